"""Hazard maps of a campaign: how likely soil reaches a place, how thick and how fast it is there, and when it comes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cooperative import effects, runs, summary
from cooperative.estimate import Chances, Estimate, Estimator, chance_of, mean_interval, mean_of
from cooperative.measure import ColumnPlan
from cooperative.scene import Campaign, campaign_of
from cooperative.store import GRIDS, Rows, Store, read_sample, read_store

REACHED, COVERED, THICKNESS, ARRIVAL = "reached", "covered at the end", "expected thickness", "arrival"


@dataclass(frozen=True)
class Maps:
    """Maps over the columns of cells with ground in them, (nx,) in a section and (nx, ny) in 3D.

    plan: where the columns stand. edges: of those that are mapped, along each axis (m). maps: by name, each with its
    pointwise interval: probabilities (reached, covered at the end, deposit thicker than a threshold, ever faster than
    one), the expected thickness of the deposit over all samples (m), and the mean time of arrival of those slides that
    come (s), nan where none does. units: of each. beyond: the mapped columns along x that lie beyond the toe. slides:
    that the maps are made from. least: thickness from which on soil counts as there (m). every: seconds between two
    looks. missed: how far the fastest soil went between two looks (m). level: of the intervals. moving: slides that had
    not come to rest at their end, `until` (s): all maps are then at least what is given.
    """

    plan: ColumnPlan
    edges: tuple[np.ndarray, ...]
    maps: Mapping[str, Chances]
    units: Mapping[str, str]
    beyond: slice
    slides: int
    least: float
    every: float
    missed: float
    level: float = 0.95
    moving: int = 0
    until: float = np.inf


def hazard_maps(folder: str | Path, *, estimator: Estimator | None = None) -> Maps:
    """The maps of a campaign's folder, of what has run by now.

    estimator: the one that `cooperative.campaign.run` was given, where it was given one.
    Raises ValueError where the scene asks for no maps, or no refined run has slid to its end.
    """
    store = read_store(folder)
    campaign = campaign_of(store, estimator)
    model = runs.build(campaign, "refined", runs.random_soil(campaign), at_rest=False)
    rough, refined = map(runs.rows_reader(campaign, store), GRIDS)
    found = maps_of(campaign, store, model, rough, refined)
    if found is None:
        raise ValueError(
            f"folder {folder} has no hazard maps: give [hazard] in the scene of another campaign"
            if campaign.hazard is None
            else f"folder {folder} has no refined run yet that failed and slid to its end: wait for one"
        )
    return found


def maps_of(campaign: Campaign, store: Store, model: runs.GridModel, rough: Rows, refined: Rows) -> Maps | None:
    """The maps of these rows; None where the scene asks for none, or nothing slid. model: of the refined grid."""
    if campaign.hazard is None or (kept := model.state.columns) is None:
        return None
    phases = runs.phases_of(campaign, rough, refined)
    slides = summary.slides_of(campaign, phases, refined)
    # A slide that broke off has no columns.
    told = np.isfinite(refined.columns.get("area_columns", np.full(len(refined.numbers), np.nan)))
    mine = np.flatnonzero(slides.slid & (slides.weight > 0) & told)
    samples = [read_sample(store, "refined", refined.numbers[at]) for at in mine]
    if not samples:
        return None
    plan = runs.column_plan(model.scene)
    where = plan.ground
    fields = {name: np.stack([sample.fields[name] for sample in samples])[:, *where] for name in runs.COLUMNS}
    step = float(model.scene.time_step) * kept.every
    first = int(np.searchsorted(plan.edges(0)[where[0]], plan.edges(0)[runs.beyond_toe(model, plan).start]))
    maps, units = _maps(campaign, phases.estimate, slides.weight[mine], fields, kept.least)
    return Maps(
        plan=plan,
        edges=tuple(plan.edges(axis)[part.start : part.stop + 1] for axis, part in enumerate(where)),
        maps=maps,
        units=units,
        beyond=slice(first, None),
        slides=mine.size,
        least=kept.least,
        every=step,
        missed=step * float(fields["column_speed"].max()),
        level=phases.estimate.level,
        moving=effects.cut_off(campaign, refined, slides).at_t_end,
        until=campaign.run.last("refined"),
    )


def _maps(
    campaign: Campaign, found: Estimate, weight: np.ndarray, fields: Mapping[str, np.ndarray], least: float
) -> tuple[dict[str, Chances], dict[str, str]]:
    deposit, thickness, speed, arrival = (fields[name] for name in runs.COLUMNS)
    hazard = campaign.hazard
    assert hazard is not None
    happens = {REACHED: thickness >= least, COVERED: deposit >= least}
    happens |= {f"deposit thicker than {level:g} m": deposit > level for level in hazard.thickness}
    happens |= {f"faster than {level:g} m/s": speed > level for level in hazard.speed}
    maps = {name: chance_of(found, weight, each) for name, each in happens.items()}
    maps[THICKNESS] = mean_of(found, weight, deposit)
    maps[ARRIVAL] = _arrival(arrival, weight, found.level, campaign.run.last("refined"))
    return maps, dict.fromkeys(happens, "-") | {THICKNESS: "m", ARRIVAL: "s"}


def _arrival(arrival: np.ndarray, weight: np.ndarray, level: float, until: float) -> Chances:
    """Mean time of arrival in each column, over the slides that come, with the interval of a mean, which holds no time
    after the end of the runs, `until` (s)."""
    came = np.isfinite(arrival)
    share = came * weight.reshape(-1, *[1] * (arrival.ndim - 1))
    total = share.sum(axis=0)
    some = total > 0
    value = np.where(some, np.where(came, arrival * share, 0).sum(axis=0) / np.where(some, total, 1), np.nan)
    low, high = np.full(value.shape, np.nan), np.full(value.shape, np.nan)
    for at in np.argwhere(some):
        here = (slice(None), *at)
        interval = mean_interval(arrival[here][came[here]], weight[came[here]], level=level)
        if interval is not None:
            low[tuple(at)], high[tuple(at)] = interval[0], max(min(interval[1], until), value[tuple(at)])
    return Chances(value, low, high, came.sum(axis=0))
