"""Record of the soil over each column of cells: largest thickness, speed and time of arrival, on the device."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from jaxmpm import tensors
from jaxmpm.equations import grid_position
from jaxmpm.support import check
from jaxmpm.transfer import cell_sums, locate
from jaxmpm.types import Columns, Scene, State, Status

LEAST = 0.75
"""Mean thickness of soil, in layers of particles, from which a column counts as covered: more than a loose grain."""


HALF = 0.25
"""Half the height of a particle, in cells, where its kernel gives it none."""


class Passing(NamedTuple):
    """Soil that has moved, in each column of cells (nx,) or (nx, ny).

    Args:
        thickness: m.
        speed: m/s.
    """

    thickness: Array
    speed: Array


def with_columns(
    scene: Scene,
    state: State,
    *,
    moved: float = 1.0,
    least: float | None = None,
    every: int = 20,
    surface: ArrayLike | None = None,
) -> State:
    """Start a record of the soil over each column of cells, see `Columns`.

    Each update of the record costs a few per cent of a step. Between two updates soil at v m/s moves v times `every`
    time steps; the record misses a peak that lasts less than that.

    Args:
        scene: in two or three dimensions.
        state: of one lane.
        moved: displacement from which soil counts (m).
        least: mean thickness of soil from which a column counts as covered (m); by default 0.75 of a particle layer.
        every: steps between two updates.
        surface: heights (m) of the ground before it moved at the nodes in plan, the grid's shape without its last axis.
            Only the part of moved soil above these heights, linear between nodes, then counts, and not the ground
            that moves below. None counts all moved soil.

    Returns:
        State with an empty record.

    Raises:
        ValueError: If the scene has one dimension, a number is not above 0, or the surface has another shape or is not
            finite.
    """
    d = scene.grid.dimension
    if d < 2:
        raise ValueError("a scene in one dimension has no columns of cells: give one in two or three")
    check.positive("moved", moved, "m")
    check.whole("every", every)
    if least is None:
        # A layer one particle high of those that fill a cell evenly.
        per_cell = scene.grid.cell**d / float(jnp.max(scene.particles.volume))
        least = LEAST * scene.grid.cell / max(round(per_cell ** (1 / d)), 1)
    check.positive("least", least, "m")
    nothing = jnp.zeros(column_shape(scene), state.displacement.dtype)
    heights = None if surface is None else _in_cells(scene, np.asarray(surface, float), nothing.dtype)
    columns = Columns(nothing, nothing, jnp.full_like(nothing, math.inf), float(moved), float(least), every, heights)
    return replace(state, columns=columns)


def column_shape(scene: Scene) -> tuple[int, ...]:
    """Number of columns of cells along each horizontal axis.

    Args:
        scene: with its grid.

    Returns:
        (nx,) or (nx, ny), () in one dimension.
    """
    return tuple(nodes - 1 for nodes in scene.grid.shape[:-1])


def _in_cells(scene: Scene, surface: np.ndarray, dtype: np.dtype) -> Array:
    """Heights (m) at nodes in plan, in cells above the lowest node; ValueError for another shape or no heights."""
    grid = scene.grid
    if surface.shape != grid.shape[:-1] or not np.isfinite(surface).all():
        raise ValueError(f"surface has shape {surface.shape}: give {grid.shape[:-1]} finite heights, one at each node")
    return jnp.asarray((surface - grid.origin[-1]) / grid.cell, dtype)


def _above(scene: Scene, cells: Array, surface: Array) -> Array:
    """Part (N,) of each particle at cells (d, N) that is above a surface."""
    plan = cells[:-1]
    lower = jnp.clip(jnp.floor(plan), 0, jnp.array(surface.shape)[:, None] - 2).astype(jnp.int32)
    part, below = jnp.clip(plan - lower, 0, 1), jnp.zeros_like(cells[-1])
    for corner in itertools.product((0, 1), repeat=surface.ndim):
        up = jnp.array(corner)[:, None]
        below += jnp.prod(jnp.where(up == 1, part, 1 - part), axis=0) * surface[tuple(lower + up)]
    sizes = getattr(scene.numerics.kernel, "half_size", None)
    half = HALF if sizes is None else sizes[-1] / scene.grid.cell
    return jnp.clip((cells[-1] - below) / (2 * half) + 0.5, 0, 1)


def passing(scene: Scene, state: State, moved: float, surface: Array | None = None) -> Passing:
    """Soil that has moved, in each column of cells; a particle is in one column.

    Thickness is the soil's initial volume over the column's plan area, so that without a surface it adds up to the
    sliding volume.

    Args:
        scene: in two or three dimensions.
        state: of one lane.
        moved: displacement from which soil counts (m).
        surface: above which it counts, see `Columns`; None counts all.

    Returns:
        Thickness and speed per column.
    """
    grid, particles, shape = scene.grid, scene.particles, column_shape(scene)
    located = locate(grid, grid_position(scene, state))
    cells = jnp.floor(located[:-1]).astype(jnp.int32)
    column = jnp.zeros(cells.shape[-1:], jnp.int32)
    for axis, count in enumerate(shape):
        column = column * count + jnp.clip(cells[axis], 0, count - 1)
    slides = jnp.sum(state.displacement**2, axis=0) >= moved**2
    carried = jnp.concatenate([particles.volume[None], particles.mass[None], particles.mass * state.velocity])
    if surface is not None:
        carried *= _above(scene, located, surface)[None]
    volume, mass, *momentum = _column_sums(column, jnp.where(slides, carried, 0), math.prod(shape), scene)
    speed = tensors.safe_sqrt(sum(part**2 for part in momentum)) / jnp.where(mass > 0, mass, 1)
    return Passing((volume / grid.cell ** len(shape)).reshape(shape), speed.reshape(shape))


def _column_sums(column: Array, values: Array, columns: int, scene: Scene) -> Array:
    """Sums (c, columns) of values (c, N) of particles in columns of these numbers (N,).

    Each column reads the sums of its first particle: one scatter on a GPU would add in any order.
    """
    sums = cell_sums(column, values, cells=columns, engine=scene.numerics.engine)
    number = jnp.arange(column.size, dtype=jnp.int32)
    first = jnp.full(columns, column.size, jnp.int32).at[column].min(number)
    return sums.at[:, first].get(mode="fill", fill_value=0)


def recorded(scene: Scene, state: State) -> State:
    """The state after a step, with its record updated if the step is due for a look."""
    columns = state.columns
    assert columns is not None

    def updated() -> tuple[Array, Array, Array]:
        now = passing(scene, state, columns.moved, columns.surface)
        there = now.thickness >= columns.least
        time = (state.step * scene.numerics.time_step).astype(columns.arrival.dtype)
        return (
            jnp.maximum(columns.thickness, now.thickness),
            jnp.maximum(columns.speed, jnp.where(there, now.speed, 0)),
            jnp.where(there, jnp.minimum(columns.arrival, time), columns.arrival),
        )

    due = (state.step % columns.every == 0) & (state.status == Status.RUNNING)
    before = (columns.thickness, columns.speed, columns.arrival)
    thickness, speed, arrival = jax.lax.cond(due, updated, lambda: before)
    return replace(state, columns=replace(columns, thickness=thickness, speed=speed, arrival=arrival))
