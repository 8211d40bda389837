"""A section in plane strain drawn as lines: the ground's surface, the boundaries of its layers, the soil of each."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np

from foundation import check
from foundation.text import shown
from jaxmpm.ground._free_field import check_free_field, joined
from jaxmpm.ground._ground import Face, box_cells, box_grid, lattice
from jaxmpm.ground._layer import Box, Layer, Line, check_ends
from jaxmpm.ground._raster import Raster
from jaxmpm.ground._seam import Thickness, thicknesses_of, warn_of_seams
from jaxmpm.laws import BaseMotion, WaterTable
from jaxmpm.setup import (
    PADDING,
    RESOLVED,
    Discretisation,
    Hold,
    below,
    build,
    check_discretisation,
    end_walls,
    settled,
)
from jaxmpm.soil import AnySoil, Interface
from jaxmpm.types import Grid, Scene, State, Wall

Height = Callable[[np.ndarray], np.ndarray]
"""Function that gives heights (n,) m of a line at x (n,) m."""

FOOT = 1e-6
"""Largest distance of a toe from a point of the surface, as a share of the section's length."""

TOUCHING = 0.01
"""Largest distance of two lines that touch, as a share of a particle's height."""

POINTS = 512
"""Points between the walls at which layers are sampled."""

WATER_WEIGHT = 9810.0
"""Unit weight of water (N/m3)."""


