"""Record of the soil over each column of cells: largest thickness, speed and time of arrival, on the device."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from foundation import check
from jaxmpm import tensors
from jaxmpm.equations import grid_position
from jaxmpm.transfer import locate
from jaxmpm.types import Columns, Scene, State, Status

LEAST = 0.75
"""Mean thickness of soil, in layers of particles, from which a column counts as covered: more than a loose grain."""


class Passing(NamedTuple):
    """Soil that has moved, in each column of cells (nx,) or (nx, ny).

    Args:
        thickness: m.
        speed: m/s.
    """

    thickness: Array
    speed: Array


def with_columns(
    scene: Scene, state: State, *, moved: float = 1.0, least: float | None = None, every: int = 20
) -> State:
    """Start a record of the soil over each column of cells, see `Columns`.

    A look at the columns costs a few per cent of a step. Between two looks soil at v m/s moves v times `every` time
    steps; a peak that lasts less than that is missed.

    Args:
        scene: in two or three dimensions.
        state: of one lane.
        moved: displacement from which soil counts (m).
        least: mean thickness of soil from which a column counts as covered (m); by default 0.75 of a particle layer.
        every: steps between two looks.

    Returns:
        State with an empty record.

    Raises:
        ValueError: If the scene has one dimension, or a number is not above 0.
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
    columns = Columns(nothing, nothing, jnp.full_like(nothing, math.inf), float(moved), float(least), every)
    return replace(state, columns=columns)


def column_shape(scene: Scene) -> tuple[int, ...]:
    """Number of columns of cells along each horizontal axis.

    Args:
        scene: with its grid.

    Returns:
        (nx,) or (nx, ny), () in one dimension.
    """
    return tuple(nodes - 1 for nodes in scene.grid.shape[:-1])


def passing(scene: Scene, state: State, moved: float) -> Passing:
    """Soil that has moved, in each column of cells; a particle is in one column.

    Thickness is the soil's initial volume over the column's plan area, so that it adds up to the sliding volume.

    Args:
        scene: in two or three dimensions.
        state: of one lane.
        moved: displacement from which soil counts (m).

    Returns:
        Thickness and speed per column.
    """
    grid, particles, shape = scene.grid, scene.particles, column_shape(scene)
    cells = jnp.floor(locate(grid, grid_position(scene, state))[:-1]).astype(jnp.int32)
    column = jnp.zeros(cells.shape[-1:], jnp.int32)
    for axis, count in enumerate(shape):
        column = column * count + jnp.clip(cells[axis], 0, count - 1)
    slides = jnp.sum(state.displacement**2, axis=0) >= moved**2
    carried = jnp.concatenate([particles.volume[None], particles.mass[None], particles.mass * state.velocity])
    sums = jnp.zeros((math.prod(shape), len(carried)), carried.dtype).at[column].add(jnp.where(slides, carried, 0).T)
    volume, mass, momentum = sums[:, 0], sums[:, 1], sums[:, 2:]
    speed = tensors.safe_sqrt(jnp.sum(momentum**2, axis=1)) / jnp.where(mass > 0, mass, 1)
    return Passing((volume / grid.cell ** len(shape)).reshape(shape), speed.reshape(shape))


def recorded(scene: Scene, state: State) -> State:
    """The state after a step, with its record updated if the step is due for a look."""
    columns = state.columns
    assert columns is not None

    def look() -> tuple[Array, Array, Array]:
        now = passing(scene, state, columns.moved)
        there = now.thickness >= columns.least
        time = (state.step * scene.time_step).astype(columns.arrival.dtype)
        return (
            jnp.maximum(columns.thickness, now.thickness),
            jnp.maximum(columns.speed, jnp.where(there, now.speed, 0)),
            jnp.where(there, jnp.minimum(columns.arrival, time), columns.arrival),
        )

    due = (state.step % columns.every == 0) & (state.status == Status.RUNNING)
    before = (columns.thickness, columns.speed, columns.arrival)
    thickness, speed, arrival = jax.lax.cond(due, look, lambda: before)
    return replace(state, columns=replace(columns, thickness=thickness, speed=speed, arrival=arrival))
