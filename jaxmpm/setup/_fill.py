"""Particles that fill a box."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import jax
import numpy as np
from jax.typing import DTypeLike

from jaxmpm.grid import Grid, Particles
from jaxmpm.setup._discretisation import Discretisation
from jaxmpm.soil import STANDARD_GRAVITY, AnySoil
from jaxmpm.support import check
from jaxmpm.support.tracing import array, host, taken


def fill(
    extent: Sequence[float],
    spacing: Sequence[float],
    *,
    unit_weight: float,
    inside: Callable[[np.ndarray], np.ndarray] | None = None,
    corner: Sequence[float] | None = None,
    dtype: DTypeLike | None = None,
) -> Particles:
    """Equal particles that fill a box, at the centres of boxes of size `spacing`.

    Args:
        extent: edges of the box (m).
        spacing: edges of a particle's own box (m), one value per axis.
        unit_weight: N/m3.
        inside: function of positions (d, N) m from the corner that returns (N,) bool, which particles to take; None
            takes all.
        corner: lowest corner of the box (m), by default the origin.
        dtype: float32 or float64; None for that of JAX.

    Returns:
        Particles.

    Raises:
        ValueError: If sizes do not fit, or no particle is inside.
    """
    dtype, d = check.dtype(dtype or jax.dtypes.canonicalize_dtype(float)), len(extent)
    check.axes("spacing", spacing, d)
    check.positive("spacing", spacing, "m")
    for a in range(d):
        check.multiple(f"extent[{a}]", extent[a], f"spacing[{a}]", spacing[a])
    check.positive("unit_weight", unit_weight, "N/m3")
    corner = (0.0,) * d if corner is None else corner
    check.axes("corner", corner, d)
    axes = [(np.arange(round(e / s)) + 0.5) * s for e, s in zip(extent, spacing, strict=True)]
    position = np.stack([a.ravel() for a in np.meshgrid(*axes, indexing="ij")])
    if inside is not None:
        mask = np.asarray(inside(position))
        if mask.shape != position.shape[1:] or mask.dtype != bool or not mask.any():
            raise ValueError(
                f"inside gave {mask.dtype} of shape {mask.shape}, {np.count_nonzero(mask)} of them true: give one bool "
                f"for each of {position.shape[1]} particles, some of them true"
            )
        position = position[:, mask]
    position = position + np.asarray(corner, float)[:, None]
    volume = float(np.prod(spacing))
    return Particles(
        position=array(position, dtype),
        mass=array(host(unit_weight).full(position.shape[1], unit_weight / STANDARD_GRAVITY * volume), dtype),
        volume=array(np.full(position.shape[1], volume), dtype),
    )


def box_particles(
    extent: Sequence[float], soil: AnySoil, discretisation: Discretisation, corner: Sequence[float] | None = None
) -> Particles:
    """Particles of a soil that fill a box.

    Args:
        extent: edges of the box (m).
        soil: of the particles.
        discretisation: cell, spacing and numerical choices.
        corner: lowest corner (d,) of the box (m), by default the origin.

    Returns:
        Particles.
    """
    return fill(extent, discretisation.spacing, unit_weight=soil.unit_weight, corner=corner, dtype=discretisation.dtype)


def ordered(particles: Particles, grid: Grid) -> Particles:
    """Particles in an order in which those that start with the same nodes follow each other, the last axis fastest.

    Args:
        particles: in any order.
        grid: whose nodes count.

    Returns:
        The same particles.
    """
    position = np.asarray(particles.position, float)
    cells = (position - np.asarray(grid.origin)[:, None]) / grid.cell
    number = np.floor(cells - 0.5).astype(np.int64)
    sequence = np.lexsort(number[::-1])
    return taken(particles, sequence)
