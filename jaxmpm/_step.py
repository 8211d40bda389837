"""One step of the material point method, State -> State.

A step consists of five operations: particles map to the nodes, the nodes move, they move the particles, velocities are
mapped again, and the velocity gradient strains the soil. The schemes differ only in the order of these.
"""

from __future__ import annotations

import operator
from dataclasses import replace
from functools import partial
from typing import Protocol

import jax
import jax.numpy as jnp
from jax import Array

from jaxmpm.boundary import along_walls
from jaxmpm.equations import (
    GridMotion,
    Maps,
    Nodal,
    beyond_ends,
    free_field,
    grid_position,
    move_grid,
    nodal_velocity,
    particles_to_grid,
    pushed,
    update_stress,
)
from jaxmpm.laws import of_skeleton, with_skeleton
from jaxmpm.transfer import fits, inside, locate, momentum, near_soil, velocity_gradient
from jaxmpm.types import Scene, Scheme, State, Status


def step(scene: Scene, state: State, dt: Array) -> State:
    """Advance by one time step: the motion, the count of steps that gives the time, and the status.

    It is pure and differentiable, and works under `jax.vmap`. The status of a lane that breaks off has the reason, and
    keeps it; its other fields then have no meaning. A step longer than an elastic wave takes through a cell is such a
    reason. `advance` stops a lane there, and checks the numbers of the scene beforehand. Only `advance` updates the
    columns that a state records.

    Sources: Sulsky, Chen and Schreyer (1994), doi:10.1016/0045-7825(94)90112-0 (method); Bardenhagen (2002),
    doi:10.1006/jcph.2002.7103 (USF, USL); Sulsky, Zhou and Schreyer (1995), doi:10.1016/0010-4655(94)00170-7 (MUSL).

    Args:
        scene: to run.
        state: before the step.
        dt: time step (s).

    Returns:
        State after the step.
    """
    after = stepped(scene, state, dt)
    wave2 = jnp.max(scene.material.p_wave_modulus * (scene.particles.volume / scene.particles.mass))
    unstable = (after.status == Status.RUNNING) & ~(dt**2 * wave2 <= scene.grid.cell**2)
    return replace(after, status=jnp.where(unstable, int(Status.TIME_STEP_TOO_LARGE), after.status))


def stepped(scene: Scene, state: State, dt: Array) -> State:
    """The state after a step of dt (s), whose length is taken as right."""
    scene = near_soil(scene, grid_position(scene, state))
    after = moved(scene, state, dt)
    if scene.free_field is not None:
        low, high = (moved(column, column_state, dt) for column, column_state in beyond_ends(scene, state))
        after = replace(after, free_field=(low, high))
    status = lane_status(scene, jax.lax.stop_gradient(after), dt)
    after = replace(after, step=state.step + 1, status=jnp.where(state.status > Status.DECIDED, state.status, status))
    if scene.grid.near is None:
        return after
    full = jnp.where(state.status > Status.DECIDED, state.status, int(Status.GRID_FULL)).astype(after.status.dtype)
    return jax.tree.map(partial(jnp.where, fits(scene.grid)), after, replace(state, status=full))


def moved(scene: Scene, state: State, dt: Array) -> State:
    """The state with the motion of a step of dt (s)."""
    return SCHEMES[scene.numerics.scheme](scene, state, dt, Maps(scene, grid_position(scene, state)))


def lane_status(scene: Scene, state: State, dt: Array) -> Array:
    """Status of a running lane after a step: RUNNING, or the reason to end.

    It compares extremes over the particles, which propagate NaN: every comparison with NaN is false.

    Args:
        scene: of the lane.
        state: after the step.
        dt: time step (s).

    Returns:
        () int32.
    """
    cells = locate(scene.grid, grid_position(scene, state))
    ends = jnp.stack([jnp.min(cells, axis=1), jnp.max(cells, axis=1)], axis=1)
    speed2 = jnp.max(jnp.sum(state.velocity**2, axis=0))
    finite = jnp.isfinite(speed2) & jnp.all(jnp.isfinite(ends))
    slow = speed2 * dt**2 < scene.grid.cell**2
    status = jnp.where(slow, Status.RUNNING, Status.TIME_STEP_TOO_LARGE)
    status = jnp.where(jnp.min(state.volume_ratio) > 0, status, Status.INVERTED)
    status = jnp.where(jnp.all(inside(scene.grid, ends)), status, Status.OUTSIDE_GRID)
    return jnp.where(finite, status, Status.NOT_FINITE).astype(jnp.int32)


def update_stress_first(scene: Scene, state: State, dt: Array, maps: Maps) -> State:
    """USF: strain the soil by the velocities that particles map to the grid, before the grid moves."""
    nodal = on_grid(scene, state, dt, maps, stressed=False)
    gradient = maps.gradient(straining_velocity(scene, state, nodal, dt, maps))
    state = update_stress(scene, state, gradient, dt, maps)
    motion = move_grid(scene, pushed(scene, state, nodal, maps), state.step * dt, dt)
    state, _ = grid_to_particles(scene, state, nodal, motion, dt, maps)
    return state


