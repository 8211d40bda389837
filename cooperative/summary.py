"""A campaign in numbers, from its rows alone: probability, modes, consequences, how well the grids agree."""

from __future__ import annotations

from collections import Counter

import numpy as np

from cooperative.estimate import (
    Correlation,
    CutOff,
    Phases,
    Slides,
    after_more_runs,
    correlation,
    effects_of,
    in_range,
    out_of_range,
)
from cooperative.measure import EDGE
from cooperative.runs import phases_of, warnings_of
from cooperative.scene import Campaign, doubts
from cooperative.store import Rows, mixed_versions
from cooperative.values import Convergence, MoreRuns, OtherEstimate, StandsFor, Summary

__all__ = ["Summary", "slides_of", "summarise", "summary_of", "walls_reached"]

NOT_BROKEN = ("FINISHED", "SETTLED", "DECIDED")
MORE = 50
"""Further refined runs whose effect is given, or fewer where fewer are left."""
NEAR_FAILURE = 0.2
"""Share of the failure displacement from which a standing slope is close to failure."""
SECOND_FACE = 0.2
"""Height of a face behind the crest, over that of the slope, from which on slides may take it."""
EARLY_TESTED, EARLY_TESTED_3D = 1288, 207
"""Runs on which early classes were tested, and those in 3D; no class changed (`python -m benchmarks early`)."""


def summarise(campaign: Campaign, rough: Rows, refined: Rows) -> Summary:
    """The campaign in numbers.

    Means, shares and fits weigh every refined run by what it stands for. Where only some failures slid on to their end,
    these stand for all. What there is too little of is None or noted: modes of ground without a toe, fits of fewer than
    two failures, a correlation without spread.

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
        phases: what its estimator takes from these rows.
        rough: rows of the rough grid.
        refined: rows of the refined grid.
    """
    estimate, path, slides = phases.estimate, phases.path, slides_of(campaign, phases, refined)
    tables = {"rough": rough, "refined": refined}
    effects = effects_of(
        estimate,
        refined,
        slides,
        t_end=campaign.run.last("refined"),
        deepest=campaign.site.shape.extent[-1],
        elements_at_risk=campaign.elements_at_risk,
        failure_displacement=campaign.run.failure_displacement,
    )
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
        coarse_samples=phases.coarse_samples,
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
        warnings=tuple(warnings_of(campaign)),
        notes=notes_of(campaign, phases, rough, refined, slides, effects.cut_off),
        estimate_runs=estimate.refined_runs,
        audit_variance=estimate.audit_variance,
        freedom=_finite(estimate.freedom),
        planned_samples=phases.planned,
        failure_displacement=limit,
        least_volume=campaign.failing_volume,
        settle=campaign.run.settle is not None,
        annual_frequency=campaign.plan.annual_frequency,
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
    # Runs of a wave that is not complete do not count yet.
    waiting = len(phases.answers) - estimate.refined_runs

    def after(more: int) -> float | None:
        if left and not estimate.audit_variance:
            return None
        more = waiting + more if more < left else population.size
        return _finite(after_more_runs(estimate, more, samples=population.size))

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
        _as_far_as_known(rough, both),
        _as_far_as_known(refined, both),
        np.array([weights[number] for number in both]),
        failure_displacement=campaign.run.failure_displacement,
    )


def _as_far_as_known(rows: Rows, numbers: list[int]) -> np.ndarray:
    """Largest displacement of these samples (n,) m.

    Runs that ended once they had failed, or broke off, would have moved farther, so it is unknown which of those beyond
    the least of them moved farthest: they are all alike.
    """
    at = np.isin(rows.numbers, numbers)
    displacement, cut = rows.columns["displacement"][at], (~rows.ended | rows.columns["broke_off"].astype(bool))[at]
    return np.minimum(displacement, displacement[cut].min(initial=np.inf))


