"""From Gaussian fields to soil: correlated parameters, trends with depth, strata."""

from __future__ import annotations

import itertools
from typing import Any

import jax.numpy as jnp
import numpy as np

from foundation.check import require
from kl.marginal import Marginal, nataf_correlation


def correlate(coefficients: Any, matrix: Any) -> Any:
    """Coefficients of cross-correlated fields of one expansion, from independent ones.

    Args:
        coefficients: (P, ..., M), independent, one set for each of P parameters.
        matrix: (P, P) correlation of the Gaussian fields (`nataf_matrix` gives it from that of the properties).

    Returns:
        (P, ..., M); parameter p depends on the sets up to p alone.

    Raises ValueError unless the matrix is symmetric, of unit diagonal and positive definite.
    """
    host = np.asarray(matrix, np.float64)
    require(
        host.ndim == 2 and host.shape[0] == host.shape[1] == coefficients.shape[0],
        f"correlation matrix of shape {host.shape} for {coefficients.shape[0]} sets of coefficients: give one row each",
    )
    require(np.abs(host - host.T) < 1e-6, f"correlation matrix {host.tolist()} is not symmetric: c_ij must be c_ji")
    require(np.abs(np.diag(host) - 1) < 1e-6, f"diagonal {np.diag(host)} of the correlation matrix must be 1")
    smallest = np.linalg.eigvalsh(host)[0]
    require(
        smallest > 1e-10,
        f"correlation matrix is not positive definite (smallest eigenvalue {smallest:.3g}): weaken its correlations",
    )
    root = jnp.asarray(np.linalg.cholesky(host), coefficients.dtype)
    return jnp.tensordot(root, coefficients, (1, 0))


def nataf_matrix(matrix: Any, marginals: tuple[Marginal, ...]) -> Any:
    """Gaussian correlation (P, P) that gives the properties' correlation `matrix` (P, P).

    Raises ValueError for a correlation that the marginals cannot have.
    """
    count = len(marginals)
    gaussian = np.eye(count)
    for i in range(count):
        for j in range(i):
            gaussian[i, j] = gaussian[j, i] = float(nataf_correlation(marginals[i], marginals[j], matrix[i][j]))
    return gaussian


def linear_with_depth(depth: Any, surface: Any, gradient: Any) -> Any:
    """Value at `depth` (N,) below the surface (m, downwards): surface + gradient * depth."""
    return surface + gradient * depth


def with_trend(marginal: Any, gaussian: Any, *, mean: Any, deviation: Any) -> Any:
    """Field with the shape of `marginal` but its own mean and deviation at each point.

    Args:
        marginal: of mean and cov as numbers; its standardised values are shifted and scaled.
        gaussian: (..., N), the standard field.
        mean, deviation: (N,) in the property's unit, for example from `linear_with_depth`.

    Returns:
        (..., N). Raises ValueError for a deviation below 0.
    """
    require(jnp.asarray(deviation) >= 0, "deviation of the trend falls below 0: check its gradient and the depth")
    standard = (marginal.transform(gaussian) - marginal.mean) / (marginal.cov * abs(marginal.mean))
    return mean + deviation * standard


def in_strata(elevation: Any, interfaces: Any, fields: tuple[Any, ...]) -> Any:
    """Field of each point's stratum.

    Args:
        elevation: (N,), z of the points (m).
        interfaces: K - 1 elevations from the top down, each a number or (N,) for horizons that dip; a point on an
            interface belongs to the stratum above.
        fields: K arrays (..., N) from the top stratum down, each made with its own expansion and marginal.

    Returns:
        (..., N). Raises ValueError for a wrong number of interfaces or interfaces that cross.
    """
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
