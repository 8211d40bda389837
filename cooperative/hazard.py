"""Hazard maps of a campaign: how likely soil reaches a column, how thick and fast it is there, and when it arrives."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cooperative import runs
from cooperative.estimate import LEVEL, Chances, Estimate, Estimator, chance_of, mean_interval, mean_of
from cooperative.folder import Results, read_results
from cooperative.measure import ColumnPlan
from cooperative.store import read_sample

REACHED, COVERED, THICKNESS, ARRIVAL = "reached", "covered at the end", "expected thickness", "arrival"
CARRIED = "ground carried away"


@dataclass(frozen=True)
class HazardMaps:
    """Maps over the columns of cells with ground in them, (nx,) in a section and (nx, ny) in 3D.

    All but that of the ground that is carried away are of the soil that lies or moves above the surface that was there
    before.

    Args:
        plan: where the columns stand.
        edges: of those that are mapped, along each axis (m).
        maps: by name, each with its pointwise interval: probabilities (reached, covered at the end, deposit thicker
            than a threshold, ever faster than one, ground carried away by the failure displacement or more), the
            expected thickness of the deposit over all samples (m), and the mean time of arrival of those slides that
            come (s), nan where none does.
        units: of each.
        beyond: the mapped columns along x that lie beyond the toe.
        slides: that the maps are made from.
        least: thickness from which on soil counts as there (m).
        every: seconds between two looks.
        missed: how far the fastest soil went between two looks (m).
        level: of the intervals.
        moving: slides that had not come to rest at their end; all maps are then least values.
        until: latest end of a slide (s).
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
    level: float = LEVEL
    moving: int = 0
    until: float = np.inf


def hazard_maps(folder: str | Path, *, estimator: Estimator | None = None) -> HazardMaps:
    """The maps of a campaign's folder, of what has run by now.

    Args:
        folder: of the campaign.
        estimator: the one that `cooperative.campaign.run` was given, where it was given one.

    Raises:
        ValueError: the scene asks for no maps, or no refined run has slid to its end.
    """
    results = read_results(folder, estimator)
    maps = maps_of(results)
    if maps is None:
        raise ValueError(
            f"folder {folder} has no hazard maps: give [hazard] in the scene of another campaign"
            if results.ground.hazard is None
            else f"folder {folder} has no refined run yet that failed and slid to its end: wait for one"
        )
    return maps


def maps_of(results: Results) -> HazardMaps | None:
    """The maps of these results; None where the scene asks for none, or nothing slid.

    Args:
        results: of a campaign.
    """
    hazard, grid, rows, pf = results.ground.hazard, results.grid, results.finest, results.summary.probability
    if hazard is None:
        return None
    # A slide that broke off has no columns.
    with_columns = np.isfinite(rows.columns.get("area_columns", np.full(len(rows.numbers), np.nan)))
    slid = np.flatnonzero((results.weight > 0) & with_columns)
    samples = [read_sample(results.store, grid, rows.numbers[at]) for at in slid]
    if not samples:
        return None
    plan = results.ground.grids[grid].columns
    where, beyond = plan.ground, plan.beyond(results.ground.face)
    fields = {name: np.stack([sample.fields[name] for sample in samples])[:, *where] for name in runs.COLUMNS}
    first, last = (max(at - where[0].start, 0) for at in (beyond.start, beyond.stop))
    cut = results.summary.consequences.cut_off
    weight = results.weight[slid]
    maps, units = _maps(hazard, pf.estimate, weight, fields, cut.t_end)
    if all(runs.GROUND_MOVED in sample.fields for sample in samples):
        ground = np.stack([sample.fields[runs.GROUND_MOVED] for sample in samples])[:, *where]
        maps[CARRIED], units[CARRIED] = (
            chance_of(pf.estimate, weight, ground >= pf.failure_displacement),
            "-",
        )
    return HazardMaps(
        plan=plan,
        edges=tuple(plan.edges(axis)[part.start : part.stop + 1] for axis, part in enumerate(where)),
        maps=maps,
        units=units,
        beyond=slice(first, last),
        slides=slid.size,
        least=hazard.least,
        every=hazard.every,
        missed=hazard.every * float(fields["column_speed"].max()),
        level=pf.level,
        moving=cut.at_t_end,
        until=cut.t_end,
    )


def _maps(
    hazard: runs.HazardPlan, estimate: Estimate, weight: np.ndarray, fields: Mapping[str, np.ndarray], until: float
) -> tuple[dict[str, Chances], dict[str, str]]:
    deposit, thickness, speed, arrival = (fields[name] for name in runs.COLUMNS)
    happens = {REACHED: thickness >= hazard.least, COVERED: deposit >= hazard.least}
    happens |= {f"deposit thicker than {level:g} m": deposit > level for level in hazard.thickness}
    happens |= {f"faster than {level:g} m/s": speed > level for level in hazard.speed}
    maps = {name: chance_of(estimate, weight, true) for name, true in happens.items()}
    maps[THICKNESS] = mean_of(estimate, weight, deposit)
    maps[ARRIVAL] = _arrival(arrival, weight, estimate.level, until)
    return maps, dict.fromkeys(happens, "-") | {THICKNESS: "m", ARRIVAL: "s"}


def _arrival(arrival: np.ndarray, weight: np.ndarray, level: float, until: float) -> Chances:
    """Mean time of arrival in each column, over the slides that arrive.

    Its interval is that of a mean and holds no time after the end of the runs, `until` (s).
    """
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