def update_stress_last(scene: Scene, state: State, dt: Array, maps: Maps) -> State:
    """USL: strain the soil by the velocities of the grid at the end of the step."""
    nodal = on_grid(scene, state, dt, maps)
    motion = move_grid(scene, nodal, state.step * dt, dt)
    state, gradient = grid_to_particles(scene, state, nodal, motion, dt, maps, strain=True)
    return update_stress(scene, state, gradient, dt, maps)


def modified_update_stress_last(scene: Scene, state: State, dt: Array, maps: Maps) -> State:
    """MUSL: map the particles' new velocities to the grid, and strain the soil by these."""
    nodal = on_grid(scene, state, dt, maps)
    motion = move_grid(scene, nodal, state.step * dt, dt)
    state, _ = grid_to_particles(scene, state, nodal, motion, dt, maps)
    gradient = maps.gradient(mapped_again(scene, state, nodal, motion, maps))
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


def on_grid(scene: Scene, state: State, dt: Array, maps: Maps, *, stressed: bool = True) -> Nodal:
    """`particles_to_grid` with the action of the free field on the ends."""
    nodal = particles_to_grid(scene, state, dt, maps, stressed=stressed)
    return nodal if scene.free_field is None else nodal._replace(beyond=free_field(scene, state, dt))


def grid_to_particles(
    scene: Scene, state: State, nodal: Nodal, motion: GridMotion, dt: Array, maps: Maps, *, strain: bool = False
) -> tuple[State, Array]:
    """Particles after the motion of the grid, and the velocity gradient (d, d, N) 1/s at them if `strain`."""
    d = scene.grid.dimension
    fields = {"velocity": motion.velocity, "acceleration": motion.acceleration}
    if nodal.history_change is not None:
        fields["history"] = nodal.history_change
    values, gradient = maps.values(fields, gradients=d if strain else 0)
    pic_velocity, change = values["velocity"], values["acceleration"]
    flip_velocity = state.velocity + dt * change
    numerics = scene.numerics
    flip = numerics.flip if numerics.pic_damping is None else jnp.exp(-numerics.pic_damping * dt)
    filtered = pic_velocity
    if numerics.xpic > 1:
        filtered = flip_velocity - unresolved(scene, state, nodal, pic_velocity - dt * change, maps)
    state = replace(
        state,
        displacement=state.displacement + dt * pic_velocity,
        velocity=flip_velocity if flip is None else flip * flip_velocity + (1 - flip) * filtered,
    )
    if "history" in values:
        skeleton = of_skeleton(state.history)
        change = jax.tree.unflatten(jax.tree.structure(skeleton), list(values["history"]))
        averaged = jax.tree.map(operator.add, skeleton, change)
        state = replace(state, history=with_skeleton(state.history, averaged))
    if state.affine is not None:
        affine = velocity_gradient(scene.grid, maps.position, maps.unfold(motion.velocity), maps.from_all_nodes)
        state = replace(state, affine=affine)
    return state, gradient


def unresolved(scene: Scene, state: State, nodal: Nodal, resolved: Array, maps: Maps) -> Array:
    """Velocity (d, N) m/s of the particles that `xpic` transfers to the grid and back leave out.

    Source: Hammerquist and Nairn (2017), doi:10.1016/j.cma.2017.01.035.

    Args:
        scene: to run.
        state: before the motion of the grid.
        nodal: values at the nodes, before their motion.
        resolved: velocity (d, N) m/s that the nodes then give back.
        maps: transfers.
    """
    rest = state.velocity - resolved
    for _ in range(scene.numerics.xpic - 1):
        moving = maps.momentum(maps.to_all_nodes(scene.particles.mass * rest, None))
        seen, _ = maps.to_particles(nodal_velocity(nodal._replace(momentum=moving)), values=len(rest), gradients=0)
        rest = rest - seen
    return rest


def mapped_again(scene: Scene, state: State, nodal: Nodal, motion: GridMotion, maps: Maps) -> Array:
    """Velocity (nodes, d) m/s from the particles' new momentum and the nodal masses before."""
    moving = maps.momentum(maps.to_all_nodes(momentum(scene, state, maps.position), None))
    velocity = nodal_velocity(nodal._replace(momentum=moving))
    if scene.boundary.friction is None:
        return velocity
    return along_walls(scene, velocity, motion.velocity)


def straining_velocity(scene: Scene, state: State, nodal: Nodal, dt: Array, maps: Maps) -> Array:
    """Velocity (nodes, d) m/s by which USF strains the soil.

    It is that of the nodes; at walls with friction it is that to which the current stress would move them.
    """
    velocity = nodal_velocity(nodal)
    if scene.boundary.friction is None:
        return velocity
    motion = move_grid(scene, pushed(scene, state, nodal, maps), state.step * dt, dt)
    return along_walls(scene, velocity, motion.velocity)
