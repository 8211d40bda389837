"""Pore pressure in time that another program has computed: heads at points, or heights of the water table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import LinearNDInterpolator
from scipy.spatial import Delaunay, QhullError, cKDTree

from jaxmpm.ground import WATER_WEIGHT, Ground, Raster
from jaxmpm.seepage._cells import cells_under
from jaxmpm.seepage._series import TIMES, in_unit
from jaxmpm.support import check
from jaxmpm.support.table import LENGTHS, Table, measured, number, plain_unit, read_table
from jaxmpm.support.text import shown
from jaxmpm.support.values import by_value

Values = NDArray[np.floating]

PRESSURES = {
    "pa": 1.0,
    "kpa": 1e3,
    "mpa": 1e6,
    "n/m2": 1.0,
    "kn/m2": 1e3,
    "bar": 1e5,
    "psi": 6894.757,
    "psf": 47.880259,
}
"""Pascals of each unit of pressure, by its name as `plain_unit` writes it."""

AXES = {
    "x": ("x", "distance", "chainage", "easting"),
    "y": ("y", "northing"),
    "z": ("z", "elevation", "level", "height"),
}
TIME = ("t", "time")
QUANTITIES = {
    "total_head": ("total_head", "head", "hydraulic_head", "h"),
    "pressure_head": ("pressure_head", "psi"),
    "pressure": ("pressure", "pore_pressure", "pore_water_pressure", "pwp", "u"),
}
"""Headings of each column of a table of points."""

GAP = 0.25
"""Distance over the height of the ground up to which a cell of it may lie from the nearest point of a table."""
PROBED = 24
"""Cells of the ground along each axis at which a table is compared with it."""


class HeadsAt(Protocol):
    """Pressure heads at one time."""

    def at(self, position: Values) -> Any:
        """Pressure heads (N,) m at points (d, N) m, below 0 under suction."""


class PressureInTime(Protocol):
    """Pore pressure at points and times: a `Flow` or a `PressureTable`."""

    @property
    def times(self) -> Any:
        """Times (n,) s between which the pressure is known."""

    def heads(self, time: float) -> HeadsAt:
        """Pressure heads at a time (s), linear between the times."""

    def pressure(self, position: Values, time: float, unit_weight: float = WATER_WEIGHT) -> Any:
        """Pore pressures (N,) Pa at points (d, N) m at a time (s), below 0 under suction."""


class _TotalHeads(Protocol):
    """Total heads of a table at one of its times."""

    @property
    def dimension(self) -> int:
        """Coordinates of a point."""

    def total(self, position: Values) -> Values:
        """Total heads (N,) m at points (d, N) m."""


@dataclass(frozen=True, eq=False)
class _Points:
    """Total heads (n,) m at points (n, d) m."""

    points: Values
    heads: Values
    triangles: Delaunay

    @property
    def dimension(self) -> int:
        return self.points.shape[1]

    @cached_property
    def tree(self) -> cKDTree:
        return cKDTree(self.points)

    def total(self, position: Values) -> Values:
        """Linear in the triangles or tetrahedra between the points; that of the nearest point beyond them."""
        inside = LinearNDInterpolator(self.triangles, self.heads)(position.T)
        beyond = np.isnan(inside)
        if beyond.any():
            inside[beyond] = self.heads[self.tree.query(position.T[beyond])[1]]
        return inside


@dataclass(frozen=True)
class _Surface:
    """A water table over a plan, below which water is at rest along each upright line."""

    raster: Raster
    dimension: int = 3

    def check_ground(self, ground: Ground, place: Values, time: float) -> None:
        """Check that there is a height wherever there is ground.

        Args:
            ground: whose water table it is said to be.
            place: points of the ground (d, n) m.
            time: s, for the message.

        Raises:
            ValueError: If there is none somewhere.
        """
        low, high = _corners(ground)
        points = self.raster.points()
        holes = points[:, np.isnan(self.raster.heights).ravel()]
        holes = holes[:, ((low[:2, None] <= holes) & (holes <= high[:2, None])).all(0)]
        holes = holes[:, np.isfinite(np.asarray(ground.heights(*holes), float))]
        plan = np.hstack([holes, place[:2]])
        dry = np.isnan(self.raster.at(*plan))
        if dry.any():
            x, y = plan[:, dry.argmax()]
            raise ValueError(
                f"the water table at {time:g} s has no height at the ground's ({x:.4g}, {y:.4g}) m: its raster goes "
                f"{_box(points.T, 'xy')}, the ground {_box(_corners(ground)[:, :2], 'xy')}; fill its holes, and give "
                "heights in the coordinates of the ground, all over it"
            )

    def total(self, position: Values) -> Values:
        level = self.raster.at(*position[:2])
        if np.isnan(level).any():
            x, y = position[:2, np.argmax(np.isnan(level))]
            raise ValueError(
                f"the raster of the water table has no height at ({x:g}, {y:g}) m: give one that covers it"
            )
        return level


@by_value
@dataclass(frozen=True)
class TableHeads:
    """Heads of a table at one time.

    Args:
        before: total heads at the time before.
        after: total heads at the time after.
        share: of the interval that has passed.
    """

    before: _TotalHeads
    after: _TotalHeads
    share: float

    def at(self, position: ArrayLike) -> Values:
        """Pressure heads at points.

        Args:
            position: (d, N) m.

        Returns:
            (N,) m, below 0 under suction.
        """
        place = np.asarray(position, float)
        if place.ndim != 2 or len(place) != self.before.dimension:
            raise ValueError(f"position has shape {place.shape}: give ({self.before.dimension}, N)")
        total = (1 - self.share) * self.before.total(place)
        if self.share:
            total = total + self.share * self.after.total(place)
        return total - place[-1]


@by_value
@dataclass(frozen=True, eq=False)
class PressureTable:
    """Pore pressure in time from another program, with the seam of a `Flow`.

    Total heads are interpolated, so that water at rest is exact: in triangles or tetrahedra between the points of a
    table, and linearly between the times.

    Args:
        times: (n,) s, rising.
        total_heads: at each time, points with total heads or a water table.
    """

    times: Values
    total_heads: tuple[_TotalHeads, ...]

    @property
    def dimension(self) -> int:
        """2 of a section, 3 of a solid."""
        return self.total_heads[0].dimension

    @classmethod
    def of_points(
        cls, times: Sequence[float], points: Sequence[ArrayLike], heads: Sequence[ArrayLike]
    ) -> PressureTable:
        """A table of total heads at points.

        Args:
            times: (n,) s, rising.
            points: for each time (m, d) m.
            heads: for each time total heads (m,) m.

        Returns:
            Table.

        Raises:
            ValueError: If times do not rise, or points lie on a line or are fewer than a triangle or tetrahedron has.
        """
        check.finite("times", tuple(times), "s")
        fields: list[_TotalHeads] = []
        for time, at, total in zip(_rising(times), map(_array, points), map(_array, heads), strict=True):
            if at.ndim != 2 or at.shape[1] not in (2, 3) or total.shape != at.shape[:1]:
                raise ValueError(
                    f"points and heads at {time:g} s have shapes {at.shape} and {total.shape}: give (m, d), (m,)"
                )
            check.finite(f"points at {time:g} s", at, "m")
            check.finite(f"heads at {time:g} s", total, "m")
            last = fields[-1] if fields else None
            same = isinstance(last, _Points) and np.array_equal(last.points, at)
            fields.append(
                _Points(at, total, last.triangles if isinstance(last, _Points) and same else _joined(at, time))
            )
        return cls(np.asarray(times, float), tuple(fields))

    @classmethod
    def of_rows(cls, rows: ArrayLike) -> PressureTable:
        """A table of rows.

        Args:
            rows: (n, d + 2), each a point (m), a time (s) and the total head there (m).

        Returns:
            Table.

        Raises:
            ValueError: If two rows are of one point at one time, or as for `of_points`.
        """
        table = np.asarray(rows, float)
        if table.ndim != 2 or table.shape[1] not in (4, 5) or not len(table):
            raise ValueError(f"rows have shape {table.shape}: give (n, 4) of x, z, t and head, in 3D (n, 5)")
        points, heads = table[:, :-2], table[:, -1]
        times, number = np.unique(table[:, -2], return_inverse=True)
        at_time = [number == k for k in range(times.size)]
        for time, here in zip(times, at_time, strict=True):
            places, counts = np.unique(points[here], axis=0, return_counts=True)
            if counts.max() > 1:
                at = ", ".join(f"{x:g}" for x in places[counts.argmax()])
                raise ValueError(f"there are {counts.max()} heads at ({at}) m and {time:g} s: give one")
        return cls.of_points(times.tolist(), [points[here] for here in at_time], [heads[here] for here in at_time])

    @classmethod
    def of_rasters(cls, rasters: Mapping[float, Raster]) -> PressureTable:
        """A table of water tables in plan, under which and above which water is at rest.

        Args:
            rasters: heights of the water table (m) by time (s).

        Returns:
            Table.

        Raises:
            ValueError: If there are none, or one is no raster.
        """
        times = sorted(rasters)
        for time in times:
            rasters[time].check(f"the water table at {time:g} s")
        return cls(_rising(times), tuple(_Surface(rasters[time]) for time in times))

    def heads(self, time: float) -> TableHeads:
        """Pressure heads at a time, linear between the times.

        Args:
            time: s.

        Returns:
            Heads, which give values at points.

        Raises:
            ValueError: If the time lies outside the times.
        """
        first, last = float(self.times[0]), float(self.times[-1])
        if not first <= time <= last:
            raise ValueError(f"time = {time:g} s: the table of pore pressure goes from {first:g} to {last:g} s")
        after = min(int(np.searchsorted(self.times, time, side="right")), len(self.times) - 1)
        before = max(after - 1, 0)
        span = self.times[after] - self.times[before]
        return TableHeads(
            self.total_heads[before],
            self.total_heads[after],
            float((time - self.times[before]) / span) if span else 0.0,
        )

    def pressure(self, position: ArrayLike, time: float, unit_weight: float = WATER_WEIGHT) -> Values:
        """Pore pressure at points at a time.

        Args:
            position: (d, N) m.
            time: s, within the times.
            unit_weight: of water (N/m3).

        Returns:
            (N,) Pa, below 0 under suction.
        """
        return unit_weight * self.heads(time).at(position)

    def check_ground(self, ground: Ground) -> None:
        """Check that the table is of a ground.

        Args:
            ground: whose pore pressure it is said to be.

        Raises:
            ValueError: If it has other axes, its points or rasters lie elsewhere or leave a part of the ground out, or
                nowhere in the ground is its water at or above the base.
        """
        d = len(ground.corner)
        if d != self.dimension:
            raise ValueError(
                f"the table of pore pressure has {self.dimension} coordinates and the ground {d}: give x and z of a "
                "section, x, y and z in 3D"
            )
        edges = [edge / PROBED for edge in ground.extent]
        cells = cells_under(ground, edges)
        place = cells.centres().reshape(d, -1)[:, cells.soil.ravel()]
        axes = "xyz" if d == 3 else "xz"
        for time, field in zip(self.times, self.total_heads, strict=True):
            if isinstance(field, _Points):
                far = field.tree.query(place.T)[0]
                limit = GAP * ground.extent[-1] + float(np.hypot(edges[0], edges[1]))
                beyond = (far > limit) & (field.triangles.find_simplex(place.T) < 0)
                if beyond.any():
                    at = ", ".join(f"{x:.4g}" for x in place[:, np.argmax(np.where(beyond, far, -1))])
                    raise ValueError(
                        f"the table of pore pressure at {time:g} s has no point within {limit:.3g} m of the ground's "
                        f"({at}) m: its points go {_box(field.points, axes)}, the ground "
                        f"{_box(_corners(ground), axes)}; give points in the coordinates of the ground, all over it"
                    )
            if isinstance(field, _Surface):
                field.check_ground(ground, place, time)
            level = field.total(place)
            if level.max() < ground.corner[-1]:
                remedy = (
                    "are these depths of the water table? Give its heights"
                    if isinstance(field, _Surface)
                    else "are these pressure heads? Then name the column pressure_head"
                )
                raise ValueError(
                    f"the table's heads at {time:g} s are at most {level.max():.4g} m, below the ground's base at "
                    f"{ground.corner[-1]:g} m: total heads count from the zero of the ground's heights; {remedy}"
                )


def _array(values: ArrayLike) -> Values:
    return np.asarray(values, float)


def _rising(times: Sequence[float]) -> Values:
    at = np.asarray(times, float)
    if not at.size or np.any(np.diff(at) <= 0) or not np.isfinite(at).all():
        raise ValueError(f"times = {shown(at.tolist())} s: give one or more, rising")
    return at


def _joined(points: Values, time: float) -> Delaunay:
    """Triangles or tetrahedra between points."""
    try:
        return Delaunay(points)
    except QhullError as error:
        raise ValueError(
            f"the {len(points)} points at {time:g} s span no area (in 3D no volume): give points all over the ground"
        ) from error


def _box(points: Values, axes: str) -> str:
    """The ends of points (n, d) m along axes of these names."""
    return ", ".join(
        f"{axis} = {low:.6g} to {high:.6g} m"
        for axis, low, high in zip(axes, points.min(0), points.max(0), strict=True)
    )


def _corners(ground: Ground) -> Values:
    low = np.asarray(ground.corner, float)
    return np.stack([low, low + np.asarray(ground.extent, float)])


MOST_ROWS = 200_000
"""Rows of a table of heads."""


def read_pressure(path: str | Path, *, unit_weight: float = WATER_WEIGHT) -> PressureTable:
    """Read pore pressure in time from a table of text.

    Its first row names the columns x, z and in 3D y, the time t with its unit, and one of head (total), pressure_head
    and pressure with its unit in brackets. Each row is a point at a time. Rows of one time need not follow each other.

    Args:
        path: of the file.
        unit_weight: of water (N/m3), by which a pressure is turned into a head.

    Returns:
        Table.

    Raises:
        ValueError: If a column is missing, there twice or has no unit, or a row has a gap; the message has the line.
    """
    return PressureTable.of_rows(read_heads(path, unit_weight=unit_weight))


def read_heads(path: str | Path, *, unit_weight: float = WATER_WEIGHT) -> Values:
    """Read the rows of `read_pressure` alone.

    Args:
        path: of the file.
        unit_weight: of water (N/m3).

    Returns:
        Rows (n, d + 2) of a point (m), a time (s) and a total head (m).

    Raises:
        ValueError: As for `read_pressure`.
    """
    path = Path(path)
    if not path.is_file():
        raise ValueError(f"there is no file {path}: give a table of text with the columns x, z, t and head or pressure")
    table = read_table(path)
    if not table.header:
        raise ValueError(
            f"{path} has no row of headings: name its columns, such as x [m], z [m], t [h], pressure [kPa]"
        )
    columns = _columns(table)
    found = [name for name in QUANTITIES if name in columns]
    if len(found) != 1:
        has = f"has columns of {' and '.join(found)}" if found else "has no column of the water"
        raise ValueError(f"{path} {has}: give one of total_head [m], pressure_head [m] and pressure [kPa]")
    if missing := [name for name in ("x", "z", "t") if name not in columns]:
        raise ValueError(f"{path} has no column {', '.join(missing)}: give x, z, in 3D y, and the time t")
    if not 0 < len(table.rows) <= MOST_ROWS:
        raise ValueError(f"{path} has {len(table.rows)} rows below its header: give 1 to {MOST_ROWS}")
    values = {
        name: np.array([(measured if name in QUANTITIES else number)(row[at]) for row in table.rows]) * scale
        for name, (at, scale) in columns.items()
    }
    for name, column in values.items():
        if not np.isfinite(column).all():
            line = table.lines[int(np.argmin(np.isfinite(column)))]
            raise ValueError(f"{path}, line {line}: {name} is no number: give one in each row, or leave it out")
    axes, (name,) = [axis for axis in AXES if axis in values], found
    total = values[name] / (unit_weight if name == "pressure" else 1.0)
    total = total if name == "total_head" else total + values["z"]
    return np.stack([*(values[axis] for axis in axes), values["t"], total], axis=1)


def _columns(table: Table) -> dict[str, tuple[int, float]]:
    """Number of each known column, and what its numbers are multiplied by."""
    columns: dict[str, tuple[int, float]] = {}
    for at, (word, unit) in enumerate(zip(table.names, table.units, strict=True)):
        plain = plain_unit(word).replace("-", "_") if unit is None else word.strip().lower().replace(" ", "_")
        words_of = {**AXES, **QUANTITIES, "t": TIME}
        name = next((name for name, words in words_of.items() if plain in words), None)
        if name is None:
            check.warn(f"{table.path}: the column {shown(word)} is unknown and not read")
            continue
        if name in columns:
            raise ValueError(f"{table.path} has two columns of {name}: leave one out")
        units = TIMES if name == "t" else PRESSURES if name == "pressure" else LENGTHS
        where = f"{table.path}: column {shown(word)}"
        columns[name] = at, in_unit(where, unit, units, usual="m" if units is LENGTHS else None)
    return columns
