"""Particles of a lattice that the surface of ground cuts: each has the volume of its part below it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from jaxmpm.grid import Particles
from jaxmpm.ground._base import Heights
from jaxmpm.ground._ground import Ground
from jaxmpm.setup import Discretisation, fill
from jaxmpm.soil import STANDARD_GRAVITY
from jaxmpm.support.tracing import product

SAMPLED = 4
"""Points along each side of a column of particles at which its surface is sampled."""


LEAST_SHARE = 0.02
"""Least share of its box for a particle; with less, its stress would be rounding only."""


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
        Particles.

    Raises:
        ValueError: If none is left.
    """
    dx, dy, dz = discretisation.spacing
    length, width, height = ground.extent
    nx, ny, nz = round(length / dx), round(width / dy), math.ceil(height / dz * (1 - 1e-12))
    x, y = (
        start + (np.arange(n * SAMPLED) + 0.5) * step / SAMPLED
        for start, n, step in zip(ground.corner, (nx, ny), (dx, dy), strict=False)
    )

    def below(heights: Heights) -> np.ndarray:
        """Share (nx, ny, nz) of each box that lies below a surface."""
        z = (heights(*np.meshgrid(x, y, indexing="ij")) - ground.corner[-1]) / dz
        samples = z.reshape(nx, SAMPLED, ny, SAMPLED).transpose(1, 3, 0, 2).reshape(SAMPLED**2, nx, ny, 1)
        return np.mean([np.clip(sampled - np.arange(nz), 0, 1) for sampled in samples], axis=0)

    steps = zip(ground.corner, (nx, ny, nz), discretisation.spacing, strict=True)
    centres = np.meshgrid(*(start + (np.arange(n) + 0.5) * step for start, n, step in steps), indexing="ij")
    share = below(ground.heights)
    if bedrock is not None:
        share -= below(bedrock)
        # The volume of a box whose centre lies in the rock goes to the box above it.
        buried = np.where(centres[2] < bedrock(*centres[:2]), share, 0)
        share -= buried
        share[..., 1:] += np.where(share[..., 1:] > 0, buried[..., :-1], 0)
    # The volume of a sliver goes to the box below it.
    sliver = np.where(share < LEAST_SHARE, share, 0)
    sliver[..., 0] = 0
    share -= sliver
    share[..., :-1] += np.where(share[..., :-1] > 0, sliver[..., 1:], 0)
    modelled = (share.ravel() > 0) & inside(np.stack([axis.ravel() for axis in centres]))
    if not modelled.any():
        raise ValueError("the cuts leave no particle: draw the polygon larger, or take smaller particles")
    particles = fill(
        (length, width, nz * dz), (dx, dy, dz), unit_weight=STANDARD_GRAVITY, inside=lambda _: modelled,
        corner=ground.corner, dtype=discretisation.dtype,
    )  # fmt: skip
    share_of_each = np.asarray(share.ravel()[modelled], particles.volume.dtype)
    return replace(particles, volume=product(particles.volume, share_of_each))
