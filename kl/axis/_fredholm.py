"""Eigenpairs of the covariance operator along one axis (a Fredholm equation of the second kind).

integral over the axis of c(x - y) f(y) dy = lambda f(x)

Solvers are static: they determine the program. Eigenpairs are decomposed in jnp from the covariance, whose length may
be traced, so a field can be differentiated with respect to its correlation length. The order that reaches a tolerance
depends on values; it is chosen on the host in NumPy before that.

Sources: Ghanem and Spanos (1991), doi:10.1007/978-1-4612-3094-6, Eq. 2.27; comparison of the methods: Betz,
Papaioannou and Straub (2014), doi:10.1016/j.cma.2013.12.010.
"""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass, replace
from functools import lru_cache, partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from foundation import check
from foundation.check import is_traced, require
from kl.axis._closed_form import exponential_modes, periodic_modes, triangular_modes
from kl.axis._covariance import (
    Corrected,
    Covariance,
    Exponential,
    Infinite,
    Periodic,
    SquaredExponential,
    Triangular,
    on_host,
)
from kl.axis._modes import AxisModes, CellModes, LegendreModes, SineModes
from kl.types import EitherArray, HostArray


@dataclass(frozen=True)
class Nystrom:
    """Gauss-Legendre quadrature of the integral.

    It converges spectrally for a smooth kernel (squared exponential), with second order for one with a kink at lag 0.
    Eigenfunctions are the polynomials through the quadrature points, so no small eigenvalue is divided by.

    Source: Betz, Papaioannou and Straub (2014), doi:10.1016/j.cma.2013.12.010, Section 3.1.

    Args:
        order: number of quadrature points; None raises it until none of the leading half of the eigenvalues, over the
            extent, changes by more than `tolerance` when the order grows by a quarter.
        tolerance: largest change of an eigenvalue, as a share of the variance.
        largest: order at which the search ends with a warning.
    """

    order: int | None = None
    tolerance: float = 1e-8
    largest: int = 400


@dataclass(frozen=True)
class Legendre:
    """Legendre-Galerkin with the inner integral split at lag 0, where most kernels have a kink.

    Gauss's rule integrates a smooth function on both parts, so the method stays spectral for the Matern, Markov and
    cosine-exponential families.

    Args:
        order: number of polynomials; None raises it as in `Nystrom`, and until the basis holds the variance that the
            truncation requires.
        tolerance: largest change of an eigenvalue, as a share of the variance.
        largest: order at which the search ends with a warning.
    """

    order: int | None = None
    tolerance: float = 1e-8
    largest: int = 160


@dataclass(frozen=True)
class Haar:
    """Haar wavelet-Galerkin with 2^level functions.

    The Haar functions up to a level span the piecewise constants on 2^level equal cells. The fast wavelet transform is
    the orthogonal map between the two bases: it turns the matrix of cell averages into the wavelet matrix and
    eigenvectors back, and leaves eigenvalues and eigenfunctions unchanged. So the eigenproblem is solved on the cells;
    `haar_transform` is needed only to see wavelet coefficients. The method is of second order in the cell size, and the
    captured variance lies below the exact one.

    Sources: Phoon, Huang and Quek (2002), doi:10.1016/S0266-8920(02)00013-9; Jiang et al. (2024),
    doi:10.1016/j.compgeo.2024.106413, Eqs. 7 to 14.

    Args:
        level: 0 to 12.
    """

    level: int


@dataclass(frozen=True)
class ClosedForm:
    """Roots of the characteristic equation: Exponential, Periodic, and Triangular at least as long as the axis.

    Args:
        count: number of modes; None takes as many as the truncation may need.
        largest: limit of that number.
    """

    count: int | None = None
    largest: int = 4000


@dataclass(frozen=True)
class Constant:
    """The single mode of an axis along which the field does not vary."""


Solver = Nystrom | Legendre | Haar | ClosedForm | Constant


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


