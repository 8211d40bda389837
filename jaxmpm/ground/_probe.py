"""Volume, relief and layers of any ground: its own members, or values sampled from it."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from jaxmpm.ground._ground import Ground, layer_of
from jaxmpm.ground._layer import Box, Layer, labels
from jaxmpm.ground._seam import Thickness, thicknesses_of
from jaxmpm.setup import Discretisation

PLAN = {1: 4096, 2: 256}
"""Points along each horizontal axis at which ground is sampled, by the number of these axes."""


PROBED = {1: (512,), 2: (48, 48)}
"""Columns of points at which layers are sampled, by the number of horizontal axes."""


PROBED_UP = 256
"""Points in each of these columns."""


HALVINGS = 20
"""Bisection steps for a layer's top, which is then known to a millionth of the height above a point."""


def volume(ground: Ground) -> float:
    """Volume of the ground, in plane strain per metre of width.

    Args:
        ground: its own `volume` is used if it has one, else that below its surface.

    Returns:
        m3, in plane strain m2.
    """
    if hasattr(ground, "volume"):
        return ground.volume
    return float(np.mean(_surface(ground) - ground.corner[-1]) * math.prod(ground.extent[:-1]))


def points_held(ground: Ground, discretisation: Discretisation) -> float:
    """How many points of the lattice in the ground's box are in memory at once while its particles are chosen.

    Args:
        ground: its own `points_held` is used if it has one, else it holds all points.
        discretisation: with the spacing of the points.

    Returns:
        The number, for an estimate.
    """
    if hasattr(ground, "points_held"):
        return ground.points_held(discretisation)
    return math.prod(ground.extent) / math.prod(discretisation.spacing)


def relief(ground: Ground) -> float:
    """Height of the ground's highest point above its lowest.

    Args:
        ground: its own `relief` is used if it has one, else that of its surface.

    Returns:
        m.
    """
    return ground.relief if hasattr(ground, "relief") else float(np.ptp(_surface(ground)))


def floor(ground: Ground, *plan: np.ndarray) -> np.ndarray:
    """Height of the rigid ground below points in plan.

    Args:
        ground: its own `floor` is used if it has one, else its level base.
        *plan: x (n,) m of the points or, in three dimensions, x and y.

    Returns:
        (n,) m.
    """
    return ground.floor(*plan) if hasattr(ground, "floor") else np.full(plan[0].shape, ground.corner[-1])


def _surface(ground: Ground) -> np.ndarray:
    """Elevations (n,) m of the surface, at points spread evenly in plan."""
    axes = len(ground.corner) - 1
    return ground.heights(*_spread(ground, (PLAN[axes],) * axes))


def _spread(ground: Ground, counts: Sequence[int]) -> list[np.ndarray]:
    """Coordinates (n,) m of the centres of `counts` equal parts of the box along each axis, of the first axes."""
    sides = zip(ground.corner, ground.extent, counts, strict=False)
    axes = [low + edge * (np.arange(count) + 0.5) / count for low, edge, count in sides]
    return [axis.ravel() for axis in np.meshgrid(*axes, indexing="ij")]


def thicknesses(ground: Ground, layers: Sequence[Layer]) -> list[Thickness]:
    """Thickness of each layer, and whether it is a weak seam.

    Args:
        ground: its own `thicknesses` is used if it has one; else they are sampled, to a 256th of its height.
        layers: from the top down.

    Returns:
        One per layer.

    Raises:
        ValueError: If the layers are invalid.
    """
    if hasattr(ground, "thicknesses"):
        return ground.thicknesses(layers)
    number, step = _probed(ground, layers)
    thick = [(number == layer).sum(axis=-1).ravel() * step[-1] for layer in range(len(layers))]
    return thicknesses_of(layers, [-np.sum(thick[:first], axis=0) for first in range(len(layers) + 1)])


def box_of(ground: Ground, layers: Sequence[Layer], number: int) -> Box:
    """A box that holds a layer.

    Args:
        ground: its own `box_of` is used if it has one; else the layer is sampled, to a 256th of its height.
        layers: from the top down.
        number: of the layer, from 0.

    Returns:
        Lowest corner and edges (m).

    Raises:
        ValueError: If there is no ground of this layer.
    """
    if hasattr(ground, "box_of"):
        return ground.box_of(layers, number)
    probed, step = _probed(ground, layers)
    at = np.argwhere(probed == number)
    if not at.size:
        raise ValueError(f"{labels(layers)[number]} lies nowhere between the walls: draw it there, or leave it out")
    low, high = np.maximum(at.min(axis=0) - 1, 0), np.minimum(at.max(axis=0) + 2, probed.shape)
    return tuple((ground.corner + low * step).tolist()), tuple(((high - low) * step).tolist())


def top_of(
    ground: Ground, layers: Sequence[Layer], number: int, position: np.ndarray, discretisation: Discretisation
) -> np.ndarray:
    """Elevation of the top of a layer above points in it, to a millionth of the height above each.

    It bisects `layer_of` between each point and the surface.

    Args:
        ground: of the layers.
        layers: from the top down.
        number: of the layer, from 0.
        position: of the points (d, N) m; a point above the layer gets its own elevation.
        discretisation: cell, spacing and numerical choices.

    Returns:
        (N,) m.

    Raises:
        ValueError: If `layer_of` gives no valid numbers.
    """
    plan, low = position[:-1], np.array(position[-1], float)
    high = np.maximum(ground.heights(*plan), low)
    for _ in range(HALVINGS if number else 0):
        middle = (low + high) / 2
        under = layer_of(ground, layers, np.stack([*plan, middle]), discretisation) >= number
        low, high = np.where(under, middle, low), np.where(under, high, middle)
    return high


def _probed(ground: Ground, layers: Sequence[Layer]) -> tuple[np.ndarray, np.ndarray]:
    """Layer number at the centres of equal parts of the box, -1 above the surface; edges (d,) m of the parts."""
    counts = (*PROBED[len(ground.corner) - 1], PROBED_UP)
    step = np.array(ground.extent) / counts
    position = np.stack(_spread(ground, counts))
    numerics = Discretisation(float(step.max()), tuple(step.tolist()))
    number = layer_of(ground, layers, position, numerics)
    under = position[-1] < ground.heights(*position[:-1])
    return np.where(under, number, -1).reshape(counts), step
