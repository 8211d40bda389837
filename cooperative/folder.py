"""What a campaign's folder holds, read once: ground, rows and summary.

Its scene is read only where one is missing.
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from cooperative import runs
from cooperative.estimate import Estimator
from cooperative.measure import SEVERITY
from cooperative.names import DRAWN_SLIDES
from cooperative.scene import Campaign, FromScript, campaign_of, rested
from cooperative.store import (
    GRIDS,
    IN_TIME,
    Rows,
    Scalar,
    Store,
    contents_sum,
    read_sample,
    read_store,
    store_text,
    stored_text,
)
from cooperative.store import (
    SUMMARY as STORED,
)
from cooperative.summary import Summary, summarise
from jaxmpm.support import files

SUMMARY = "summary.json"
"""The summary as a file, for other programs; the one in the database is read."""
MADE_FROM = "made_from"
"""Key of a summary in the database that has the checksum of what else is there."""


@dataclass(frozen=True)
class Results:
    """Results of a campaign.

    Args:
        store: the campaign's folder.
        ground: of the campaign.
        rough: rows of the rough grid.
        refined: rows of the refined grid.
        summary: of these rows.
        left_out: what is there and does not count, and why.
    """

    store: Store
    ground: runs.StoredGround
    rough: Rows
    refined: Rows
    summary: Summary
    left_out: tuple[str, ...] = ()

    def slides_to_draw(self, most: int = DRAWN_SLIDES) -> tuple[str, list[int]]:
        """Grid and numbers of the samples that a report draws.

        These are the farthest of each failure mode that occurs, then the next farthest; where nothing failed, the one
        with the largest displacement.
        """
        grid, rows, failed = self.grid, self.finest, self.slid
        displacement = rows.columns["displacement"]
        modes = rows.columns.get("mode", np.full(displacement.size, ""))
        order = np.argsort(-displacement, kind="stable").tolist()
        if not failed.any():
            return grid, [rows.numbers[order[0]]]
        falls = [at for at in order if failed[at]]
        leaders = [next((at for at in falls if modes[at] == mode), None) for mode in SEVERITY]
        chosen = dict.fromkeys([falls[0], *(at for at in leaders if at is not None), *falls])
        return grid, [rows.numbers[at] for at in list(chosen)[: max(most, 1)]]

    def soils(self, most: int = DRAWN_SLIDES) -> list[tuple[str, int]]:
        """Grid and sample of each random soil that a report draws: of the first sample on both grids."""
        grid, (first, *others) = self.slides_to_draw(most)
        return [*((name, first) for name in GRIDS), *((grid, number) for number in others)]

    @property
    def grid(self) -> str:
        """The finest grid with runs."""
        return "refined" if self.refined.numbers else "rough"

    @property
    def finest(self) -> Rows:
        """Rows of that grid."""
        return self.refined if self.refined.numbers else self.rough

    @property
    def weight(self) -> np.ndarray:
        """What each of these runs stands for as a slide (runs,), 0 for those that did not slide to their end."""
        return np.array([self.summary.consequences.weights.get(number, 0.0) for number in self.finest.numbers], float)

    @property
    def slid(self) -> np.ndarray:
        """Those that failed and have consequences: they slid to their end (runs,) bool."""
        slid = np.array([number in self.summary.consequences.weights for number in self.finest.numbers], bool)
        return slid & ~self.finest.columns.get("broke_off", np.zeros(slid.size)).astype(bool)


def read_results(folder: str | Path, estimator: Estimator | None = None) -> Results:
    """Read a campaign's folder.

    Args:
        folder: of the campaign; it may be running.
        estimator: the one that `cooperative.campaign.run` was given, where it was given one.

    Raises:
        ValueError: the folder holds no campaign, no finished sample, or that of another estimator.
    """
    store = read_store(folder)
    campaign = None if estimator is None else campaign_of(store, estimator)
    ground = stored_ground(store)
    if ground is None:
        campaign = campaign or campaign_of(store)
        ground = runs.ground_of(models_of(campaign))
    rough, refined = map(runs.rows_reader(store, ground.samples, ground), GRIDS)
    if stored_text(store.folder, IN_TIME) is not None:
        return _slides_in_time(store, ground, rough, refined)
    if not rough.numbers:
        raise ValueError(f"folder {folder} has no finished sample yet: start the run first")
    left_out = [f"{why}: will be run again" for rows in (rough, refined) for why in rows.damaged]
    refined, without = _paired(refined, rough)
    left_out += [f"refined run {number} has no rough run beside it: resume the campaign" for number in without]
    summary = _stored(store, rough, refined) or summarise(campaign or campaign_of(store), rough, refined)
    return Results(store, ground, rough, refined, summary, tuple(left_out))


def _slides_in_time(store: Store, ground: runs.StoredGround, rough: Rows, refined: Rows) -> Results:
    """Slides of samples that were asked in time, whose summary their answers give."""
    summary = _stored(store, rough, refined)
    if summary is None:
        raise ValueError(
            f"folder {store.folder} has no slide of all samples that fail in time: `jaxmpm resume {store.folder}` goes "
            "on with them; where none fails there is nothing to show, and a chart has no slides"
        )
    return Results(store, ground, rough, refined, summary)


def known_summary(store: Store, rows: Mapping[str, Rows], estimator: Estimator | None = None) -> Summary | None:
    """The summary of a campaign's rows; None before the first rough one.

    It is None too where the folder stores none and only a script's estimator, which is not given, can weigh the rows,
    or where these are slides of samples asked in time, not all of which have ended.

    Args:
        store: the campaign's folder.
        rows: of both grids.
        estimator: of the script, where one gave it.
    """
    if stored_text(store.folder, IN_TIME) is not None:
        return _stored(store, *rows.values())
    rough, (refined, _) = rows["rough"], _paired(rows["refined"], rows["rough"])
    if not rough.numbers:
        return None
    if (stored := _stored(store, rough, refined)) is not None:
        return stored
    campaign = campaign_of(store, estimator)
    return None if isinstance(campaign.estimator, FromScript) else summarise(campaign, rough, refined)


def write_results(results: Results, models: Mapping[str, runs.GridModel]) -> None:
    """Write the summary of a campaign, and the random soil that a report draws.

    Args:
        results: of the campaign.
        models: both grids by name.

    Raises:
        OSError: the disk refuses.
    """
    store, fields = results.store, results.summary.as_json()
    store_text(store, STORED, json.dumps({MADE_FROM: contents_sum(store), **fields}))
    files.write_aside(store.folder / SUMMARY, json.dumps(fields, indent=1).encode())
    grid, _ = results.slides_to_draw()
    coefficients = {run: read_sample(store, grid, run[1]).coefficients for run in results.soils()}
    # A run that was given up has no coefficients.
    soils = {run: runs.soil_of(models[run[0]], xi) for run, xi in coefficients.items() if xi.size}
    runs.keep_drawn(store.folder, soils)


def _stored(store: Store, *grids: Rows) -> Summary | None:
    """The summary that the database holds, None where it is not of just what else is there."""
    if any(rows.damaged for rows in grids):
        return None
    try:
        text = stored_text(store.folder, STORED)
        if text is not None and json.loads(text)[MADE_FROM] == contents_sum(store):
            return Summary.from_json(text)
    except (ValueError, TypeError, KeyError, RecursionError):
        pass  # of another version, or damaged: the rows give it again
    return None


def models_of(campaign: Campaign) -> dict[str, runs.GridModel]:
    """Both grids of a campaign, free of stress: to be looked at, not run.

    Args:
        campaign: the campaign.
    """
    soil = runs.random_soil(campaign)
    return {grid: runs.build(campaign, grid, soil, at_rest=False) for grid in GRIDS}


def model_of(campaign: Campaign, grid: str, failed_at: Scalar | None, folder: Path | None = None) -> runs.GridModel:
    """A grid of a campaign as a stored run began on it, at rest.

    Args:
        campaign: the campaign.
        grid: "rough" or "refined".
        failed_at: FAILED_AT of the run, a slide in time: it rests under the pressure of that time. None for others.
        folder: of the campaign, which may have the stress at rest.
    """
    campaign = campaign if failed_at is None else rested(campaign, float(failed_at))
    return runs.build(campaign, grid, runs.random_soil(campaign), folder=folder)


def stored_ground(store: Store) -> runs.StoredGround | None:
    """The ground that a folder keeps; a warning names a file that is damaged.

    Args:
        store: the campaign's folder.
    """
    try:
        return runs.read_ground(store.folder)
    except files.DamagedFile as error:
        warnings.warn(f"{error}: the ground is built again", stacklevel=3)
        return None


def _paired(refined: Rows, rough: Rows) -> tuple[Rows, list[int]]:
    """The refined runs whose rough runs are there, and the numbers of the others: nobody knows where those rank."""
    there = np.isin(refined.columns["sample"], rough.columns["sample"])
    columns = {name: values[there] for name, values in refined.columns.items()}
    return replace(refined, columns=columns), refined.columns["sample"][~there].tolist()
