"""Sentences on what limits the numbers of a summary."""

from __future__ import annotations

from collections import Counter

import numpy as np

from cooperative.estimate import Phases, Slides
from cooperative.measure import EDGE
from cooperative.scene import Campaign, doubts
from cooperative.store import GRIDS, Rows, mixed_versions
from cooperative.summary._slides import in_range, out_of_range
from cooperative.summary._values import CutOff
from jaxmpm.run import Early

NEAR_FAILURE = 0.2
"""Share of the failure displacement from which a standing slope is close to failure."""
SECOND_FACE = 0.2
"""Height of a face behind the crest, over that of the slope, from which on slides may take it."""
EARLY_TESTED, EARLY_TESTED_3D = 1288, 207
"""Runs on which early classes were tested, and those in 3D; no class changed (`python -m benchmarks early`)."""


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
    notes += [*_loads(campaign), *_other_face(campaign), *phases.estimate.notes]
    notes += walls_reached("refined", refined) or walls_reached("rough", rough)
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
    if run.settle and moving.any():
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
    classes = [grid for grid in GRIDS if campaign.decided_at(grid) is not None]
    if classes and any(isinstance(rule, Early) for rule in campaign.rules(run.failure_displacement)):
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
    if campaign.shaking is not None:
        peak = float(np.abs(campaign.shaking.acceleration).max())
        loads.append(
            f"a record of {float(campaign.shaking.duration):g} s shakes the base, with a peak of {peak:.3g} m/s2"
        )
    if run.strength_factor != 1:
        loads.append(f"all strength is multiplied by {run.strength_factor:g}")
    if level is not None:
        loads.append(f"each sample has its own water level, of mean {level.mean:g} m and deviation {level.sd:g} m")
    if campaign.seepage is not None:
        source = "rain" if campaign.drawdown is None else "drawdown"
        loads.append(
            f"each slope rests under the pore pressure of its {source} at {campaign.seepage.moment / 3600:g} h, which "
            "its soil carries along as it slides"
        )
    return loads


def _other_face(campaign: Campaign) -> list[str]:
    """Name a face of a section on the other side of its crest than the toe."""
    shape = campaign.site.shape
    if campaign.dimension == 3 or shape.face is None:
        return []
    rear = shape.corner[0] if shape.face.downhill == 1 else shape.corner[0] + shape.extent[0]
    z = shape.heights(np.linspace(rear, shape.face.toe_x, 1025))
    crest = int(np.flatnonzero(z == z.max())[-1])
    fall = float(z[crest] - z[: crest + 1].min())
    if fall < SECOND_FACE * shape.face.height:
        return []
    return [
        f"the ground falls by {fall:.3g} m on the other side of its crest too. A slide there is a failure, and its "
        "run-out is 0, since run-out counts soil beyond the toe alone"
    ]


def walls_reached(grid: str, rows: Rows) -> list[str]:
    """Name the walls that slides have reached.

    Args:
        grid: of the runs, "rough" or "refined".
        rows: of it.
    """
    reached = [wall for walls in rows.columns.get("walls", ()) for wall in str(walls).split("; ") if wall]
    return [
        f"the slide reached {wall if wall == EDGE else f'the wall at {wall}'}, which held it, in {count} "
        f"{grid} run{'s' if count > 1 else ''}: "
        f"{'draw it farther out' if wall == EDGE else 'lengthen the ground'} there"
        for wall, count in sorted(Counter(reached).items())
    ]
