"""A section in plane strain drawn as lines: the ground's surface, the boundaries of its layers, the soil of each."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import pairwise
from typing import Literal

import numpy as np
from jax import Array

from jaxmpm.grid import Hold
from jaxmpm.ground._base import boundary_of_base
from jaxmpm.ground._boundaries import (
    TOUCHING,
    Height,
    Outline,
    bedrock_of,
    between_walls,
    check_alike,
    foot_of,
    knots,
    layer_at,
    layering,
    points_of,
    tops_of,
)
from jaxmpm.ground._fill import REMEDY, box_cells, box_grid, lattice
from jaxmpm.ground._free_field import check_free_field, check_level, with_free_field
from jaxmpm.ground._ground import Face
from jaxmpm.ground._layer import Box, Layer, Line, labels
from jaxmpm.ground._pore_water import pore_pressure_of, pressure_on_base, under, water_table
from jaxmpm.ground._seam import Thickness, thicknesses_of, warn_of_seams
from jaxmpm.laws import BaseMotion, WaterTable
from jaxmpm.setup import (
    PADDING,
    Discretisation,
    build,
    check_discretisation,
    end_walls,
    pseudo_static,
    settled,
)
from jaxmpm.soil import AnySoil, Interface
from jaxmpm.support import check
from jaxmpm.support.tracing import host, require_known
from jaxmpm.support.values import by_value
from jaxmpm.types import Loads, Scene, State

POINTS = 512
"""Points between the walls at which layers are sampled."""


@by_value
@dataclass(frozen=True)
class Section:
    """The outline of a section.

    Args:
        surface: of the ground, points (x, z) m with x rising; two points of the same x make a vertical face.
        base: height of the rigid base (m).
        walls: x of the walls at both ends (m), by default the ends of the surface; the part beyond them is left out.
        interface: strength of the contact between soil and rigid ground; None if soil cannot slide on it.
        toe: x (m) of the toe of a slope, a point of the surface beyond which it falls less steeply, along x or against
            it; run-out is measured from it. In a valley the higher side is the slope. None for ground without a toe.
        crest: x of its crest (m), by default the highest point of the surface behind the toe.
        bedrock: surface of rigid ground above the base, points (x, z) m from wall to wall; None for the level base.
    """

    surface: Line
    base: float = 0.0
    walls: tuple[float, float] | None = None
    interface: Interface | None = None
    toe: float | None = None
    crest: float | None = None
    bedrock: Line | None = None

    def outline(self) -> Outline:
        """Points of the surface between the walls, positions of both walls, and height of the base.

        Raises:
            ValueError: If the surface is invalid, does not reach the walls or goes below the base.
        """
        return self._outline

    @cached_property
    def _outline(self) -> Outline:
        points = points_of("surface", self.surface)
        left, right = points[[0, -1], 0] if self.walls is None else self.walls
        check.finite("walls", (left, right), "m")
        check.finite("base", self.base, "m")
        if self.interface is not None:
            self.interface.check()
        if not left < right:
            raise ValueError(f"walls at x = {left:g} m and {right:g} m: give the left one first")
        points = between_walls(points, left, right)
        x, z = points[np.argmin(points[:, 1])]
        if z < self.base:
            raise ValueError(f"the surface at ({x:g}, {z:g}) m lies below the base at {self.base:g} m: lower the base")
        bedrock = None if self.bedrock is None else bedrock_of(self.bedrock, points, (left, right), self.base)
        return Outline(points, (float(left), float(right)), self.base, bedrock)

    @property
    def corner(self) -> tuple[float, ...]:
        """Lowest corner (2,) m of the bounding box."""
        return (self.outline().walls[0], self.base)

    @property
    def extent(self) -> tuple[float, ...]:
        """Edges (2,) m of the bounding box."""
        points, (left, right), *_ = self.outline()
        return (right - left, float(points[:, 1].max()) - self.base)

    @property
    def relief(self) -> float:
        """Height of the surface's highest point above its lowest (m)."""
        return float(np.ptp(self.outline().points[:, 1]))

    @property
    def downhill(self) -> int:
        """Direction along x in which the ground falls: to its toe, or to its lower end where it has none; 1 or -1."""
        if self.face is not None:
            return self.face.downhill
        z = self.outline().points[:, 1]
        return 1 if z[0] >= z[-1] else -1

    @property
    def volume(self) -> float:
        """Area of the section (m2), its volume per metre of width."""
        x = knots(self.outline(), [])
        return float(np.trapezoid(self.heights(x) - self.floor(x), x))

    def check(self) -> None:
        """Check the outline, the toe and the crest.

        Raises:
            ValueError: If `outline` refuses the surface, or it has no such toe or crest.
        """
        self.outline()
        _ = self.face

    @property
    def face(self) -> Face | None:
        """The face of the slope, None without a toe; ValueError for a toe or crest that the surface does not have."""
        if self.toe is None and self.crest is None:
            return None
        if self.toe is None:
            raise ValueError(f"crest = {self.crest:g} m without a toe, from which its height is counted: give toe, too")
        points, (left, right), *_ = self.outline()
        toe_z, sides = foot_of(points, left, self.toe, right)
        if self.crest is not None and not left <= self.crest <= right:
            raise ValueError(
                f"crest = {self.crest:g} m lies outside the ground, which reaches from x = {left:g} to {right:g} m: "
                "give the x at which the slope begins to fall to its toe"
            )
        # Where both sides of a valley fall to the toe, the crest tells them apart, else the higher one is the slope.
        heights = {side: self._highest(*((left, self.toe) if side == 1 else (self.toe, right))) for side in sides}
        if self.crest is not None:
            heights = {
                side: self._highest(self.crest, self.crest) for side in sides if side * (self.toe - self.crest) >= 0
            }
        if not heights:
            raise ValueError(
                f"crest = {self.crest:g} m lies on the other side of the toe at x = {self.toe:g} m than its slope, "
                f"which falls {'along' if 1 in sides else 'against'} x: give the x at which the slope begins to fall"
            )
        downhill = max(heights, key=heights.__getitem__)
        height = heights[downhill] - toe_z
        if not height > 0:
            raise ValueError(
                f"crest = {self.crest:g} m is {height:g} m above the toe at x = {self.toe:g} m: give the x at which "
                "the slope begins to fall to it"
            )
        return Face(self.toe, toe_z, height, downhill)

    def _highest(self, low: float, high: float) -> float:
        """Elevation (m) of the surface's highest point from low to high (m)."""
        points = self.outline().points
        between = points[(points[:, 0] >= low) & (points[:, 0] <= high), 1]
        return float(np.r_[between, self.heights(np.array([low, high]))].max())

    def heights(self, x: np.ndarray) -> np.ndarray:
        """Height (n,) m of the surface at x (n,) m."""
        return self.outline().heights(x)

    def floor(self, x: np.ndarray) -> np.ndarray:
        """Height (n,) m of rigid ground at x (n,) m."""
        return self.outline().floor(x)

    def cells(self, discretisation: Discretisation) -> list[int]:
        """Cells of a grid along each axis, with air above the highest point, as `jaxmpm.ground.cells`."""
        check_discretisation(discretisation, 2)
        self.check()
        return box_cells("the section", self, discretisation)

    def layer_of(self, layers: Sequence[Layer], position: np.ndarray, discretisation: Discretisation) -> np.ndarray:
        """Number (N,) int, from 0, of the layer that points at position (2, N) m lie in; the spacing rounds."""
        return layer_at(layering(self.outline(), layers, discretisation), position, discretisation.spacing[-1])

    def thicknesses(self, layers: Sequence[Layer]) -> list[Thickness]:
        """Thickness of each layer, and whether it is a weak seam, as `jaxmpm.ground.thicknesses`."""
        left, right = self.outline().walls
        x = left + (right - left) * (np.arange(POINTS) + 0.5) / POINTS
        return thicknesses_of(layers, self._tops(layers, x))

    def boundaries(self, layers: Sequence[Layer]) -> tuple[np.ndarray, np.ndarray]:
        """The surface, the lower boundaries of the layers and the base, as lines over the same points.

        Args:
            layers: from the top down.

        Returns:
            x (n,) m, just before and just after every point of a line, and heights (layers + 1, n) m from the top down.

        Raises:
            ValueError: If a line is invalid or crosses another.
        """
        x = knots(self.outline(), layers)
        return x, np.minimum.accumulate(self._tops(layers, x))

    def box_of(self, layers: Sequence[Layer], number: int) -> Box:
        """Lowest corner and edges (m) of a box that holds a layer, as `jaxmpm.ground.box_of`."""
        x, heights = self.boundaries(layers)
        top, bottom = heights[number : number + 2]
        thick = np.flatnonzero(top > bottom)
        if not thick.size:
            raise ValueError(f"{labels(layers)[number]} lies nowhere between the walls: draw it there, or leave it out")
        near = slice(max(thick[0] - 1, 0), thick[-1] + 2)
        low = (float(x[near][0]), float(bottom[near].min()))
        return low, (float(x[near][-1]) - low[0], float(top[near].max()) - low[1])

    def lowered(self, depth: float) -> tuple[tuple[float, float], ...]:
        """The surface moved down by `depth` (m)."""
        return tuple((float(x), float(z) - depth) for x, z in self.surface)

    @property
    def build(self) -> Callable[..., tuple[Scene, State]]:
        """`section` of this outline: a function of layers and discretisation, with its keyword arguments."""
        return partial(section, self)

    def _tops(self, layers: Sequence[Layer], x: np.ndarray) -> list[np.ndarray]:
        """Heights (n,) m of the layers' upper boundaries and of rigid ground at x (n,) m, none below it."""
        return [np.maximum(top(x), self.floor(x)) for top in tops_of(self.outline(), layers, spacing=math.inf)]


