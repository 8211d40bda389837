"""From Gaussian fields to soil: correlated parameters, trends with depth, strata."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Protocol

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from kl._checks import finite, require
from kl.marginal import Marginal, nataf_correlation
from kl.types import HostArray, Parameter, size_of


class Moments(Marginal, Protocol):
    """A marginal of given mean and coefficient of variation."""

    @property
    def mean(self) -> Parameter:
        """Mean in the property's unit."""

    @property
    def cov(self) -> Parameter:
        """Coefficient of variation."""


def correlate(coefficients: Array, matrix: ArrayLike | Sequence[Sequence[float]]) -> Array:
    """Coefficients of cross-correlated fields of one expansion, from independent ones.

    Args:
        coefficients: (P, ..., M), independent, one set for each of P parameters.
        matrix: (P, P) correlation of the Gaussian fields (`nataf_matrix` gives it from that of the properties).

    Returns:
        Coefficients (P, ..., M); parameter p depends on the sets up to p alone.

    Raises:
        ValueError: If `correlation_root` refuses the matrix, or it has another size.
    """
    require(coefficients.ndim >= 2, f"coefficients of shape {coefficients.shape}: give (P, ..., M), a set for each")
    root = correlation_root(matrix)
    require(
        len(root) == coefficients.shape[0],
        f"correlation matrix of shape {root.shape} for {len(coefficients)} sets of coefficients: give one row each",
    )
    return jnp.tensordot(jnp.asarray(root, coefficients.dtype), coefficients, (1, 0))


def correlation_root(matrix: ArrayLike | Sequence[Sequence[float]]) -> HostArray:
    """Lower triangle L with L L^T = `matrix`, which makes independent fields correlated.

    Args:
        matrix: (P, P) correlation.

    Returns:
        Triangle L (P, P).

    Raises:
        ValueError: If the matrix is not square, finite, symmetric, of unit diagonal and positive definite.
    """
    try:
        host = np.asarray(matrix, np.float64)
    except ValueError as error:
        raise ValueError("the rows of the correlation matrix differ in length: give a square one") from error
    finite("correlation matrix", host)
    require(
        host.ndim == 2 and host.shape[0] == host.shape[1],
        f"correlation matrix of shape {host.shape}: give a square one, a row for each parameter",
    )
    require(np.abs(host - host.T) < 1e-6, f"correlation matrix {host.tolist()} is not symmetric: c_ij must be c_ji")
    require(np.abs(np.diag(host) - 1) < 1e-6, f"diagonal {np.diag(host)} of the correlation matrix must be 1")
    smallest = np.linalg.eigvalsh(host)[0]
    require(
        smallest > 1e-10,
        f"correlation matrix is not positive definite (smallest eigenvalue {smallest:.3g}): weaken its correlations",
    )
    return np.asarray(np.linalg.cholesky(host), np.float64)


def nataf_matrix(matrix: ArrayLike | Sequence[Sequence[float]], marginals: tuple[Marginal, ...]) -> HostArray:
    """Gaussian correlation that gives the correlation of properties.

    Args:
        matrix: (P, P) correlation of the properties.
        marginals: of the P properties.

    Returns:
        Correlation (P, P) of the Gaussian fields.

    Raises:
        ValueError: If the matrix has another shape, or the marginals cannot have a correlation.
    """
    count = len(marginals)
    target = np.asarray(matrix, np.float64)
    require(
        target.shape == (count, count),
        f"correlation matrix of shape {target.shape} for {count} marginals: give ({count}, {count})",
    )
    gaussian = np.eye(count)
    for i in range(count):
        for j in range(i):
            gaussian[i, j] = gaussian[j, i] = float(nataf_correlation(marginals[i], marginals[j], target[i, j]))
    return gaussian


def linear_with_depth(depth: Array, surface: Parameter, gradient: Parameter) -> Array:
    """Value that grows linearly with depth: surface + gradient * depth.

    Args:
        depth: (N,) below the surface (m), positive downwards.
        surface: value at the surface, in the property's unit.
        gradient: its increase per metre.

    Returns:
        Values (N,) in the property's unit.

    Raises:
        ValueError: If a value is not finite.
    """
    for name, value in (("depth", depth), ("surface", surface), ("gradient", gradient)):
        finite(name, value)
    return surface + gradient * depth


def with_trend(marginal: Moments, gaussian: Array, *, mean: Parameter, deviation: Parameter) -> Array:
    """Field with the shape of a marginal but its own mean and deviation at each point.

    Args:
        marginal: with mean and cov as numbers, neither 0; its standardised values are shifted and scaled.
        gaussian: (..., N), the standard field.
        mean: (N,) in the property's unit, for example from `linear_with_depth`.
        deviation: (N,) in the property's unit, 0 or more.

    Returns:
        Field (..., N) in the property's unit.

    Raises:
        ValueError: If mean or deviation has another shape or is not finite, a deviation is below 0, or the marginal
            does not vary.
    """
    points = jnp.shape(gaussian)[-1:]
    for name, value in (("mean", mean), ("deviation", deviation)):
        require(
            jnp.shape(value) in ((), (1,), points),
            f"{name} of the trend of shape {jnp.shape(value)} for a field of {points} points: give one value for each",
        )
        finite(f"{name} of the trend", value)
    require(jnp.asarray(deviation) >= 0, "deviation of the trend falls below 0: check its gradient and the depth")
    spread = marginal.cov * size_of(marginal.mean)
    require(jnp.asarray(spread) > 0, f"{marginal} does not vary, no trend can scale it: give a mean and a cov above 0")
    standard = (marginal.transform(gaussian) - marginal.mean) / spread
    return mean + deviation * standard


def in_strata(elevation: Array, interfaces: Sequence[Parameter], fields: Sequence[Array]) -> Array:
    """Field of each point's stratum.

    Args:
        elevation: (N,), z of the points (m).
        interfaces: K - 1 elevations from the top down (m), each a number or (N,) for horizons that dip; a point on an
            interface belongs to the stratum above.
        fields: K arrays (..., N) from the top stratum down, each made with its own expansion and marginal.

    Returns:
        Field (..., N).

    Raises:
        ValueError: If the number of interfaces is wrong, interfaces cross, an array is of other points than
            `elevation`, or an elevation is not finite.
    """
    finite("elevation", elevation)
    named = [("field", values) for values in fields] + [("interface", values) for values in interfaces]
    for name, values in named:
        require(
            jnp.shape(values)[-1:] in ((), jnp.shape(elevation)[-1:]),
            f"{name} of shape {jnp.shape(values)} for an elevation of {jnp.shape(elevation)}: give the same points",
        )
    require(
        len(interfaces) == len(fields) - 1,
        f"{len(interfaces)} interfaces between {len(fields)} strata: give one fewer than strata",
    )
    for upper, lower in itertools.pairwise(interfaces):
        require(jnp.asarray(upper) >= lower, f"interface {upper} lies below the next one, {lower}: order from the top")
    chosen = fields[-1]
    for interface, field in zip(reversed(interfaces), reversed(fields[:-1]), strict=True):
        chosen = jnp.where(elevation >= interface, field, chosen)
    return chosen
