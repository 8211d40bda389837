"""Averages over particles, by way of the grid or within its cells: cures for volumetric locking and mesh dependence."""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
from jax import Array

from foundation import check
from jaxmpm.transfer._shape import locate
from jaxmpm.types import Grid, Kernel


def filtered(grid: Grid, nodal: Array, passes: int) -> Array:
    """Nodal sums (nodes, c) after `passes` binomial filters (1, 2, 1) / 4 along each axis: each adds a variance of
    cell^2 / 2 to how far a particle's share reaches. Sums at the grid's outermost nodes lose what leaves the grid."""
    field = nodal.reshape(*grid.shape, -1)
    for axis in range(grid.dimension if passes else 0):

        def smoothed(_: int, field: Array, axis: int = axis) -> Array:
            return 0.5 * field + 0.25 * (jnp.roll(field, 1, axis) + jnp.roll(field, -1, axis))

        # A loop: filters written out one by one are fused, and each computes those before it again at three nodes.
        field = jax.lax.fori_loop(0, passes, smoothed, field)
    return field.reshape(nodal.shape)


def within_cells(grid: Grid, position: Array, values: Array, weights: Array) -> Array:
    """Average (N,) of `values` (N,) over the particles at `position` (d, N) m in the same cell, by weight (N,).

    A projection, and symmetric in the weights: what it has averaged it leaves as it is.
    """
    cells = jnp.floor(locate(grid, position)).astype(jnp.int32)
    cell = jnp.zeros(position.shape[-1:], jnp.int32)
    for axis, nodes in enumerate(grid.shape):
        cell = cell * nodes + jnp.clip(cells[axis], 0, nodes - 1)
    sums = jnp.zeros((grid.nodes, 2), values.dtype).at[cell].add(jnp.stack([weights, weights * values], axis=-1))
    weight, weighted = jnp.moveaxis(sums[cell], -1, 0)
    return weighted / weight


def band_thickness(length: float) -> float:
    """Thickness (m) of a band of softening soil whose plastic strain is averaged over `length` (m): that of the box
    which has the peak and the area of the average's bell. Raises ValueError for what is no length."""
    check.positive("internal_length", length, "m")
    return math.sqrt(2 * math.pi) * length


def length_of_band(thickness: float) -> float:
    """The internal length (m) with which bands are as thick as `thickness` (m)."""
    return thickness / math.sqrt(2 * math.pi)


def passes_for(length: float, kernel: Kernel, cell: float) -> int:
    """Filters that make the weights of the average a bell of standard deviation `length` (m).

    Raises ValueError where `length` is below the kernel's own deviation.
    """
    least = kernel.deviation(cell)
    if length < least:
        raise ValueError(
            f"internal_length = {length:g} m is less than cells of {cell:g} m resolve ({least:.2g} m): "
            "give a longer one, or smaller cells"
        )
    return round((length**2 - least**2) / (cell**2 / 2))
