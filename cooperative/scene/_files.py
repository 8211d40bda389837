"""A scene read from its file, with the files that it names.

Their content stands in the table `files` beside the scene's text, so that both stand alone. Nothing in it is executed.
"""

from __future__ import annotations

import base64
import json
import math
import os
import re
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

import jax.numpy as jnp
import numpy as np

from cooperative.laboratory import read_rows
from cooperative.scene import tables
from cooperative.scene._projection import compare_projections
from cooperative.scene._region import shift_of
from cooperative.scene._vector import Feature, read_features
from jaxmpm import BaseMotion, Raster, read_line, read_motion, read_raster
from jaxmpm.support import check
from jaxmpm.support.check import Invalid
from jaxmpm.support.text import shown
from jaxmpm.support.values import by_value

T = TypeVar("T")

MOST_HEIGHTS = 150_000
"""Heights of a raster in a scene: half of the megabyte that a scene's text may have."""
MOST_SAMPLES = 200_000
"""Samples of a record in a scene."""


@by_value
@dataclass(frozen=True)
class Files:
    """What the files hold that a scene names.

    Args:
        contents: points and rasters by name.
        folder: where those lie that are not known yet, None where there are no more.
        origin: subtracted from coordinates in the projection of the files (m); of a section along x alone.
        outside: whether files may lie outside the folder.
        projections: coordinate systems of those that have one, by name; the first is the surface's.
    """

    contents: dict[str, object]
    folder: Path | None = None
    origin: tuple[float, ...] = (0.0, 0.0)
    outside: bool = False
    projections: dict[str, str] = field(default_factory=dict)

    @classmethod
    def of(cls, table: object) -> Files:
        """Those in the table `files`.

        Raises:
            ValueError: one that is damaged.
        """
        contents = table if isinstance(table, dict) else {}
        return cls(
            {
                name: unpacked(name, content) if isinstance(content, dict) else content
                for name, content in contents.items()
            }
        )

    def table(self, terrain: tables.TerrainTable | None) -> dict[str, object]:
        """The table `files`: of a raster the part between the walls of [terrain], at its step if that reaches them."""
        content = dict(self.contents)
        for name, raster in self.contents.items():
            if isinstance(raster, Raster) and terrain is not None:
                x, y = raster.ends
                try:
                    raster = raster.cropped(terrain.x or x, terrain.y or y)
                except ValueError as error:
                    raise Invalid((), name, "does not reach the walls", str(error)) from error
                if terrain.step is not None:
                    stepped = raster.resampled(terrain.step)
                    ends = zip(stepped.ends, (terrain.x, terrain.y), strict=True)
                    raster = stepped if all(wall is None or wall[1] <= end[1] + 1e-6 for end, wall in ends) else raster
            if isinstance(raster, Raster | BaseMotion):
                content[name] = packed(name, raster)
        return content

    def points(self, name: str, *, outline: bool = False) -> list[object]:
        """Points of a file, in a drawing of one of its layers: "section.dxf#GROUND".

        Args:
            name: of the file.
            outline: whether it may hold a closed outline, whose upper edge is the line.

        Raises:
            ValueError: it has none.
        """
        drawing = re.fullmatch(r"(.+?\.dxf)#(.+)", name, re.IGNORECASE)
        path, *layer = (name,) if drawing is None else drawing.groups()

        def read() -> list[list[float]]:
            return self._from_origin(read_line(self._path(path), *layer, outline=outline), 1)

        return self._content(name, list, read, "give points [[x, z], ...]")

    def data(self, name: str) -> list[object]:
        """Measured values of a file, a row each, likewise."""

        def read() -> list[list[float]]:
            rows = read_rows(self._path(name))
            return self._from_origin(rows, len(rows[0]) - 2)

        return self._content(name, list, read)

    def series(self, name: str, kind: str) -> list[object]:
        """Times (s) and values of a file of "rain" (m/s) or a "level" (m), likewise."""

        def read() -> list[list[float]]:
            from jaxmpm import seepage

            pairs = (seepage.read_hyetograph if kind == "rain" else seepage.read_levels)(self._path(name))
            return [list(pair) for pair in zip(*pairs, strict=True)]

        return self._content(name, list, read, "give pairs of times and values")

    def pressure(self, name: str) -> list[object]:
        """Total heads of a file of pore pressures in time, rows of a point, a time (s) and a head (m), likewise."""

        def read() -> list[list[float]]:
            from jaxmpm import seepage

            rows = seepage.read_heads(self._path(name)).tolist()
            return self._from_origin(rows, len(rows[0]) - 3)

        return self._content(name, list, read)

    def _from_origin(self, rows: list[list[float]], plan: int) -> list[list[float]]:
        """Rows, whose first numbers are a position in plan, counted from the origin."""
        table, plan = np.array(rows, float), min(plan, len(self.origin))
        table[:, :plan] -= shift_of(self.origin[:plan], table[:, :plan])
        return table.tolist()

    def raster(self, name: str) -> Raster:
        """Heights of a file, likewise; of a GeoTIFF's band: "water.tif#2"."""
        banded = re.fullmatch(r"(.+\.tiff?)#(\d+)", name, re.IGNORECASE)
        path, band = (name, None) if banded is None else (banded[1], int(banded[2]))

        def read() -> Raster:
            raster = read_raster(self._path(path), band=band)
            self._compare(path, raster.projection)
            x, y = shift_of(self.origin, np.transpose(raster.ends))
            return replace(raster, corner=(raster.corner[0] - x, raster.corner[1] - y))

        return self._content(name, Raster, read)

    def features(self, name: str) -> list[Feature]:
        """Lines and polygons of a file, of a GeoPackage's layer, each with its name, likewise: "site.gpkg#houses"."""

        def read() -> list[Feature]:
            path, _, layer = name.partition("#")
            features, projection = read_features(self._path(path), layer or None)
            self._compare(path, projection)
            for feature in features:
                points = np.array(feature["points"])
                feature["points"] = (points - shift_of(self.origin, points)).tolist()
            return features

        remedy = "give points [[x, y], ...]"
        features: list[Feature] = self._content(name, list, read, remedy)
        if not (features and all(map(_is_feature, features))):
            raise _not_read(name, remedy)
        return features

    def motion(self, name: str, unit: float | None = None) -> BaseMotion:
        """Record of motion of a file, likewise, along x, y and z in its own unit.

        Args:
            name: of the file.
            unit: of the record by the scene (m/s2), None where it has none that is known.
        """
        unit_name = next((word for word, factor in tables.ACCELERATIONS.items() if factor == unit), "m/s2")

        def read() -> BaseMotion:
            return read_motion(
                self._path(name), axes=tables.AXES, unit=unit_name, scale=1 / tables.ACCELERATIONS[unit_name]
            )

        return self._content(name, BaseMotion, read)

    def _content(self, name: str, kind: type[T], read: Callable[[], T], remedy: str = "run the scene's own file") -> T:
        """What a file holds, read from the folder where it is not known yet."""
        if self.folder is not None and name not in self.contents:
            try:
                self.contents[name] = read()
            except ValueError as error:
                if "\0" in name or ("\\" not in name and name.isprintable()):
                    raise
                rule = f"has a backslash, or a special character that one gave ({error})"
                raise Invalid((), shown(name), rule, "write folders of a path with / in between") from error
        content = self.contents.get(name)
        if not isinstance(content, kind):
            raise _not_read(name, remedy)
        return content

    def _path(self, name: str) -> Path:
        """Where the file of this name is read.

        Raises ValueError where it lies outside the folder, as it stands or by a link, and none may.
        """
        assert self.folder is not None
        path = self.folder / name
        if self.outside or "\0" in name:  # which no file has, and its reader refuses
            return path
        for real in (os.path.abspath, os.path.realpath):
            if not Path(real(path)).is_relative_to(real(self.folder)):
                raise Invalid(
                    (),
                    str(path),
                    "lies outside the scene's folder",
                    "move it there, or allow it by --allow-outside, in Python read_scene(path, outside=True)",
                )
        return path

    def _compare(self, name: str, projection: str | None) -> None:
        """Remark on a file in another datum than the first one; ValueError for one in another projection."""
        if projection is None:
            return
        for first, there in list(self.projections.items())[:1]:
            if remark := compare_projections(name, projection, first, there):
                check.warn(remark)
        self.projections.setdefault(name, projection)


