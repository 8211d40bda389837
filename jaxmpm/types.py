"""The data of a simulation: frozen pytrees, static where the program depends on them, dynamic elsewhere.

Particle arrays are component first: ``(d, N)`` with d the dimension, so that each component is contiguous.
Axes are x in 1D, (x, z) in 2D plane strain and (x, y, z) in 3D. Absent physics is ``None``. SI units.
"""

from __future__ import annotations

import enum
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal, Protocol, TypeAlias

from jax import Array

from foundation.check import Limit, above_zero, from_zero
from foundation.pytrees import pytree

Component: TypeAlias = Array | float
"""A component of a tensor; one that the dimension cannot have is the number 0.0, which vanishes in the program."""

Tensor: TypeAlias = tuple[Component, Component, Component, Component, Component, Component]
"""Symmetric tensor as its six components (xx, yy, zz, xy, yz, xz); a component absent in 1D or 2D is 0.0."""


def static(**kwargs: Any) -> Any:
    """A dataclass field that shapes the program: hashable, part of the compilation key."""
    return field(metadata={"static": True}, **kwargs)


class Kernel(Protocol):
    """Shape functions of the nodes around a particle: static, so a frozen dataclass of hashable values.

    They may reach one and a half cells from their node, and those of the three nodes around a particle add up to 1.
    """

    @classmethod
    def of_spacing(cls, spacing: tuple[float, ...]) -> Kernel:
        """The kernel for particles this far apart along each axis (m)."""

    def shape(self, axis: int, cell: float, r: Array) -> tuple[Array, Array]:
        """Value and derivative (1/m) of a node's function at r = (x - x_node) / cell along an axis."""

    def deviation(self, cell: float) -> float:
        """Standard deviation (m) of the bell that mapping to the grid and back spreads a particle's value over."""


class Engine(enum.Enum):
    """What runs the transfers between particles and grid."""

    XLA = "scatter and gather as XLA compiles them, on any device"
    NATIVE = "compiled kernels, on CPU"


class Scheme(enum.Enum):
    """When the stress is updated within a step: first, last, or last with velocities mapped again."""

    USF = "update stress first"
    USL = "update stress last"
    MUSL = "modified update stress last"


class Status(enum.IntEnum):
    """Where a lane stands. Anything above DECIDED has failed, and its state is that of its last step.

    DECIDED: its displacement passed the limit at which the caller wanted to know no more. BAD_PARAMETER: a number of
    its scene is not finite or beyond its limit, so that no step was taken. Files keep names and numbers: new ones go to
    the end.
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


@pytree
@dataclass(frozen=True)
class Grid:
    """Regular background grid.

    shape: nodes per axis. cell: edge of a cell (m). origin: position of node 0 (m).
    """

    shape: tuple[int, ...] = static()
    cell: float = static()
    origin: tuple[float, ...] = static()

    @property
    def dimension(self) -> int:
        """Number of axes: 1, 2 or 3."""
        return len(self.shape)

    @property
    def nodes(self) -> int:
        """Number of nodes; a node's number runs fastest along the last axis."""
        total = 1
        for n in self.shape:
            total *= n
        return total


@dataclass(frozen=True)
class Wall:
    """A plane normal to one axis that holds the nodes on it and beyond it.

    axis: index of the normal's axis. side: "low" holds nodes up to `index`, "high" from `index` on.
    index: node number of the plane along the axis. hold: "fixed" stops all motion, "roller" the normal one, "friction"
    what goes into it, and brakes what slides along it (Coulomb, with cohesion where the scene has some).
    """

    axis: int
    side: Literal["low", "high"]
    index: int
    hold: Literal["fixed", "roller", "friction"]


@pytree
@dataclass(frozen=True)
class Particles:
    """What a particle keeps throughout: initial position (d, N) m, mass (N,) kg, initial volume (N,) m3.

    In plane strain masses and volumes are per metre of width, in 1D per square metre of section.
    """

    position: Array
    mass: Array
    volume: Array

    PARAMETERS: ClassVar[Mapping[str, Limit]] = {"mass": above_zero("kg"), "volume": above_zero("m3")}


