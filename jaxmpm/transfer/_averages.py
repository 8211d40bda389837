"""Averages over particles, through the grid or within its cells: cures for volumetric locking and mesh dependence."""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
from jax import Array

from jaxmpm.grid import Grid
from jaxmpm.protocols import Kernel
from jaxmpm.support import check
from jaxmpm.transfer._cells import cell_sums
from jaxmpm.transfer._near import of_all, of_stored
from jaxmpm.transfer._shape import locate
from jaxmpm.types import Engine

REACH = 4.0
"""Nodes beyond the grid into which filters spread, in standard deviations of their weights."""


def filtered(grid: Grid, nodal: Array, passes: int) -> Array:
    """Nodal sums after binomial filters (1, 2, 1) / 4 along each axis.

    Each filter adds cell^2 / 2 to the variance of a particle's weights. What leaves the grid comes back on the same
    side with later filters, as on a grid without end, and less than 1e-4 of it on the other.

    Args:
        grid: of the nodes.
        nodal: (nodes, c) sums, which spread over all nodes, also where those near soil alone are stored.
        passes: number of filters.

    Returns:
        (nodes, c).
    """
    if not passes:
        return nodal
    field = of_all(grid, nodal).reshape(*grid.shape, -1)
    # One filter reaches the padding of the grid alone.
    margin = 0 if passes < 2 else math.ceil(REACH * math.sqrt(passes / 2))
    for axis in range(grid.dimension):

        def smoothed(_: int, field: Array, axis: int = axis) -> Array:
            return 0.5 * field + 0.25 * (jnp.roll(field, 1, axis) + jnp.roll(field, -1, axis))

        # A loop: XLA would fuse unrolled filters, and each would recompute those before it at three nodes.
        beyond = [(0, margin if other_axis == axis else 0) for other_axis in range(field.ndim)]
        field = jax.lax.fori_loop(0, passes, smoothed, jnp.pad(field, beyond) if margin else field)
        field = jax.lax.slice_in_dim(field, 0, grid.shape[axis], axis=axis)
    return of_stored(grid, field.reshape(-1, nodal.shape[1]))


def within_cells(
    grid: Grid,
    position: Array,
    values: Array,
    weights: Array,
    apart: Array | None = None,
    *,
    engine: Engine | None = None,
) -> Array:
    """Average over the particles in the same cell, by weight.

    It is a projection, symmetric in the weights: averaging twice changes nothing.

    Args:
        grid: of the cells.
        position: (d, N) m.
        values: (N,).
        weights: (N,).
        apart: whether a particle is of the second of two groups (N,), each averaged by itself; None for one group.
        engine: None takes native kernels on CPU if they were built, else XLA.

    Returns:
        (N,).
    """
    cells = jnp.floor(locate(grid, position)).astype(jnp.int32)
    cell = jnp.zeros(position.shape[-1:], jnp.int32)
    for axis, nodes in enumerate(grid.shape):
        # Where nodes near soil alone are stored, the row of the cell's lowest node, which its particles reach.
        last = axis == grid.dimension - 1
        start = grid.near.first[0, cell] if grid.near is not None and last else cell * nodes
        cell = start + jnp.clip(cells[axis], 0, nodes - 1)
    cell = cell if grid.near is None else jnp.clip(cell, 0, grid.rows - 1)
    groups = 1 if apart is None else 2
    cell = cell if apart is None else cell + grid.rows * apart

    both = jnp.stack([weights * values, weights])
    total, weight = cell_sums(cell, both, cells=groups * grid.rows, engine=engine)
    return total / weight


def band_thickness(length: float) -> float:
    """Thickness of a band of softening soil whose plastic strain is averaged over a length.

    It is the width of the box with the peak and the area of the average's Gaussian.

    Args:
        length: standard deviation of the average (m).

    Returns:
        Thickness (m).

    Raises:
        ValueError: If the length is not above 0.
    """
    check.positive("internal_length", length, "m")
    return math.sqrt(2 * math.pi) * length


def length_of_band(thickness: float) -> float:
    """Internal length with which bands have a given thickness: the inverse of `band_thickness`.

    Args:
        thickness: of the bands (m).

    Returns:
        Length (m).
    """
    return thickness / math.sqrt(2 * math.pi)


def passes_for(length: float, kernel: Kernel, cell: float) -> int:
    """Number of filters that make the weights of the average a Gaussian of a given deviation.

    Args:
        length: standard deviation (m).
        kernel: shape functions.
        cell: edge of a cell (m).

    Returns:
        The number, 0 or more.

    Raises:
        ValueError: If `length` is below the kernel's own deviation.
    """
    least = kernel.deviation(cell)
    if length < least:
        raise ValueError(
            f"internal_length = {length:g} m is less than cells of {cell:g} m resolve ({least:.2g} m): "
            "give a longer one, or smaller cells"
        )
    return round((length**2 - least**2) / (cell**2 / 2))


def thickness_on(passes: int | None, kernel: Kernel, cell: float) -> float:
    """Thickness (m) of bands with so many filters in the average of the plastic strain; without one it is a cell.

    Args:
        passes: from `passes_for`, or None without an average.
        kernel: shape functions.
        cell: edge of a cell (m).
    """
    return cell if passes is None else band_thickness(math.sqrt(passes * cell**2 / 2 + kernel.deviation(cell) ** 2))
