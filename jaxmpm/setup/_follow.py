"""Nodes stored near the soil alone, where the box around it has many more."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TypeVar

import jax
import numpy as np

from jaxmpm.support import check
from jaxmpm.support.tracing import array, host
from jaxmpm.transfer import SPARE, can_follow, spreads, with_room
from jaxmpm.types import Scene, State

SPARSE = 8
"""Nodes of a grid over those that its soil reaches from which on the latter alone are stored."""

FEW = 5000
"""Nodes up to which a grid stores all of them: their part in a step is small."""

REACHED = 6
"""Nodes of a column that soil reaches beside the cells that it fills, estimated upwards: 5.3 on 29 degrees."""

Values = TypeVar("Values")


def follow_soil(scene: Scene, state: State | None = None) -> Scene:
    """The scene with nodes stored only near its soil; each step finds which these are.

    In each column along the last axis a step stores the nodes from the lowest to the highest that soil reaches. Results
    are those of a grid that stores all nodes, to rounding. There is room for twice the nodes that soil reaches at the
    start, or in a given state. `solve` and `solve_each` make more room if a run needs it; elsewhere the lane then has
    the status GRID_FULL. Grounds do this by themselves if the box has eight times as many nodes, and more than 5000.
    Averages over an internal length and bridges across gaps still work on all nodes, so that air costs them time.

    Args:
        scene: in two or three dimensions.
        state: whose soil needs the room, such as the last of a run that `replay` repeats; None for the start. With
            several lanes there is room for each.

    Returns:
        Scene.

    Raises:
        ValueError: If positions are traced, or the scene has one dimension, tied sides or a free field: these identify
            planes of nodes with each other, also where soil reaches one of the two.

    Example:
        >>> import jaxmpm as mpm
        >>> soil = mpm.Soil(young=5e6, strength=9e3)
        >>> numerics = mpm.Discretisation(cell=1.0, spacing=(0.5, 0.5))
        >>> scene, state = mpm.block((4.0, 4.0), soil, numerics, domain=(12.0, 12.0), corner=(2.0, 2.0))
        >>> scene.grid.nodes, mpm.follow_soil(scene).grid.stored
        (225, 112)
    """
    if check.is_traced(scene.particles.position) or check.is_traced(state):
        raise ValueError("where soil is, is traced: choose the nodes that are stored outside of jit, vmap and grad")
    if not can_follow(scene):
        raise ValueError(
            "the scene has one dimension, tied sides or a free field, which need nodes that soil does not reach: store "
            "all nodes"
        )
    position = np.asarray(scene.particles.position)
    grid = with_room(scene.grid, position if state is None else position + np.asarray(state.displacement))
    return replace(scene, grid=grid)


def follow_sparse_soil(scene: Scene) -> Scene:
    """The scene with nodes stored near its soil where the grid has SPARSE times as many, else as it is."""
    grid, particles = scene.grid, scene.particles
    if check.is_traced(particles) or not can_follow(scene):
        return scene
    # It reaches a node for each cell that it fills, at the least.
    if not _sparse(grid.nodes, np.sum(np.asarray(particles.volume)) / grid.cell**grid.dimension):
        return scene
    following = follow_soil(scene)
    return following if _sparse(grid.nodes, (following.grid.stored or grid.nodes) / SPARE) else scene


def _sparse(nodes: float, reached: float) -> bool:
    """Whether a grid has so many more nodes than soil reaches that it stores the latter alone."""
    return nodes >= max(FEW, SPARSE * reached)


def estimated_nodes(scene: Scene, nodes: float, columns: float, filled: float) -> float:
    """How many nodes the grid of a ground works on, before it is built: those that it stores, or all.

    Args:
        scene: of the same soil and numerical choices, of any size.
        nodes: of the grid.
        columns: of the grid.
        filled: cells that soil fills.
    """
    reached = filled + REACHED * columns
    follows = can_follow(scene) and not spreads(scene)
    return SPARE * reached if follows and _sparse(nodes, reached) else nodes


def under_sky(scene: Scene, height: float) -> Scene:
    """The scene with so much more air (m) over its grid, where nodes near soil alone are stored: it costs no step.

    Args:
        scene: to run.
        height: of the air (m); no more than doubles the grid.

    Returns:
        The scene itself if it stores all nodes, or works on all. Nodes in the air are held as is the highest of their
        column.
    """
    grid, levels = scene.grid, scene.grid.shape[-1]
    if grid.stored is None or spreads(scene):
        return scene
    more = math.ceil(min(height / grid.cell, levels))

    def raised(values: Values) -> Values:
        def of_leaf(leaf: jax.Array) -> jax.Array:
            columns = leaf.reshape(-1, levels, *leaf.shape[1:])
            wider = [(0, more) if axis == 1 else (0, 0) for axis in range(columns.ndim)]
            return array(host(leaf).pad(columns, wider, mode="edge").reshape(-1, *leaf.shape[1:]), leaf.dtype)

        return jax.tree.map(lambda leaf: of_leaf(leaf) if np.ndim(leaf) else leaf, values)

    at_nodes = {name: raised(getattr(scene.boundary, name)) for name in scene.boundary.AT_NODES}
    grid = replace(grid, shape=(*grid.shape[:-1], levels + more))
    return replace(scene, grid=grid, boundary=replace(scene.boundary, **at_nodes))
