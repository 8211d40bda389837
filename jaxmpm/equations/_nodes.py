"""Nodal mass, momentum and force of the particles, and the motion of the nodes."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from jaxmpm import tensors
from jaxmpm.boundary import Region, hold, slide
from jaxmpm.equations._gaps import bridged, by_levels, closed, gaps, sheared, shifted
from jaxmpm.equations._maps import Maps, reciprocal
from jaxmpm.equations._stress import acting_stress, excess_of
from jaxmpm.laws import softened
from jaxmpm.transfer import at_rows, beside, momentum, thickness_on
from jaxmpm.types import Scene, State


class Beyond(NamedTuple):
    """Action of the free field on the nodes at both ends of the ground.

    Args:
        velocity: (2, nz, d) m/s at the end of the step, from the base up.
        traction: (2, nz, d) N.
        impedance: (2, nz, d) of the dashpots (kg/s).
    """

    velocity: Array
    traction: Array
    impedance: Array


class Nodal(NamedTuple):
    """Values at the nodes.

    Args:
        mass: (nodes, d) kg, equal along all axes.
        momentum: (nodes, d) kg m/s.
        force: (nodes, d) N; None before there is one.
        per_mass: (nodes, d) 1 / mass (1/kg), 0 at nodes without mass and for components that walls hold.
        area: (nodes,) area of soil on a wall or the base (m2), at their nodes; None if they do not need it.
        history_change: (nodes, leaves) average change of the history in the step before; None if it is not averaged.
        beyond: action of the free field; None without.
        unsoftened: (nodes,) share of the strength of walls and the base that slip has left; None if it takes none.
        undrained: (nodes,) share of the soil that has no friction; None where all of it is of one kind.
    """

    mass: Array
    momentum: Array
    force: Array | None
    per_mass: Array
    area: Array | None = None
    history_change: Array | None = None
    beyond: Beyond | None = None
    unsoftened: Array | None = None
    undrained: Array | None = None


class GridMotion(NamedTuple):
    """The grid after its motion.

    Args:
        velocity: (nodes, d) m/s.
        acceleration: (nodes, d) m/s2.
    """

    velocity: Array
    acceleration: Array


def particles_to_grid(scene: Scene, state: State, dt: Array, maps: Maps, *, stressed: bool = True) -> Nodal:
    """Mass, momentum and force of the particles at the nodes; the force of their stress only if `stressed`."""
    particles, passes = scene.particles, scene.numerics.nonlocal_passes
    volume, shears = particles.volume * state.volume_ratio, sheared(scene)
    changes = [] if passes is None else jax.tree.leaves(state.unaveraged)
    carried = {
        "mass": jnp.stack([particles.mass, *(particles.mass * change for change in changes)]),
        "momentum": momentum(scene, state, maps.position),
    }
    external = external_force(scene, maps.position, state.step * dt)
    if external is not None:
        carried["external"] = external
    remaining = left_on_contact(scene, state.displacement)
    if remaining is not None:
        carried["unsoftened"] = (particles.mass * remaining)[None]
    if bonded(scene):
        carried["volume"] = particles.volume[None]  # without the gaps of soil that has opened, which bear nothing
    if not isinstance(shears, bool):
        carried["undrained"] = (particles.mass * shears)[None]
    stress = acting_stress(scene, state.stress, volume, maps, excess_of(scene, state)) if stressed else None
    sums = maps.sums(carried, stress, None if stress is None else by_levels(scene, volume, stress))
    moving = maps.momentum(sums.pop("momentum"))
    sums = {name: maps.fold(block) for name, block in sums.items()}
    weight = sums["mass"][:, 0]

    def share(name: str) -> Array | None:
        """Average by mass of a channel that is mapped."""
        return sums[name][:, 0] * reciprocal(scene, weight) if name in sums else None

    undrained, covers = share("undrained"), "volume" in sums
    gap = gaps(scene, weight) if covers or shears is not False else None
    if "upright" in sums:
        sums["force"] = bridged(scene, sums["upright"], sums["force"], gap)
    if stressed and shears is not False:
        sums["force"] = closed(scene, gap, sums["force"], undrained)
    forces = [sums[name] for name in ("external", "force") if name in sums]
    mass = tensors.spread(sums["mass"][:, :1], scene.grid.dimension, axis=1)
    return Nodal(
        mass=mass,
        momentum=moving,
        force=sum(forces[1:], forces[0]) if forces else None,
        per_mass=reciprocal(scene, hold(scene, mass, math.inf)),
        area=area_covered(scene, sums["volume"][:, 0], gap) if covers else None,
        history_change=None if passes is None else maps.nodal_average(sums["mass"], passes),
        unsoftened=share("unsoftened"),
        undrained=undrained,
    )


def left_on_contact(scene: Scene, displacement: Array) -> Array | None:
    """Share of the strength of the base that is left under soil, which falls with its slip.

    The slip is the displacement of the soil next to the base from the start. So it goes with the soil, and soil that
    comes to fresh ground finds no fresh strength there. Soil that slides back would regain strength: `scene` refuses
    the shaking that does this to it.

    A contact that softens as its soil does what a layer of this soil would that is as thick as shear bands, so that
    slip takes the same work on every grid where softening is scaled by them. Under shaking it keeps its strength.

    Source: Palmer and Rice (1973), doi:10.1098/rspa.1973.0040 (strength of a slip surface that falls with slip).

    Args:
        scene: of the soil.
        displacement: (d, N) m.

    Returns:
        (N,); None for a contact that keeps its strength.
    """
    boundary = scene.boundary
    if boundary.softening is None and (not boundary.softens or scene.loads.motion is not None):
        return None
    slip = tensors.safe_sqrt(jnp.sum(displacement**2, axis=0))
    if boundary.softening is None:
        numerics = scene.numerics
        band = thickness_on(numerics.nonlocal_passes, numerics.kernel, scene.grid.cell)
        return softened(scene.material, slip / band)
    residual, length = boundary.softening
    return 1 - (1 - residual) * jnp.minimum(slip / length, 1)


def external_force(scene: Scene, position: Array, time: Array) -> Array | None:
    """Force (d, N) N besides gravity on particles at `position` (d, N) m; None if there is none.

    Water fills what opens between grains, so that it carries as much of the soil as at the start.
    """
    particles, loads, force = scene.particles, scene.loads, None
    if loads.body_force is not None:
        force = particles.mass * loads.body_force(particles.position, time)
    if loads.water is not None:
        push = particles.volume * loads.water.push(position)
        force = push if force is None else force + push
    return force


def felt_gravity(scene: Scene, time: Array) -> Array:
    """Gravity (d,) m/s2 minus the acceleration of the base, in whose frame the soil moves."""
    loads = scene.loads
    return loads.gravity if loads.motion is None else loads.gravity - loads.motion.at(time)


def pushed(scene: Scene, state: State, nodal: Nodal, maps: Maps) -> Nodal:
    """The nodes with the force of the particles' stress added."""
    volume, d = scene.particles.volume * state.volume_ratio, scene.grid.dimension
    acting = acting_stress(scene, state.stress, volume, maps, excess_of(scene, state))
    levels = by_levels(scene, volume, acting)
    sums = maps.to_grid(None, acting, levels)
    gap = gaps(scene, nodal.mass[:, 0]) if sheared(scene) is not False else None
    stress = sums[:, :d] if levels is None else bridged(scene, sums[:, d:], sums[:, :d], gap)
    stress = closed(scene, gap, stress, nodal.undrained)
    return nodal._replace(force=stress if nodal.force is None else nodal.force + stress)


