"""Time steps that soil as thin as a particle is stable with, which waves alone do not tell.

A particle alone in its cells oscillates between its nodes faster than a wave crosses a cell: with the square of its
frequency up to 8 (c / h)^2 times the number of axes. Where other soil shares its nodes, that is less.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
from jax import Array

from jaxmpm import tensors
from jaxmpm.boundary import hold
from jaxmpm.equations import MASS_FLOOR, Maps, acting_stress
from jaxmpm.laws import elastic_increment
from jaxmpm.support import check
from jaxmpm.transfer import near_soil, of_stored
from jaxmpm.types import Scene

LIMIT = 2.0
"""Frequency times time step from which on an explicit step gains energy."""

NEAR = 0.95
"""Share of it from which on a step is shortened, since the frequency is known from below."""

SAFE = 0.5
"""CFL number up to which a particle alone is stable. Soil thins out in other places as it moves, so that no step
between this one and that of the frequency at the start is safe."""

ITERATIONS = 60


@partial(jax.jit, static_argnames="iterations")
def highest_frequency(scene: Scene, *, iterations: int = ITERATIONS) -> Array:
    """Highest angular frequency of small elastic motions of the soil on its grid, by power iteration.

    Args:
        scene: at the start.
        iterations: their number.

    Returns:
        () rad/s, from below.
    """
    particles, d = scene.particles, scene.grid.dimension
    scene = replace(scene, loads=replace(scene.loads, pore_pressure=None))
    scene = near_soil(scene, particles.position)
    law = scene.material
    bulk = law.p_wave_modulus - 4 * law.shear / 3
    maps = Maps(scene, particles.position)
    mass = maps.to_grid(particles.mass[None], None)[:, :1]
    carries = mass > MASS_FLOOR * jnp.mean(particles.mass)
    weight = jnp.where(carries, mass, 0)

    def accelerations(u: Array) -> Array:
        entries = tensors.entries(maps.gradient(u))
        strain = maps.unlocked(tensors.strain_increment(entries, jnp.ones((), u.dtype)), particles.volume)
        stress = tensors.compress(elastic_increment(bulk, law.shear, strain), d)
        force = maps.to_grid(None, acting_stress(scene, stress, particles.volume, maps))
        return hold(scene, jnp.where(carries, -force / jnp.where(carries, mass, 1), 0))

    def unit(u: Array) -> tuple[Array, Array]:
        size = jnp.sqrt(jnp.sum(weight * u**2))
        return u / jnp.where(size > 0, size, 1), size

    noise = jax.random.normal(jax.random.key(0), (scene.grid.nodes, d), particles.mass.dtype)
    noise = of_stored(scene.grid, noise)
    start = unit(hold(scene, jnp.where(carries, noise, 0)))[0], jnp.zeros((), particles.mass.dtype)
    _, square = jax.lax.fori_loop(0, iterations, lambda _, state: unit(accelerations(state[0])), start)
    return jnp.sqrt(square)


def with_stable_step(scene: Scene, cfl: float) -> Scene:
    """The scene with a shorter time step if its own lets thin soil on rigid ground gain energy.

    Args:
        scene: at the start.
        cfl: CFL number of its time step.

    Returns:
        The scene, itself if its step is stable.
    """
    boundary = scene.boundary
    if cfl <= SAFE or (boundary.base is None and boundary.cut is None):
        return scene
    step = float(scene.numerics.time_step)
    turn = float(highest_frequency(scene)) * step
    if not turn > LIMIT * NEAR:
        return scene
    shorter = step * SAFE / cfl
    check.warn(
        f"soil on the rigid ground is as thin as a particle in places, which oscillates too fast for time steps of "
        f"{step:.3g} s (cfl = {cfl:g}): they are {shorter:.3g} s (cfl = {SAFE:g})"
    )
    numerics = replace(scene.numerics, time_step=jnp.asarray(shorter, scene.numerics.time_step.dtype))
    return replace(scene, numerics=numerics)
