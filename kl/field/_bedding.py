"""Rotated anisotropy: strata that dip, whose covariance is separable along dip, strike and normal.

The expansion is made on the smallest box in rotated axes that holds the given one, and points are rotated into
those axes. Coordinates: x along the run-out, y along the slope, z up.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jax import Array

from kl._checks import finite, require
from kl.types import HostArray


@dataclass(frozen=True)
class Bedding:
    """Orientation of strata; static.

    The axes of the covariance are then: down the dip in the bedding plane, along strike, and normal to the plane,
    upwards; in two dimensions (x, z) the first and the third.

    Args:
        dip: steepest inclination below the horizontal (degrees), in [0, 90].
        strike: direction of the horizontal line in the bedding plane (degrees), anticlockwise from +x seen from above.
            The strata fall to its right: with 90, along y, they dip towards +x.
    """

    dip: float
    strike: float = 90.0


def rotation_matrix(bedding: Bedding, dimension: int) -> HostArray:
    """Unit vectors down dip, along strike and normal as rows (d, d); `matrix @ points` rotates points (d, N)."""
    require(dimension in (2, 3), f"bedding in {dimension} dimension: it needs 2 or 3")
    finite("strike", bedding.strike, remedy="it is an angle in degrees")
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
    """Origin and extent (m) in rotated axes of the smallest box that holds the given one."""
    matrix = rotation_matrix(bedding, len(origin))
    corners = np.array(list(itertools.product(*zip(origin, np.add(origin, extent), strict=True)))).T
    rotated = matrix @ corners
    low = rotated.min(axis=1)
    return tuple(map(float, low)), tuple(map(float, rotated.max(axis=1) - low))


def rotate(bedding: Bedding, points: Array) -> Array:
    """Rotate points into the axes of the strata.

    Args:
        bedding: orientation of the strata.
        points: (d, N) in metres, d 2 or 3, finite.

    Returns:
        Points (d, N) in metres along dip, strike and normal.

    Raises:
        ValueError: If the points have another shape or are not finite, or a dip or strike is out of range.
    """
    require(points.ndim == 2, f"points of shape {points.shape}: give (2, N) or (3, N)")
    finite("points", points)
    return jnp.asarray(rotation_matrix(bedding, points.shape[0]), points.dtype) @ points
