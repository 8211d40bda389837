"""The text of a scene: read from a file, and taken apart as TOML. Nothing in it is executed."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from cooperative.scene._rasters import packed
from cooperative.scene._schema import LINE, RASTER, SECTIONS, read
from jaxmpm import Raster, read_line, read_raster

LARGEST = 1_000_000
"""Bytes of a scene file at most; a scene has a few thousand."""


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
        return _with_files(path.read_bytes().decode("utf-8-sig"), path.parent)
    except UnicodeDecodeError as error:
        raise ValueError(f"scene {path} is no text in UTF-8 (byte {error.start}): give a scene in TOML") from error
    except OSError as error:
        raise ValueError(f"scene {path} cannot be read ({error.strerror}): give a file that you may read") from error


def tables_of(text: str) -> dict[str, Any]:
    """The tables of a scene. Raises ValueError for text that is no TOML."""
    if text.startswith("\ufeff"):
        raise ValueError("the scene begins with a byte order mark (U+FEFF): read its file with encoding = 'utf-8-sig'")
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
    said = [f"{json.dumps(name)} = {json.dumps(_points(folder, name))}" for name in lines]
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


def _points(folder: Path, name: str) -> list[list[float]]:
    """Points of a file in the folder, in a drawing of one of its layers: "section.dxf#GROUND"."""
    drawing = re.fullmatch(r"(.+?\.dxf)#(.+)", name, re.IGNORECASE)
    return read_line(folder / name) if drawing is None else read_line(folder / drawing[1], drawing[2])
