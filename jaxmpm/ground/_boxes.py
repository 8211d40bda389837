"""Particles of a lattice that the surface of ground cuts: each has the volume of its part below it."""

from __future__ import annotations

import math
from collections.abc import Callable

import jax
import numpy as np

from jaxmpm.grid import Particles
from jaxmpm.ground._base import Heights
from jaxmpm.ground._ground import Ground
from jaxmpm.setup import Discretisation
from jaxmpm.support import check
from jaxmpm.support.tracing import array

SAMPLED = 4
"""Points along each side of a column of particles at which its surface is sampled."""


LEAST_SHARE = 0.02
"""Least share of its box for a particle; with less, its stress would be rounding only."""

AT_ONCE = 10**5
"""Boxes of the lattice whose shares are found at once: on terrain most of them are air or rock."""


def boxes(
    ground: Ground, discretisation: Discretisation, inside: Callable[[np.ndarray], np.ndarray], bedrock: Heights | None
) -> Particles:
    """The particles under the surface, each with its share of its box's volume.

    Args:
        ground: in three dimensions.
        discretisation: cell, spacing and numerical choices.
        inside: function of positions (3, N) m that returns (N,) bool, which of them to model.
        bedrock: rigid ground, above which they lie; None for none.

    Returns:
        Particles of density 1.

    Raises:
        ValueError: If none is left.
    """
    dtype, spacing = check.dtype(discretisation.dtype or jax.dtypes.canonicalize_dtype(float)), discretisation.spacing
    nx, ny, nz = _counts(ground, spacing)
    steps = zip(ground.corner, (nx, ny, nz), spacing, strict=True)
    along, across, z = (start + (np.arange(n) + 0.5) * step for start, n, step in steps)
    plan = np.meshgrid(along, across, indexing="ij")
    surface = _samples(ground, ground.heights, spacing, (nx, ny))
    rock = None if bedrock is None else (_samples(ground, bedrock, spacing, (nx, ny)), bedrock(*plan))
    positions, shares = [], []
    rows = _rows(ny, nz)
    for part in (slice(start, start + rows) for start in range(0, nx, rows)):
        share = _below(surface[:, part], nz)
        if rock is not None:
            samples, floor = rock
            share -= _below(samples[:, part], nz)
            # The volume of a box whose centre lies in the rock goes to the box above it.
            buried = np.where(z < floor[part, :, None], share, 0)
            share -= buried
            share[..., 1:] += np.where(share[..., 1:] > 0, buried[..., :-1], 0)
        # The volume of a sliver goes to the box below it.
        sliver = np.where(share < LEAST_SHARE, share, 0)
        sliver[..., 0] = 0
        share -= sliver
        share[..., :-1] += np.where(share[..., :-1] > 0, sliver[..., 1:], 0)
        i, j, k = np.nonzero(share > 0)
        position = np.stack([along[part][i], across[j], z[k]])
        modelled = inside(position)
        positions.append(position[:, modelled])
        shares.append(share[i, j, k][modelled])
    of_box = np.concatenate(shares)
    if not of_box.size:
        raise ValueError("the cuts leave no particle: draw the polygon larger, or take smaller particles")
    volume = array(np.asarray(np.prod(spacing), dtype) * of_box.astype(dtype), dtype)
    return Particles(array(np.concatenate(positions, axis=1), dtype), mass=volume, volume=volume)


def points_held(ground: Ground, discretisation: Discretisation) -> float:
    """How many points `boxes` has in memory at once, estimated upwards.

    Args:
        ground: in three dimensions.
        discretisation: with the spacing of the points.

    Returns:
        As many as there are numbers of its parts of the lattice and its samples of surfaces, over the fifteen numbers
        of a point.
    """
    nx, ny, nz = _counts(ground, discretisation.spacing)
    return 3 * min(_rows(ny, nz), nx) * ny * nz + 2 * SAMPLED**2 * nx * ny


def _counts(ground: Ground, spacing: tuple[float, ...]) -> tuple[int, int, int]:
    """Boxes along each axis."""
    (dx, dy, dz), (length, width, height) = spacing, ground.extent
    return round(length / dx), round(width / dy), math.ceil(height / dz * (1 - 1e-12))


def _rows(across: int, up: int) -> int:
    """Rows of columns that are looked at together."""
    return max(AT_ONCE // (across * up), 1)


def _samples(ground: Ground, heights: Heights, spacing: tuple[float, ...], columns: tuple[int, int]) -> np.ndarray:
    """Heights of a surface over the base (SAMPLED**2, nx, ny), over the height of a box, at points of each column."""
    x, y = (
        start + (np.arange(n * SAMPLED) + 0.5) * step / SAMPLED
        for start, n, step in zip(ground.corner, columns, spacing, strict=False)
    )
    z = (heights(*np.meshgrid(x, y, indexing="ij")) - ground.corner[-1]) / spacing[-1]
    nx, ny = columns
    return z.reshape(nx, SAMPLED, ny, SAMPLED).transpose(1, 3, 0, 2).reshape(SAMPLED**2, nx, ny)


def _below(samples: np.ndarray, boxes: int) -> np.ndarray:
    """Share (nx, ny, boxes) of each box that lies below a surface."""
    return np.mean([np.clip(sampled[..., None] - np.arange(boxes), 0, 1) for sampled in samples], axis=0)
