"""Polygons in plan that bound the part of a terrain to model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import product

import numpy as np
import shapely

from jaxmpm.ground._raster import Raster
from jaxmpm.support.text import shown

ROUNDING = 1e-6
"""Distance from a wall, over its length, within which an edge lies on it."""

Corners = Sequence[Sequence[float]]
"""Corners (x, y) of a polygon in plan (m)."""


def check_polygon(polygon: Corners, walls: Sequence[tuple[float, float]]) -> None:
    """Refuse corners that enclose nothing, or lie beyond the walls.

    Args:
        polygon: corners.
        walls: positions of the walls along x and along y (m).

    Raises:
        ValueError: If there are fewer than three corners, edges cross, or a corner lies beyond a wall.
    """
    if len(polygon) < 3 or any(len(corner) != 2 or not np.isfinite(corner).all() for corner in polygon):
        raise ValueError(f"polygon = {shown(polygon)}: give three or more corners [x, y] in metres")
    corners = np.array(polygon, float)
    area = shapely.Polygon(corners)
    if not area.is_valid or area.area == 0:
        raise ValueError(f"the polygon encloses nothing, or crosses itself ({shapely.is_valid_reason(area)}): "
                         "give its corners in order")  # fmt: skip
    for axis, at, (low, high) in zip("xy", corners.T, walls, strict=True):
        if at.min() < low or at.max() > high:
            raise ValueError(
                f"the polygon reaches from {axis} = {at.min():g} to {at.max():g} m, beyond the walls at {low:g} "
                f"and {high:g} m: draw it between them"
            )


def in_polygon(polygon: Corners, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Whether points at x and y (m), of any shape, lie in a polygon."""
    return np.asarray(shapely.contains_xy(shapely.Polygon(polygon), x, y))


@lru_cache(maxsize=16)
def filled_beyond(raster: Raster, polygon: tuple[tuple[float, float], ...]) -> Raster:
    """A raster with the nearest height in each hole that no height within a polygon is interpolated from.

    Args:
        raster: heights.
        polygon: corners.

    Returns:
        Raster.
    """
    from scipy.ndimage import distance_transform_edt  # loads what only polygons need

    holes = ~np.isfinite(raster.heights)
    if not holes.any() or holes.all():
        return raster
    squares = holes[:-1, :-1] | holes[1:, :-1] | holes[:-1, 1:] | holes[1:, 1:]
    i, j = np.nonzero(squares)
    west, south = raster.corner[0] + i * raster.step, raster.corner[1] + j * raster.step
    area = shapely.Polygon(polygon)
    shapely.prepare(area)
    used = shapely.intersects(area, shapely.box(west, south, west + raster.step, south + raster.step))
    needed = np.zeros(holes.shape, bool)
    for across, up in product((0, 1), repeat=2):
        needed[i[used] + across, j[used] + up] = True
    nearest = distance_transform_edt(holes, return_distances=False, return_indices=True)
    filled = np.where(holes & ~needed, raster.heights[tuple(nearest)], raster.heights)
    return replace(raster, heights=filled)


def beyond_edge(
    polygon: Corners, walls: Sequence[tuple[float, float]], x: np.ndarray, y: np.ndarray, within: float
) -> np.ndarray:
    """Whether points at x and y (m), of any shape, lie outside a polygon, or nearer than `within` (m) to its edge.

    An edge along a wall does not count: the wall is the constraint. ValueError where this holds for all points.
    """
    (west, east), (south, north) = walls
    inner = shapely.box(west, south, east, north).buffer(-ROUNDING * min(east - west, north - south))
    edge = shapely.Polygon(polygon).exterior.intersection(inner)
    beyond = ~in_polygon(polygon, x, y) | (shapely.distance(edge, shapely.points(x, y)) < within)
    if beyond.all():
        raise ValueError(
            f"the fixed edge of the polygon holds all soil in it, which is no wider than cells of {2 * within:.3g} m: "
            "draw it wider, or take smaller cells"
        )
    return beyond
