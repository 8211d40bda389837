"""Files of a region: coordinates in a national grid, walls that fit the cells, features of a GeoPackage."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from fractions import Fraction
from math import floor, lcm
from pathlib import Path
from typing import TypedDict

import numpy as np

from cooperative.measure import Track
from foundation import files
from foundation.extras import extra
from foundation.text import shown
from jaxmpm import Raster, Terrain

RUN_OUT_LINE = "[terrain] run_out_line"
CLEARLY = 2.0
"""Factor between the distances of coordinates from an origin and from 0 that shows from which they are counted."""
FARTHEST = 1e5
"""Coordinate (m) from which on a surface is taken to be in a national grid."""
FINEST = 10**6
"""Largest denominator of a cell (1/m)."""
MOST_BYTES = 2**26
"""Largest size (bytes) of a file of features."""
MOST_POINTS = 20_000
"""Points of all features of a layer."""


def shift_of(origin: Sequence[float], points: np.ndarray) -> np.ndarray:
    """What to subtract from points of a file, so that they are counted from the origin of the scene.

    Args:
        origin: of the scene in the projection of its files (2,) m.
        points: of the file (n, 2) m.

    Returns:
        The origin where the points are coordinates of the projection, 0 where they are counted from it already (2,) m.

    Raises:
        ValueError: they lie about as far from the origin as from 0.
    """
    start, middle = np.asarray(origin, float), np.asarray(points, float).mean(axis=0)
    from_origin, from_zero = float(np.linalg.norm(middle - start)), float(np.linalg.norm(middle))
    if not start.any() or CLEARLY * from_zero <= from_origin:
        return np.zeros(2)
    if CLEARLY * from_origin <= from_zero:
        return start
    raise ValueError(
        f"the middle of the file, ({middle[0]:.10g}, {middle[1]:.10g}) m, lies {from_origin:.3g} m from origin = "
        f"{list(origin)} and {from_zero:.3g} m from 0, so that it is not clear whether the origin is to be subtracted: "
        "give an origin at a corner of the file, or none"
    )


def ask_for_origin(surface: Raster) -> None:
    """Raise ValueError for a surface in a national grid, whose coordinates single precision does not resolve.

    Args:
        surface: as its file has it.
    """
    west, south = (floor(low / 100) * 100 for low, _ in surface.ends)
    if max(abs(west), abs(south)) > FARTHEST:
        raise ValueError(
            f"[terrain] surface begins at x = {surface.ends[0][0]:.10g} m and y = {surface.ends[1][0]:.10g} m, in a "
            f"national grid: add origin = [{west:.1f}, {south:.1f}], which is subtracted; walls, lines and elements at "
            "risk are then counted from it"
        )


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


class Feature(TypedDict):
    """A line or polygon of a file: its name, and its points [x, y] (m)."""

    name: str
    points: list[list[float]]


def read_features(path: Path, layer: str | None) -> list[Feature]:
    """Lines and polygons of a GeoPackage, by geopandas (extra "region").

    Args:
        path: of the file.
        layer: of it, None for its only one.

    Returns:
        Of each feature its `name` (the column of that name, else its number) and its `points` in the plan.

    Raises:
        ValueError: the library is not installed, the file cannot be read, or has no lines and polygons in metres.
    """
    geopandas, pyogrio = (
        extra(name, f"{path.name} is a GeoPackage, which geopandas reads", "geopandas pyogrio")
        for name in ("geopandas", "pyogrio")
    )
    data = files.read_given(path, MOST_BYTES)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # that bytes have no suffix
            layers = [str(name) for name in pyogrio.list_layers(data)[:, 0]]
            known = layer in layers or (layer is None and len(layers) == 1)
            frame = geopandas.read_file(data, layer=layer or layers[0]) if known else None
    except (pyogrio.errors.DataSourceError, ValueError) as error:
        raise ValueError(f"{path} cannot be read as a GeoPackage: {shown(str(error))}") from error
    if frame is None:
        raise ValueError(f"{path} has the layers {', '.join(layers)}: give one of them, {path.name}#{layers[0]}")
    if frame.crs is not None and not frame.crs.is_projected:
        raise ValueError(
            f"{path} is in degrees: project it to the metres of the surface first, e.g. with ogr2ogr -t_srs"
        )
    features: list[Feature] = []
    for number, (shape, row) in enumerate(zip(frame.geometry, frame.to_dict("records"), strict=True), 1):
        parts = getattr(shape, "geoms", [shape])
        kind = "nothing" if shape is None else shape.geom_type
        if shape is None or shape.is_empty or len(parts) != 1 or "Point" in kind:
            raise ValueError(f"{path}: feature {number} is {kind}: give lines and polygons, each of one part")
        line = getattr(parts[0], "exterior", parts[0])
        points = [[float(x), float(y)] for x, y, *_ in line.coords]
        features.append({"name": str(row.get("name") or number), "points": points[: -1 if line.is_ring else None]})
    if not 0 < sum(len(each["points"]) for each in features) <= MOST_POINTS:
        raise ValueError(
            f"{path} has no features, or more than {MOST_POINTS} points: give the few that the scene needs"
        )
    return features


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
    for number, point in enumerate(points, 1):
        if len(point) != 2:
            raise ValueError(f"{RUN_OUT_LINE}: point {number} is {list(point)}: give [x, y] in metres")
        for axis, at, (low, high) in zip("xy", point, shape.walls, strict=True):
            if not low <= at <= high:
                raise ValueError(
                    f"{RUN_OUT_LINE}: point {number} has {axis} = {at:g} m, outside the ground, which reaches from "
                    f"{low:g} to {high:g} m: move it, it goes on straight beyond its ends"
                )
    try:
        return Track(tuple((x, y) for x, y in points))
    except ValueError as error:
        raise ValueError(f"{RUN_OUT_LINE}: {error}") from error
