"""Stress at rest of soil on a contact that bears no more than its strength.

Soil that sticks to its base draws on it most at its edges, by more than the contact's friction. Were it let go from
there, the edges would slip at once, and the waves that this sends through the soil would give it a velocity with which
a block close to its limit slides on for seconds.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from jaxmpm import tensors
from jaxmpm.boundary import Region, slide
from jaxmpm.equations import Maps, Nodal, braked, move_grid, particles_to_grid, pushed
from jaxmpm.laws import elastic_increment
from jaxmpm.setup._choices import WALL_STRENGTH
from jaxmpm.transfer import near_soil
from jaxmpm.types import Scene, State

EXCESS = 0.01
"""Share of the weight by which a contact may be drawn on beyond its strength: less moves no soil."""

PERIODS = 4
"""Duration of the motion to rest, in periods of shear waves through the height of the soil."""

DAMPING = 0.25
"""Of that motion, over its critical one."""


MARGIN = 1.001
"""Strength of a contact from which soil comes to rest on it, over what the soil needs in total."""


def borne_by_contact(scene: Scene, state: State) -> Array:
    """Stress of soil that comes to rest elastically on its contact.

    Small elastic motions of the grid, at the initial positions, are damped until they have ended. The contact slips
    where it is drawn on beyond its strength, as in a step. A contact too weak for its soil has the strength with which
    it would just hold it: the soil slides from there.

    Args:
        scene: with a contact.
        state: in balance on a contact to which soil sticks.

    Returns:
        Stress (s, N) Pa; that of the state if the contact bears it.
    """
    scene = replace(scene, loads=replace(scene.loads, motion=None))
    needed, strength, _ = map(float, contact_forces(scene, state))
    if not strength > 0:
        return state.stress
    holding = _strengthened(scene, max(MARGIN * needed / strength, 1.0))
    if not float(contact_forces(holding, state).excess) > EXCESS:
        return state.stress
    particles = scene.particles
    height = float(jnp.ptp(particles.position[-1])) + scene.grid.cell
    speed = float(jnp.sqrt(jnp.median(scene.material.shear * particles.volume / particles.mass)))
    period = 4 * height / speed
    steps = math.ceil(PERIODS * period / float(scene.numerics.time_step))
    return relaxed(holding, state, DAMPING * 4 * math.pi / period, steps)


def _strengthened(scene: Scene, factor: float) -> Scene:
    """The scene with the strength of its contact times a factor."""
    boundary = scene.boundary
    strength = {name: getattr(boundary, name) for name in WALL_STRENGTH.values()}
    stronger: dict[str, Any] = {name: None if value is None else value * factor for name, value in strength.items()}
    return replace(scene, boundary=replace(boundary, **stronger))


class ContactForces(NamedTuple):
    """Forces along a contact over the weight of its soil, summed over its nodes.

    Args:
        needed: that hold the soil at rest.
        strength: that the contact has.
        excess: by which those exceed the strength of their node.
    """

    needed: Array
    strength: Array
    excess: Array


@jax.jit
def contact_forces(scene: Scene, state: State) -> ContactForces:
    """How soil at rest draws on its contact."""
    scene = near_soil(scene, scene.particles.position)
    dt, maps, strengths = scene.numerics.time_step, Maps(scene, scene.particles.position), []
    nodal = pushed(scene, state, at_start(scene, state, maps), maps)
    brake, mass = braked(scene, nodal, dt), nodal.mass[:, 0]

    def noted(region: Region | None, push: Array) -> Array:
        largest = brake(region, push)
        weighed = mass.reshape(scene.grid.shape)[region] if isinstance(region, tuple) else mass
        strengths.append(jnp.sum(largest * weighed))
        return largest

    smooth = replace(scene, boundary=replace(scene.boundary, friction=None))
    velocity = move_grid(smooth, nodal, jnp.zeros(()), dt).velocity
    free, limited = slide(scene, velocity, lambda _, push: jnp.zeros_like(push)), slide(scene, velocity, noted)
    needed, excess = (jnp.sum(jnp.linalg.norm(nodal.mass * v, axis=1)) for v in (free, limited))
    impulse = dt * jnp.sum(scene.particles.mass) * jnp.linalg.norm(scene.loads.gravity)
    return ContactForces(needed / impulse, jnp.asarray(sum(strengths)) / impulse, excess / impulse)


def at_start(scene: Scene, state: State, maps: Maps) -> Nodal:
    """The nodes before the soil's stress acts on them."""
    return particles_to_grid(scene, state, scene.numerics.time_step, maps, stressed=False)


@jax.jit
def relaxed(scene: Scene, state: State, damping: float, steps: int) -> Array:
    """Stress (s, N) Pa after so many steps of damped (1/s) elastic motion of the grid."""
    scene = near_soil(scene, scene.particles.position)
    d, volume = scene.grid.dimension, scene.particles.volume
    dt, maps = scene.numerics.time_step, Maps(scene, scene.particles.position)
    scene = replace(scene, numerics=replace(scene.numerics, damping=jnp.asarray(damping, dt.dtype)))
    nodal = at_start(scene, state, maps)

    def step(_: int, now: tuple[Array, Array]) -> tuple[Array, Array]:
        momentum, stress = now
        acted = pushed(scene, replace(state, stress=stress), nodal._replace(momentum=momentum), maps)
        velocity = move_grid(scene, acted, jnp.zeros(()), dt).velocity
        strain = maps.unlocked(tensors.strain_increment(tensors.entries(maps.gradient(velocity)), dt), volume)
        change = elastic_increment(scene.material.bulk, scene.material.shear, strain)
        return nodal.mass * velocity, stress + tensors.compress(change, d)

    return jax.lax.fori_loop(0, steps, step, (jnp.zeros_like(nodal.momentum), state.stress))[1]
