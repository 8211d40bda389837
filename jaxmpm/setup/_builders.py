"""Builders on the host: from sizes in metres to a Scene and its initial State."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike

from foundation import check
from jaxmpm.laws import BaseMotion, WaterSurface, WaterTable, Zoned
from jaxmpm.setup._discretisation import Discretisation, cells_up, check_discretisation, kernel_of
from jaxmpm.setup._initial_stress import settled
from jaxmpm.setup._scene import in_total_stress_at, scene, unstressed
from jaxmpm.soil import STANDARD_GRAVITY, AnySoil, warn_of_units
from jaxmpm.transfer import band_thickness
from jaxmpm.types import Grid, Material, Particles, Scene, State, Wall

PADDING = 1
"""Cells of grid beyond a wall."""

ROUNDING = 1e-9
"""Share of a particle's height within rounding."""


def column(
    height: float,
    soil: AnySoil,
    discretisation: Discretisation,
    *,
    gravity: float = 9.81,
    at_rest: bool = True,
) -> tuple[Scene, State]:
    """Build a column on a fixed base, in 1D, or in 2D and 3D one cell wide between rollers.

    Args:
        height: along the last axis (m).
        soil: of the column.
        discretisation: cell, spacing (whose length is the dimension) and numerical choices.
        gravity: downwards (m/s2).
        at_rest: with the stress of elastic gravity loading, else free of stress, so that gravity acts suddenly.

    Returns:
        Scene and state.

    Raises:
        ValueError: If sizes and numbers do not fit each other.
    """
    d, cell = len(discretisation.spacing), discretisation.cell
    check_discretisation(discretisation, d)
    check.positive("height", height, "m")
    check.not_negative("gravity", gravity, "m/s2")
    check.multiple("height", height, "the spacing along the height", discretisation.spacing[-1])
    walls = [wall for a in range(d - 1) for wall in end_walls(a, 1, "roller")]
    walls.append(Wall(d - 1, "low", PADDING, "fixed"))
    cells = [1] * (d - 1) + [cells_up(discretisation, height)]
    built, state = build(
        box_particles([cell] * (d - 1) + [height], soil, discretisation),
        Grid(tuple(n + 1 + 2 * PADDING for n in cells), cell, (-PADDING * cell,) * d),
        material_on(discretisation, soil),
        discretisation,
        walls=tuple(walls),
        gravity=gravity,
        speed=math.sqrt(gravity * height),
    )
    return built, settled(built, state) if at_rest else state


def bar(
    length: float, soil: AnySoil, discretisation: Discretisation, *, velocity: float, mode: int = 1
) -> tuple[Scene, State]:
    """Build a 1D bar fixed at x = 0, free at x = length, without gravity, vibrating in one of its modes.

    It starts with v = velocity sin(b x), b = (2 mode - 1) pi / (2 length). In 1D the strain is uniaxial: for a bar of
    Young's modulus E give a Poisson's ratio of 0.

    Args:
        length: m.
        soil: of the bar.
        discretisation: cell, spacing and numerical choices.
        velocity: amplitude, at the tip (m/s).
        mode: number from 1.

    Returns:
        Scene and state.

    Raises:
        ValueError: If sizes and numbers do not fit each other.
    """
    check_discretisation(discretisation, 1)
    check.positive("length", length, "m")
    check.multiple("length", length, "the spacing", discretisation.spacing[0])
    check.finite("velocity", velocity, "m/s")
    check.whole("mode", mode)
    cell = discretisation.cell
    cells = cells_up(discretisation, length)
    built, state = build(
        box_particles([length], soil, discretisation),
        Grid((cells + 1 + 2 * PADDING,), cell, (-PADDING * cell,)),
        material_on(discretisation, soil),
        discretisation,
        walls=(Wall(0, "low", PADDING, "fixed"),),
        gravity=0.0,
        speed=abs(velocity),
    )
    wave = (2 * mode - 1) * math.pi / (2 * length)
    return built, replace(state, velocity=velocity * jnp.sin(wave * built.particles.position))


