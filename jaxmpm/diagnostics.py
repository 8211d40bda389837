"""Energy, momentum and displacement of a state; each of one lane, to be vmapped over a batch.

Those that take a scene raise ValueError for a state of another number of particles, or of many lanes.
"""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jax import Array

from foundation import check
from jaxmpm import tensors
from jaxmpm._step import Maps, acting_stress, external_force, felt_gravity, place, reciprocal
from jaxmpm.boundary import hold
from jaxmpm.transfer import momentum as particle_momentum
from jaxmpm.types import Scene, State


def _of_one_lane(scene: Scene, state: State) -> None:
    found, wanted = np.shape(state.displacement), np.shape(scene.particles.position)
    if found != wanted:
        raise ValueError(
            f"the state's displacement has shape {found}, the scene asks for {wanted}: give the state of one lane of "
            "this scene, or map over the lanes with jax.vmap"
        )


def position(scene: Scene, state: State) -> Array:
    """Current positions (d, N) m."""
    _of_one_lane(scene, state)
    return scene.particles.position + state.displacement


def displacement(state: State) -> Array:
    """Length of the displacement of each particle (N,) m."""
    return tensors.safe_sqrt(jnp.sum(state.displacement**2, axis=0))


def largest_displacement(state: State) -> Array:
    """Largest length of a particle's displacement (m)."""
    return jnp.max(displacement(state))


def exceeded_displacement(scene: Scene, state: State, volume: float) -> Array:
    """Largest displacement (m) that a volume of soil (m3, in a section m2, undeformed) has reached or exceeded.

    Soil is counted from that which moved farthest down, so that neither a few grains nor soil that stands have any
    weight. Of more soil than there is, the least displacement. Raises ValueError for a volume not above 0.
    """
    _of_one_lane(scene, state)
    check.positive("volume", volume)
    moved, own = displacement(state), scene.particles.volume
    order = jnp.argsort(-moved)
    # Half a particle away from the sum that is asked for, rounding cannot tell.
    last = jnp.searchsorted(jnp.cumsum(own[order]), volume - jnp.min(own) / 2)
    return moved[order][jnp.minimum(last, moved.size - 1)]


def mean_displacement(scene: Scene, state: State) -> Array:
    """Mean length of the displacement of all soil, weighted by mass (m)."""
    _of_one_lane(scene, state)
    mass = scene.particles.mass
    return jnp.sum(mass * displacement(state)) / jnp.sum(mass)


def slide_displacement(scene: Scene, state: State, beyond: float) -> Array:
    """How far all soil has moved, weighted by mass, over the mass that moved more than `beyond` (m); 0 where none did.

    A mean over the slide, to which soil that does not slide yet adds what it creeps.
    """
    moved, mass = displacement(state), scene.particles.mass
    slides = jnp.sum(jnp.where(moved > beyond, mass, 0))
    return jnp.where(slides > 0, jnp.sum(mass * moved) / jnp.where(slides > 0, slides, 1), 0)


def momentum(scene: Scene, state: State) -> Array:
    """Total momentum (d,) kg m/s."""
    _of_one_lane(scene, state)
    return jnp.sum(scene.particles.mass * state.velocity, axis=1)


def grid_velocity(scene: Scene, state: State) -> Array:
    """Velocity of the grid at the particles (d, N) m/s: what moves them.

    Particles in FLIP also carry velocities that cancel at the nodes, and ring on for long in soil that stands.
    """
    _of_one_lane(scene, state)
    maps, d = Maps(scene, place(scene, state)), scene.grid.dimension
    nodal = maps.to_reached(
        jnp.concatenate([scene.particles.mass[None], particle_momentum(scene, state, maps.position)]), None
    )
    mass, moving = maps.joined(nodal[:, :1]), maps.momentum(nodal[:, 1:])
    velocity = hold(scene, reciprocal(scene, mass) * moving)
    return maps.to_particles(velocity, values=d, gradients=0)[0]


def kinetic_energy(scene: Scene, state: State) -> Array:
    """Kinetic energy of the particles (J)."""
    _of_one_lane(scene, state)
    return 0.5 * jnp.sum(scene.particles.mass * jnp.sum(state.velocity**2, axis=0))


def elastic_energy(scene: Scene, state: State) -> Array:
    """Energy stored in the elastic stress (J), for a material with `bulk` and `shear`.

    With finite strains it is of the Kirchhoff stress, per initial volume.
    """
    _of_one_lane(scene, state)
    ratio = state.volume_ratio
    stress = tensors.expand(ratio * state.stress if scene.finite_strain else state.stress, scene.grid.dimension)
    pressure, j2 = tensors.mean(stress), tensors.second_invariant(tensors.deviator(stress))
    density = pressure**2 / (2 * scene.material.bulk) + j2 / (2 * scene.material.shear)
    return jnp.sum(scene.particles.volume * (1 if scene.finite_strain else ratio) * density)


def potential_energy(scene: Scene, state: State) -> Array:
    """Work still to be had from gravity, relative to the initial positions (J)."""
    _of_one_lane(scene, state)
    return -jnp.sum(scene.particles.mass * (scene.gravity @ state.displacement))


def speed(scene: Scene, state: State) -> Array:
    """Root mean square of the particle speed, weighted by mass (m/s)."""
    return tensors.safe_sqrt(2 * kinetic_energy(scene, state) / jnp.sum(scene.particles.mass))


def unbalanced_force(scene: Scene, state: State) -> Array:
    """Norm of the net force on the free nodes over the norm of what loads them: gravity, body force, water and
    the motion of the base."""
    _of_one_lane(scene, state)
    maps, particles = Maps(scene, place(scene, state)), scene.particles
    volume = particles.volume * state.volume_ratio
    nodal = maps.to_grid(particles.mass[None], acting_stress(scene, state.stress, volume, maps))
    time = state.step * scene.time_step
    load = nodal[:, :1] * felt_gravity(scene, time)
    external = external_force(scene, maps.position, volume, time)
    if external is not None:
        load = load + maps.to_grid(external, None)
    weight = hold(scene, load)
    net = hold(scene, nodal[:, 1:] + load)
    return jnp.sqrt(jnp.sum(net**2) / jnp.maximum(jnp.sum(weight**2), jnp.finfo(net.dtype).tiny))
