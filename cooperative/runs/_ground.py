"""The ground of a campaign as arrays in its folder, by which samples are read and drawn without building a grid.

    ground.h5     written before the first run: outline, toe, layers, and the particles of both grids at the start
    drawn.h5      written with the summary: the random soil of the samples that a report draws

Both are sealed. A folder of an earlier version has neither; its scene gives what they hold (`ground_of`, `soil_of`).
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np

from cooperative.measure import ColumnPlan
from cooperative.runs._model import GridModel, column_plan, sampling_of
from cooperative.scene import Campaign, Given
from foundation import files
from jaxmpm import Face

GROUND, DRAWN = "cooperative ground", "cooperative random soil"
SCHEMA = 2
POINTS = {2: 401, 3: 101}
"""Points of the outline along each horizontal axis, by dimension."""


@dataclass(frozen=True)
class StoredGrid:
    """One grid of a campaign.

    Args:
        position: of its particles at the start (d, N) m.
        half_size: half their spacing (d,) m.
        layer: number of the layer that each particle is of (N,), None where the ground has none.
        columns: of its cells.
        numerics: how its answers depend on the cell, in words.
    """

    position: np.ndarray
    half_size: np.ndarray
    layer: np.ndarray | None
    columns: ColumnPlan
    numerics: str


@dataclass(frozen=True)
class HazardPlan:
    """What hazard maps are made by.

    Args:
        least: thickness from which on soil counts as there (m).
        every: time between two looks (s).
        thickness, speed: thresholds of maps (m, m/s).
    """

    least: float
    every: float
    thickness: tuple[float, ...]
    speed: tuple[float, ...]


@dataclass(frozen=True)
class StoredGround:
    """What samples of a campaign are read and drawn by.

    Args:
        corner, extent: lowest corner and edges (d,) m of the box that holds the ground.
        surface: points of its outline (d, n) m, in 3D (d, n, n) m.
        face: of its slope, None for ground without a toe.
        line: whether the scene draws the line along which run-out is measured.
        layers: their names, from the top down.
        random: names of the soil's parameters that vary.
        terms: coefficients of a sample.
        samples: of the first phase, None where only the estimator of a script knows.
        grids: "rough" and "refined".
        hazard: None where the scene asks for no maps.
        origin: of the scene's coordinates in those of its map (2,) m.
        projection: of that map as WKT, None where the scene has none.
    """

    corner: tuple[float, ...]
    extent: tuple[float, ...]
    surface: np.ndarray
    face: Face | None
    line: bool
    layers: tuple[str, ...]
    random: tuple[str, ...]
    terms: int
    samples: int | None
    grids: Mapping[str, StoredGrid]
    hazard: HazardPlan | None
    origin: tuple[float, ...]
    projection: str | None

    @property
    def dimension(self) -> int:
        """2 for a section, 3 otherwise."""
        return len(self.corner)

    @property
    def middle(self) -> float:
        """Half way along y (m); 0 in a section."""
        return self.corner[1] + self.extent[1] / 2 if self.dimension == 3 else 0.0


@dataclass(frozen=True)
class SampleSoil:
    """The random soil of a sample on one grid. values: of each parameter at the particles (N,), in SI units and
    degrees, nan in rock. time_step: (s)."""

    values: Mapping[str, np.ndarray]
    time_step: float


Drawn = Mapping[tuple[str, int], SampleSoil]
"""By grid and number of the sample."""


def ground_of(models: Mapping[str, GridModel]) -> StoredGround:
    """The ground of a campaign's grids."""
    refined = models["refined"]
    campaign, shape = refined.campaign, refined.campaign.site.shape
    corner, extent = tuple(map(float, shape.corner)), tuple(map(float, shape.extent))
    axes = [np.linspace(low, low + edge, POINTS[len(corner)]) for low, edge in zip(corner[:-1], extent, strict=False)]
    plan = np.meshgrid(*axes, indexing="ij")
    heights = shape.heights(*(axis.ravel() for axis in plan)).reshape(plan[0].shape)
    columns, hazard = refined.state.columns, None
    if columns is not None and campaign.hazard is not None:
        every = float(refined.scene.time_step) * columns.every
        hazard = HazardPlan(float(columns.least), every, campaign.hazard.thickness, campaign.hazard.speed)
    return StoredGround(
        corner,
        extent,
        np.stack([*plan, heights]),
        shape.face,
        line=campaign.site.track is not None,
        layers=tuple(each.name for each in campaign.site.layers),
        random=tuple(campaign.random),
        terms=refined.soil.modes,
        samples=samples_of(campaign),
        grids={grid: _stored_grid(model) for grid, model in models.items()},
        hazard=hazard,
        origin=tuple(map(float, campaign.site.origin)),
        projection=campaign.site.projection,
    )


