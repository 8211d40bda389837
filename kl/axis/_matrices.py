"""Matrices whose eigenpairs are those of the covariance operator, by quadrature, polynomials and wavelets."""

from __future__ import annotations

import math
from functools import lru_cache

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from kl._checks import finite, require
from kl.axis._covariance import Covariance
from kl.types import EitherArray, HostArray


@lru_cache(maxsize=64)
def gauss(order: int) -> tuple[HostArray, HostArray, HostArray]:
    """Gauss points and weights (order,) on [0, 1], and p_k(point q) sqrt(weight q) (order, order), orthogonal."""
    points, weights = np.polynomial.legendre.leggauss(order)
    values = np.polynomial.legendre.legvander(points, order - 1).T * np.sqrt(2 * np.arange(order) + 1)[:, None]
    weights = np.asarray(weights / 2, np.float64)
    return (points + 1) / 2, weights, np.asarray(values * np.sqrt(weights), np.float64)


def nystrom_matrix(order: int, extent: float, covariance: Covariance) -> EitherArray:
    """Matrix sqrt(w_i) c(x_i - x_j) sqrt(w_j), whose eigenvalues are fractions of the variance."""
    points, weights, _ = gauss(order)
    roots = np.sqrt(weights)
    return covariance(np.abs(points[:, None] - points) * extent) * (roots[:, None] * roots)


@lru_cache(maxsize=4)
def _split_rule(order: int) -> tuple[HostArray, HostArray, HostArray]:
    """Quadrature over 0 < y < x < 1: lags (q, s), p_m(x_q) w_q x_q (order, q), p_n(y_qs) w_s (order, q, s)."""
    points, weights, _ = gauss(order + 8)
    inner = points[:, None] * points
    norms = np.sqrt(2 * np.arange(order) + 1)
    outer_values = np.polynomial.legendre.legvander(2 * points - 1, order - 1).T * norms[:, None]
    inner_values = np.moveaxis(np.polynomial.legendre.legvander(2 * inner - 1, order - 1), -1, 0)
    return (
        points[:, None] - inner,
        outer_values * (weights * points),
        inner_values * norms[:, None, None] * weights,
    )


def legendre_matrix(order: int, extent: float, covariance: Covariance) -> EitherArray:
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


def haar_matrix(level: int, extent: float, covariance: Covariance) -> EitherArray:
    """Averages of the covariance over pairs of cells, divided by the number of cells; a Toeplitz matrix.

    The average over cells k apart is the integral of (1 - |s|) c((k + s) h), s in [-1, 1], by Gauss's rule on each
    half, so that a kink at lag 0 falls on an end.
    """
    cells = 2**level
    points, weights, _ = gauss(16)
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
    finite("cell values", smooth)
    while smooth.shape[-1] > 1:
        left, right = smooth[..., 0::2], smooth[..., 1::2]
        details.append((left - right) / math.sqrt(2))
        smooth = (left + right) / math.sqrt(2)
    return jnp.concatenate([smooth, *details[::-1]], axis=-1)
