"""Lines of a section in files: points in tables of text, and polylines of a drawing in DXF."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxmpm.support import check, files
from jaxmpm.support.extras import extra
from jaxmpm.support.table import LENGTHS, Table, measured, number, read_table, scale_of, table_of
from jaxmpm.support.text import shown

if TYPE_CHECKING:
    from ezdxf.document import Drawing

MOST_BYTES = {"csv": 1_000_000, "dxf": 2**25}
"""Largest size (bytes) of a file of points, and of a drawing."""

MOST_POINTS = 10_000
"""Largest number of points of a line."""

NO_UNIT = 0
UNITS = {NO_UNIT: 1.0} | {
    code: LENGTHS[unit]
    for code, unit in {1: "in", 2: "ft", 4: "mm", 5: "cm", 6: "m", 7: "km", 10: "yd", 14: "dm", 21: "usft"}.items()
}
"""Metres of a DXF drawing's unit, by its code ($INSUNITS)."""

SHORTEST = 1.0
"""Length (m) below which a line in a unit shorter than a metre betrays that the drawing is in another."""

MEETING = 1e-6
"""Largest distance (m) of the ends of two pieces of one line."""

HEADINGS = {
    "x": ("x", "distance", "dist", "chainage", "station", "horizontal_distance", "abstand", "afstand", "distancia"),
    "y": ("y",),
    "z": ("z", "elevation", "elev", "height", "level", "altitude", "höhe", "hoehe", "hoogte", "cota", "cote"),
}
"""Headings of a line's columns, for each axis."""

FLAT = 1e-6
"""Largest distance (m) of the points of an upright or a level line in space from its plane."""


def read_line(path: str | Path, layer: str | None = None, *, outline: bool = True) -> list[list[float]]:
    r"""Points of a line from a table of text or a DXF drawing.

    A table has the columns x and z, in any order where headings name them: x is called x, distance, chainage or
    station, and z is called z, elevation, height, level or, beside x alone, y. Units in brackets or in a row below are
    converted to metres. Without headings the two columns are x and z in metres.

    A DXF drawing, which `ezdxf` reads (extra "sections"), has one line, with x to the right and the height as y, or
    as z if its line stands upright in space. Pieces that meet are joined. The drawing's unit is converted to metres; a
    drawing without a unit is in metres.

    A line may run from right to left.

    Args:
        path: of the file.
        layer: of the drawing, which has one line in it; None if the whole drawing has one.
        outline: whether the line may be a closed outline, of which the upper edge is read.

    Returns:
        Points [x, z] in metres.

    Raises:
        ValueError: If the file has no such line or several, is incomplete, or has columns, units or curves that are not
            known.

    Example:
        >>> import tempfile, pathlib
        >>> import jaxmpm as mpm
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     table = pathlib.Path(folder, "line.csv")
        ...     _ = table.write_text("x,z\nm,cm\n0,400\n5,150\n")
        ...     mpm.read_line(table)
        [[0.0, 4.0], [5.0, 1.5]]
    """
    path = Path(path)
    if path.suffix.lower() == ".dxf":
        points = _read_drawing(path, layer, outline)
    elif layer is not None:
        raise ValueError(f"{path} is no DXF drawing, which alone has layers: leave out layer = {shown(layer)}")
    else:
        points = _listed(path)
    if not 2 <= len(points) <= MOST_POINTS:
        raise ValueError(f"{path} holds {len(points)} points: give 2 to {MOST_POINTS}")
    return points[:: -1 if points[0, 0] > points[-1, 0] else 1].tolist()


def _listed(path: Path) -> np.ndarray:
    """Points (n, 2) of a table of text."""
    table = read_table(path, MOST_BYTES["csv"])
    columns, scales = _columns(table)
    points = np.empty((len(table.rows), 2))
    for k, (line, row) in enumerate(zip(table.lines, table.rows, strict=True)):
        points[k] = np.array([number(row[columns[0]]), measured(row[columns[1]])]) * scales
        if not np.isfinite(points[k]).all():
            raise ValueError(
                f"{path}, line {line} has {', '.join(shown(row[column]) for column in columns)}: give x and z, two "
                "finite numbers"
            )
    return points