def move_grid(scene: Scene, nodal: Nodal, time: Array, dt: Array) -> GridMotion:
    """Motion of the nodes by forces, gravity and damping, with walls applied."""
    assert nodal.force is not None
    before = nodal_velocity(nodal)
    acceleration = nodal.per_mass * (nodal.force + nodal.mass * felt_gravity(scene, time))
    if scene.numerics.damping is not None:
        acceleration = acceleration - scene.numerics.damping * before
    if nodal.beyond is not None:
        acceleration = led(scene, nodal, before, acceleration, dt)
    velocity = before + dt * acceleration
    if scene.boundary.friction is None:
        return GridMotion(velocity, acceleration)
    velocity = slide(scene, velocity, braked(scene, nodal, dt))
    return GridMotion(velocity, (velocity - before) / dt)


def bonded(scene: Scene) -> bool:
    """Whether walls with friction need the area of soil on them."""
    return scene.boundary.cohesion is not None or scene.boundary.pressure is not None


COVERED = 0.25
"""Share of the volume of full cells from which soil covers all of the base at a node; with less, in proportion."""


def area_covered(scene: Scene, volume: Array, gap: Array | None) -> Array:
    """Area of walls or of the base that soil covers at their nodes.

    Args:
        scene: of the nodes.
        volume: of the soil mapped to them (nodes,) m3.
        gap: below soil that does not reach down to them, from `gaps`.

    Returns:
        (nodes,) m2.
    """
    if gap is not None:
        volume = volume / (1 - gap) ** 2
    base = scene.boundary.base
    if base is None:
        # Soil that fills the cells on a wall contributes half of their volume to its nodes.
        return 2 / scene.grid.cell * volume
    return base.area * jnp.minimum(1, volume / (COVERED * base.volume))


