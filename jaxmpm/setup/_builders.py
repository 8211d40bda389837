"""Builders on the host: from sizes in metres to a Scene and the State it starts from."""

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
"""Share of a particle's height that is nothing but rounding."""


def column(
    height: float,
    soil: AnySoil,
    discretisation: Discretisation,
    *,
    gravity: float = 9.81,
    at_rest: bool = True,
) -> tuple[Scene, State]:
    """A column on a fixed base, in 1D, or in 2D and 3D one cell wide between rollers; vertical is the last axis.

    at_rest: with the stress of elastic gravity loading, else free of stress (gravity then acts suddenly).
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
    """A 1D bar fixed at x = 0, free at x = length, without gravity, vibrating in one of its modes.

    Starts with v = velocity sin(b x), b = (2 mode - 1) pi / (2 length) (m/s): the tip's amplitude.
    In 1D the strain is uniaxial: for the bar of Young's modulus E, give a Poisson's ratio of 0.
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
    """A box of soil in a box-shaped domain, free of stress, moving at `velocity` (m/s).

    size, domain: edges (m). corner: lowest corner of the block in the domain. gravity: vector (m/s2).
    walls: what stands on all faces of the domain; with "none" a lane that leaves it fails with OUTSIDE_GRID.
    friction: coefficient of walls with "friction", tan of the wall's friction angle; they hold nothing back. cohesion:
    of such walls (Pa), along them.
    speed: largest particle speed allowed for in the time step (m/s), by default that of the start.
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
    held = () if walls == "none" else tuple(wall for a in range(d) for wall in end_walls(a, cells[a], walls))
    built, state = build(
        box_particles(size, soil, discretisation, corner=corner),
        Grid(tuple(n + 1 + 2 * PADDING for n in cells), cell, (-PADDING * cell,) * d),
        material_on(discretisation, soil),
        discretisation,
        walls=held,
        gravity=gravity,
        speed=float(np.linalg.norm(velocity)) if speed is None else speed,
        friction=friction if walls == "friction" else None,
        cohesion=cohesion or None,
    )
    start = jnp.asarray(velocity, state.velocity.dtype)[:, None]
    return built, replace(state, velocity=jnp.broadcast_to(start, state.velocity.shape))


Hold = Literal["fixed", "roller", "friction"]


def end_walls(axis: int, cells: int, hold: Hold, high: Hold | None = None) -> list[Wall]:
    """Walls at both ends of an axis that is `cells` cells long; high: of the higher end, where it holds otherwise."""
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
    """Equal particles that fill a box from `corner`: at the centres of boxes of size `spacing`, those `inside`.

    extent, spacing: edges of the box and of a particle's own (m), one value per axis. unit_weight: N/m3. inside: told
    positions (d, N) m from the corner, says which to keep, (N,) bool; None keeps all. corner: lowest corner of the box
    (m), by default the origin. dtype: float32 or float64, as JAX is set if None.
    Raises ValueError for sizes that do not fit, or where nothing is inside.
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
        kept = np.asarray(inside(position))
        if kept.shape != position.shape[1:] or kept.dtype != bool or not kept.any():
            raise ValueError(
                f"inside gave {kept.dtype} of shape {kept.shape}, {np.count_nonzero(kept)} of them true: give one bool "
                f"for each of {position.shape[1]} particles, some of them true"
            )
        position = position[:, kept]
    position = position + np.asarray(corner or (0.0,) * d, float)[:, None]
    volume = float(np.prod(spacing))
    return Particles(
        position=jnp.asarray(position, dtype),
        mass=jnp.full(position.shape[1], unit_weight / STANDARD_GRAVITY * volume, dtype),
        volume=jnp.full(position.shape[1], volume, dtype),
    )


def below(z: np.ndarray, height: np.ndarray, rounding: float) -> np.ndarray:
    """Whether points at z (m) lie below a height (m) at their place; one as high, to `rounding` (m), does not."""
    return z < height - rounding


def box_particles(extent: Sequence[float], soil: AnySoil, discretisation: Discretisation, **where: Any) -> Particles:
    """Particles of a soil that fill a box."""
    return fill(extent, discretisation.spacing, unit_weight=soil.unit_weight, dtype=discretisation.dtype, **where)


def material_on(discretisation: Discretisation, soil: AnySoil) -> Material:
    """The law of a soil on this grid, whose shear bands are as thick as a cell or as their average makes them."""
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
    """Scene and motionless, stress-free state of these particles, which of a `Zoned` law come in its order. Where they
    carry a pore pressure, undrained ones have none: their stress is total."""
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
    """The particles in the order of the cells in which they lie: neighbours then lie close in memory."""
    position = np.asarray(particles.position, float)
    cell_of = np.floor((position - np.asarray(grid.origin)[:, None]) / grid.cell).astype(np.int64)
    order = np.lexsort(cell_of[::-1])
    return jax.tree.map(lambda leaf: leaf[..., order], particles)
