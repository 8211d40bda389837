"""Water in and above ground: its table, its surface, and pore pressure as a share of the weight above."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike, DTypeLike

from jaxmpm.ground._boundaries import Outline, points_of
from jaxmpm.ground._layer import Layer, Line
from jaxmpm.ground._raster import Raster
from jaxmpm.ground._strata import refuse_holes
from jaxmpm.laws import WaterSurface, WaterTable
from jaxmpm.setup import RESOLVED, Discretisation, below, force_of_water
from jaxmpm.soil import STANDARD_GRAVITY
from jaxmpm.support import check
from jaxmpm.support.check import Limit
from jaxmpm.support.text import shown
from jaxmpm.support.tracing import array, host, require_known
from jaxmpm.types import Scene

WATER_WEIGHT = 9810.0
"""Unit weight of water under standard gravity (N/m3), as those of soil are given."""


def water_table(
    outline: Outline, water: float | Line | None, discretisation: Discretisation, gravity: float
) -> WaterTable | None:
    """The table from wall to wall, under gravity (m/s2); ValueError for one that does not reach them."""
    if water is None:
        return None
    if not gravity:
        raise ValueError("water with gravity = 0, under which it has no pressure: leave it out")
    left, right = outline.walls
    if check.is_traced(water):
        return _traced_table(outline.walls, water, discretisation, gravity)
    points = points_of("water", [(left, water), (right, water)] if isinstance(water, int | float) else water)
    if points[0, 0] > left or points[-1, 0] < right:
        raise ValueError(
            f"water goes from ({points[0, 0]:g}, {points[0, 1]:g}) to ({points[-1, 0]:g}, {points[-1, 1]:g}) m"
            f": draw it to the walls at x = {left:g} and {right:g} m"
        )
    upright = np.flatnonzero(np.diff(points[:, 0]) == 0)
    if upright.size:
        x, z = points[upright[0]]
        raise ValueError(f"water is upright at ({x:g}, {z:g}) m: draw a table that slopes there")
    _refuse_sloping_pool(outline, points, discretisation)
    x, z = points.T
    return _table_of(x, z, discretisation, gravity)


def _table_of(x: np.ndarray, z: ArrayLike, discretisation: Discretisation, gravity: float) -> WaterTable:
    dtype = check.dtype(discretisation.dtype or jax.dtypes.canonicalize_dtype(float))
    weight = WATER_WEIGHT * gravity / STANDARD_GRAVITY
    return WaterTable(*(array(value, dtype) for value in (x, z, weight, discretisation.spacing[-1])))


def _traced_table(walls: tuple[float, float], water: Any, discretisation: Discretisation, gravity: float) -> WaterTable:
    """A table whose level, or heights of points, are traced; ValueError where its shape or its x are not known."""
    if np.ndim(water) == 0:
        return _table_of(np.array(walls), jnp.full(2, water), discretisation, gravity)
    x, z = zip(*water, strict=True)
    require_known(
        {f"x of point {number} of the water": coordinate for number, coordinate in enumerate(x)},
        "give traced heights alone",
    )
    if np.any(np.diff(x) <= 0) or x[0] > walls[0] or x[-1] < walls[1]:
        raise ValueError(
            f"water has points at x = {shown(list(x))} m: give rising ones, from wall to wall at {walls} m"
        )
    return _table_of(np.array(x), jnp.stack([jnp.asarray(height) for height in z]), discretisation, gravity)


def under(table: WaterTable) -> Callable[[np.ndarray], np.ndarray]:
    """Function that gives which of positions (2, N) m lie under a table: (N,) bool."""
    numbers = host(table)
    return lambda position: below(
        position[1], numbers.interp(position[0], table.x, table.z), RESOLVED * numbers.asarray(table.height, float)
    )


def wet(scene: Scene) -> np.ndarray:
    """Which particles of a scene start below the water table.

    Args:
        scene: with or without water.

    Returns:
        (N,) bool.
    """
    water = scene.loads.water
    if water is None:
        return np.zeros(scene.particles.mass.shape, bool)
    assert hasattr(water, "unit_weight")
    push = np.asarray(force_of_water(scene)[-1], float)
    return push / float(water.unit_weight) > 0.5 + RESOLVED


def _refuse_sloping_pool(outline: Outline, points: np.ndarray, discretisation: Discretisation) -> None:
    """Raise ValueError unless water above the ground is level, to half a particle.

    The weight of a sloping pool would push soil sideways without balance.
    """
    left, right = outline.walls
    dx, dz = discretisation.spacing
    x = left + (np.arange(round((right - left) / dx)) + 0.5) * dx
    water, ground = np.interp(x, *points.T), outline.heights(x)
    stands = water - ground > dz / 2
    for pool in np.split(np.arange(x.size), np.flatnonzero(np.diff(stands)) + 1):
        low, high = pool[np.argmin(water[pool])], pool[np.argmax(water[pool])]
        if stands[pool[0]] and water[high] - water[low] > dz / 2:
            (x0, z0), (x1, z1) = sorted((x[end], water[end]) for end in (low, high))
            raise ValueError(
                f"water above the ground slopes from ({x0:g}, {z0:.4g}) to ({x1:g}, {z1:.4g}) m, where a pool is "
                f"level: draw one level above the ground from x = {x[pool[0]]:g} to {x[pool[-1]]:g} m, or the table "
                "below the ground there"
            )


def pore_pressure_of(
    r_u: float | None, table: bool, z: np.ndarray, layers: Sequence[Layer], tops: Sequence[np.ndarray], gravity: float
) -> np.ndarray | None:
    """Pore pressure as a share of the weight per area above each particle.

    Args:
        r_u: that share; None for no pore pressure.
        table: whether there is a water table too.
        z: height of the particles (N,) m.
        layers: from the top down.
        tops: heights (N,) m, above each particle, of the layers' upper boundaries and of the base.
        gravity: downwards (m/s2).

    Returns:
        (N,) Pa, None without r_u.

    Raises:
        ValueError: If r_u is outside [0, 1), or a table is given too.
    """
    if r_u is None:
        return None
    check.within("r_u", r_u, Limit(least=0, below=1))
    if table:
        raise ValueError(f"both water and r_u = {r_u:g} are given: give one of them")
    above = np.zeros(z.size)
    for layer, (top, bottom) in zip(layers, pairwise(tops), strict=True):
        above = above + layer.soil.unit_weight * np.maximum(top - np.maximum(bottom, z), 0)
    return r_u * gravity / STANDARD_GRAVITY * above


def pressure_on_base(
    r_u: float | None, layers: Sequence[Layer], tops: Sequence[np.ndarray], levels: int, gravity: float
) -> np.ndarray | None:
    """Pore pressure at the nodes of rigid ground, by the weight above them.

    Args:
        r_u: pore pressure over that weight; None for no pore pressure.
        layers: from the top down.
        tops: heights (n,) m, at the nodes in plan, of the layers' upper boundaries and of rigid ground.
        levels: nodes above each other.
        gravity: downwards (m/s2).

    Returns:
        (n * levels,) Pa, None without r_u.
    """
    pressure = pore_pressure_of(r_u, table=False, z=tops[-1], layers=layers, tops=tops, gravity=gravity)
    return None if pressure is None else host(pressure).repeat(pressure, levels)


def water_raster(water: float | Raster | None, walls: tuple[tuple[float, float], tuple[float, float]]) -> Raster | None:
    """Heights of the water between the walls; ValueError if they have holes or end before them."""
    if water is None:
        return None
    if not isinstance(water, Raster):
        check.finite("water", water, "m")
        (west, east), (south, north) = walls
        return Raster(np.full((2, 2), float(water)), (west, south), max(east - west, north - south))
    water.check("water")
    part = water.cropped(*walls)
    refuse_holes("water", part.heights.ravel(), *part.points())
    return part


def water_surface(table: Raster, height: float, dtype: DTypeLike, gravity: float) -> WaterSurface:
    """The water table in 3D under gravity (m/s2), from heights on a raster, with the height of particles' boxes (m)."""
    numbers = table.heights, table.corner, table.step, WATER_WEIGHT * gravity / STANDARD_GRAVITY, height
    return WaterSurface(*(jnp.asarray(value, dtype) for value in numbers))