def _is_feature(value: object) -> bool:
    """Whether this is a feature: a scene from somebody else may hold anything in its place."""
    try:
        name, points, holes = (value[key] for key in Feature.__annotations__)  # type: ignore[index]
        return isinstance(name, str) and isinstance(holes, int) and np.asarray(points, float).shape[1:] == (2,)
    except (KeyError, TypeError, ValueError):
        return False


def _not_read(name: str, remedy: str) -> Invalid:
    return Invalid((), shown(name), "is no file that was read with the scene", remedy)


def to_toml(scene: Mapping[str, object]) -> str:
    """TOML of texts, numbers, true and false, lists, and tables of these.

    Args:
        scene: its tables.
    """
    plain = [f"{_key(name)} = {toml_value(value)}" for name, value in scene.items() if not isinstance(value, dict)]
    for name, table in scene.items():
        if isinstance(table, dict):
            plain += ["", f"[{_key(name)}]", *(f"{_key(key)} = {toml_value(value)}" for key, value in table.items())]
    return "\n".join(plain) + "\n"


def _key(name: str) -> str:
    """A key as TOML writes it: names of files need quotes."""
    return name if name.isidentifier() and name.isascii() else _quoted(name)


def _quoted(text: str) -> str:
    """A text as TOML quotes it: as JSON does, without halves of characters, and with the one control character more."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def toml_value(value: object) -> str:
    """A value as TOML writes it."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{_key(key)} = {toml_value(item)}" for key, item in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(map(toml_value, value)) + "]"
    if isinstance(value, str):
        return _quoted(value)
    return str(value) if isinstance(value, float) else json.dumps(value)


