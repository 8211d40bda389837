"""Data of a simulation: frozen pytrees, static where the program depends on them, dynamic elsewhere.

Particle arrays are component first: ``(d, N)`` with d the dimension, so that each component is contiguous.
Axes are x in 1D, (x, z) in 2D plane strain and (x, y, z) in 3D. Absent physics is ``None``. SI units.
"""

from __future__ import annotations

import enum
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, TypeAlias

from jax import Array

from jaxmpm.grid import Grid, Particles, RigidBase, Wall, static
from jaxmpm.protocols import History, Kernel, PrescribedMotion, PrescribedWater
from jaxmpm.support.check import Limit, above_zero, from_zero
from jaxmpm.support.pytrees import pytree


class Engine(enum.Enum):
    """Implementation of the transfers between particles and grid."""

    XLA = "scatter and gather as XLA compiles them, on any device"
    NATIVE = "compiled kernels, on CPU and CUDA GPUs"


class Scheme(enum.Enum):
    """Time of the stress update within a step: first, last, or last with velocities mapped again."""

    USF = "update stress first"
    USL = "update stress last"
    MUSL = "modified update stress last"


class Status(enum.IntEnum):
    """State of a lane; one above DECIDED has failed, and its fields are those of its last step.

    DECIDED: its displacement passed the limit beyond which the caller needs no more. BAD_PARAMETER: a number of its
    scene is not finite or beyond its limit, so it took no step. GRID_FULL: its soil reaches more nodes than the scene
    stores, so it took no step; `solve` and `solve_each` store more and go on. Files store names and numbers, so new
    ones go to the end.
    """

    RUNNING = 0
    FINISHED = 1
    SETTLED = 2
    DECIDED = 3
    NOT_FINITE = 4
    OUTSIDE_GRID = 5
    INVERTED = 6
    TIME_STEP_TOO_LARGE = 7
    BAD_PARAMETER = 8
    GRID_FULL = 9


@pytree
@dataclass(frozen=True)
class Numerics:
    """Numerical choices of a run, as a step takes them; `Discretisation` has those that a user makes.

    Args:
        time_step: s.
        kernel: shape functions; static.
        scheme: when the stress is updated; static.
        engine: of the transfers, None for the fastest available; static.
        fbar: whether volumetric strain and mean stress are averaged over neighbouring particles, against locking;
            static.
        cell_average: whether the volumetric strain alone is averaged, over each cell; static.
        gap_average: whether the gap that a tension cutoff has opened in soil with friction is averaged there, too;
            static.
        bridging: whether shear stress of undrained soil crosses gaps between soils, see `Discretisation`; static.
        finite_strain: whether elasticity uses Hencky strains instead of the Jaumann rate; yield then applies to J times
            the stress; static.
        xpic: transfers to the grid and back that the share of PIC filters by, see `Discretisation`; static.
        nonlocal_passes: filters in the average of the plastic strain over neighbours, see `jaxmpm.transfer.filtered`;
            None for no average; static.
        flip: share of FLIP in the particle velocity update, the rest is PIC; None for pure FLIP.
        pic_damping: rate (1/s) at which velocities decay that the grid does not resolve, see `Discretisation`; None
            for none.
        damping: mass-proportional damping (1/s); None for none.
    """

    time_step: Array
    kernel: Kernel = static()
    scheme: Scheme = static(default=Scheme.MUSL)
    engine: Engine | None = static(default=None)
    fbar: bool = static(default=False)
    cell_average: bool = static(default=False)
    gap_average: bool = static(default=False)
    bridging: bool = static(default=False)
    finite_strain: bool = static(default=False)
    xpic: int = static(default=1)
    nonlocal_passes: int | None = static(default=None)
    flip: Array | None = None
    pic_damping: Array | None = None
    damping: Array | None = None

    PARAMETERS: ClassVar[Mapping[str, Limit]] = {
        "time_step": above_zero("s"),
        "flip": Limit(least=0.0, most=1.0),
        "pic_damping": from_zero("1/s"),
        "damping": from_zero("1/s"),
    }


Numbers: TypeAlias = Any
"""An array in a scene; where a user gives it to `jaxmpm.scene`, anything that JAX makes an array of."""


@pytree
@dataclass(frozen=True)
class Boundary:
    """What constrains the nodes of a grid.

    Args:
        walls: planes that constrain nodes; static.
        friction: coefficient of walls with friction and of the base, a number or (nodes,); None for none.
        cohesion: of those (Pa), likewise.
        pressure: (nodes,) pressure of the water between these walls and the soil (Pa), below 0 under suction; None for
            none.
        tied: numbers of two planes of nodes along x that are identified: particles and waves that leave at one enter at
            the other; None for none; static.
        cut: (nodes,) bool, nodes beyond the edge of ground of any shape, at which nothing moves; None if walls are all.
        base: rigid ground of any shape, on which soil slides with the friction, cohesion and water pressure of walls;
            None if walls are all.
        softening: (2,) share of that friction and cohesion which slip leaves, and the slip (m) over which they fall to
            it; None for none.
        softens: whether slip reduces the strength of a contact with undrained soil as shear strain softens that soil,
            in a layer as thick as shear bands; static.
    """

    walls: Sequence[Wall] = static(default=())
    friction: Numbers | None = None
    cohesion: Numbers | None = None
    pressure: Numbers | None = None
    tied: tuple[int, int] | None = static(default=None)
    cut: Numbers | None = None
    base: RigidBase | None = None
    softening: Numbers | None = None
    softens: bool = static(default=False)

    AT_NODES: ClassVar[tuple[str, ...]] = ("friction", "cohesion", "pressure", "cut", "base")
    """Fields with a number for all nodes or one for each."""
    PARAMETERS: ClassVar[Mapping[str, Limit]] = {
        "friction": from_zero(),
        "cohesion": from_zero("Pa"),
        "pressure": Limit(unit="Pa"),
        "softening": from_zero(),
    }


