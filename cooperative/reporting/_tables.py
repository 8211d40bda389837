"""A campaign in one file: a table for people, and one HDF5 file with every sample."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import h5py
import numpy as np

from cooperative.estimate import Estimator
from cooperative.runs import StoredGround, phases_of, rows_reader, samples_of
from cooperative.scene import Campaign, Given, campaign_of
from cooperative.store import GRIDS, Rows, Store, fill_sample, read_sample
from cooperative.summary import slides_of
from foundation import files
from foundation.files import write_aside


def write_table(
    store: Store,
    path: str | Path | None = None,
    *,
    ground: StoredGround | None = None,
    estimator: Estimator | None = None,
) -> Path:
    """Write one CSV line per finished sample and grid, `table.csv` in the campaign's folder by default.

    Columns: grid, sample, status, steps, seconds, then all scalars by name; empty where a sample has none. Refined runs
    also have `failed` (1 or 0, empty where the run broke off before it could tell), `weight`, the share of all samples
    that each stands for, whose sum over the failures is the probability of failure, and `slide_weight`, the same for
    what slides did: 0 for failures that did not slide on to their end, and the more for those that did.
    estimator: the one that `cooperative.campaign.run` was given, where it was given one; without it these three columns
    are left out, as nobody else knows what the runs stand for.
    ground: of the campaign, by which samples with arrays of other grids are damaged ones.
    Damaged files are left out; `read_rows` names them. OSError if the disk refuses.
    """
    path = store.folder / "table.csv" if path is None else Path(path)
    tables = tables_of(campaign_of(store, estimator), store, ground)
    names = list(dict.fromkeys(name for columns in tables.values() for name in columns))
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["grid", *names])
    for grid, columns in tables.items():
        for at in range(columns["sample"].size):
            writer.writerow([grid, *(_cell(columns.get(name), at) for name in names)])
    write_aside(path, text.getvalue().encode())
    return path


def tables_of(campaign: Campaign, store: Store, ground: StoredGround | None = None) -> dict[str, dict[str, np.ndarray]]:
    """Columns of each grid's rows by name, with what the refined runs stand for; see `write_table`."""
    read = rows_reader(store, samples_of(campaign), ground)
    rows = {grid: read(grid) for grid in GRIDS}
    tables = {grid: rows[grid].columns for grid in GRIDS}
    if not isinstance(campaign.estimator, Given):
        tables["refined"] = tables["refined"] | _standing_for(campaign, rows["rough"], rows["refined"])
    return tables


def _standing_for(campaign: Campaign, rough: Rows, refined: Rows) -> dict[str, np.ndarray]:
    """What each refined run stands for, and whether it failed (runs,) each."""
    phases = phases_of(campaign, rough, refined)
    answers, weights = phases.answers, phases.weights
    return {
        "failed": np.array([np.nan if answers[n] is None else float(answers[n] is True) for n in refined.numbers]),
        "weight": np.array([weights[n] for n in refined.numbers]),
        "slide_weight": slides_of(campaign, phases, refined).weight,
    }


def consolidate(store: Store, path: str | Path | None = None, *, ground: StoredGround | None = None) -> Path:
    """Write all verified samples into one HDF5 file, `campaign.h5` in the campaign's folder by default.

    The scene is the attribute `scene`; each sample is a group `rough/000123` or `refined/000123` with what was read of
    its own file; `tables/rough/...` are the columns of the rows. One sample is in memory at a time. ground: as for
    `write_table`. OSError if the disk refuses; what was there before stays.
    """
    path = store.folder / "campaign.h5" if path is None else Path(path)
    read = rows_reader(store, samples_of(campaign_of(store)), ground)
    with files.hdf5_aside(path) as file:
        file.attrs["scene"] = store.source.words
        for grid in GRIDS:
            rows = read(grid)
            for name, values in rows.columns.items():
                text = values.dtype.kind == "U"
                file[f"tables/{grid}/{name}"] = values.astype(h5py.string_dtype()) if text else values
            for number in rows.numbers:
                fill_sample(file.create_group(f"{grid}/{number:06d}"), store, grid, read_sample(store, grid, number))
    return path


def _cell(column: np.ndarray | None, at: int) -> object:
    if column is None:
        return ""
    value = column[at].item()
    return "" if isinstance(value, float) and np.isnan(value) else value
