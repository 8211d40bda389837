"""Failure by the limit load: the displacement from which on the slope of mean soil is beyond its limit load.

A displacement of 1 m is no failure where soil does not soften: such a slope slides a little and stands again. At its
limit load the displacement of the slope of mean soil turns upwards with the reduction factor, or jumps. The geometric
mean of its displacements a little below and above that factor is the failure displacement of all samples, so that this
slope's factor of safety by displacement is that of its limit load.
"""

from __future__ import annotations

import json
import math
import os
from dataclasses import asdict, replace
from pathlib import Path

import jax

from cooperative.scene._schema import LIMIT_LOAD, read
from cooperative.scene._typed import Campaign, LimitLoad, check_failure
from cooperative.store import MOST_TEXT, write_aside
from foundation import files
from jaxmpm import Scene, Settle, State, diagnostics, factor_of_safety, reduced, solve

KEPT = "limit_load.json"

BESIDE = 0.02
"""How far below and above the factor of the limit load displacements are taken, over that factor."""


def measured_limit_load(campaign: Campaign, folder: Path, scene: Scene, state: State) -> LimitLoad:
    """The limit load kept in `limit_load.json` of the campaign's folder, measured and written there at first.

    scene, state: of the refined grid at rest, with mean soil. Raises ValueError for a file that holds something else,
    or a slope whose displacement shows no limit load between factors of 0.5 and 3.
    """
    path = folder / KEPT
    if not os.path.lexists(path):
        write_aside(path, json.dumps(asdict(measure_limit_load(campaign, scene, state))).encode())
    return kept_limit_load(folder)


def kept_limit_load(folder: Path) -> LimitLoad:
    """The limit load in `limit_load.json`, checked as that of a scene is. Raises ValueError where it is damaged,
    OSError where it is missing."""
    path = folder / KEPT
    try:
        found = LimitLoad(**read("limit_load", json.loads(files.read_plain(path, MOST_TEXT)), LIMIT_LOAD))
        found.check()
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path} holds no limit load ({error}): delete it to measure it again") from error
    return found


def at_limit_load(campaign: Campaign, found: LimitLoad) -> Campaign:
    """The scene with this limit load in it, in its text too, so that whoever reads the text has it.

    Raises ValueError where the failure displacement does not go with the rest of the scene.
    """
    numbers = "".join(f"{name} = {value!r}\n" for name, value in asdict(found).items())
    settle = campaign.run.settle
    if settle is not None and settle.slides is not None:
        settle = replace(settle, slides=found.displacement)
    run = replace(campaign.run, failure_displacement=found.displacement, settle=settle)
    ready = replace(campaign, text=f"{campaign.text}\n[limit_load]\n{numbers}", run=run, limit_load=found)
    check_failure(ready)
    return ready


def measure_limit_load(campaign: Campaign, scene: Scene, state: State) -> LimitLoad:
    t_end = campaign.run.t_end
    # On CPU lanes run in turn, and bisection takes the fewest; elsewhere a batch costs as much time as one.
    batch = 2 if jax.default_backend() == "cpu" else 8
    found = factor_of_safety(scene, state, criterion="limit load", t_end=t_end, batch=batch)
    assert found.kink is not None
    moved = [
        float(
            diagnostics.largest_displacement(
                solve(reduced(scene, factor), state, t_end=t_end, settle=Settle()).raise_if_failed().state
            )
        )
        for factor in (found.kink * (1 - BESIDE), found.kink * (1 + BESIDE))
    ]
    return LimitLoad(found.kink, float(f"{math.sqrt(moved[0] * moved[1]):.3g}"))
