"""Rotated anisotropy: strata that dip, whose covariance is separable along strike, dip and normal.

The expansion is made on the smallest box in rotated axes that holds the given one, and points are turned into
those axes. Coordinates: x along the run-out, y along the slope, z up.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jax import Array

from foundation import check
from foundation.check import require
from kl.types import HostArray


@dataclass(frozen=True)
class Bedding:
    """Orientation of strata, in degrees; static.

    `dip` is the steepest inclination below the horizontal, in [0, 90]. `strike` is the direction of the horizontal
    line in the bedding plane, anticlockwise from +x seen from above; the strata fall to its right. With strike 90
    (the default: along y) they dip towards +x. The axes of the covariance become: first in the bedding plane down
    the dip, second along strike, third normal to the plane, upwards; in two dimensions (x, z) the first and third.
    """

    dip: float
    strike: float = 90.0


def rotation_matrix(bedding: Bedding, dimension: int) -> HostArray:
    """Rows are the unit vectors down dip, along strike and normal (d, d); `matrix @ points` rotates (d, N)."""
    require(dimension in (2, 3), f"bedding in {dimension} dimension: it needs 2 or 3")
    check.finite("strike", bedding.strike, remedy="it is an angle in degrees")
    require(0 <= bedding.dip <= 90, f"dip = {bedding.dip} degrees is outside [0, 90]: turn the strike by 180 instead")
    dip, strike = math.radians(bedding.dip), math.radians(bedding.strike)
    if dimension == 2:
        require(
            abs(math.cos(strike)) < 1e-9,
            f"strike = {bedding.strike}: in two dimensions strata strike along y, give 90 (dip towards +x) or 270",
        )
        towards = round(math.sin(strike))
        return np.array([[towards * math.cos(dip), -math.sin(dip)], [towards * math.sin(dip), math.cos(dip)]])
    along = np.array([math.cos(strike), math.sin(strike), 0.0])
    right = np.array([math.sin(strike), -math.cos(strike), 0.0])
    up = np.array([0.0, 0.0, 1.0])
    return np.stack([math.cos(dip) * right - math.sin(dip) * up, along, math.sin(dip) * right + math.cos(dip) * up])


def rotated_box(
    bedding: Bedding, origin: tuple[float, ...], extent: tuple[float, ...]
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Origin and extent in rotated axes of the smallest box that holds the given one (m)."""
    matrix = rotation_matrix(bedding, len(origin))
    corners = np.array(list(itertools.product(*zip(origin, np.add(origin, extent), strict=True)))).T
    turned = matrix @ corners
    low = turned.min(axis=1)
    return tuple(map(float, low)), tuple(map(float, turned.max(axis=1) - low))


def rotate(bedding: Bedding, points: Array) -> Array:
    """Points (d, N) in the axes of the strata (m). ValueError for another shape, or points that are not finite."""
    require(points.ndim == 2, f"points of shape {points.shape}: give (2, N) or (3, N)")
    check.finite("points", points)
    return jnp.asarray(rotation_matrix(bedding, points.shape[0]), points.dtype) @ points
