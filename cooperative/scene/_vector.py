"""Lines and polygons of a GeoPackage, a shapefile or a GeoJSON, taken from the bytes of the file.

A library that guesses the format of a file can do more than read it: some formats name other files and hosts, run SQL
and write. Here the first bytes say what a file is, and a GeoPackage is a database in memory that reads plain tables.

Formats: OGC 12-128r17, GeoPackage 1.3; ESRI Shapefile Technical Description (1998); RFC 7946, GeoJSON, with the member
`crs` of its form of 2008.
"""

from __future__ import annotations

import codecs
import io
import json
import os
import re
import sqlite3
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TypedDict

import numpy as np
import shapely

from cooperative.scene._projection import refuse_unmetric
from jaxmpm.support import check, files
from jaxmpm.support.check import Invalid
from jaxmpm.support.extras import extra
from jaxmpm.support.text import shown

MOST_BYTES = 2**26
"""Largest size (bytes) of a file of features."""
MOST_JSON = 2**23
"""Largest size (bytes) of a GeoJSON, which takes ten times as much memory."""
MOST_VALUE = 2**22
"""Largest size (bytes) of a value in a database."""
MOST_STEPS, STEP = 5_000, 10_000
"""Steps that a query may take, and instructions of SQLite in each."""
MOST_FEATURES = 20_000
"""Features of a layer."""
MOST_POINTS = 20_000
"""Points of all features of a layer."""
ENVELOPES = (0, 32, 48, 48, 64)
"""Bytes of the box of a geometry in a GeoPackage, by its code."""
LINE, POLYGON, LINES, POLYGONS = 2, 3, 5, 6
"""Codes of geometries in well-known bytes; the last two have several parts."""
KINDS = ("LineString", "Polygon", "MultiLineString", "MultiPolygon")
"""Names of these in GeoJSON."""
WEST = 360.0
"""Coordinate beyond which a number is no longitude."""
SLIT = 1e-3
"""Width (m) of the slit that joins a hole of a polygon to its outside, so that one ring bounds it."""
METRES = "project it to the metres of the surface first, e.g. with ogr2ogr -t_srs"

Row = tuple[Mapping[str, object], shapely.Geometry | None]
"""Values of the columns of a feature, and its geometry."""


class Feature(TypedDict):
    """A line or polygon of a file: its name, its points [x, y] (m), and how many holes slits join to its outside."""

    name: str
    points: list[list[float]]
    holes: int


@dataclass(frozen=True)
class _Layer:
    """A layer as its file has it.

    Args:
        rows: its features.
        projection: as WKT, or "EPSG:" and a number; None where the file has none.
        left_out: what else the file holds, in words.
    """

    rows: Sequence[Row]
    projection: str | None
    left_out: tuple[str, ...] = ()


def read_features(path: Path, layer: str | None) -> tuple[list[Feature], str | None]:
    """Lines and polygons of a file.

    Args:
        path: of the file.
        layer: of a GeoPackage, None for its only one.

    Returns:
        Of each feature its `name` (the column of that name, else its number) and its `points` in the plan; and the
        coordinate system, None where the file has none.

    Raises:
        ValueError: a library is not installed, the file cannot be read, or has no lines and polygons in metres.
    """
    data = files.read_given(path, MOST_BYTES)
    begin = data.removeprefix(codecs.BOM_UTF8).lstrip()
    if data.startswith(b"SQLite format 3\0"):
        read = _geopackage(path, data, layer)
    elif data.startswith(b"\0\0\x27\x0a"):
        read = _shapefile(path, data)
    elif begin.startswith(b"{"):
        read = _geojson(path, data)
    else:
        raise Invalid(
            (),
            str(path),
            "is no GeoPackage, shapefile or GeoJSON by its first bytes",
            "export the features as one of these",
        )
    if layer not in (None, path.stem) and not data.startswith(b"SQLite"):
        raise Invalid((), str(path), "is no GeoPackage, which alone has layers", f"leave out #{layer}")
    if read.projection is not None:
        refuse_unmetric(str(path), read.projection)
    features = list(_features(path, read.rows))
    if not 0 < sum(len(feature["points"]) for feature in features) <= MOST_POINTS or len(features) > MOST_FEATURES:
        raise Invalid(
            (), str(path), f"has no features, or more than {MOST_POINTS} points", "give the few that the scene needs"
        )
    if read.left_out and layer is None:
        check.warn(f"{path}: {', '.join(read.left_out)} beside the layer that is read: left out")
    return features, read.projection


