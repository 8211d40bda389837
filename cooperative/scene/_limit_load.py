"""Failure by the limit load: the displacement from which on the slope of median soil is beyond its limit load.

A displacement of 1 m is no failure where soil does not soften: such a slope slides a little and stands again. At its
limit load the displacement of the slope of median soil turns upwards with the reduction factor, or jumps. The geometric
mean of its displacements a little below and above that factor is the failure displacement of all samples, so that this
slope's factor of safety by displacement is that of its limit load.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

from cooperative.scene._campaign import Campaign, LimitLoad, check_failure
from cooperative.scene._kept import Grid, Kept, factors_at_once
from cooperative.scene._schema import LIMIT_LOAD
from jaxmpm import Scene, Settle, State, diagnostics, factor_of_safety, reduced, solve

KEPT = Kept("limit_load", LIMIT_LOAD, LimitLoad, "limit load")

SHARE = 0.05
"""Least volume that counts as a failure where the scene does not say, over the height of the slope to the power of the
dimensions."""

BESIDE = 0.02
"""How far below and above the factor of the limit load displacements are taken, over that factor."""


def measured_limit_load(campaign: Campaign, folder: Path, refined: Grid) -> LimitLoad:
    """The limit load kept in `limit_load.json` of the campaign's folder, measured and written there at first.

    Raises ValueError for a file that holds something else, or a slope whose displacement shows no limit load between
    factors of 0.5 and 3.
    """
    return KEPT.once(folder, lambda: measure_limit_load(campaign, refined))


def at_limit_load(campaign: Campaign, found: LimitLoad) -> Campaign:
    """The scene with this limit load in it, in its text too, so that whoever reads the text has it.

    Raises ValueError where the failure displacement does not go with the rest of the scene.
    """
    settle = campaign.run.settle
    if settle is not None and settle.slides is not None:
        settle = replace(settle, slides=found.displacement)
    run = replace(campaign.run, failure_displacement=found.displacement, least_volume=found.volume, settle=settle)
    ready = replace(campaign, text=KEPT.in_text(campaign.text, found), run=run, limit_load=found)
    check_failure(ready)
    return ready


def measure_limit_load(campaign: Campaign, refined: Grid) -> LimitLoad:
    """The limit load of the slope of median soil, by strength reduction."""
    scene, state = refined.median
    t_end, volume = campaign.run.t_end, campaign.run.least_volume
    if volume is None:
        volume = float(f"{SHARE * campaign.site.height**campaign.dimension:.3g}")
    found = factor_of_safety(
        scene, state, criterion="limit load", t_end=t_end, batch=factors_at_once(), least_volume=volume
    )
    assert found.kink is not None
    below, above = (
        _displacement(reduced(scene, factor), state, t_end, volume)
        for factor in (found.kink * (1 - BESIDE), found.kink * (1 + BESIDE))
    )
    return LimitLoad(found.kink, float(f"{math.sqrt(below * above):.3g}"), volume)


def _displacement(scene: Scene, state: State, t_end: float, volume: float) -> float:
    """Displacement (m) that a volume of soil has exceeded by the end of a run."""
    result = solve(scene, state, t_end=t_end, settle=Settle(), least_volume=volume).raise_if_failed()
    return float(diagnostics.exceeded_displacement(scene, result.state, volume))
