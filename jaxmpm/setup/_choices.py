"""Checks of a scene's geometry, loads and numerical choices."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any, get_args

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from jaxmpm.grid import Grid, Hold, Particles, Wall
from jaxmpm.laws import WaterSurface, WaterTable, Zoned, in_total_stress
from jaxmpm.protocols import Kernel, Material, PrescribedWater
from jaxmpm.setup._law import force_of_water, in_total_stress_at
from jaxmpm.soil import STANDARD_GRAVITY
from jaxmpm.support import check
from jaxmpm.support.check import Limit
from jaxmpm.support.text import shown
from jaxmpm.support.tracing import array, at_once
from jaxmpm.transfer import Linear, inside, locate
from jaxmpm.types import Boundary, Engine, Scene, Scheme


def check_grid(grid: Grid) -> int:
    """Number of the grid's axes; ValueError for a grid that no scene can have."""
    d = len(grid.shape)
    if d not in (1, 2, 3):
        raise ValueError(f"grid.shape = {grid.shape}: give 1, 2 or 3 axes")
    for a, nodes in enumerate(grid.shape):
        check.whole(f"grid.shape[{a}]", nodes, least=3)
    check.positive("grid.cell", grid.cell, "m")
    check.axes("grid.origin", grid.origin, d)
    return d


def check_particles(particles: Particles, grid: Grid) -> np.dtype:
    """Their precision."""
    d, arrays = grid.dimension, (particles.position, particles.mass, particles.volume)
    shapes = tuple(np.shape(array) for array in arrays)
    count = shapes[0][-1] if shapes[0] else 0
    if shapes != ((d, count), (count,), (count,)) or not count:
        raise ValueError(
            f"particles have position {shapes[0]}, mass {shapes[1]} and volume {shapes[2]}: give ({d}, N), (N,) and "
            f"(N,) on a grid of {d} axes, N at least 1"
        )
    dtypes = {np.dtype(array.dtype) for array in arrays}
    if len(dtypes) > 1:
        raise ValueError(f"particles mix {', '.join(sorted(map(str, dtypes)))}: give all arrays one dtype")
    check.within_limits(particles)
    if check.is_traced(particles.position):
        return check.dtype(dtypes.pop())  # the status of a lane tells
    out = ~inside(grid, locate(grid, np.asarray(particles.position)))
    if out.any():
        first = np.asarray(particles.position)[:, int(np.argmax(out))]
        raise ValueError(
            f"{int(out.sum())} particles, one of them at {first.tolist()} m, stand on or beyond the outermost cells of "
            f"the grid of {grid.shape} nodes from {grid.origin} m: enlarge the grid by a cell of padding on each side"
        )
    return check.dtype(dtypes.pop())


def check_boundary(boundary: Boundary, grid: Grid) -> None:
    """Raise ValueError for walls, or shapes of values at the nodes, that do not fit the grid or each other."""
    walls, friction = boundary.walls, boundary.friction
    for wall in walls:
        if not isinstance(wall, Wall):
            raise ValueError(f"walls hold {wall!r}: give Wall(axis, side, index, hold)")
        if wall.axis not in range(grid.dimension) or wall.index not in range(grid.shape[wall.axis]):
            raise ValueError(f"{wall}: there is no such axis or node on a grid of {grid.shape} nodes")
        if wall.side not in ("low", "high") or wall.hold not in get_args(Hold):
            raise ValueError(f"{wall}: side is 'low' or 'high', hold is one of {', '.join(get_args(Hold))}")
    if boundary.base is not None and any(wall.hold == "friction" for wall in walls):
        raise ValueError("walls of 'friction' with a base, whose area alone is known: give one of them")
    rough = boundary.base is not None or any(wall.hold == "friction" for wall in walls)
    if rough != (friction is not None):
        raise ValueError(
            f"boundary.friction = {shown(friction)} with walls of {sorted({wall.hold for wall in walls})}: give it "
            "with, and only with, walls of 'friction' or a base"
        )
    if not rough and any(field is not None for field in (boundary.cohesion, boundary.pressure, boundary.softening)):
        raise ValueError(
            "cohesion, pressure or softening of walls without walls of 'friction' or a base: leave them out"
        )
    if friction is not None:
        check.not_negative("boundary.friction", friction)
    if boundary.softening is not None:
        residual, slip = boundary.softening
        check.within("softening[0], the share that slip leaves,", residual, Limit(least=0, most=1))
        check.positive("softening[1], the slip,", slip, "m")
    nodes, pressure, cut, base = (grid.nodes,), boundary.pressure, boundary.cut, boundary.base
    for part in WALL_STRENGTH.values():
        check_of_contact(f"boundary.{part}", getattr(boundary, part), grid)
    if pressure is not None and np.shape(pressure) != nodes:
        raise ValueError(f"boundary.pressure has shape {np.shape(pressure)}: give {nodes}, in Pa")
    if cut is not None and (np.shape(cut) != nodes or np.asarray(cut).dtype != bool):
        raise ValueError(f"cut has shape {np.shape(cut)}: give {nodes}, one bool for each node")
    if base is not None:
        shapes = tuple(np.shape(array) for array in (base.normal, base.area, base.volume))
        if shapes != ((*nodes, grid.dimension), nodes, nodes):
            raise ValueError(f"the base has shapes {shapes}: give normals {(*nodes, grid.dimension)}, else {nodes}")


