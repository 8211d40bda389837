"""One step of the material point method, State -> State.

A step consists of five operations: particles map to the nodes, the nodes move, they move the particles, velocities are
mapped again, and the velocity gradient strains the soil. The schemes differ only in the order of these.
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
from jaxmpm.laws import elastic_increment, elastic_strain, frictional, logarithmic, update_with_gap, volumetric
from jaxmpm.transfer import filtered, g2p, momentum, nodal_momentum, p2g, velocity_gradient, within_cells
from jaxmpm.types import Scene, Scheme, State, Tensor

# Nodes with less than this share of the mean particle mass get no velocity. Their momentum is lost, so the share is far
# below rounding; a node's velocity, a ratio of sums with the same weights, is accurate down to it.
MASS_FLOOR = 1e-12


def step(scene: Scene, state: State, dt: Array) -> State:
    """Advance by one time step.

    It is pure, differentiable and vmappable. Only the fields of motion change, not `step` and `status`.

    Sources: Sulsky, Chen and Schreyer (1994), doi:10.1016/0045-7825(94)90112-0 (method); Bardenhagen (2002),
    doi:10.1006/jcph.2002.7103 (USF, USL); Sulsky, Zhou and Schreyer (1995), doi:10.1016/0010-4655(94)00170-7 (MUSL).

    Args:
        scene: to run.
        state: before the step.
        dt: time step (s).

    Returns:
        State after the step.
    """
    moved = SCHEMES[scene.scheme](scene, state, dt, Maps(scene, grid_position(scene, state)))
    if scene.free_field is None:
        return moved
    low, high = (step(column, own, dt) for column, own in beyond_ends(scene, state))
    return replace(moved, free_field=(low, high))


def grid_position(scene: Scene, state: State) -> Array:
    """Positions of particles on the grid (d, N) m; tied sides wrap them round."""
    position = scene.particles.position + state.displacement
    return position if scene.tied is None else around(scene.tied, scene.grid, position)


def update_stress_first(scene: Scene, state: State, dt: Array, maps: Maps) -> State:
    """USF: strain the soil by the velocities that particles map to the grid, before the grid moves."""
    nodal = particles_to_grid(scene, state, dt, maps, stressed=False)
    gradient = maps.gradient(straining_velocity(scene, state, nodal, dt, maps))
    state = update_stress(scene, state, gradient, dt, maps)
    moved = move_grid(scene, pushed(scene, state, nodal, maps), state.step * dt, dt)
    state, _ = grid_to_particles(scene, state, moved, dt, maps)
    return state


def update_stress_last(scene: Scene, state: State, dt: Array, maps: Maps) -> State:
    """USL: strain the soil by the velocities of the grid at the end of the step."""
    nodal = particles_to_grid(scene, state, dt, maps)
    moved = move_grid(scene, nodal, state.step * dt, dt)
    state, gradient = grid_to_particles(scene, state, moved, dt, maps, strain=True)
    return update_stress(scene, state, gradient, dt, maps)


def modified_update_stress_last(scene: Scene, state: State, dt: Array, maps: Maps) -> State:
    """MUSL: map the particles' new velocities to the grid, and strain the soil by these."""
    nodal = particles_to_grid(scene, state, dt, maps)
    moved = move_grid(scene, nodal, state.step * dt, dt)
    state, _ = grid_to_particles(scene, state, moved, dt, maps)
    gradient = maps.gradient(mapped_again(scene, state, nodal, moved, maps))
    return update_stress(scene, state, gradient, dt, maps)


class Move(Protocol):
    """A scheme."""

    def __call__(self, scene: Scene, state: State, dt: Array, maps: Maps) -> State:
        """State after a step of dt (s)."""