def samples_of(campaign: Campaign) -> int | None:
    """Samples of the first phase; None where the estimator of a script, which alone knows, is not here."""
    if isinstance(campaign.estimator, Given):
        return None
    return campaign.estimator.rough_runs(sampling_of(campaign))


def _stored_grid(model: GridModel) -> StoredGrid:
    position = np.asarray(model.scene.particles.position)
    return StoredGrid(position, model.half_size, model.layer, column_plan(model.scene), _numerics(model))


def _numerics(model: GridModel) -> str:
    """How a grid's answers depend on its cell, in words."""
    numerics, soil = model.campaign.grids[model.grid], model.campaign.soil
    words = f"cells of {numerics.cell:g} m, {'F-bar' if numerics.fbar else 'no F-bar'}"
    if not getattr(soil, "softens", False):
        return words
    if numerics.internal_length is not None:
        words += f", plastic strain averaged over {numerics.internal_length:.3g} m"
    thickness = getattr(soil, "softening_length", None)
    return f"{words}, softening " + ("per cell" if thickness is None else f"of a band {thickness:g} m thick")


def soil_of(model: GridModel, coefficients: np.ndarray) -> SampleSoil:
    """The random soil of a sample with these coefficients (terms,) on a grid."""
    values = {name: np.asarray(value, float) for name, value in model.parameters(coefficients).items()}
    if model.layer is not None:
        rock = np.array([each.rock for each in model.campaign.site.layers])[model.layer]
        values = {name: np.where(rock, np.nan, value) for name, value in values.items()}
    return SampleSoil(values, model.time_step(coefficients))


def keep_ground(folder: Path, models: Mapping[str, GridModel]) -> None:
    """Write `ground.h5`, unless the folder has it; one that is damaged is set aside. For the one controller. OSError
    where the disk refuses."""
    path = folder / "ground.h5"
    try:
        if read_ground(folder) is not None:
            return
    except files.DamagedFile:
        files.set_aside(path)
    ground = ground_of(models)

    def fill(file: h5py.File) -> None:
        file.attrs.update(line=ground.line, random=" ".join(ground.random), terms=ground.terms)
        file["origin"] = np.array(ground.origin)
        file.attrs["projection"] = json.dumps(ground.projection)
        if ground.samples is not None:
            file.attrs["samples"] = ground.samples
        if ground.face is not None:
            file.attrs.update(vars(ground.face))
        file["corner"], file["extent"], file["surface"] = ground.corner, ground.extent, ground.surface
        file.create_group("layers").attrs.update({f"layer_{at}": name for at, name in enumerate(ground.layers)})
        for name, grid in ground.grids.items():
            group, plan = file.create_group(name), grid.columns
            group.attrs.update(numerics=grid.numerics, cell=plan.cell)
            group["position"], group["half_size"] = grid.position, grid.half_size
            group["origin"], group["shape"], group["ends"] = plan.origin, plan.shape, plan.ends
            if grid.layer is not None:
                group["layer"] = grid.layer
        if ground.hazard is not None:
            group = file.create_group("hazard")
            group.attrs.update(least=ground.hazard.least, every=ground.hazard.every)
            group["thickness"] = np.array(ground.hazard.thickness, float)
            group["speed"] = np.array(ground.hazard.speed, float)

    files.write_sealed(path, GROUND, SCHEMA, fill)