def block(
    size: Sequence[float],
    soil: AnySoil,
    discretisation: Discretisation,
    *,
    domain: Sequence[float],
    corner: Sequence[float],
    velocity: Sequence[float] | None = None,
    gravity: Sequence[float] | None = None,
    walls: Literal["none", "fixed", "roller", "friction"] = "none",
    friction: float = 0.0,
    cohesion: float = 0.0,
    speed: float | None = None,
) -> tuple[Scene, State]:
    """Build a box of soil in a box-shaped domain, free of stress and moving.

    Args:
        size: edges of the block (m).
        soil: of the block.
        discretisation: cell, spacing and numerical choices.
        domain: edges of the domain (m).
        corner: lowest corner of the block in the domain (m).
        velocity: initial one (m/s), by default 0.
        gravity: vector (m/s2), by default 0.
        walls: constraint at all faces of the domain; with "none" a lane that leaves it fails with OUTSIDE_GRID.
        friction: coefficient of walls with "friction", the tangent of the wall's friction angle.
        cohesion: of such walls, along them (Pa); they do not resist separation.
        speed: largest particle speed that the time step allows for (m/s), by default the initial one.

    Returns:
        Scene and state.

    Raises:
        ValueError: If sizes and numbers do not fit each other.
    """
    d, cell = len(size), discretisation.cell
    check_discretisation(discretisation, d)
    zero = (0.0,) * d
    velocity, gravity = velocity or zero, gravity or zero
    for name, values in (
        ("domain", domain),
        ("corner", corner),
        ("velocity", velocity),
        ("gravity", gravity),
    ):
        check.axes(name, values, d)
    check.positive("size", size, "m")
    check.not_negative("corner", corner, "m")
    for a in range(d):
        check.multiple(f"size[{a}]", size[a], f"spacing[{a}]", discretisation.spacing[a])
        if corner[a] + size[a] > domain[a] * (1 + 1e-12):
            raise ValueError(
                f"the block ends at {corner[a] + size[a]:g} m along axis {a}, beyond the domain of {domain[a]:g} m: "
                "enlarge the domain"
            )
    if walls not in ("none", "fixed", "roller", "friction"):
        raise ValueError(f"walls = {walls!r}: give 'none', 'fixed', 'roller' or 'friction'")
    for name, value in (("friction", friction), ("cohesion", cohesion)):
        check.not_negative(name, value)
        if value and walls != "friction":
            raise ValueError(f"{name} = {value:g} with walls = {walls!r}: give walls = 'friction'")
    cells = [check.multiple(f"domain[{a}]", domain[a], "cell", cell) for a in range(d)]
    faces = () if walls == "none" else tuple(wall for a in range(d) for wall in end_walls(a, cells[a], walls))
    built, state = build(
        box_particles(size, soil, discretisation, corner=corner),
        Grid(tuple(n + 1 + 2 * PADDING for n in cells), cell, (-PADDING * cell,) * d),
        material_on(discretisation, soil),
        discretisation,
        walls=faces,
        gravity=gravity,
        speed=float(np.linalg.norm(velocity)) if speed is None else speed,
        friction=friction if walls == "friction" else None,
        cohesion=cohesion or None,
    )
    start = jnp.asarray(velocity, state.velocity.dtype)[:, None]
    return built, replace(state, velocity=jnp.broadcast_to(start, state.velocity.shape))


Hold = Literal["fixed", "roller", "friction"]


def end_walls(axis: int, cells: int, hold: Hold, high: Hold | None = None) -> list[Wall]:
    """Walls at both ends of an axis.

    Args:
        axis: number of the axis.
        cells: its length in cells.
        hold: constraint.
        high: that of the higher end, None for the same.

    Returns:
        Two walls.
    """
    return [Wall(axis, "low", PADDING, hold), Wall(axis, "high", PADDING + cells, high or hold)]


def fill(
    extent: Sequence[float],
    spacing: Sequence[float],
    *,
    unit_weight: float,
    inside: Callable[[np.ndarray], np.ndarray] | None = None,
    corner: Sequence[float] | None = None,
    dtype: DTypeLike | None = None,
) -> Particles:
    """Equal particles that fill a box, at the centres of boxes of size `spacing`.

    Args:
        extent: edges of the box (m).
        spacing: edges of a particle's own box (m), one value per axis.
        unit_weight: N/m3.
        inside: function of positions (d, N) m from the corner that returns (N,) bool, which particles to take; None
            takes all.
        corner: lowest corner of the box (m), by default the origin.
        dtype: float32 or float64; None for that of JAX.

    Returns:
        Particles.

    Raises:
        ValueError: If sizes do not fit, or no particle is inside.
    """
    dtype, d = check.dtype(dtype or jax.dtypes.canonicalize_dtype(float)), len(extent)
    check.axes("spacing", spacing, d)
    check.positive("spacing", spacing, "m")
    for a in range(d):
        check.multiple(f"extent[{a}]", extent[a], f"spacing[{a}]", spacing[a])
    check.positive("unit_weight", unit_weight, "N/m3")
    check.axes("corner", corner or (0.0,) * d, d)
    axes = [(np.arange(round(e / s)) + 0.5) * s for e, s in zip(extent, spacing, strict=True)]
    position = np.stack([a.ravel() for a in np.meshgrid(*axes, indexing="ij")])
    if inside is not None:
        mask = np.asarray(inside(position))
        if mask.shape != position.shape[1:] or mask.dtype != bool or not mask.any():
            raise ValueError(
                f"inside gave {mask.dtype} of shape {mask.shape}, {np.count_nonzero(mask)} of them true: give one bool "
                f"for each of {position.shape[1]} particles, some of them true"
            )
        position = position[:, mask]
    position = position + np.asarray(corner or (0.0,) * d, float)[:, None]
    volume = float(np.prod(spacing))
    return Particles(
        position=jnp.asarray(position, dtype),
        mass=jnp.full(position.shape[1], unit_weight / STANDARD_GRAVITY * volume, dtype),
        volume=jnp.full(position.shape[1], volume, dtype),
    )