SCHEMES: dict[Scheme, Move] = {
    Scheme.USF: update_stress_first,
    Scheme.USL: update_stress_last,
    Scheme.MUSL: modified_update_stress_last,
}


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
        per_mass: (nodes, d) 1 / mass (1/kg), 0 at nodes without mass.
        area: (nodes,) area of soil on a wall (m2), at nodes that lie on one; None if no wall needs it.
        beyond: action of the free field; None without.
    """

    mass: Array
    momentum: Array
    force: Array | None
    per_mass: Array
    area: Array | None = None
    beyond: Beyond | None = None


class Moved(NamedTuple):
    """The grid after its motion.

    Args:
        velocity: (nodes, d) m/s.
        acceleration: (nodes, d) m/s2.
    """

    velocity: Array
    acceleration: Array


class Maps(NamedTuple):
    """The transfers between a scene's grid and its particles at given positions.

    At open ends of the ground particles reach nodes beyond the last plane. `fold` adds sums there to the nodes that
    they are identified with, `unfold` copies values back.

    Args:
        scene: whose grid, kernel and engine are used.
        position: (d, N) m of the particles on the grid.
    """

    scene: Scene
    position: Array

    def to_grid(self, carried: Array | None, stress: Array | None) -> Array:
        """Map particles to nodes: see `jaxmpm.transfer.p2g`."""
        return self.fold(self.to_all_nodes(carried, stress))

    def to_particles(self, nodal: Array, *, values: int, gradients: int) -> tuple[Any, Any]:
        """Interpolate nodal values at particles: see `jaxmpm.transfer.g2p`."""
        return self.from_all_nodes(self.unfold(nodal), values=values, gradients=gradients)

    def to_all_nodes(self, carried: Array | None, stress: Array | None) -> Array:
        """As `to_grid`, at all nodes that particles reach, those beyond open ends of the ground included."""
        scene = self.scene
        return p2g(scene.grid, scene.kernel, self.position, carried, stress, engine=scene.engine)

    def from_all_nodes(self, nodal: Array, *, values: int, gradients: int) -> tuple[Any, Any]:
        """As `to_particles`, from all nodes that particles reach."""
        scene = self.scene
        return g2p(
            scene.grid, scene.kernel, self.position, nodal, values=values, gradients=gradients, engine=scene.engine
        )

    def fold(self, reached: Array) -> Array:
        """Sums (nodes, c) with those beyond open ends added to the nodes that they are identified with."""
        return fold(one_with(self.scene), self.scene.grid, reached)

    def unfold(self, nodal: Array) -> Array:
        """Nodal values (nodes, c), copied to the nodes beyond open ends."""
        return unfold(one_with(self.scene), self.scene.grid, nodal)

    def momentum(self, moving: Array) -> Array:
        """Momentum (nodes, d) kg m/s from the channels of `jaxmpm.transfer.momentum` at all nodes that particles reach.

        An affine part refers to the positions of these nodes, so it is evaluated before those beyond open ends are
        added.
        """
        return self.fold(nodal_momentum(self.scene.grid, moving))

    def gradient(self, velocity: Array) -> Array:
        """Gradient (d, d, N) 1/s at the particles of velocities (nodes, d) m/s."""
        return self.to_particles(velocity, values=0, gradients=self.scene.grid.dimension)[1]

    def average(self, values: Array, passes: int) -> Array:
        """Average (N,) of `values` (N,) over the particles nearby, weighted by mass, through `passes` filters."""
        m = self.scene.particles.mass
        nodal = filtered(self.scene.grid, self.to_grid(jnp.stack([m, m * values]), None), passes)
        averaged, _ = self.to_particles(reciprocal(self.scene, nodal[:, :1]) * nodal[:, 1:], values=1, gradients=0)
        return averaged[0]

    def cell_average(self, values: Array, volume: Array) -> Array:
        """Average (N,) of `values` (N,) over each cell by `volume` (N,) m3; soil with friction and other soil apart."""
        kind = frictional(self.scene.material)
        return within_cells(self.scene.grid, self.position, values, volume, None if isinstance(kind, bool) else kind)

    def unlocked(self, strain: Tensor, volume: Array) -> Tensor:
        """The strain with its mean averaged as the scene requires; `volume` (N,) m3 is that of the particles."""
        scene = self.scene
        if scene.fbar:
            return tensors.with_mean(strain, self.average(tensors.mean(strain), 0))
        if scene.cell_average:
            return tensors.with_mean(strain, self.cell_average(tensors.mean(strain), volume))
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
        # Soil that fills the cells on a wall contributes half of their volume to its nodes.
        carried.insert(0, 2 / grid.cell * volume[None])
    nodal = maps.to_all_nodes(
        jnp.concatenate(carried), acting_stress(scene, state.stress, volume, maps) if stressed else None
    )
    ends = np.cumsum([len(block) for block in carried][: None if stressed else -1])
    blocks = jnp.split(nodal, ends, axis=1)
    if bonded(scene):
        area = maps.fold(blocks.pop(0))[:, 0]
    mass, moving, *forces = blocks
    mass = tensors.spread(maps.fold(mass), grid.dimension, axis=1)
    return Nodal(
        mass=mass,
        momentum=maps.momentum(moving),
        force=maps.fold(sum(forces[1:], forces[0])) if forces else None,
        per_mass=reciprocal(scene, mass),
        area=area,
        beyond=None if scene.free_field is None else free_field(scene, state, dt),
    )


SHARED = (
    *("gravity", "motion", "body_force", "damping", "flip", "scheme", "engine"),
    *("fbar", "cell_average", "finite_strain"),
)
"""Fields of the scene that the columns of its free field share."""


def beyond_ends(scene: Scene, state: State) -> list[tuple[Scene, State]]:
    """Columns of the free field with their states, at the scene's time and under its motion."""
    assert scene.free_field is not None
    assert state.free_field is not None
    shared: dict[str, Any] = {name: getattr(scene, name) for name in SHARED}
    columns = (replace(column, **shared) for column in (scene.free_field.low, scene.free_field.high))
    return [(column, replace(own, step=state.step)) for column, own in zip(columns, state.free_field, strict=True)]