@dataclass(frozen=True)
class Section:
    """The outline of a section.

    Args:
        surface: of the ground, points (x, z) m with x rising; two points of the same x make a vertical face.
        base: height of the rigid base (m).
        walls: x of the walls at both ends (m), by default the ends of the surface; the part beyond them is left out.
        interface: strength of the contact between soil and base; None if soil cannot slide on it.
        toe: x (m) of the toe of a slope that falls along x, a point of the surface beyond which it falls less steeply;
            run-out is measured from it. None for ground without a toe.
        crest: x of its crest (m), by default the highest point of the surface before the toe.
    """

    surface: Line
    base: float = 0.0
    walls: tuple[float, float] | None = None
    interface: Interface | None = None
    toe: float | None = None
    crest: float | None = None

    def outline(self) -> tuple[np.ndarray, tuple[float, float]]:
        """Points of the surface and positions of both walls.

        Returns:
            Points (n, 2) m, and x of the left and the right wall (m).

        Raises:
            ValueError: If the surface is invalid, does not reach the walls or goes below the base.
        """
        points = _points("surface", self.surface)
        left, right = points[[0, -1], 0] if self.walls is None else self.walls
        check.finite("walls", (left, right), "m")
        check.finite("base", self.base, "m")
        if self.interface is not None:
            self.interface.check()
        if not left < right:
            raise ValueError(f"walls at x = {left:g} m and {right:g} m: give the left one first")
        for (x, z), wall, gap in ((points[0], left, points[0, 0] - left), (points[-1], right, right - points[-1, 0])):
            if gap > 0:
                raise ValueError(
                    f"the surface ends at ({x:g}, {z:g}) m, {gap:g} m from the wall at x = {wall:g} m: draw it on"
                )
        x, z = points[np.argmin(points[:, 1])]
        if z < self.base:
            raise ValueError(f"the surface at ({x:g}, {z:g}) m lies below the base at {self.base:g} m: lower the base")
        return points, (float(left), float(right))

    @property
    def corner(self) -> tuple[float, ...]:
        """Lowest corner (2,) m of the bounding box."""
        return (self.outline()[1][0], self.base)

    @property
    def extent(self) -> tuple[float, ...]:
        """Edges (2,) m of the bounding box."""
        left, right = self.outline()[1]
        return (right - left, self._top() - self.base)

    @property
    def relief(self) -> float:
        """Height of the surface's highest point above its lowest (m)."""
        return self._top() - min(point[1] for point in self.surface)

    @property
    def volume(self) -> float:
        """Area of the section (m2), its volume per metre of width."""
        points, (left, right) = self.outline()
        x, z = points.T
        inner = (x > left) & (x < right)
        x, z = (np.r_[a, values[inner], b] for a, values, b in (
            (left, x, right), (np.interp(left, x, z), z, np.interp(right, x, z))
        ))  # fmt: skip
        return float(np.trapezoid(z - self.base, x))

    def check(self) -> None:
        """Check the outline, the toe and the crest.

        Raises:
            ValueError: If the surface is invalid, does not reach the walls or goes below the base, or has no such toe
                or crest.
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
        points, (left, right) = self.outline()
        toe_z = _foot(points, left, self.toe, right)
        if self.crest is not None and not left <= self.crest <= self.toe:
            raise ValueError(
                f"crest = {self.crest:g} m lies beyond the toe at x = {self.toe:g} m or the wall at x = {left:g} m: a "
                "slope falls along x, so give an x between them, or mirror the section"
            )
        span = (left, self.toe) if self.crest is None else (self.crest, self.crest)
        drawn = points[(points[:, 0] >= span[0]) & (points[:, 0] <= span[1]), 1]
        height = float(np.r_[drawn, self.heights(np.array(span))].max()) - toe_z
        if not height > 0:
            raise ValueError(
                f"crest = {self.crest:g} m is {height:g} m above the toe at x = {self.toe:g} m: give the x at which "
                "the slope begins to fall to it"
            )
        return Face(self.toe, toe_z, height)

    def heights(self, x: np.ndarray) -> np.ndarray:
        """Height (n,) m of the surface at x (n,) m."""
        points, _ = self.outline()
        return np.interp(x, points[:, 0], points[:, 1])

    def cells(self, discretisation: Discretisation) -> list[int]:
        """Cells of a grid along each axis, with air above the highest point.

        Args:
            discretisation: cell, spacing and numerical choices.

        Returns:
            Number of cells along each axis.

        Raises:
            ValueError: If section or grid is invalid, or they do not fit each other.
        """
        check_discretisation(discretisation, 2)
        self.check()
        return box_cells("the section", self, discretisation)

    def layer_of(self, layers: Sequence[Layer], position: np.ndarray, discretisation: Discretisation) -> np.ndarray:
        """Layer of points.

        Args:
            layers: from the top down.
            position: (2, N) m.
            discretisation: its spacing decides on which side of a boundary a point lies.

        Returns:
            (N,) int, numbers from 0.

        Raises:
            ValueError: If layers are invalid or too thin, as for `section`.
        """
        return _layer_of(_layering(self, layers, discretisation), position, discretisation.spacing[-1])

    def thicknesses(self, layers: Sequence[Layer]) -> list[Thickness]:
        """Thickness of each layer, and whether it is a weak seam.

        Args:
            layers: from the top down.

        Returns:
            One per layer.

        Raises:
            ValueError: If a line is invalid.
        """
        left, right = self.outline()[1]
        x = left + (right - left) * (np.arange(POINTS) + 0.5) / POINTS
        return thicknesses_of(layers, [np.maximum(top(x), self.base) for top in _tops(self, layers, spacing=math.inf)])

    def box_of(self, layers: Sequence[Layer], number: int) -> Box:
        """A box that holds a layer.

        Args:
            layers: from the top down.
            number: of the layer, from 0.

        Returns:
            Lowest corner and edges (m).

        Raises:
            ValueError: If a line is invalid, or the layer lies nowhere.
        """
        tops, x = _tops(self, layers, spacing=math.inf), _knots(self, layers)
        top, bottom = (np.maximum(tops[number + down](x), self.base) for down in (0, 1))
        thick = np.flatnonzero(top > bottom)
        if not thick.size:
            raise ValueError(f"layer {number + 1} lies nowhere between the walls: draw it there, or leave it out")
        near = slice(max(thick[0] - 1, 0), thick[-1] + 2)
        low = (float(x[near][0]), float(bottom[near].min()))
        return low, (float(x[near][-1]) - low[0], float(top[near].max()) - low[1])

    def lowered(self, depth: float) -> tuple[tuple[float, float], ...]:
        """The surface moved down by `depth` (m)."""
        return tuple((float(x), float(z) - depth) for x, z in self.surface)

    def build(self, layers: Sequence[Layer], discretisation: Discretisation, **loads: Any) -> tuple[Scene, State]:
        """Scene and state, as `section` with the same keyword arguments."""
        return section(self, layers, discretisation, **loads)

    def _top(self) -> float:
        return max(point[1] for point in self.surface)


HELD: dict[str, tuple[Hold, Hold]] = {
    "roller": ("roller", "roller"),
    "fixed": ("fixed", "fixed"),
    "left fixed": ("fixed", "roller"),
    "right fixed": ("roller", "fixed"),
}
"""Constraint of the left and the right end of a section, by the name for both."""

FREE_FIELD: Literal["free field"] = "free field"


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

    A lattice of particles fills it with those whose centres lie in the ground.

    Args:
        shape: outline.
        soil: one for all, or layers from the top down; a particle is of the layer in which its centre lies.
        discretisation: cell, spacing and numerical choices.
        gravity: downwards (m/s2).
        water: level or points (x, z) of the water table (m), a level pool where it is above the ground, see
            `WaterTable`.
        r_u: instead, pore pressure over the weight of the soil above.
        k_h: pseudo-static acceleration over gravity, towards the lower end of the surface.
        k_v: pseudo-static acceleration over gravity, upwards.
        motion: of the base, from time 0, after the initial stress; the section is solved in its frame.
        ends: constraint of both ends. "left fixed" and "right fixed" leave the other on a roller. "tied" identifies
            both ends, of ground as high at both: waves continue round without reflection at a wall, and a level layer
            moves as a column of infinite ground. "free field" ends the section without walls where the ground is level:
            dashpots join it to columns of level ground with the same layers and motion, and absorb waves, see
            `FreeField`.
        speed: largest particle speed that the time step allows for (m/s), by default of a fall through the height.
        at_rest: with the stress of elastic gravity loading, else free of stress.

    Returns:
        Scene and state.

    Raises:
        ValueError: If a line turns back, crosses another or ends in the ground, a pool slopes, a layer is thinner than
            a particle, one of several layers has a parameter per particle, or sizes do not fit the grid; with
            coordinates.
    """
    check.not_negative("gravity", gravity, "m/s2")
    check.between("k_h", k_h, -1.0, 1.0)
    check.between("k_v", k_v, -1.0, 1.0)
    if ends not in HELD and ends not in ("tied", FREE_FIELD):
        raise ValueError(f"ends = {ends!r}: give {', '.join(map(repr, HELD))}, 'tied' or {FREE_FIELD!r}")
    cells = shape.cells(discretisation)
    layers = list(soil) if isinstance(soil, Sequence) else [Layer(soil)]
    tops = _layering(shape, layers, discretisation)
    grid = box_grid(shape.corner, cells, discretisation.cell)
    table = _water_table(shape, water, discretisation)
    particles, law = lattice(shape, layers, discretisation, grid, wet=None if table is None else _under(table))
    if ends == "tied":
        _check_alike(shape, tops, table, discretisation.spacing[-1])
    if ends == FREE_FIELD:
        if shape.interface is not None:
            raise ValueError("ends = 'free field' with an interface on the base, which ground beyond it would need too")
        check_free_field(discretisation)
        _check_level(tops, shape, discretisation)
    upright = () if ends == "tied" else end_walls(0, cells[0], *HELD.get(ends, HELD["roller"]))
    base = Wall(1, "low", PADDING, "fixed" if shape.interface is None else "friction")
    warn_of_seams(layers, shape.thicknesses(layers), discretisation.cell)
    towards = 1 if shape.surface[0][1] >= shape.surface[-1][1] else -1
    built, state = build(
        particles,
        grid,
        law,
        discretisation,
        walls=(*upright, base),
        **_strength_of_base(shape, layers, tops, grid, r_u),
        tied=(PADDING, PADDING + cells[0]) if ends == "tied" else None,
        motion=motion,
        gravity=(towards * k_h * gravity, -(1 - k_v) * gravity),
        speed=math.sqrt(gravity * shape.extent[-1]) if speed is None else speed,
        water=table,
        pore_pressure=pore_pressure_of(
            r_u,
            table is not None,
            np.asarray(particles.position[1], float),
            layers,
            [top(np.asarray(particles.position[0], float)) for top in tops],
        ),
    )
    state = settled(built, state) if at_rest else state
    if ends != FREE_FIELD:
        return built, state
    loads = {"gravity": gravity, "r_u": r_u, "k_h": towards * k_h, "k_v": k_v, "at_rest": at_rest}
    return joined(built, state, *_columns_beyond(shape, layers, tops, table, discretisation, loads))