class Material(Protocol):
    """A constitutive law: a frozen pytree of parameters, each a number or one value per particle (N,).

    All that the package asks of a law; `Law` is a base class with what most laws share.
    """

    PARAMETERS: ClassVar[Mapping[str, Limit]]
    """What values the parameters may have, each a `Limit`, or a `Parameter` where strength reduction, a campaign or the
    thickness of shear bands concern it; those that are not named here may have any that is finite."""

    @property
    def FRICTIONAL(self) -> bool:
        """Whether strength depends on the mean stress, which F-bar would average; of most laws a class variable."""

    @property
    def bulk(self) -> Array:
        """Elastic bulk modulus K (Pa), of the initial stress and the energy stored."""

    @property
    def shear(self) -> Array:
        """Elastic shear modulus G (Pa), likewise."""

    @property
    def p_wave_modulus(self) -> Array:
        """Modulus of the fastest elastic wave (Pa), K + 4G/3 of an isotropic law: it sets the time step."""

    @property
    def steepest_softening(self) -> Array | None:
        """Largest loss of shear strength per unit of plastic shear strain (Pa), which must stay below G; None where the
        law does not soften."""

    def initial_history(self, particles: Particles) -> Any:
        """The history of undisturbed particles, an array (N,) or a pytree of them, or None where the law has none."""

    def reduced(self, factor: Array) -> Any:
        """The law with its strength divided by `factor`: peak, residual, and the tangent of friction."""

    def update(
        self, strain_increment: Tensor, stress: Tensor, history: Any, dt: Array | None = None
    ) -> tuple[Tensor, Any]:
        """Stress (Pa) and history after a strain increment within dt (s), which rate-dependent laws need.

        Tensors have six components (xx, yy, zz, xy, yz, xz), tension positive; absent ones are the number 0.0.
        """


@pytree
@dataclass(frozen=True)
class Scene:
    """All that defines a run except the state it starts from.

    grid: of nodes. particles: their initial positions, masses and volumes. material: their constitutive law. kernel:
    shape function. walls: where nodes are held. scheme: when the stress is updated.
    gravity: (d,) m/s2. time_step: s. flip: share of FLIP in the particle velocity update, the rest is PIC;
    None is pure FLIP. damping: mass-proportional damping (1/s); None is undamped. engine: of the transfers, None
    takes the fastest there is. wall_friction: coefficient of the walls with friction. wall_cohesion: their cohesion
    (Pa), wall_pressure: (nodes,) Pa, of the water between them and the soil; None without.
    fbar: whether volumetric strain and mean stress are averaged over neighbouring particles, against locking.
    cell_average: whether the volumetric strain alone is averaged, over each cell. finite_strain: whether elasticity is
    that of Hencky strains, not hypoelastic by the Jaumann rate; yield is then of J times the stress.
    nonlocal_passes: filters in the average of the plastic strain over neighbours, see `jaxmpm.averages`; None keeps it
    local.
    body_force: (initial positions (d, N) m, time s) -> acceleration (d, N) m/s2 added to gravity's.
    water: a `WaterTable` or `WaterSurface`; pore_pressure: (N,) Pa that particles carry along. With either, stress is
    effective stress; None is soil without pore pressure, or undrained soil in total stress.
    cut: (nodes,) bool, nodes beyond the edge of ground of any shape, at which nothing moves; None where walls are all.
    motion: a `BaseMotion`, the acceleration of the base, in whose frame the scene is solved; None stands still.
    tied: numbers of two planes of nodes along x that are one: what leaves at one enters at the other, waves too.
    free_field: the ground beyond both ends of a section that ends without walls; None for walls or tied sides.
    """

    grid: Grid
    particles: Particles
    material: Any  # a `Material`, and what its law adds: callers vary parameters that only they know
    gravity: Array
    time_step: Array
    kernel: Kernel = static()
    walls: tuple[Wall, ...] = static(default=())
    scheme: Scheme = static(default=Scheme.MUSL)
    engine: Engine | None = static(default=None)
    fbar: bool = static(default=False)
    cell_average: bool = static(default=False)
    finite_strain: bool = static(default=False)
    nonlocal_passes: int | None = static(default=None)
    body_force: Callable[[Array, Array], Array] | None = static(default=None)
    tied: tuple[int, int] | None = static(default=None)
    flip: Array | None = None
    damping: Array | None = None
    wall_friction: Array | None = None
    wall_cohesion: Array | None = None
    wall_pressure: Array | None = None
    water: Any = None
    pore_pressure: Array | None = None
    motion: Any = None
    cut: Array | None = None
    free_field: FreeField | None = None

    PARAMETERS: ClassVar[Mapping[str, Limit]] = {
        "time_step": above_zero("s"),
        "flip": Limit(least=0.0, most=1.0),
        "damping": from_zero("1/s"),
        "wall_friction": from_zero(),
        "wall_cohesion": from_zero("Pa"),
        "wall_pressure": from_zero("Pa"),
    }


