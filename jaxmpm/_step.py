"""One step of the material point method, State -> State.

A step is made of five moves: particles give to the nodes, the grid moves, it moves the particles, velocities are mapped
again, the velocity's gradient strains the soil. The schemes differ in the order of these alone.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple, Protocol

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmpm import tensors
from jaxmpm.boundary import around, fold, hold, moved_along, one_with, slide, unfold
from jaxmpm.laws import elastic_increment, elastic_strain, logarithmic, update_with_gap, volumetric
from jaxmpm.transfer import filtered, g2p, momentum, nodal_momentum, p2g, velocity_gradient, within_cells
from jaxmpm.types import Scene, Scheme, State, Tensor

# Nodes with less than this share of the mean particle mass carry nothing. What they drop is lost momentum, so it is
# far below rounding; a node's velocity, a ratio of sums with the same weights, is good down to there.
MASS_FLOOR = 1e-12


def step(scene: Scene, state: State, dt: Array) -> State:
    """Advance by dt (s). Pure, differentiable, vmappable; only the fields of motion change, not step and status.

    Sources: Sulsky, Chen and Schreyer (1994), 10.1016/0045-7825(94)90112-0 (the method); Bardenhagen (2002),
    10.1006/jcph.2002.7103 (USF, USL) and Sulsky, Zhou and Schreyer (1995), 10.1016/0010-4655(94)00170-7 (MUSL).
    """
    moved = SCHEMES[scene.scheme](scene, state, dt, Maps(scene, place(scene, state)))
    if scene.free_field is None:
        return moved
    low, high = (step(column, own, dt) for column, own in beyond_ends(scene, state))
    return replace(moved, free_field=(low, high))


def place(scene: Scene, state: State) -> Array:
    """Where particles stand on the grid (d, N) m: their positions, brought back in where tied sides let them out."""
    position = scene.particles.position + state.displacement
    return position if scene.tied is None else around(scene.tied, scene.grid, position)


def update_stress_first(scene: Scene, state: State, dt: Array, maps: Maps) -> State:
    """USF: the soil is strained in the velocities that particles bring, before the grid moves."""
    nodal = particles_to_grid(scene, state, dt, maps, stressed=False)
    gradient = maps.gradient(straining_velocity(scene, state, nodal, dt, maps))
    state = update_stress(scene, state, gradient, dt, maps)
    moved = move_grid(scene, pushed(scene, state, nodal, maps), state.step * dt, dt)
    state, _ = grid_to_particles(scene, state, moved, dt, maps)
    return state


def update_stress_last(scene: Scene, state: State, dt: Array, maps: Maps) -> State:
    """USL: the soil is strained in the velocities of the grid at the end of the step."""
    nodal = particles_to_grid(scene, state, dt, maps)
    moved = move_grid(scene, nodal, state.step * dt, dt)
    state, gradient = grid_to_particles(scene, state, moved, dt, maps, strain=True)
    return update_stress(scene, state, gradient, dt, maps)


def modified_update_stress_last(scene: Scene, state: State, dt: Array, maps: Maps) -> State:
    """MUSL: particles give the grid their new velocities, in which the soil is then strained."""
    nodal = particles_to_grid(scene, state, dt, maps)
    moved = move_grid(scene, nodal, state.step * dt, dt)
    state, _ = grid_to_particles(scene, state, moved, dt, maps)
    gradient = maps.gradient(mapped_again(scene, state, nodal, moved, maps))
    return update_stress(scene, state, gradient, dt, maps)


class Move(Protocol):
    """A scheme."""

    def __call__(self, scene: Scene, state: State, dt: Array, maps: Maps) -> State:
        """The state after a step of dt (s)."""


SCHEMES: dict[Scheme, Move] = {
    Scheme.USF: update_stress_first,
    Scheme.USL: update_stress_last,
    Scheme.MUSL: modified_update_stress_last,
}


class Beyond(NamedTuple):
    """What the free field does to the nodes at the ends of the ground, those of both ends (2, nz, d) from the base up:
    its velocity in m/s at the end of the step, its traction in N, and the impedance of the dashpots in kg/s."""

    velocity: Array
    traction: Array
    impedance: Array


class Nodal(NamedTuple):
    """What the nodes hold: mass (nodes, d) kg, alike along all axes, momentum (nodes, d) kg m/s, and the force on them
    (nodes, d) N, None while there is none. per_mass: 1 / mass (nodes, d) 1/kg, 0 where there is none. area: of soil
    on a wall (nodes,) m2, at nodes that lie on one, None where no wall asks. beyond: the ends' free field, None
    without."""

    mass: Array
    momentum: Array
    force: Array | None
    per_mass: Array
    area: Array | None = None
    beyond: Beyond | None = None


class Moved(NamedTuple):
    """The grid after its motion: velocity (nodes, d) m/s and acceleration (nodes, d) m/s2."""

    velocity: Array
    acceleration: Array


class Maps(NamedTuple):
    """The transfers between the grid and particles that stand at `position` (d, N) m."""

    scene: Scene
    position: Array

    def to_grid(self, carried: Array | None, stress: Array | None) -> Array:
        """See `jaxmpm.transfer.p2g`."""
        return self.joined(self.to_reached(carried, stress))

    def to_particles(self, nodal: Array, *, values: int, gradients: int) -> tuple[Any, Any]:
        """See `jaxmpm.transfer.g2p`."""
        return self.from_reached(self.parted(nodal), values=values, gradients=gradients)

    def to_reached(self, carried: Array | None, stress: Array | None) -> Array:
        """As `to_grid`, at the nodes that particles reach: those beyond open ends of the ground too."""
        scene = self.scene
        return p2g(scene.grid, scene.kernel, self.position, carried, stress, engine=scene.engine)

    def from_reached(self, nodal: Array, *, values: int, gradients: int) -> tuple[Any, Any]:
        """As `to_particles`, from the nodes that they reach."""
        scene = self.scene
        return g2p(
            scene.grid, scene.kernel, self.position, nodal, values=values, gradients=gradients, engine=scene.engine
        )

    def joined(self, reached: Array) -> Array:
        """Sums (nodes, c) with those beyond open ends added to the nodes that they are one with."""
        return fold(one_with(self.scene), self.scene.grid, reached)

    def parted(self, nodal: Array) -> Array:
        """Nodal values (nodes, c), beyond open ends too."""
        return unfold(one_with(self.scene), self.scene.grid, nodal)

    def momentum(self, moving: Array) -> Array:
        """Momentum (nodes, d) kg m/s of the nodes from the channels of `jaxmpm.transfer.momentum` at the nodes that
        particles reach: an affine part is of these nodes' own places, before those beyond open ends are added."""
        return self.joined(nodal_momentum(self.scene.grid, moving))

    def gradient(self, velocity: Array) -> Array:
        """Gradient (d, d, N) 1/s of velocities (nodes, d) m/s at the particles."""
        return self.to_particles(velocity, values=0, gradients=self.scene.grid.dimension)[1]

    def average(self, values: Array, passes: int) -> Array:
        """Average of `values` (N,) over the particles around each one, weighted by mass, through `passes` filters."""
        m = self.scene.particles.mass
        nodal = filtered(self.scene.grid, self.to_grid(jnp.stack([m, m * values]), None), passes)
        averaged, _ = self.to_particles(reciprocal(self.scene, nodal[:, :1]) * nodal[:, 1:], values=1, gradients=0)
        return averaged[0]

    def unlocked(self, strain: Tensor, volume: Array) -> Tensor:
        """The strain with its mean averaged as the scene asks; volume: of the particles (N,) m3."""
        scene = self.scene
        if scene.fbar:
            return tensors.with_mean(strain, self.average(tensors.mean(strain), 0))
        if scene.cell_average:
            return tensors.with_mean(strain, within_cells(scene.grid, self.position, tensors.mean(strain), volume))
        return strain