def _strength_of_base(
    shape: Section,
    layers: Sequence[Layer],
    tops: Sequence[Height],
    grid: Grid,
    r_u: float | None,
) -> dict[str, Any]:
    """Arguments of `build` for an interface on the base; nothing without one.

    Under a water table soil presses on the base with its effective stress alone, with r_u with that of the water too.
    """
    if shape.interface is None:
        return {}
    x = np.clip(grid.origin[0] + np.arange(grid.shape[0]) * grid.cell, *shape.outline()[1])
    base = np.full(x.size, shape.base)
    pressure = pore_pressure_of(r_u, table=False, z=base, layers=layers, tops=[top(x) for top in tops])
    return {
        "friction": math.tan(math.radians(shape.interface.friction)),
        "cohesion": shape.interface.cohesion or None,
        "wall_pressure": None if pressure is None else np.repeat(pressure, grid.shape[1]),
    }


def _columns_beyond(
    shape: Section,
    layers: Sequence[Layer],
    tops: Sequence[Height],
    table: WaterTable | None,
    discretisation: Discretisation,
    loads: dict[str, Any],
) -> Iterator[tuple[Scene, State]]:
    """Scenes and states of columns of the level ground beyond both walls, the low one first."""
    for wall in shape.outline()[1]:
        ground, here = _level_ground(wall, layers, tops, discretisation)
        water = None if table is None else float(np.interp(wall, table.x, table.z))
        yield section(ground, here, discretisation, ends="tied", water=water, **loads)


