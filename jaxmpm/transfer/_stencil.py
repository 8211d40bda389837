"""Transfers in plain jnp: the reference of the native engine, and its replacement on other devices.

A transfer is a list of terms. Each joins a row of a particle array to a channel of the nodal array through the weight
of a node, or one of the weight's derivatives along some axes. Particles to nodes and nodes to particles under the same
terms are each other's transpose.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from jaxmpm.grid import Grid
from jaxmpm.protocols import Kernel
from jaxmpm.transfer._shape import WIDTH, base_node, locate


class Term(NamedTuple):
    """One product in a transfer: factor * row * weight <-> channel.

    Args:
        row: number of the row of the particle array.
        channel: number of the channel of the nodal array.
        axes: axes along which the weight is differentiated, once each, sorted.
        factor: of the product.
    """

    row: int
    channel: int
    axes: tuple[int, ...] = ()
    factor: int = 1


def scatter(
    grid: Grid,
    kernel: Kernel,
    position: Array,
    rows: Sequence[Array],
    *,
    terms: Sequence[Term],
    channels: int,
    first: Array | None = None,
) -> Array:
    """Map particles to nodes.

    Args:
        grid: of the nodes.
        kernel: shape functions.
        position: (d, N) m.
        rows: arrays (N,).
        terms: of the transfer.
        channels: number of channels.
        first: (1, columns) as of `NearNodes`; None for a grid that stores all nodes.

    Returns:
        (nodes, channels).
    """
    # A GPU adds four channels of a node at once where their number is a multiple of four: twice as fast as seven.
    width = channels if channels <= 2 else -(-channels // 4) * 4
    nodal = jnp.zeros((rows_of_grid(grid), width), position.dtype)
    for node, weight in _layers(grid, kernel, position, terms, first):
        contribution = _sums([(t.channel, t.factor * rows[t.row] * weight[t.axes]) for t in terms], width, node)
        nodal = nodal.at[node].add(jnp.stack(contribution, axis=-1))
    return nodal[:, :channels]


def gather(
    grid: Grid,
    kernel: Kernel,
    position: Array,
    nodal: Array,
    *,
    terms: Sequence[Term],
    rows: int,
    first: Array | None = None,
) -> Array:
    """Map nodes to particles.

    Args:
        grid: of the nodes.
        kernel: shape functions.
        position: (d, N) m.
        nodal: (nodes, channels).
        terms: of the transfer.
        rows: number of rows.
        first: as of `scatter`.

    Returns:
        (rows, N).
    """
    products = []
    for node, weight in _layers(grid, kernel, position, terms, first):
        values = nodal[node]
        products += [(t.row, (t.factor * values[..., t.channel] * weight[t.axes]).sum(0)) for t in terms]
    return jnp.stack(_sums(products, rows, position[0]))


def _sums(products: Sequence[tuple[int, Array]], count: int, like: Array) -> list[Array]:
    """Sum of the products with each number below `count`; zeros if there is none."""
    sums: list[Array | None] = [None] * count
    for number, product in products:
        before = sums[number]
        sums[number] = product if before is None else before + product
    dtype = next(s.dtype for s in sums if s is not None)
    return [jnp.zeros(like.shape, dtype) if s is None else s for s in sums]


def _layers(
    grid: Grid, kernel: Kernel, position: Array, terms: Sequence[Term], first: Array | None
) -> Iterator[tuple[Array, dict[tuple[int, ...], Array]]]:
    """The stencil in three layers across the first axis, each as (nodes (m, N), {axes: weight derived so (m, N)}).

    A layer at a time compiles to a small program, and to arrays nine times the particles' rather than 27.
    """
    cells = locate(grid, position)
    base = base_node(grid, cells)
    sets = {term.axes for term in terms}
    order = max((len(axes) for axes in sets), default=0)
    nodes = base[:, None] + jnp.arange(WIDTH, dtype=base.dtype)[:, None]
    factors = [
        _derivatives(kernel, a, grid.cell, cells[a] - nodes[a].astype(cells.dtype), order)
        for a in range(grid.dimension)
    ]
    for k in range(WIDTH):
        node = nodes[0, k : k + 1]
        weights = {axes: factors[0][axes.count(0)][k : k + 1] for axes in sets}
        for a in range(1, grid.dimension):
            # Nodes of a column follow each other.
            last = a == grid.dimension - 1
            start = first[0, node] if first is not None and last else node * grid.shape[a]
            node = _outer(jnp.add, start, nodes[a])
            weights = {axes: _outer(jnp.multiply, w, factors[a][axes.count(a)]) for axes, w in weights.items()}
        yield node if first is None else jnp.clip(node, 0, rows_of_grid(grid) - 1), weights


def rows_of_grid(grid: Grid) -> int:
    """Length of an array of nodal values in a transfer."""
    return grid.nodes if grid.stored is None else grid.stored


def _outer(operation: Callable[[Array, Array], Array], a: Array, b: Array) -> Array:
    """All pairs of (m, N) and (n, N): (m n, N)."""
    return operation(a[:, None], b[None]).reshape(-1, a.shape[-1])


def _derivatives(kernel: Kernel, axis: int, cell: float, r: Array, order: int) -> list[Array]:
    """Values of a 1D shape function at r cells from its node, and its derivatives (1/m^n) up to `order`."""
    value, slope = kernel.shape(axis, cell, r)
    values = [value, slope]
    nth: Callable[[Array], Array] = lambda r: kernel.shape(axis, cell, r)[1]  # noqa: E731
    for _ in range(order - 1):
        nth = _derivative(nth, cell)
        values.append(nth(r))
    return values


def _derivative(function: Callable[[Array], Array], cell: float) -> Callable[[Array], Array]:
    return lambda r: jax.jvp(function, (r,), (jnp.ones_like(r),))[1] / cell
