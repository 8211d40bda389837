"""A scene read from its file, with the files that it names: what these hold stands in the table `files` beside its
text, so that both stand alone. Nothing in it is executed."""

from __future__ import annotations

import base64
import binascii
import json
import re
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cooperative.scene import tables
from cooperative.scene.tables._key import as_points
from cooperative.store import Source, tables_of
from foundation.text import shown
from jaxmpm import Raster, read_line, read_raster

LARGEST = 1_000_000
"""Bytes of a scene file at most; a scene has a few thousand."""
MOST_HEIGHTS = 150_000
"""Heights of a raster in a scene: half of the megabyte that a scene's text may have."""


@dataclass(frozen=True)
class Files:
    """What the files hold that a scene names.

    known: points and rasters by name. folder: where those lie that are not known yet, None where there are no more.
    """

    known: dict[str, Any]
    folder: Path | None = None

    def points(self, name: str) -> Any:
        """Points of a file, in a drawing of one of its layers: "section.dxf#GROUND". ValueError, for the end of a
        message, where it has none."""
        if self.folder is not None and name not in self.known:
            drawing = re.fullmatch(r"(.+?\.dxf)#(.+)", name, re.IGNORECASE)
            path, *layer = (name,) if drawing is None else drawing.groups()
            self.known[name] = as_points(_read(read_line, self.folder / path, *layer))
        found = self.known.get(name)
        if not isinstance(found, tuple):
            raise ValueError(f" = {shown(name)} is no file that was read with the scene: give points [[x, z], ...]")
        return found

    def raster(self, name: str) -> Raster:
        """Heights of a file, likewise."""
        if self.folder is not None and name not in self.known:
            self.known[name] = _read(read_raster, self.folder / name)
        found = self.known.get(name)
        if not isinstance(found, Raster):
            raise ValueError(f" = {shown(name)} is no file that was read with the scene: run the scene's own file")
        return found


def _read(reader: Callable[..., Any], *where: Any) -> Any:
    try:
        return reader(*where)
    except ValueError as error:
        raise ValueError(f": {error}") from error


def files_of(table: Any) -> Files:
    """The files in the table `files`. ValueError for one that is damaged."""
    known = {}
    for name, value in table.items() if isinstance(table, dict) else ():
        try:
            known[name] = unpacked(value) if isinstance(value, dict) else as_points(value)
        except ValueError as error:
            raise ValueError(f"files {shown(name)}{error}") from error
    return Files(known)


def source_of(scene: Source | str | Path) -> Source:
    """What a scene is made from: its text and, of a file, the points and heights of the files that it names.

    Args:
        scene: the text, or the path of a file; a string of one line that ends in ".toml" is a path, since no scene
            has one line.

    Raises:
        ValueError: naming the file, where one is missing or no text.
    """
    if isinstance(scene, Source):
        return scene
    if isinstance(scene, str) and ("\n" in scene or not scene.endswith(".toml")):
        return Source(scene)
    return read_scene(Path(scene))


def read_scene(path: Path) -> Source:
    """A scene's file, with the points and heights of the files that it names. Raises ValueError, naming the file, where
    one is missing or no text, and for what no scene has."""
    if not path.exists():
        raise ValueError(f"there is no scene {path}: give the path of a scene in TOML")
    if not path.is_file():
        raise ValueError(f"scene {path} is no file: give the path of a scene in TOML")
    if path.stat().st_size > LARGEST:
        raise ValueError(f"scene {path} has {path.stat().st_size} bytes, the limit is {LARGEST}: is it a scene?")
    try:
        text = path.read_bytes().decode("utf-8-sig")
        given = tables_of(text)
        if "files" in given:
            return Source(text)
        files = Files({}, path.parent)
        scene = tables.read(tables.Scene, given, files=files)
    except UnicodeDecodeError as error:
        raise ValueError(f"scene {path} is no text in UTF-8 (byte {error.start}): give a scene in TOML") from error
    except OSError as error:
        raise ValueError(f"scene {path} cannot be read ({error.strerror}): give a file that you may read") from error
    table = {name: _in_table(name, found, scene.terrain) for name, found in files.known.items()}
    return Source(text, {"files": table} if table else {})


def _in_table(name: str, found: Any, terrain: tables.Terrain | None) -> Any:
    """The points or the raster of a file as the table `files` has them; of a raster the part between the walls, at the
    step of [terrain]."""
    if not isinstance(found, Raster):
        return [list(point) for point in found]
    if terrain is not None:
        x, y = found.ends
        found = found.cropped(terrain.x or x, terrain.y or y)
        found = found if terrain.step is None else found.resampled(terrain.step)
    return packed(name, found)


def to_toml(scene: dict[str, Any]) -> str:
    """TOML of texts, numbers, true and false, lists, and tables of these."""
    plain = [f"{_key(name)} = {toml_value(value)}" for name, value in scene.items() if not isinstance(value, dict)]
    for name, table in scene.items():
        if isinstance(table, dict):
            plain += ["", f"[{_key(name)}]", *(f"{_key(key)} = {toml_value(value)}" for key, value in table.items())]
    return "\n".join(plain) + "\n"


def _key(name: str) -> str:
    """A key as TOML writes it: names of files need quotes."""
    return name if name.isidentifier() and name.isascii() else json.dumps(name)


def toml_value(value: Any) -> str:
    """A value as TOML writes it."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{_key(key)} = {toml_value(each)}" for key, each in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(map(toml_value, value)) + "]"
    return str(value) if isinstance(value, float) else json.dumps(value)


def packed(name: str, raster: Raster) -> dict[str, Any]:
    """A raster as a table of a scene: its heights in single precision, compressed. ValueError for too many."""
    nx, ny = raster.heights.shape
    if nx * ny > MOST_HEIGHTS:
        raise ValueError(
            f"{name} has {nx} times {ny} heights between the walls, the limit is {MOST_HEIGHTS}: give walls x and y "
            "that lie closer, or a longer step in [terrain]"
        )
    data = zlib.compress(np.asarray(raster.heights, "<f4").tobytes(), 9)
    table: dict[str, Any] = {"corner": list(raster.corner), "step": raster.step, "shape": [nx, ny]}
    if raster.projection is not None:
        table["projection"] = raster.projection
    return table | {"heights": base64.b64encode(data).decode()}


def unpacked(table: Any) -> Raster:
    """The raster in a table of a scene. ValueError for one that holds something else, or less than it says."""
    try:
        (nx, ny), (x, y), step = table["shape"], table["corner"], table["step"]
        projection = table.get("projection")
        if not (projection is None or isinstance(projection, str)):
            raise ValueError(f"projection {shown(projection)}")
        if not (all(isinstance(n, int) and n >= 2 for n in (nx, ny)) and nx * ny <= MOST_HEIGHTS):
            raise ValueError(f"shape {shown(table['shape'])}")
        unpack = zlib.decompressobj()
        data = unpack.decompress(base64.b64decode(table["heights"], validate=True), 4 * nx * ny + 1)
        if len(data) != 4 * nx * ny:
            raise ValueError(f"{len(data)} bytes for {nx} times {ny} heights")
        heights = np.frombuffer(data, "<f4").astype(float).reshape(nx, ny)
        found = Raster(heights, (float(x), float(y)), float(step), projection)
    except (AttributeError, TypeError, KeyError, ValueError, OverflowError, zlib.error, binascii.Error) as error:
        raise ValueError(f": its table in [files] is damaged ({shown(str(error))}): run the scene's file") from error
    found.check("")
    return found