def particles_to_grid(scene: Scene, state: State, dt: Array, maps: Maps, *, stressed: bool = True) -> Nodal:
    """Mass, momentum and force of the particles at the nodes; the force of their stress only if `stressed`."""
    particles, grid = scene.particles, scene.grid
    carried = [particles.mass[None], momentum(scene, state, maps.position)]
    volume, area = particles.volume * state.volume_ratio, None
    external = external_force(scene, maps.position, volume, state.step * dt)
    if external is not None:
        carried.append(external)
    if bonded(scene):
        # Soil that fills the cells on a wall gives its nodes half of their volume.
        carried.insert(0, 2 / grid.cell * volume[None])
    nodal = maps.to_reached(
        jnp.concatenate(carried), acting_stress(scene, state.stress, volume, maps) if stressed else None
    )
    ends = np.cumsum([len(block) for block in carried][: None if stressed else -1])
    blocks = jnp.split(nodal, ends, axis=1)
    if bonded(scene):
        area = maps.joined(blocks.pop(0))[:, 0]
    mass, moving, *forces = blocks
    mass = tensors.spread(maps.joined(mass), grid.dimension, axis=1)
    return Nodal(
        mass=mass,
        momentum=maps.momentum(moving),
        force=maps.joined(sum(forces[1:], forces[0])) if forces else None,
        per_mass=reciprocal(scene, mass),
        area=area,
        beyond=None if scene.free_field is None else free_field(scene, state, dt),
    )


