"""A campaign in numbers, from its rows alone: probability, modes, consequences, how well the grids agree."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from cooperative.estimate import Correlation, Estimate, Phases, Slides, after_more_runs, correlation
from cooperative.runs import name_of_rank, phases_of, warnings_of
from cooperative.scene import Campaign
from cooperative.store import GRIDS, Rows, mixed_versions
from cooperative.summary._notes import notes_of, walls_reached
from cooperative.summary._slides import consequences_of, modes_of, out_of_range
from cooperative.summary._values import (
    CampaignCost,
    Convergence,
    FailureProbability,
    MoreRuns,
    OtherEstimate,
    StandsFor,
    Summary,
)

NOT_BROKEN = ("FINISHED", "SETTLED", "DECIDED")
MORE = 50
"""Further refined runs whose effect is given, or fewer where fewer are left."""


def summarise(campaign: Campaign, rough: Rows, refined: Rows, phases: Phases | None = None) -> Summary:
    """The campaign in numbers.

    Means, shares and fits weigh every refined run by what it stands for. Where only some failures slid on to their end,
    these stand for all. What there is too little of is None or noted: modes of ground without a toe, fits of fewer than
    two failures, a correlation without spread.

    Args:
        campaign: whose rows these are.
        rough: rows of the rough grid.
        refined: rows of the refined grid.
        phases: what its estimator takes from these rows; by default worked out from them.
    """
    phases = phases or phases_of(campaign, rough, refined)
    slides = slides_of(campaign, phases, refined)
    consequences = consequences_of(campaign, phases.estimate, refined, slides)
    return Summary(
        name=campaign.name,
        probability=_probability(campaign, phases, rough, refined, slides),
        modes=modes_of(phases.estimate, refined, slides),
        consequences=consequences,
        cost=_cost(campaign, phases, rough, refined),
        warnings=tuple(warnings_of(campaign)),
        notes=notes_of(campaign, phases, rough, refined, slides, consequences.cut_off),
    )


def _probability(campaign: Campaign, phases: Phases, rough: Rows, refined: Rows, slides: Slides) -> FailureProbability:
    path, limit = phases.path, campaign.run.failure_displacement
    return replace(
        _alone(campaign, phases.estimate),
        others={other.method: OtherEstimate(other.probability, other.interval) for other in phases.beside},
        convergence=Convergence(
            refined_runs=tuple(step.refined_runs for step in path),
            probability=tuple(step.probability for step in path),
            low=tuple(step.interval[0] for step in path),
            high=tuple(step.interval[1] for step in path),
        ),
        failures_rough=int(np.sum(rough.columns["displacement"] > limit)),
        failures_refined=int(slides.failed.sum()),
        grids=agreement_of(campaign, phases, rough, refined),
        stands_for={
            number: StandsFor(phases.answers[number], float(phases.weights[number]), float(slides.weight[at]))
            for at, number in enumerate(refined.numbers)
        },
    )


def _alone(campaign: Campaign, estimate: Estimate) -> FailureProbability:
    """An estimate without the runs that it rests on."""
    return FailureProbability(
        value=estimate.probability,
        interval=estimate.interval,
        level=estimate.level,
        estimator=estimate.method,
        coefficient_of_variation=_finite(estimate.cov),
        runs=estimate.refined_runs,
        hidden_limit=estimate.hidden_limit,
        sampling_interval=estimate.sampling_interval,
        audit_variance=estimate.audit_variance,
        freedom=_finite(estimate.freedom),
        others={},
        convergence=Convergence((), (), (), ()),
        failures_rough=0,
        failures_refined=0,
        grids=None,
        stands_for={},
        failure_displacement=campaign.run.failure_displacement,
        least_volume=campaign.failing_volume,
        limit_load=campaign.measured.limit_load,
        calibration=campaign.measured.calibration,
        annual_frequency=campaign.plan.annual_frequency,
    )


def _cost(campaign: Campaign, phases: Phases, rough: Rows, refined: Rows) -> CampaignCost:
    return replace(
        _cost_of(campaign, {"rough": rough, "refined": refined}),
        planned_samples=phases.planned,
        coarse_samples=phases.coarse_samples,
        ranked_by=name_of_rank(campaign),
        refined_runs_allowed=campaign.raised,
        finished=phases.why_finished,
        after_more_runs=_after_more_runs(campaign, phases),
    )


def _cost_of(campaign: Campaign, tables: Mapping[str, Rows]) -> CampaignCost:
    """What ran on each grid."""
    samples, refined_runs = (len(tables[grid].numbers) for grid in GRIDS)
    return CampaignCost(
        samples=samples,
        planned_samples=samples,
        coarse_samples=None,
        ranked_by=None,
        refined_runs=refined_runs,
        refined_runs_allowed=None,
        seconds={grid: float(np.sum(rows.columns["seconds"])) for grid, rows in tables.items()},
        status={grid: dict(Counter(rows.columns["status"].tolist())) for grid, rows in tables.items()},
        settle=bool(campaign.run.settle),
        broke_off={grid: _broken(rows) for grid, rows in tables.items()},
        finished=None,
        after_more_runs=MoreRuns(0, None, None, None),
    )


def summarise_slides(
    campaign: Campaign, estimate: Estimate, slid: Mapping[str, Rows], fails: Mapping[str, Sequence[bool]]
) -> Summary:
    """Slides of samples that were asked in time, each from its first failure, in numbers.

    They are of the first of the samples that fail, whatever they do, so that each stands for as many failures.

    Args:
        campaign: whose samples these are.
        estimate: of the probability of failure by the last time.
        slid: rows of the slides of each grid; they ran on the finest that was asked.
        fails: whether each sample that was asked on a grid fails.

    Returns:
        The numbers, with what each slide stands for where it ran on the refined grid.
    """
    grid = "refined" if fails["refined"] else "rough"
    rows = slid[grid]
    count = len(rows.numbers)
    weight = np.full(count, estimate.probability / max(count, 1))
    slides = Slides(np.ones(count, bool), np.ones(count, bool), weight, ())
    samples, refined = len(fails["rough"]), len(fails["refined"])
    consequences = consequences_of(campaign, estimate, rows, slides)
    limits = [out_of_range(rows, slides.slid), mixed_versions(slid)]
    if (cut := consequences.cut_off).at_t_end:
        limits.append(
            f"{cut.at_t_end} of {cut.of} slides had not come to rest when they ended at {cut.t_end:g} s, so their "
            "consequences are least values. A later t_end in [run] of the scene, in another folder, lets them go on"
        )
    return Summary(
        name=campaign.name,
        probability=replace(
            _alone(campaign, estimate),
            failures_rough=sum(fails["rough"]),
            failures_refined=sum(fails["refined"]),
            stands_for={number: StandsFor(True, *2 * (float(weight[0]),)) for number in slid["refined"].numbers},
        ),
        modes=modes_of(estimate, rows, slides),
        consequences=consequences,
        cost=replace(
            _cost_of(campaign, slid),
            samples=samples,
            planned_samples=samples,
            refined_runs=refined,
            finished="all samples have been asked in time",
            after_more_runs=MoreRuns(0, None, samples - refined, None),
        ),
        warnings=tuple(warnings_of(campaign)),
        notes=(*estimate.notes, *walls_reached(grid, rows), *filter(None, limits)),
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
    remaining = np.setdiff1d(population.numbers, list(phases.answers)).size
    budget = campaign.estimator.budget(population.size)
    # Once the budget is spent the folder may allow more.
    allowed = remaining if budget is None or phases.why_finished else max(budget - len(phases.answers), 0)
    runs = min(MORE, remaining, allowed)
    # Runs of a wave that is not complete do not count yet; samples without a rough result count before they have run.
    waiting = max(len(phases.answers) - estimate.refined_runs, 0)

    def after(more: int) -> float | None:
        if remaining and not estimate.audit_variance:
            return None
        more = waiting + more if more < remaining else population.size
        return _finite(after_more_runs(estimate, more, samples=population.size))

    return MoreRuns(runs, after(runs), remaining, after(remaining))


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


def agreement_of(campaign: Campaign, phases: Phases, rough: Rows, refined: Rows) -> Correlation | None:
    """How well the grids agree, over all runs that have a class on both, by their weights in the audit.

    Failures that ended before the end of their slide count too.

    Args:
        campaign: whose rows these are.
        phases: results of both phases.
        rough: rows of the rough grid.
        refined: rows of the refined grid.
    """
    weights, classes = phases.weights, {n: phases.answer(*result) for n, result in rough.results.items()}
    # A rough sample may lack while its damaged file waits to be redone.
    both = [number for number in refined.numbers if weights[number] > 0 and classes.get(number) is not None]
    if not both:
        return None
    return correlation(
        _bounded(rough, both),
        _bounded(refined, both),
        np.array([weights[number] for number in both]),
        failure_displacement=campaign.run.failure_displacement,
    )


def _bounded(rows: Rows, numbers: list[int]) -> np.ndarray:
    """Largest displacement of these samples (n,) m.

    Runs that ended once they had failed, or broke off, would have moved farther, so it is unknown which of those beyond
    the least of them moved farthest: they are all alike.
    """
    at = np.isin(rows.numbers, numbers)
    displacement, cut = rows.columns["displacement"][at], (~rows.ended | rows.columns["broke_off"].astype(bool))[at]
    return np.minimum(displacement, displacement[cut].min(initial=np.inf))
