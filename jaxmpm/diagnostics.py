"""Energy, momentum and displacement of a state; each function is for one lane and can be vmapped over a batch.

Those that take a scene raise ValueError for a state of another number of particles, or of many lanes.
"""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmpm import tensors
from jaxmpm.boundary import hold
from jaxmpm.equations import Maps, acting_stress, excess_of, external_force, felt_gravity, grid_position, reciprocal
from jaxmpm.laws import pressure_left
from jaxmpm.support import check
from jaxmpm.transfer import momentum as particle_momentum
from jaxmpm.transfer import on_nodes
from jaxmpm.types import Scene, State


def _of_one_lane(scene: Scene, state: State) -> None:
    shape, expected = np.shape(state.displacement), np.shape(scene.particles.position)
    if shape != expected:
        raise ValueError(
            f"the state's displacement has shape {shape}, the scene needs {expected}: give the state of one lane of "
            "this scene, or map over the lanes with jax.vmap"
        )


def position(scene: Scene, state: State) -> Array:
    """Current positions.

    Args:
        scene: of the state.
        state: of one lane.

    Returns:
        (d, N) m.

    Raises:
        ValueError: If the state is not of one lane of this scene.
    """
    _of_one_lane(scene, state)
    return scene.particles.position + state.displacement


def displacement(state: State) -> Array:
    """Length of the displacement of each particle.

    Args:
        state: of one lane.

    Returns:
        (N,) m.
    """
    return tensors.safe_sqrt(jnp.sum(state.displacement**2, axis=0))


def largest_displacement(state: State) -> Array:
    """Largest length of a particle's displacement.

    Args:
        state: of one lane.

    Returns:
        () m.
    """
    return jnp.max(displacement(state))


def exceeded_displacement(scene: Scene, state: State, volume: float | None) -> Array:
    """Largest displacement that a given volume of soil has reached or exceeded.

    Soil is counted from the largest displacement down, so that neither a few grains nor soil that stands affect the
    result. If the volume exceeds that of the soil, it is the least displacement.

    Args:
        scene: of the state.
        state: of one lane.
        volume: of undeformed soil (m3, in a section m2), above 0; None for a single particle.

    Returns:
        () m.

    Raises:
        ValueError: If the volume is not above 0, or the state is not of one lane of this scene.
    """
    _of_one_lane(scene, state)
    if volume is None:
        return largest_displacement(state)
    check.positive("volume", volume)
    distance, volumes = displacement(state), scene.particles.volume
    order = jnp.argsort(-distance)
    # Half a particle less than the given volume, so that rounding does not matter.
    last = jnp.searchsorted(jnp.cumsum(volumes[order]), volume - jnp.min(volumes) / 2)
    return distance[order][jnp.minimum(last, distance.size - 1)]


def mean_displacement(scene: Scene, state: State) -> Array:
    """Mean length of the displacement of all soil, weighted by mass.

    Args:
        scene: of the state.
        state: of one lane.

    Returns:
        () m.

    Raises:
        ValueError: If the state is not of one lane of this scene.
    """
    _of_one_lane(scene, state)
    mass = scene.particles.mass
    return jnp.sum(mass * displacement(state)) / jnp.sum(mass)


def slide_displacement(scene: Scene, state: State, beyond: float) -> Array:
    """Sum of mass times displacement of all soil, over the mass that moved farther than a limit.

    It is a mean over the slide, plus the creep of soil that does not slide yet.

    Args:
        scene: of the state.
        state: of one lane.
        beyond: displacement from which soil counts as the slide (m).

    Returns:
        () m, 0 if no soil moved that far.
    """
    distance, mass = displacement(state), scene.particles.mass
    slides = jnp.sum(jnp.where(distance > beyond, mass, 0))
    return jnp.where(slides > 0, jnp.sum(mass * distance) / jnp.where(slides > 0, slides, 1), 0)


def momentum(scene: Scene, state: State) -> Array:
    """Total momentum.

    Args:
        scene: of the state.
        state: of one lane.

    Returns:
        (d,) kg m/s.

    Raises:
        ValueError: If the state is not of one lane of this scene.
    """
    _of_one_lane(scene, state)
    return jnp.sum(scene.particles.mass * state.velocity, axis=1)


def grid_velocity(scene: Scene, state: State) -> Array:
    """Velocity of the grid at the particles, by which they move.

    With FLIP the particles' own velocities also have parts that cancel at the nodes; these oscillate for long in soil
    that stands.

    Args:
        scene: of the state.
        state: of one lane.

    Returns:
        (d, N) m/s.

    Raises:
        ValueError: If the state is not of one lane of this scene.
    """
    _of_one_lane(scene, state)
    position = grid_position(scene, state)

    def on(scene: Scene) -> Array:
        maps, d = Maps(scene, position), scene.grid.dimension
        carried = {"mass": scene.particles.mass[None], "momentum": particle_momentum(scene, state, maps.position)}
        sums = maps.sums(carried, None)
        velocity = hold(scene, reciprocal(scene, maps.fold(sums["mass"])) * maps.momentum(sums["momentum"]))
        return maps.to_particles(velocity, values=d, gradients=0)[0]

    return on_nodes(scene, position, on)