def _level_ground(
    wall: float, layers: Sequence[Layer], tops: Sequence[Height], discretisation: Discretisation
) -> tuple[Section, list[Layer]]:
    """Level ground one cell wide with the layers at a wall (m)."""
    heights = [float(top(np.array([wall]))[0]) for top in tops]
    span = (wall, wall + discretisation.cell)
    here = [
        Layer(layer.soil, [(x, bottom) for x in span])
        for layer, (top, bottom) in zip(layers, pairwise(heights), strict=True)
        if top - bottom > TOUCHING * discretisation.spacing[-1]
    ]
    here[-1] = Layer(here[-1].soil)
    return Section([(x, heights[0]) for x in span], base=heights[-1]), here


def _check_level(tops: Sequence[Height], shape: Section, discretisation: Discretisation) -> None:
    """Raise ValueError unless the surface and layers are level within a cell of each wall, to half a particle."""
    left, right = shape.outline()[1]
    for wall, within in ((left, left + discretisation.cell), (right, right - discretisation.cell)):
        for number, top in enumerate(tops[:-1], 1):
            at, inside = top(np.array([wall, within]))
            if abs(at - inside) > discretisation.spacing[-1] / 2:
                raise ValueError(
                    f"ends = {FREE_FIELD!r}, but the top of layer {number} goes from {inside:g} to {at:g} m within a "
                    f"cell of the wall at x = {wall:g} m: draw it on level there, ground beyond it is taken as level"
                )