SHARED = (
    *("gravity", "motion", "body_force", "damping", "flip", "scheme", "engine"),
    *("fbar", "cell_average", "finite_strain"),
)
"""What columns of a free field take over from the scene."""


def beyond_ends(scene: Scene, state: State) -> list[tuple[Scene, State]]:
    """The columns of the free field, at the scene's time and shaken as it is."""
    assert scene.free_field is not None
    assert state.free_field is not None
    shared: dict[str, Any] = {name: getattr(scene, name) for name in SHARED}
    columns = (replace(column, **shared) for column in (scene.free_field.low, scene.free_field.high))
    return [(column, replace(own, step=state.step)) for column, own in zip(columns, state.free_field, strict=True)]


def free_field(scene: Scene, state: State, dt: Array) -> Beyond:
    """What the free field does to the ends in a step of dt (s). See `FreeField`."""
    assert scene.free_field is not None
    sides = [beside(*one, dt, scene.grid.shape[-1]) for one in beyond_ends(scene, state)]
    velocity, (low, high), impedance = (jnp.stack(each) for each in zip(*sides, strict=True))
    return Beyond(velocity, scene.free_field.held + jnp.stack([-low, high]), impedance)


def beside(column: Scene, state: State, dt: Array, height: int) -> list[Array]:
    """Of a column of the free field, at each of `height` nodes from the base up (height, d): its velocity at the end of
    a step of dt in m/s, the force of its stress on a plane across x in N, and the plane's impedance to both waves."""
    maps, mass = Maps(column, place(column, state)), column.particles.mass
    moved = move_grid(column, particles_to_grid(column, state, dt, maps), state.step * dt, dt)
    stress = acting_stress(column, state.stress, column.particles.volume * state.volume_ratio, maps)
    density = mass / column.particles.volume
    waves = [mass * jnp.sqrt(modulus / density) for modulus in (column.material.p_wave_modulus, column.material.shear)]
    sums = maps.to_grid(jnp.stack([stress[0], stress[-1], *waves]) / column.grid.cell, None)
    assert column.tied is not None
    plane = jnp.concatenate([moved.velocity, sums], axis=1).reshape(*column.grid.shape, -1)[column.tied[0]]
    return jnp.split(jnp.pad(plane, ((0, height - len(plane)), (0, 0))), 3, axis=1)


def external_force(scene: Scene, position: Array, volume: Array, time: Array) -> Array | None:
    """Force (d, N) N besides gravity on particles at `position` (d, N) m of volume (N,) m3, None if there is none."""
    particles, force = scene.particles, None
    if scene.body_force is not None:
        force = particles.mass * scene.body_force(particles.position, time)
    if scene.water is not None:
        push = volume * scene.water.push(position)
        force = push if force is None else force + push
    return force


def felt_gravity(scene: Scene, time: Array) -> Array:
    """Gravity (d,) m/s2 less the acceleration of the base, in whose frame the soil moves."""
    return scene.gravity if scene.motion is None else scene.gravity - scene.motion.at(time)


def pushed(scene: Scene, state: State, nodal: Nodal, maps: Maps) -> Nodal:
    """The nodes with the force of the particles' stress as well."""
    stress = maps.to_grid(None, acting_stress(scene, state.stress, scene.particles.volume * state.volume_ratio, maps))
    return nodal._replace(force=stress if nodal.force is None else nodal.force + stress)


