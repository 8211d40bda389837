"""Notes of a summary: what limits its numbers, in sentences."""

from __future__ import annotations

from collections import Counter

import numpy as np

from cooperative.estimate import Phases, Slides
from cooperative.measure import EDGE
from cooperative.risk import CutOff
from cooperative.scene import Campaign
from cooperative.store import Rows

NEAR_FAILURE = 0.2
"""Share of the failure displacement from which a standing slope is close to failure."""


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
            f"of median soil at its limit load (factor of safety {load.factor:.3f})"
        )
    notes += [*phases.estimate.notes, *walls_reached(rough, refined)]
    if campaign.raised is not None:
        allowed = campaign.raised
        notes.append(f"the folder allows {allowed.refined_runs} refined runs, the scene {allowed.scene}")
    notes += slides.notes
    if cut.at_t_end:
        how = "had not come to rest" if run.settle else "were not looked at for rest (settle = false)"
        notes.append(
            f"{cut.at_t_end} of {cut.of} slides {how} when they ended at {cut.t_end:g} s, so their "
            "consequences are least values. A later [run] slides_t_end lets slides run on"
        )
    if cut.broke_off:
        notes.append(
            f"{cut.broke_off} of {cut.of} slides broke off. Their displacement is a least value, and they have no "
            "part in the other consequences"
        )
    stands = np.array([phases.answers[number] is False for number in refined.numbers], bool)
    displacement, status = refined.columns.get("displacement", np.zeros(0)), refined.columns["status"]
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
    return tuple(notes)


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