@pytree
@dataclass(frozen=True)
class FreeField:
    """Level ground without end beyond both ends of a section in plane strain: what shakes it shakes it alike along x.

    low, high: for each end a column of it, a scene one cell wide with tied sides, on nodes as high as the section's.
    They take gravity, motion, body force and numerical choices from the section, which does not act on them. planes:
    numbers of the planes of nodes along x at which the section ends. There the stress of the column acts on it, and
    dashpots of impedance density times wave speed between its velocity and the column's, P waves across the plane,
    S waves along it: waves that come from within go out, all of one that meets the plane squarely, less of one that
    comes aslant. held: force (2, nz, d) N on the nodes of both planes, which keeps the section at rest that walls held
    until then.
    Sources: Lysmer and Kuhlemeyer (1969), 10.1061/JMCEA3.0001144 (the dashpots); Zienkiewicz, Bicanic and Shen (1989),
    10.1007/978-3-7091-2828-2_3 (the free field).
    """

    low: Scene
    high: Scene
    held: Array
    planes: tuple[int, int] = static()


@pytree
@dataclass(frozen=True)
class Columns:
    """What has passed over each column of cells by now, along the horizontal axes (nx,) or (nx, ny).

    thickness: largest thickness of the soil in it that has moved (m). speed: its largest speed (m/s), that of its
    momentum over its mass. arrival: when it first was there (s), inf where it was not. moved: displacement from which
    on soil counts (m). least: thickness from which on it counts as there (m). every: steps from one look to the next.
    """

    thickness: Array
    speed: Array
    arrival: Array
    moved: float = static()
    least: float = static()
    every: int = static()


@pytree
@dataclass(frozen=True)
class State:
    """What changes in time, per particle unless said otherwise.

    displacement: (d, N) m from the initial position. velocity: (d, N) m/s.
    stress: (s, N) Pa, the components that the dimension can have: xx, yy, zz in 1D, with xz in 2D, all six
    (xx, yy, zz, xy, yz, xz) in 3D. volume_ratio: (N,) current over initial volume.
    history: of the material, (N,), or None. gap: (N,) growth in volume, a logarithm, that soil has opened under its
    tension cutoff and not closed since; None where it does not remember it. step: steps taken so far. status: of the
    lane, see `Status`.
    affine: (d, d, N) gradient of the velocity that APIC carries (1/s), None without. columns: what has passed over each
    column of cells, None where nobody asked, see `with_columns`. free_field: states of the scene's
    free field, of its low column and its high one, None without.
    """

    displacement: Array
    velocity: Array
    stress: Array
    volume_ratio: Array
    history: Any
    step: Array
    status: Array
    affine: Array | None = None
    gap: Array | None = None
    columns: Columns | None = None
    free_field: tuple[State, State] | None = None