def below(z: np.ndarray, height: np.ndarray, rounding: float) -> np.ndarray:
    """Whether points lie below a height.

    Args:
        z: of the points (m).
        height: of the surface at each point (m).
        rounding: a point less than this below the height does not count (m).

    Returns:
        bool, of the shape of `z`.
    """
    return z < height - rounding


def box_particles(extent: Sequence[float], soil: AnySoil, discretisation: Discretisation, **where: Any) -> Particles:
    """Particles of a soil that fill a box.

    Args:
        extent: edges of the box (m).
        soil: of the particles.
        discretisation: cell, spacing and numerical choices.
        **where: `corner` and `inside` of `fill`.

    Returns:
        Particles.
    """
    return fill(extent, discretisation.spacing, unit_weight=soil.unit_weight, dtype=discretisation.dtype, **where)


def material_on(discretisation: Discretisation, soil: AnySoil) -> Material:
    """The law of a soil on a grid, with warnings about units.

    Shear bands are as thick as a cell, or as the average of plastic strain makes them.

    Args:
        discretisation: cell, spacing and numerical choices.
        soil: to convert.

    Returns:
        The law.

    Raises:
        ValueError: If a number is impossible for soil.
    """
    length = discretisation.internal_length
    dtype = check.dtype(discretisation.dtype or jax.dtypes.canonicalize_dtype(float))
    law: Material = soil.material(dtype, discretisation.cell if length is None else band_thickness(length))
    warn_of_units(soil)
    return law


def build(
    particles: Particles,
    grid: Grid,
    material: Material,
    discretisation: Discretisation,
    *,
    walls: tuple[Wall, ...],
    gravity: float | Sequence[float],
    speed: float,
    friction: float | None = None,
    cohesion: float | None = None,
    wall_pressure: np.ndarray | None = None,
    water: WaterTable | WaterSurface | None = None,
    pore_pressure: np.ndarray | None = None,
    motion: BaseMotion | None = None,
    tied: tuple[int, int] | None = None,
    cut: np.ndarray | None = None,
) -> tuple[Scene, State]:
    """Scene and motionless, stress-free state of particles.

    With a `Zoned` law particles are in its order. If they have a pore pressure, it is 0 in undrained zones: their
    stress is total.

    Args:
        particles: to run.
        grid: background grid.
        material: their law.
        discretisation: cell, spacing and numerical choices.
        walls: planes that constrain nodes.
        gravity: downwards (m/s2), or a vector (d,).
        speed: largest particle speed that the time step allows for (m/s).
        friction: coefficient of walls with friction.
        cohesion: of such walls (Pa).
        wall_pressure: (nodes,) pressure of the water between these walls and the soil (Pa).
        water: table or surface of the water.
        pore_pressure: (N,) Pa.
        motion: of the base.
        tied: two planes of nodes along x that are identified.
        cut: (nodes,) bool, nodes at which nothing moves.

    Returns:
        Scene and state.

    Raises:
        ValueError: If shapes, numbers and choices do not fit, as for `scene`.
    """
    if isinstance(material, Zoned):
        if pore_pressure is not None:
            pore_pressure = np.where(in_total_stress_at(material), 0.0, pore_pressure)
    else:
        particles = sorted_by_cell(particles, grid)
    built = scene(
        particles,
        grid,
        material,
        kernel=kernel_of(discretisation),
        gravity=gravity,
        walls=walls,
        wall_friction=friction,
        wall_cohesion=cohesion,
        wall_pressure=wall_pressure,
        scheme=discretisation.scheme,
        cfl=discretisation.cfl,
        speed=speed,
        flip=discretisation.flip,
        damping=discretisation.damping,
        fbar=discretisation.fbar,
        cell_average=discretisation.cell_average,
        finite_strain=discretisation.finite_strain,
        internal_length=discretisation.internal_length,
        water=water,
        pore_pressure=pore_pressure,
        motion=motion,
        tied=tied,
        cut=cut,
    )
    return built, unstressed(built, apic=discretisation.apic)


def sorted_by_cell(particles: Particles, grid: Grid) -> Particles:
    """Particles in the order of the cells in which they lie, so that neighbours are close in memory.

    Args:
        particles: in any order.
        grid: whose cells count.

    Returns:
        The same particles.
    """
    position = np.asarray(particles.position, float)
    cell_of = np.floor((position - np.asarray(grid.origin)[:, None]) / grid.cell).astype(np.int64)
    order = np.lexsort(cell_of[::-1])
    return jax.tree.map(lambda leaf: leaf[..., order], particles)
