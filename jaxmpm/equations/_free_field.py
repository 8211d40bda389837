"""Columns of level ground beyond both ends of a section, and their action on it."""

from __future__ import annotations

from dataclasses import replace

import jax.numpy as jnp
from jax import Array

from jaxmpm.equations._maps import Maps, grid_position
from jaxmpm.equations._nodes import Beyond, move_grid, particles_to_grid
from jaxmpm.equations._stress import acting_stress, excess_of
from jaxmpm.types import Scene, State


def beyond_ends(scene: Scene, state: State) -> list[tuple[Scene, State]]:
    """Columns of the free field with their states, at the scene's time and under its motion."""
    assert scene.free_field is not None
    assert state.free_field is not None
    columns = (
        replace(
            column,
            numerics=scene.numerics,
            loads=replace(scene.loads, water=column.loads.water, pore_pressure=column.loads.pore_pressure),
        )
        for column in (scene.free_field.low, scene.free_field.high)
    )
    return [
        (column, replace(column_state, step=state.step))
        for column, column_state in zip(columns, state.free_field, strict=True)
    ]


def free_field(scene: Scene, state: State, dt: Array) -> Beyond:
    """Action of the free field on the ends in a step of dt (s); see `FreeField`."""
    assert scene.free_field is not None
    sides = [beside(*one, dt, scene.grid.shape[-1]) for one in beyond_ends(scene, state)]
    velocity, (low, high), impedance = (jnp.stack(values) for values in zip(*sides, strict=True))
    return Beyond(velocity, scene.free_field.reaction + jnp.stack([-low, high]), impedance)


def beside(column: Scene, state: State, dt: Array, height: int) -> list[Array]:
    """Action of a column of the free field on the end of the section next to it.

    Args:
        column: of the free field.
        state: of the column.
        dt: time step (s).
        height: number of nodes from the base up.

    Returns:
        Arrays (height, d): its velocity at the end of the step (m/s), the force of its stress on a plane across x in N,
        and the plane's impedance to both waves (kg/s).
    """
    maps, mass = Maps(column, grid_position(column, state)), column.particles.mass
    motion = move_grid(column, particles_to_grid(column, state, dt, maps), state.step * dt, dt)
    volume = column.particles.volume * state.volume_ratio
    stress = acting_stress(column, state.stress, volume, maps, excess_of(column, state))
    density = mass / column.particles.volume
    waves = [mass * jnp.sqrt(modulus / density) for modulus in (column.material.p_wave_modulus, column.material.shear)]
    sums = maps.to_grid(jnp.stack([stress[0], stress[-1], *waves]) / column.grid.cell, None)
    assert column.boundary.tied is not None
    plane = jnp.concatenate([motion.velocity, sums], axis=1).reshape(*column.grid.shape, -1)[column.boundary.tied[0]]
    return jnp.split(jnp.pad(plane, ((0, height - len(plane)), (0, 0))), 3, axis=1)
