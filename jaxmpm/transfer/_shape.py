"""1D shape functions and their product stencil: three nodes per axis for every kernel.

With r the distance from a node in cells, a particle at x touches the nodes base, base + 1 and base + 2 of an
axis, base = floor(x/h - 1/2). Weights beyond a kernel's support are zero.
"""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from jaxmpm.types import GIMP, Grid, Kernel, Linear, QuadraticBSpline

WIDTH = 3
"""Nodes per axis in a stencil."""


def locate(grid: Grid, position: Array) -> Array:
    """Position (d, N) in cells from node 0, the measure that the other functions here take."""
    origin = jnp.asarray(grid.origin, position.dtype)[:, None]
    return (position - origin) / grid.cell


def inside(grid: Grid, cells: Array) -> Array:
    """Whether all nodes of the stencils lie on the grid: (N) bool, False for NaN."""
    limits = jnp.asarray(grid.shape, cells.dtype)[:, None]
    return jnp.all((cells >= 0.5) & (cells < limits - 1.5), axis=0)


def base_node(grid: Grid, cells: Array) -> Array:
    """Lowest node of each stencil (d, N), kept on the grid whatever the position (NaN too)."""
    highest = jnp.asarray(grid.shape, cells.dtype)[:, None] - WIDTH
    lowest = jnp.floor(cells - 0.5)
    return jnp.where(lowest > 0, jnp.minimum(lowest, highest), 0).astype(jnp.int32)


def shape_1d(kernel: Kernel, axis: int, cell: float, r: Array) -> tuple[Array, Array]:
    """Value and derivative (1/m) of a node's shape function at distance r = (x - x_node)/h.

    Linear: 1 - |r|. GIMP, with l the half size in cells (Steffen, Kirby and Berzins 2008, IJNME 76, 922-948):
    1 - (r^2 + l^2)/(2 l) for |r| < l, 1 - |r| up to 1 - l, (1 + l - |r|)^2/(4 l) up to 1 + l.
    Quadratic B-spline (same source): 3/4 - r^2 for |r| < 1/2, (3/2 - |r|)^2/2 up to 3/2. Zero where r is NaN.
    """
    a = jnp.abs(r)
    sign = jnp.where(r < 0, 1.0, -1.0).astype(r.dtype)
    if isinstance(kernel, Linear):
        support = (r >= -1) & (r < 1)
        return jnp.where(support, 1 - a, 0.0), jnp.where(support, sign / cell, 0.0)
    if isinstance(kernel, GIMP):
        l = kernel.half_size[axis] / cell
        tail = jnp.where(a < 1 + l, 1 + l - a, 0)
        value = jnp.where(a < l, 1 - (r * r + l * l) / (2 * l), jnp.where(a < 1 - l, 1 - a, tail * tail / (4 * l)))
        slope = jnp.where(a < l, -r / l, jnp.where(a < 1 - l, sign, sign * tail / (2 * l)))
        return value, slope / cell
    if isinstance(kernel, QuadraticBSpline):
        tail = jnp.where(a < 1.5, 1.5 - a, 0)
        value = jnp.where(a < 0.5, 0.75 - r * r, 0.5 * tail * tail)
        return value, jnp.where(a < 0.5, -2 * r, sign * tail) / cell
    raise TypeError(f"no shape functions for {kernel!r}: use one of {Kernel}")
