"""Order of a solver that resolves a covariance on an axis, chosen on the host."""

from __future__ import annotations

import math
import warnings
from dataclasses import replace

import numpy as np

from kl._checks import is_traced, require
from kl.axis._corrected import Corrected
from kl.axis._covariance import Covariance, Exponential, Infinite, Periodic, SquaredExponential, Triangular, on_host
from kl.axis._matrices import legendre_matrix, nystrom_matrix
from kl.axis._solvers import ClosedForm, Constant, Haar, Legendre, Nystrom, Solver
from kl.types import HostArray

UNRESOLVED = 0.01
"""Change of a share with the order, over the largest share, from which on an order does not resolve a length."""


def default_solver(covariance: Covariance, extent: float) -> Solver:
    """The most accurate solver for a concrete `covariance` on an axis of `extent` metres."""
    match covariance:
        case Infinite():
            return Constant()
        case Periodic() | Exponential():
            return ClosedForm()
        case Triangular() if covariance.length >= extent:
            return ClosedForm()
        case SquaredExponential() | Corrected(base=SquaredExponential()):
            return Nystrom()
    return Legendre()


def resolved(solver: Solver | None, covariance: Covariance, extent: float, remainder: float, most: int) -> Solver:
    """Fix a solver's order on the host, so that it can shape the program.

    A series without an end is cut where at most `remainder` of the variance is left along this axis, or at `most`
    modes.

    Args:
        solver: a solver, or None for the most accurate one.
        covariance: of this axis.
        extent: length of the axis (m).
        remainder: share of the variance that may be left out along this axis.
        most: largest number of modes.

    Returns:
        The solver with its order, level or count.

    Raises:
        ValueError: If the solver does not apply to the covariance, or its order, level or count is out of range.
    """
    if isinstance(covariance, Infinite):
        return Constant()
    solver = default_solver(covariance, extent) if solver is None else solver
    if isinstance(covariance, Periodic) and not isinstance(solver, ClosedForm):
        raise ValueError(f"{type(solver).__name__} cannot take a Periodic axis: leave solver=None (Fourier modes)")
    match solver:
        case Haar(level):
            require(0 <= level <= 12, f"Haar level = {level} must be 0 to 12: a level of 12 makes 4096 cells")
            cell, length = extent / 2**level, getattr(covariance, "length", extent)
            if not is_traced(length) and length < cell / 4:
                warnings.warn(
                    f"correlation length {length} m is far below the Haar cell of {cell} m, whose average loses the "
                    f"variance: raise the level above {level}",
                    stacklevel=3,
                )
            return solver
        case ClosedForm():
            return _resolved_closed_form(solver, covariance, extent, remainder, most)
        case Nystrom(order) | Legendre(order) if order is not None:
            require(1 <= order <= 2000, f"order = {order} must be 1 to 2000: leave it out to have it chosen")
            return solver
        case Nystrom() | Legendre():
            return _resolved_order(solver, covariance, extent, remainder)
    raise ValueError(f"solver = {solver!r} is none of Nystrom, Legendre, Haar, ClosedForm")


def check_resolves(solver: Solver, covariance: Covariance, before: Covariance, extent: float) -> None:
    """Check a solver that was fixed for one correlation length with a shorter one; traced lengths pass.

    Args:
        solver: with its order, level or count.
        covariance: of this axis.
        before: covariance of the same family that the solver was fixed for.
        extent: length of the axis (m).

    Raises:
        ValueError: If the solver does not resolve the covariance.
    """
    if is_traced(covariance) or is_traced(before):
        return
    new, old = (float(getattr(getattr(family, "base", family), "length", math.inf)) for family in (covariance, before))
    if not new < old:
        return
    remedy = "expand anew, with the shortest length that is to be tried"
    if isinstance(covariance, Triangular) and isinstance(solver, ClosedForm):
        require(new >= extent, f"triangular length = {new} has no closed form below the extent {extent}: {remedy}")
    if isinstance(solver, Nystrom | Legendre) and solver.order is not None:
        order = max(solver.order, min(solver.largest, _least_order(new, extent)))
        fixed, fine = (_spectrum(solver, number, on_host(covariance), extent) for number in (solver.order, order))
        leading = solver.order // 2 + 1
        require(
            float(np.max(np.abs(fine[:leading] - fixed[:leading]))) < UNRESOLVED * fine[0],
            f"correlation length = {new} m takes order {order}, the expansion of length {old} m has {solver.order}: "
            f"{remedy}",
        )