def move_grid(scene: Scene, nodal: Nodal, time: Array, dt: Array) -> Moved:
    """Motion of the nodes by the forces on them, gravity and damping; walls held, and those with friction braking."""
    assert nodal.force is not None
    before = nodal_velocity(scene, nodal)
    acceleration = nodal.per_mass * (nodal.force + nodal.mass * felt_gravity(scene, time))
    if scene.damping is not None:
        acceleration = acceleration - scene.damping * before
    if nodal.beyond is not None:
        acceleration = led(scene, nodal, before, acceleration, dt)
    acceleration = hold(scene, acceleration)
    velocity = before + dt * acceleration
    if scene.wall_friction is None:
        return Moved(velocity, acceleration)
    velocity = slide(scene.walls, scene.grid, velocity, braked(scene, nodal, dt))
    return Moved(velocity, (velocity - before) / dt)


def bonded(scene: Scene) -> bool:
    """Whether what walls with friction do depends on the area of soil on them."""
    return scene.wall_cohesion is not None or scene.wall_pressure is not None


def braked(scene: Scene, nodal: Nodal, dt: Array) -> Callable[[Array], Array]:
    """Gives for velocities into walls (nodes,) m/s, which they take away in dt (s), those along them (nodes,) m/s that
    they take away at most: friction of what soil presses on them, less what water bears of it, and cohesion."""
    friction = scene.wall_friction
    assert friction is not None
    if nodal.area is None:
        return lambda push: friction * push
    rate = dt * nodal.area * nodal.per_mass[:, 0]
    borne = 0.0 if scene.wall_pressure is None else rate * scene.wall_pressure
    held = 0.0 if scene.wall_cohesion is None else rate * scene.wall_cohesion
    return lambda push: jnp.where(push > 0, friction * jnp.maximum(push - borne, 0) + held, 0)


def led(scene: Scene, nodal: Nodal, before: Array, acceleration: Array, dt: Array) -> Array:
    """Acceleration (nodes, d) with the traction of the free field on the ends, and of the dashpots that tie them to it.

    before: velocity (nodes, d). Dashpots take the velocities at the end of the step, so that no node is too light.
    """
    assert scene.free_field is not None
    assert nodal.beyond is not None
    shape = (*scene.grid.shape, scene.grid.dimension)
    per_mass, before, field = (each.reshape(shape) for each in (nodal.per_mass, before, acceleration))
    for plane, velocity, traction, impedance in zip(scene.free_field.planes, *nodal.beyond, strict=True):
        rate = per_mass[plane] * impedance
        pull = per_mass[plane] * traction + rate * (velocity - before[plane])
        field = field.at[plane].set((field[plane] + pull) / (1 + dt * rate))
    return field.reshape(acceleration.shape)


def grid_to_particles(
    scene: Scene, state: State, moved: Moved, dt: Array, maps: Maps, *, strain: bool = False
) -> tuple[State, Any]:
    """The particles moved by the grid, and the velocity's gradient (d, d, N) 1/s at them if asked to `strain`."""
    d = scene.grid.dimension
    fields = jnp.concatenate([moved.velocity, moved.acceleration], axis=1)
    values, gradient = maps.to_particles(fields, values=2 * d, gradients=d if strain else 0)
    pic_velocity, change = jnp.split(values, 2)
    flip_velocity = state.velocity + dt * change
    state = replace(
        state,
        displacement=state.displacement + dt * pic_velocity,
        velocity=flip_velocity if scene.flip is None else scene.flip * flip_velocity + (1 - scene.flip) * pic_velocity,
    )
    if state.affine is not None:
        affine = velocity_gradient(scene.grid, maps.position, maps.parted(moved.velocity), maps.from_reached)
        state = replace(state, affine=affine)
    return state, gradient


def mapped_again(scene: Scene, state: State, nodal: Nodal, moved: Moved, maps: Maps) -> Array:
    """Velocity (nodes, d) of the nodes by the particles' new momentum, at the masses that they had."""
    moving = maps.momentum(maps.to_reached(momentum(scene, state, maps.position), None))
    velocity = nodal_velocity(scene, nodal._replace(momentum=moving))
    if scene.wall_friction is None:
        return velocity
    return moved_along(scene.walls, scene.grid, velocity, moved.velocity)


def straining_velocity(scene: Scene, state: State, nodal: Nodal, dt: Array, maps: Maps) -> Array:
    """Velocity (nodes, d) in which USF strains the soil: that of the nodes; at walls with friction that in which the
    forces of the stress so far would move them."""
    velocity = nodal_velocity(scene, nodal)
    if scene.wall_friction is None:
        return velocity
    moved = move_grid(scene, pushed(scene, state, nodal, maps), state.step * dt, dt)
    return moved_along(scene.walls, scene.grid, velocity, moved.velocity)


