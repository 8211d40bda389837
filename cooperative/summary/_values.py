"""The values that a summary consists of: probability, modes, consequences, cost."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydantic import TypeAdapter

from cooperative.estimate import Correlation, Estimate, Exceedance, Fits, Severity
from cooperative.scene import Budget, Calibration, LimitLoad
from jaxmpm.support.values import by_value


@dataclass(frozen=True)
class ModeShare:
    """A failure mode.

    Args:
        count: refined runs that failed so.
        ratio: weighted share of the failures.
        interval: confidence limits of the share.
        probability: that a sample fails so.
    """

    count: int
    ratio: float
    interval: tuple[float, float]
    probability: float


@dataclass(frozen=True)
class CutOff:
    """Slides that ended before they came to rest.

    Args:
        of: slides that count.
        at_t_end: those that moved still when they ended.
        broke_off: those that ended for numerical reasons.
        t_end: up to when slides may go on (s).
    """

    of: int
    at_t_end: int
    broke_off: int
    t_end: float


@dataclass(frozen=True)
class Spread:
    """A consequence over the slides.

    Args:
        mean: weighted.
        interval: its confidence limits, None for too few slides.
        smallest: of all slides.
        largest: of all slides.
        at_least: whether the slides would have gone on.
    """

    mean: float
    interval: tuple[float, float] | None
    smallest: float
    largest: float
    at_least: bool


@dataclass(frozen=True)
class Reached:
    """Probability that a slide reaches an element at risk, or carries it away.

    Args:
        probability: over all samples.
        interval: its confidence limits.
        at_least: as in `Spread`.
    """

    probability: float
    interval: tuple[float, float]
    at_least: bool


@dataclass(frozen=True)
class ElementLoss:
    """Expected loss at one element at risk.

    Args:
        value: what it is worth.
        expected: over all samples.
        interval: its confidence limits.
        at_least: as in `Spread`.
    """

    value: float
    expected: float
    interval: tuple[float, float]
    at_least: bool


@dataclass(frozen=True)
class SampleLoss:
    """A sample that is part of the loss.

    Args:
        sample: its number.
        loss: if it fails.
        share: of the expected loss.
    """

    sample: int
    loss: float
    share: float


@by_value
@dataclass(frozen=True)
class Loss:
    """Expected loss at all elements at risk together.

    Args:
        expected: over all samples.
        interval: its confidence limits.
        at_least: as in `Spread`.
        exceedance: probability of losing more.
        modes: share of the loss by failure mode.
        samples: those with the largest shares.
    """

    expected: float
    interval: tuple[float, float]
    at_least: bool
    exceedance: Exceedance
    modes: Mapping[str, float]
    samples: tuple[SampleLoss, ...]


@dataclass(frozen=True)
class Element:
    """Effects on one element at risk.

    What hits it is soil that lies or moves above the surface that was there before; what carries it away is a
    displacement of its own ground.

    Args:
        reached: probability that soil arrives above its ground.
        thickness: largest of that soil, of the slides that arrive (m), None where none does.
        speed: largest of that soil, of the slides that arrive (m/s), None where none does.
        arrival: of the slides that arrive (s), None where none does.
        loss: by what hits it, None where the scene gives no value.
        carried: probability that its ground moves by the failure displacement or more.
        ground: displacement of its ground, of the slides that carry it away (m), None where none does.
    """

    reached: Reached
    thickness: Spread | None
    speed: Spread | None
    arrival: Spread | None
    loss: ElementLoss | None
    carried: Reached
    ground: Spread | None


@by_value
@dataclass(frozen=True)
class Risk:
    """Risk of the elements at risk.

    Args:
        places: effects by name of the element, None each while nothing is known of them.
        loss: of all together, None where no element has a value.
    """

    places: Mapping[str, Element | None]
    loss: Loss | None


@dataclass(frozen=True)
class OtherEstimate:
    """Probability of failure by another estimator from the same runs.

    Args:
        probability: P_f.
        interval: its confidence limits.
    """

    probability: float
    interval: tuple[float, float]


@dataclass(frozen=True)
class MoreRuns:
    """What further refined runs would buy.

    Args:
        runs: as many as the budget and the samples leave, at most 50.
        coefficient_of_variation: after these runs, None where the runs do not show it, or the estimator takes no more.
        samples_left: not run refined yet, None while the first phase is not complete.
        all_samples: coefficient of variation after all samples, None likewise.
    """

    runs: int
    coefficient_of_variation: float | None
    samples_left: int | None
    all_samples: float | None


@by_value
@dataclass(frozen=True)
class Convergence:
    """The estimate as refined runs came in.

    Args:
        refined_runs: number of them (k,).
        probability: P_f (k,).
        low: lower confidence limits (k,).
        high: upper confidence limits (k,).
    """

    refined_runs: tuple[int, ...]
    probability: tuple[float, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]


@dataclass(frozen=True)
class StandsFor:
    """A refined run in the estimate.

    Args:
        failed: None where it broke off undecided.
        weight: the share of all samples that it stands for.
        slide_weight: the same for what slides did.
    """

    failed: bool | None
    weight: float
    slide_weight: float


@by_value
@dataclass(frozen=True)
class FailureProbability:
    """How likely a sample fails, and what that rests on.

    Args:
        value: P_f by the estimator.
        interval: its confidence limits.
        level: of all intervals.
        estimator: its name.
        coefficient_of_variation: of the estimate, None at 0.
        runs: refined runs of the estimate.
        hidden_limit: as in `Estimate`.
        sampling_interval: as in `Estimate`.
        audit_variance: as in `Estimate`.
        freedom: as in `Estimate`, None for no limit.
        others: estimates by other estimators from the same runs, by name.
        convergence: the estimate as refined runs came in.
        failures_rough: runs of the rough grid that failed.
        failures_refined: runs of the refined grid that failed.
        grids: how well the rough grid predicts the refined one, None without any spread.
        stands_for: by sample, what each refined run stands for.
        failure_displacement: beyond which a slope fails (m).
        least_volume: of soil that has to move so far (m3, in a section m2), None for any particle.
        limit_load: as measured before the first run, None where the scene has none.
        calibration: as measured before the first run, None where the scene has none.
        annual_frequency: how often a year the scene's trigger comes, None where the scene does not give it.
    """

    value: float
    interval: tuple[float, float]
    level: float
    estimator: str
    coefficient_of_variation: float | None
    runs: int
    hidden_limit: float
    sampling_interval: tuple[float, float] | None
    audit_variance: float
    freedom: float | None
    others: Mapping[str, OtherEstimate]
    convergence: Convergence
    failures_rough: int
    failures_refined: int
    grids: Correlation | None
    stands_for: Mapping[int, StandsFor]
    failure_displacement: float
    least_volume: float | None
    limit_load: LimitLoad | None
    calibration: Calibration | None
    annual_frequency: float | None

    @property
    def estimate(self) -> Estimate:
        """The probability of failure as the estimator gave it, without its notes."""
        return Estimate(
            self.value,
            self.interval,
            np.inf if self.coefficient_of_variation is None else self.coefficient_of_variation,
            self.runs,
            self.estimator,
            self.level,
            audit_variance=self.audit_variance,
            hidden_limit=self.hidden_limit,
            sampling_interval=self.sampling_interval,
            freedom=np.inf if self.freedom is None else self.freedom,
        )


@by_value
@dataclass(frozen=True)
class FailureModes:
    """In which way slopes fail.

    Args:
        shares: by mode, None where the rows have none.
        severity: modes by the median of each consequence, most severe first.
    """

    shares: Mapping[str, ModeShare] | None
    severity: Mapping[str, tuple[Severity, ...]]


@by_value
@dataclass(frozen=True)
class FailureConsequences:
    """What slides do, each weighed by what it stands for.

    Args:
        slides: failures that slid on to their end.
        planned: slides that there are in the end, as far as the runs show.
        weights: by sample, what each slide stands for.
        cut_off: slides that had not come to rest.
        means: by consequence, None where no slide has it.
        exceedance: curves by consequence.
        fits: by group ("all" or a mode) and consequence.
        risk: of the elements at risk, None without any.
    """

    slides: int
    planned: int
    weights: Mapping[int, float]
    cut_off: CutOff
    means: Mapping[str, Spread | None]
    exceedance: Mapping[str, Exceedance]
    fits: Mapping[str, Mapping[str, Fits]]
    risk: Risk | None

    @property
    def elements_at_risk(self) -> Mapping[str, Element | None]:
        """Effects by name of the element at risk, None each while nothing is known of them; none without elements."""
        return self.risk.places if self.risk else {}


@by_value
@dataclass(frozen=True)
class CampaignCost:
    """What ran, and what further runs would bring.

    Args:
        samples: on the rough grid.
        planned_samples: on the rough grid in the end.
        coarse_samples: of the coarse phase, of which those on the rough grid were drawn; None without one.
        ranked_by: name of the function that ranked these in place of a coarse grid; None for none.
        refined_runs: on the refined grid.
        refined_runs_allowed: where the folder allows more than the scene.
        seconds: of all runs of each grid (s).
        status: count of runs by how they ended, of each grid.
        settle: whether a run ends once it has settled.
        broke_off: by grid and sample, why and at which step.
        finished: why no further run is wanted, None where some are.
        after_more_runs: what further runs would bring.
    """

    samples: int
    planned_samples: int
    coarse_samples: int | None
    ranked_by: str | None
    refined_runs: int
    refined_runs_allowed: Budget | None
    seconds: Mapping[str, float]
    status: Mapping[str, Mapping[str, int]]
    settle: bool
    broke_off: Mapping[str, Mapping[int, str]]
    finished: str | None
    after_more_runs: MoreRuns


@by_value
@dataclass(frozen=True)
class Summary:
    """A campaign in numbers.

    Args:
        name: of the campaign.
        probability: how likely a sample fails.
        modes: in which way.
        consequences: what slides do.
        cost: what ran.
        warnings: what limits the numbers and was known before the first run, as `jaxmpm check` says it, in sentences.
        notes: what limits the numbers and shows in the runs, in sentences.
    """

    name: str
    probability: FailureProbability
    modes: FailureModes
    consequences: FailureConsequences
    cost: CampaignCost
    warnings: tuple[str, ...]
    notes: tuple[str, ...]

    def as_json(self) -> dict[str, Any]:
        """Its fields as JSON has them, which `from_json` reads: a number that is not finite is null."""
        return json.loads(_SUMMARY.dump_json(self))

    @classmethod
    def from_json(cls, text: str | bytes) -> Summary:
        """A summary from the JSON of `as_json`, without keys that are no field. Raises ValueError for anything else."""
        return _SUMMARY.validate_json(text, strict=True)


_SUMMARY = TypeAdapter(Summary)
