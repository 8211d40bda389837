"""Cells that water flows through, and their outer faces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from jaxmpm.ground import Ground, check_ground
from jaxmpm.ground import floor as floor_of
from jaxmpm.support import check
from jaxmpm.support.text import shown
from jaxmpm.support.values import by_value

Side = Literal["surface", "base", "left", "right", "front", "back"]

SIDES: dict[Side, str] = {
    "surface": "between soil and air",
    "base": "below the soil",
    "left": "at the lower end of x",
    "right": "at the upper end of x",
    "front": "at the lower end of y",
    "back": "at the upper end of y",
}
"""Where the outer faces of each side lie."""

ENDS: dict[str, tuple[int, int]] = {"left": (0, -1), "right": (0, 1), "front": (1, -1), "back": (1, 1)}
"""Axis of the ends of the grid, and the way outwards along it."""


@by_value
@dataclass(frozen=True)
class Faces:
    """Outer faces of some cells; nf is their number.

    Args:
        cell: (nf,) number of the cell inside, counted fastest along the last axis.
        area: (nf,) m2; per metre of width in plane strain, per square metre in columns.
        distance: (nf,) from the face to the centre of its cell (m).
        z: (nf,) height of the face's centre above the cells' corner (m).
        centre: (nf,) height of the cell's centre above the cells' corner (m).
        upward: (nf,) bool, whether rain falls on it.
        level: (nf,) bool, whether water crosses it horizontally.
    """

    cell: NDArray[np.int64]
    area: NDArray[np.floating]
    distance: NDArray[np.floating]
    z: NDArray[np.floating]
    centre: NDArray[np.floating]
    upward: NDArray[np.bool_]
    level: NDArray[np.bool_]


@by_value
@dataclass(frozen=True)
class Cells:
    """A regular grid of cells, of which the active ones hold soil.

    The last axis points upwards. In one dimension the cells are a column.

    Args:
        shape: cells along each axis, (nz,), (nx, nz) or (nx, ny, nz).
        spacing: edges of a cell (m).
        corner: lowest corner of the grid (m).
        active: of that shape, whether a cell holds soil; None if all do.
    """

    shape: tuple[int, ...]
    spacing: tuple[float, ...]
    corner: tuple[float, ...]
    active: NDArray[np.bool_] | None = None

    @property
    def soil(self) -> NDArray[np.bool_]:
        """Whether a cell holds soil."""
        return np.ones(self.shape, bool) if self.active is None else self.active

    @property
    def volume(self) -> float:
        """Of one cell (m3)."""
        return float(np.prod(self.spacing))

    def centres(self) -> NDArray[np.floating]:
        """Positions (d, ...) m of the centres of the cells, in the shape of the cells."""
        axes = [low + (np.arange(n) + 0.5) * h for low, n, h in zip(self.corner, self.shape, self.spacing, strict=True)]
        return np.stack(np.meshgrid(*axes, indexing="ij"))

    def faces(self, side: Side) -> Faces:
        """Outer faces of a side; upright steps of the surface belong to it.

        Args:
            side: "surface", "base", "left", "right", "front" or "back".

        Returns:
            Faces.

        Raises:
            ValueError: If the cells have no such side.
        """
        d = len(self.shape)
        sides = [*SIDES][: 2 * d]
        if side not in sides:
            raise ValueError(f"side = {shown(side)} of cells in {d}D: give one of {', '.join(sides)}")
        parts = []
        for axis in range(d):
            for way in (-1, 1):
                beyond = _beyond(self.soil, axis, way)
                if side in ENDS:
                    on_side = (
                        _at_end(self.shape, axis, way) if ENDS[side] == (axis, way) else np.zeros(self.shape, bool)
                    )
                elif axis == d - 1:
                    on_side = np.full(self.shape, (way > 0) == (side == "surface"))
                else:
                    on_side = ~_at_end(self.shape, axis, way) & _beyond_air(self.soil, axis, way) & (side == "surface")
                parts.append(self._faces(np.flatnonzero(self.soil & beyond & on_side), axis, way))
        return _joined(parts)

    def positions(self, side: Side) -> NDArray[np.floating]:
        """Positions (d, nf) m of the centres of a side's faces, in the order of `faces`."""
        faces = self.faces(side)
        at = self.centres().reshape(len(self.shape), -1)[:, faces.cell]
        at[-1] = self.corner[-1] + faces.z
        if side in ENDS:
            axis, way = ENDS[side]
            at[axis] += way * self.spacing[axis] / 2
        return at

    def _faces(self, cell: NDArray[np.int64], axis: int, way: int) -> Faces:
        upright, h = axis == len(self.shape) - 1, self.spacing
        centre = (np.unravel_index(cell, self.shape)[-1] + 0.5) * h[-1]
        full = np.ones(cell.size)
        return Faces(
            cell=cell,
            area=full * self.volume / h[axis],
            distance=full * h[axis] / 2,
            z=centre + (way * h[-1] / 2 if upright else 0),
            centre=centre,
            upward=np.full(cell.size, upright and way > 0),
            level=np.full(cell.size, not upright),
        )