def _check_alike(shape: Section, tops: Sequence[Height], table: WaterTable | None, spacing: float) -> None:
    """Raise ValueError unless every line is as high at one wall as at the other, so that they can be tied."""
    ends = shape.outline()[1]
    lines = {f"top of layer {number}": top(np.array(ends)) for number, top in enumerate(tops[:-1], 1)}
    if table is not None:
        lines["water"] = np.interp(ends, table.x, table.z)
    for name, (left, right) in lines.items():
        if abs(left - right) > TOUCHING * spacing:
            raise ValueError(
                f"ends = 'tied', but the {name} is at {left:g} m at one wall and at {right:g} m at the other: draw the "
                "ground on until it is as high at both, or take rollers"
            )


def _layer_of(tops: Sequence[Height], position: np.ndarray, spacing: float) -> np.ndarray:
    x, z = np.asarray(position, float)
    layer = np.zeros(x.size, int)
    for top in tops[1:-1]:
        layer += below(z, top(x), RESOLVED * spacing)
    return layer


def _points(name: str, line: Line | Raster) -> np.ndarray:
    """The points (n, 2) of a line; ValueError for an invalid one."""
    if isinstance(line, Raster) or np.ndim(line) != 2 or np.shape(line)[0] < 2 or np.shape(line)[1] != 2:
        raise ValueError(f"{name} = {shown(line)}: give two points [x, z] or more")
    points = np.asarray(line, float)
    check.finite(name, points, "m")
    for (x0, z0), (x1, z1) in pairwise(points):
        if x1 < x0:
            raise ValueError(
                f"{name} turns back from ({x0:g}, {z0:g}) to ({x1:g}, {z1:g}) m: give points with x rising, without "
                "overhang"
            )
    return points


def _foot(points: np.ndarray, left: float, toe: float, right: float) -> float:
    """Elevation (m) of the surface, points (n, 2), at its toe (m); ValueError unless it is a foot between the walls."""
    check.finite("toe", toe, "m")
    if not left < toe < right:
        raise ValueError(
            f"toe = {toe:g} m lies outside the ground, which reaches from x = {left:g} to {right:g} m: give the x at "
            "which the slope meets the ground before it"
        )
    with np.errstate(divide="ignore", invalid="ignore"):
        steep = np.diff(points[:, 1]) / np.diff(points[:, 0])
    feet = points[1:-1][(steep[:-1] < 0) & (steep[:-1] < steep[1:])]
    feet = feet[(feet[:, 0] > left) & (feet[:, 0] < right)]
    apart = np.abs(feet[:, 0] - toe)
    if not feet.size or apart.min() > FOOT * (right - left):
        there = ", ".join(f"{x:g}" for x in feet[np.argsort(apart)[:4], 0])
        raise ValueError(
            f"toe = {toe:g} m is no foot of a slope, a point of the surface beyond which it falls less steeply: "
            + (f"give x = {there} m" if there else "no slope falls along x, mirror the section")
        )
    return float(feet[np.argmin(apart), 1])


def _layering(shape: Section, layers: Sequence[Layer], discretisation: Discretisation) -> list[Height]:
    """The upper boundaries of the layers, and the base; ValueError for layers too thin for particles."""
    dx, dz = discretisation.spacing
    tops = _tops(shape, layers, dz)
    left, right = shape.outline()[1]
    columns = left + (np.arange(round((right - left) / dx)) + 0.5) * dx
    x = np.r_[left, columns, right]
    _refuse_thin(x, [np.maximum(top(x), shape.base) for top in tops], dz)
    return tops


