"""Making the rough grid fail as easily as the refined one: its strength times the ratio of their factors of safety.

A rough grid is stiffer and stands where the refined one fails. The factors are those of the slope of median soil, by
strength reduction, and cost some ten runs on each grid.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from cooperative.estimate import Estimator
from cooperative.scene._budget import kept_budget, raised
from cooperative.scene._campaign import Calibration, Campaign
from cooperative.scene._field_modes import with_kept_field_modes
from cooperative.scene._kept import Grid, Kept, factors_at_once
from cooperative.scene._limit_load import KEPT as LIMIT_LOAD_KEPT
from cooperative.scene._limit_load import at_limit_load
from cooperative.scene._schema import CALIBRATION
from cooperative.scene._typed import parse
from cooperative.store import Store
from jaxmpm import Scene, State, factor_of_safety

KEPT = Kept("calibration", CALIBRATION, Calibration, "two factors of safety")

Grids = Mapping[str, Grid]
"""Both grids by name."""


def measure(campaign: Campaign, grids: Grids) -> Calibration:
    """Factors of safety of the slope of median soil. Raises ValueError where one lies outside 0.5 to 3."""
    return Calibration(**{grid: _factor_of_safety(campaign, *model.median) for grid, model in grids.items()})


def measured(campaign: Campaign, folder: Path, grids: Grids) -> Calibration:
    """Factors of safety kept in `calibration.json` of the campaign's folder, measured and written there at first.

    Raises ValueError for a file that holds something else.
    """
    return KEPT.once(folder, lambda: measure(campaign, grids))


def kept(folder: Path) -> Calibration:
    """Factors of safety in `calibration.json`, checked as those of a scene are. Raises ValueError where it is damaged,
    OSError where it is missing."""
    return KEPT.read(folder)


def calibrated(campaign: Campaign, found: Calibration) -> Campaign:
    """The scene with these factors in it, in its text too, so that whoever reads the text has them."""
    return replace(campaign, text=KEPT.in_text(campaign.text, found), calibration=found)


def campaign_of(store: Store, estimator: Estimator | None = None) -> Campaign:
    """The scene of a campaign's folder, with the numbers that it keeps: modes of its fields, what was measured before
    its first run, and the refined runs that were allowed since.

    estimator: that of the script, where one gave it.
    """
    campaign, budget = parse(store.scene_text, estimator, begun=True), kept_budget(store.folder)
    if budget is not None and campaign.plan.estimator is not None:
        campaign = raised(campaign, budget)
    campaign = with_kept_field_modes(campaign, store.folder)
    asked = campaign.run.failure == "limit load" and campaign.limit_load is None
    if asked and (limit_load := LIMIT_LOAD_KEPT.there(store.folder)) is not None:
        campaign = at_limit_load(campaign, limit_load)
    asked = campaign.plan.calibrate and campaign.calibration is None
    if asked and (factors := KEPT.there(store.folder)) is not None:
        campaign = calibrated(campaign, factors)
    return campaign


def _factor_of_safety(campaign: Campaign, scene: Scene, state: State) -> float:
    return factor_of_safety(
        scene, state, failure_displacement=campaign.run.failure_displacement, t_end=campaign.run.t_end,
        batch=factors_at_once(), settle=campaign.run.settle, least_volume=campaign.run.least_volume,
    ).stable  # fmt: skip
