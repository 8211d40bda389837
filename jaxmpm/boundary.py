"""Boundary conditions at the nodes: walls, friction of walls and of a base as impulses, and open ends."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmpm.grid import Grid, Wall
from jaxmpm.tensors import dot, safe_sqrt
from jaxmpm.transfer import along
from jaxmpm.types import Scene

Region = tuple[slice, ...] | Array
"""Of the nodes, as an index of an array of the grid's shape; where those near soil alone are stored, (rows,) bool."""


def one_with(scene: Scene) -> list[tuple[int, int]]:
    """Pairs of planes of nodes along x that are identified: one beyond an end of the ground, and its image.

    With tied sides the second plane lies between the ends, where the grid continues round; with a free field it is the
    end itself.

    Args:
        scene: with tied sides, a free field or neither.

    Returns:
        Pairs of node numbers along x.
    """
    if scene.free_field is not None:
        low, high = scene.free_field.planes
        return [(low - 1, low), (high + 1, high)]
    if scene.boundary.tied is None:
        return []
    low, high = scene.boundary.tied
    return [(node, low + (node - low) % (high - low)) for node in (low - 1, high, high + 1)]


def fold(pairs: Sequence[tuple[int, int]], grid: Grid, nodal: Array) -> Array:
    """Add sums at the first plane of each pair to the second; the first becomes 0.

    Args:
        pairs: from `one_with`.
        grid: of the nodes.
        nodal: (nodes, c) sums.

    Returns:
        (nodes, c).
    """
    if not pairs:
        return nodal
    field = nodal.reshape(*grid.shape, -1)
    for node, same in pairs:
        field = field.at[same].add(field[node]).at[node].set(0)
    return field.reshape(nodal.shape)


def unfold(pairs: Sequence[tuple[int, int]], grid: Grid, nodal: Array) -> Array:
    """Copy nodal values from the second plane of each pair to the first.

    Args:
        pairs: from `one_with`.
        grid: of the nodes.
        nodal: (nodes, c).

    Returns:
        (nodes, c).
    """
    if not pairs:
        return nodal
    field = nodal.reshape(*grid.shape, -1)
    for node, same in pairs:
        field = field.at[node].set(field[same])
    return field.reshape(nodal.shape)


def around(tied: tuple[int, int], grid: Grid, position: Array) -> Array:
    """Wrap positions beyond a tied plane to the other.

    Args:
        tied: numbers of the two planes of nodes along x.
        grid: of the nodes.
        position: (d, N) m.

    Returns:
        (d, N) m.
    """
    low, high = (grid.origin[0] + node * grid.cell for node in tied)
    return position.at[0].set(low + jnp.mod(position[0] - low, high - low))


def hold(scene: Scene, nodal: Array, value: float = 0.0) -> Array:
    """Set components of nodal vectors that walls constrain, and all beyond a cut.

    Args:
        scene: with its walls and cut.
        nodal: velocities, or another quantity by component (nodes, d).
        value: to set.

    Returns:
        (nodes, d).
    """
    walls, cut, grid = scene.boundary.walls, scene.boundary.cut, scene.grid
    if cut is not None:
        nodal = jnp.where(cut[:, None], value, nodal)
    if all(wall.hold == "friction" for wall in walls):
        return nodal
    shape = (*(grid.shape if grid.near is None else (grid.rows,)), grid.dimension)
    fixed = jnp.zeros(shape, bool)
    for wall in walls:
        if wall.hold == "friction":
            continue
        beyond = _beyond(wall, grid, shape)
        if wall.hold == "roller":
            beyond &= jax.lax.broadcasted_iota(jnp.int32, shape, len(shape) - 1) == wall.axis
        fixed |= beyond
    # One selection, of a mask that XLA makes once: a selection per wall would be made in every step.
    return jnp.where(fixed.reshape(nodal.shape), value, nodal)


