"""One step of the material point method, State -> State."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import jax.numpy as jnp
from jax import Array

from jaxmpm import tensors
from jaxmpm.boundary import hold
from jaxmpm.transfer import g2p, p2g
from jaxmpm.types import Scene, Scheme, State

# Nodes with less than this share of the mean particle mass carry nothing: their weights are rounding noise.
MASS_FLOOR = 1e-6


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

    # Particles to grid: mass, momentum and internal force.
    momentum_p = jnp.concatenate([m[None], m * state.velocity])
    if scene.scheme is Scheme.USF:
        nodal = to_grid(momentum_p, None)
        mass = nodal[:, :1]
        velocity = nodal_velocity(scene, mass, nodal[:, 1:])
        _, gradient = to_particles(velocity, values=0, gradients=d)
        state = update_stress(scene, state, gradient, dt)
        force = to_grid(None, acting_stress(scene, state))
    else:
        nodal = to_grid(momentum_p, acting_stress(scene, state))
        mass, force = nodal[:, :1], nodal[:, 1 + d :]
        velocity = nodal_velocity(scene, mass, nodal[:, 1 : 1 + d])

    # Motion of the grid.
    acceleration = nodal_acceleration(scene, mass, force, velocity)
    velocity = velocity + dt * acceleration

    # Grid to particles: move them.
    fields = jnp.concatenate([velocity, acceleration], axis=1)
    values, gradient = to_particles(fields, values=2 * d, gradients=d if scene.scheme is Scheme.USL else 0)
    flip_velocity = state.velocity + dt * values[d:]
    state = replace(
        state,
        displacement=state.displacement + dt * values[:d],
        velocity=flip_velocity if scene.flip is None else scene.flip * flip_velocity + (1 - scene.flip) * values[:d],
    )

    # Stress from the velocity field at the end of the step.
    if scene.scheme is Scheme.MUSL:
        velocity = nodal_velocity(scene, mass, to_grid(m * state.velocity, None))
        _, gradient = to_particles(velocity, values=0, gradients=d)
    if scene.scheme is not Scheme.USF:
        state = update_stress(scene, state, gradient, dt)
    return state


def acting_stress(scene: Scene, state: State) -> Array:
    """Current volume times the stress components that act on the grid (J)."""
    d = scene.grid.dimension
    acting = [tensors.CARRIED[d].index(c) for c in tensors.ACTING[d]]
    return scene.particles.volume * state.volume_ratio * jnp.stack([state.stress[k] for k in acting])


def per_mass(scene: Scene, mass: Array, nodal: Array) -> Array:
    """nodal / mass where a node has mass, else 0."""
    carries = mass > MASS_FLOOR * jnp.mean(scene.particles.mass)
    return jnp.where(carries, nodal / jnp.where(carries, mass, 1), 0)


def nodal_velocity(scene: Scene, mass: Array, momentum: Array) -> Array:
    """Velocity (nodes, d) of the nodes, walls held."""
    return hold(scene.walls, scene.grid, per_mass(scene, mass, momentum))


def nodal_acceleration(scene: Scene, mass: Array, force: Array, velocity: Array) -> Array:
    """Acceleration (nodes, d) by internal force, gravity and damping, walls held."""
    acceleration = per_mass(scene, mass, force + mass * scene.gravity)
    if scene.damping is not None:
        acceleration = acceleration - scene.damping * velocity
    return hold(scene.walls, scene.grid, acceleration)


def update_stress(scene: Scene, state: State, gradient: Array, dt: Array) -> State:
    """Stress, history and volume after a step in the velocity gradient (d, d, N), by the Jaumann rate."""
    d = scene.grid.dimension
    rotated = tensors.rotate(tensors.expand(state.stress, d), gradient, dt)
    strain = tensors.strain_increment(gradient, dt)
    stress, history = scene.material.update(strain, rotated, state.history)
    return replace(
        state,
        stress=tensors.compress(stress, d),
        history=history,
        volume_ratio=state.volume_ratio * (1 + 3 * tensors.mean(strain)),
    )
