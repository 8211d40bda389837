"""The text of a scene: read from a file, and taken apart as TOML. Nothing in it is executed."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from cooperative.scene._rasters import packed
from cooperative.scene._schema import LINE, RASTER, SECTIONS, read
from foundation import files
from foundation.text import shown
from jaxmpm import Raster, read_raster

LARGEST = 1_000_000
"""Bytes of a scene file at most, and of a file of points; a scene has a few thousand."""

MOST_POINTS = 10_000
"""Points of a line in a file."""


def read_scene(path: Path) -> str:
    """The text of a scene file, with the points of the files that it names for its lines in a table `[files]`, so that
    it stands alone. Raises ValueError, naming the file, where one is missing or no text."""
    if not path.exists():
        raise ValueError(f"there is no scene {path}: give the path of a scene in TOML")
    if not path.is_file():
        raise ValueError(f"scene {path} is no file: give the path of a scene in TOML")
    if path.stat().st_size > LARGEST:
        raise ValueError(f"scene {path} has {path.stat().st_size} bytes, the limit is {LARGEST}: is it a scene?")
    try:
        return _with_files(path.read_bytes().decode(), path.parent)
    except UnicodeDecodeError as error:
        raise ValueError(f"scene {path} is no text in UTF-8 (byte {error.start}): give a scene in TOML") from error
    except OSError as error:
        raise ValueError(f"scene {path} cannot be read ({error.strerror}): give a file that you may read") from error


def tables_of(text: str) -> dict[str, Any]:
    """The tables of a scene. Raises ValueError for text that is no TOML."""
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ValueError(f"the scene is not valid TOML: {error}") from error
    except RecursionError as error:
        raise ValueError("the scene nests tables or lists without end: a scene has tables of plain values") from error


def _with_files(text: str, folder: Path) -> str:
    """The text with the points of files that lie in `folder`; the same where it names none or has the table already."""
    tables = tables_of(text)
    lines, rasters = (dict.fromkeys(_named(tables, kind)) for kind in (LINE, RASTER))
    if not (lines or rasters) or "files" in tables:
        return text
    said = [f"{json.dumps(name)} = {json.dumps(_points(folder / name))}" for name in lines]
    for name in rasters:
        table = packed(name, _between_walls(read_raster(folder / name), tables.get("terrain")))
        said.append(f"{json.dumps(name)} = {{ {', '.join(f'{k} = {json.dumps(v)}' for k, v in table.items())} }}")
    return text + "\n".join(["\n[files]", *said]) + "\n"


def _between_walls(raster: Raster, terrain: Any) -> Raster:
    """The part of a raster that a scene's table [terrain] needs, at its step."""
    said = read("terrain", terrain, SECTIONS["terrain"])
    ends = [said[axis] or end for axis, end in zip("xy", raster.ends, strict=True)]
    if any(len(end) != 2 for end in ends):
        raise ValueError("[terrain] x and y: give two walls each, low and high")
    part = raster.cropped(*ends)
    return part if said["step"] is None else part.resampled(said["step"])


def _named(tables: Mapping[str, Any], kind: str) -> Iterator[str]:
    """Names of the files that stand in the place of lines, or of rasters."""
    for section, keys in SECTIONS.items():
        found = tables.get(section)
        for table in found if isinstance(found, list) else [found]:
            if isinstance(table, dict):
                values = [table.get(key) for key, what in keys.items() if what.kind == kind]
                yield from (value for value in values if isinstance(value, str))


def _points(path: Path) -> list[list[float]]:
    """Points of a CSV file: x and z on each line, with or without a line of headings."""
    try:
        lines = files.read_plain(path, LARGEST).decode().splitlines()
    except UnicodeDecodeError as error:
        raise ValueError(f"{path} is no text in UTF-8 (byte {error.start}): give x and z as CSV") from error
    except OSError as error:
        raise ValueError(f"{path}, which the scene names, cannot be read ({error.strerror})") from error
    points: list[list[float]] = []
    for number, line in enumerate(lines, 1):
        entries = re.split(r"[;,\s]+", line.strip(" ,;\t"))
        if entries == [""] or line.startswith("#"):
            continue
        try:
            points.append([float(entry) for entry in entries])
        except ValueError as error:
            if points or number > 1:
                raise ValueError(f"{path}, line {number} is {shown(line)}: give x and z, two numbers") from error
            if re.search(r"(feet|foot|\bft\b|_ft)", line.lower()):
                raise ValueError(f"{path} has headings {shown(line)}: give x and z in metres, not in feet") from error
            continue
        if len(entries) != 2 or not np.isfinite(points[-1]).all():
            raise ValueError(f"{path}, line {number} is {shown(line)}: give two finite numbers, x and z")
    if not 2 <= len(points) <= MOST_POINTS:
        raise ValueError(f"{path} holds {len(points)} points: give 2 to {MOST_POINTS}")
    return points