def free_field(scene: Scene, state: State, dt: Array) -> Beyond:
    """Action of the free field on the ends in a step of dt (s); see `FreeField`."""
    assert scene.free_field is not None
    sides = [beside(*one, dt, scene.grid.shape[-1]) for one in beyond_ends(scene, state)]
    velocity, (low, high), impedance = (jnp.stack(each) for each in zip(*sides, strict=True))
    return Beyond(velocity, scene.free_field.held + jnp.stack([-low, high]), impedance)


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
    moved = move_grid(column, particles_to_grid(column, state, dt, maps), state.step * dt, dt)
    stress = acting_stress(column, state.stress, column.particles.volume * state.volume_ratio, maps)
    density = mass / column.particles.volume
    waves = [mass * jnp.sqrt(modulus / density) for modulus in (column.material.p_wave_modulus, column.material.shear)]
    sums = maps.to_grid(jnp.stack([stress[0], stress[-1], *waves]) / column.grid.cell, None)
    assert column.tied is not None
    plane = jnp.concatenate([moved.velocity, sums], axis=1).reshape(*column.grid.shape, -1)[column.tied[0]]
    return jnp.split(jnp.pad(plane, ((0, height - len(plane)), (0, 0))), 3, axis=1)


def external_force(scene: Scene, position: Array, volume: Array, time: Array) -> Array | None:
    """Force (d, N) N besides gravity on particles at `position` (d, N) m of volume (N,) m3; None if there is none."""
    particles, force = scene.particles, None
    if scene.body_force is not None:
        force = particles.mass * scene.body_force(particles.position, time)
    if scene.water is not None:
        push = volume * scene.water.push(position)
        force = push if force is None else force + push
    return force


