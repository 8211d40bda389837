"""Sums over the particles' stencils in plain jnp: what a transfer means, and how it runs without the native engine.

A transfer is a list of terms. Each joins a row of a particle array to a channel of the nodal array through the weight
of a node, or one of the weight's derivatives along some axes. Particles to nodes and nodes to particles under the same
terms are each other's transpose.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from jaxmpm.shape import WIDTH, base_node, locate, shape_1d
from jaxmpm.types import Grid, Kernel


class Term(NamedTuple):
    """One product in a transfer: factor * row * (weight derived once along each of `axes`, sorted) <-> channel."""

    row: int
    channel: int
    axes: tuple[int, ...] = ()
    factor: int = 1


def scatter(
    grid: Grid, kernel: Kernel, position: Array, rows: Sequence[Array], *, terms: Sequence[Term], channels: int
) -> Array:
    """Particles to nodes: position (d, N) m and rows, each (N), to (nodes, channels)."""
    nodal = jnp.zeros((grid.nodes, channels), position.dtype)
    for node, weight in _stencil(grid, kernel, position, terms):
        contribution = [(t.channel, t.factor * rows[t.row] * weight[t.axes]) for t in terms]
        nodal = nodal.at[node].add(jnp.stack(_sums(contribution, channels, position[0]), axis=-1))
    return nodal


def gather(grid: Grid, kernel: Kernel, position: Array, nodal: Array, *, terms: Sequence[Term], rows: int) -> Array:
    """Nodes to particles: position (d, N) m and nodal (nodes, channels) to (rows, N)."""
    products = []
    for node, weight in _stencil(grid, kernel, position, terms):
        values = nodal[node]
        products += [(t.row, t.factor * values[:, t.channel] * weight[t.axes]) for t in terms]
    return jnp.stack(_sums(products, rows, position[0]))


def _sums(products: Sequence[tuple[int, Array]], count: int, like: Array) -> list[Array]:
    """Sum of the products with each number below `count`; zeros where there is none."""
    sums: list[Array | None] = [None] * count
    for number, product in products:
        before = sums[number]
        sums[number] = product if before is None else before + product
    return [jnp.zeros_like(like) if s is None else s for s in sums]


def _stencil(grid: Grid, kernel: Kernel, position: Array, terms: Sequence[Term]):
    """Yield (node (N), {axes: weight derived along them (N)}) for each node of the product stencil."""
    cells = locate(grid, position)
    base = base_node(grid, cells)
    wanted = {term.axes for term in terms}
    order = max((len(axes) for axes in wanted), default=0)
    factors = [
        [
            _derivatives(kernel, axis, grid.cell, cells[axis] - (base[axis] + k).astype(cells.dtype), order)
            for k in range(WIDTH)
        ]
        for axis in range(grid.dimension)
    ]
    for offsets in itertools.product(range(WIDTH), repeat=grid.dimension):
        node = base[0] + offsets[0]
        for axis in range(1, grid.dimension):
            node = node * grid.shape[axis] + base[axis] + offsets[axis]
        weights = {}
        for axes in wanted:
            weight = factors[0][offsets[0]][axes.count(0)]
            for axis in range(1, grid.dimension):
                weight = weight * factors[axis][offsets[axis]][axes.count(axis)]
            weights[axes] = weight
        yield node, weights


def _derivatives(kernel: Kernel, axis: int, cell: float, r: Array, order: int) -> list[Array]:
    """A 1D shape function at r cells from its node, and its derivatives (1/m^n) up to `order`."""
    value, slope = shape_1d(kernel, axis, cell, r)
    found = [value, slope]
    nth: Callable[[Array], Array] = lambda r: shape_1d(kernel, axis, cell, r)[1]  # noqa: E731
    for _ in range(order - 1):
        nth = _derivative(nth, cell)
        found.append(nth(r))
    return found


def _derivative(function: Callable[[Array], Array], cell: float) -> Callable[[Array], Array]:
    return lambda r: jax.jvp(function, (r,), (jnp.ones_like(r),))[1] / cell
