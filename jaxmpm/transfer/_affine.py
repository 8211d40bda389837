"""APIC: particles carry the gradient of the velocity around them, so that transfers conserve angular momentum.

The method is for quadratic B-splines, whose weights have the second moment cell^2 / 4 at any position. A momentum field
m (v + C (x_node - x)) is mapped as its value and gradient at the grid's origin, which needs no transfer of its own.

Source: Jiang, Schroeder, Selle, Teran and Stomakhin (2015), doi:10.1145/2766996, Section 5.
"""

from __future__ import annotations

from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import DTypeLike

from jaxmpm.grid import Grid
from jaxmpm.tensors import dot
from jaxmpm.transfer._near import along
from jaxmpm.types import Scene, State


def momentum(scene: Scene, state: State, position: Array) -> Array:
    """Momentum that particles map to the grid.

    Args:
        scene: of the particles.
        state: their velocity, and the affine part if there is one.
        position: (d, N) m on the grid.

    Returns:
        m v (d, N), or with an affine part (d + d d, N).
    """
    m = scene.particles.mass
    if state.affine is None:
        return m * state.velocity
    x = position - jnp.asarray(scene.grid.origin, position.dtype)[:, None]
    at_origin = m * (state.velocity - jnp.sum(state.affine * x[None], axis=1))
    return jnp.concatenate([at_origin, (m * state.affine).reshape(-1, m.size)])


def nodal_momentum(grid: Grid, nodal: Array) -> Array:
    """Momentum of the nodes from the sums of what `momentum` returned.

    Args:
        grid: of the nodes.
        nodal: (nodes, d) or (nodes, d + d d).

    Returns:
        (nodes, d) kg m/s.
    """
    d = grid.dimension
    if nodal.shape[1] == d:
        return nodal
    slopes = nodal[:, d:].reshape(-1, d, d)
    return nodal[:, :d] + dot(slopes, _nodes(grid, nodal.dtype)[:, None, :])


def velocity_gradient(
    grid: Grid, position: Array, velocity: Array, to_particles: Callable[..., tuple[Array, Array]]
) -> Array:
    """Velocity gradient C of APIC at the particles.

    Args:
        grid: of the nodes.
        position: (d, N) m on the grid.
        velocity: (nodes, d) m/s.
        to_particles: interpolates nodal values, as `g2p`.

    Returns:
        (d, d, N) 1/s.
    """
    d = grid.dimension
    moments = (velocity[:, :, None] * _nodes(grid, velocity.dtype)[:, None, :]).reshape(-1, d * d)
    values, _ = to_particles(jnp.concatenate([velocity, moments], axis=1), values=d + d * d, gradients=0)
    x = position - jnp.asarray(grid.origin, position.dtype)[:, None]
    return 4 / grid.cell**2 * (values[d:].reshape(d, d, -1) - values[:d, None] * x[None])


def _nodes(grid: Grid, dtype: DTypeLike) -> Array:
    """Positions of the nodes from the first one (nodes, d), m."""
    if grid.near is not None:
        return jnp.stack([along(grid, axis) for axis in range(grid.dimension)], axis=1).astype(dtype) * grid.cell
    return jnp.asarray(np.stack(np.unravel_index(np.arange(grid.nodes), grid.shape), axis=1) * grid.cell, dtype)