def read_ground(folder: Path) -> StoredGround | None:
    """The ground in `ground.h5`, None where the folder has none. DamagedFile where it cannot be trusted."""
    path = folder / "ground.h5"
    if not os.path.lexists(path):
        return None
    with files.read_sealed(path, GROUND, SCHEMA) as file:
        about, names, layers = file.scalars("/"), file.names("/"), file.scalars("layers")
        hazard = None
        if "hazard" in names:
            least, every = (float(file.scalars("hazard")[name]) for name in ("least", "every"))
            thickness, speed = (_numbers(file, "hazard", name) for name in ("thickness", "speed"))
            hazard = HazardPlan(least, every, thickness, speed)
        return StoredGround(
            _numbers(file, "/", "corner"),
            _numbers(file, "/", "extent"),
            file.array("/", "surface", kinds="f"),
            Face(*(float(about[name]) for name in ("toe_x", "toe_z", "height"))) if "toe_x" in about else None,
            line=bool(about["line"]),
            layers=tuple(str(layers[f"layer_{at}"]) for at in range(len(layers))),
            random=tuple(str(about["random"]).split()),
            terms=int(about["terms"]),
            samples=int(about["samples"]) if "samples" in about else None,
            grids={name: _read_grid(file, name) for name in ("rough", "refined")},
            hazard=hazard,
            origin=_numbers(file, "/", "origin"),
            projection=json.loads(str(about["projection"])),
        )


def _read_grid(file: files.Contents, name: str) -> StoredGrid:
    position, about = file.array(name, "position", dimensions=2, kinds="f"), file.scalars(name)
    layer = file.array(name, "layer", dimensions=1, kinds="iu") if "layer" in file.names(name) else None
    if layer is not None and layer.shape != position.shape[1:]:
        raise files.DamagedFile(f"{file.path} is damaged: {layer.size} layers of {position.shape[1]} particles")
    plan = ColumnPlan(
        _numbers(file, name, "origin"),
        float(about["cell"]),
        tuple(map(int, _numbers(file, name, "shape"))),
        tuple((float(low), float(high)) for low, high in file.array(name, "ends", dimensions=2)),
    )
    half_size = file.array(name, "half_size", dimensions=1, kinds="f")
    return StoredGrid(position, half_size, layer, plan, str(about["numerics"]))


def _numbers(file: files.Contents, group: str, name: str) -> tuple[float, ...]:
    return tuple(file.array(group, name, dimensions=1).tolist())


def keep_drawn(folder: Path, drawn: Drawn) -> None:
    """Write `drawn.h5`, the random soil of samples. OSError where the disk refuses."""

    def fill(file: h5py.File) -> None:
        for (grid, number), soil in drawn.items():
            group = file.create_group(f"{grid}_{number}")
            group.attrs["time_step"] = soil.time_step
            for name, values in soil.values.items():
                group[name] = values.astype(np.float32)

    files.write_sealed(folder / "drawn.h5", DRAWN, SCHEMA, fill)


def read_drawn(folder: Path, wanted: Iterable[tuple[str, int]]) -> Drawn:
    """The random soil in `drawn.h5` of these samples, by grid and number; those that it lacks are left out, all of them
    where it cannot be trusted."""
    try:
        with files.read_sealed(folder / "drawn.h5", DRAWN, SCHEMA) as file:
            groups = {f"{grid}_{number}": (grid, number) for grid, number in wanted}
            return {groups[name]: _read_soil(file, name) for name in file.names("/") if name in groups}
    except (FileNotFoundError, files.DamagedFile):
        return {}


def _read_soil(file: files.Contents, group: str) -> SampleSoil:
    values = {name: file.array(group, name, dimensions=1, kinds="f").astype(float) for name in file.names(group)}
    return SampleSoil(values, float(file.scalars(group)["time_step"]))
