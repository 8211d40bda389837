"""Files of the trade that somebody made to be more than they are called.

Each is put under the name of a raster, a drawing, a sounding, a record or a file of features, and read as a scene or
`jaxmpm site` reads it. It may be read right or refused in one line. It may not lead to another file, to a host or to
what is written, nor take gigabytes or minutes, and no message may quote another file.
"""

from __future__ import annotations

import json
import os
import resource
import signal
import socket
import sqlite3
import struct
import tempfile
import warnings
import zlib
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from cooperative.scene import Files
from cooperative.tools.soundings import read_files

SECRET = 31337.25
"""Coordinate, height and word of the baits: where it turns up, another file was read."""
MEMORY = 3 * 2**30
"""Bytes of address space that a file may take."""
PATIENCE = 30
"""Seconds after which reading counts as hanging."""
EVERY = 7
"""Of these files a quick run takes each such."""


@dataclass
class Outside:
    """What lies outside a scene's folder and must stay as it is.

    Attributes:
        folder: with the baits.
        before: their bytes by name.
        host: that nobody may call.
    """

    folder: Path
    before: dict[str, bytes] = field(default_factory=dict)
    host: socket.socket = field(default_factory=socket.socket)

    def __post_init__(self) -> None:
        self.folder.mkdir(parents=True)
        write_features(self.folder / "bait.gpkg")
        (self.folder / "bait.csv").write_text(f"{SECRET}, {SECRET}\n{SECRET + 1}, 0\n")
        (self.folder / "bait.asc").write_text(
            f"ncols 2\nnrows 2\nxllcorner 0\nyllcorner 0\ncellsize 1\n{f'{SECRET} ' * 4}"
        )
        self.before = self._content()
        self.host.bind(("127.0.0.1", 0))
        self.host.listen()
        self.host.setblocking(False)

    @property
    def address(self) -> str:
        """Of the host."""
        return "http://{}:{}".format(*self.host.getsockname())

    def faults(self) -> Iterator[str]:
        """What was done to the outside."""
        if self._content() != self.before:
            yield "changed what is outside"
        try:
            self.host.accept()[0].close()
            yield "called a host"
        except BlockingIOError:
            pass

    def _content(self) -> dict[str, bytes]:
        return {path.name: path.read_bytes() for path in self.folder.iterdir()}


def square(x: float, y: float) -> bytes:
    """A polygon in well-known bytes."""
    points = ((x, y), (x + 9, y), (x + 9, y + 9), (x, y))
    return struct.pack("<BIII", 1, 3, 1, 4) + b"".join(struct.pack("<dd", *point) for point in points)


def write_features(
    path: Path, geometry: bytes | None = None, also: tuple[str, ...] = (), table: str = "houses"
) -> None:
    """A GeoPackage with one feature, whose layer may be another table than the plain one."""
    with closing(sqlite3.connect(path)) as database:
        for setting in ("page_size = 512", "synchronous = OFF"):
            database.execute(f"PRAGMA {setting}")
        for columns in (
            "gpkg_contents (table_name, data_type)",
            "gpkg_geometry_columns (table_name, column_name, srs_id)",
            "gpkg_spatial_ref_sys (srs_id, organization, organization_coordsys_id, definition)",
            "plain (geom, name)",
        ):
            database.execute(f"CREATE TABLE {columns}")
        shape = square(SECRET, SECRET) if geometry is None else geometry
        database.execute("INSERT INTO plain VALUES (?, 'house')", (b"GP\0\1" + bytes(4) + shape,))
        for statement in also or (f"ALTER TABLE plain RENAME TO {table}",):
            database.execute(statement)
        database.execute("INSERT INTO gpkg_contents VALUES (?, 'features')", (table,))
        database.execute("INSERT INTO gpkg_geometry_columns VALUES (?, 'geom', -1)", (table,))
        database.commit()


Maker = Callable[[Path, Outside], None]


def _text(content: str, path: Path, outside: Outside) -> None:
    """Write a text with the outside's places filled in."""
    places = {"BAIT": outside.folder / "bait", "NEW": outside.folder / "written", "HOST": outside.address}
    for name, place in places.items():
        content = content.replace(name, str(place))
    path.write_bytes(content.encode())


def _bytes(content: bytes, path: Path, _: Outside) -> None:
    path.write_bytes(content)


