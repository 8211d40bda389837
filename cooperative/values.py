"""The values that a summary consists of."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from pydantic import TypeAdapter

from cooperative.estimate import (
    Correlation,
    CutOff,
    Element,
    Estimate,
    Exceedance,
    Fits,
    ModeShare,
    Risk,
    Severity,
    Spread,
)
from cooperative.scene import Budget, Calibration, LimitLoad


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


@dataclass(frozen=True)
class Summary:
    """A campaign in numbers.

    Args:
        name: of the campaign.
        probability_of_failure: by the estimator.
        interval: its confidence limits.
        level: of all intervals.
        estimator: its name.
        coefficient_of_variation: of the estimate, None at 0.
        unseen: as in `Estimate`.
        sampling_interval: as in `Estimate`.
        finished: why no further run is wanted, None where some are.
        after_more_runs: what further runs would bring.
        other_estimates: by estimator.
        convergence: the estimate as refined runs came in.
        samples: on the rough grid.
        failures_rough: on the rough grid.
        refined_runs: on the refined grid.
        failures_refined: on the refined grid.
        slides: failures that slid on to their end.
        slides_drawn: that there are in the end, as far as is known.
        calibration: as measured before the first run, None where the scene has none.
        limit_load: as measured before the first run, None where the scene has none.
        grids: how well the rough grid predicts the refined one, None without any spread.
        modes: by name, None where the rows have none.
        status: count of runs by how they ended, of each grid.
        broke_off: by grid and sample, why and at which step.
        cut_off: slides that had not come to rest.
        consequences_of_failures: by name, None where no slide has it.
        exceedance: by consequence.
        risk: of the elements at risk, None without any.
        fits: by group ("all" or a mode) and consequence.
        severity: modes by the median of each consequence, most severe first.
        seconds: of all runs of each grid (s).
        refined_runs_allowed: where the folder allows more than the scene.
        warnings: what limits the numbers and was known before the first run, as `jaxmpm check` says it, in sentences.
        notes: what limits the numbers and shows in the runs, in sentences.
        estimate_runs: refined runs of the estimate.
        audit_variance: as in `Estimate`.
        freedom: as in `Estimate`, None for no limit.
        planned_samples: on the rough grid in the end.
        failure_displacement: beyond which a slope fails (m).
        least_volume: of soil that has to move so far (m3, in a section m2), None for any particle.
        settle: whether a run ends once it has settled.
        slide_weights: by sample, what each slide stands for.
        stands_for: by sample, what each refined run stands for.
        annual_frequency: how often a year the scene's trigger comes, None where the scene does not give it.
        coarse_samples: on the coarse grid, of which those on the rough grid were drawn; None without such a grid.
    """

    name: str
    probability_of_failure: float
    interval: tuple[float, float]
    level: float
    estimator: str
    coefficient_of_variation: float | None
    unseen: float
    sampling_interval: tuple[float, float] | None
    finished: str | None
    after_more_runs: MoreRuns
    other_estimates: Mapping[str, OtherEstimate]
    convergence: Convergence
    samples: int
    failures_rough: int
    refined_runs: int
    failures_refined: int
    slides: int
    slides_drawn: int
    calibration: Calibration | None
    limit_load: LimitLoad | None
    grids: Correlation | None
    modes: Mapping[str, ModeShare] | None
    status: Mapping[str, Mapping[str, int]]
    broke_off: Mapping[str, Mapping[int, str]]
    cut_off: CutOff
    consequences_of_failures: Mapping[str, Spread | None]
    exceedance: Mapping[str, Exceedance]
    risk: Risk | None
    fits: Mapping[str, Mapping[str, Fits]]
    severity: Mapping[str, tuple[Severity, ...]]
    seconds: Mapping[str, float]
    refined_runs_allowed: Budget | None
    warnings: tuple[str, ...]
    notes: tuple[str, ...]
    estimate_runs: int
    audit_variance: float
    freedom: float | None
    planned_samples: int
    failure_displacement: float
    least_volume: float | None
    settle: bool
    slide_weights: Mapping[int, float]
    stands_for: Mapping[int, StandsFor]
    annual_frequency: float | None
    coarse_samples: int | None = None

    @property
    def elements_at_risk(self) -> Mapping[str, Element | None]:
        """Effects by name of the element at risk, None each while nothing is known of them; none without elements."""
        return self.risk.places if self.risk else {}

    @property
    def estimate(self) -> Estimate:
        """The probability of failure as the estimator gave it, without its notes."""
        return Estimate(
            self.probability_of_failure,
            self.interval,
            np.inf if self.coefficient_of_variation is None else self.coefficient_of_variation,
            self.estimate_runs,
            self.estimator,
            self.level,
            audit_variance=self.audit_variance,
            unseen=self.unseen,
            sampling_interval=self.sampling_interval,
            freedom=np.inf if self.freedom is None else self.freedom,
        )

    def as_json(self) -> dict[str, object]:
        """Its fields as JSON has them, which `from_json` reads: a number that is not finite is null."""
        return json.loads(_SUMMARY.dump_json(self))

    @classmethod
    def from_json(cls, text: str | bytes) -> Summary:
        """A summary from the JSON of `as_json`, without keys that are no field. Raises ValueError for anything else."""
        return _SUMMARY.validate_json(text, strict=True)


_SUMMARY = TypeAdapter(Summary)
