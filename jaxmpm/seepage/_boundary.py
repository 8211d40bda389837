"""What water does at the outer faces of cells: rain, evaporation, pools, seepage faces, given heads, drains."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar, Protocol, TypeAlias

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from jaxmpm.grid import static
from jaxmpm.seepage._cells import Cells, Faces, Side
from jaxmpm.seepage._soil import Gardner, Shape, VanGenuchten
from jaxmpm.support import check
from jaxmpm.support.check import Limit, from_zero
from jaxmpm.support.pytrees import pytree
from jaxmpm.support.text import shown

Soil: TypeAlias = VanGenuchten | Gardner
InTime: TypeAlias = ArrayLike | tuple[Sequence[float], Sequence[float]]
"""A number, or times (s) and the values from there on: rates hold until the next time, levels are linear between."""


@pytree
@dataclass(frozen=True)
class Series:
    """A value that changes with time.

    Args:
        times: (m,) rising (s).
        values: (m,) at them; (1, nf) for values that differ between faces and never change.
        stepped: whether a value holds until the next time, else it is linear between; static.
    """

    times: Array
    values: Array
    stepped: bool = static()

    def at(self, start: Array, end: Array) -> Array:
        """The value, () or (nf,), of a step from `start` to `end` (s): a rate in its middle, a level at its end."""
        if len(self.times) == 1:
            return self.values[0]
        if not self.stepped:
            return jnp.interp(end, self.times, self.values)
        number = jnp.searchsorted(self.times, (start + end) / 2, side="right") - 1
        return self.values[jnp.maximum(number, 0)]


@pytree
@dataclass(frozen=True)
class Places:
    """Faces on the device, as of `Faces`; heights are above the cells' corner.

    Args:
        cell: (nf,) number of the cell.
        area: (nf,) m2.
        distance: (nf,) m.
        z: (nf,) m.
        centre: (nf,) m.
        upward: (nf,) 1 where rain falls.
        level: (nf,) 1 where water crosses horizontally.
        turn: (nf,) number of faces of the same cell before it.
        turns: faces of a cell at most; static.
    """

    cell: Array
    area: Array
    distance: Array
    z: Array
    centre: Array
    upward: Array
    level: Array
    turn: Array
    turns: int = static()

    def conductance(self, soil: Soil) -> Array:
        """Inflow into saturated soil per head (nf,) m2/s."""
        along = jnp.where(self.level > 0, soil.anisotropy, 1)
        return soil.conductivity * along * self.area / self.distance

    def driven(self, soil: Soil, shape: Shape, head: Array, outside: Array) -> tuple[Array, Array]:
        """Inflow from heads outside, and the relative conductivity of the cells.

        Args:
            soil: of the cells.
            shape: of its curves.
            head: pressure heads (nf,) m of the cells.
            outside: total heads (nf,) m above the cells' corner.

        Returns:
            Inflow (nf,) m3/s, and relative conductivity (nf,).
        """
        fall = outside - self.centre - head
        _, (conductivity, outside_conductivity) = soil.curves(jnp.stack([head, outside - self.z]), shape)
        return self.conductance(soil) * driven(fall, outside_conductivity, conductivity, soil.steepness), conductivity


def driven(fall: Array, first: Array, second: Array, steepness: Array) -> Array:
    """Fall of the total head times the relative conductivity between two points.

    While the fall changes conductivity by a factor of less than e^2, it is multiplied by a mean of second order: the
    arithmetic one where water flows from wet to dry soil, the harmonic one where it flows from dry to wet. What is left
    over of a larger fall takes the conductivity of the end upstream. The flow then falls with the head downstream and
    rises with that upstream, whatever the cells, so that heads do not oscillate.

    Source: Forsyth and Kropinski (1997), doi:10.1137/S1064827594265824 (the bound of e^2).

    Args:
        fall: of the total head from the first to the second point (m).
        first: relative conductivity there.
        second: relative conductivity there.
        steepness: fall of the logarithm of conductivity per suction (1/m).

    Returns:
        m.
    """
    near = jnp.clip(fall, -2 / steepness, 2 / steepness)
    upstream, downstream = jnp.where(fall > 0, first, second), jnp.where(fall > 0, second, first)
    total = upstream + downstream
    mean = jnp.where(upstream < downstream, 2 * upstream / total * downstream, total / 2)
    return near * mean + (fall - near) * upstream


class Condition(Protocol):
    """What happens at some faces: a frozen pytree."""

    @property
    def places(self) -> Places:
        """The faces."""

    def inflow(self, soil: Soil, shape: Shape, head: Array, start: Array, end: Array) -> Array:
        """Inflow (nf,) m3/s in a step from `start` to `end` (s) into cells of soil with pressure heads (nf,) m."""

    def offered(self, start: Array, end: Array) -> Array:
        """Rain () m3/s that falls on the faces in a step."""


@pytree
@dataclass(frozen=True)
class Open:
    """Faces in air or under a pool; the solver finds how much water enters, runs off, evaporates and seeps out.

    Below the level the head is that of the pool. Above it rain enters at its rate unless the surface is ponded, and
    saturated soil seeps: the inflow is the smaller of the rain and of the flow that a head at the surface drives. A
    negative rate is evaporation; soil at its driest gives no more than flows to the surface.

    Args:
        places: the faces.
        rain: rate (m/s), per level area; None without rain.
        level: of the pool above the cells' corner (m); None without a pool.
        ponding: depth (m) at which water on the surface runs off.
        driest: pressure head (m) of the air-dry surface.
    """

    places: Places
    rain: Series | None
    level: Series | None
    ponding: Array
    driest: Array

    PARAMETERS: ClassVar[dict[str, Limit]] = {"ponding": from_zero("m"), "driest": Limit(below=0.0, unit="m")}

    def inflow(self, soil: Soil, shape: Shape, head: Array, start: Array, end: Array) -> Array:
        """Inflow (nf,) m3/s in a step from `start` to `end` (s) into cells of soil with pressure heads (nf,) m."""
        places = self.places
        pond = places.z + self.ponding * places.upward
        level = jnp.full_like(pond, -jnp.inf) if self.level is None else self.level.at(start, end)
        under = level > places.z
        most, relative = places.driven(soil, shape, head, jnp.where(under, level, pond))
        if self.rain is None:
            return jnp.where(under, most, jnp.minimum(0, most))
        rate = self.rain.at(start, end) * places.area * places.upward
        rising = places.z + self.driest - places.centre - head
        least = places.conductance(soil) * relative * jnp.minimum(rising, 0)
        return jnp.where(under, most, jnp.minimum(jnp.maximum(rate, least), most))

    def offered(self, start: Array, end: Array) -> Array:
        """Rain () m3/s that falls on the faces above the pool in a step; 0 while it evaporates."""
        if self.rain is None:
            return jnp.zeros_like(self.ponding)
        area = self.places.area * self.places.upward
        if self.level is not None:
            area = jnp.where(self.level.at(start, end) > self.places.z, 0, area)
        return jnp.maximum(self.rain.at(start, end), 0) * jnp.sum(area)


@pytree
@dataclass(frozen=True)
class Held:
    """Faces with a given head.

    Args:
        places: the faces.
        head: total head above the cells' corner (m), or pressure head.
        total: whether it is the total head; static.
    """

    places: Places
    head: Series
    total: bool = static()

    def inflow(self, soil: Soil, shape: Shape, head: Array, start: Array, end: Array) -> Array:
        """Inflow (nf,) m3/s in a step from `start` to `end` (s) into cells of soil with pressure heads (nf,) m."""
        outside_head = self.head.at(start, end)
        outside = outside_head if self.total else self.places.z + outside_head
        return self.places.driven(soil, shape, head, jnp.broadcast_to(outside, head.shape))[0]

    def offered(self, start: Array, end: Array) -> Array:
        """No rain."""
        return jnp.zeros((), self.places.z.dtype)


@pytree
@dataclass(frozen=True)
class Draining:
    """Faces through which water falls at the conductivity of the soil: its table lies far below.

    Args:
        places: the faces.
    """

    places: Places

    def inflow(self, soil: Soil, shape: Shape, head: Array, start: Array, end: Array) -> Array:
        """Inflow (nf,) m3/s in a step from `start` to `end` (s) into cells of soil with pressure heads (nf,) m."""
        return -soil.conductivity * soil.curves(head, shape)[1] * self.places.area

    def offered(self, start: Array, end: Array) -> Array:
        """No rain."""
        return jnp.zeros((), self.places.z.dtype)


@pytree
@dataclass(frozen=True)
class Drain:
    """Pipes in cells. Water flows into a pipe while the head in its cell is above the pipe's, and never back.

    The flow to a pipe that is far thinner than its cell follows from the mean head of the cell.

    Source: Peaceman (1983), doi:10.2118/10528-PA, eq. 9 (equivalent radius of a cell).

    Args:
        places: cells of the pipes; z is the pipe's, area its length.
        radius: of the pipes (m).
        head: total head in the pipes above the cells' corner (m); None if they are full of air at their own height.
        edges: of a cell across the pipes (m); static.
    """

    places: Places
    radius: Array
    head: Series | None
    edges: tuple[float, float] = static()

    def inflow(self, soil: Soil, shape: Shape, head: Array, start: Array, end: Array) -> Array:
        """Inflow (nf,) m3/s in a step from `start` to `end` (s) into cells of soil with pressure heads (nf,) m."""
        (dx, dz), ratio = self.edges, jnp.sqrt(soil.anisotropy)
        equal = 0.28 * jnp.sqrt(dx**2 / ratio + dz**2 * ratio) / (jnp.sqrt(ratio) + 1 / jnp.sqrt(ratio))
        transmits = soil.conductivity * ratio * soil.curves(head, shape)[1]
        inside = self.places.z if self.head is None else self.head.at(start, end)
        falls = jnp.minimum(inside - self.places.centre - head, 0)
        return 2 * jnp.pi * transmits * self.places.area / jnp.log(equal / self.radius) * falls

    def offered(self, start: Array, end: Array) -> Array:
        """No rain."""
        return jnp.zeros((), self.places.z.dtype)


AnyCondition: TypeAlias = Open | Held | Draining | Drain


@dataclass(frozen=True)
class AtSide:
    """A condition at a side, which `problem` makes for its cells.

    Args:
        side: of the cells; None for one inside.
        of: a function of the cells that gives the condition.
    """

    side: Side | None
    of: Callable[[Cells], AnyCondition]


def series(name: str, value: InTime, *, stepped: bool, above: float = 0.0) -> Series:
    """A number or table in time, checked.

    Args:
        name: for messages.
        value: a number, or times (s) and values.
        stepped: whether a value holds until the next time.
        above: taken off the values.

    Returns:
        Series.

    Raises:
        ValueError: If the times do not rise, or there are not as many values.
    """
    shapes = [*map(np.shape, value)] if isinstance(value, tuple) else [(1,), (1,)]
    if len(shapes) != 2 or len(shapes[0]) != 1 or shapes[0] != shapes[1] or shapes[0] == (0,):
        raise ValueError(f"{name} = {shown(value)}: give times (s) and as many values, or one number")
    # On the host in float64: heights above the sea keep their digits when the corner's is taken off.
    host = jnp if check.is_traced(value) else np
    times, values = map(host.asarray, value) if isinstance(value, tuple) else (host.zeros(1), host.asarray(value)[None])
    check.finite(f"times of {name}", times, "s")
    check.finite(name, values)
    if not check.is_traced(times) and np.any(np.diff(times) <= 0):
        raise ValueError(f"times of {name} = {shown(times.tolist())} s do not rise: give them in order, each once")
    return Series(jnp.asarray(times, float), jnp.asarray(values - above, float), stepped)


def _places(faces: Faces, what: str) -> Places:
    if not faces.cell.size:
        raise ValueError(f"{what} has no faces: give the cells soil there, or leave it out")
    given = (faces.area, faces.distance, faces.z, faces.centre, faces.upward, faces.level)
    area, distance, z, centre, upward, level = (jnp.asarray(values, float) for values in given)
    order = np.argsort(faces.cell, kind="stable")
    turn, ordered = np.empty_like(order), faces.cell[order]
    turn[order] = np.arange(order.size) - np.searchsorted(ordered, ordered)
    cell, turns = jnp.asarray(faces.cell, jnp.int32), int(turn.max()) + 1
    return Places(cell, area, distance, z, centre, upward, level, jnp.asarray(turn, jnp.int32), turns)


def open_face(
    side: Side = "surface",
    *,
    rain: InTime | None = None,
    level: InTime | None = None,
    ponding: float = 0.0,
    driest: float = -100.0,
) -> AtSide:
    """Faces in air or under a pool: rain, evaporation, run-off, seepage faces and the level of a river or reservoir.

    Args:
        side: of the cells.
        rain: rate per level area (m/s), below 0 for evaporation; a table's rates hold until its next time.
        level: height of the pool (m), linear between a table's times.
        ponding: depth (m) at which water on the surface runs off.
        driest: pressure head (m) of the air-dry surface, at which evaporation dries up.

    Returns:
        A condition for `problem`.

    Raises:
        ValueError: If a value is outside its limit; 100 mm/h and more of rain is taken for a mistaken unit.
    """
    rate = None if rain is None else series("rain", rain, stepped=True)
    if rate is not None:
        check.within(
            "rain", rate.values, Limit(most=1e-3, unit="m/s"), remedy="1 m/s is 3.6 million mm/h: divide mm/h by 3.6e6"
        )

    def make(cells: Cells) -> Open:
        pool = None if level is None else series("level", level, stepped=False, above=cells.corner[-1])
        condition = Open(
            _places(cells.faces(side), side), rate, pool, jnp.asarray(ponding, float), jnp.asarray(driest, float)
        )
        check.within_limits(condition)
        return condition

    return AtSide(side, make)


def held_head(
    side: Side,
    *,
    level: InTime | None = None,
    pressure_head: InTime | Callable[[np.ndarray], np.ndarray] | None = None,
) -> AtSide:
    """Faces with a given head: groundwater beyond the end of a section, a table in the base.

    Args:
        side: of the cells.
        level: height to which water rises in a standpipe there (m), the total head; suction above it.
        pressure_head: at the faces (m), in place of the level; or a function of their positions (d, nf) m that gives
            (nf,) m.

    Returns:
        A condition for `problem`.

    Raises:
        ValueError: Unless one of the two is given.
    """
    if (level is None) == (pressure_head is None):
        raise ValueError(f"held_head at {side}: give one of level and pressure_head")

    def make(cells: Cells) -> Held:
        if level is not None:
            head = series("level", level, stepped=False, above=cells.corner[-1])
        else:
            assert pressure_head is not None
            outside_head = pressure_head(cells.positions(side)) if callable(pressure_head) else pressure_head
            head = series("pressure_head", outside_head, stepped=False)
        return Held(_places(cells.faces(side), side), head, level is not None)

    return AtSide(side, make)


def free_drainage(side: Side = "base") -> AtSide:
    """Faces through which water falls by its weight alone, above a table far below.

    Args:
        side: of the cells, "base".

    Returns:
        A condition for `problem`.

    Raises:
        ValueError: If the side is another, through which water does not fall.
    """
    if side != "base":
        raise ValueError(f"free_drainage at {shown(side)}: water falls through the base alone")
    return AtSide(side, lambda cells: Draining(_places(cells.faces(side), side)))


def drain(points: Sequence[Sequence[float]], *, radius: float, head: InTime | None = None) -> AtSide:
    """Drain pipes along y, at points of a section or through the cells of a solid with these x and z.

    Args:
        points: (x, z) of each pipe (m).
        radius: of the pipes (m), less than 0.2 of the cell's edges.
        head: height of the water in them (m); by default they are full of air at their own height.

    Returns:
        A condition for `problem`.

    Raises:
        ValueError: If a pipe lies in no soil, or is no thinner than its cell.
    """
    check.positive("radius", radius, "m")

    def make(cells: Cells) -> Drain:
        d, h = len(cells.shape), cells.spacing
        if d == 1:
            raise ValueError("drain in a column: pipes need a section or a solid")
        equal = 0.14 * math.hypot(h[0], h[-1])
        if radius >= equal:
            raise ValueError(
                f"radius = {radius:g} m of the drain is no less than {equal:.3g} m, that of its cell: give larger cells"
            )
        found, heights = [], []
        for x, z in points:
            at = [math.floor((value - cells.corner[axis]) / h[axis]) for axis, value in ((0, x), (d - 1, z))]
            inside = all(0 <= n < cells.shape[axis] for n, axis in zip(at, (0, d - 1), strict=True))
            number = np.arange(cells.soil.size).reshape(cells.shape)
            row = number[at[0], ..., at[1]].ravel() if inside else number.ravel()[:0]
            row = row[cells.soil.ravel()[row]]
            if not row.size:
                raise ValueError(f"drain at ({x:g}, {z:g}) m lies in no soil: give points inside it")
            found.append(row)
            heights.append(np.full(row.size, z - cells.corner[-1]))
        cell, height = np.concatenate(found), np.concatenate(heights)
        full, no = np.ones(cell.size), np.zeros(cell.size, bool)
        centre, length = (np.unravel_index(cell, cells.shape)[-1] + 0.5) * h[-1], 1.0 if d == 2 else h[1]
        places = _places(Faces(cell, full * length, full, height, centre, no, no), "drain")
        air = None if head is None else series("head", head, stepped=False, above=cells.corner[-1])
        return Drain(places, jnp.asarray(radius, float), air, (h[0], h[-1]))

    return AtSide(None, make)
