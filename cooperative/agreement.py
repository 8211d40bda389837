"""How well the two grids of a campaign agree."""

from __future__ import annotations

import numpy as np

from cooperative.estimate import Correlation, Phases, correlation
from cooperative.scene import Campaign
from cooperative.store import Rows


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

    Runs that ended once they had failed, or broke off, would have moved farther, so nothing tells which of those beyond
    the least of them moved farthest: they are all alike.
    """
    at = np.isin(rows.numbers, numbers)
    moved, cut = rows.columns["displacement"][at], (~rows.ended | rows.columns["broke_off"].astype(bool))[at]
    return np.minimum(moved, moved[cut].min(initial=np.inf))
