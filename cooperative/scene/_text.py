"""The text of a scene: read from a file, and taken apart as TOML. Nothing in it is executed."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

LARGEST = 1_000_000
"""Bytes of a scene file at most; a scene has a few thousand."""


def read_scene(path: Path) -> str:
    """The text of a scene file. Raises ValueError, naming the file, where it is missing or no text."""
    if not path.exists():
        raise ValueError(f"there is no scene {path}: give the path of a scene in TOML")
    if not path.is_file():
        raise ValueError(f"scene {path} is no file: give the path of a scene in TOML")
    if path.stat().st_size > LARGEST:
        raise ValueError(f"scene {path} has {path.stat().st_size} bytes, the limit is {LARGEST}: is it a scene?")
    try:
        return path.read_bytes().decode()
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
