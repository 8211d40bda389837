"""Lines of a section in files: points as CSV, and polylines of a drawing in DXF."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from foundation import files
from foundation.extras import extra
from foundation.text import shown

if TYPE_CHECKING:
    from ezdxf.document import Drawing

MOST_BYTES = {"csv": 1_000_000, "dxf": 2**25}
"""Largest size (bytes) of a file of points, and of a drawing."""

MOST_POINTS = 10_000
"""Largest number of points of a line."""

METRES, NO_UNIT = 6, 0
"""Codes of a DXF drawing's unit ($INSUNITS) for metres, and for no unit."""

FLAT = 1e-6
"""Largest distance (m) of the points of an upright or a level line in space from its plane."""


def read_line(path: str | Path, layer: str | None = None) -> list[list[float]]:
    """Points of a line from a CSV file or a DXF drawing.

    A CSV file has x and z on each row, and may have a row of headings. A DXF drawing, which `ezdxf` reads (extra
    "sections"), has one polyline, with x to the right and the height as y, or as z if its line stands upright in space.
    A drawing without a unit is taken in metres. A polyline may run from right to left.

    Args:
        path: of the file.
        layer: of the drawing, which has one polyline in it; None if the whole drawing has one.

    Returns:
        Points [x, z] in metres.

    Raises:
        ValueError: If the file has no such line or several, is incomplete, or has arcs, outlines or lengths in another
            unit.
    """
    path = Path(path)
    if path.suffix.lower() == ".dxf":
        points = _polyline(path, layer)
    elif layer is not None:
        raise ValueError(f"{path} is no DXF drawing, which alone has layers: leave out layer = {shown(layer)}")
    else:
        points = _rows(path)
    if not 2 <= len(points) <= MOST_POINTS:
        raise ValueError(f"{path} holds {len(points)} points: give 2 to {MOST_POINTS}")
    return points


def _rows(path: Path) -> list[list[float]]:
    try:
        lines = files.read_given(path, MOST_BYTES["csv"]).decode("utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        raise ValueError(f"{path} is no text in UTF-8 (byte {error.start}): give x and z as CSV") from error
    points: list[list[float]] = []
    for number, line in enumerate(lines, 1):
        entries = re.split(r"[;,\s]+", line.strip(" ,;\t"))
        if entries == [""] or line.startswith("#"):
            continue
        try:
            points.append([float(entry) for entry in entries])
        except ValueError as error:
            if points or number > 1 or any(re.fullmatch(r"[-+.\d][\d.e+-]*", entry) for entry in entries):
                raise ValueError(f"{path}, line {number} is {shown(line)}: give x and z, two numbers") from error
            if re.search(r"(feet|foot|\bft\b|_ft)", line.lower()):
                raise ValueError(f"{path} has headings {shown(line)}: give x and z in metres, not in feet") from error
            continue
        if len(entries) != 2 or not np.isfinite(points[-1]).all():
            raise ValueError(f"{path}, line {number} is {shown(line)}: give two finite numbers, x and z")
    return points


def _polyline(path: Path, layer: str | None) -> list[list[float]]:
    """The points of the one polyline of a layer, from left to right."""
    drawing = _drawing(path)
    units = drawing.header.get("$INSUNITS", NO_UNIT)
    if units not in (METRES, NO_UNIT):
        unit = _unit(units)
        raise ValueError(
            f"{path} is drawn in {unit} ($INSUNITS = {shown(units)}): scale it to metres in the drawing program, and "
            "set its units to metres"
        )
    lines = list(drawing.modelspace().query("LWPOLYLINE POLYLINE LINE"))
    if layer is not None:
        named = [line for line in lines if line.dxf.layer.lower() == layer.lower()]
        if not named:
            layers = sorted({line.dxf.layer for line in lines})
            raise ValueError(
                f"{path} has no polyline in a layer {shown(layer)}; layers with some: "
                f"{', '.join(map(shown, layers[:8])) or 'none'} (blocks are not looked into: explode them)"
            )
        lines = named
    if len(lines) != 1:
        where = "" if layer is None else f" in its layer {shown(layer)}"
        layers = sorted({line.dxf.layer for line in lines})
        remedy = "draw one" if not lines else "join them, or delete the others"
        if layer is None and len(layers) > 1:
            remedy = f"name its layer, as in {path.name}#{layers[0]} (layers: {', '.join(map(shown, layers[:8]))})"
        raise ValueError(f"{path} has {len(lines)} polylines{where}, and the line is one: {remedy}")
    return _flat(path, np.array(list(_vertices(path, lines[0])), float).reshape(-1, 3))


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
    if line.is_closed:
        raise ValueError(f"{where} is closed: give the open line, from wall to wall")
    if line.has_arc:
        raise ValueError(f"{where} has arcs: turn them into straight pieces in the drawing program")
    yield from map(tuple, line.vertices_in_wcs() if line.dxftype() == "LWPOLYLINE" else line.points_in_wcs())


def _flat(path: Path, points: np.ndarray) -> list[list[float]]:
    """Points [x, height] from left to right, of points (n, 3) with a constant y or z."""
    if not np.isfinite(points).all():
        raise ValueError(f"the polyline of {path} has points that are not finite: draw it again")
    across, up = np.ptp(points[:, 1:], axis=0) if len(points) else (0.0, 0.0)
    if min(across, up) > FLAT:
        raise ValueError(
            f"the polyline of {path} runs through space, {across:g} m along y and {up:g} m along z: draw the section "
            "flat, x to the right and the height as y"
        )
    line = points[:, [0, 1]] if up <= FLAT else points[:, [0, 2]]
    return (line[::-1] if len(line) and line[0, 0] > line[-1, 0] else line).tolist()
