"""Numerical choices: cell, particles, kernel, scheme, and cures for locking and dependence on the cell."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import jax
import numpy as np
from jax.typing import DTypeLike

from jaxmpm.protocols import Kernel
from jaxmpm.soil import AnySoil
from jaxmpm.support import check
from jaxmpm.support.tracing import require_known
from jaxmpm.support.values import by_value
from jaxmpm.transfer import GIMP, QuadraticBSpline, length_of_band
from jaxmpm.types import Scheme

RESOLVED = 1e-3
"""Required precision of a particle's position, as a share of its size."""
USL_CFL = 0.72
"""Largest stable CFL number of USL, of one particle a cell; USF and MUSL are stable beyond 1 (benchmarks/stability)."""


@by_value
@dataclass(frozen=True)
class Discretisation:
    """Cell, particle spacing and numerical choices.

    Args:
        cell: edge of a cell (m).
        spacing: of particles along each axis (m), at most a cell.
        kernel: class of the shape functions: GIMP (domain of one spacing), Linear, QuadraticBSpline or a user's own,
            see `Kernel`.
        scheme: when the stress is updated.
        cfl: dt = cfl cell / (c + speed), c the elastic wave speed; below 1, with USL at most 0.72.
        flip: share of FLIP; 1 is pure FLIP.
        pic_damping: with flip = 1, rate (1/s) at which velocities decay that particles have and the grid does not
            resolve. The share of PIC in a step is 1 - exp(-pic_damping dt). So it does not grow with the number of
            steps, and the loss of resolved motion falls with the square of the cell.
        xpic: order m of XPIC(m). The share of PIC in a step keeps what m transfers to the grid and back resolve: 1 is
            PIC, and more transfers dissipate less of what the grid resolves in part. Each one above 1 adds a transfer
            to the grid and one back to the step.
        apic: carry the velocity gradient; needs quadratic B-splines and flip = 0.
        damping: mass-proportional (1/s).
        cell_average: average the volumetric strain over each cell, against locking, and in soil without friction the
            mean stress that acts; None does so for frictional soils in 2D and 3D. See `cell_independent`.
        fbar: instead, average both over neighbours; not for frictional soils.
        bridging: shear stress of undrained soil on level planes crosses gaps between soils undiminished: a cell that is
            less full than those above and below acts as one as full as they are. A step of clay takes some 14 % longer.
        finite_strain: Hencky strains with exponential return mapping, for elastic strains of hundredths and more, at
            which the hypoelastic stress of the Jaumann rate creates or loses energy.
        internal_length: standard deviation (m) of the average of the plastic strain over neighbours, which prevents
            softening from localising into single cells; its bands are 2.5 times as thick. None for no average. See
            `cell_independent`.
        air: height of the grid above the highest ground (m), rounded up to whole cells. Soil that is thrown higher
            leaves the grid. None for one cell, and for a throw at the speed that the time step allows for on terrain
            whose nodes are stored near the soil alone (`follow_soil`), where air costs nothing.
        dtype: float32 or float64; None for that of JAX.
    """

    cell: float
    spacing: tuple[float, ...]
    kernel: type[Kernel] = GIMP
    scheme: Scheme = Scheme.MUSL
    cfl: float = 0.5
    flip: float = 1.0
    pic_damping: float = 0.0
    xpic: int = 1
    apic: bool = False
    damping: float = 0.0
    cell_average: bool | None = None
    fbar: bool = False
    bridging: bool = False
    finite_strain: bool = False
    internal_length: float | None = None
    air: float | None = None
    dtype: DTypeLike | None = None


def cells_up(discretisation: Discretisation, height: float) -> int:
    """Cells of a grid from the base up to the highest ground and through the air above it.

    Args:
        discretisation: cell and air.
        height: of the highest ground above the base (m).

    Returns:
        The number.
    """
    cell = discretisation.cell
    air = cell if discretisation.air is None else discretisation.air
    return sum(math.ceil(part / cell * (1 - 1e-12)) for part in (height, air))


def kernel_of(discretisation: Discretisation) -> Kernel:
    """The kernel for particles of this spacing."""
    return discretisation.kernel.of_spacing(tuple(discretisation.spacing))


def cell_independent(discretisation: Discretisation, soil: AnySoil) -> Discretisation:
    """Choices that make results independent of the cell: averages of volumetric and of plastic strain.

    The volumetric strain is averaged over cells in 2D and 3D, unless the choices have `fbar` or `cell_average`. Plastic
    strain is averaged if soil softens and has a `softening_length`, so that bands are as thick as that. On cells too
    large for it they stay a cell thick, and softening is scaled.

    Args:
        discretisation: cell, spacing and numerical choices.
        soil: to run.

    Returns:
        The choices with `cell_average` and `internal_length` set.
    """
    length, band = None, getattr(soil, "softening_length", None)
    if getattr(soil, "softens", False) and band not in (None, "cell"):
        averaging = length_of_band(band)
        length = averaging if averaging >= kernel_of(discretisation).deviation(discretisation.cell) else None
    average = discretisation.cell_average
    if average is None:
        average = not discretisation.fbar and len(discretisation.spacing) > 1
    return replace(discretisation, cell_average=average, internal_length=length)


