"""Storage of nodes that follows the soil: a step keeps those of each column of the grid that lie near soil.

On terrain the box around the ground has tens of nodes for each particle, few of which soil reaches. A scene whose grid
has a number of `stored` nodes gives these alone a row in arrays of nodal values. Which nodes they are follows from the
positions of the particles at each step, so that neither a state nor a restart knows of them. Where soil needs more, its
lane takes no step and has the status GRID_FULL; `solve` and `solve_each` go on from there with more.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.core import ShapedArray
from jax.extend.core import Primitive
from jax.interpreters import batching, mlir

from jaxmpm.grid import Grid, NearNodes
from jaxmpm.transfer import native
from jaxmpm.transfer._primitives import batched
from jaxmpm.transfer._shape import WIDTH, base_node, locate
from jaxmpm.transfer._stencil import rows_of_grid
from jaxmpm.types import Engine, Scene

SPARE = 2
"""Nodes stored over those that the soil needs, so that it seldom needs more."""

Values = TypeVar("Values")


def can_follow(scene: Scene) -> bool:
    """Whether nodes of a scene may be stored near its soil alone.

    Tied sides and free fields identify whole planes of nodes, also where soil reaches one of two. In one dimension all
    nodes are of one column.

    Args:
        scene: to run.

    Returns:
        Whether they may.
    """
    return scene.free_field is None and scene.boundary.tied is None and scene.grid.dimension > 1


def spreads(scene: Scene) -> bool:
    """Whether a step works on some values of all nodes, also where those near soil alone are stored.

    Averages of plastic strain and bridges across gaps spread through nodes that soil does not reach.

    Args:
        scene: to run.

    Returns:
        Whether it does, so that air costs steps.
    """
    return scene.numerics.bridging or bool(scene.numerics.nonlocal_passes)


near_p = Primitive("jaxmpm_near")  # position (d, N) -> arrays of `NearNodes`, (1, columns), (1, rows) and (1, 1)
near_p.multiple_results = True


def near_nodes(grid: Grid, position: Array, *, engine: Engine | None = None) -> NearNodes:
    """The nodes that particles reach.

    Args:
        grid: with a number of stored nodes.
        position: (d, N) m of the particles on the grid.
        engine: None takes native kernels on CPU if they were built, else XLA.

    Returns:
        Their rows.
    """
    position = jax.lax.stop_gradient(position)
    if engine is Engine.XLA:
        first, node, needed = _xla_of_lane(grid, position)
    else:
        first, node, needed = near_p.bind(position, grid=grid)
    return NearNodes(first, node[0], needed[0, 0])


def _xla_of_lane(grid: Grid, position: Array) -> list[Array]:
    """`near_p` of one lane as XLA compiles it."""
    assert grid.stored is not None
    first, height = columns_of(grid, position)
    ends = jnp.cumsum(height)
    starts, levels = ends - height, grid.shape[-1]
    column = jnp.arange(height.size, dtype=jnp.int32)
    # Rows from the start of a column on are the column's, until the next one starts.
    marks = jnp.zeros(grid.stored, jnp.int32).at[jnp.where(height > 0, starts, grid.stored)].max(column, mode="drop")
    of_row, row = jax.lax.cummax(marks), jnp.arange(grid.stored, dtype=jnp.int32)
    node = row - (starts - first)[of_row] + of_row * levels
    return [(starts - first)[None], jnp.where(row < ends[-1], node, -1)[None], ends[-1:, None]]


def _xla(position: Array, *, grid: Grid) -> list[Array]:
    one_lane: Callable[[Array], list[Array]] = partial(_xla_of_lane, grid)
    for _ in position.shape[:-2]:
        one_lane = jax.vmap(one_lane)
    return one_lane(position)


def _native(position: Array, *, grid: Grid) -> Sequence[Array]:
    if native.available() and position.dtype in (jnp.float32, jnp.float64):
        return native.near_nodes(grid, position)
    return _xla(position, grid=grid)


def _shapes(position: ShapedArray, *, grid: Grid) -> list[ShapedArray]:
    sizes = (math.prod(grid.shape[:-1]), rows_of_grid(grid), 1)
    return [ShapedArray((*position.shape[:-2], 1, size), jnp.int32) for size in sizes]


near_p.def_abstract_eval(_shapes)
near_p.def_impl(jax.jit(near_p.bind, static_argnames="grid"))
batching.primitive_batchers[near_p] = partial(batched, near_p)
mlir.register_lowering(near_p, mlir.lower_fun(_xla, multiple_results=True))
mlir.register_lowering(near_p, mlir.lower_fun(_native, multiple_results=True), platform="cpu")


def columns_of(grid: Grid, position: Array) -> tuple[Array, Array]:
    """Lowest node of each column that particles reach, numbered from the column's own lowest, and how many are kept.

    Above the highest that they reach one more is kept: whether ground goes on there tells where its surface is.

    Args:
        grid: of the nodes.
        position: (d, N) m of the particles on the grid.

    Returns:
        Both (columns,) int32, 0 for a column that none reaches.
    """
    *across, level = base_node(grid, locate(grid, position))
    plan, column = grid.shape[:-1], jnp.zeros_like(level)
    for nodes, number in zip(plan, across, strict=True):
        column = column * nodes + number
    none = jnp.int32(grid.shape[-1])
    ends = jnp.full((math.prod(plan), 2), none).at[column].min(jnp.stack([level, -level], axis=-1))
    ends = ends.reshape(*plan, 2)
    for axis, nodes in enumerate(plan):
        widths = [(WIDTH - 1, 0) if a == axis else (0, 0) for a in range(ends.ndim)]
        padded = jnp.pad(ends, widths, constant_values=none)
        shifted = [jax.lax.slice_in_dim(padded, k, k + nodes, axis=axis) for k in range(WIDTH)]
        ends = functools.reduce(jnp.minimum, shifted)
    lowest, highest = ends[..., 0].ravel(), jnp.minimum(WIDTH - ends[..., 1].ravel(), grid.shape[-1] - 1)
    reached = lowest < none
    return jnp.where(reached, lowest, 0), jnp.where(reached, highest - lowest + 1, 0)


def near_soil(scene: Scene, position: Array) -> Scene:
    """The scene on the nodes that are stored, with what its boundary has at each of them.

    Args:
        scene: to run.
        position: (d, N) m of the particles on the grid.

    Returns:
        The scene itself if it stores all nodes.
    """
    grid, boundary = scene.grid, scene.boundary
    if grid.stored is None or grid.near is not None:
        return scene
    grid = replace(grid, near=near_nodes(grid, position, engine=scene.numerics.engine))

    def kept(values: Values) -> Values:
        return jax.tree.map(lambda leaf: of_stored(grid, leaf) if jnp.ndim(leaf) else leaf, values)

    at_nodes = {name: kept(getattr(boundary, name)) for name in boundary.AT_NODES}
    return replace(scene, grid=grid, boundary=replace(boundary, **at_nodes))


def on_nodes(scene: Scene, position: Array, function: Callable[[Scene], Array]) -> Array:
    """The result of a function of a scene, on the nodes that it stores, or on all where soil reaches more than these.

    Args:
        scene: to run.
        position: (d, N) m of the particles on the grid.
        function: of the scene on its nodes.

    Returns:
        What the function returns.
    """
    near = near_soil(scene, position)
    if near.grid.near is None:
        return function(near)
    return jax.lax.cond(fits(near.grid), lambda: function(near), lambda: function(scene))


def fits(grid: Grid) -> Array | bool:
    """Whether all nodes that soil reaches are stored.

    Args:
        grid: of the nodes.

    Returns:
        () bool.
    """
    return True if grid.near is None else grid.near.needed <= grid.near.node.size


def with_room(grid: Grid, position: Array | np.ndarray) -> Grid:
    """The grid with as many stored nodes as soil in motion needs for a while.

    Args:
        grid: of the nodes.
        position: (d, N) m of the particles on it, of lanes (B, d, N).

    Returns:
        Grid.
    """
    lanes = jnp.asarray(position).reshape(-1, *np.shape(position)[-2:])
    needed = jax.jit(jax.vmap(lambda lane: jnp.sum(columns_of(grid, lane)[1])))(lanes)
    return replace(grid, stored=min(SPARE * int(jnp.max(needed)), grid.nodes))


def of_stored(grid: Grid, values: Array) -> Array:
    """Values at all nodes as those at the nodes that are stored.

    Args:
        grid: of the nodes.
        values: (nodes, ...).

    Returns:
        (rows, ...).
    """
    return values if grid.near is None else jnp.asarray(values)[jnp.maximum(grid.near.node, 0)]


def of_all(grid: Grid, values: Array) -> Array:
    """Values at the nodes that are stored as those at all nodes.

    Args:
        grid: of the nodes.
        values: (rows, ...).

    Returns:
        (nodes, ...), 0 at nodes that are not stored.
    """
    if grid.near is None:
        return values
    node = grid.near.node
    nothing = jnp.zeros((grid.nodes, *values.shape[1:]), values.dtype)
    return nothing.at[jnp.where(node < 0, grid.nodes, node)].set(values, mode="drop")


def along(grid: Grid, axis: int) -> Array:
    """Number of each stored node along an axis.

    Args:
        grid: of the nodes, near soil.
        axis: number of the axis.

    Returns:
        (rows,) int32.
    """
    assert grid.near is not None
    return grid.near.node // math.prod(grid.shape[axis + 1 :]) % grid.shape[axis]


def beside(grid: Grid, axis: int, step: int) -> Array:
    """Rows of the nodes next to each stored one.

    Args:
        grid: of the nodes, near soil.
        axis: number of the axis.
        step: nodes further along it.

    Returns:
        (rows,) int32, -1 where no node is stored.
    """
    assert grid.near is not None
    first, node, levels = grid.near.first[0], grid.near.node, grid.shape[-1]
    number = node + step * math.prod(grid.shape[axis + 1 :])
    on_grid = (node >= 0) & (along(grid, axis) + step >= 0) & (along(grid, axis) + step < grid.shape[axis])
    column = jnp.clip(number // levels, 0, first.size - 1)
    row = jnp.clip(first[column] + number % levels, 0, node.size - 1)
    return jnp.where(on_grid & (node[row] == number), row, -1)


def at_rows(values: Array, rows: Array) -> Array:
    """Values at other rows.

    Args:
        values: (rows, ...).
        rows: (n,) int32, such as from `beside`.

    Returns:
        (n, ...), 0 for a row of -1.
    """
    found = (rows >= 0).reshape(-1, *[1] * (values.ndim - 1))
    return jnp.where(found, values[jnp.maximum(rows, 0)], jnp.zeros((), values.dtype))
