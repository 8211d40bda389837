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
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from kl.axis._closed_form import exponential_modes, periodic_modes, triangular_modes
from kl.axis._covariance import Covariance, Exponential, Periodic, Triangular
from kl.axis._matrices import gauss, haar_matrix, legendre_matrix, nystrom_matrix
from kl.axis._modes import AxisModes, CellModes, LegendreModes, SineModes, SolvedModes
from kl.axis._solvers import ClosedForm, Constant, Haar, Legendre, Nystrom, Solver


def axis_modes(covariance: Covariance, solver: Solver, origin: float, extent: float) -> SolvedModes:
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
            fractions, vectors = _eigenpairs(haar_matrix(level, extent, covariance))
            cells = vectors.shape[0]
            levels = vectors.T * math.sqrt(cells)
            return CellModes(fractions, levels * _signs(levels[:, 0])[:, None], origin, extent)
        case Nystrom(order=int() as order):
            fractions, vectors = _eigenpairs(nystrom_matrix(order, extent, covariance))
            _, _, basis = gauss(order)
            vectors = jnp.asarray(basis, vectors.dtype) @ vectors
        case Legendre(order=int() as order):
            fractions, vectors = _eigenpairs(legendre_matrix(order, extent, covariance))
        case _:
            raise ValueError(f"{solver!r} has no order yet: pass it through `resolved`")
    alternating = (-1.0) ** np.arange(order) * np.sqrt(2 * np.arange(order) + 1)
    at_origin = jnp.asarray(alternating, vectors.dtype) @ vectors
    return LegendreModes(fractions, (vectors * _signs(at_origin)).T, origin, extent)


def _signs(values: Array) -> Array:
    return jnp.where(jax.lax.stop_gradient(values) < 0, -1, 1).astype(values.dtype)


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
    return tuple(replace(axis_modes(family, solver, 0.0, size), extent=1.0) for family, solver, size in axes)
