"""Soil that lies a share of a cell above rigid ground or other soil, and the traction that it then has on it.

Soil in the cell next to rigid ground is supported by the nodes on that ground, and so may come to rest anywhere in this
cell. Its stress acts on the grid by its volume. Where soil fills a share of the cell, its pressure rises until it bears
the weight, and friction with it. Undrained strength does not depend on pressure: a fixed base would hold such soil by
`1 - gap` of its strength. So the traction along the ground is that of a cell which the soil fills down to the ground.
The forces normal to the ground are left as they are: there energy would not be conserved in an impact.

Between two bodies of soil a gap leaves cells that are partly filled, with fuller ones above and below. The soil in them
would transmit its shear stress by their share alone, so its traction is that of a cell as full as those.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from jaxmpm.grid import Grid
from jaxmpm.laws import Elastic, frictional
from jaxmpm.tensors import ACTING, AXES, VOIGT
from jaxmpm.transfer import along, at_rows, beside, of_all, of_stored
from jaxmpm.types import Scene

NARROW, WIDE = 0.02, 0.85
"""Gaps, as shares of a cell, up to which soil counts as touching the ground, and that count at most. Between the first
and twice that a gap counts more and more, so that forces do not jump."""

UNEVEN = 0.05
"""Share up to which a cell within soil may hold less than those above and below without a gap, likewise."""

REACHES = 0.25
"""Share of a cell from which soil in it joins the cell beyond it; with less, in proportion."""


BARELY = 1e-15
"""Mass at a node (kg), volume (m3) or share of a cell up to which soil barely reaches there: the square of its inverse,
which a derivative takes, is no number in float32."""


class GroundPlanes(NamedTuple):
    """A plane of nodes on rigid ground along which soil shears or slides, or all planes of nodes but the last.

    Args:
        axis: normal to the planes.
        planes: of the ground, first and beyond the last.
        inward: distance in nodes of the next planes into the soil, 1 or -1.
        nodes: which nodes of these planes are the ground's with soil's beside them; None for all.
    """

    axis: int
    planes: tuple[int, int]
    inward: int
    nodes: Array | None = None

    def of(self, field: Array, beside: int = 0) -> Array:
        """Values of a field (grid's shape, ...) on these planes, or on those beside them."""
        first, beyond = (plane + beside for plane in self.planes)
        return jax.lax.slice_in_dim(field, first, beyond, axis=self.axis)

    def padded(self, values: Array, planes: int, beside: int = 0) -> Array:
        """A field on so many planes with these values on the ground's, or on those beside them, and 0 elsewhere."""
        first, beyond = (plane + beside for plane in self.planes)
        widths = [(0, 0)] * values.ndim
        widths[self.axis] = (first, planes - beyond)
        return jnp.pad(values, widths)


class GroundRows(NamedTuple):
    """`GroundPlanes` where nodes near soil alone are stored: fields are (rows, ...), and all rows are the ground's.

    Args:
        axis: normal to the planes.
        inward: distance in nodes of the next planes into the soil, 1 or -1.
        nodes: rows of the ground's nodes with soil's beside them (rows,).
        into: rows beside each row into the soil (rows,), -1 for none.
        out: rows beside it on the other side (rows,), likewise.
    """

    axis: int
    inward: int
    nodes: Array
    into: Array
    out: Array

    def of(self, field: Array, beside: int = 0) -> Array:
        """Values of a field (rows, ...), or those beside them."""
        return at_rows(field, self.into) if beside else field

    def padded(self, values: Array, planes: int, beside: int = 0) -> Array:
        """A field with these values, or with them on the rows beside."""
        return at_rows(values, self.out) if beside else values


def sheared(scene: Scene) -> Array | bool:
    """Whether undrained soil may shear along rigid ground, of soil of both kinds which particles are undrained (N,)."""
    boundary = scene.boundary
    holds = boundary.cut is not None or boundary.base is not None or any(w.hold != "roller" for w in boundary.walls)
    return holds and undrained(scene)


def undrained(scene: Scene) -> Array | bool:
    """Whether soil yields at a strength that does not depend on pressure, of soil of both kinds which (N,).

    A body that does not yield has no strength that a gap could take.
    """
    if isinstance(scene.material, Elastic):
        return False
    kind = frictional(scene.material)
    return not kind if isinstance(kind, bool) else ~kind


def gaps(scene: Scene, mass: Array) -> Array | None:
    """Gap between soil and rigid ground at the nodes of the ground.

    Of soil that reaches up from a gap g through the next cells, (1 - g)^2 / 2 of a full cell's mass maps to the node on
    the ground and 1 - g^2 / 2 to the next one, however much of the ground it covers. A thin layer maps less to the
    next node, and counts as lying on the ground.

    Args:
        scene: of the nodes.
        mass: at the nodes (nodes,) kg.

    Returns:
        (nodes,) share of a cell, 0 at all other nodes; None where no ground holds soil along itself.
    """
    grid = scene.grid
    found, field = None, laid_out(grid, mass)
    for ground in _grounds(scene):
        here = gap_of(ground.of(field), ground.of(field, ground.inward))
        if ground.nodes is not None:
            here = jnp.where(ground.nodes, here, 0)
        here = ground.padded(here, grid.shape[ground.axis])
        found = here if found is None else jnp.maximum(found, here)
    return None if found is None else found.reshape(mass.shape)


def gap_of(first: Array, second: Array) -> Array:
    """Gap as a share of a cell, of the masses at nodes on the ground and at the next ones (kg)."""
    # From a half on there is no gap; a ratio to the mass at a node that soil barely reaches overflows, as its square
    # and its derivative do.
    less = (first < second) & (second > BARELY)
    ratio = jnp.where(less, first / jnp.where(less, second, 1), 1)
    # Without mass on the ground the root is 1, where it has a derivative.
    return _counted((1 - jnp.sqrt(jnp.where(ratio > 0, ratio + 2 * ratio**2, 1))) / (1 + ratio), NARROW)


def _counted(gap: Array, narrow: float) -> Array:
    """A gap as it counts: not at all up to `narrow`, and at most as WIDE."""
    return jnp.minimum(gap, WIDE) * jnp.clip(gap / narrow - 1, 0, 1)


def closed(
    scene: Scene, gap: Array | None, force: Array, undrained: Array | None = None, *, pressing: bool = True
) -> Array:
    """Forces of the soil's stress, along ground to which it sticks as they are if soil reaches down to it.

    What a node on the ground lacks, the next one lacks in return.

    Args:
        scene: of the nodes.
        gap: from `gaps`.
        force: of the stress (nodes, d) N.
        undrained: share of the soil at the nodes that has no friction (nodes,); None for all.
        pressing: whether soil that pulls at its ground is left as it is; without, the forces are linear in the stress.

    Returns:
        (nodes, d) N.
    """
    if gap is None:
        return force
    grid, lacking = scene.grid, gap / (1 - gap) if undrained is None else undrained * gap / (1 - gap)
    result = field = laid_out(grid, force)
    lacking = laid_out(grid, lacking)
    for ground in _grounds(scene, sticking=True):
        motion, share = ground.of(field), ground.of(lacking)
        if ground.nodes is not None:
            share = jnp.where(ground.nodes, share, 0)
        if pressing:
            share = jnp.where(ground.inward * motion[..., ground.axis] < 0, share, 0)
        along = jnp.arange(motion.shape[-1]) != ground.axis
        lacks, planes = jnp.where(along, share[..., None] * motion, 0), grid.shape[ground.axis]
        result = result + ground.padded(lacks, planes) - ground.padded(lacks, planes, ground.inward)
    return result.reshape(force.shape)


def by_levels(scene: Scene, volume: Array, acting: Array) -> Array | None:
    """What `bridged` needs of the particles, to be mapped by the weights' derivative upwards.

    Args:
        scene: of the particles.
        volume: current one (N,) m3.
        acting: volume times stress components (s, N) that act on the grid (J).

    Returns:
        (d, N) volume (m3), and the stress of undrained soil along level planes (J); None for a scene
        without any, or that bridges no gaps.
    """
    d, soft = scene.grid.dimension, undrained(scene)
    if d == 1 or soft is False or not scene.numerics.bridging:
        return None
    along = [acting[ACTING[d].index(VOIGT[axis][2])] for axis in AXES[d][:-1]]
    return jnp.stack([volume, *(stress if soft is True else jnp.where(soft, stress, 0) for stress in along)])


def bridged(scene: Scene, levels: Array, force: Array, gap: Array | None) -> Array:
    """Forces of the soil's stress, along level planes as if cells were as full as those above and below them.

    Sums upwards of the mapped volume and shear stress are those of the soil between two levels of nodes, which so are
    exact for boxes of particles that fill cells by a share. What one level of nodes gains, the next one loses. Where
    nodes near soil alone are stored the sums are made over all levels all the same.

    Args:
        scene: of the nodes.
        levels: from `by_levels` (nodes, d).
        force: of the stress (nodes, d) N.
        gap: below soil that does not reach down to rigid ground, from `gaps`.

    Returns:
        (nodes, d) N.
    """
    grid = scene.grid
    d, upright = grid.dimension, grid.dimension - 1
    between = _added_up(of_all(grid, levels).reshape(*grid.shape, d), upright)
    filled, traction = between[..., 0] / grid.cell ** (d - 1), between[..., 1:]
    around = jnp.pad(
        _with_rock(scene, filled, None if gap is None else of_all(grid, gap)), [(0, 0)] * upright + [(2, 2)]
    )

    def beyond(cells: int) -> Array:
        """Filled share of the cells so many further up."""
        return jax.lax.slice_in_dim(around, 2 + cells, 2 + cells + grid.shape[upright], axis=upright)

    def full(side: int) -> Array:
        """Filled share of the cells on this side, the first or, where soil reaches through it, the second."""
        first, second = beyond(side), beyond(2 * side)
        return first + jnp.clip(first / REACHES, 0, 1) * jnp.maximum(second - first, 0)

    beside = jnp.minimum(jnp.minimum(full(1), full(-1)), 1)
    lacks = (beside > filled) & (beside > BARELY)
    gap = _counted(jnp.where(lacks, 1 - filled / jnp.where(lacks, beside, 1), 0), UNEVEN)
    lacking = (gap / (1 - gap))[..., None] * traction
    change = lacking - shifted(lacking, -1, upright)
    return force + of_stored(grid, jnp.pad(change, [(0, 0)] * d + [(0, 1)]).reshape(-1, d))


def _added_up(field: Array, axis: int) -> Array:
    """Sums along an axis, one level after the other: on CPU a third of what `jnp.cumsum` takes."""
    rows = jnp.moveaxis(field, axis, 0)
    _, sums = jax.lax.scan(lambda before, row: (before + row,) * 2, jnp.zeros_like(rows[0]), rows)
    return jnp.moveaxis(sums, 0, axis)


def _with_rock(scene: Scene, filled: Array, gap: Array | None) -> Array:
    """Filled shares of cells (grid's shape), 1 in those below a level base that soil reaches down to."""
    if gap is None:
        return filled
    upright, gap = scene.grid.dimension - 1, gap.reshape(filled.shape)
    for wall in scene.boundary.walls:
        if wall.axis == upright and wall.side == "low" and wall.hold != "roller":
            beyond = jax.lax.broadcasted_iota(jnp.int32, filled.shape, upright) < wall.index
            filled = jnp.where(beyond & (gap[..., wall.index, None] < 2 * NARROW), 1, filled)
    return filled


def shifted(field: Array, levels: int, axis: int) -> Array:
    """Values so many levels further along an axis, 0 beyond its end."""
    size, ends = field.shape[axis], [(0, 0)] * field.ndim
    ends[axis] = (max(-levels, 0), max(levels, 0))
    first = max(levels, 0)
    return jax.lax.slice_in_dim(jnp.pad(field, ends), first, first + size, axis=axis)


def laid_out(grid: Grid, values: Array) -> Array:
    """Nodal values (nodes, ...) as an array of the grid's shape, or as they are where it stores those near soil."""
    return values if grid.near is not None else values.reshape(*grid.shape, *values.shape[1:])


def _grounds(scene: Scene, *, sticking: bool = False) -> Iterator[GroundPlanes | GroundRows]:
    """Walls that hold soil along themselves, and ground of any shape, whose next nodes lie above.

    Args:
        scene: of the nodes.
        sticking: leave out ground along which soil slides. Its nodes move, and those of a wide gap have so little mass
            that forces of a whole cell would throw them off.
    """
    boundary, grid = scene.boundary, scene.grid
    for wall in boundary.walls:
        if wall.hold == "fixed" or (wall.hold == "friction" and not sticking):
            inward = 1 if wall.side == "low" else -1
            if grid.near is None:
                yield GroundPlanes(wall.axis, (wall.index, wall.index + 1), inward)
            else:
                yield _rows_of_ground(grid, wall.axis, inward, along(grid, wall.axis) == wall.index)
    on_ground = boundary.cut
    if boundary.base is not None and not sticking:
        on_base = jnp.any(boundary.base.normal != 0, axis=1)
        on_ground = on_base if on_ground is None else on_ground | on_base
    upright = grid.dimension - 1
    if on_ground is not None and grid.near is not None:
        above = beside(grid, upright, 1)
        yield _rows_of_ground(grid, upright, 1, on_ground & (above >= 0) & ~at_rows(on_ground, above))
    elif on_ground is not None:
        field = on_ground.reshape(grid.shape)
        ground = GroundPlanes(upright, (0, field.shape[upright] - 1), 1)
        yield ground._replace(nodes=ground.of(field) & ~ground.of(field, 1))


def _rows_of_ground(grid: Grid, axis: int, inward: int, on_ground: Array) -> GroundRows:
    return GroundRows(axis, inward, on_ground, beside(grid, axis, inward), beside(grid, axis, -inward))