WALL_STRENGTH = {"wall_friction": "friction", "wall_cohesion": "cohesion"}
"""Strength of walls with friction and of a base: fields of a `Boundary` by the names of `with_soil`."""


def check_of_contact(name: str, value: ArrayLike | None, grid: Grid) -> None:
    """Check that a strength of walls or of a base is a number or one value per node.

    Args:
        name: of the parameter, for the message.
        value: () or (nodes,); None for none.
        grid: of the nodes.

    Raises:
        ValueError: If it has another shape.
    """
    if value is not None and np.shape(value) not in ((), (grid.nodes,)):
        raise ValueError(f"{name} has shape {np.shape(value)}: give a number or {(grid.nodes,)}, one value per node")


def check_kernel(kernel: Kernel, grid: Grid) -> None:
    """ValueError for a kernel that lacks a member, cannot be hashed, or does not fit the grid."""
    missing = [name for name in ("shape", "deviation") if not hasattr(kernel, name)]
    if missing or isinstance(kernel, type) or type(kernel).__hash__ is None:
        raise ValueError(f"kernel = {kernel!r}: give a hashable object with shape and deviation, e.g. GIMP((0.5, 0.5))")
    half = getattr(kernel, "half_size", None)
    if half is not None:
        check.axes("half_size", half, grid.dimension)
        check.positive("half_size", half, "m")
    _check_weights(kernel, grid)  # type: ignore[arg-type]


@lru_cache
def _check_weights(kernel: Kernel, grid: Grid) -> None:
    reach = (np.arange(64) + 0.5) / 64 + 0.5
    r = array(reach - np.arange(3)[:, None], jnp.float32)
    for axis in range(grid.dimension):
        weights = at_once(lambda at, axis=axis: kernel.shape(axis, grid.cell, at), r)
        value, slope = (np.asarray(weight).sum(0) for weight in weights)
        if not (np.abs(value - 1) < 1e-5).all() or not (np.abs(slope * grid.cell) < 1e-4).all():
            raise ValueError(
                f"{kernel!r} weighs a particle by {value.min():g} to {value.max():g} over its three nodes along axis "
                f"{axis} in cells of {grid.cell:g} m: give functions that add up to 1 and reach at most 1.5 cells"
            )


HATS_EDGE = 0.01
"""Distance of a particle from a face (cells) below which there is a warning of hats."""


def warn_of_hats(kernel: Kernel, scheme: Scheme, particles: Particles, grid: Grid) -> None:
    """Warn of hats where they do not work: their slopes jump at the faces of cells."""
    if not isinstance(kernel, Linear) or check.is_traced(particles.position):
        return
    if scheme is Scheme.USL:
        check.warn(
            "kernel = Linear with scheme = USL: nodes that are nearly empty have no bounded velocity, and slides end "
            "INVERTED; take MUSL, or GIMP"
        )
    cells = locate(grid, np.asarray(particles.position)).astype(float)
    near = np.any(abs(cells - np.round(cells)) < HATS_EDGE, axis=0)
    if near.any():
        check.warn(
            f"kernel = Linear with {int(near.sum())} of {near.size} particles within {HATS_EDGE:g} cells of a cell's "
            "face, where the slope of hats jumps: even a uniform motion strains them; move the particles, or take GIMP"
        )


def check_engine(engine: Engine | None) -> None:
    """ValueError for anything but an engine or None."""
    if engine is not None and not isinstance(engine, Engine):
        raise ValueError(f"engine = {engine!r}: give a member of Engine, or None")


def gravity_vector(gravity: Any, dimension: int) -> np.ndarray | Array:
    """The vector (d,) m/s2; a number acts downwards."""
    if np.ndim(gravity) == 0:
        check.not_negative("gravity", gravity, "m/s2")
        gravity = (0.0,) * (dimension - 1) + (-gravity,)
    if check.is_traced(gravity):
        return jnp.stack([jnp.asarray(component) for component in gravity])
    vector = np.asarray(gravity, float)
    check.axes("gravity", vector.tolist(), dimension)
    return vector


