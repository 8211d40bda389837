"""Layers under a terrain: heights of their boundaries at points in plan."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from jaxmpm.ground._layer import Layer, check_ends, labels
from jaxmpm.ground._raster import DEEPEST, Raster
from jaxmpm.setup import RESOLVED


def bottoms(
    surface: np.ndarray, layers: Sequence[Layer], x: np.ndarray, y: np.ndarray, spacing: float
) -> list[np.ndarray]:
    """Heights (N,) m of the layers' lower boundaries, without the last, at points in plan.

    Args:
        surface: height of the ground at the points (N,) m.
        layers: from the top down.
        x: of the points (N,) m.
        y: of the points (N,) m.
        spacing: largest height (m) of a boundary above the one above it.

    Returns:
        One array per boundary.

    Raises:
        ValueError: If a boundary is no raster, depth or thickness, has holes, or lies above the one above it.
    """
    check_ends(layers)
    bounds = [surface]
    for name, layer in zip(labels(layers[:-1]), layers[:-1], strict=True):
        if layer.depth is not None:
            bottom = surface - layer.depth
        elif layer.thickness is not None:
            bottom = bounds[-1] - layer.thickness
        elif isinstance(layer.bottom, Raster):
            bottom = layer.bottom.at(x, y)
        else:
            raise ValueError(f"the bottom of {name} is a line: under a terrain give a raster, depth or thickness")
        refuse_holes(f"the bottom of {name}", bottom, x, y)
        beyond = bottom - bounds[-1]
        worst = int(np.argmax(beyond)) if beyond.size else 0
        if beyond.size and beyond[worst] > spacing:
            raise ValueError(
                f"the bottom of {name} lies {beyond[worst]:g} m above the one above it at ({x[worst]:g}, "
                f"{y[worst]:g}) m: draw it below"
            )
        bounds.append(np.minimum(bottom, bounds[-1]))
    return bounds[1:]


def refuse_thin(x: np.ndarray, y: np.ndarray, tops: Sequence[np.ndarray], spacing: float, names: Sequence[str]) -> None:
    """Raise ValueError for a layer that is nowhere as thick as a particle.

    Args:
        x: positions of points (N,) m.
        y: positions of points (N,) m.
        tops: heights (N,) m there of the layers' upper boundaries and of the base.
        spacing: height of a particle (m).
        names: of the layers.
    """
    for name, (top, bottom) in zip(names, pairwise(tops), strict=True):
        thickness = top - bottom
        most = int(np.argmax(thickness))
        if thickness[most] < spacing * (1 - RESOLVED):
            raise ValueError(
                f"{name} is at most {thickness[most]:g} m thick, at ({x[most]:g}, {y[most]:g}) m, less than a "
                f"particle of {spacing:g} m: take smaller particles, or draw it thicker"
            )


def refuse_holes(name: str, heights: np.ndarray, x: np.ndarray, y: np.ndarray) -> None:
    """Refuse a surface with holes.

    Args:
        name: of the surface, for the message.
        heights: of it (n,) m, in a hole not finite or below `DEEPEST`.
        x: of the heights (n,) m.
        y: of the heights (n,) m.

    Raises:
        ValueError: If it has a hole.
    """
    holes = np.flatnonzero(~np.isfinite(heights) | (heights < DEEPEST))
    if holes.size:
        raise ValueError(
            f"{name} has {holes.size} holes between the walls, the first at ({x[holes[0]]:g}, {y[holes[0]]:g}) m: fill "
            "them, e.g. with gdal_fillnodata, or give one that reaches the walls, or a polygon or walls without holes"
        )
