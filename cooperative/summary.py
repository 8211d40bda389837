"""A campaign in numbers, from its rows alone: probability, modes, consequences, how well the grids agree."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydantic import TypeAdapter

from cooperative.agreement import agreement_of
from cooperative.effects import ModeShare, effects_of
from cooperative.estimate import (
    Correlation,
    Estimate,
    Exceedance,
    Fits,
    Phases,
    Severity,
    Slides,
    after_more_runs,
)
from cooperative.notes import notes_of
from cooperative.risk import CutOff, Risk, Spread
from cooperative.runs import phases_of
from cooperative.scene import Budget, Calibration, Campaign, LimitLoad
from cooperative.store import Rows

NOT_BROKEN = ("FINISHED", "SETTLED", "DECIDED")
MORE = 50
"""Further refined runs whose effect is given, or fewer where fewer are left."""


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
        runs: so many as the budget and the samples leave, at most `MORE`.
        coefficient_of_variation: after these runs, and after all samples; None where the runs do not tell, or the
            estimator takes no more.
        samples_left: not run refined yet, None while the first phase is not complete.
        all_samples: after these runs, and after all samples; None where the runs do not tell, or the estimator takes no
            more.
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
        failed: None where it broke off before it could tell.
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
        probability_of_failure: by the `estimator`, with its confidence limits, the interval, at `level` and its
            coefficient_of_variation, None at 0.
        interval: its confidence limits.
        level: of all intervals.
        estimator: its name.
        coefficient_of_variation: of the estimate, None at 0.
        unseen: as in `Estimate`.
        sampling_interval: as in `Estimate`.
        finished: why no further run is asked for, None where some are.
        after_more_runs: what these would buy.
        other_estimates: by estimator.
        convergence: the estimate as refined runs came in.
        samples: on the rough grid.
        failures_rough: on the rough grid.
        refined_runs: on the refined grid.
        failures_refined: on the refined grid.
        slides: failures that slid on to their end;
        slides_drawn: that there are in the end, as far as is known.
        calibration: as measured before the first run, None where not asked for.
        limit_load: as measured before the first run, None where not asked for.
        grids: how well the rough grid tells the refined one, None without any spread.
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
        notes: what a reader must know, in words.
        estimate_runs: as in `Estimate`, whose refined_runs are the first, None for no limit.
        audit_variance: as in `Estimate`, whose refined_runs are the first, None for no limit.
        freedom: as in `Estimate`, whose refined_runs are the first, None for no limit.
        planned_samples: on the rough grid in the end. failure_displacement (m), least_volume (m3, in a section m2; None
            for any particle): from which on a slope fails.
        failure_displacement: beyond which a slope fails (m).
        least_volume: of soil that has to move so far (m3, in a section m2), None for any particle.
        settle: whether a run ends once it has settled.
        slide_weights: by sample, what each slide stands for.
        stands_for: by sample, what each refined run does.
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

    def as_json(self) -> dict[str, Any]:
        """Its fields as JSON has them, which `from_json` reads: a number that is not finite is null."""
        fields: dict[str, Any] = json.loads(_SUMMARY.dump_json(self))
        if self.calibration is not None:
            fields["calibration"]["factor"] = self.calibration.factor
        return fields

    @classmethod
    def from_json(cls, text: str | bytes) -> Summary:
        """A summary from the JSON of `as_json`, without keys that are no field. Raises ValueError for anything else."""
        return _SUMMARY.validate_json(text, strict=True)


_SUMMARY = TypeAdapter(Summary)


def summarise(campaign: Campaign, rough: Rows, refined: Rows) -> Summary:
    """The campaign in numbers.

    Means, shares and fits weigh every refined run by what it stands for. Where only some failures slid on to their end,
    these stand for all. What there is too little of is None or says so: modes of rows without any (written before there
    were modes), fits of fewer than two failures, a correlation without spread.

    Args:
        campaign: whose rows these are.
        rough: rows of the rough grid.
        refined: rows of the refined grid.
    """
    return summary_of(campaign, phases_of(campaign, rough, refined), rough, refined)


def summary_of(campaign: Campaign, phases: Phases, rough: Rows, refined: Rows) -> Summary:
    """The campaign in numbers; see `summarise`.

    Args:
        campaign: whose rows these are.
        phases: what these rows tell its estimator.
        rough: rows of the rough grid.
        refined: rows of the refined grid.
    """
    estimate, path, slides = phases.estimate, phases.path, slides_of(campaign, phases, refined)
    effects, tables = effects_of(campaign, estimate, refined, slides), {"rough": rough, "refined": refined}
    limit = campaign.run.failure_displacement
    return Summary(
        name=campaign.name,
        probability_of_failure=estimate.probability,
        interval=estimate.interval,
        level=estimate.level,
        estimator=estimate.method,
        coefficient_of_variation=_finite(estimate.cov),
        unseen=estimate.unseen,
        sampling_interval=estimate.sampling_interval,
        finished=phases.why_finished,
        after_more_runs=_after_more_runs(campaign, phases),
        other_estimates={each.method: OtherEstimate(each.probability, each.interval) for each in phases.beside},
        convergence=Convergence(
            refined_runs=tuple(each.refined_runs for each in path),
            probability=tuple(each.probability for each in path),
            low=tuple(each.interval[0] for each in path),
            high=tuple(each.interval[1] for each in path),
        ),
        samples=len(rough.numbers),
        failures_rough=int(np.sum(rough.columns["displacement"] > limit)),
        refined_runs=len(refined.numbers),
        failures_refined=int(slides.failed.sum()),
        slides=int(slides.slid.sum()),
        slides_drawn=slides.planned,
        calibration=campaign.measured.calibration,
        limit_load=campaign.measured.limit_load,
        grids=agreement_of(campaign, phases, rough, refined),
        status={grid: dict(Counter(rows.columns["status"].tolist())) for grid, rows in tables.items()},
        broke_off={grid: _broken(rows) for grid, rows in tables.items()},
        seconds={grid: float(np.sum(rows.columns["seconds"])) for grid, rows in tables.items()},
        refined_runs_allowed=campaign.raised,
        notes=notes_of(campaign, phases, rough, refined, slides, effects.cut_off),
        estimate_runs=estimate.refined_runs,
        audit_variance=estimate.audit_variance,
        freedom=_finite(estimate.freedom),
        planned_samples=phases.planned,
        failure_displacement=limit,
        least_volume=campaign.run.least_volume,
        settle=campaign.run.settle is not None,
        slide_weights={refined.numbers[at]: float(slides.weight[at]) for at in np.flatnonzero(slides.slid)},
        stands_for={
            number: StandsFor(phases.answers[number], float(phases.weights[number]), float(slides.weight[at]))
            for at, number in enumerate(refined.numbers)
        },
        **vars(effects),
    )


def slides_of(campaign: Campaign, phases: Phases, refined: Rows) -> Slides:
    """Which refined failures slid on to their end, and what each run stands for then.

    Args:
        campaign: whose runs these are.
        phases: results of both phases.
        refined: rows of the refined grid.
    """
    return Slides.of(phases, refined.numbers, refined.ended, campaign.plan.slides, campaign.plan.seed)


def _after_more_runs(campaign: Campaign, phases: Phases) -> MoreRuns:
    estimate, population = phases.estimate, phases.population
    if population is None:
        return MoreRuns(0, None, None, None)
    # A sample at which a chain of subset simulation stood still has several positions.
    left = np.setdiff1d(population.numbers, list(phases.answers)).size
    budget = campaign.estimator.budget(population.size)
    # Once the budget is spent the folder may allow more.
    allowed = left if budget is None or phases.why_finished else max(budget - len(phases.answers), 0)
    runs = min(MORE, left, allowed)

    def after(more: int) -> float | None:
        if left and not estimate.audit_variance:
            return None
        return _finite(after_more_runs(estimate, more if more < left else population.size, samples=population.size))

    return MoreRuns(runs, after(runs), left, after(left))


def _broken(rows: Rows) -> dict[int, str]:
    """Samples whose run broke off: why, and at which step."""
    columns = rows.columns
    return {
        number: f"{status} at step {steps}"
        for number, status, steps in zip(rows.numbers, columns["status"], columns["steps"], strict=True)
        if status not in NOT_BROKEN
    }


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