def kinetic_energy(scene: Scene, state: State) -> Array:
    """Kinetic energy of the particles.

    Args:
        scene: of the state.
        state: of one lane.

    Returns:
        () J.

    Raises:
        ValueError: If the state is not of one lane of this scene.
    """
    _of_one_lane(scene, state)
    return 0.5 * jnp.sum(scene.particles.mass * jnp.sum(state.velocity**2, axis=0))


def effective_stress(scene: Scene, state: State) -> Array:
    """Stress that the grains bear: that of the state, of soil with a B-value with the excess of its water added.

    Without water, and in soil without friction, it is the total stress.

    Args:
        scene: of the state.
        state: of one lane.

    Returns:
        (s, N) Pa, the components of the state.

    Raises:
        ValueError: If the state is not of one lane of this scene.
    """
    _of_one_lane(scene, state)
    excess = excess_of(scene, state)
    if excess is None:
        return state.stress
    d = scene.grid.dimension
    stress = tensors.expand(state.stress, d)
    return tensors.compress(tensors.with_mean(stress, tensors.mean(stress) + excess), d)


def pore_pressure(scene: Scene, state: State) -> Array:
    """Pressure of the water in the soil: that of a table where the soil is now, that which it carries, and the excess.

    Args:
        scene: of the state.
        state: of one lane.

    Returns:
        (N,) Pa, 0 without water.

    Raises:
        ValueError: If the state is not of one lane of this scene.
    """
    _of_one_lane(scene, state)
    loads, pressure = scene.loads, jnp.zeros_like(scene.particles.mass)
    if loads.water is not None:
        pressure = pressure + loads.water.pressure(grid_position(scene, state))
    if loads.pore_pressure is not None:
        pressure = pressure + pressure_left(jnp.log(state.volume_ratio)) * loads.pore_pressure
    excess = excess_of(scene, state)
    return pressure if excess is None else pressure + excess


def elastic_energy(scene: Scene, state: State) -> Array:
    """Energy stored in the elastic effective stress, and of soil with a B-value in the excess pressure of its water.

    With finite strains it is that of the Kirchhoff stress, per initial volume.

    Args:
        scene: of the state, with a material that has `bulk` and `shear`.
        state: of one lane.

    Returns:
        () J.

    Raises:
        ValueError: If the state is not of one lane of this scene.
    """
    _of_one_lane(scene, state)
    ratio = state.volume_ratio
    measure, law = ratio if scene.numerics.finite_strain else 1, scene.material
    stress = tensors.expand(measure * effective_stress(scene, state), scene.grid.dimension)
    pressure, j2 = tensors.mean(stress), tensors.second_invariant(tensors.deviator(stress))
    density = pressure**2 / (2 * law.bulk) + j2 / (2 * law.shear)
    excess = excess_of(scene, state)
    if excess is not None:
        water = law.p_wave_modulus - law.bulk - 4 * law.shear / 3
        density = density + jnp.where(excess == 0, 0, (measure * excess) ** 2 / (2 * jnp.where(excess == 0, 1, water)))
    return jnp.sum(scene.particles.volume * (1 if scene.numerics.finite_strain else ratio) * density)


def potential_energy(scene: Scene, state: State) -> Array:
    """Potential energy of gravity, relative to the initial positions.

    Args:
        scene: of the state.
        state: of one lane.

    Returns:
        () J.

    Raises:
        ValueError: If the state is not of one lane of this scene.
    """
    _of_one_lane(scene, state)
    return -jnp.sum(scene.particles.mass * (scene.loads.gravity @ state.displacement))


def speed(scene: Scene, state: State) -> Array:
    """Root mean square of the particle speed, weighted by mass.

    Args:
        scene: of the state.
        state: of one lane.

    Returns:
        () m/s.

    Raises:
        ValueError: If the state is not of one lane of this scene.
    """
    return tensors.safe_sqrt(2 * kinetic_energy(scene, state) / jnp.sum(scene.particles.mass))


def unbalanced_force(scene: Scene, state: State) -> Array:
    """Norm of the net force on the free nodes over that of their load.

    The load is gravity, body force, water and the motion of the base. What walls with friction, an interface and a free
    field bear does not count, so that soil on these has a ratio above 0 at rest.

    Args:
        scene: of the state.
        state: of one lane.

    Returns:
        () ratio, 0 in equilibrium on walls and bases without friction.

    Raises:
        ValueError: If the state is not of one lane of this scene.
    """
    _of_one_lane(scene, state)
    position = grid_position(scene, state)

    def on(scene: Scene) -> Array:
        maps, particles = Maps(scene, position), scene.particles
        volume = particles.volume * state.volume_ratio
        acting = acting_stress(scene, state.stress, volume, maps, excess_of(scene, state))
        sums = maps.sums({"mass": particles.mass[None]}, acting)
        time = state.step * scene.numerics.time_step
        load = maps.fold(sums["mass"]) * felt_gravity(scene, time)
        external = external_force(scene, maps.position, time)
        if external is not None:
            load = load + maps.to_grid(external, None)
        weight = hold(scene, load)
        net = hold(scene, maps.fold(sums["force"]) + load)
        return jnp.sqrt(jnp.sum(net**2) / jnp.maximum(jnp.sum(weight**2), jnp.finfo(net.dtype).tiny))

    return on_nodes(scene, position, on)