def _joined(parts: Sequence[Faces]) -> Faces:
    return Faces(*(np.concatenate([getattr(part, name) for part in parts]) for name in Faces.__dataclass_fields__))


def _at_end(shape: tuple[int, ...], axis: int, way: int) -> NDArray[np.bool_]:
    """Cells at one end of the grid."""
    ends = np.zeros(shape, bool)
    np.moveaxis(ends, axis, 0)[-1 if way > 0 else 0] = True
    return ends


def _shifted(value: NDArray[np.bool_], axis: int, way: int, beyond: bool) -> NDArray[np.bool_]:
    """The value of each cell's neighbour."""
    shifted = np.roll(value, -way, axis)
    np.moveaxis(shifted, axis, 0)[-1 if way > 0 else 0] = beyond
    return shifted


def _beyond(soil: NDArray[np.bool_], axis: int, way: int) -> NDArray[np.bool_]:
    """Cells whose neighbour holds no soil."""
    return ~_shifted(soil, axis, way, False)


def _beyond_air(soil: NDArray[np.bool_], axis: int, way: int) -> NDArray[np.bool_]:
    """Cells whose neighbour is air: no soil lies above it or in it."""
    covered = np.flip(np.logical_or.accumulate(np.flip(soil, -1), axis=-1), -1)
    return _shifted(~covered, axis, way, False)


def cells(
    extent: Sequence[float], count: Sequence[int], corner: Sequence[float] | None = None, active: object = None
) -> Cells:
    """Cells that fill a box.

    Args:
        extent: edges of the box (m), the last one upright.
        count: cells along each.
        corner: its lowest corner (m), by default 0.
        active: bool of shape `count`, whether a cell holds soil; by default all do.

    Returns:
        Cells.

    Raises:
        ValueError: If the numbers fit no box of 1 to 3 dimensions, or no cell is active.
    """
    d = len(count)
    if not 1 <= d <= 3:
        raise ValueError(f"count = {shown(tuple(count))}: give 1 to 3 numbers of cells")
    check.axes("extent", extent, d)
    check.positive("extent", tuple(extent), "m")
    for n in count:
        check.whole("count", n)
    check.axes("corner", corner := (0.0,) * d if corner is None else tuple(map(float, corner)), d)
    mask = None if active is None else np.asarray(active)
    if mask is not None and (mask.dtype != bool or mask.shape != tuple(count)):
        raise ValueError(f"active has shape {mask.shape} of {mask.dtype}: give bools of shape {tuple(count)}")
    if mask is not None and not mask.any():
        raise ValueError("no cell is active: give soil to one or more")
    spacing = tuple(float(edge) / int(n) for edge, n in zip(extent, count, strict=True))
    return Cells(tuple(map(int, count)), spacing, corner, mask)


def cells_under(ground: Ground, spacing: Sequence[float]) -> Cells:
    """Cells whose centres lie in a ground, between its surface and rigid ground.

    Args:
        ground: a `Slope`, `Section`, `Terrain`, or a user's own.
        spacing: largest edges of a cell (m), one an axis; they are shortened to fill the ground's box.

    Returns:
        Cells.

    Raises:
        ValueError: If the ground is none, or has no soil in any cell.
    """
    check_ground(ground)
    d = len(ground.corner)
    check.axes("spacing", spacing, d)
    check.positive("spacing", tuple(spacing), "m")
    count = [max(1, round(np.ceil(edge / h - 1e-9))) for edge, h in zip(ground.extent, spacing, strict=True)]
    box = cells(ground.extent, count, ground.corner)
    *plan, z = box.centres()
    flat = [axis[..., 0].ravel() for axis in plan]
    top = np.asarray(ground.heights(*flat)).reshape(plan[0].shape[:-1])
    low = np.asarray(floor_of(ground, *flat)).reshape(plan[0].shape[:-1])
    return cells(ground.extent, count, ground.corner, (z < top[..., None]) & (z > low[..., None]))
