"""Ground under a terrain model: particles that the surface cuts have the volume and mass of their part below it."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Literal

import numpy as np

from jaxmpm.grid import Grid
from jaxmpm.ground._base import NEAR, boundary_of_base, check_bedrock, normals
from jaxmpm.ground._boxes import SAMPLED, boxes, points_held
from jaxmpm.ground._fill import REMEDY, box_cells, box_grid, nodes_in_plan
from jaxmpm.ground._layer import Box, Layer, labels
from jaxmpm.ground._polygon import beyond_edge, check_polygon, filled_beyond, in_polygon
from jaxmpm.ground._pore_water import pore_pressure_of, pressure_on_base, water_raster, water_surface
from jaxmpm.ground._raster import CODES, Raster
from jaxmpm.ground._seam import Thickness, thicknesses_of, warn_of_seams
from jaxmpm.ground._strata import bottoms, refuse_holes, refuse_thin
from jaxmpm.laws import BaseMotion
from jaxmpm.setup import (
    RESOLVED,
    Discretisation,
    below,
    build,
    check_discretisation,
    end_walls,
    material_on,
    ordered,
    pseudo_static,
    settled,
    under_sky,
)
from jaxmpm.soil import STANDARD_GRAVITY, AnySoil, Interface, law_of_layers, ratio_at_rest, weights
from jaxmpm.support import check
from jaxmpm.support.tracing import array, product, require_known, taken
from jaxmpm.support.values import by_value
from jaxmpm.types import Loads, Scene, State

POINTS = 64
"""Points along each wall at which layers are sampled."""


@by_value
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
        bedrock: heights of rigid ground above the base; None for the level base.
        interface: strength of the contact between soil and rigid ground; None if soil cannot slide on it.
    """

    surface: Raster
    base: float
    x: tuple[float, float] | None = None
    y: tuple[float, float] | None = None
    polygon: tuple[tuple[float, float], ...] | None = None
    depth: float | None = None
    cut: Literal["fixed", "free"] = "fixed"
    bedrock: Raster | None = None
    interface: Interface | None = None

    @property
    def walls(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Positions of the walls along x and along y (m)."""
        ends = self.surface.ends
        return (ends[0] if self.x is None else self.x, ends[1] if self.y is None else self.y)

    @property
    def corner(self) -> tuple[float, ...]:
        """Lowest corner (3,) m of the bounding box."""
        return (self.walls[0][0], self.walls[1][0], self.base)

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
        heights = self.heights(along, across) - self.floor(along, across)
        if self.depth is not None:
            heights = np.minimum(heights, self.depth)
        return float((heights * self.in_plan(along, across)).mean() * (east - west) * (north - south))

    @cached_property
    def _ends(self) -> tuple[float, float]:
        """Lowest and highest point of the surface between the walls (m)."""
        heights = self.whole(self.surface).cropped(*self.walls).heights
        return float(np.nanmin(heights)), float(np.nanmax(heights))

    def whole(self, raster: Raster) -> Raster:
        """A raster of this ground; its holes outside the polygon have the nearest height, on which nothing depends."""
        if self.polygon is None:
            return raster
        return filled_beyond(raster, tuple((float(x), float(y)) for x, y in self.polygon))

    def _whole_layers(self, layers: Sequence[Layer]) -> list[Layer]:
        """Layers with such boundaries."""
        return [
            replace(layer, bottom=self.whole(layer.bottom)) if isinstance(layer.bottom, Raster) else layer
            for layer in layers
        ]

    def check(self) -> None:
        """Check the surface and the cuts.

        Raises:
            ValueError: If the surface has holes, does not reach the walls or goes below the base, or a cut is invalid.
        """
        self.surface.check("surface")
        check.finite("base", self.base, "m")
        if self.polygon is not None:
            check_polygon(self.polygon, self.walls)
        part = self.whole(self.surface).cropped(*self.walls)
        (x, y), z = part.points(), part.heights.ravel()
        refuse_holes("the surface", z, x, y)
        low = np.argmin(z)
        if z[low] < self.base:
            remedy = "lower the base"
            if z[low] in CODES:
                remedy = f"where {z[low]:g} marks a hole, let the file name it (NODATA) and fill it, else {remedy}"
            at = f"({x[low]:g}, {y[low]:g}, {z[low]:g}) m"
            raise ValueError(f"the surface at {at} lies below the base at {self.base:g} m: {remedy}")
        if self.cut not in ("fixed", "free"):
            raise ValueError(f"cut = {self.cut!r}: give 'fixed' or 'free'; nothing can roll along a cut through cells")
        if self.depth is not None:
            check.positive("depth", self.depth, "m")
        if self.interface is not None:
            self.interface.check()
        if self.bedrock is not None:
            self.bedrock.check("bedrock")
            refuse_holes("bedrock", self.floor(x, y), x, y)
            plan = np.stack(self._clamped(x, y))
            check_bedrock(plan, self.floor(*plan), self.heights(*plan), self.base)

    def in_plan(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Whether points at x and y (m), of any shape, lie in the modelled part, seen from above."""
        if self.polygon is None:
            return np.ones(np.shape(x), bool)
        return in_polygon(self.polygon, x, y)

    def modelled(self, position: np.ndarray) -> np.ndarray:
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
        """Nodes of a grid at which ground beyond a cut is fixed, up to half a cell within it, as by `rigid_base`.

        Args:
            grid: of the nodes.

        Returns:
            (nodes,) bool, None without such a cut.
        """
        if self.fixed_edge is None and self.depth is None:
            return None
        x, y = nodes_in_plan(grid, self.walls)
        z = grid.origin[2] + grid.cell * np.arange(grid.shape[2])
        fixed = np.zeros(grid.shape, bool)
        if self.fixed_edge is not None:
            fixed |= beyond_edge(self.fixed_edge, self.walls, x, y, NEAR * grid.cell)[..., None]
        if self.depth is not None:
            upright = normals(lambda *at: self.heights(*self._clamped(*at)), [x, y], grid.cell)[-1]
            fixed |= (z - (self.heights(x, y) - self.depth)[..., None]) * upright[..., None] < NEAR * grid.cell
        return fixed.ravel()

    def heights(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Height of the surface (m) at x, y (m), nan outside it."""
        return self.whole(self.surface).at(x, y)

    def _clamped(self, x: np.ndarray, y: np.ndarray) -> list[np.ndarray]:
        """Points x, y (m), those beyond the walls moved to them."""
        return [at.clip(*ends) for at, ends in zip((x, y), self.walls, strict=True)]

    def floor(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Height of rigid ground (m) at x, y (m) of any shape, as at the walls beyond them: of the bedrock or base."""
        if self.bedrock is None:
            return np.full(np.shape(x), self.base)
        return self.whole(self.bedrock).at(*self._clamped(x, y))

    def lowered(self, depth: float) -> Raster:
        """The surface moved down by `depth` (m)."""
        return replace(self.surface, heights=self.surface.heights - depth)

    @property
    def build(self) -> Callable[..., tuple[Scene, State]]:
        """`terrain` of this surface: a function of layers and discretisation, with its keyword arguments."""
        return partial(terrain, self)

    def cells(self, discretisation: Discretisation) -> list[int]:
        """Cells of a grid along each axis, with air above the highest point, as `jaxmpm.ground.cells`."""
        check_discretisation(discretisation, 3)
        self.check()
        return box_cells("the terrain", self, discretisation)

    def points_held(self, discretisation: Discretisation) -> float:
        """Points of the lattice that are in memory at once, as `jaxmpm.ground.points_held`."""
        return points_held(self, discretisation)

    def layer_of(self, layers: Sequence[Layer], position: np.ndarray, discretisation: Discretisation) -> np.ndarray:
        """Number (N,) int, from 0, of the layer in which the centre of a box's part under the surface lies.

        Position (3, N) m is that of the centres of the boxes, the spacing their height.
        """
        x, y, z = np.asarray(position, float)
        spacing, surface = discretisation.spacing[-1], self.heights(x, y)
        rounding = RESOLVED * spacing
        # The centre of a box that the surface cuts may lie in the air, above a layer that has no thickness there.
        z = np.minimum(np.minimum(z, (z - spacing / 2 + surface) / 2), surface - 2 * rounding)
        layer = np.zeros(z.size, int)
        for bottom in bottoms(self.heights(x, y), self._whole_layers(layers), x, y, spacing):
            layer += below(z, bottom, rounding)
        return layer

    def tops(self, layers: Sequence[Layer], x: np.ndarray, y: np.ndarray, most: float = math.inf) -> list[np.ndarray]:
        """Heights (N,) m of the layers' tops and of rigid ground, none below it; no top `most` (m) above the last."""
        surface, floor = self.heights(x, y), self.floor(x, y)
        boundaries = bottoms(surface, self._whole_layers(layers), x, y, most)
        return [np.maximum(top, floor) for top in (surface, *boundaries, floor)]

    def thicknesses(self, layers: Sequence[Layer]) -> list[Thickness]:
        """Thickness of each layer, and whether it is a weak seam, as `jaxmpm.ground.thicknesses`."""
        share = (np.arange(POINTS) + 0.5) / POINTS
        x, y = (axis.ravel() for axis in np.meshgrid(*(low + share * (high - low) for low, high in self.walls)))
        within = self.in_plan(x, y)
        x, y = x[within], y[within]
        return thicknesses_of(layers, self.tops(layers, x, y))

    def box_of(self, layers: Sequence[Layer], number: int) -> Box:
        """Lowest corner and edges (m) of a box that holds a layer, as `jaxmpm.ground.box_of`."""
        rasters = [self.surface, *(layer.bottom for layer in layers if isinstance(layer.bottom, Raster))]
        points = [raster.cropped(*self.walls).points() for raster in rasters]
        (west, east), (south, north) = self.walls
        x, y = self._clamped(*np.concatenate(points, axis=1))
        top, bottom = self.tops(layers, x, y)[number : number + 2]
        if not (top > bottom).any():
            raise ValueError(f"{labels(layers)[number]} lies nowhere between the walls: draw it there, or leave it out")
        return (west, south, float(bottom.min())), (east - west, north - south, float(top.max() - bottom.min()))


def terrain(
    shape: Terrain,
    soil: AnySoil | Sequence[Layer],
    discretisation: Discretisation,
    *,
    gravity: float = 9.81,
    k_h: float = 0.0,
    k_v: float = 0.0,
    motion: BaseMotion | None = None,
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
        k_h: pseudo-static acceleration over gravity, along x.
        k_v: pseudo-static acceleration over gravity, upwards.
        motion: of the base, from time 0, after the initial stress; the scene is solved in its frame.
        water: level (m) or heights of the water table, a pool where it lies above the ground, see `WaterSurface`.
        r_u: ratio of the pore pressure to the weight of the soil above, in place of `water`.
        ends: constraint of the four walls.
        speed: largest particle speed that the time step allows for (m/s), by default of a fall through half the height.
        at_rest: with the stress of elastic gravity loading, else free of stress.

    Returns:
        Scene and state.

    Raises:
        ValueError: If a raster is invalid, has holes or ends before the walls, a layer lies above the ground, holds no
            particle or is nowhere as thick as one, or sizes do not fit the grid; with coordinates.
    """
    require_known({"shape": shape, "gravity": gravity, "k_h": k_h, "k_v": k_v, "speed": speed}, REMEDY)
    require_known({"water": water}, "give a level, then vary it by `with_soil(water_level=...)`")
    acceleration = pseudo_static(gravity, k_h, k_v, 3)
    if ends not in ("fixed", "roller"):
        raise ValueError(f"ends = {ends!r}: give 'fixed' or 'roller'")
    cells = shape.cells(discretisation)
    layers = list(soil) if isinstance(soil, Sequence) else [Layer(soil)]
    grid = box_grid(shape.corner, cells, discretisation.cell)
    bedrock = None if shape.bedrock is None else shape.floor
    particles = ordered(boxes(shape, discretisation, shape.modelled, bedrock), grid)
    layer = shape.layer_of(layers, np.asarray(particles.position), discretisation)
    empty = np.flatnonzero(np.bincount(layer, minlength=len(layers)) == 0)
    if empty.size:
        raise ValueError(
            f"{labels(layers)[empty[0]]} holds no particle between the walls: draw it there, or leave it out"
        )
    law, order = law_of_layers([material_on(discretisation, part.soil) for part in layers], layer)
    particles, layer = taken(particles, order), layer[order]
    (x, y, z), spacing = np.asarray(particles.position, float), discretisation.spacing[-1]
    table = water_raster(shape.whole(water) if isinstance(water, Raster) else water, shape.walls)
    under = None if table is None else below(z, table.at(x, y), RESOLVED * spacing)
    density = array(weights([part.soil for part in layers], layer, under) / STANDARD_GRAVITY, particles.mass.dtype)
    tops = shape.tops(layers, x, y, spacing)
    refuse_thin(x, y, tops, spacing, labels(layers))
    warn_of_seams(layers, thicknesses_of(layers, tops), discretisation.cell)
    x_plan, y_plan = (at.ravel() for at in nodes_in_plan(grid, shape.walls))
    pressure = pressure_on_base(r_u, layers, shape.tops(layers, x_plan, y_plan), grid.shape[-1], gravity)
    rigid = boundary_of_base(grid, bedrock, shape.interface, pressure, cut=shape.beyond(grid))
    speed = math.sqrt(gravity * shape.extent[-1]) if speed is None else speed
    built, state = build(
        replace(particles, mass=product(particles.volume, density)),
        grid,
        law,
        discretisation,
        boundary=replace(rigid, walls=(*end_walls(0, cells[0], ends), *end_walls(1, cells[1], ends), *rigid.walls)),
        loads=Loads(
            gravity=acceleration,
            motion=motion,
            k0=ratio_at_rest([part.soil for part in layers], layer, law),
            water=None if table is None else water_surface(table, spacing, particles.mass.dtype, gravity),
            pore_pressure=pore_pressure_of(r_u, table is not None, z, layers, tops, gravity),
        ),
        speed=speed,
    )
    state = settled(built, state) if at_rest else state
    if discretisation.air is None and acceleration[-1] < 0:
        built = under_sky(built, speed**2 / (-2 * acceleration[-1]))
    return built, state