def _database(also: tuple[str, ...], path: Path, outside: Outside) -> None:
    """A GeoPackage whose layer is a program."""
    path.unlink(missing_ok=True)
    write_features(path, square(0, 0), tuple(text.replace("BAIT", str(outside.folder / "bait")) for text in also))


def _geometry(geometry: bytes, path: Path, _: Outside) -> None:
    path.unlink(missing_ok=True)
    write_features(path, geometry)


def _sparse(path: Path, _: Outside) -> None:
    path.touch()
    os.truncate(path, 30 * 10**9)


def _link(name: str, path: Path, outside: Outside) -> None:
    path.symlink_to(outside.folder / name)


def _tiff(tags: list[tuple[int, int, int, int]], body: bytes = bytes(64)) -> bytes:
    """A TIFF of one directory behind its body."""
    entries = b"".join(struct.pack("<HHII", *tag) for tag in sorted(tags))
    return b"II*\0" + struct.pack("<I", 8 + len(body)) + body + struct.pack("<H", len(tags)) + entries + bytes(4)


def _heights(width: int, height: int, *, tile: tuple[int, int] | None = None, body: bytes = bytes(64)) -> bytes:
    """A TIFF of heights that declares this size."""
    tags = [(256, 4, 1, width), (257, 4, 1, height), (258, 3, 1, 32), (259, 3, 1, 8), (262, 3, 1, 1), (277, 3, 1, 1),
            (339, 3, 1, 3)]  # fmt: skip
    if tile is None:
        tags += [(273, 4, 1, 8), (278, 4, 1, height), (279, 4, 1, len(body))]
    else:
        tags += [(322, 4, 1, tile[0]), (323, 4, 1, tile[1]), (324, 4, 1, 8), (325, 4, 1, len(body))]
    return _tiff(tags, body)


VIRTUAL = {
    "virtual features": "<OGRVRTDataSource><OGRVRTLayer name='houses'><SrcDataSource>BAIT.gpkg</SrcDataSource>"
    "<SrcLayer>houses</SrcLayer></OGRVRTLayer></OGRVRTDataSource>",
    "virtual features that write": "<OGRVRTDataSource><OGRVRTLayer name='houses'><SrcDataSource>BAIT.gpkg"
    "</SrcDataSource><SrcSQL dialect='SQLite'>VACUUM INTO 'NEW.db'</SrcSQL></OGRVRTLayer></OGRVRTDataSource>",
    "virtual features of a host": "<OGRVRTDataSource><OGRVRTLayer name='a'><SrcDataSource>/vsicurl/HOST/a.gpkg"
    "</SrcDataSource></OGRVRTLayer></OGRVRTDataSource>",
    "features of a service": "<OGRWFSDataSource><URL>HOST/wfs</URL></OGRWFSDataSource>",
    "virtual raster": '<VRTDataset rasterXSize="2" rasterYSize="2"><GeoTransform>0,1,0,2,0,-1</GeoTransform>'
    '<VRTRasterBand dataType="Float64" band="1"><SimpleSource><SourceFilename>BAIT.asc</SourceFilename>'
    "<SourceBand>1</SourceBand></SimpleSource></VRTRasterBand></VRTDataset>",
    "virtual raster that runs": '<VRTDataset rasterXSize="2" rasterYSize="2"><VRTRasterBand dataType="Float64" '
    'band="1" subClass="VRTDerivedRasterBand"><PixelFunctionLanguage>Python</PixelFunctionLanguage>'
    "<PixelFunctionType>f</PixelFunctionType><PixelFunctionCode>open('NEW.txt', 'w').write('a')"
    "</PixelFunctionCode></VRTRasterBand></VRTDataset>",
    "raster of a service": '<GDAL_WMS><Service name="WMS"><ServerUrl>HOST/wms</ServerUrl></Service></GDAL_WMS>',
    "raster of a host": "<WCS_GDAL><ServiceURL>HOST/wcs</ServiceURL><CoverageName>a</CoverageName></WCS_GDAL>",
    "pipeline": '{"type": "gdal_streamed_alg", "command_line": "gdal vector pipeline ! read BAIT.gpkg ! '
    'write NEW.gpkg"}',
    "features by link": '{"type": "FeatureCollection", "crs": {"type": "link", "properties": {"href": "HOST/crs"}}, '
    '"features": [{"type": "Feature", "properties": {}, "geometry": {"type": "Polygon", "coordinates": '
    "[[[0, 0], [9, 0], [9, 9], [0, 0]]]}}]}",
    "name of another driver": "GPKG:BAIT.gpkg",
    "name of a host": "/vsicurl/HOST/houses.gpkg",
}  # fmt: skip
"""Files that a library which guesses formats takes for a way to others."""

