"""Files of a region: coordinates in a national grid, walls that fit the cells, the run-out line."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from math import floor, lcm

import numpy as np

from cooperative.measure import Track
from jaxmpm import Raster, Terrain
from jaxmpm.support.check import Invalid, at

CLEARLY = 2.0
"""Factor between the distances of coordinates from an origin and from 0 that shows from which they are counted."""
FARTHEST = 1e5
"""Coordinate (m) from which on a surface is taken to be in a national grid."""
FINEST = 10**6
"""Largest denominator of a cell (1/m)."""


def shift_of(origin: Sequence[float], points: np.ndarray) -> np.ndarray:
    """What to subtract from points of a file, so that they are counted from the origin of the scene.

    Args:
        origin: of the scene in the projection of its files (d,) m.
        points: of the file (n, d) m.

    Returns:
        The origin where the points are coordinates of the projection, 0 where they are counted from it already (d,) m.

    Raises:
        ValueError: they lie about as far from the origin as from 0.
    """
    start, middle = np.asarray(origin, float), np.asarray(points, float).mean(axis=0)
    from_origin, from_zero = float(np.linalg.norm(middle - start)), float(np.linalg.norm(middle))
    if not start.any() or CLEARLY * from_zero <= from_origin:
        return np.zeros(start.size)
    if CLEARLY * from_origin <= from_zero:
        return start
    where = ", ".join(f"{coordinate:.10g}" for coordinate in middle)
    raise Invalid(
        (),
        None,
        f"the middle of the file, ({where}) m, lies {from_origin:.3g} m from origin = {list(origin)} and "
        f"{from_zero:.3g} m from 0, so that it is not clear whether the origin is to be subtracted",
        "give an origin at a corner of the file, or none",
    )


def national_origin(surface: Raster) -> tuple[float, float] | None:
    """A round origin near the corner of a surface in a national grid, None for one that needs none.

    Args:
        surface: as its file has it.
    """
    west, south = (float(floor(low / 100) * 100) for low, _ in surface.ends)
    return (west, south) if max(abs(west), abs(south)) > FARTHEST else None


def ask_for_origin(surface: Raster) -> None:
    """Raise ValueError for a surface in a national grid, whose coordinates single precision does not resolve.

    Args:
        surface: as its file has it.
    """
    origin = national_origin(surface)
    if origin is not None:
        raise Invalid(
            ("surface",), None,
            f"begins at x = {surface.ends[0][0]:.10g} m and y = {surface.ends[1][0]:.10g} m, in a national grid",
            f"add origin = {list(origin)}, which is subtracted from it and from other files; walls and other numbers "
            "of the scene are then counted from it",
        )  # fmt: skip


def ask_for_origin_of_section(surface: Sequence[Sequence[float]]) -> None:
    """Raise ValueError for the surface of a section in a national grid, likewise.

    Args:
        surface: its points [x, z] (m).
    """
    start = surface[0][0]
    if max(abs(start), abs(surface[-1][0])) > FARTHEST:
        raise Invalid(
            ("surface",), None, f"begins at x = {start:.10g} m, in a national grid",
            f"add origin = {floor(start / 100) * 100:.1f}, which is subtracted from x of files, and count all other x "
            "from it",
        )  # fmt: skip


def between_cells(ends: tuple[float, float], cells: Sequence[float]) -> tuple[float, float]:
    """The ends, the upper one so much lower that their distance is a multiple of all cells.

    Args:
        ends: of the ground along an axis (m).
        cells: of the grids (m).
    """
    parts = [Fraction(cell).limit_denominator(FINEST) for cell in cells]
    bottom = lcm(*(part.denominator for part in parts))
    step = lcm(*(int(part * bottom) for part in parts)) / bottom
    count = floor((ends[1] - ends[0]) / step + 1e-6)
    return (ends[0], ends[0] + count * step) if count else ends


def track_of(points: Sequence[Sequence[float]], shape: Terrain) -> Track | None:
    """The run-out line, between the walls.

    Args:
        points: of it (n, 2) m, none without.
        shape: of the ground.

    Raises:
        ValueError: it leaves the ground, or is no line.
    """
    if not points:
        return None
    with at("run_out_line"):
        for number, point in enumerate(points, 1):
            if len(point) != 2:
                raise Invalid((), None, f"has a point {number} = {list(point)}", "give [x, y] in metres")
            for axis, x, (low, high) in zip("xy", point, shape.walls, strict=True):
                if not low <= x <= high:
                    raise Invalid(
                        (), None,
                        f"has a point {number} at {axis} = {x:g} m, outside the ground, which reaches from {low:g} to "
                        f"{high:g} m",
                        "move it, it goes on straight beyond its ends",
                    )  # fmt: skip
        return Track(tuple((x, y) for x, y in points))