def _tops(shape: Section, layers: Sequence[Layer], spacing: float) -> list[Height]:
    """The upper boundaries of the layers, and the base.

    Args:
        shape: outline.
        layers: from the top down.
        spacing: of particles along z (m), a share of which is the largest distance of lines that touch; inf for no
            check.

    Returns:
        Functions of x.

    Raises:
        ValueError: If a line is invalid or crosses another.
    """
    ends = shape.outline()[1]
    check_ends(layers)
    tops: list[Height] = [shape.heights]
    x = _knots(shape, layers)
    for number, layer in enumerate(layers[:-1], 1):
        name = f"bottom of layer {number}"
        if layer.bottom is not None:
            points = _points(name, layer.bottom)
            tops.append(_boundary(name, points, tops[-1], ends, touching=TOUCHING * spacing))
        elif layer.depth is not None:
            tops.append(_offset(tops[0], layer.depth))
        elif layer.thickness is not None:
            tops.append(_offset(tops[-1], layer.thickness))
        beyond = tops[-1](x) - tops[-2](x)
        worst = int(np.argmax(beyond))
        if beyond[worst] > TOUCHING * spacing:
            upper = "the surface" if number == 1 else f"the bottom of layer {number - 1}"
            raise ValueError(
                f"the {name} crosses {upper}: at x = {x[worst]:g} m it is {beyond[worst]:g} m higher, at z = "
                f"{tops[-1](x)[worst]:g} m; draw it below, or end it where they meet"
            )
    return [*tops, lambda x: np.full_like(x, shape.base)]


def _knots(shape: Section, layers: Sequence[Layer]) -> np.ndarray:
    """Positions x (n,) m just before and just after every point of the surface and of the layers' boundaries."""
    surface, (left, right) = shape.outline()
    lines = [
        _points(f"bottom of layer {number}", layer.bottom)
        for number, layer in enumerate(layers, 1)
        if layer.bottom is not None
    ]
    x = np.unique(np.concatenate([line[:, 0] for line in (surface, *lines)]).clip(left, right))
    step = 1e-9 * (right - left)
    return np.unique(np.concatenate([x - step, x + step]).clip(left, right))


def _offset(line: Height, down: float) -> Height:
    """The line moved down (m)."""
    return lambda x: line(x) - down


def _boundary(name: str, points: np.ndarray, above: Height, ends: tuple[float, float], touching: float) -> Height:
    """A layer's lower boundary; beyond its ends, which touch the one above or reach a wall, it is the one above."""
    for (x, z), short in ((points[0], points[0, 0] > ends[0]), (points[-1], points[-1, 0] < ends[1])):
        height = float(above(np.array([x]))[0])
        if short and abs(height - z) > touching:
            raise ValueError(
                f"the {name} ends at ({x:g}, {z:g}) m in the ground, {height - z:g} m below the boundary above it: "
                f"draw it on to the walls at x = {ends[0]:g} and {ends[1]:g} m, or to that one, to end its layer"
            )
    return lambda x: np.where(
        (x < points[0, 0]) | (x > points[-1, 0]), above(x), np.interp(x, points[:, 0], points[:, 1])
    )


def _water_table(shape: Section, water: float | Line | None, discretisation: Discretisation) -> WaterTable | None:
    """The table from wall to wall; ValueError for one that does not reach them."""
    if water is None:
        return None
    left, right = shape.outline()[1]
    points = _points("water", [(left, water), (right, water)] if isinstance(water, int | float) else water)
    if points[0, 0] > left or points[-1, 0] < right:
        raise ValueError(
            f"water goes from ({points[0, 0]:g}, {points[0, 1]:g}) to ({points[-1, 0]:g}, {points[-1, 1]:g}) m"
            f": draw it to the walls at x = {left:g} and {right:g} m"
        )
    upright = np.flatnonzero(np.diff(points[:, 0]) == 0)
    if upright.size:
        x, z = points[upright[0]]
        raise ValueError(f"water is upright at ({x:g}, {z:g}) m: draw a table that slopes there")
    _refuse_sloping_pool(shape, points, discretisation)
    dtype = check.dtype(discretisation.dtype or jax.dtypes.canonicalize_dtype(float))
    x, z = points.T
    return WaterTable(*(jnp.asarray(value, dtype) for value in (x, z, WATER_WEIGHT, discretisation.spacing[-1])))


def _under(table: WaterTable) -> Callable[[np.ndarray], np.ndarray]:
    """Function that gives which of positions (2, N) m lie under a table: (N,) bool."""
    rounding = RESOLVED * float(table.height)
    return lambda position: below(position[1], np.interp(position[0], table.x, table.z), rounding)