def notes_of(
    campaign: Campaign, phases: Phases, rough: Rows, refined: Rows, slides: Slides, cut: CutOff
) -> tuple[str, ...]:
    """Sentences on what limits the numbers of a summary.

    Args:
        campaign: whose rows these are.
        phases: results of both phases.
        rough: rows of the rough grid.
        refined: rows of the refined grid.
        slides: which failures slid.
        cut: slides that had not come to rest.
    """
    notes, run, load = [], campaign.run, campaign.measured.limit_load
    if load is not None:
        notes.append(
            f"a slope fails when {campaign.least_volume or 'any soil'} moves {load.displacement:g} m, the displacement "
            f"of median soil at its limit load (factor of safety {load.factor:.3f}"
            + (")" if load.sharpness is None else f", displacement grows {load.sharpness:.3g} times as fast beyond)")
        )
        notes += doubts(load, campaign.least_volume or "any soil")
    notes += [*_loads(campaign), *_other_face(campaign), *phases.estimate.notes, *walls_reached(rough, refined)]
    if campaign.raised is not None:
        allowed = campaign.raised
        notes.append(f"the folder allows {allowed.refined_runs} refined runs, the scene {allowed.scene}")
    notes += slides.notes
    if cut.at_t_end:
        how = "had not come to rest" if run.settle else "were not looked at for rest (settle = false)"
        notes.append(
            f"{cut.at_t_end} of {cut.of} slides {how} when they ended at {cut.t_end:g} s, so their "
            "consequences are least values. `jaxmpm resume --slides-t-end SECONDS` lets them go on from there"
        )
    if cut.broke_off:
        notes.append(
            f"{cut.broke_off} of {cut.of} slides broke off. Their displacement is a least value, and they have no "
            "part in the other consequences"
        )
    notes += filter(None, [out_of_range(refined, slides.slid), mixed_versions({"rough": rough, "refined": refined})])
    stands = np.array([phases.answers[number] is False for number in refined.numbers], bool)
    displacement, status = refined.columns.get("displacement", np.zeros(0)), refined.columns["status"]
    smaller = in_range(refined.columns.get("volume", np.full(stands.size, np.nan)))[stands]
    if campaign.failing_volume is not None and (smaller > 0).any():
        notes.append(
            f"in {(smaller > 0).sum()} of {stands.sum()} refined runs that stand less than {campaign.least_volume} of "
            f"soil moved so far, {np.nanmax(smaller):.3g} at most. [run] least_volume says what is a failure"
        )
    moving = stands & (status == "FINISHED")
    if run.settle is not None and moving.any():
        notes.append(
            f"{moving.sum()} of {stands.sum()} refined runs that stand had not settled at t_end = {run.t_end:g} "
            f"s; the farthest had moved {displacement[moving].max():.2g} m. They may fail later"
        )
    near = stands & (status == "SETTLED") & (displacement > NEAR_FAILURE * run.failure_displacement)
    if load is None and near.any():
        notes.append(
            f"{near.sum()} of {stands.sum()} refined runs that stand settled after {displacement[near].max():.2g} m, "
            f"more than {NEAR_FAILURE:g} of the {run.failure_displacement:g} m of a failure: such a slope can creep on "
            "and fail later. [run] settle = false runs every sample to t_end"
        )
    classes = [grid for grid, stop in (("rough", campaign.plan.screening_stop), ("refined", campaign.plan.slides))
               if stop is not None]  # fmt: skip
    settle = campaign.settles(run.failure_displacement)
    if settle is not None and settle.early is not None and classes:
        notes.append(
            f"{' and '.join(classes)} runs ended once the rate of their plastic strain showed the class ([run] early). "
            f"In {EARLY_TESTED} runs of other samples this changed no class, an error of at most "
            f"{3 / EARLY_TESTED:.2%} (95 %); in the {EARLY_TESTED_3D} in 3D alone of {3 / EARLY_TESTED_3D:.2%}"
        )
    return tuple(notes)


def _loads(campaign: Campaign) -> list[str]:
    """Name the earthquake, the factor on strength and the random water under which all runs are."""
    run, level, loads = campaign.run, campaign.site.level, []
    if run.k_h or run.k_v:
        loads.append(f"a pseudo-static acceleration of k_h = {run.k_h:g} and k_v = {run.k_v:g} acts all the time")
    if run.motion is not None:
        peak = float(np.abs(run.motion.acceleration).max())
        loads.append(f"a record of {float(run.motion.duration):g} s shakes the base, with a peak of {peak:.3g} m/s2")
    if run.strength_factor != 1:
        loads.append(f"all strength is multiplied by {run.strength_factor:g}")
    if level is not None:
        loads.append(f"each sample has its own water level, of mean {level.mean:g} m and deviation {level.sd:g} m")
    return loads


def _other_face(campaign: Campaign) -> list[str]:
    """Name a face of a section on the other side of its crest than the toe."""
    shape = campaign.site.shape
    if campaign.dimension == 3 or shape.face is None:
        return []
    z = shape.heights(np.linspace(shape.corner[0], shape.face.toe_x, 1025))
    crest = int(np.flatnonzero(z == z.max())[-1])
    fall = float(z[crest] - z[: crest + 1].min())
    if fall < SECOND_FACE * shape.face.height:
        return []
    return [
        f"the ground falls by {fall:.3g} m on the other side of its crest too. A slide there is a failure, and its "
        "run-out is 0, since run-out counts soil beyond the toe alone"
    ]


def walls_reached(rough: Rows, refined: Rows) -> list[str]:
    """Name the walls that slides have reached, on the refined grid or, where nothing slid on it, the rough one.

    Args:
        rough: rows of the rough grid.
        refined: rows of the refined grid.
    """
    for grid, rows in (("refined", refined), ("rough", rough)):
        reached = [wall for walls in rows.columns.get("walls", ()) for wall in str(walls).split("; ") if wall]
        if reached:
            return [
                f"the slide reached {wall if wall == EDGE else f'the wall at {wall}'}, which held it, in {count} "
                f"{grid} run{'s' if count > 1 else ''}: "
                f"{'draw it farther out' if wall == EDGE else 'lengthen the ground'} there"
                for wall, count in sorted(Counter(reached).items())
            ]
    return []
