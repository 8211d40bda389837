"""The ground of a campaign as arrays in its folder, by which samples are read and drawn without building a grid.

`ground.h5` is written before the first run, and sealed: outline, toe, lower boundaries of layers, walls, and the
particles of both grids at the start. Where it is damaged, the scene gives what it holds
(`ground_of`).
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path

import h5py
import numpy as np
from pydantic import ConfigDict, TypeAdapter, with_config

from cooperative.measure import ColumnPlan
from cooperative.runs._model import GridModel
from cooperative.runs._sampling import samples_of
from cooperative.store import Rows, RunRecord, Store, read_rows
from jaxmpm import Face
from jaxmpm import ground as shapes
from jaxmpm.support import files, hdf5
from jaxmpm.support.values import by_value

SEAL = ("cooperative ground", 3)
"""Kind and schema of the file."""
OUTLINE, ARRAYS = ("surface", "bottoms"), ("position", "half_size", "layer")
"""Fields of the ground, and of a grid, that are data sets of `ground.h5`; all else is JSON there."""
POINTS = {2: 401, 3: 101}
"""Points of the outline along each horizontal axis, by dimension."""


@by_value
@with_config(ConfigDict(arbitrary_types_allowed=True))
@dataclass(frozen=True)
class StoredGrid:
    """One grid of a campaign.

    Args:
        position: of its particles at the start (d, N) m.
        half_size: half their spacing (d,) m.
        columns: of its cells.
        numerics: how its answers depend on the cell, in words.
        layer: number of the layer that each particle is of (N,), None where the ground has none.
    """

    position: np.ndarray
    half_size: np.ndarray
    columns: ColumnPlan
    numerics: str
    layer: np.ndarray | None = None


@by_value
@dataclass(frozen=True)
class HazardPlan:
    """What hazard maps are made by.

    Args:
        least: thickness from which on soil counts as there (m).
        every: time between two looks (s).
        thickness: thresholds of maps (m).
        speed: thresholds of maps (m/s).
    """

    least: float
    every: float
    thickness: tuple[float, ...]
    speed: tuple[float, ...]


@by_value
@with_config(ConfigDict(arbitrary_types_allowed=True))
@dataclass(frozen=True)
class StoredGround:
    """What samples of a campaign are read and drawn by.

    Args:
        corner: lowest corner (d,) m of the box that holds the ground.
        extent: edges (d,) m of that box.
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
        thickness: of the deposit at the front of the run-out (m).
        bottoms: elevation of the lower boundary of each layer but the last, at the points of the surface
            (layers - 1, ...) m; None for ground without layers.
        walls: axis, position (m) and hold ("fixed" or "roller") of each upright wall.
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
    thickness: float
    bottoms: np.ndarray | None = None
    walls: tuple[tuple[int, float, str], ...] = ()

    def boundaries(self, y: float = 0.0) -> list[tuple[np.ndarray, np.ndarray]]:
        """Lower boundaries of layers in a section.

        Args:
            y: of the section (m), in 3D.

        Returns:
            x and z (n,) m of each layer but the last, z nan where the layer ends.
        """
        if self.bottoms is None:
            return []
        surface, bottoms = self.surface, self.bottoms
        if self.dimension == 3:
            at = int(np.argmin(np.abs(surface[1, 0] - y)))
            surface, bottoms = surface[:, :, at], bottoms[:, :, at]
        lines, thin = [surface[-1], *bottoms], 1e-4 * self.extent[-1]
        return [(surface[0], np.where(top - z > thin, z, np.nan)) for top, z in pairwise(lines)]

    @property
    def dimension(self) -> int:
        """2 for a section, 3 otherwise."""
        return len(self.corner)

    @property
    def middle(self) -> float:
        """Where half of the particles lie on each side along y (m); 0 in a section."""
        return float(np.median(self.grids["refined"].position[1])) if self.dimension == 3 else 0.0


_STORED = TypeAdapter(StoredGround)


