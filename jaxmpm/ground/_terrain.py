"""Ground under a terrain model: particles that the surface cuts have the volume and mass of their part below it."""

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
"""Points along each side of a column of particles at which its surface is sampled."""

POINTS = 64
"""Points along each wall at which layers are sampled."""

LEAST_SHARE = 0.02
"""Least share of its box for a particle; with less, its stress would be rounding only."""


@dataclass(frozen=True)
class Terrain:
    """Ground under a terrain model, between four upright walls and on a rigid level base.

    Args:
        surface: heights of the ground.
        base: height of the base (m).
        x: positions of the walls along x (m), by default the ends of the surface; ground beyond them is left out.
        y: positions of the walls along y (m), likewise.
        polygon: corners in plan (m) of the part to model; None for all.
        depth: below the surface (m) down to which ground is modelled; None for down to the base.
        cut: constraint along these cuts. With "fixed" nothing moves there, as if the soil beyond were rock. With "free"
            nothing is held along the polygon, as if the soil beyond had been excavated; a cut at a depth is always
            fixed.
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
        """Positions of the walls along x and along y (m)."""
        ends = self.surface.ends
        return (ends[0] if self.x is None else self.x, ends[1] if self.y is None else self.y)

    @property
    def corner(self) -> tuple[float, ...]:
        """Lowest corner (3,) m of the bounding box."""
        (west, _), (south, _) = self.walls
        return (west, south, self.base)

    @property
    def extent(self) -> tuple[float, ...]:
        """Edges (3,) m of the bounding box."""
        (west, east), (south, north) = self.walls
        return (east - west, north - south, self._ends[1] - self.base)

    @property
    def face(self) -> None:
        """None: a terrain has no straight toe."""

    @property
    def projection(self) -> str | None:
        """Projection of the surface's file (WKT), None without."""
        return self.surface.projection

    @property
    def fixed_edge(self) -> tuple[tuple[float, float], ...] | None:
        """Corners in plan (m) of a polygon that is fixed along its edge; None for other ground."""
        return self.polygon if self.cut == "fixed" else None

    @property
    def relief(self) -> float:
        """Height of the surface's highest point above its lowest (m)."""
        return self._ends[1] - self._ends[0]

    @property
    def volume(self) -> float:
        """Volume of the ground (m3), to the accuracy of the surface's own steps."""
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
        """Lowest and highest point of the surface between the walls (m)."""
        heights = self.surface.cropped(*self.walls).heights
        return float(np.nanmin(heights)), float(np.nanmax(heights))

    def check(self) -> None:
        """Check the surface and the cuts.

        Raises:
            ValueError: If the surface has holes, does not reach the walls or goes below the base, or a cut is invalid.
        """
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
        """Whether points lie in the modelled part, seen from above.

        Args:
            x: positions (m), of any shape.
            y: positions (m), of the same shape.

        Returns:
            bool, of this shape.
        """
        if self.polygon is None:
            return np.ones(np.shape(x), bool)
        return shapely.contains_xy(shapely.Polygon(self.polygon), x, y)

    def kept(self, position: np.ndarray) -> np.ndarray:
        """Whether points between the walls lie in the modelled part.

        Args:
            position: (3, N) m.

        Returns:
            (N,) bool.
        """
        x, y, z = np.asarray(position, float)
        modelled = self.in_plan(x, y)
        return modelled if self.depth is None else modelled & (z > self.heights(x, y) - self.depth)

    def beyond(self, grid: Grid) -> np.ndarray | None:
        """Nodes of a grid at which ground beyond a cut is fixed.

        Args:
            grid: of the nodes.

        Returns:
            (nodes,) bool, None without such a cut.
        """
        polygon = self.polygon is not None and self.cut == "fixed"
        if not polygon and self.depth is None:
            return None
        axes = [start + grid.cell * np.arange(n) for start, n in zip(grid.origin, grid.shape, strict=True)]
        # Where the polygon follows a wall, the wall is the constraint.
        inner = ((low + 1e-6 * grid.cell, high - 1e-6 * grid.cell) for low, high in self.walls)
        x, y = np.meshgrid(*(axis.clip(*ends) for axis, ends in zip(axes, inner, strict=False)), indexing="ij")
        fixed = np.zeros(grid.shape, bool)
        if polygon:
            fixed |= ~self.in_plan(x, y)[..., None]
        if self.depth is not None:
            fixed |= axes[2] <= (self.heights(x, y) - self.depth)[..., None]
        return fixed.ravel()

    def heights(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Height of the surface (m) at x, y (m), nan outside it."""
        return self.surface.at(x, y)

    def lowered(self, depth: float) -> Raster:
        """The surface moved down by `depth` (m)."""
        return replace(self.surface, heights=self.surface.heights - depth)

    def build(self, layers: Sequence[Layer], discretisation: Discretisation, **loads: Any) -> tuple[Scene, State]:
        """Scene and state, as `terrain` with the same keyword arguments."""
        return terrain(self, layers, discretisation, **loads)

    def cells(self, discretisation: Discretisation) -> list[int]:
        """Cells of a grid along each axis, with air above the highest point.

        Args:
            discretisation: cell, spacing and numerical choices.

        Returns:
            Number of cells along each axis.

        Raises:
            ValueError: If terrain or grid is invalid, or they do not fit each other.
        """
        check_discretisation(discretisation, 3)
        self.check()
        return box_cells("the terrain", self, discretisation)

    def layer_of(self, layers: Sequence[Layer], position: np.ndarray, discretisation: Discretisation) -> np.ndarray:
        """Layer of boxes of particles: the one in which the centre of their part under the surface lies.

        Args:
            layers: from the top down.
            position: centres of the boxes (3, N) m.
            discretisation: its spacing is the height of the boxes.

        Returns:
            (N,) int, numbers from 0.

        Raises:
            ValueError: If layers are invalid, as for `terrain`.
        """
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
        """Thickness of each layer, and whether it is a weak seam.

        Args:
            layers: from the top down.

        Returns:
            One per layer.

        Raises:
            ValueError: If a bottom has holes.
        """
        share = (np.arange(POINTS) + 0.5) / POINTS
        x, y = (axis.ravel() for axis in np.meshgrid(*(low + share * (high - low) for low, high in self.walls)))
        within = self.in_plan(x, y)
        x, y = x[within], y[within]
        tops = [self.heights(x, y), *_bottoms(self, layers, x, y, math.inf), np.full(x.size, self.base)]
        return thicknesses_of(layers, [np.maximum(top, self.base) for top in tops])

    def box_of(self, layers: Sequence[Layer], number: int) -> Box:
        """A box that holds a layer.

        Args:
            layers: from the top down.
            number: of the layer, from 0.

        Returns:
            Lowest corner and edges (m).

        Raises:
            ValueError: If layers are invalid, have holes, or this one lies nowhere.
        """
        rasters = [self.surface, *(layer.bottom for layer in layers if isinstance(layer.bottom, Raster))]
        points = [raster.cropped(*self.walls).places() for raster in rasters]
        (west, east), (south, north) = self.walls
        x, y = np.concatenate(points, axis=1)
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
    """Build ground under a terrain model, on a fixed base between four walls.

    Each particle of a lattice has the volume and mass of the part of its box that lies under the surface.

    Args:
        shape: surface, base, walls and cuts.
        soil: one for all, or layers from the top down, whose bottoms are rasters, depths or thicknesses. A particle is
            of the layer in which the centre of its part under the surface lies.
        discretisation: cell, spacing and numerical choices.
        gravity: downwards (m/s2).
        water: level (m) or heights of the water table, a pool where it lies above the ground, see `WaterSurface`.
        r_u: instead, pore pressure over the weight of the soil above.
        ends: constraint of the four walls.
        speed: largest particle speed that the time step allows for (m/s), by default of a fall through the height.
        at_rest: with the stress of elastic gravity loading, else free of stress.

    Returns:
        Scene and state.

    Raises:
        ValueError: If a raster is invalid, has holes or ends before the walls, a layer lies above the ground, holds no
            particle or is nowhere as thick as one, or sizes do not fit the grid; with coordinates.
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
    bounded = [np.maximum(top, shape.base) for top in tops]
    _refuse_thin(x, y, bounded, spacing)
    warn_of_seams(layers, thicknesses_of(layers, bounded), discretisation.cell)
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
    """Heights of the water between the walls; ValueError if they have holes or end before them."""
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
    numbers = table.heights, table.corner, table.step, WATER_WEIGHT, height
    return WaterSurface(*(jnp.asarray(value, dtype) for value in numbers))


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
    # The volume of a sliver goes to the box below it.
    sliver = np.where(share < LEAST_SHARE, share, 0)
    sliver[..., 0] = 0
    share -= sliver
    share[..., :-1] += sliver[..., 1:]
    modelled = share.ravel() > 0
    if shape.polygon is not None or shape.depth is not None:
        steps = zip(shape.corner, (nx, ny, nz), discretisation.spacing, strict=True)
        centres = [start + (np.arange(n) + 0.5) * step for start, n, step in steps]
        modelled &= shape.kept(np.stack([axis.ravel() for axis in np.meshgrid(*centres, indexing="ij")]))
    if not modelled.any():
        raise ValueError("the cuts leave no particle: draw the polygon larger, or take smaller particles")
    particles = fill(
        (length, width, nz * dz), (dx, dy, dz), unit_weight=STANDARD_GRAVITY, inside=lambda _: modelled,
        corner=shape.corner, dtype=discretisation.dtype,
    )  # fmt: skip
    return replace(particles, volume=particles.volume * jnp.asarray(share.ravel()[modelled], particles.volume.dtype))


def _bottoms(shape: Terrain, layers: Sequence[Layer], x: np.ndarray, y: np.ndarray, spacing: float) -> list[np.ndarray]:
    """Heights (N,) m of the layers' lower boundaries, without the last, at points (N,) m."""
    check_ends(layers)
    surface = shape.heights(x, y)
    bounds = [surface]
    for number, layer in enumerate(layers[:-1], 1):
        if layer.depth is not None:
            bottom = surface - layer.depth
        elif layer.thickness is not None:
            bottom = bounds[-1] - layer.thickness
        elif isinstance(layer.bottom, Raster):
            bottom = layer.bottom.at(x, y)
        else:
            raise ValueError(
                f"the bottom of layer {number} is a line: under a terrain give a raster, depth or thickness"
            )
        _refuse_holes(f"the bottom of layer {number}", bottom, x, y)
        beyond = bottom - bounds[-1]
        worst = int(np.argmax(beyond)) if beyond.size else 0
        if beyond.size and beyond[worst] > spacing:
            raise ValueError(
                f"the bottom of layer {number} lies {beyond[worst]:g} m above the one above it at ({x[worst]:g}, "
                f"{y[worst]:g}) m: draw it below"
            )
        bounds.append(np.minimum(bottom, bounds[-1]))
    return bounds[1:]


def _refuse_thin(x: np.ndarray, y: np.ndarray, tops: Sequence[np.ndarray], spacing: float) -> None:
    """Raise ValueError for a layer that is nowhere as thick as a particle.

    Args:
        x: positions of points (N,) m.
        y: positions of points (N,) m.
        tops: heights (N,) m there of the layers' upper boundaries and of the base.
        spacing: height of a particle (m).
    """
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