def _features(path: Path, rows: Iterable[Row]) -> Iterator[Feature]:
    """Each feature with its name and its points."""
    for number, (values, shape) in enumerate(rows, 1):
        parts = getattr(shape, "geoms", [shape])
        kind = "nothing" if shape is None else shape.geom_type
        if shape is None or shape.is_empty or len(parts) != 1 or kind not in KINDS:
            raise Invalid((), f"{path}: feature {number}", f"is {kind}", "give lines and polygons, each of one part")
        name = _name(values, number)
        where = f"{path}: feature {number}, {shown(name)},"
        holes = len(getattr(parts[0], "interiors", ()))
        line = _ring(where, parts[0]) if holes else getattr(parts[0], "exterior", parts[0])
        points = shapely.get_coordinates(line)
        if not np.isfinite(points).all():
            raise Invalid((), where, "has points that are not finite", "draw it again")
        yield {"name": name, "points": points[: -1 if line.is_ring else None].tolist(), "holes": holes}


def _ring(where: str, polygon: shapely.Polygon) -> shapely.LinearRing:
    """One ring around a polygon with holes, each of which the shortest slit joins to its outside."""
    if not polygon.is_valid:
        raise Invalid((), where, f"is no polygon ({shapely.is_valid_reason(polygon)})", "draw it again")
    for _ in polygon.interiors:
        if polygon.interiors:  # a slit may have met another hole on its way
            slit = shapely.shortest_line(polygon.interiors[0], polygon.exterior).buffer(SLIT / 2, quad_segs=1)
            polygon = polygon.difference(slit)
        if polygon.geom_type != "Polygon" or polygon.is_empty:
            raise Invalid((), where, f"has holes {SLIT:g} m from one another or its edge", "draw it with wider ground")
    return polygon.exterior


def _name(values: Mapping[str, object], number: int) -> str:
    """The name of a feature: its column `name`, in any case, else its number."""
    named = [value for key, value in values.items() if key.lower() == "name"]
    return str(values.get("name") or next(filter(None, named), number))


def _geopackage(path: Path, data: bytes, layer: str | None) -> _Layer:
    """A layer of a GeoPackage."""
    journal = path.with_name(f"{path.name}-wal")
    if os.path.lexists(journal) and os.lstat(journal).st_size:
        raise Invalid((), str(journal), f"holds changes that {path.name} lacks", "close the program that has it open")
    try:
        with closing(_database(data)) as database:
            return _layer(path, database, layer)
    except sqlite3.Error as error:
        raise Invalid((), str(path), "cannot be read as a GeoPackage", shown(str(error))) from error


def _database(data: bytes) -> sqlite3.Connection:
    """A database in memory whose statements read tables, and can neither call functions nor open or write anything."""
    database = sqlite3.connect(":memory:")
    # A write-ahead log would be another file.
    database.deserialize(data[:18] + b"\1\1" + data[20:])
    for setting in ("trusted_schema = OFF", "cell_size_check = ON", "query_only = ON"):
        database.execute(f"PRAGMA {setting}")
    database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MOST_VALUE)
    database.text_factory = lambda text: text.decode("utf-8", "replace")
    allowed, steps = (sqlite3.SQLITE_SELECT, sqlite3.SQLITE_READ), iter(range(MOST_STEPS))
    database.set_authorizer(lambda action, *_: sqlite3.SQLITE_OK if action in allowed else sqlite3.SQLITE_DENY)
    database.set_progress_handler(lambda: next(steps, None) is None, STEP)
    return database