def _columns(table: Table) -> tuple[tuple[int, int], tuple[float, float]]:
    """Columns of x and z, and the metres of their units."""
    named = _named(table.names, table.units)
    if not table.header:
        # Some programs write the headings in a comment, where any other words may stand too.
        marked = table_of(table.path, "\t".join(table.remark))
        named = _named(marked.names, marked.units) if len(marked.names) == table.width else {}
        if not named.keys() >= {"x", "z"}:
            if table.width != 2 and table.rows:
                raise ValueError(
                    f"{table.path}, line {table.lines[0]} has {table.width} columns: give two, x and z, or name them "
                    "in a first row; part columns by semicolons if commas mark decimals"
                )
            return (0, 1), (1.0, 1.0)
    if "y" in named and "z" not in named:
        named["z"] = named.pop("y")
    if "y" in named or not named.keys() >= {"x", "z"}:
        raise ValueError(
            f"{table.path} has the headings {shown(list(table.header or table.remark))}: name the distance along the "
            "section x and the elevation z, as in x [m], z [m]"
        )
    left_out = [name for k, name in enumerate(table.names) if name and all(k != column for column, _ in named.values())]
    if left_out:
        check.warn(f"{table.path}: columns beside x and z are not read: {', '.join(map(shown, left_out))}")
    columns, scales = zip(*(named[axis] for axis in ("x", "z")), strict=True)
    return columns, scales


def _named(names: Sequence[str], units: Sequence[str | None]) -> dict[str, tuple[int, float]]:
    """Column and metres of its unit of each axis that a heading names; a unit may follow a name, as in x_mm."""
    found: dict[str, tuple[int, float]] = {}
    for column, (name, unit) in enumerate(zip(names, units, strict=False)):
        words = re.split(r"[\s_,/]+", name.strip().lower())
        if unit is None and len(words) > 1 and words[-1] in LENGTHS:
            unit = words.pop()
        axis = next((axis for axis, headings in HEADINGS.items() if "_".join(words) in headings), None)
        if axis is None:
            continue
        if axis in found:
            raise ValueError(f"two columns are headed as {axis}, the second {shown(name)}: leave one out")
        found[axis] = column, 1.0 if unit is None else scale_of(f"the column {shown(name)}", unit)
    return found


def _read_drawing(path: Path, layer: str | None, outline: bool) -> np.ndarray:
    """Points (n, 2) m of the one line of a layer of a drawing."""
    drawing = _drawing(path)
    unit = drawing.header.get("$INSUNITS", NO_UNIT)
    if unit not in UNITS:
        raise ValueError(
            f"{path} is drawn in {_unit(unit)} ($INSUNITS = {shown(unit)}): scale it to metres in the drawing program, "
            "and set its units to metres"
        )
    space = drawing.modelspace()
    lines, others = list(space.query("LWPOLYLINE POLYLINE LINE")), list(space.query("INSERT SPLINE ARC ELLIPSE MLINE"))
    if layer is not None:
        named = [line for line in lines if line.dxf.layer.lower() == layer.lower()]
        if not named:
            raise ValueError(
                f"{path} has no polyline in a layer {shown(layer)}; layers with some: {_layers(lines) or 'none'}"
                f"{_curves(others)}"
            )
        lines = named
    layers = {line.dxf.layer for line in lines}
    pieces = [np.array(list(_vertices(path, line)), float).reshape(-1, 3) * UNITS[unit] for line in lines]
    joined = pieces if len(layers) > 1 else _joined(pieces)
    if len(joined) != 1:
        where = "" if layer is None else f" in its layer {shown(layer)}"
        remedy = "draw one" if not lines else "join them, so that each begins where another ends, or delete the others"
        if layer is None and len(layers) > 1:
            remedy = f"name its layer, as in {path.name}#{min(layers)} (layers: {_layers(lines)})"
        beside = "" if lines else _curves(others)
        raise ValueError(f"{path} has {len(joined)} polylines{where}, and the line is one: {remedy}{beside}")
    line = _flat(path, joined[0])
    length = np.ptp(line[:, 0])
    if UNITS[unit] < 1 and length < SHORTEST:
        raise ValueError(
            f"{path} is drawn in {_unit(unit)} ($INSUNITS = {unit}), so that the line is {length:g} m long: set the "
            "drawing's units to those that it is drawn in"
        )
    if unit == NO_UNIT:
        check.warn(
            f"{path} states no unit ($INSUNITS) and is taken in metres: its line is {length:g} m long and "
            f"{np.ptp(line[:, 1]):g} m high"
        )
    if not _closed(line):
        return line
    if not outline:
        raise ValueError(f"the line of {path} is closed: give the open line, from wall to wall")
    return _upper(path, line)


def _layers(lines: Sequence[Any]) -> str:
    return ", ".join(map(shown, sorted({line.dxf.layer for line in lines})[:8]))


