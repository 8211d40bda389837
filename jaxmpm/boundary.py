"""Nodal walls: what they hold is zero on and beyond their plane; those with friction act by impulses; open ends."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
from jax import Array

from jaxmpm.tensors import safe_sqrt
from jaxmpm.types import Grid, Scene, Wall


def one_with(scene: Scene) -> list[tuple[int, int]]:
    """Pairs of planes of nodes along x: one that particles reach on or beyond an end of the ground, and the one that it
    is one with: of tied sides that between them at which the grid goes on round, of a free field the end itself."""
    if scene.free_field is not None:
        low, high = scene.free_field.planes
        return [(low - 1, low), (high + 1, high)]
    if scene.tied is None:
        return []
    low, high = scene.tied
    return [(node, low + (node - low) % (high - low)) for node in (low - 1, high, high + 1)]


def fold(pairs: Sequence[tuple[int, int]], grid: Grid, nodal: Array) -> Array:
    """Sums (nodes, c) of what particles gave, those of the first of each pair of planes added to the second's; the
    first has 0 itself."""
    if not pairs:
        return nodal
    field = nodal.reshape(*grid.shape, -1)
    for node, same in pairs:
        field = field.at[same].add(field[node]).at[node].set(0)
    return field.reshape(nodal.shape)


def unfold(pairs: Sequence[tuple[int, int]], grid: Grid, nodal: Array) -> Array:
    """Nodal values (nodes, c), those of the first of each pair of planes being the second's."""
    if not pairs:
        return nodal
    field = nodal.reshape(*grid.shape, -1)
    for node, same in pairs:
        field = field.at[node].set(field[same])
    return field.reshape(nodal.shape)


def around(tied: tuple[int, int], grid: Grid, position: Array) -> Array:
    """Positions (d, N) m, those beyond a tied plane brought back in at the other."""
    low, high = (grid.origin[0] + node * grid.cell for node in tied)
    return position.at[0].set(low + jnp.mod(position[0] - low, high - low))


def hold(scene: Scene, nodal: Array) -> Array:
    """Velocities or accelerations (nodes, d) with the components set to 0 that walls hold, and all beyond a cut."""
    walls, grid = scene.walls, scene.grid
    if scene.cut is not None:
        nodal = jnp.where(scene.cut[:, None], 0, nodal)
    if all(wall.hold == "friction" for wall in walls):
        return nodal
    shape = (*grid.shape, grid.dimension)
    field = nodal.reshape(shape)
    for wall in walls:
        if wall.hold == "friction":
            continue
        held = _beyond(wall, shape)
        if wall.hold == "roller":
            held &= jax.lax.broadcasted_iota(jnp.int32, shape, grid.dimension) == wall.axis
        field = jnp.where(held, 0, field)
    return field.reshape(nodal.shape)


def slide(walls: Sequence[Wall], grid: Grid, velocity: Array, braked: Callable[[Array], Array]) -> Array:
    """Velocities (nodes, d) after the impulses of the walls with friction.

    A wall takes away the velocity into it, and of the velocity along it at most what `braked` gives for that, (nodes,)
    m/s; it does not hold back what leaves. Source: Coulomb's law for impulses, as in Bardenhagen et al. (2000),
    10.1016/S0045-7825(99)00338-2, section 3.
    """
    shape = (*grid.shape, grid.dimension)
    field = velocity.reshape(shape)
    for wall in _with_friction(walls):
        inward = 1 if wall.side == "low" else -1
        push = jnp.where(_beyond(wall, grid.shape), jnp.maximum(-inward * field[..., wall.axis], 0), 0)
        normal = jax.lax.broadcasted_iota(jnp.int32, shape, grid.dimension) == wall.axis
        tangential = jnp.where(normal, 0, field)
        speed = safe_sqrt(jnp.sum(tangential**2, axis=-1))
        taken = braked(push.ravel()).reshape(push.shape)
        left = jnp.where(speed > 0, jnp.maximum(1 - taken / jnp.where(speed > 0, speed, 1), 0), 1)
        field = jnp.where(normal, field + inward * push[..., None], left[..., None] * tangential)
    return field.reshape(velocity.shape)


def moved_along(walls: Sequence[Wall], grid: Grid, velocity: Array, moved: Array) -> Array:
    """Velocities (nodes, d) in which soil is strained: on and beyond walls with friction those in which it moved.

    Particles bring back to such a node only a part of what the wall took from it. Strains in what they bring would let
    the soil go from a wall that holds it: they make energy, which shakes a block off a plane that it would stick to.
    """
    for wall in _with_friction(walls):
        velocity = jnp.where(_beyond(wall, grid.shape).reshape(-1, 1), moved, velocity)
    return velocity


def _with_friction(walls: Sequence[Wall]) -> list[Wall]:
    return [wall for wall in walls if wall.hold == "friction"]


def _beyond(wall: Wall, shape: tuple[int, ...]) -> Array:
    """Where in an array of this shape nodes stand on the wall or beyond it: index arithmetic, not a stored mask, which
    is fused into the nodal update and costs no memory."""
    along = jax.lax.broadcasted_iota(jnp.int32, shape, wall.axis)
    return along <= wall.index if wall.side == "low" else along >= wall.index