def _resolved_order(solver: Nystrom | Legendre, covariance: Covariance, extent: float, remainder: float) -> Solver:
    if is_traced(covariance):
        raise ValueError("the order cannot be chosen for a traced length: give the solver's order")
    host = on_host(covariance)
    assemble = _nystrom_matrix if isinstance(solver, Nystrom) else _legendre_matrix

    def spectrum(order: int) -> HostArray:
        return np.asarray(np.linalg.eigvalsh(assemble(order, extent, host))[::-1], np.float64)

    # A kernel of length l holds wavenumbers up to about 9 / l; Legendre needs two points in a wave.
    length = getattr(getattr(host, "base", host), "length", extent)
    order = min(solver.largest, 8 + math.ceil(3.5 * extent / length))
    coarse = spectrum(order)
    while True:
        finer = order + max(4, order // 4)
        fine = spectrum(finer)
        leading = order // 2 + 1
        change = float(np.max(np.abs(fine[:leading] - coarse[:leading])))
        converged = change <= solver.tolerance
        # Galerkin's trace lacks what the basis cannot hold; quadrature's is 1 by construction.
        if converged and (coarse.sum() >= 1 - remainder - 1e-9 or finer > solver.largest):
            return replace(solver, order=order)
        if finer > solver.largest:
            require(
                change < 0.01 * fine[0],
                f"{type(solver).__name__}: order {order} does not resolve the correlation length {length} m on an axis "
                f"of {extent} m: raise `largest`, use a longer length, or `exact_lattice`",
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
        held = np.cumsum(np.append(host.spectral_density(np.zeros(1)), 2 * host.spectral_density(wave))) / extent
        return replace(solver, count=min(2 * int(np.searchsorted(held, 1 - remainder)) + 1, most))
    # Eigenvalues fall as 2 L / (l pi^2 k^2): the tail from k on holds 2 L / (l pi^2 k).
    needed = 2 + 2 * extent / (float(covariance.length) * math.pi**2 * max(remainder, 1e-12))
    return replace(solver, count=min(math.ceil(needed), most))


def axis_modes(covariance: Covariance, solver: Solver, origin: float, extent: float) -> AxisModes:
    """All eigenpairs that a resolved solver gives on [origin, origin + extent].

    Pure jnp in the covariance's length, whose dtype it follows. Each function is positive at the origin, so that
    coefficients mean the same for every solver, precision and machine.

    Args:
        covariance: of this axis.
        solver: with its order, from `resolved`.
        origin: start of the axis (m).
        extent: its length (m).

    Returns:
        The modes, largest first.

    Raises:
        ValueError: If the solver has no order yet.
    """
    match solver:
        case Constant():
            one = jnp.ones(1)
            return SineModes(one, 0 * one, 0 * one, one, origin, extent)
        case ClosedForm(count=int() as count):
            match covariance:
                case Exponential():
                    return exponential_modes(covariance, count, origin, extent)
                case Triangular():
                    return triangular_modes(covariance, count, origin, extent)
                case Periodic():
                    return periodic_modes(covariance, count, origin, extent)
        case Haar(level):
            fractions, vectors = _eigenpairs(_haar_matrix(level, extent, covariance))
            cells = vectors.shape[0]
            levels = vectors.T * math.sqrt(cells)
            return CellModes(fractions, levels * _signs(levels[:, 0])[:, None], origin, extent)
        case Nystrom(order=int() as order):
            fractions, vectors = _eigenpairs(_nystrom_matrix(order, extent, covariance))
            _, _, basis = _gauss(order)
            vectors = jnp.asarray(basis, vectors.dtype) @ vectors
        case Legendre(order=int() as order):
            fractions, vectors = _eigenpairs(_legendre_matrix(order, extent, covariance))
        case _:
            raise ValueError(f"{solver!r} has no order yet: pass it through `resolved`")
    alternating = (-1.0) ** np.arange(order) * np.sqrt(2 * np.arange(order) + 1)
    at_origin = jnp.asarray(alternating, vectors.dtype) @ vectors
    return LegendreModes(fractions, (vectors * _signs(at_origin)).T, origin, extent)


def _signs(values: Array) -> Array:
    return jnp.where(jax.lax.stop_gradient(values) < 0, -1, 1).astype(values.dtype)


@lru_cache(maxsize=64)
def _gauss(order: int) -> tuple[HostArray, HostArray, HostArray]:
    """Gauss points and weights (order,) on [0, 1], and p_k(point q) sqrt(weight q) (order, order), orthogonal."""
    points, weights = np.polynomial.legendre.leggauss(order)
    values = np.polynomial.legendre.legvander(points, order - 1).T * np.sqrt(2 * np.arange(order) + 1)[:, None]
    weights = np.asarray(weights / 2, np.float64)
    return (points + 1) / 2, weights, np.asarray(values * np.sqrt(weights), np.float64)


def _nystrom_matrix(order: int, extent: float, covariance: Covariance) -> EitherArray:
    """Matrix sqrt(w_i) c(x_i - x_j) sqrt(w_j), whose eigenvalues are fractions of the variance."""
    points, weights, _ = _gauss(order)
    roots = np.sqrt(weights)
    return covariance(np.abs(points[:, None] - points) * extent) * (roots[:, None] * roots)


@lru_cache(maxsize=4)
def _split_rule(order: int) -> tuple[HostArray, HostArray, HostArray]:
    """Quadrature over 0 < y < x < 1: lags (q, s), p_m(x_q) w_q x_q (order, q), p_n(y_qs) w_s (order, q, s)."""
    points, weights, _ = _gauss(order + 8)
    inner = points[:, None] * points
    norms = np.sqrt(2 * np.arange(order) + 1)
    outer_values = np.polynomial.legendre.legvander(2 * points - 1, order - 1).T * norms[:, None]
    inner_values = np.moveaxis(np.polynomial.legendre.legvander(2 * inner - 1, order - 1), -1, 0)
    return (
        points[:, None] - inner,
        outer_values * (weights * points),
        inner_values * norms[:, None, None] * weights,
    )


def _legendre_matrix(order: int, extent: float, covariance: Covariance) -> EitherArray:
    """Galerkin matrix in Legendre polynomials; the part y > x mirrors y < x with sign (-1)^(m + n)."""
    lags, outer, inner = _split_rule(order)
    # A copy: JAX caches an array in the precision of its first use, and this rule outlives a change of precision.
    kernel = covariance(lags.copy() * extent)
    if isinstance(kernel, jax.Array):
        sums = (jnp.asarray(inner, kernel.dtype) * kernel).sum(-1)
        lower: EitherArray = jnp.asarray(outer, kernel.dtype) @ sums.T
    else:
        lower = outer @ np.einsum("nqs,qs->qn", inner, kernel)
    parity = (-1.0) ** np.arange(order)
    matrix = lower * (1 + parity[:, None] * parity)
    return (matrix + matrix.T) / 2


def _haar_matrix(level: int, extent: float, covariance: Covariance) -> EitherArray:
    """Averages of the covariance over pairs of cells, divided by the number of cells; a Toeplitz matrix.

    The average over cells k apart is the integral of (1 - |s|) c((k + s) h), s in [-1, 1], by Gauss's rule on each
    half, so that a kink at lag 0 falls on an end.
    """
    cells = 2**level
    points, weights, _ = _gauss(16)
    apart = np.arange(cells)[:, None]
    size = extent / cells
    below = covariance(np.abs(apart - points) * size)
    above = covariance((apart + points) * size)
    averages = (below + above) @ (weights * (1 - points)).astype(below.dtype)
    return averages[np.abs(np.arange(cells)[:, None] - np.arange(cells))] / cells


def haar_transform(cell_values: ArrayLike) -> Array:
    """Orthonormal Haar coefficients of values on cells, by the fast wavelet transform along the last axis.

    The transform takes O(n) operations; it is orthogonal, so its transpose inverts it.

    Args:
        cell_values: (..., 2^level), finite.

    Returns:
        Coefficients (..., 2^level), coarsest first: the mean, then 1, 2, 4 ... wavelets.

    Raises:
        ValueError: If the last axis is not a power of 2 long, or a value is not finite.
    """
    details = []
    smooth = jnp.asarray(cell_values)
    count = smooth.shape[-1] if smooth.ndim else 0
    require(count >= 1 and count & (count - 1) == 0, f"{count} values along the last axis: give 2^level of them")
    check.finite("cell values", smooth)
    while smooth.shape[-1] > 1:
        left, right = smooth[..., 0::2], smooth[..., 1::2]
        details.append((left - right) / math.sqrt(2))
        smooth = (left + right) / math.sqrt(2)
    return jnp.concatenate([smooth, *details[::-1]], axis=-1)


@jax.custom_jvp
def _eigenpairs(matrix: Array) -> tuple[Array, Array]:
    """Eigenvalues (n,), descending, and eigenvectors (n, n), in columns, of a symmetric matrix."""
    values, vectors = jnp.linalg.eigh(matrix)
    return values[::-1], vectors[:, ::-1]


@_eigenpairs.defjvp
def _eigenpairs_derivative(
    primals: tuple[Array], tangents: tuple[Array]
) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """First-order perturbation, finite where eigenvalues agree to rounding.

    1 / gap becomes gap / (gap^2 + width^2): vectors in a cluster narrower than rounding can resolve are not rotated,
    and no sum that is invariant under such a rotation changes.
    """
    (matrix,), (tangent,) = primals, tangents
    values, vectors = _eigenpairs(matrix)
    inner = vectors.T @ tangent @ vectors
    gap = values[None, :] - values[:, None]
    width = 4 * jnp.finfo(values.dtype).eps * matrix.shape[0] * jnp.abs(values[0])
    turn = gap / (gap**2 + width**2 + jnp.finfo(values.dtype).tiny) * inner
    return (values, vectors), (jnp.diagonal(inner), vectors @ turn)


def all_axis_modes(
    covariance: tuple[Covariance, ...],
    solvers: tuple[Solver, ...],
    origin: tuple[float, ...],
    extent: tuple[float, ...],
) -> tuple[AxisModes, ...]:
    """Modes of every axis in one program, which serves boxes of every position and size.

    Args:
        covariance: d, one per axis.
        solvers: d, from `resolved`.
        origin: d starts of the axes (m).
        extent: d lengths of the axes (m).

    Returns:
        d sets of modes, as of `axis_modes`.
    """
    boxes = zip(_all_from_zero(covariance, solvers, extent), origin, extent, strict=True)
    return tuple(replace(modes, origin=start, extent=size) for modes, start, size in boxes)


@partial(jax.jit, static_argnames="solvers")
def _all_from_zero(
    covariance: tuple[Covariance, ...], solvers: tuple[Solver, ...], extent: tuple[float, ...]
) -> tuple[AxisModes, ...]:
    """Modes whose axes start at 0. Extents are traced here and static in the modes, so these get an extent of 1 m."""
    axes = zip(covariance, solvers, extent, strict=True)
    return tuple(replace(axis_modes(each, solver, 0.0, size), extent=1.0) for each, solver, size in axes)