HELD: dict[str, tuple[Hold, Hold]] = {
    "roller": ("roller", "roller"),
    "fixed": ("fixed", "fixed"),
    "left fixed": ("fixed", "roller"),
    "right fixed": ("roller", "fixed"),
}
"""Constraint of the left and the right end of a section, by the name for both."""


def section(
    shape: Section,
    soil: AnySoil | Sequence[Layer],
    discretisation: Discretisation,
    *,
    gravity: float = 9.81,
    water: float | Line | None = None,
    r_u: float | None = None,
    k_h: float = 0.0,
    k_v: float = 0.0,
    motion: BaseMotion | None = None,
    ends: Literal["roller", "fixed", "left fixed", "right fixed", "tied", "free field"] = "roller",
    speed: float | None = None,
    at_rest: bool = True,
) -> tuple[Scene, State]:
    """Build a section in plane strain, on a fixed base or one with an interface.

    Particles of a lattice fill it, those whose centres lie in the ground.

    Args:
        shape: outline.
        soil: one for all, or layers from the top down; a particle is of the layer in which its centre lies.
        discretisation: cell, spacing and numerical choices.
        gravity: downwards (m/s2).
        water: level or points (x, z) of the water table (m), a level pool where it is above the ground, see
            `WaterTable`.
        r_u: ratio of the pore pressure to the weight of the soil above, in place of `water`.
        k_h: pseudo-static acceleration over gravity, towards the toe, or the lower end of the surface without one.
        k_v: pseudo-static acceleration over gravity, upwards.
        motion: of the base, from time 0, after the initial stress; the section is solved in its frame.
        ends: constraint of both ends. "left fixed" and "right fixed" leave the other on a roller. "tied" joins
            both ends, where the ground must be as high: a wave that leaves at one end enters at the other, and a level
            layer moves as a column of infinite ground. "free field" ends the section without walls where the ground is
            level: dashpots join it to columns of level ground with the same layers and motion, and absorb waves, see
            `FreeField`.
        speed: largest particle speed that the time step allows for (m/s), by default of a fall through half the height.
        at_rest: with the stress of elastic gravity loading, else free of stress.

    Returns:
        Scene and state.

    Raises:
        ValueError: If a line turns back, crosses another or ends in the ground, a pool slopes, a layer is thinner than
            a particle, one of several layers has a parameter per particle, or sizes do not fit the grid; with
            coordinates.

    Example:
        >>> import jaxmpm as mpm
        >>> soil, grid = mpm.Soil(young=5e6, strength=9e3), mpm.Discretisation(cell=1.0, spacing=(0.5, 0.5))
        >>> outline = mpm.Section([(0, 4), (4, 4), (8, 1), (12, 1)])
        >>> scene, state = mpm.section(outline, soil, grid, at_rest=False)
        >>> float(scene.particles.volume.sum())  # m2
        30.0
    """
    require_known({"shape": shape, "gravity": gravity, "k_h": k_h, "k_v": k_v, "speed": speed}, REMEDY)
    along, down = pseudo_static(gravity, k_h, k_v, 2)
    if ends not in HELD and ends not in ("tied", "free field"):
        raise ValueError(f"ends = {ends!r}: give {', '.join(map(repr, HELD))}, 'tied' or 'free field'")
    cells = shape.cells(discretisation)
    layers = list(soil) if isinstance(soil, Sequence) else [Layer(soil)]
    outline = shape.outline()
    tops = layering(outline, layers, discretisation)
    grid = box_grid(shape.corner, cells, discretisation.cell)
    table = water_table(outline, water, discretisation, gravity)
    bedrock = None if outline.bedrock is None else outline.floor
    if bedrock is not None and ends in ("tied", "free field"):
        raise ValueError(f"ends = {ends!r} with bedrock, whose level would have to be that of the base: leave it out")
    wet = None if table is None else under(table)
    particles, law, k0 = lattice(shape, layers, discretisation, grid, bedrock=bedrock, wet=wet)
    if ends == "tied":
        check_alike(outline, tops, table, discretisation.spacing[-1], labels(layers))
    if ends == "free field":
        check_free_field(discretisation, shape.interface)
        check_level(tops, outline, discretisation, labels(layers))
    upright = () if ends == "tied" else end_walls(0, cells[0], *HELD.get(ends, HELD["roller"]))
    warn_of_seams(layers, shape.thicknesses(layers), discretisation.cell)
    x = np.clip(grid.origin[0] + np.arange(grid.shape[0]) * grid.cell, *outline.walls)
    pressure = pressure_on_base(r_u, layers, [top(x) for top in tops], grid.shape[1], gravity)
    rigid = boundary_of_base(grid, bedrock, shape.interface, pressure)
    x, z = np.asarray(particles.position, float)
    built, state = build(
        particles,
        grid,
        law,
        discretisation,
        boundary=replace(
            rigid,
            walls=(*upright, *rigid.walls),
            tied=(PADDING, PADDING + cells[0]) if ends == "tied" else None,
        ),
        loads=Loads(
            gravity=(shape.downhill * along, down),
            water=table,
            pore_pressure=pore_pressure_of(r_u, table is not None, z, layers, [top(x) for top in tops], gravity),
            motion=motion,
            k0=k0,
        ),
        speed=math.sqrt(gravity * shape.extent[-1]) if speed is None else speed,
    )
    state = settled(built, state) if at_rest else state
    if ends != "free field":
        return built, state
    column = partial(section, ends="tied", gravity=gravity, r_u=r_u, k_h=shape.downhill * k_h, k_v=k_v, at_rest=at_rest)
    return with_free_field(built, state, *_columns_beyond(shape, layers, tops, table, discretisation, column))


def _at(table: WaterTable, x: float) -> float | Array:
    """Height (m) of a table."""
    height: float | Array = host(table).interp(x, table.x, table.z)
    return height if check.is_traced(table) else float(height)


def _columns_beyond(
    shape: Section,
    layers: Sequence[Layer],
    tops: Sequence[Height],
    table: WaterTable | None,
    discretisation: Discretisation,
    column: Callable[..., tuple[Scene, State]],
) -> Iterator[tuple[Scene, State]]:
    """Scenes and states of columns of the level ground beyond both walls, one cell wide, the low wall first."""
    for wall in shape.outline().walls:
        heights = [float(top(np.array([wall]))[0]) for top in tops]
        span = (wall, wall + discretisation.cell)
        here = [
            Layer(layer.soil, [(x, bottom) for x in span])
            for layer, (top, bottom) in zip(layers, pairwise(heights), strict=True)
            if top - bottom > TOUCHING * discretisation.spacing[-1]
        ]
        here[-1] = Layer(here[-1].soil)
        water = None if table is None else _at(table, wall)
        yield column(Section([(x, heights[0]) for x in span], base=heights[-1]), here, discretisation, water=water)