def felt_gravity(scene: Scene, time: Array) -> Array:
    """Gravity (d,) m/s2 minus the acceleration of the base, in whose frame the soil moves."""
    return scene.gravity if scene.motion is None else scene.gravity - scene.motion.at(time)


def pushed(scene: Scene, state: State, nodal: Nodal, maps: Maps) -> Nodal:
    """The nodes with the force of the particles' stress added."""
    stress = maps.to_grid(None, acting_stress(scene, state.stress, scene.particles.volume * state.volume_ratio, maps))
    return nodal._replace(force=stress if nodal.force is None else nodal.force + stress)


def move_grid(scene: Scene, nodal: Nodal, time: Array, dt: Array) -> Moved:
    """Motion of the nodes by forces, gravity and damping, with walls applied."""
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
    """Whether walls with friction need the area of soil on them."""
    return scene.wall_cohesion is not None or scene.wall_pressure is not None


def braked(scene: Scene, nodal: Nodal, dt: Array) -> Callable[[Array], Array]:
    """Largest change of velocity along walls with friction, as a function of the velocity into them.

    It is Coulomb friction of the contact pressure minus the water's, and cohesion.

    Args:
        scene: with wall_friction.
        nodal: values at the nodes.
        dt: time step (s).

    Returns:
        Function of the velocities (nodes,) m/s into walls that they stop in dt; it gives the largest change of those
        along them (nodes,) m/s.
    """
    friction = scene.wall_friction
    assert friction is not None
    if nodal.area is None:
        return lambda push: friction * push
    rate = dt * nodal.area * nodal.per_mass[:, 0]
    water = 0.0 if scene.wall_pressure is None else rate * scene.wall_pressure
    cohesion = 0.0 if scene.wall_cohesion is None else rate * scene.wall_cohesion
    return lambda push: jnp.where(push > 0, friction * jnp.maximum(push - water, 0) + cohesion, 0)


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
    per_mass, before, field = (each.reshape(shape) for each in (nodal.per_mass, before, acceleration))
    for plane, velocity, traction, impedance in zip(scene.free_field.planes, *nodal.beyond, strict=True):
        rate = per_mass[plane] * impedance
        pull = per_mass[plane] * traction + rate * (velocity - before[plane])
        field = field.at[plane].set((field[plane] + pull) / (1 + dt * rate))
    return field.reshape(acceleration.shape)


def grid_to_particles(
    scene: Scene, state: State, moved: Moved, dt: Array, maps: Maps, *, strain: bool = False
) -> tuple[State, Any]:
    """Particles moved by the grid, and the velocity gradient (d, d, N) 1/s at them if `strain`."""
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
        affine = velocity_gradient(scene.grid, maps.position, maps.unfold(moved.velocity), maps.from_all_nodes)
        state = replace(state, affine=affine)
    return state, gradient


def mapped_again(scene: Scene, state: State, nodal: Nodal, moved: Moved, maps: Maps) -> Array:
    """Velocity (nodes, d) m/s from the particles' new momentum and the nodal masses before."""
    moving = maps.momentum(maps.to_all_nodes(momentum(scene, state, maps.position), None))
    velocity = nodal_velocity(scene, nodal._replace(momentum=moving))
    if scene.wall_friction is None:
        return velocity
    return moved_along(scene.walls, scene.grid, velocity, moved.velocity)


def straining_velocity(scene: Scene, state: State, nodal: Nodal, dt: Array, maps: Maps) -> Array:
    """Velocity (nodes, d) m/s by which USF strains the soil.

    It is that of the nodes; at walls with friction it is that to which the current stress would move them.
    """
    velocity = nodal_velocity(scene, nodal)
    if scene.wall_friction is None:
        return velocity
    moved = move_grid(scene, pushed(scene, state, nodal, maps), state.step * dt, dt)
    return moved_along(scene.walls, scene.grid, velocity, moved.velocity)


