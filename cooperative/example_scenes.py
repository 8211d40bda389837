"""The example scenes that come with the package, and how one is written where an editor completes its keys."""

from __future__ import annotations

import math
import os
import warnings
from pathlib import Path

import cooperative
from jaxmpm.support.files import write_aside
from jaxmpm.support.text import shown

SCHEMA = Path(cooperative.__file__).parent / "scene.schema.json"
"""The JSON schema of scenes, for editors. It goes along with the package."""

NAMED = f"#:schema ./{SCHEMA.name}\n"
"""The first line of a scene whose editor is to find the schema beside it."""


def examples() -> dict[str, Path]:
    """Files of the example scenes by name.

    An installed package holds them; a checkout has them under benchmarks.
    """
    package = Path(cooperative.__file__).parent
    folder = next((f for f in (package / "scenes", package.parent / "benchmarks" / "scenes") if f.is_dir()), package)
    return {path.stem: path for path in sorted(folder.glob("*.toml"))}


def starters() -> dict[str, Path]:
    """Files of the commented scenes to begin with, by kind of ground."""
    folder = next(iter(examples().values())).parent / "new"
    return {path.stem: path for path in sorted(folder.glob("*.toml"))}


def begin(kind: str, path: Path) -> list[Path]:
    """Write the commented scene of a kind of ground, and the schema for editors beside it.

    A terrain model is written beside it where it needs one.

    Args:
        kind: of ground.
        path: of the scene.

    Returns:
        The files written.

    Raises:
        ValueError: another kind, and where a file exists already.
    """
    kinds = starters()
    if kind not in kinds:
        raise ValueError(f"kind = {shown(kind)}: give one of {', '.join(kinds)}")
    hillside = {path.parent / "terrain.asc": _hillside()} if kind == "terrain" else {}
    return _write({path: NAMED + kinds[kind].read_text(encoding="utf-8"), **hillside})


def write_example(name: str, path: Path) -> list[Path]:
    """Write an example scene, and the schema for editors beside it.

    Args:
        name: of the example.
        path: of the scene.

    Returns:
        The files written.

    Raises:
        ValueError: a name that no example has, and where the file exists already.
    """
    return _write({path: NAMED + example(name)})


def _write(texts: dict[Path, str]) -> list[Path]:
    """Write a scene and what it needs, and beside it the schema; what was there before stays."""
    for path in texts:
        if path.exists():
            raise ValueError(f"{path} exists already: give another name with --out")
    for path, text in texts.items():
        write_aside(path, text.encode())
    schema = next(iter(texts)).with_name(SCHEMA.name)
    if not os.path.lexists(schema):
        write_aside(schema, SCHEMA.read_bytes())
        return [*texts, schema]
    if not (schema.is_file() and schema.read_bytes() == SCHEMA.read_bytes()):
        warnings.warn(
            f"{schema} is there already, is not the schema of this version, and stays as it is; an editor completes "
            "keys from it. Remove it and write a scene again to have that of this version",
            stacklevel=3,
        )
    return list(texts)


def _hillside() -> str:
    """A made-up terrain model: a hillside with a hollow, in an ESRI ASCII grid of steps of 4 m."""
    step, columns, rows = 4, 25, 17

    def height(x: float, y: float) -> float:
        hollow = 1.5 * math.exp(-(((y - 32) / 12) ** 2)) if x < 56 else 0.0
        return 104 + 16 / (1 + math.exp((x - 40) / 7)) - hollow

    lines = "\n".join(
        " ".join(f"{height(step * column, step * row):.2f}" for column in range(columns))
        for row in reversed(range(rows))
    )
    return f"ncols {columns}\nnrows {rows}\nxllcenter 0\nyllcenter 0\ncellsize {step}\n{lines}\n"


def example(name: str) -> str:
    """The TOML of the example scene `name`.

    Args:
        name: of the example.

    Raises:
        ValueError: a name that no example has.
    """
    names = examples()
    if name not in names:
        raise ValueError(f"no example scene is called {shown(name)}: give one of {', '.join(names)}")
    return names[name].read_text(encoding="utf-8")