def _refuse_sloping_pool(shape: Section, points: np.ndarray, discretisation: Discretisation) -> None:
    """Raise ValueError unless water above the ground is level, to half a particle.

    The weight of a sloping pool would push soil sideways without balance.
    """
    left, right = shape.outline()[1]
    dx, dz = discretisation.spacing
    x = left + (np.arange(round((right - left) / dx)) + 0.5) * dx
    water, ground = np.interp(x, *points.T), shape.heights(x)
    stands = water - ground > dz / 2
    for pool in np.split(np.arange(x.size), np.flatnonzero(np.diff(stands)) + 1):
        low, high = pool[np.argmin(water[pool])], pool[np.argmax(water[pool])]
        if stands[pool[0]] and water[high] - water[low] > dz / 2:
            (x0, z0), (x1, z1) = sorted((x[end], water[end]) for end in (low, high))
            raise ValueError(
                f"water above the ground slopes from ({x0:g}, {z0:.4g}) to ({x1:g}, {z1:.4g}) m, where a pool is "
                f"level: draw one level above the ground from x = {x[pool[0]]:g} to {x[pool[-1]]:g} m, or the table "
                "below the ground there"
            )


def pore_pressure_of(
    r_u: float | None, table: bool, z: np.ndarray, layers: Sequence[Layer], tops: Sequence[np.ndarray]
) -> np.ndarray | None:
    """Pore pressure as a share of the weight per area above each particle.

    Args:
        r_u: that share; None for no pore pressure.
        table: whether there is a water table too.
        z: height of the particles (N,) m.
        layers: from the top down.
        tops: heights (N,) m, above each particle, of the layers' upper boundaries and of the base.

    Returns:
        (N,) Pa, None without r_u.

    Raises:
        ValueError: If r_u is outside [0, 1), or a table is given too.
    """
    if r_u is None:
        return None
    if not 0 <= r_u < 1:
        raise ValueError(f"r_u = {r_u:g}: give a value of 0 or more and below 1")
    if table:
        raise ValueError(f"both water and r_u = {r_u:g} are given: give one of them")
    above = np.zeros(z.size)
    for layer, (top, bottom) in zip(layers, pairwise(tops), strict=True):
        above += layer.soil.unit_weight * np.maximum(top - np.maximum(bottom, z), 0)
    return r_u * above


def _refuse_thin(x: np.ndarray, tops: Sequence[np.ndarray], spacing: float) -> None:
    """Raise ValueError for a layer thinner than a particle, except where it tapers to nothing.

    Args:
        x: of both walls and of the columns of particles between them (m).
        spacing: of particles along z (m).
        tops: heights (n,) m there of the layers' upper boundaries and of the base.
    """
    for number, (top, bottom) in enumerate(pairwise(tops), 1):
        thickness = top - bottom
        size = np.where(thickness < spacing * (1 - RESOLVED), np.where(thickness > TOUCHING * spacing, 1, 0), 2)
        ends, size = size[[0, -1]], size[1:-1]
        changes = np.flatnonzero(np.diff(size)) + 1
        kinds = [int(run[0]) for run in np.split(size, changes)]
        # A wall where the layer has tapered to nothing counts as ground without it; another does not.
        beyond = np.where(ends == 0, 0, -1)
        for kind, before, after, start in zip(
            kinds, [beyond[0], *kinds], [*kinds[1:], beyond[1]], [0, *changes.tolist()], strict=False
        ):
            if kind == 1 and {before, after} != {0, 2}:
                at = start + 1
                raise ValueError(
                    f"layer {number} is {thickness[at]:g} m thick at ({x[at]:g}, {bottom[at]:g}) m, less than "
                    f"a particle of {spacing:g} m: take smaller particles, or draw it thicker"
                )
        if not (size == 2).any():
            raise ValueError(f"layer {number} holds no particle between the walls: draw it there, or leave it out")