def nodal_velocity(scene: Scene, nodal: Nodal) -> Array:
    """Velocity (nodes, d) m/s of the nodes, with walls applied."""
    return hold(scene, nodal.per_mass * nodal.momentum)


def reciprocal(scene: Scene, mass: Array) -> Array:
    """1 / mass at nodes with mass, else 0."""
    carries = mass > MASS_FLOOR * jnp.mean(scene.particles.mass)
    return jnp.where(carries, 1 / jnp.where(carries, mass, 1), 0)


def acting_stress(scene: Scene, stress: Array, volume: Array, maps: Maps) -> Array:
    """Stress components (s, N) that act on the grid, times the current volume (J).

    The mean stress is averaged by the transpose of the strain's average: forces then do the work that the averaged
    strain stores. Without this the energy grows in a long run, and that of clay that softens without bounds. Frictional
    soil under the cell average keeps its local mean stress: a free surface would lose its strength. If particles have a
    pore pressure, the total stress acts.

    Args:
        scene: of the particles.
        stress: components of the state (s, N) Pa.
        volume: current one (N,) m3.
        maps: transfers at the particles.

    Returns:
        (d (d + 1) / 2, N) J.
    """
    d = scene.grid.dimension
    if scene.pore_pressure is not None:
        effective = tensors.expand(stress, d)
        stress = tensors.compress(tensors.with_mean(effective, tensors.mean(effective) - scene.pore_pressure), d)
    if scene.fbar:
        specific, full = volume / scene.particles.mass, tensors.expand(stress, d)
        full = tensors.with_mean(full, maps.average(tensors.mean(full) * specific, 0) / specific)
        stress = tensors.compress(full, d)
    if scene.cell_average and (local := frictional(scene.material)) is not True:
        full = tensors.expand(stress, d)
        mean = tensors.mean(full)
        full = tensors.with_mean(full, jnp.where(local, mean, maps.cell_average(mean, volume)))
        stress = tensors.compress(full, d)
    acting = tensors.acting(stress, d)
    return tensors.spread(volume[None], len(acting), axis=0) * acting


def update_stress(scene: Scene, state: State, gradient: Array, dt: Array, maps: Maps) -> State:
    """Stress, history, gap and volume after a step with velocity gradient (d, d, N) 1/s."""
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
        # Stored first: otherwise XLA on CPU divides all components in the one loop that computes them.
        components = tensors.compress(tensors.row_by_row(stress), d) / strained.volume_ratio
    else:
        components = tensors.compress(stress, d)
    return replace(state, stress=components, history=history, gap=gap, volume_ratio=strained.volume_ratio)


class Strained(NamedTuple):
    """Arguments of a law in a step, and the new volume.

    Args:
        strain: increment.
        stress: tensor that it is added to (Pa).
        volume_ratio: (N,) current over initial volume.
    """

    strain: Tensor
    stress: Tensor
    volume_ratio: Array


def strained_by_rates(scene: Scene, state: State, entries: Any, dt: Array, maps: Maps) -> Strained:
    """Hypoelasticity: the stress rotated by the Jaumann rate, and the strain of the velocity gradient's entries."""
    rotated = tensors.rotate(tensors.expand(state.stress, scene.grid.dimension), entries, dt)
    strain = maps.unlocked(tensors.strain_increment(entries, dt), scene.particles.volume * state.volume_ratio)
    return Strained(strain, rotated, state.volume_ratio * (1 + 3 * tensors.mean(strain)))


def strained_by_logarithms(scene: Scene, state: State, entries: Any, dt: Array, maps: Maps) -> Strained:
    """Hyperelasticity: the Kirchhoff stress minus that of the strain increment, and the increment.

    Both add up to the trial stress of Hencky's strain. The change of volume is exact, averaged as the scene requires.

    Args:
        scene: of the particles.
        state: before the step.
        entries: of the velocity gradient, row by row (1/s).
        dt: time step (s).
        maps: transfers at the particles.

    Returns:
        Arguments of the law.
    """
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
