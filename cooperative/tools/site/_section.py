"""The section for which layers are estimated: its surface cuts off readings, and its file begins the scene."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from cooperative.scene import Files, tables
from cooperative.tools.soundings import Values
from jaxmpm.support.files import read_given
from jaxmpm.support.table import decoded

EDGE = 0.01
"""Depth (m) below the surface from which on a reading lies in the ground."""
MOST_BYTES = 2**20
"""Size of a scene's text at most."""


@dataclass(frozen=True)
class DrawnSection:
    """The ground of a section.

    Args:
        path: of its file.
        text: of the file.
        surface: (2, n) x and z (m), between the walls.
        base: elevation (m).
        beside: files beside it that it names.
    """

    path: Path
    text: str
    surface: Values
    base: float
    beside: tuple[str, ...] = ()

    def inside(self, points: Values) -> npt.NDArray[np.bool_]:
        """Which points (2, n) m lie in the ground.

        Args:
            points: x and z.
        """
        x, z = points
        (low, *_, high), heights = self.surface[0], np.interp(x, *self.surface)
        return (x >= low) & (x <= high) & (z < heights - EDGE) & (z >= self.base)

    def bottom(self, elevation: float) -> list[list[float]]:
        """The level bottom of a layer; along the surface where that is lower.

        Args:
            elevation: of the bottom (m).
        """
        x, z = self.surface
        above = z - elevation
        crossed = [
            float(x[k] - above[k] * (x[k + 1] - x[k]) / (above[k + 1] - above[k]))
            for k in np.flatnonzero(above[1:] * above[:-1] < 0)
        ]
        stations = np.unique(np.r_[x, crossed])
        heights = np.minimum(np.interp(stations, x, z), elevation)
        level = heights[:-2] + heights[2:] == 2 * heights[1:-1]
        kept = np.r_[True, ~(level & (heights[1:-1] == elevation)), True]
        return [
            [round(float(at), 3), round(float(high), 3)] for at, high in zip(stations[kept], heights[kept], strict=True)
        ]

    def holds(self, bottom: float) -> bool:
        """Whether a layer with this bottom (m) has ground in the section.

        Args:
            bottom: elevation (m).
        """
        return bool(self.surface[1].max() > bottom)


def read_section(path: Path) -> DrawnSection:
    """The section of a scene's file that has [ground] and no layers yet.

    Args:
        path: of the file.

    Raises:
        ValueError: no TOML, or no such section.
    """
    text = decoded(path, read_given(path, MOST_BYTES))
    try:
        scene = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ValueError(f"{path} is no scene in TOML: {error}") from error
    if "ground" not in scene:
        raise ValueError(
            f"{path} has no table [ground]: --section takes the scene of a section, for a terrain --surface"
        )
    if clash := [key for key in ("layer", "soil", "strength") if key in scene]:
        raise ValueError(f"{path} has {', '.join(clash)} already, which the soundings give: leave out these tables")
    ground = tables.read(tables.GroundTable, scene["ground"], "ground", files=Files({}, path.parent))
    surface = np.array(ground.surface, float).T
    low, high = ground.walls or (float(surface[0, 0]), float(surface[0, -1]))
    stations = np.unique(np.clip(np.r_[surface[0], low, high], low, high))
    surface = np.stack([stations, np.interp(stations, *surface)])
    beside = tuple(text_there for text_there in _texts(scene) if (path.parent / text_there.partition("#")[0]).is_file())
    return DrawnSection(path, text, surface, ground.base, beside)


def _texts(value: object) -> Iterator[str]:
    """Every text in a scene that could name a file."""
    if isinstance(value, str):
        if 0 < len(value) < 200 and "\0" not in value:
            yield value
    elif isinstance(value, dict | list):
        for part in value.values() if isinstance(value, dict) else value:
            yield from _texts(part)
