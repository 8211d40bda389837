"""One step of the material point method, State -> State."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmpm import tensors
from jaxmpm.boundary import hold, slide
from jaxmpm.transfer import filtered, g2p, momentum, nodal_momentum, p2g, velocity_gradient
from jaxmpm.types import Scene, Scheme, State

Transfer = Callable[..., Any]

# Nodes with less than this share of the mean particle mass carry nothing. What they drop is lost momentum, so it is
# far below rounding; a node's velocity, a ratio of sums with the same weights, is good down to there.
MASS_FLOOR = 1e-12


def step(scene: Scene, state: State, dt: Array) -> State:
    """Advance by dt (s). Pure, differentiable, vmappable; only the fields of motion change, not step and status.

    Sources: Sulsky, Chen and Schreyer (1994), 10.1016/0045-7825(94)90112-0 (the method); Bardenhagen (2002),
    10.1006/jcph.2002.7103 (USF, USL) and Sulsky, Zhou and Schreyer (1995), 10.1016/0010-4655(94)00170-7 (MUSL).
    """
    grid, kernel, d = scene.grid, scene.kernel, scene.grid.dimension
    m = scene.particles.mass
    x = scene.particles.position + state.displacement
    to_grid = partial(p2g, grid, kernel, x, engine=scene.engine)
    to_particles = partial(g2p, grid, kernel, x, engine=scene.engine)
    average = partial(neighbour_average, scene, to_grid, to_particles)

    def acting(state: State) -> Array:
        return acting_stress(scene, state.stress, scene.particles.volume * state.volume_ratio, average)

    # Particles to grid: mass, momentum and force.
    carried = [m[None], momentum(scene, state, x)]
    if scene.body_force is not None:
        carried.append(m * scene.body_force(scene.particles.position, state.step * dt))
    ends = np.cumsum([len(block) for block in carried])
    if scene.scheme is Scheme.USF:
        mass, moving, *pushed = jnp.split(to_grid(jnp.concatenate(carried), None), ends[:-1], axis=1)
        mass = tensors.spread(mass, d, axis=1)
        inverse_mass = reciprocal(scene, mass)
        velocity = nodal_velocity(scene, inverse_mass, moving)
        straining = velocity
        if scene.wall_friction is not None:
            stress_force = to_grid(None, acting(state))
            pressed = velocity + dt * (inverse_mass * stress_force + scene.gravity)
            straining = slide(scene.walls, grid, velocity, None, pressed)
        _, gradient = to_particles(straining, values=0, gradients=d)
        state = update_stress(scene, state, gradient, dt, average)
        force = sum(pushed, to_grid(None, acting(state)))
    else:
        nodal = to_grid(jnp.concatenate(carried), acting(state))
        mass, moving, *pushed = jnp.split(nodal, ends, axis=1)
        mass = tensors.spread(mass, d, axis=1)
        inverse_mass = reciprocal(scene, mass)
        velocity = nodal_velocity(scene, inverse_mass, moving)
        force = sum(pushed[1:], pushed[0])

    # Motion of the grid.
    acceleration = nodal_acceleration(scene, inverse_mass, force + mass * scene.gravity, velocity)
    if scene.wall_friction is None:
        velocity = velocity + dt * acceleration
    else:
        before, pressed = velocity, velocity + dt * acceleration
        velocity = slide(scene.walls, grid, pressed, scene.wall_friction)
        acceleration = (velocity - before) / dt

    # Grid to particles: move them.
    fields = jnp.concatenate([velocity, acceleration], axis=1)
    values, gradient = to_particles(fields, values=2 * d, gradients=d if scene.scheme is Scheme.USL else 0)
    pic_velocity, change = jnp.split(values, 2)
    flip_velocity = state.velocity + dt * change
    state = replace(
        state,
        displacement=state.displacement + dt * pic_velocity,
        velocity=flip_velocity if scene.flip is None else scene.flip * flip_velocity + (1 - scene.flip) * pic_velocity,
    )
    if state.affine is not None:
        state = replace(state, affine=velocity_gradient(grid, x, velocity, to_particles))

    # Stress from the velocity field at the end of the step.
    if scene.scheme is Scheme.MUSL:
        velocity = nodal_velocity(scene, inverse_mass, to_grid(momentum(scene, state, x), None))
        if scene.wall_friction is not None:
            velocity = slide(scene.walls, grid, velocity, None, pressed)
        _, gradient = to_particles(velocity, values=0, gradients=d)
    if scene.scheme is not Scheme.USF:
        state = update_stress(scene, state, gradient, dt, average)
    return state


def acting_stress(scene: Scene, stress: Array, volume: Array, average: Transfer) -> Array:
    """The components of the stress (s, N) that act on the grid (J), times the current volume (N).

    With F-bar its mean is averaged as well, by the transpose of the strain's average: forces then do the work that the
    averaged strain stores. Without this the energy grows in a long run.
    """
    d = scene.grid.dimension
    if scene.fbar:
        specific, full = volume / scene.particles.mass, tensors.expand(stress, d)
        full = tensors.with_mean(full, average(tensors.mean(full) * specific, 0) / specific)
        stress = tensors.compress(full, d)
    acting = tensors.acting(stress, d)
    return tensors.spread(volume[None], len(acting), axis=0) * acting


def reciprocal(scene: Scene, mass: Array) -> Array:
    """1 / mass where a node has mass, else 0."""
    carries = mass > MASS_FLOOR * jnp.mean(scene.particles.mass)
    return jnp.where(carries, 1 / jnp.where(carries, mass, 1), 0)


def nodal_velocity(scene: Scene, inverse_mass: Array, channels: Array) -> Array:
    """Velocity (nodes, d) of the nodes, walls held."""
    return hold(scene.walls, scene.grid, inverse_mass * nodal_momentum(scene.grid, channels))


def nodal_acceleration(scene: Scene, inverse_mass: Array, force: Array, velocity: Array) -> Array:
    """Acceleration (nodes, d) by the force on a node and damping, walls held."""
    acceleration = inverse_mass * force
    if scene.damping is not None:
        acceleration = acceleration - scene.damping * velocity
    return hold(scene.walls, scene.grid, acceleration)


def update_stress(scene: Scene, state: State, gradient: Array, dt: Array, average: Transfer) -> State:
    """Stress, history and volume after a step in the velocity gradient (d, d, N), by the Jaumann rate."""
    d = scene.grid.dimension
    entries = tensors.entries(gradient)
    rotated = tensors.rotate(tensors.expand(state.stress, d), entries, dt)
    strain = tensors.strain_increment(entries, dt)
    if scene.fbar:
        strain = tensors.with_mean(strain, average(tensors.mean(strain), 0))
    stress, history = scene.material.update(strain, rotated, state.history, dt)
    if scene.nonlocal_passes is not None:
        smooth = partial(average, passes=scene.nonlocal_passes)
        history = jax.tree.map(lambda new, old: old + smooth(new - old), history, state.history)
    return replace(
        state,
        stress=tensors.compress(stress, d),
        history=history,
        volume_ratio=state.volume_ratio * (1 + 3 * tensors.mean(strain)),
    )


def neighbour_average(scene: Scene, to_grid: Transfer, to_particles: Transfer, values: Array, passes: int) -> Array:
    """Average of `values` (N) over the particles around each one, weighted by mass: see `jaxmpm.averages`."""
    m = scene.particles.mass
    nodal = filtered(scene.grid, to_grid(jnp.stack([m, m * values]), None), passes)
    averaged, _ = to_particles(reciprocal(scene, nodal[:, :1]) * nodal[:, 1:], values=1, gradients=0)
    return averaged[0]