PROGRAMS = {
    "view that loads": ("CREATE VIEW houses AS SELECT load_extension('BAIT') AS geom, name FROM plain",),
    "view that reads": ("CREATE VIEW houses AS SELECT readfile('BAIT.csv') AS geom, name FROM plain",),
    "view without end": (
        "CREATE VIEW houses AS WITH RECURSIVE n(a) AS (SELECT 1 UNION ALL SELECT a + 1 FROM n) "
        "SELECT a AS geom, a AS name FROM n",
    ),
    "virtual table": ("CREATE VIRTUAL TABLE houses USING fts3(geom, name)",),
    "column that computes": (
        "CREATE TABLE houses (geom, name AS (length(zeroblob(400000000))))",
        "INSERT INTO houses SELECT geom FROM plain",
    ),
    "trigger": (
        "ALTER TABLE plain RENAME TO houses",
        "CREATE TRIGGER a AFTER INSERT ON houses BEGIN SELECT load_extension('BAIT'); END",
    ),
}

DEEP = (struct.pack("<BII", 1, 6, 1)) * 100_000
GEOMETRIES = {
    "geometry without end": DEEP,
    "collections without end": struct.pack("<BII", 1, 7, 1) * 100_000,
    "points beyond counting": struct.pack("<BIII", 1, 3, 1, 2**32 - 1) + bytes(64),
    "rings beyond counting": struct.pack("<BII", 1, 3, 2**32 - 1) + bytes(64),
}

OTHERS = {
    "nothing": b"",
    "zeros": bytes(4096),
    "deep JSON": b'{"type": "FeatureCollection", "features": ' + b"[" * 100_000,
    "workbook": b"PK\x03\x04" + bytes(200),
    "a long word": b"a" * 3_000_000,
    "one long field": b'x,z\n0,"' + b"1" * 200_000 + b'"\n1,1\n',
    "escapes": b"\x1b[2J\x1b]0;title\x07,\x1b[31m\n1,2\n",
}

RASTERS = {
    "a tile of 16 GB": _heights(16, 16, tile=(65_536, 65_536)),
    "a raster of a terabyte": _heights(500_000, 500_000),
    "a deflated bomb": _heights(5_000, 5_000, body=zlib.compress(bytes(10**8), 9)),
    "a directory that is its own next": b"II*\0\x08\0\0\0\0\0\x08\0\0\0",
    "a grid of a terabyte": b"ncols 1000000\nnrows 1000000\nxllcorner 0\nyllcorner 0\ncellsize 1\n1 2 3\n",
    "a grid of numbers without end": b"ncols 1e400\nnrows nan\nxllcorner 0\nyllcorner 0\ncellsize 1\n1 2 3\n",
}

MARKUP = {
    "entities that grow": "<!DOCTYPE a [<!ENTITY b0 'ha'>"
    + "".join(f"<!ENTITY b{k} '{f'&b{k - 1};' * 10}'>" for k in range(1, 12))
    + "]><a>&b11;</a>",
    "entity of a file": "<!DOCTYPE a [<!ENTITY b SYSTEM 'file://BAIT.csv'>]><a>&b;</a>",
    "entity of a host": "<!DOCTYPE a [<!ENTITY b SYSTEM 'HOST/a'>]><a>&b;</a>",
    "type of a host": "<!DOCTYPE a SYSTEM 'HOST/a.dtd'><a/>",
    "inclusion": "<a xmlns:xi='http://www.w3.org/2001/XInclude'><xi:include href='BAIT.csv' parse='text'/></a>",
    "elements without end": "<a>" * 200_000,
}

DRAWINGS = {
    "drawing with another one": "0\nSECTION\n2\nBLOCKS\n0\nBLOCK\n8\n0\n2\nA\n70\n4\n1\nBAIT.csv\n0\nENDBLK\n0\n"
    "ENDSEC\n0\nSECTION\n2\nENTITIES\n0\nINSERT\n8\n0\n2\nA\n0\nENDSEC\n0\nEOF\n",
    "drawing that ends early": "0\nSECTION\n2\nENTITIES\n0\nLWPOLYLINE\n90\n1000000000\n",
    "drawing without end": "0\nSECTION\n" * 20_000,
}

