"""Making the rough grid fail as easily as the refined one: its strength times the ratio of their factors of safety.

A rough grid is stiffer and stands where the refined one fails. The factors are those of the homogeneous slope of mean
strength, by strength reduction, and cost some ten runs on each grid.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path

import jax

from cooperative.estimate import Estimator
from cooperative.scene._budget import kept_budget, raised
from cooperative.scene._limit_load import KEPT as LIMIT_LOAD_KEPT
from cooperative.scene._limit_load import at_limit_load, kept_limit_load
from cooperative.scene._schema import CALIBRATION, read
from cooperative.scene._typed import Calibration, Campaign, built, parse
from cooperative.store import MOST_TEXT, Store, write_aside
from foundation import files
from jaxmpm import Scene, State, factor_of_safety

KEPT = "calibration.json"


Grids = Mapping[str, tuple[Scene, State]]
"""Both grids by name, at rest."""


def measure(campaign: Campaign, grids: Grids | None = None) -> Calibration:
    """Factors of safety of the scene's slope with its mean strength everywhere, on both grids, which are built if not
    given.

    Raises ValueError where a factor lies outside 0.5 to 3.
    """
    grids = grids or {grid: built(campaign, grid) for grid in ("rough", "refined")}
    return Calibration(**{grid: _factor_of_safety(campaign, *at_rest) for grid, at_rest in grids.items()})


def measured(campaign: Campaign, folder: Path, grids: Grids | None = None) -> Calibration:
    """Factors of safety kept in `calibration.json` of the campaign's folder, measured and written there at first.

    Raises ValueError for a file that holds something else.
    """
    path = folder / KEPT
    if not os.path.lexists(path):
        found = measure(campaign, grids)
        write_aside(path, json.dumps({"rough": found.rough, "refined": found.refined}).encode())
    return kept(folder)


def kept(folder: Path) -> Calibration:
    """Factors of safety in `calibration.json`, checked as those of a scene are. Raises ValueError where it is damaged,
    OSError where it is missing."""
    path = folder / KEPT
    try:
        found = Calibration(**read("calibration", json.loads(files.read_plain(path, MOST_TEXT)), CALIBRATION))
        for grid, factor in asdict(found).items():
            if not 0 < factor < float("inf"):
                raise ValueError(f"{grid} = {factor:g}: give a finite value above 0")
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path} holds no two factors of safety ({error}): delete it to measure them again") from error
    return found


def calibrated(campaign: Campaign, found: Calibration) -> Campaign:
    """The scene with these factors in it, in its text too, so that whoever reads the text has them."""
    table = f"\n[calibration]\nrough = {found.rough!r}\nrefined = {found.refined!r}\n"
    return replace(campaign, text=campaign.text + table, calibration=found)


def campaign_of(store: Store, estimator: Estimator | None = None) -> Campaign:
    """The scene of a campaign's folder, with its factors of safety where they were measured, and the refined runs that
    were allowed since.

    estimator: that of the script, where one gave it.
    """
    campaign, budget = parse(store.scene_text, estimator), kept_budget(store.folder)
    if budget is not None and campaign.plan.estimator is not None:
        campaign = raised(campaign, budget)
    asked = campaign.run.failure == "limit load" and campaign.limit_load is None
    if asked and os.path.lexists(store.folder / LIMIT_LOAD_KEPT):
        campaign = at_limit_load(campaign, kept_limit_load(store.folder))
    wants = campaign.plan.calibrate and campaign.calibration is None and os.path.lexists(store.folder / KEPT)
    return calibrated(campaign, kept(store.folder)) if wants else campaign


def _factor_of_safety(campaign: Campaign, scene: Scene, state: State) -> float:
    # On CPU lanes run in turn, and bisection takes the fewest; elsewhere a batch costs as much time as one.
    batch = 2 if jax.default_backend() == "cpu" else 8
    return factor_of_safety(
        scene, state, failure_displacement=campaign.run.failure_displacement, t_end=campaign.run.t_end, batch=batch,
        settle=campaign.run.settle,
    ).stable  # fmt: skip