def _spectrum(solver: Nystrom | Legendre, order: int, covariance: Covariance, extent: float) -> HostArray:
    """Shares of the variance by a solver of this order, largest first, for a covariance on the host."""
    assemble = nystrom_matrix if isinstance(solver, Nystrom) else legendre_matrix
    return np.asarray(np.linalg.eigvalsh(assemble(order, extent, covariance))[::-1], np.float64)


def _least_order(length: float, extent: float) -> int:
    """Points for a correlation length (m) on an axis (m).

    A kernel of length l holds wavenumbers up to about 9 / l; Legendre needs two points in a wave.
    """
    return 8 + math.ceil(3.5 * extent / length)


def _resolved_order(solver: Nystrom | Legendre, covariance: Covariance, extent: float, remainder: float) -> Solver:
    if is_traced(covariance):
        raise ValueError("the order cannot be chosen for a traced length: give the solver's order")
    host = on_host(covariance)
    length = getattr(getattr(host, "base", host), "length", extent)
    order = min(solver.largest, _least_order(length, extent))
    coarse = _spectrum(solver, order, host, extent)
    while True:
        finer = order + max(4, order // 4)
        fine = _spectrum(solver, finer, host, extent)
        leading = order // 2 + 1
        change = float(np.max(np.abs(fine[:leading] - coarse[:leading])))
        converged = change <= solver.tolerance
        # Galerkin's trace lacks what the basis cannot hold; quadrature's is 1 by construction.
        if converged and (coarse.sum() >= 1 - remainder - 1e-9 or finer > solver.largest):
            return replace(solver, order=order)
        if finer > solver.largest:
            require(
                change < UNRESOLVED * fine[0],
                f"{type(solver).__name__}: order {order} does not resolve the correlation length {length} m on an axis "
                f"of {extent} m: give a length of {3.5 * extent / solver.largest:.2g} m or more, a higher `largest`, "
                "or `exact_lattice`",
            )
            warnings.warn(
                f"{type(solver).__name__}: eigenvalues still move by {change:.1e} of the variance at order {order} "
                f"(tolerance {solver.tolerance:.0e}): raise `largest`, loosen the tolerance or shorten the axis",
                stacklevel=4,
            )
            return replace(solver, order=order)
        order, coarse = finer, fine


def _resolved_closed_form(
    solver: ClosedForm, covariance: Covariance, extent: float, remainder: float, most: int
) -> Solver:
    match covariance:
        case Exponential() | Periodic():
            pass
        case Triangular():
            require(
                covariance.length >= extent,
                f"triangular length = {covariance.length} is below the extent {extent}, where no closed form "
                "exists: use Legendre() or Haar(level)",
            )
        case _:
            raise ValueError(f"no closed form for {type(covariance).__name__}: use Nystrom() or Legendre()")
    if solver.count is not None:
        require(1 <= solver.count <= 100_000, f"count = {solver.count} must be 1 to 100,000")
        return solver
    if is_traced(covariance):
        raise ValueError("the number of modes cannot be chosen for a traced length: give ClosedForm(count=...)")
    most = min(most, solver.largest)
    if isinstance(covariance, Periodic):
        wave: HostArray = 2 * np.pi * np.arange(1, most + 1, dtype=np.float64) / extent
        host = on_host(covariance)
        energy = np.cumsum(np.append(host.spectral_density(np.zeros(1)), 2 * host.spectral_density(wave))) / extent
        return replace(solver, count=min(2 * int(np.searchsorted(energy, 1 - remainder)) + 1, most))
    # Eigenvalues fall as 2 L / (l pi^2 k^2): the tail from k on holds 2 L / (l pi^2 k).
    needed = 2 + 2 * extent / (float(covariance.length) * math.pi**2 * max(remainder, 1e-12))
    return replace(solver, count=min(math.ceil(needed), most))