def _layer(path: Path, database: sqlite3.Connection, layer: str | None) -> _Layer:
    """A layer in a plain table: a view, or a virtual table, is a program of whoever wrote it."""
    tables = database.execute("SELECT name FROM sqlite_master WHERE type = 'table' AND rootpage > 0")
    plain = {name for (name,) in islice(tables, MOST_FEATURES)}
    if not plain >= {"gpkg_contents", "gpkg_geometry_columns", "gpkg_spatial_ref_sys"}:
        raise Invalid((), str(path), "is an SQLite database, and no GeoPackage", "export the features as a GeoPackage")
    holds = islice(database.execute("SELECT table_name, data_type FROM gpkg_contents"), MOST_FEATURES)
    kinds = {str(name): str(kind) for name, kind in holds}
    columns = database.execute("SELECT table_name, column_name, srs_id FROM gpkg_geometry_columns")
    geometry = {str(name): (str(column), srs) for name, column, srs in islice(columns, MOST_FEATURES)}
    layers = [name for name, kind in kinds.items() if kind == "features" and name in plain and name in geometry]
    others = [f"{shown(name)} ({_kind(kind, name in plain)})" for name, kind in kinds.items() if name not in layers]
    name = layers[0] if layer is None and len(layers) == 1 else layer
    if name is None or name not in layers:
        remedy = f"give one of them, {path.name}#{layers[0]}" if layers else "export a table with geometry"
        beside = f" (and {', '.join(others[:8])})" if others else ""
        raise Invalid((), str(path), f"has the layers {', '.join(layers[:8]) or 'none'}{beside}", remedy)
    column, srs = geometry[name]
    return _Layer(_rows(path, database, name, column), _projection(path, database, srs), tuple(others))


def _kind(kind: str, plain: bool) -> str:
    """What an entry of a GeoPackage is that is no layer, in words."""
    words = {"features": "no geometry", "attributes": "no geometry"}
    return words.get(kind, shown(kind).strip("'")) if plain else "a view, not a table"


def _rows(path: Path, database: sqlite3.Connection, table: str, column: str) -> list[Row]:
    quoted, rows, size = table.replace('"', '""'), list[Row](), 0
    found = database.execute(f'SELECT * FROM "{quoted}"')
    names = [str(column[0]) for column in found.description]
    if column not in names:
        raise Invalid((), f"{path}: {shown(table)}", f"has no column {shown(column)} of geometry", "it is damaged")
    for row in islice(found, MOST_FEATURES + 1):
        size += sum(len(value) for value in row if isinstance(value, str | bytes))
        if size > MOST_BYTES:  # damaged pages may be read again and again
            raise Invalid((), f"{path}: {shown(table)}", f"has more than {MOST_BYTES} bytes", "it is damaged")
        values = dict(zip(names, row, strict=True))
        rows.append((values, _of_bytes(f"{path}: feature {len(rows) + 1}", values.pop(column))))
    return rows


def _of_bytes(where: str, value: object) -> shapely.Geometry | None:
    """The geometry in a value of a GeoPackage: a head, a box, and well-known bytes."""
    if value is None:
        return None
    data = value if isinstance(value, bytes) else b""
    box = data[3] >> 1 & 7 if len(data) > 8 else len(ENVELOPES)
    if not data.startswith(b"GP") or box >= len(ENVELOPES):
        raise Invalid((), where, "is no geometry of a GeoPackage", "export it again")
    data = data[8 + ENVELOPES[box] :]
    kind, one = _head(data), data[5:9] == (b"\1\0\0\0" if data[:1] == b"\1" else b"\0\0\0\1")
    if kind in (LINES, POLYGONS) and one and _head(data[9:]) == kind - 3:
        kind, data = kind - 3, data[9:]
    if kind not in (LINE, POLYGON):  # parts within parts without end would overflow the library's stack
        raise Invalid(
            (), where, "is no line or polygon", "give lines and polygons, each of one part and without curves"
        )
    try:
        return shapely.from_wkb(data)
    except shapely.errors.ShapelyError as error:
        raise Invalid((), where, "is a damaged geometry", shown(str(error))) from error


def _head(data: bytes) -> int:
    """Code of the geometry that well-known bytes begin with, without its axes; -1 for none."""
    if len(data) < 9 or data[0] > 1:
        return -1
    return (int.from_bytes(data[1:5], "little" if data[0] else "big") & 0x0FFFFFFF) % 1000


def _projection(path: Path, database: sqlite3.Connection, srs: object) -> str | None:
    """The coordinate system of a layer by its number; None where the file says that it is not known."""
    if srs == -1:
        return None
    if srs == 0:
        raise Invalid((), str(path), "is in degrees", METRES)
    query = "SELECT organization, organization_coordsys_id, definition FROM gpkg_spatial_ref_sys WHERE srs_id = ?"
    organization, code, definition = database.execute(query, (srs,)).fetchone() or ("", srs, "undefined")
    return f"EPSG:{code}" if str(organization).upper() == "EPSG" else str(definition)


