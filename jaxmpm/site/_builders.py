"""Builders on the host: from sizes in metres to a Scene and the State it starts from."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike

from foundation import check
from jaxmpm.laws import BaseMotion, WaterSurface, WaterTable
from jaxmpm.site import _initial_stress
from jaxmpm.site._discretisation import Discretisation, cells_up, check_discretisation, kernel_of
from jaxmpm.site._scene import scene, unstressed
from jaxmpm.site._soil import STANDARD_GRAVITY, Ground, material_of, warn_of_units
from jaxmpm.transfer import band_thickness
from jaxmpm.types import Grid, Material, Particles, Scene, State, Wall

PADDING = 1
"""Cells of grid beyond a wall."""

ROUNDING = 1e-9
"""Share of a particle's height that is nothing but rounding."""


@dataclass(frozen=True)
class Slope:
    """A slope over a foundation, falling along x from the crest at x = 0 (m).

    crest: flat length behind the slope. height: of the slope. run_per_rise: 2 is 1:2. toe: flat length before it.
    foundation: thickness below the toe. width: along y, None for a section in plane strain.
    """

    crest: float = 30.0
    height: float = 12.0
    run_per_rise: float = 2.0
    toe: float = 42.0
    foundation: float = 4.0
    width: float | None = None

    @property
    def toe_x(self) -> float:
        """Where the slope meets the flat ground (m)."""
        return self.crest + self.run_per_rise * self.height

    @property
    def length(self) -> float:
        """Length along x (m)."""
        return self.toe_x + self.toe

    @property
    def dimension(self) -> int:
        """2 for a section, 3 with a width."""
        return 2 if self.width is None else 3

    def check(self) -> None:
        """Raise ValueError for sizes that no slope has."""
        for name in ("crest", "height", "toe", "foundation"):
            check.positive(name, getattr(self, name), "m")
        check.not_negative("run_per_rise", self.run_per_rise)
        if self.width is not None:
            check.positive("width", self.width, "m")

    @property
    def area(self) -> float:
        """Of the section (m2)."""
        return self.length * self.foundation + self.height * (self.crest + self.run_per_rise * self.height / 2)

    @property
    def corner(self) -> tuple[float, ...]:
        """Lowest corner (d,) m of the box that holds the ground: the origin."""
        return (0.0,) * self.dimension

    @property
    def extent(self) -> tuple[float, ...]:
        """Edges (d,) m of the box that holds the ground."""
        top = self.foundation + self.height
        return (self.length, top) if self.width is None else (self.length, self.width, top)

    @property
    def volume(self) -> float:
        """Of the ground (m3), in a section per metre of width (m2)."""
        return self.area * (1.0 if self.width is None else self.width)

    def cells(self, discretisation: Discretisation) -> list[int]:
        """Cells of a grid along each axis, with air above the crest. Raises ValueError for a slope or a grid that is
        none, and where one does not fit the other."""
        d, cell = self.dimension, discretisation.cell
        check_discretisation(discretisation, d)
        self.check()
        if self.toe < 2 * cell:
            raise ValueError(
                f"toe = {self.toe:g} m leaves no room for a run-out: give at least two cells ({2 * cell:g} m)"
            )
        dx, dz = discretisation.spacing[0], discretisation.spacing[-1]
        for name, value in (
            ("crest", self.crest),
            ("slope's run", self.run_per_rise * self.height),
            ("toe", self.toe),
        ):
            if value > 0:
                check.multiple(name, value, "the spacing along x", dx)
        for name, value in (("height", self.height), ("foundation", self.foundation)):
            check.multiple(name, value, "the spacing along z", dz)
        cells = [check.multiple("length", self.length, "cell", cell)]
        if self.width is not None:
            check.multiple("width", self.width, "the spacing along y", discretisation.spacing[1])
            cells.append(check.multiple("width", self.width, "cell", cell))
        return [*cells, cells_up(discretisation, self.foundation + self.height)]

    def heights(self, x: np.ndarray, _: np.ndarray | None = None) -> np.ndarray:
        """Height of the surface (m) at x, and wherever along y."""
        return self.surface(x)

    def surface(self, x: np.ndarray) -> np.ndarray:
        """Height of the ground above the base (m) at x."""
        if self.run_per_rise == 0:
            return self.foundation + self.height * (x <= self.crest)
        return self.foundation + np.clip(self.height - (x - self.crest) / self.run_per_rise, 0.0, self.height)


