"""Nodal walls: what they hold is zero on and beyond their plane."""

from __future__ import annotations

from collections.abc import Sequence

import jax
import jax.numpy as jnp
from jax import Array

from jaxmpm.types import Grid, Wall


def hold(walls: Sequence[Wall], grid: Grid, nodal: Array) -> Array:
    """Velocities or accelerations (nodes, d) with the held components set to 0."""
    if not walls:
        return nodal
    shape = (*grid.shape, grid.dimension)
    field = nodal.reshape(shape)
    for wall in walls:
        # Index arithmetic, not a stored mask: it is fused into the nodal update and costs no memory.
        along = jax.lax.broadcasted_iota(jnp.int32, shape, wall.axis)
        held = along <= wall.index if wall.side == "low" else along >= wall.index
        if wall.hold == "roller":
            held &= jax.lax.broadcasted_iota(jnp.int32, shape, grid.dimension) == wall.axis
        field = jnp.where(held, 0, field)
    return field.reshape(nodal.shape)