def _shapefile(path: Path, data: bytes) -> _Layer:
    """The features of a shapefile, with the names and the coordinate system in the files beside it."""
    shapefile = extra("shapefile", f"{path.name} is a shapefile, which pyshp reads", "pyshp")
    table, page, projection = (_beside(path, ending) for ending in (".dbf", ".cpg", ".prj"))
    parts = {"shp": io.BytesIO(data)} | ({} if table is None else {"dbf": io.BytesIO(table)})
    try:
        with warnings.catch_warnings():
            # The library warns of a file of another length than it declares.
            warnings.simplefilter("error", getattr(shapefile, "PossiblyCorruptFileHeader", UserWarning))
            reader = shapefile.Reader(**parts, encoding=_encoding(page, table), encodingErrors="replace")
            values: Iterator[Mapping[str, object]] = iter(())
            if table is not None:
                values = (record.as_dict() for record in reader.iterRecords())
            shapes = islice(reader.iterShapes(), MOST_FEATURES + 1)
            rows: list[Row] = [(next(values, {}), _of_json(shape.__geo_interface__)) for shape in shapes]
    except Exception as error:  # the library raises any type of error for a damaged file
        raise Invalid((), str(path), "cannot be read as a shapefile", shown(str(error)) or "it ends early") from error
    return _Layer(rows, None if projection is None else projection.decode("utf-8", "replace").strip() or None)


def _beside(path: Path, ending: str) -> bytes | None:
    """Bytes of the file that has this ending and otherwise the name of a shapefile; None without one."""
    other = files.named_beside(path, ending)
    return None if other is None else files.read_given(other, MOST_BYTES)


def _encoding(page: bytes | None, table: bytes | None) -> str:
    """Of the names of a shapefile: as it states, else UTF-8, else code page 1252."""
    named = (page or b"").decode("ascii", "replace").strip()
    try:
        return codecs.lookup(f"cp{named}" if named.isdigit() else named).name
    except LookupError:
        pass
    try:
        (table or b"")[int.from_bytes((table or b"")[8:10], "little") :].decode()
    except UnicodeDecodeError:
        return "cp1252"
    return "utf-8"


def _geojson(path: Path, data: bytes) -> _Layer:
    """The features of a GeoJSON."""
    if len(data) > MOST_JSON:
        raise Invalid(
            (), str(path), f"has {len(data)} bytes, the limit for GeoJSON is {MOST_JSON}", "give a GeoPackage"
        )
    try:
        content = json.loads(data)
        kind = content.get("type")
        if kind not in ("FeatureCollection", "Feature", *KINDS):
            raise ValueError(f"its type is {shown(kind)}")
        features = content["features"] if kind == "FeatureCollection" else [content]
        features = [{"geometry": feature} if feature.get("type") in KINDS else feature for feature in features]
        rows = [
            (dict(feature.get("properties") or {}), _of_json(feature["geometry"]))
            for feature in features[: MOST_FEATURES + 1]
        ]
        system = content.get("crs")
        name = None if system is None else str(system["properties"]["name"])
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError, shapely.errors.ShapelyError) as error:
        raise Invalid((), str(path), "cannot be read as GeoJSON", shown(f"{type(error).__name__}: {error}")) from error
    if name is None:
        # By RFC 7946 coordinates are degrees.
        points = shapely.get_coordinates([shape for _, shape in rows])
        if len(points) and not (np.abs(points) > WEST).any():
            raise Invalid(
                (),
                str(path),
                "has no member crs, so that its coordinates are degrees (RFC 7946)",
                f"{METRES} and to GeoPackage",
            )
        return _Layer(rows, None)
    code = re.search(r"EPSG:[\d.]*:?(\d+)$", name)
    if code is None and "CRS84" not in name:
        raise Invalid((), str(path), f"has the coordinate system {shown(name)}", "give an EPSG code, or a GeoPackage")
    return _Layer(rows, "EPSG:4326" if code is None else f"EPSG:{code[1]}")


def _of_json(geometry: object) -> shapely.Geometry | None:
    """A line or polygon of the form of GeoJSON; None for none."""
    if not isinstance(geometry, dict) or geometry.get("type") == "GeometryCollection":
        return None
    return shapely.geometry.shape(geometry)