FEATURES = ("site.gpkg", "houses.shp", "houses.geojson")
HEIGHTS = ("hill.tif", "hill.asc")
ALL = (*FEATURES, *HEIGHTS, "section.dxf", "section.csv", "cpt.gef", "cpt.xml", "cpt.ags", "cpt.csv", "record.csv")


def made() -> Iterator[tuple[str, str, Maker]]:
    """Name of the file, what it is, and what puts it at a path where nothing is."""
    for name in (*FEATURES, *HEIGHTS):
        yield from ((name, what, partial(_text, content)) for what, content in VIRTUAL.items())
    for name in FEATURES:
        yield from ((name, what, partial(_database, also)) for what, also in PROGRAMS.items())
    yield from (("site.gpkg", what, partial(_geometry, geometry)) for what, geometry in GEOMETRIES.items())
    for name in HEIGHTS:
        yield from ((name, what, partial(_bytes, content)) for what, content in RASTERS.items())
    for name in ("cpt.xml", "site.gpkg"):
        yield from ((name, what, partial(_text, content)) for what, content in MARKUP.items())
    yield from (("section.dxf", what, partial(_text, content)) for what, content in DRAWINGS.items())
    for name in ALL:
        yield from ((name, what, partial(_bytes, content)) for what, content in OTHERS.items())
        yield name, "thirty gigabytes of nothing", _sparse
        yield name, "link to a bait", partial(_link, "bait.csv")
        yield name, "link to a device", lambda path, _: path.symlink_to("/dev/zero")
        yield name, "pipe", lambda path, _: os.mkfifo(path)


def read(path: Path) -> Any:
    """What a scene, or `jaxmpm site`, reads of a file by its name."""
    files, kind = Files({}, path.parent), path.stem
    if path.name in FEATURES:
        return files.features(path.name)
    if kind == "hill":
        return files.raster(path.name).heights.tolist()
    if kind == "section":
        return files.points(path.name)
    if kind == "record":
        return files.motion(path.name, None).acceleration.tolist()
    return (
        files.data(path.name)
        if path.name == "cpt.csv"
        else [sounding.cone.tolist() for sounding in read_files([path])[0]]
    )


def faults(name: str, put: Maker, outside: Outside) -> Iterator[str]:
    """What reading one of these files does that it may not."""
    with tempfile.TemporaryDirectory() as folder:
        path, said = Path(folder) / name, ""
        put(path, outside)
        try:
            with _bounded(), warnings.catch_warnings(record=True):
                warnings.simplefilter("always")
                said = json.dumps(read(path))
        except ValueError as error:
            said = str(error)
        except Exception as error:
            yield repr(error)[:200]
        yield from ("read another file",) if str(SECRET) in said else ()
        beside = sorted(path.name for path in Path(folder).iterdir())
        yield from (f"wrote {beside}",) if beside != [name] else ()
        yield from outside.faults()


def tried(folder: Path, every: int = 1) -> tuple[int, list[str]]:
    """How many of these files were read, and what reading them did that it may not.

    Args:
        folder: for what lies outside.
        every: takes each such file.
    """
    outside, found = Outside(folder / "outside"), []
    chosen = list(made())[::every]
    with closing(outside.host):
        for name, what, put in chosen:
            found += [f"{name}: {what}: {fault}" for fault in faults(name, put, outside)]
    return len(chosen), found


@contextmanager
def _bounded() -> Iterator[None]:
    """Bound memory and time; what takes more raises MemoryError or TimeoutError."""

    def over(*_: Any) -> None:
        raise TimeoutError(f"hung for {PATIENCE} s")

    pages = int(Path("/proc/self/statm").read_text().split()[0])
    limits, before = resource.getrlimit(resource.RLIMIT_AS), signal.signal(signal.SIGALRM, over)
    resource.setrlimit(resource.RLIMIT_AS, (pages * os.sysconf("SC_PAGE_SIZE") + MEMORY, limits[1]))
    signal.alarm(PATIENCE)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)
        resource.setrlimit(resource.RLIMIT_AS, limits)