@pytree
@dataclass(frozen=True)
class Loads:
    """What acts on the particles of a scene.

    Args:
        gravity: (d,) m/s2; `jaxmpm.scene` also takes a number, which acts downwards.
        body_force: (initial positions (d, N) m, time s) -> acceleration (d, N) m/s2 added to gravity; None for none;
            static.
        water: a `WaterTable` or `WaterSurface`; stress is then effective stress. The strength of undrained soil does
            not depend on the mean stress, so a table below the surface changes nothing there, and a pool is a pressure
            on the surface. None for none.
        pore_pressure: (N,) Pa, constant on each particle; stress is then effective stress. None without pore pressure,
            or for undrained soil in total stress.
        motion: a `BaseMotion`, the acceleration of the base, in whose frame the scene is solved; None for none.
        k0: () or (N,) horizontal over vertical effective stress from which the equilibrium at rest is reached; under a
            slope equilibrium asks for more shear. None for that of elastic loading, nu / (1 - nu). No step reads it.
    """

    gravity: Numbers = 0.0
    body_force: Callable[[Array, Array], Array] | None = static(default=None)
    water: PrescribedWater | None = None
    pore_pressure: Numbers | None = None
    motion: PrescribedMotion | None = None
    k0: Numbers | None = None

    PARAMETERS: ClassVar[Mapping[str, Limit]] = {"k0": from_zero()}


@pytree
@dataclass(frozen=True)
class Scene:
    """All that defines a run except the state it starts from.

    Args:
        grid: background grid.
        particles: initial positions, masses and volumes.
        material: constitutive law.
        numerics: numerical choices.
        boundary: what constrains the nodes.
        loads: what acts on the particles.
        free_field: level ground beyond both ends of a section without walls there; None for walls or tied sides.
    """

    grid: Grid
    particles: Particles
    material: Any  # a `Material` with the members of its own law, which callers vary
    numerics: Numerics
    boundary: Boundary
    loads: Loads
    free_field: FreeField | None = None


@pytree
@dataclass(frozen=True)
class FreeField:
    """Semi-infinite level ground beyond each end of a section in plane strain; its motion is uniform in x.

    Each end has a column of this ground, which the section does not act on. At the planes where the section ends, the
    stress of the column acts on it, and dashpots of impedance density times wave speed between its velocity and the
    column's: for P waves across the plane, for S waves along it. Waves from within leave the section: all of a wave at
    normal incidence, less of an oblique one.

    Sources: Lysmer and Kuhlemeyer (1969), doi:10.1061/JMCEA3.0001144 (dashpots); Zienkiewicz, Bicanic and Shen (1989),
    doi:10.1007/978-3-7091-2828-2_3 (free field).

    Args:
        low: column at the low end, a scene one cell wide with tied sides, on nodes at the heights of the section's.
            Gravity, motion, body force and numerical choices come from the section.
        high: column at the high end, likewise.
        reaction: (2, nz, d) force in N on the nodes of both planes, in place of the walls that held it at rest.
        planes: numbers of the planes of nodes along x at which the section ends; static.
    """

    low: Scene
    high: Scene
    reaction: Array
    planes: tuple[int, int] = static()


@pytree
@dataclass(frozen=True)
class Columns:
    """Record of the soil that has passed over each column of cells, along the horizontal axes (nx,) or (nx, ny).

    Args:
        thickness: largest thickness of moved soil in the column (m), above the surface where there is one.
        speed: largest speed of that soil (m/s), its momentum over its mass.
        arrival: first time at which the column was covered (s), inf if it was not.
        moved: displacement from which soil counts (m); static.
        least: thickness from which a column counts as covered (m); static.
        every: steps between two looks; static.
        surface: heights of the ground at nodes in plan before it moved, in cells above the lowest node; soil counts as
            far as it is above. None counts all moved soil.
    """

    thickness: Array
    speed: Array
    arrival: Array
    moved: float = static()
    least: float = static()
    every: int = static()
    surface: Array | None = None


@pytree
@dataclass(frozen=True)
class State:
    """Variables that change in time.

    Args:
        displacement: (d, N) m from the initial position.
        velocity: (d, N) m/s.
        stress: (s, N) Pa, the components that the dimension can have: xx, yy, zz in 1D, with xz in 2D, all six
            (xx, yy, zz, xy, yz, xz) in 3D.
        volume_ratio: (N,) current over initial volume.
        history: of the material, (N,) or a pytree of such arrays; None for a law without.
        step: () steps taken so far.
        status: () of the lane, see `Status`.
        affine: (d, d, N) velocity gradient of APIC (1/s); None without.
        gap: (N,) growth in volume, as a logarithm, that soil has opened under its tension cutoff and not closed since;
            None for a law without memory of it.
        unaveraged: change of the history in the last step, which the next one averages over neighbours and adds; None
            unless the scene averages it.
        columns: record of the soil over each column of cells, see `with_columns`; None without.
        free_field: states of the scene's free field, of its low and its high column; None without.
    """

    displacement: Array
    velocity: Array
    stress: Array
    volume_ratio: Array
    history: History
    step: Array
    status: Array
    affine: Array | None = None
    gap: Array | None = None
    unaveraged: History = None
    columns: Columns | None = None
    free_field: tuple[State, State] | None = None
