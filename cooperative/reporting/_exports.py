"""A campaign for other programs: a table, one HDF5 file, and series of particles for ParaView."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from cooperative.estimate import Estimator
from cooperative.reporting._pictures import end_of
from cooperative.reporting._tables import consolidate, write_table
from cooperative.runs import GridModel, build, foreign, random_soil, rows_reader
from cooperative.scene import campaign_of
from cooperative.store import GRIDS, Sample, Store, own_folder, read_sample, read_store, sample_path
from jaxmpm import Result, solve, write_particles, write_vtkhdf


def export(folder: str | Path, *, estimator: Estimator | None = None) -> Iterator[Path]:
    """Write all that a campaign's folder holds for other programs; yields each file once it is there.

    estimator: the one that `cooperative.campaign.run` was given, where it was given one, see `write_table`.

    `table.csv`, `campaign.h5`, and `series/refined-000123.vtkhdf` for each sample whose fields were kept: its particles
    at the start and at the end. Raises ValueError where the folder holds no finished sample, OSError where the disk
    refuses.
    """
    store = read_store(folder)
    campaign = campaign_of(store, estimator)
    models = {grid: build(campaign, grid, random_soil(campaign), at_rest=False) for grid in GRIDS}
    read = rows_reader(campaign, store, models)
    if not any(read(grid).numbers for grid in GRIDS):
        raise ValueError(f"folder {folder} has no finished sample yet: start the run first")
    yield write_table(store, estimator=estimator)
    yield consolidate(store)
    for grid in GRIDS:
        for number in read(grid).numbers:
            sample = read_sample(store, grid, number)
            if "displacement" in sample.fields:
                yield _series_of_fields(store, models[grid], sample)


def export_sample(folder: str | Path, number: int, grid: str = "refined", *, frames: int | None = None) -> Path:
    """Write the series of one sample, `series/refined-000123.vtkhdf` in the campaign's folder.

    frames: None takes the fields that the campaign kept, at the start and at the end; a number runs the sample again,
    with velocity and stress, and writes so many moments from start to end. Raises ValueError for a sample that is not
    there, for fields that were not kept, or for fewer than 2 frames.
    """
    store = read_store(folder)
    if not sample_path(store, grid, number).exists():
        there = rows_reader(campaign_of(store), store)(grid).numbers
        raise ValueError(f"sample {number} is not finished on the {grid} grid: give one of {_few(there)}")
    sample = read_sample(store, grid, number)
    if frames is None and "displacement" not in sample.fields:
        raise ValueError(
            f"the fields of sample {number} on the {grid} grid were not kept ([campaign] fields in the scene): "
            'set fields = "both" for another campaign, or give --frames to run the sample again'
        )
    model = _model(store, grid, at_rest=frames is not None)
    if why := foreign(None, model, sample):
        raise ValueError(f"{sample_path(store, grid, number)} {why}: delete it and resume the campaign")
    if frames is None:
        return _series_of_fields(store, model, sample)
    if frames < 2:
        raise ValueError(f"frames = {frames}: give 2 or more, the first is the start and the last the end")
    times = np.linspace(0.0, end_of(model, sample), frames)
    path = _series_path(store, grid, number)
    result = run_again(model, sample, times)
    write_vtkhdf(path, model.of_sample(sample.coefficients)[0], result.snapshots, result.times)
    return path


def run_again(model: GridModel, sample: Sample, times: np.ndarray) -> Result:
    """Run a finished sample once more from its coefficients, for its states at `times` (s, ascending)."""
    scene, state = model.of_sample(sample.coefficients)
    return solve(scene, state, t_end=float(times[-1]), snapshots=times.tolist())


def _series_of_fields(store: Store, model: GridModel, sample: Sample) -> Path:
    path = _series_path(store, model.grid, sample.number)
    position = np.asarray(model.scene.particles.position)
    of_particles = (position.shape, position.shape[1:])
    kept = {name: values for name, values in sample.fields.items() if values.shape in of_particles}
    at_rest = {name: np.zeros_like(values) for name, values in kept.items()}
    write_particles(
        path,
        position,
        [0.0, end_of(model, sample)],
        [at_rest, kept],
        constant={name: np.asarray(value) for name, value in model.parameters(sample.coefficients).items()},
    )
    return path


def _series_path(store: Store, grid: str, number: int) -> Path:
    return own_folder(store.folder / "series") / f"{grid}-{number:06d}.vtkhdf"


def _model(store: Store, grid: str, *, at_rest: bool) -> GridModel:
    campaign = campaign_of(store)
    return build(campaign, grid, random_soil(campaign), at_rest=at_rest, folder=store.folder)


def _few(numbers: list[int], most: int = 10) -> str:
    said = ", ".join(map(str, numbers[:most])) or "none yet"
    return said if len(numbers) <= most else f"{said} and {len(numbers) - most} more"