def _curves(others: Sequence[Any]) -> str:
    """The end of a message: what the drawing has in place of polylines."""
    blocks = sorted({entity.dxf.name for entity in others if entity.dxftype() == "INSERT"})
    curves = sorted({entity.dxftype().lower() for entity in others if entity.dxftype() != "INSERT"})
    words = f"; it has the block {', '.join(map(shown, blocks[:8]))}: explode it" if blocks else ""
    return f"{words}; it has a curve ({', '.join(curves)}): turn it into a polyline" if curves else words


def _joined(pieces: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Lines (n, 3) of pieces, each joined to the one that begins or ends where it does."""
    remaining, lines = list(pieces), []
    while remaining:
        line = remaining.pop(0)
        while not _closed(line):
            ends = [
                (k, piece[::turn], front)
                for k, piece in enumerate(remaining)
                for front, at in ((False, line[-1]), (True, line[0]))
                for turn in (1, -1)
                if np.linalg.norm(piece[::turn][-1 if front else 0] - at) <= MEETING
            ]
            if not ends:
                break
            k, piece, front = ends[0]
            del remaining[k]
            line = np.concatenate([piece, line[1:]] if front else [line, piece[1:]])
        lines.append(line)
    return lines


def _closed(line: np.ndarray) -> bool:
    """Whether a line (n, d) ends where it begins."""
    return len(line) > 2 and bool(np.linalg.norm(line[0] - line[-1]) <= MEETING)


def _upper(path: Path, ring: np.ndarray) -> np.ndarray:
    """The upper edge (n, 2) of a closed line (m, 2), from its left end to its right one."""
    ring, (left, right) = ring[:-1], (ring[:, 0].min(), ring[:, 0].max())
    # Of an upright side the edge begins at its top.
    first, last = (
        max(np.flatnonzero(np.abs(ring[:, 0] - x) <= MEETING), key=lambda k: ring[k, 1]) for x in (left, right)
    )
    turned = np.roll(ring, -first, axis=0)
    k = (last - first) % len(ring)
    sides = turned[: k + 1], np.r_[turned[k:], turned[:1]][::-1]
    above = [float(np.trapezoid(side[:, 1], side[:, 0])) for side in sides]
    if not abs(above[0] - above[1]) > MEETING * (right - left):
        raise ValueError(f"the outline of {path} encloses nothing: draw the line once")
    return sides[int(np.argmax(above))]


def _drawing(path: Path) -> Drawing:
    ezdxf = extra("ezdxf", f"{path} is a DXF drawing, which ezdxf reads")
    files.read_given(path, MOST_BYTES["dxf"])  # refuses links, pipes and files that are too large
    try:
        return ezdxf.filemanagement.readfile(path)
    except Exception as error:  # the library raises any type of error for a damaged drawing
        raise ValueError(f"{path} cannot be read as a DXF drawing: {shown(str(error)) or 'it ends early'}") from error


def _unit(number: int) -> str:
    from ezdxf.enums import InsertUnits

    try:
        return InsertUnits(number).name.lower()
    except ValueError:
        return "an unknown unit"


def _vertices(path: Path, line: Any) -> Iterator[tuple[float, float, float]]:
    """Points (x, y, z) of a polyline in the axes of the drawing."""
    if line.dxftype() == "LINE":
        yield from (tuple(line.dxf.start), tuple(line.dxf.end))
        return
    where = f"the polyline of {path} in layer {shown(line.dxf.layer)}"
    if line.dxftype() == "POLYLINE" and not (line.is_2d_polyline or line.is_3d_polyline):
        raise ValueError(f"{where} is a mesh: give a line")
    if line.has_arc:
        raise ValueError(f"{where} has arcs: turn them into straight pieces in the drawing program")
    points = list(map(tuple, line.vertices_in_wcs() if line.dxftype() == "LWPOLYLINE" else line.points_in_wcs()))
    yield from (points + points[:1] if line.is_closed and points[:1] != points[-1:] else points)


def _flat(path: Path, points: np.ndarray) -> np.ndarray:
    """Points [x, height] of points (n, 3) with a constant y or z."""
    if not np.isfinite(points).all():
        raise ValueError(f"the polyline of {path} has points that are not finite: draw it again")
    across, up = np.ptp(points[:, 1:], axis=0) if len(points) else (0.0, 0.0)
    if min(across, up) > FLAT:
        raise ValueError(
            f"the polyline of {path} runs through space, {across:g} m along y and {up:g} m along z: draw the section "
            "flat, x to the right and the height as y"
        )
    line = points[:, [0, 1]] if up <= FLAT else points[:, [0, 2]]
    return line