def braked(scene: Scene, nodal: Nodal, dt: Array) -> Callable[[Region | None, Array], Array]:
    """Largest change of velocity along walls with friction, as a function of the velocity into them.

    It is Coulomb friction of the contact pressure minus the water's, and cohesion, as far as slip has left them.

    Args:
        scene: with walls with friction or a base.
        nodal: values at the nodes.
        dt: time step (s).

    Returns:
        Function of a region of the nodes, None for all as (nodes,), and of the velocities m/s into walls that they stop
        there in dt; it gives the largest change of those along them m/s.
    """
    boundary, friction = scene.boundary, scene.boundary.friction
    assert friction is not None

    def at(region: Region | None, value: Array) -> Array:
        """A number, or the nodes' values in a region; those of all rows for a region of rows."""
        part = isinstance(region, tuple) and value.ndim
        return value.reshape(scene.grid.shape)[region] if part else value

    def softened(region: Region | None, strength: Array) -> Array:
        return strength if nodal.unsoftened is None else strength * at(region, nodal.unsoftened)

    if nodal.area is None:
        return lambda region, push: softened(region, at(region, friction)) * push
    rate = dt * nodal.area * reciprocal(scene, nodal.mass[:, 0])
    zero = jnp.zeros_like(rate)
    water = zero if boundary.pressure is None else rate * boundary.pressure
    cohesion = zero if boundary.cohesion is None else rate * boundary.cohesion

    def largest(region: Region | None, push: Array) -> Array:
        borne = softened(region, at(region, friction)) * jnp.maximum(push - at(region, water), 0)
        pressed = push > 0 if region is not None else pressed_on_base(scene, push)
        return jnp.where(pressed, borne + softened(region, at(region, cohesion)), 0)

    return largest


def pressed_on_base(scene: Scene, push: Array) -> Array:
    """Nodes (nodes,) bool of the base that bear soil themselves or by the node below, of `push` (nodes,) m/s into it.

    On steep rock the uppermost node of a column, which has the contact's area, may be drawn off it while those below
    press: soil above a step hangs over its edge.
    """
    grid, pressing = scene.grid, push > 0
    upright = grid.dimension - 1
    if grid.near is not None:
        return pressing | at_rows(pressing, beside(grid, upright, -1))
    pressing = pressing.reshape(grid.shape)
    return (pressing | shifted(pressing, -1, upright)).ravel()


def led(scene: Scene, nodal: Nodal, before: Array, acceleration: Array, dt: Array) -> Array:
    """Acceleration with the traction of the free field on the ends and of the dashpots between them.

    Dashpots take the velocities at the end of the step, so that light nodes are stable.

    Args:
        scene: with a free field.
        nodal: values at the nodes.
        before: velocity (nodes, d) m/s.
        acceleration: (nodes, d) m/s2 without the free field.
        dt: time step (s).

    Returns:
        (nodes, d) m/s2.
    """
    assert scene.free_field is not None
    assert nodal.beyond is not None
    shape = (*scene.grid.shape, scene.grid.dimension)
    per_mass, before, field = (values.reshape(shape) for values in (nodal.per_mass, before, acceleration))
    for plane, velocity, traction, impedance in zip(scene.free_field.planes, *nodal.beyond, strict=True):
        rate = per_mass[plane] * impedance
        pull = per_mass[plane] * traction + rate * (velocity - before[plane])
        field = field.at[plane].set((field[plane] + pull) / (1 + dt * rate))
    return field.reshape(acceleration.shape)


def nodal_velocity(nodal: Nodal) -> Array:
    """Velocity (nodes, d) m/s of the nodes, with walls applied."""
    return nodal.per_mass * nodal.momentum