def ground_of(models: Mapping[str, GridModel]) -> StoredGround:
    """The ground of a campaign's grids.

    Args:
        models: both grids by name.
    """
    refined = models["refined"]
    campaign, shape = refined.campaign, refined.campaign.site.shape
    layers = [part.layer for part in campaign.site.layers]
    corner, extent = tuple(map(float, shape.corner)), tuple(map(float, shape.extent))
    axes = [np.linspace(low, low + edge, POINTS[len(corner)]) for low, edge in zip(corner[:-1], extent, strict=False)]
    plan = np.meshgrid(*axes, indexing="ij")
    heights = shape.heights(*(axis.ravel() for axis in plan)).reshape(plan[0].shape)
    base = np.stack([*(axis.ravel() for axis in plan), np.full(plan[0].size, corner[-1])])
    bottoms = [
        shapes.top_of(shape, layers, number, base, campaign.grids["refined"]) for number in range(1, len(layers))
    ]
    upright = len(corner) - 1
    columns, hazard, grid = refined.state.columns, None, refined.scene.grid
    if columns is not None and campaign.hazard is not None:
        every = float(refined.scene.numerics.time_step) * columns.every
        hazard = HazardPlan(float(columns.least), every, campaign.hazard.thickness, campaign.hazard.speed)
    return StoredGround(
        corner,
        extent,
        np.stack([*plan, heights]),
        shape.face,
        line=campaign.site.track is not None,
        layers=tuple(part.name for part in campaign.site.layers),
        random=tuple(campaign.random),
        terms=refined.soil.modes,
        samples=samples_of(campaign),
        grids={grid: _stored_grid(model) for grid, model in models.items()},
        hazard=hazard,
        origin=tuple(map(float, campaign.site.origin)),
        projection=campaign.site.projection,
        thickness=campaign.runout_thickness,
        bottoms=np.reshape(bottoms, (len(bottoms), *plan[0].shape)),
        walls=tuple(
            (wall.axis, float(grid.origin[wall.axis] + wall.index * grid.cell), wall.hold)
            for wall in refined.scene.boundary.walls
            if wall.axis < upright
        ),
    )


def _stored_grid(model: GridModel) -> StoredGrid:
    position = np.asarray(model.scene.particles.position)
    return StoredGrid(position, model.half_size, model.columns, _numerics(model), model.layer)


def _numerics(model: GridModel) -> str:
    """How a grid's answers depend on its cell, in words."""
    numerics, soil = model.campaign.grids[model.grid], model.campaign.soil
    average = "volumetric strain averaged over cells" if model.scene.numerics.cell_average else "no cure of locking"
    words = f"cells of {numerics.cell:g} m, {'F-bar' if model.scene.numerics.fbar else average}"
    if not getattr(soil, "softens", False):
        return words
    if numerics.internal_length is not None:
        words += f", plastic strain averaged over {numerics.internal_length:.3g} m"
    thickness = getattr(soil, "softening_length", None)
    return f"{words}, softening " + ("per cell" if thickness in (None, "cell") else f"of a band {thickness:g} m thick")


def rows_reader(
    store: Store, samples: int | None, ground: StoredGround | None = None, check: Callable[[], None] = lambda: None
) -> Callable[[str], Rows]:
    """Reads the verified rows of a grid. Runs of samples that the campaign does not have are damaged.

    Args:
        store: the campaign's folder.
        samples: of the first phase, None where only the estimator of a script knows.
        ground: of the campaign; then runs with another number of coefficients are damaged too.
        check: called before each row.
    """
    return partial(read_rows, store, foreign=partial(_foreign, samples, ground), check=check)


def _foreign(samples: int | None, ground: StoredGround | None, run: RunRecord) -> str | None:
    """What a run holds that a campaign of so many samples does not have; None if nothing."""
    if samples is not None and run.number >= samples:
        return f"is of a sample that the scene, with {samples}, does not have"
    if ground is not None and run.terms != ground.terms and not (run.row["broke_off"] and run.terms == 0):
        return f"holds {run.terms} coefficients of a field that has {ground.terms}"
    return None


def keep_ground(folder: Path, models: Mapping[str, GridModel]) -> None:
    """Write `ground.h5`, unless the folder has it; one that is damaged is set aside.

    For the one controller.

    Args:
        folder: of the campaign.
        models: both grids by name.

    Raises:
        OSError: the disk refuses.
    """
    path = folder / "ground.h5"
    try:
        if read_ground(folder) is not None:
            return
    except files.DamagedFile:
        files.set_aside(path)
    about = asdict(ground_of(models))
    arrays = {name: about.pop(name) for name in OUTLINE}
    for name, grid in about["grids"].items():
        arrays |= {f"{name}_{of}": grid.pop(of) for of in ARRAYS if grid[of] is not None}

    def fill(file: h5py.File) -> None:
        file.attrs["ground"] = json.dumps(about)
        for name, values in arrays.items():
            file[name] = values

    hdf5.write_sealed(path, *SEAL, fill)


def read_ground(folder: Path) -> StoredGround | None:
    """The ground in `ground.h5`, None where the folder has none.

    Args:
        folder: of the campaign.

    Raises:
        DamagedFile: it cannot be trusted.
    """
    path = folder / "ground.h5"
    if not os.path.lexists(path):
        return None
    with hdf5.read_sealed(path, *SEAL) as file:
        about, there = json.loads(str(file.scalars("/")["ground"])), file.names("/")
        about |= {name: file.array("/", name, kinds="f") for name in OUTLINE if name in there}
        for name, grid in about["grids"].items():
            grid |= {of: file.array("/", f"{name}_{of}") for of in ARRAYS if f"{name}_{of}" in there}
        return _STORED.validate_python(about)