def check_resolved(what: str, corner: Sequence[float], extent: Sequence[float], discretisation: Discretisation) -> None:
    """Check that a box of ground is close enough to the origin for the precision of particle positions.

    Args:
        what: name of the ground in messages.
        corner: lowest corner (m).
        extent: edges (m).
        discretisation: spacing and dtype.

    Raises:
        ValueError: If it is too far.
    """
    dtype = check.dtype(discretisation.dtype or jax.dtypes.canonicalize_dtype(float))
    far = [max(abs(low), abs(low + length)) for low, length in zip(corner, extent, strict=True)]
    axis = int(np.argmax(far))
    resolved = float(np.finfo(dtype).eps) * far[axis]
    if resolved > RESOLVED / 4 * min(discretisation.spacing):
        name = {2: "xz", 3: "xyz"}.get(len(far), "z")[axis]
        raise ValueError(
            f"{what} lies at {name} = {corner[axis]:g} to {corner[axis] + extent[axis]:g} m, which {dtype} resolves to "
            f"{resolved:.1g} m only: measure from a corner of {what}, in metres"
        )


def check_discretisation(discretisation: Discretisation, dimension: int) -> None:
    """Check numerical choices.

    Args:
        discretisation: to check.
        dimension: number of axes.

    Raises:
        Faults: All choices that are invalid, or do not go together.
    """
    require_known(
        {"discretisation": discretisation},
        "differentiate by flip, damping and time step with `replace(scene, numerics=...)`",
    )
    gathered = check.Gathered()
    with gathered.of():
        _check_cells(discretisation, dimension)
    with gathered.of():
        _check_kernel(discretisation)
    with gathered.of():
        _check_scheme(discretisation)
    with gathered.of():
        _check_pic(discretisation)
    with gathered.of():
        check.not_negative("damping", discretisation.damping, "1/s")
    with gathered.of():
        if discretisation.air is not None:
            check.positive("air", discretisation.air, "m")
    gathered.raise_all()


def _check_cells(discretisation: Discretisation, dimension: int) -> None:
    check.positive("cell", discretisation.cell, "m")
    check.axes("spacing", discretisation.spacing, dimension)
    check.positive("spacing", discretisation.spacing, "m")
    wide = [s for s in discretisation.spacing if s > discretisation.cell * (1 + 1e-12)]
    if wide:
        raise ValueError(
            f"spacing = {wide[0]:g} m leaves gaps in cells of {discretisation.cell:g} m: give at most the cell"
        )


def _check_kernel(discretisation: Discretisation) -> None:
    if not isinstance(discretisation.kernel, type) or not hasattr(discretisation.kernel, "of_spacing"):
        raise ValueError(
            f"kernel = {discretisation.kernel!r}: give GIMP, Linear, QuadraticBSpline or a class with `of_spacing`"
        )
    if discretisation.apic and (discretisation.kernel is not QuadraticBSpline or discretisation.flip != 0):
        raise ValueError("apic = True: give kernel = QuadraticBSpline and flip = 0 with it")


def _check_scheme(discretisation: Discretisation) -> None:
    if not isinstance(discretisation.scheme, Scheme):
        raise ValueError(f"scheme = {discretisation.scheme!r}: give a member of Scheme")
    check.between("cfl", discretisation.cfl, 0.0, 1.0)
    if discretisation.scheme is Scheme.USL and discretisation.cfl > USL_CFL:
        raise ValueError(
            f"cfl = {discretisation.cfl:g} with scheme = USL, which is stable up to {USL_CFL:g}: give at most that, or "
            "take MUSL"
        )


def _check_pic(discretisation: Discretisation) -> None:
    check.between("flip", discretisation.flip, 0.0, 1.0, ends=True)
    check.not_negative("pic_damping", discretisation.pic_damping, "1/s")
    if discretisation.pic_damping and discretisation.flip != 1:
        raise ValueError(
            f"pic_damping = {discretisation.pic_damping:g} 1/s with flip = {discretisation.flip:g}: both set the share "
            "of PIC, leave one of them out"
        )
    check.whole("xpic", discretisation.xpic)
    if discretisation.xpic > 1 and (discretisation.apic or not (discretisation.flip < 1 or discretisation.pic_damping)):
        raise ValueError(
            f"xpic = {discretisation.xpic} filters the share of PIC: give flip below 1 or pic_damping with it, "
            "and no apic"
        )
