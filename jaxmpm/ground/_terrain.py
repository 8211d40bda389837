"""Ground under a terrain model: boxes of particles that the surface cuts keep their share of volume and mass."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
import shapely
from jax.typing import DTypeLike

from foundation import check
from foundation.text import shown
from jaxmpm.ground._ground import box_cells, box_grid
from jaxmpm.ground._layer import Box, Layer, check_ends
from jaxmpm.ground._raster import Raster
from jaxmpm.ground._seam import Thickness, thicknesses_of, warn_of_seams
from jaxmpm.ground._section import WATER_WEIGHT, pore_pressure_of
from jaxmpm.laws import WaterSurface
from jaxmpm.setup import (
    PADDING,
    RESOLVED,
    Discretisation,
    below,
    build,
    check_discretisation,
    end_walls,
    fill,
    material_on,
    settled,
    sorted_by_cell,
)
from jaxmpm.soil import STANDARD_GRAVITY, AnySoil, law_of_layers, weights
from jaxmpm.types import Grid, Particles, Scene, State, Wall

SAMPLED = 4
"""Points along each side of a column of particles at which its surface is looked at."""

PLACES = 64
"""Places along each wall at which layers are measured."""

LEAST_SHARE = 0.02
"""Share of its box below which a particle is left out: what it would hold is nothing, its stress all rounding."""


@dataclass(frozen=True)
class Terrain:
    """Ground under a terrain model, between four upright walls and on a rigid level base.

    surface: heights of the ground. base: height of the base (m). x, y: places of the walls (m), by default the ends of
    the surface; what lies beyond them is left out. polygon: corners in plan (m) of the part that is kept, None for all.
    depth: below the surface (m) down to which ground is kept, None for down to the base. cut: what holds the kept part
    along these cuts: "fixed" stands still, as the soil beyond would if it were rock; "free" holds nothing along the
    polygon, as if the soil beyond had been dug away, while a depth always stands still.
    """

    surface: Raster
    base: float
    x: tuple[float, float] | None = None
    y: tuple[float, float] | None = None
    polygon: tuple[tuple[float, float], ...] | None = None
    depth: float | None = None
    cut: Literal["fixed", "free"] = "fixed"

    @property
    def walls(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Places of the walls along x and along y (m)."""
        ends = self.surface.ends
        return (ends[0] if self.x is None else self.x, ends[1] if self.y is None else self.y)

    @property
    def corner(self) -> tuple[float, ...]:
        """Lowest corner (3,) m of the box that holds the ground."""
        (west, _), (south, _) = self.walls
        return (west, south, self.base)

    @property
    def extent(self) -> tuple[float, ...]:
        """Edges (3,) m of the box that holds the ground."""
        (west, east), (south, north) = self.walls
        return (east - west, north - south, self._ends[1] - self.base)

    @property
    def face(self) -> None:
        """None: a terrain has no straight toe."""

    @property
    def projection(self) -> str | None:
        """That of the file of its surface (WKT), None where it has none."""
        return self.surface.projection

    @property
    def fixed_edge(self) -> tuple[tuple[float, float], ...] | None:
        """Corners in plan (m) of the ground, where a polygon is cut out that is fixed along its edge."""
        return self.polygon if self.cut == "fixed" else None

    @property
    def relief(self) -> float:
        """Height of the surface's highest point above its lowest (m)."""
        return self._ends[1] - self._ends[0]

    @property
    def volume(self) -> float:
        """Of the ground (m3), to the accuracy of the surface's own steps."""
        (west, east), (south, north) = self.walls
        counts = [max(round(length / self.surface.step), 1) * SAMPLED for length in self.extent[:2]]
        x, y = ((np.arange(n) + 0.5) / n * length for n, length in zip(counts, self.extent[:2], strict=True))
        along, across = np.meshgrid(west + x, south + y, indexing="ij")
        heights = self.heights(along, across) - self.base
        if self.depth is not None:
            heights = np.minimum(heights, self.depth)
        return float((heights * self.in_plan(along, across)).mean() * (east - west) * (north - south))

    @cached_property
    def _ends(self) -> tuple[float, float]:
        """Lowest and highest of the surface between the walls (m)."""
        heights = self.surface.cropped(*self.walls).heights
        return float(np.nanmin(heights)), float(np.nanmax(heights))

    def check(self) -> None:
        """Raise ValueError for a surface that has holes, does not reach the walls or goes below the base."""
        self.surface.check("surface")
        check.finite("base", self.base, "m")
        part = self.surface.cropped(*self.walls)
        holes = np.argwhere(~np.isfinite(part.heights))
        if holes.size:
            x, y = np.array(part.corner) + holes[0] * part.step
            raise ValueError(
                f"the surface has {len(holes)} holes between the walls, the first at ({x:g}, {y:g}) m: fill them, e.g. "
                "with gdal_fillnodata, or put the walls elsewhere"
            )
        i, j = np.unravel_index(int(np.argmin(part.heights)), part.heights.shape)
        x, y = np.array(part.corner) + np.array([i, j]) * part.step
        if part.heights[i, j] < self.base:
            raise ValueError(
                f"the surface at ({x:g}, {y:g}, {part.heights[i, j]:g}) m lies below the base at {self.base:g} m: "
                "lower the base"
            )

        self._check_cuts()

    def _check_cuts(self) -> None:
        if self.cut not in ("fixed", "free"):
            raise ValueError(f"cut = {self.cut!r}: give 'fixed' or 'free'; nothing can roll along a cut through cells")
        if self.depth is not None:
            check.positive("depth", self.depth, "m")
        if self.polygon is None:
            return
        if len(self.polygon) < 3 or any(len(corner) != 2 or not np.isfinite(corner).all() for corner in self.polygon):
            raise ValueError(f"polygon = {shown(self.polygon)}: give three or more corners [x, y] in metres")
        corners = np.array(self.polygon, float)
        polygon = shapely.Polygon(corners)
        if not polygon.is_valid or polygon.area == 0:
            raise ValueError(f"the polygon encloses nothing, or crosses itself ({shapely.is_valid_reason(polygon)}): "
                             "give its corners in order")  # fmt: skip
        for axis, at, (low, high) in zip("xy", corners.T, self.walls, strict=True):
            if at.min() < low or at.max() > high:
                raise ValueError(
                    f"the polygon reaches from {axis} = {at.min():g} to {at.max():g} m, beyond the walls at {low:g} "
                    f"and {high:g} m: draw it between them"
                )

    def in_plan(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Whether points (m) lie in the part that is kept, seen from above."""
        if self.polygon is None:
            return np.ones(np.shape(x), bool)
        return shapely.contains_xy(shapely.Polygon(self.polygon), x, y)

    def kept(self, position: np.ndarray) -> np.ndarray:
        """Whether points (3, N) m between the walls lie in the part that is kept (N,) bool."""
        x, y, z = np.asarray(position, float)
        kept = self.in_plan(x, y)
        return kept if self.depth is None else kept & (z > self.heights(x, y) - self.depth)

    def beyond(self, grid: Grid) -> np.ndarray | None:
        """Nodes (nodes,) bool of a grid at which ground that a cut leaves out stands still; None where none does."""
        held = self.polygon is not None and self.cut == "fixed"
        if not held and self.depth is None:
            return None
        axes = [start + grid.cell * np.arange(n) for start, n in zip(grid.origin, grid.shape, strict=True)]
        # Where the polygon follows a wall, the wall says what holds.
        inner = ((low + 1e-6 * grid.cell, high - 1e-6 * grid.cell) for low, high in self.walls)
        x, y = np.meshgrid(*(axis.clip(*ends) for axis, ends in zip(axes, inner, strict=False)), indexing="ij")
        found = np.zeros(grid.shape, bool)
        if held:
            found |= ~self.in_plan(x, y)[..., None]
        if self.depth is not None:
            found |= axes[2] <= (self.heights(x, y) - self.depth)[..., None]
        return found.ravel()

    def heights(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Height of the surface (m) at points (m)."""
        return self.surface.at(x, y)

    def lowered(self, depth: float) -> Raster:
        """The surface, so much (m) lower."""
        return replace(self.surface, heights=self.surface.heights - depth)

    def build(self, layers: Sequence[Layer], discretisation: Discretisation, **loads: Any) -> tuple[Scene, State]:
        """As `terrain`."""
        return terrain(self, layers, discretisation, **loads)

    def cells(self, discretisation: Discretisation) -> list[int]:
        """Cells of a grid along each axis, with air above the highest point. Raises ValueError for ground or a grid
        that is none, and where one does not fit the other."""
        check_discretisation(discretisation, 3)
        self.check()
        return box_cells("the terrain", self, discretisation)

    def layer_of(self, layers: Sequence[Layer], position: np.ndarray, discretisation: Discretisation) -> np.ndarray:
        """Number of the layer (N,), from 0 on, of boxes of particles about position (3, N) m: that in which the middle
        of what they hold under the surface lies. Raises as `terrain` does."""
        x, y, z = np.asarray(position, float)
        spacing, surface = discretisation.spacing[-1], self.heights(x, y)
        rounding = RESOLVED * spacing
        # The centre of a box that the surface cuts may lie in the air, above a layer that has no thickness there.
        z = np.minimum(np.minimum(z, (z - spacing / 2 + surface) / 2), surface - 2 * rounding)
        layer = np.zeros(z.size, int)
        for bottom in _bottoms(self, layers, x, y, spacing):
            layer += below(z, bottom, rounding)
        return layer

    def thicknesses(self, layers: Sequence[Layer]) -> list[Thickness]:
        """How thick each layer is, and whether it is a weak seam. Raises ValueError for bottoms that have holes."""
        share = (np.arange(PLACES) + 0.5) / PLACES
        x, y = (axis.ravel() for axis in np.meshgrid(*(low + share * (high - low) for low, high in self.walls)))
        within = self.in_plan(x, y)
        x, y = x[within], y[within]
        tops = [self.heights(x, y), *_bottoms(self, layers, x, y, math.inf), np.full(x.size, self.base)]
        return thicknesses_of(layers, [np.maximum(top, self.base) for top in tops])

    def box_of(self, layers: Sequence[Layer], number: int) -> Box:
        """A box that holds a layer, numbered from 0. Raises ValueError for layers that are none, have holes, or lie
        nowhere."""
        rasters = [self.surface, *(layer.bottom for layer in layers if isinstance(layer.bottom, Raster))]
        places = [raster.cropped(*self.walls).places() for raster in rasters]
        (west, east), (south, north) = self.walls
        x, y = np.concatenate(places, axis=1)
        x, y = x.clip(west, east), y.clip(south, north)
        lines = [self.heights(x, y), *_bottoms(self, layers, x, y, math.inf), np.full(x.size, self.base)]
        top, bottom = np.maximum(lines[number], self.base), np.maximum(lines[number + 1], self.base)
        if not (top > bottom).any():
            raise ValueError(f"layer {number + 1} lies nowhere between the walls: draw it there, or leave it out")
        return (west, south, float(bottom.min())), (east - west, north - south, float(top.max() - bottom.min()))


def terrain(
    shape: Terrain,
    soil: AnySoil | Sequence[Layer],
    discretisation: Discretisation,
    *,
    gravity: float = 9.81,
    water: float | Raster | None = None,
    r_u: float | None = None,
    ends: Literal["roller", "fixed"] = "roller",
    speed: float | None = None,
    at_rest: bool = True,
) -> tuple[Scene, State]:
    """Ground under a terrain model at rest: base fixed, the four walls as asked.

    Of a lattice of particles each has the volume and mass of the part of its box that lies under the surface.
    soil: one for all, or layers from the top down, whose bottoms are rasters, depths or thicknesses; a particle is of
    the layer in which the middle of what it holds lies. water: level (m) or heights of the water table, a pool where
    it lies above the ground, see `WaterSurface`. r_u: instead, pore pressure over the weight of what stands above.
    speed: largest particle speed that the time step allows for (m/s), by default of a fall through the height.
    at_rest: with the stress of elastic gravity loading, else free of stress.
    Raises ValueError for rasters that are none, have holes or end before the walls, layers that lie above the ground,
    hold no particle or are nowhere as thick as one, and sizes that do not fit the grid, with the coordinates.
    """
    check.not_negative("gravity", gravity, "m/s2")
    if ends not in ("fixed", "roller"):
        raise ValueError(f"ends = {ends!r}: give 'fixed' or 'roller'")
    cells = shape.cells(discretisation)
    layers = list(soil) if isinstance(soil, Sequence) else [Layer(soil)]
    grid = box_grid(shape.corner, cells, discretisation.cell)
    particles = sorted_by_cell(_boxes(shape, discretisation), grid)
    layer = shape.layer_of(layers, np.asarray(particles.position), discretisation)
    empty = np.flatnonzero(np.bincount(layer, minlength=len(layers)) == 0)
    if empty.size:
        raise ValueError(f"layer {empty[0] + 1} holds no particle between the walls: draw it there, or leave it out")
    law, order = law_of_layers([material_on(discretisation, each.soil) for each in layers], layer)
    particles, layer = jax.tree.map(lambda leaf: leaf[..., order], (particles, layer))
    (x, y, z), spacing = np.asarray(particles.position, float), discretisation.spacing[-1]
    table = _water_table(shape, water)
    under = None if table is None else below(z, table.at(x, y), RESOLVED * spacing)
    density = jnp.asarray(
        weights([each.soil for each in layers], layer, under) / STANDARD_GRAVITY, particles.mass.dtype
    )
    tops = [shape.heights(x, y), *_bottoms(shape, layers, x, y, spacing), np.full(z.size, shape.base)]
    held = [np.maximum(top, shape.base) for top in tops]
    _refuse_thin(x, y, held, spacing)
    warn_of_seams(layers, thicknesses_of(layers, held), discretisation.cell)
    built, state = build(
        replace(particles, mass=particles.volume * density),
        grid,
        law,
        discretisation,
        walls=(*end_walls(0, cells[0], ends), *end_walls(1, cells[1], ends), Wall(2, "low", PADDING, "fixed")),
        gravity=gravity,
        speed=math.sqrt(gravity * shape.extent[-1]) if speed is None else speed,
        water=None if table is None else _water_surface(table, spacing, particles.mass.dtype),
        pore_pressure=pore_pressure_of(r_u, table is not None, z, layers, tops),
        cut=shape.beyond(grid),
    )
    return built, settled(built, state) if at_rest else state


def _water_table(shape: Terrain, water: float | Raster | None) -> Raster | None:
    """Heights of the water between the walls; ValueError for those that have holes or end before."""
    if water is None:
        return None
    if not isinstance(water, Raster):
        check.finite("water", water, "m")
        (west, east), (south, north) = shape.walls
        return Raster(np.full((2, 2), float(water)), (west, south), max(east - west, north - south))
    water.check("water")
    part = water.cropped(*shape.walls)
    _refuse_holes("water", part.heights.ravel(), *part.places())
    return part


def _water_surface(table: Raster, height: float, dtype: DTypeLike) -> WaterSurface:
    told = table.heights, table.corner, table.step, WATER_WEIGHT, height
    return WaterSurface(*(jnp.asarray(value, dtype) for value in told))


def _boxes(shape: Terrain, discretisation: Discretisation) -> Particles:
    """The particles under the surface, each with its share of its box's volume."""
    dx, dy, dz = discretisation.spacing
    length, width, height = shape.extent
    nx, ny, nz = round(length / dx), round(width / dy), math.ceil(height / dz * (1 - 1e-12))
    x, y = (
        start + (np.arange(n * SAMPLED) + 0.5) * step / SAMPLED
        for start, n, step in zip(shape.corner, (nx, ny), (dx, dy), strict=False)
    )
    surface = (shape.heights(*np.meshgrid(x, y, indexing="ij")) - shape.base) / dz
    surface = surface.reshape(nx, SAMPLED, ny, SAMPLED).transpose(1, 3, 0, 2).reshape(SAMPLED**2, nx, ny, 1)
    share = np.mean([np.clip(each - np.arange(nz), 0, 1) for each in surface], axis=0)
    # What a sliver would hold goes to the box below it.
    sliver = np.where(share < LEAST_SHARE, share, 0)
    sliver[..., 0] = 0
    share -= sliver
    share[..., :-1] += sliver[..., 1:]
    kept = share.ravel() > 0
    if shape.polygon is not None or shape.depth is not None:
        steps = zip(shape.corner, (nx, ny, nz), discretisation.spacing, strict=True)
        centres = [start + (np.arange(n) + 0.5) * step for start, n, step in steps]
        kept &= shape.kept(np.stack([axis.ravel() for axis in np.meshgrid(*centres, indexing="ij")]))
    if not kept.any():
        raise ValueError("the cuts leave no particle: draw the polygon larger, or take smaller particles")
    particles = fill(
        (length, width, nz * dz), (dx, dy, dz), unit_weight=STANDARD_GRAVITY, inside=lambda _: kept,
        corner=shape.corner, dtype=discretisation.dtype,
    )  # fmt: skip
    return replace(particles, volume=particles.volume * jnp.asarray(share.ravel()[kept], particles.volume.dtype))


def _bottoms(shape: Terrain, layers: Sequence[Layer], x: np.ndarray, y: np.ndarray, spacing: float) -> list[np.ndarray]:
    """Heights (N,) m of the layers' lower boundaries, but the last, at points (N,) m."""
    check_ends(layers)
    surface = shape.heights(x, y)
    found = [surface]
    for number, layer in enumerate(layers[:-1], 1):
        if layer.depth is not None:
            bottom = surface - layer.depth
        elif layer.thickness is not None:
            bottom = found[-1] - layer.thickness
        elif isinstance(layer.bottom, Raster):
            bottom = layer.bottom.at(x, y)
        else:
            raise ValueError(
                f"the bottom of layer {number} is a line: under a terrain give a raster, depth or thickness"
            )
        _refuse_holes(f"the bottom of layer {number}", bottom, x, y)
        beyond = bottom - found[-1]
        worst = int(np.argmax(beyond)) if beyond.size else 0
        if beyond.size and beyond[worst] > spacing:
            raise ValueError(
                f"the bottom of layer {number} lies {beyond[worst]:g} m above the one above it at ({x[worst]:g}, "
                f"{y[worst]:g}) m: draw it below"
            )
        found.append(np.minimum(bottom, found[-1]))
    return found[1:]


def _refuse_thin(x: np.ndarray, y: np.ndarray, tops: Sequence[np.ndarray], spacing: float) -> None:
    """Raise ValueError for a layer that is nowhere as thick as a particle. x, y: places (N,) m. tops: heights (N,) m
    there of the layers' upper boundaries and of the base."""
    for number, (top, bottom) in enumerate(pairwise(tops), 1):
        thickness = top - bottom
        most = int(np.argmax(thickness))
        if thickness[most] < spacing * (1 - RESOLVED):
            raise ValueError(
                f"layer {number} is at most {thickness[most]:g} m thick, at ({x[most]:g}, {y[most]:g}) m, less than a "
                f"particle of {spacing:g} m: take smaller particles, or draw it thicker"
            )


def _refuse_holes(name: str, heights: np.ndarray, x: np.ndarray, y: np.ndarray) -> None:
    holes = np.flatnonzero(~np.isfinite(heights))
    if holes.size:
        raise ValueError(
            f"{name} has no height at ({x[holes[0]]:g}, {y[holes[0]]:g}) m: fill its holes, or give one that reaches "
            "the walls"
        )