def packed(name: str, content: Raster | BaseMotion) -> dict[str, object]:
    """A raster or a record as a table of a scene: its numbers in single precision, compressed.

    Args:
        name: of the file.
        content: heights, or a record with its three axes in its own unit.

    Raises:
        ValueError: too many numbers.
    """
    if isinstance(content, BaseMotion):
        samples = content.acceleration.shape[1]
        if samples > MOST_SAMPLES:
            raise Invalid(
                (), name, f"has {samples} samples, the limit is {MOST_SAMPLES}", "cut it, or sample it less often"
            )
        acceleration = as_text(np.asarray(content.acceleration, "<f4"))
        return {"interval": float(content.interval), "samples": samples, "acceleration": acceleration}
    nx, ny = content.heights.shape
    if nx * ny > MOST_HEIGHTS:
        raise Invalid(
            (),
            name,
            f"has {nx} times {ny} heights between the walls, the limit is {MOST_HEIGHTS}",
            "give walls x and y that lie closer, or a longer step in [terrain]",
        )
    table: dict[str, object] = {"corner": list(content.corner), "step": content.step, "shape": [nx, ny]}
    if content.projection is not None:
        table["projection"] = content.projection
    return table | {"heights": as_text(np.asarray(content.heights, "<f4"))}


def unpacked(name: str, table: Any) -> Raster | BaseMotion:
    """The raster or the record in a table of a scene.

    Args:
        name: of the file.
        table: as `packed` gives it.

    Raises:
        ValueError: one that holds something else, or less than it declares.
    """
    try:
        content = _record(table) if "samples" in table else _raster(table)
    except (AttributeError, TypeError, KeyError, ValueError, OverflowError, zlib.error) as error:
        rule = f"is damaged ({shown(str(error))})"
        raise Invalid((), f"files {shown(name)}", rule, "run the scene's file") from error
    if isinstance(content, Raster):
        content.check(f"files {shown(name)}")
    return content


def _record(table: Any) -> BaseMotion:
    samples, interval = table["samples"], float(table["interval"])
    if not (isinstance(samples, int) and 2 <= samples <= MOST_SAMPLES and 0 < interval < np.inf):
        raise ValueError(f"{shown(samples)} samples, each {interval:g} s")
    values = from_text(table["acceleration"], "<f4", (len(tables.AXES), samples))
    if not np.isfinite(values).all():
        raise ValueError("numbers that are not finite")
    return BaseMotion(jnp.asarray(values), jnp.asarray(interval))


def _raster(table: Any) -> Raster:
    (nx, ny), (x, y), projection = table["shape"], table["corner"], table.get("projection")
    if not (projection is None or isinstance(projection, str)):
        raise ValueError(f"projection {shown(projection)}")
    if not (all(isinstance(n, int) and n >= 2 for n in (nx, ny)) and nx * ny <= MOST_HEIGHTS):
        raise ValueError(f"shape {shown(table['shape'])}")
    heights = from_text(table["heights"], "<f4", (nx, ny)).astype(float)
    return Raster(heights, (float(x), float(y)), float(table["step"]), projection)


def as_text(values: np.ndarray) -> str:
    """Numbers as text: their bytes, compressed."""
    return base64.b64encode(zlib.compress(values.tobytes(), 9)).decode()


def from_text(text: str, dtype: str, shape: tuple[int, ...]) -> np.ndarray:
    """The numbers of `as_text`; ValueError or zlib.error for a text that is damaged, or has more or fewer of them."""
    size = np.dtype(dtype).itemsize * math.prod(shape)
    data = zlib.decompressobj().decompress(base64.b64decode(text, validate=True), size + 1)
    if len(data) != size:
        raise ValueError(f"{len(data)} bytes for {' times '.join(map(str, shape))} numbers")
    return np.frombuffer(data, dtype).reshape(shape)