def nodal_velocity(scene: Scene, nodal: Nodal) -> Array:
    """Velocity (nodes, d) of the nodes, walls held."""
    return hold(scene, nodal.per_mass * nodal.momentum)


def reciprocal(scene: Scene, mass: Array) -> Array:
    """1 / mass where a node has mass, else 0."""
    carries = mass > MASS_FLOOR * jnp.mean(scene.particles.mass)
    return jnp.where(carries, 1 / jnp.where(carries, mass, 1), 0)


def acting_stress(scene: Scene, stress: Array, volume: Array, maps: Maps) -> Array:
    """The components of the stress (s, N) that act on the grid (J), times the current volume (N,).

    With F-bar its mean is averaged as well, by the transpose of the strain's average: forces then do the work that the
    averaged strain stores. Without this the energy grows in a long run. Where particles carry a pore pressure the total
    stress acts.
    """
    d = scene.grid.dimension
    if scene.pore_pressure is not None:
        effective = tensors.expand(stress, d)
        stress = tensors.compress(tensors.with_mean(effective, tensors.mean(effective) - scene.pore_pressure), d)
    if scene.fbar:
        specific, full = volume / scene.particles.mass, tensors.expand(stress, d)
        full = tensors.with_mean(full, maps.average(tensors.mean(full) * specific, 0) / specific)
        stress = tensors.compress(full, d)
    acting = tensors.acting(stress, d)
    return tensors.spread(volume[None], len(acting), axis=0) * acting


def update_stress(scene: Scene, state: State, gradient: Array, dt: Array, maps: Maps) -> State:
    """Stress, history, gap and volume after a step in the velocity gradient (d, d, N)."""
    d = scene.grid.dimension
    strained = (strained_by_logarithms if scene.finite_strain else strained_by_rates)(
        scene, state, tensors.entries(gradient), dt, maps
    )
    given = strained.strain, strained.stress, state.history, dt
    stress, history, gap = update_with_gap(scene.material, *given, gap=state.gap, logarithmic=scene.finite_strain)
    if scene.nonlocal_passes is not None:
        smooth = partial(maps.average, passes=scene.nonlocal_passes)
        history = jax.tree.map(lambda new, old: old + smooth(new - old), history, state.history)
    if scene.finite_strain:
        # Unless it is written first, XLA on CPU divides all components in the one loop that computes them.
        components = tensors.compress(tensors.row_by_row(stress), d) / strained.volume_ratio
    else:
        components = tensors.compress(stress, d)
    return replace(state, stress=components, history=history, gap=gap, volume_ratio=strained.volume_ratio)


class Strained(NamedTuple):
    """What a law is given: the strain increment, and the stress (Pa) that it adds to; and the new volume ratio (N,)."""

    strain: Tensor
    stress: Tensor
    volume_ratio: Array


def strained_by_rates(scene: Scene, state: State, entries: Any, dt: Array, maps: Maps) -> Strained:
    """Hypoelastic: the stress rotated by the Jaumann rate, the strain that of the velocity gradient's entries."""
    rotated = tensors.rotate(tensors.expand(state.stress, scene.grid.dimension), entries, dt)
    strain = maps.unlocked(tensors.strain_increment(entries, dt), scene.particles.volume * state.volume_ratio)
    return Strained(strain, rotated, state.volume_ratio * (1 + 3 * tensors.mean(strain)))


def strained_by_logarithms(scene: Scene, state: State, entries: Any, dt: Array, maps: Maps) -> Strained:
    """Hyperelastic: the Kirchhoff stress less that of the strain increment, so that both add up to the trial stress of
    Hencky's strain. The volume's change is exact, averaged as the scene asks."""
    law = scene.material
    kirchhoff = tensors.expand(state.volume_ratio * state.stress, scene.grid.dimension)
    elastic = elastic_strain(law.bulk, law.shear, kirchhoff)
    strain = tensors.with_mean(tensors.strain_increment(entries, dt), volumetric(entries, dt) / 3)
    strain = maps.unlocked(strain, scene.particles.volume * state.volume_ratio)
    grown = tensors.mean(strain)
    trial = tensors.with_mean(logarithmic(elastic, entries, dt), tensors.mean(elastic) + grown)
    before = tensors.by_component(operator.sub, trial, strain)
    stress = elastic_increment(law.bulk, law.shear, before)
    return Strained(strain, stress, state.volume_ratio * jnp.exp(3 * grown))
