"""Elements at risk, the columns of cells that show what reaches them, and what they lose."""

from __future__ import annotations

import re
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import shapely

from cooperative.measure._vulnerability import Intensity, Vulnerability
from jaxmpm import Face
from jaxmpm.support.check import Invalid
from jaxmpm.support.values import by_value

UNITS: dict[str, tuple[Intensity, float]] = {
    "m": ("thickness", 1.0),
    "cm": ("thickness", 0.01),
    "m/s": ("speed", 1.0),
    "km/h": ("speed", 1 / 3.6),
}
"""What a unit measures, and how many metres, or metres per second, it is."""

TOUCH = 1e-9
"""Share of a column below which an element that overlaps it only touches it."""


@by_value
@dataclass(frozen=True)
class ColumnPlan:
    """Where the columns of cells stand, along the horizontal axes.

    Args:
        origin: low corner of the first column (k,) m.
        cell: their edge (m).
        shape: how many (k,).
        ends: of the ground that can be reached, (low, high) along each axis (m).
    """

    origin: tuple[float, ...]
    cell: float
    shape: tuple[int, ...]
    ends: tuple[tuple[float, float], ...]

    @property
    def area(self) -> float:
        """Plan area of a column (m2); in a section its length (m)."""
        return self.cell ** len(self.shape)

    def edges(self, axis: int) -> np.ndarray:
        """Edges of the columns along an axis, one more than columns (m)."""
        return self.origin[axis] + self.cell * np.arange(self.shape[axis] + 1)

    def beyond(self, face: Face | None) -> slice:
        """The columns, along x, that lie beyond the one that holds the toe.

        Args:
            face: of the slope, None for ground without a toe, all of whose columns count.
        """
        if face is None:
            return slice(0, self.shape[0])
        low, high = self.edges(0)[:-1], self.edges(0)[1:]
        beyond = np.flatnonzero(np.minimum(face.beyond(low), face.beyond(high)) >= -1e-6)
        return slice(int(beyond[0]), int(beyond[-1]) + 1) if beyond.size else slice(0, 0)

    @property
    def ground(self) -> tuple[slice, ...]:
        """The columns with ground in them: those beyond the ends hold the grid's margin."""
        slices = []
        for axis, (low, high) in enumerate(self.ends):
            edges = self.edges(axis)
            inside = np.flatnonzero((edges[1:] > low + TOUCH * self.cell) & (edges[:-1] < high - TOUCH * self.cell))
            slices.append(slice(int(inside[0]), int(inside[-1]) + 1))
        return tuple(slices)


@by_value
@dataclass(frozen=True)
class ElementAtRisk:
    """An element at risk: a road, a house.

    Args:
        name: of the element.
        corners: one point, or in a section the two ends of a stretch, or in 3D three or more corners of a polygon, in
            order (m).
        value: what stands there, in any currency.
        vulnerability: how much of it is lost; both or neither.

    Raises:
        ValueError: stretches without length and polygons that cross themselves or have no area.
    """

    name: str
    corners: tuple[tuple[float, ...], ...]
    value: float | None = None
    vulnerability: Vulnerability | None = None

    def __post_init__(self) -> None:
        if not np.isfinite(self.corners).all():
            raise ValueError(f"element at risk {self.name!r} has corners {self.corners}: give finite metres")
        if len(self.corners) == 2 and not self.corners[0] < self.corners[1]:
            (low,), (high,) = self.corners
            raise ValueError(
                f"element at risk {self.name!r} reaches from {low:g} to {high:g} m: give the lower end first"
            )
        if len(self.corners) > 2:
            for one, other in _crossings(self.corners):
                raise ValueError(
                    f"element at risk {self.name!r} crosses itself, between corners {one} and {other}: "
                    "give its corners in order"
                )
            if not shapely.Polygon(self.corners).area > 0:
                raise ValueError(f"element at risk {self.name!r} has no area: give corners that are not on one line")

    @property
    def key(self) -> str:
        """Its name in rows and tables: lower case, and underscores for all but letters and digits."""
        return re.sub(r"\W+", "_", self.name.lower()).strip("_")

    def columns(self, plan: ColumnPlan) -> np.ndarray:
        """Which columns the element overlaps, bool of the plan's shape; a point is in one.

        Raises:
            ValueError: an element that reaches beyond the ground, or has other axes than it.
        """
        corners = np.array(self.corners)
        if corners.shape[1] != len(plan.shape):
            raise ValueError(
                f"element at risk {self.name!r} is given by {corners.shape[1]} numbers, the ground has "
                f"{len(plan.shape)} horizontal axes: give [x] or [from, to] in a section, [x, y] or a polygon in 3D"
            )
        for axis, (low, high) in enumerate(plan.ends):
            out = corners[(corners[:, axis] < low) | (corners[:, axis] > high), axis]
            if out.size:
                raise ValueError(
                    f"element at risk {self.name!r} has {'xy'[axis]} = {out[0]:g} m, outside the ground, which "
                    f"reaches from {low:g} to {high:g} m: move it, or lengthen the ground"
                )
        columns = np.zeros(plan.shape, bool)
        if len(corners) == 1:
            at = np.floor((corners[0] - plan.origin) / plan.cell).astype(int)
            last = [np.searchsorted(plan.edges(axis), high) - 1 for axis, (_, high) in enumerate(plan.ends)]
            columns[tuple(np.minimum(at, last))] = True
            return columns
        edges = [plan.edges(axis) for axis in range(len(plan.shape))]
        if len(plan.shape) == 1:
            shared = np.minimum(edges[0][1:], corners[1, 0]) - np.maximum(edges[0][:-1], corners[0, 0])
            return shared > TOUCH * plan.cell
        (x, y), polygon = np.meshgrid(*edges, indexing="ij"), shapely.Polygon(corners)
        boxes = shapely.box(x[:-1, :-1], y[:-1, :-1], x[1:, 1:], y[1:, 1:])
        return shapely.area(shapely.intersection(boxes, polygon)) > TOUCH * plan.area


def quantity(text: object) -> tuple[Intensity, float]:
    """Quantity and size of a text such as "0.5 m" or "2 m/s".

    Args:
        text: a number and its unit.

    Returns:
        "thickness" or "speed", and how much of it in m or m/s.

    Raises:
        Invalid: a number without a unit, an unknown unit, or a number that is below 0 or not finite.
    """
    names = ", ".join(UNITS)
    words = text.split() if isinstance(text, str) else []
    if len(words) != 2 or words[1] not in UNITS:
        lacks = "has no unit" if isinstance(text, int | float) or len(words) == 1 else "is no number and unit"
        raise Invalid((), repr(text), lacks, f'give one of {names}, as in "0.5 m" or "2 m/s"')
    try:
        number = float(words[0])
    except ValueError:
        number = np.nan
    if not 0 <= number < np.inf:
        raise Invalid((), repr(text), "", f"give a finite number of 0 or more, and one of {names}")
    of, size = UNITS[words[1]]
    return of, number * size


def _crossings(corners: tuple[tuple[float, ...], ...]) -> list[tuple[int, int]]:
    """Pairs of sides of a polygon that cross or touch though they are not neighbours, by their first corners from 1."""
    sides = [shapely.LineString(ends) for ends in zip(corners, (*corners[1:], corners[0]), strict=True)]
    return [
        (one + 1, other + 1)
        for one, other in combinations(range(len(sides)), 2)
        if other - one not in (1, len(sides) - 1) and sides[one].intersects(sides[other])
    ]
