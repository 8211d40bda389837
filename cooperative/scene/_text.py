"""A scene read from its file, with the files that it names. Nothing in it is executed."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from cooperative.scene import tables as known
from cooperative.scene._rasters import packed
from cooperative.store import Source, tables_of
from jaxmpm import Raster, read_line, read_raster

LARGEST = 1_000_000
"""Bytes of a scene file at most; a scene has a few thousand."""


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
    one is missing or no text."""
    if not path.exists():
        raise ValueError(f"there is no scene {path}: give the path of a scene in TOML")
    if not path.is_file():
        raise ValueError(f"scene {path} is no file: give the path of a scene in TOML")
    if path.stat().st_size > LARGEST:
        raise ValueError(f"scene {path} has {path.stat().st_size} bytes, the limit is {LARGEST}: is it a scene?")
    try:
        text = path.read_bytes().decode("utf-8-sig")
        return Source(text, _files(tables_of(text), path.parent))
    except UnicodeDecodeError as error:
        raise ValueError(f"scene {path} is no text in UTF-8 (byte {error.start}): give a scene in TOML") from error
    except OSError as error:
        raise ValueError(f"scene {path} cannot be read ({error.strerror}): give a file that you may read") from error


def to_toml(tables: dict[str, Any]) -> str:
    """TOML of texts, numbers, true and false, lists, and tables of these."""
    plain = [f"{_key(name)} = {toml_value(value)}" for name, value in tables.items() if not isinstance(value, dict)]
    for name, table in tables.items():
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


def _files(tables: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """The table `files` of those that lie in `folder`; nothing where the scene names none or has the table already."""
    lines, rasters = (dict.fromkeys(_named(tables, kind)) for kind in (known.LINE, known.RASTER))
    if not (lines or rasters) or "files" in tables:
        return {}
    points = {name: _points(folder, name) for name in lines}
    heights = {
        name: packed(name, _between_walls(read_raster(folder / name), tables.get("terrain"))) for name in rasters
    }
    return {"files": {**points, **heights}}


def _between_walls(raster: Raster, terrain: Any) -> Raster:
    """The part of a raster that a scene's table [terrain] needs, at its step."""
    table = known.read(known.Terrain, terrain, "terrain")
    x, y = raster.ends
    part = raster.cropped(table.x or x, table.y or y)
    return part if table.step is None else part.resampled(table.step)


def _named(tables: Mapping[str, Any], kind: str) -> Iterator[str]:
    """Names of the files that stand in the place of lines, or of rasters."""
    for section, field in known.Scene.model_fields.items():
        model, found = known.table_in(field), tables.get(section)
        for table in found if isinstance(found, list) else [found]:
            if model is not None and isinstance(table, dict):
                values = [table.get(key) for key, each in model.model_fields.items() if kind in known.parts(each)]
                yield from (value for value in values if isinstance(value, str))


def _points(folder: Path, name: str) -> list[list[float]]:
    """Points of a file in the folder, in a drawing of one of its layers: "section.dxf#GROUND"."""
    drawing = re.fullmatch(r"(.+?\.dxf)#(.+)", name, re.IGNORECASE)
    return read_line(folder / name) if drawing is None else read_line(folder / drawing[1], drawing[2])
