"""A campaign for other programs: a table, series of particles for ParaView, maps, netCDF."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path

import numpy as np

from cooperative.estimate import Estimator
from cooperative.exports._dataset import write_geotiff, write_netcdf
from cooperative.exports._map_files import write_geopackage, write_notice, write_tidy
from cooperative.exports._tables import read_grids, write_table
from cooperative.folder import known_summary, model_of, models_of, read_results, stored_ground
from cooperative.hazard import HazardMaps, maps_of
from cooperative.names import EXPORTS, GRIDS, USUAL_EXPORTS
from cooperative.runs import (
    GridModel,
    SampleSoil,
    StoredGround,
    ground_of,
    read_drawn,
    soil_of,
)
from cooperative.scene import campaign_of
from cooperative.store import FAILED_AT, IN_TIME, FinishedRun, Store, own_folder, read_sample, read_store, stored_text
from jaxmpm import Result, solve, write_particles, write_vtkhdf
from jaxmpm.support.files import remove_leftovers

IN_PLAN = ("geotiff", "geopackage")
"""Kinds of maps that a section does not have."""


def export(
    folder: str | Path, kinds: Sequence[str] | None = None, *, estimator: Estimator | None = None
) -> Iterator[Path]:
    """Write what a campaign's folder holds for other programs. Damaged files are left out with a warning.

    Kinds of files:

    - "table": `table.csv`, a line for each run, see `write_table`;
    - "particles": `series/refined-000123.vtkhdf` for ParaView, of each sample whose fields are stored: its particles at
      the start and at the end;
    - "maps": `maps/hazard.csv`, of a scene with hazard maps;
    - "geotiff": `maps/*.tif`, of a scene in 3D with hazard maps, by rioxarray (extra "exports");
    - "geopackage": `maps/hazard.gpkg`, contours and deposits, likewise, by geopandas (extra "region");
    - "netcdf": `campaign.nc`, by xarray and h5netcdf (extra "exports").

    Args:
        folder: of the campaign, or of samples that were asked in time, whose slides are written.
        kinds: any of these, None for the first three, which need no extra.
        estimator: the one that `cooperative.campaign.run` was given, where it was given one, see `write_table`.

    Yields:
        Path of each file, once it is written.

    Raises:
        ValueError: a kind is unknown, or asked for by name and not in the campaign; a library is not installed; the
            folder has no finished sample.
        OSError: the disk refuses.
    """
    named, kinds = kinds or (), kinds or USUAL_EXPORTS
    if wrong := [kind for kind in kinds if kind not in EXPORTS]:
        raise ValueError(f"{wrong[0]!r} is no kind of export: give one of {', '.join(EXPORTS)}")
    store = read_store(folder)
    for written in (store.folder, store.folder / "maps", store.folder / "series"):
        remove_leftovers(written)
    models = cache(lambda: models_of(campaign_of(store, estimator)))
    ground = stored_ground(store) or ground_of(models())
    rows = read_grids(store, ground)
    if not any(rows[grid].numbers for grid in GRIDS):
        raise ValueError(
            f"folder {folder} has no finished sample yet: start the run first"
            if stored_text(store.folder, IN_TIME) is None
            else f"folder {folder} has no slide of a sample that fails in time, and nothing else to export"
        )
    for why in [why for grid in GRIDS for why in rows[grid].damaged]:
        warnings.warn(f"{why}: left out", stacklevel=2)
    if "table" in kinds:
        yield write_table(store, ground=ground, estimator=estimator)
    if {"maps", *IN_PLAN, "netcdf"} & {*kinds}:
        answered = named or known_summary(store, rows, estimator) is not None
        results = read_results(folder, estimator) if answered and ("netcdf" in kinds or ground.hazard) else None
        maps = None if results is None else maps_of(results)
        _check_maps(ground, maps, named)
        if maps is not None:
            yield from _of_maps(ground, store, maps, kinds)
        if "netcdf" in kinds and results is not None:
            yield write_netcdf(results, maps)
    if "particles" in kinds:
        soils = read_drawn(store.folder, [(grid, number) for grid in GRIDS for number in rows[grid].numbers])
        for grid in GRIDS:
            for number in rows[grid].numbers:
                sample = read_sample(store, grid, number)
                if "displacement" not in sample.fields:
                    continue
                try:
                    soil = soils.get((grid, number)) or _soil_of(models, grid, sample)
                except ValueError as error:
                    if named:
                        raise
                    warnings.warn(f"no particles of sample {number} on the {grid} grid: {error}", stacklevel=2)
                else:
                    yield _series_of_fields(store, grid, ground.grids[grid].position, sample, soil)


def _check_maps(ground: StoredGround, maps: HazardMaps | None, named: Sequence[str]) -> None:
    """Raise ValueError where maps are asked for that the campaign does not have."""
    if not {"maps", *IN_PLAN} & {*named}:
        return
    if ground.hazard is None:
        raise ValueError("the campaign has no hazard maps to export: give [hazard] in the scene of another")
    if maps is None:
        raise ValueError("the campaign has no hazard maps to export yet: no refined run has slid to its end")
    if (wrong := [kind for kind in named if kind in IN_PLAN]) and ground.dimension != 3:
        raise ValueError(
            f"a section has no map in plan to export as {wrong[0]}: give maps, whose hazard.csv is along x"
        )


def _of_maps(ground: StoredGround, store: Store, maps: HazardMaps, kinds: Sequence[str]) -> Iterator[Path]:
    """The files of hazard maps."""
    if "maps" in kinds:
        yield write_tidy(store.folder, maps)
    if "geotiff" in kinds:
        yield from write_geotiff(store.folder, ground, maps)
    if "geopackage" in kinds:
        yield from write_geopackage(store.folder, ground, maps)
    if {"maps", *IN_PLAN} & {*kinds}:
        yield from write_notice(store.folder, maps)


def export_sample(folder: str | Path, number: int, grid: str = "refined", *, frames: int | None = None) -> Path:
    """Write the series of one sample, `series/refined-000123.vtkhdf` in the campaign's folder.

    Args:
        folder: of the campaign.
        number: of the sample.
        grid: "rough" or "refined".
        frames: None takes the stored fields, at the start and at the end. A number runs the sample again, with velocity
            and stress, and writes so many moments from start to end.

    Returns:
        Path of the file.

    Raises:
        ValueError: the sample is not there, its fields are not stored, or `frames` is below 2.
    """
    store = read_store(folder)
    if number not in (there := read_grids(store)[grid].numbers):
        raise ValueError(f"sample {number} is not finished on the {grid} grid: give one of {_few(there)}")
    sample = read_sample(store, grid, number)
    if frames is None and "displacement" not in sample.fields:
        raise ValueError(
            f"the fields of sample {number} on the {grid} grid are not stored ([campaign] fields in the scene): "
            'set fields = "both" for another campaign, or give --frames to run the sample again'
        )
    ground = stored_ground(store) or ground_of(models_of(campaign_of(store)))
    if frames is None:
        soil = read_drawn(store.folder, [(grid, number)]).get((grid, number))
        soil = soil or _soil_of(lambda: models_of(campaign_of(store)), grid, sample)
        return _series_of_fields(store, grid, ground.grids[grid].position, sample, soil)
    if frames < 2:
        raise ValueError(f"frames = {frames}: give 2 or more, the first is the start and the last the end")
    model = model_of(campaign_of(store), grid, sample.row.get(FAILED_AT), store.folder)
    times = np.linspace(0.0, sample.steps * model.time_step(sample.coefficients), frames)
    path = _series_path(store, grid, number)
    result = run_again(model, sample, times)
    write_vtkhdf(path, model.of_sample(sample.coefficients)[0], result.snapshots, result.times)
    return path


def run_again(model: GridModel, sample: FinishedRun, times: np.ndarray) -> Result:
    """Run a finished sample once more from its coefficients, for its states at `times` (s, ascending)."""
    scene, state = model.of_sample(sample.coefficients)
    return solve(scene, state, t_end=float(times[-1]), snapshots=times.tolist())


def _soil_of(models: Callable[[], Mapping[str, GridModel]], grid: str, sample: FinishedRun) -> SampleSoil:
    """The random soil of a sample that `drawn.h5` does not have, on its grid, which `models` builds.

    Raises:
        ValueError: a script gave a part of the campaign that the folder cannot hold.
    """
    try:
        return soil_of(models()[grid], sample.coefficients)
    except ValueError as error:
        raise ValueError(
            f"the folder has the random soil of the samples that its report draws, not of sample {sample.number}, and "
            f"building its grid fails ({error}): give one of those samples"
        ) from error


def _series_of_fields(store: Store, grid: str, position: np.ndarray, sample: FinishedRun, soil: SampleSoil) -> Path:
    path = _series_path(store, grid, sample.number)
    of_particles = (position.shape, position.shape[1:])
    fields = {name: values for name, values in sample.fields.items() if values.shape in of_particles}
    at_rest = {name: np.zeros_like(values) for name, values in fields.items()}
    write_particles(
        path,
        position,
        [0.0, sample.steps * soil.time_step],
        [at_rest, fields],
        constant={name: values.astype(np.float32) for name, values in soil.values.items()},
    )
    return path


def _series_path(store: Store, grid: str, number: int) -> Path:
    return own_folder(store.folder / "series") / f"{grid}-{number:06d}.vtkhdf"


def _few(numbers: list[int], most: int = 10) -> str:
    first = ", ".join(map(str, numbers[:most])) or "none yet"
    return first if len(numbers) <= most else f"{first} and {len(numbers) - most} more"