def check_tied(
    tied: tuple[int, int], grid: Grid, particles: Particles, walls: Sequence[Wall], internal_length: float | None
) -> None:
    """Refuse planes across x that cannot be tied.

    Args:
        tied: nodes along x of the two planes.
        grid: of the scene.
        particles: N of them, between the planes.
        walls: of the scene, none of them across x.
        internal_length: of the scene (m), which must be None.

    Raises:
        ValueError: If they cannot be tied.
    """
    whole = isinstance(tied, tuple) and len(tied) == 2 and all(isinstance(node, int) for node in tied)
    if not whole or not 1 <= tied[0] < tied[1] <= grid.shape[0] - 2:
        raise ValueError(f"tied = {tied!r}: give two nodes along x in rising order, from 1 to {grid.shape[0] - 2}")
    along = (np.asarray(particles.position, float)[0] - grid.origin[0]) / grid.cell
    if along.min() < tied[0] or along.max() > tied[1]:
        raise ValueError(
            f"particles reach from {along.min():g} to {along.max():g} cells along x, beyond the planes tied at nodes "
            f"{tied[0]} and {tied[1]}: put them between"
        )
    if any(wall.axis == 0 for wall in walls):
        raise ValueError("a wall along x with tied sides, which are no ends: give one or the other")
    if internal_length is not None:
        raise ValueError(
            f"internal_length = {internal_length:g} m with tied sides, across which it does not average: leave it out"
        )


def check_water(
    water: PrescribedWater | None,
    pore_pressure: ArrayLike | None,
    material: Material,
    particles: Particles,
) -> None:
    """Refuse water that a scene cannot have.

    Args:
        water: a table, a surface, or None.
        pore_pressure: of r_u at the particles (N,) Pa, or None.
        material: the law.
        particles: N of them.

    Raises:
        ValueError: If shapes or values are wrong, or r_u is given for undrained soil.
    """
    if isinstance(water, WaterTable):
        check.finite("water's x", water.x, "m")
        check.finite("water's z", water.z, "m")
        if np.ndim(water.x) != 1 or np.shape(water.x) != np.shape(water.z) or np.size(water.x) < 2:
            raise ValueError(
                f"water's x and z have shapes {np.shape(water.x)} and {np.shape(water.z)}: give (m,), m > 1"
            )
        if not check.is_traced(water.x) and not np.all(np.diff(np.asarray(water.x)) > 0):
            raise ValueError(
                f"water's x = {shown(np.asarray(water.x).tolist())} m does not rise: give its points in order"
            )
    elif isinstance(water, WaterSurface):
        check.finite("water's heights", water.heights, "m")
        check.finite("water's corner", water.corner, "m")
        check.positive("water's step", water.step, "m")
        shapes = np.shape(water.heights), np.shape(water.corner), particles.position.shape[0]
        if len(shapes[0]) != 2 or min(shapes[0]) < 2 or shapes[1:] != ((2,), 3):
            raise ValueError(
                f"water's heights have shape {shapes[0]}, its corner {shapes[1]}, in {shapes[2]}D: give (nx, ny), 2 or "
                "more along each, and (2,), in 3D"
            )
    elif water is not None:
        raise ValueError(f"water = {shown(water)}: give a WaterTable, a WaterSurface, or None")
    if pore_pressure is not None:
        if in_total_stress(material):
            raise ValueError(
                f"pore pressure by r_u in {type(material).__name__}, whose strength is undrained and does not depend "
                "on it: leave it out, or give the water a level or table, of which a pool loads the ground"
            )
        check.not_negative("pore_pressure", pore_pressure, "Pa")
        if np.shape(pore_pressure) != particles.mass.shape:
            raise ValueError(
                f"pore_pressure has shape {np.shape(pore_pressure)}: give {particles.mass.shape}, one a particle"
            )
        traced = check.is_traced(pore_pressure)
        if (
            isinstance(material, Zoned)
            and not traced
            and np.any(np.asarray(pore_pressure)[in_total_stress_at(material)])
        ):
            raise ValueError("pore_pressure above 0 in a zone whose strength is undrained: give 0 Pa there")


def check_weight_below_water(scene: Scene) -> None:
    """Refuse soil that floats.

    Args:
        scene: of particles at the start; without water there is nothing to refuse.

    Raises:
        ValueError: If soil below the water is no heavier than water.
    """
    water = scene.loads.water
    if water is None or check.is_traced(scene):
        return
    particles = scene.particles
    push = np.asarray(force_of_water(scene)[-1], float)
    down = -float(scene.loads.gravity[-1])
    heavy = down * np.asarray(particles.mass, float) / np.asarray(particles.volume, float)
    floats = np.flatnonzero((push > 0) & (heavy <= push * (1 + 1e-6)))
    if floats.size:
        worst = floats[np.argmin(heavy[floats])]
        at = ", ".join(f"{x:.4g}" for x in np.asarray(particles.position)[:, worst])
        assert hasattr(water, "unit_weight")
        weight = float(water.unit_weight) * STANDARD_GRAVITY / down
        raise ValueError(
            f"soil at ({at}) m lies below the water with a unit weight of {heavy[worst] * STANDARD_GRAVITY / down:.5g} "
            f"N/m3, no more than the {weight:.4g} of water, and floats: give unit_weight, or saturated_unit_weight of "
            "soil below the water, with the water in its pores, or lower the water"
        )
