"""A campaign as a table."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from cooperative.estimate import Estimator
from cooperative.folder import known_summary, stored_ground
from cooperative.runs import StoredGround, rows_reader, samples_of
from cooperative.scene import campaign_of
from cooperative.store import GRIDS, Rows, Store
from cooperative.summary import Summary
from jaxmpm.support import files
from jaxmpm.support.text import csv_text


def write_table(
    store: Store,
    path: str | Path | None = None,
    *,
    ground: StoredGround | None = None,
    estimator: Estimator | None = None,
) -> Path:
    """Write one CSV line per finished sample and grid, `table.csv` in the campaign's folder by default.

    Columns: grid, sample, status, steps, seconds, then all scalars by name; empty where a sample has none. Refined runs
    also have `failed` (1 or 0, empty where the run broke off undecided), `weight`, the share of all samples
    that each stands for, whose sum over the failures is the probability of failure, and `slide_weight`, the same for
    what slides did: 0 for failures that did not slide on to their end, and the more for those that did.

    Args:
        store: of the campaign.
        path: of the file, None for `table.csv` in the campaign's folder.
        ground: of the campaign, by which runs of other soil are damaged ones; by default the folder's. Damaged runs are
            left out; `read_rows` names them.
        estimator: the one that `cooperative.campaign.run` was given, where it was given one; without it these three
            columns are left out where the folder has no summary of its rows, as nobody else knows what the runs stand
            for.

    Raises:
        OSError: the disk refuses.
    """
    path = store.folder / "table.csv" if path is None else Path(path)
    rows = read_grids(store, ground)
    tables = columns_by_grid(rows, known_summary(store, rows, estimator))
    names = list(dict.fromkeys(name for columns in tables.values() for name in columns))
    lines = [
        [grid, *(_cell(columns.get(name), at) for name in names)]
        for grid, columns in tables.items()
        for at in range(columns["sample"].size)
    ]
    files.write_aside(path, csv_text([["grid", *names], *lines]).encode())
    return path


def read_grids(store: Store, ground: StoredGround | None = None) -> dict[str, Rows]:
    """Verified rows of both grids.

    Where neither `ground` nor the folder holds the number of samples, it is that of the scene.
    """
    ground = ground or stored_ground(store)
    samples = samples_of(campaign_of(store)) if ground is None else ground.samples
    read = rows_reader(store, samples, ground)
    return {grid: read(grid) for grid in GRIDS}


def columns_by_grid(rows: Mapping[str, Rows], summary: Summary | None) -> dict[str, dict[str, np.ndarray]]:
    """Columns of each grid's rows by name, with what the refined runs stand for by this summary; see `write_table`."""
    tables = {grid: dict(rows[grid].columns) for grid in GRIDS}
    if summary is not None:
        stands_for = [summary.probability.stands_for.get(number) for number in rows["refined"].numbers]
        for name in ("failed", "weight", "slide_weight"):
            values = [None if run is None else getattr(run, name) for run in stands_for]
            tables["refined"][name] = np.array([np.nan if value is None else value for value in values], float)
    return tables


def _cell(column: np.ndarray | None, at: int) -> object:
    if column is None:
        return ""
    value = column[at].item()
    return "" if isinstance(value, float) and np.isnan(value) else value