def slide(scene: Scene, velocity: Array, braked: Callable[[Region | None, Array], Array]) -> Array:
    """Velocities after the impulses of walls with friction, and of the base.

    They remove the velocity into them, and of the velocity along them at most what `braked` returns. They do not
    restrain soil that leaves.

    Source: Coulomb's law for impulses, as in Bardenhagen et al. (2000), doi:10.1016/S0045-7825(99)00338-2, Section 3.

    Args:
        scene: with walls with friction or a base.
        velocity: (nodes, d) m/s.
        braked: function of a region of the nodes, None for all as (nodes,), and of the velocities m/s into walls there;
            it gives the largest change along them m/s.

    Returns:
        (nodes, d) m/s.
    """
    shape = (*scene.grid.shape, scene.grid.dimension)
    for region, normal in _walls(scene):
        if not isinstance(region, tuple):
            velocity = _slid(velocity, jnp.where(region[:, None], normal, 0), partial(braked, region))
            continue
        field = velocity.reshape(shape)
        slid = _slid(field[region], normal, partial(braked, region))
        velocity = field.at[region].set(slid).reshape(velocity.shape)
    base = scene.boundary.base
    return velocity if base is None else hold(scene, _slid(velocity, base.normal, partial(braked, None)))


def _slid(velocity: Array, normal: Array, braked: Callable[[Array], Array]) -> Array:
    """Velocities (..., d) after the impulses of walls with these normals, (d,) or (..., d) and 0 where no wall is."""
    outward = dot(velocity, normal)
    push = jnp.maximum(-outward, 0)
    tangential = velocity - outward[..., None] * normal
    speed = safe_sqrt(dot(tangential, tangential))
    share = jnp.where(speed > 0, jnp.maximum(1 - braked(push) / jnp.where(speed > 0, speed, 1), 0), 1)
    return share[..., None] * tangential + (outward + push)[..., None] * normal


def along_walls(scene: Scene, velocity: Array, after: Array) -> Array:
    """Velocities that strain the soil: on and beyond walls with friction those after the motion of the grid.

    Particles return to such a node only part of the velocity that the wall took from it. Strains from that part would
    let soil come off a wall that holds it, and create energy: a block would shake off a plane that it should stick to.

    Args:
        scene: of the nodes.
        velocity: (nodes, d) m/s, mapped from the particles.
        after: (nodes, d) m/s, after the grid's motion.

    Returns:
        (nodes, d) m/s.
    """
    for region, _ in _walls(scene):
        if not isinstance(region, tuple):
            velocity = jnp.where(region[:, None], after, velocity)
            continue
        field = after.reshape(*scene.grid.shape, -1)
        velocity = velocity.reshape(field.shape).at[region].set(field[region]).reshape(after.shape)
    base = scene.boundary.base
    return velocity if base is None else jnp.where(jnp.any(base.normal != 0, axis=1)[:, None], after, velocity)


def on_contact(scene: Scene) -> np.ndarray:
    """Nodes at which soil slides with friction: those on such walls or beyond them, and those of the base.

    Args:
        scene: of the nodes.

    Returns:
        (nodes,) bool.
    """
    field = np.zeros(scene.grid.shape, bool)
    for region, _ in _walls(scene):
        field[region] = True
    if scene.boundary.base is not None:
        field |= np.asarray(scene.boundary.base.normal).any(axis=1).reshape(scene.grid.shape)
    return field.ravel()


def _walls(scene: Scene) -> Iterator[tuple[Region, Array]]:
    """Nodes on walls with friction or beyond them, and unit normals (d,) there."""
    axes = jnp.eye(scene.grid.dimension, dtype=scene.loads.gravity.dtype)
    for wall in scene.boundary.walls:
        if wall.hold == "friction":
            low = wall.side == "low"
            nodes = slice(wall.index + 1) if low else slice(wall.index, None)
            region: Region = (slice(None),) * wall.axis + (nodes,)
            if scene.grid.near is not None:
                region = _beyond(wall, scene.grid, (scene.grid.rows,))
            yield region, axes[wall.axis] if low else -axes[wall.axis]


def _beyond(wall: Wall, grid: Grid, shape: tuple[int, ...]) -> Array:
    """Nodes on a wall or beyond it, in an array of this shape, of a grid's nodes or its rows."""
    if grid.near is None:
        number = jax.lax.broadcasted_iota(jnp.int32, shape, wall.axis)
    else:
        number = jnp.broadcast_to(along(grid, wall.axis).reshape(-1, *[1] * (len(shape) - 1)), shape)
    return number <= wall.index if wall.side == "low" else number >= wall.index