def slope(
    shape: Slope,
    soil: Ground,
    discretisation: Discretisation,
    *,
    gravity: float = 9.81,
    y_ends: Literal["fixed", "roller"] = "fixed",
    speed: float | None = None,
    at_rest: bool = True,
) -> tuple[Scene, State]:
    """A slope at rest: base fixed, x ends on rollers, y ends as asked, stress from elastic gravity loading.

    at_rest: False leaves it free of stress, which is not solved for then (gravity would act suddenly).
    speed: largest particle speed that the time step allows for (m/s), by default of a fall
    through half the relief.
    Raises ValueError for sizes, moduli, spacings and walls that do not fit (each message says which and why).
    """
    check.not_negative("gravity", gravity, "m/s2")
    if y_ends not in ("fixed", "roller"):
        raise ValueError(f"y_ends = {y_ends!r}: give 'fixed' or 'roller'")
    d, cell, cells = shape.dimension, discretisation.cell, shape.cells(discretisation)
    top = shape.foundation + shape.height
    walls = end_walls(0, cells[0], "roller")
    if shape.width is not None:
        walls += end_walls(1, cells[1], y_ends)
    walls.append(Wall(d - 1, "low", PADDING, "fixed"))

    built, state = build(
        _particles(
            shape.extent,
            soil,
            discretisation,
            inside=lambda x: below(x[-1], shape.surface(x[0]), ROUNDING * discretisation.spacing[-1]),
        ),
        Grid(tuple(n + 1 + 2 * PADDING for n in cells), cell, (-PADDING * cell,) * d),
        material_on(discretisation, soil),
        discretisation,
        walls=tuple(walls),
        gravity=gravity,
        speed=math.sqrt(gravity * top) if speed is None else speed,
    )
    return built, _initial_stress.settled(built, state) if at_rest else state


def column(
    height: float,
    soil: Ground,
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
        _particles([cell] * (d - 1) + [height], soil, discretisation),
        Grid(tuple(n + 1 + 2 * PADDING for n in cells), cell, (-PADDING * cell,) * d),
        material_on(discretisation, soil),
        discretisation,
        walls=tuple(walls),
        gravity=gravity,
        speed=math.sqrt(gravity * height),
    )
    return built, _initial_stress.settled(built, state) if at_rest else state


def bar(
    length: float, soil: Ground, discretisation: Discretisation, *, velocity: float, mode: int = 1
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
        _particles([length], soil, discretisation),
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
    soil: Ground,
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
        _particles(size, soil, discretisation, corner=corner),
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


def _particles(extent: Sequence[float], soil: Ground, discretisation: Discretisation, **where: Any) -> Particles:
    """Particles of a soil that fill a box."""
    return fill(extent, discretisation.spacing, unit_weight=soil.unit_weight, dtype=discretisation.dtype, **where)


def material_on(discretisation: Discretisation, soil: Ground) -> Material:
    """The law of a soil on this grid, whose shear bands are as thick as a cell or as their average makes them."""
    length = discretisation.internal_length
    dtype = check.dtype(discretisation.dtype or jax.dtypes.canonicalize_dtype(float))
    law = material_of(soil, dtype, discretisation.cell if length is None else band_thickness(length))
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
    """Scene and motionless, stress-free state of these particles."""
    built = scene(
        sorted_by_cell(particles, grid),
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
