"""Fields that honour borehole data, by conditioning the coefficients.

The field is linear in its coefficients. Given data y = A xi + e the coefficients are Gaussian again, with mean
A^T K^-1 y and covariance I - A^T K^-1 A, K = A A^T + diag(error^2): simple kriging in the space of the modes. A
conditioned sample is mean + (covariance)^(1/2) xi with the symmetric root. So conditioned coefficients are used
wherever coefficients are, on any grid, and a sample keeps its number.

Sources: Rasmussen and Williams (2006), Gaussian Processes for Machine Learning, Section 2.1; Journel and Huijbregts
(1978), Mining Geostatistics, Section VII.A.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from kl._checks import finite, pytree, require
from kl.axis import scaled_functions
from kl.field._evaluation import points_in_box
from kl.field._expansion import Expansion
from kl.field._isotropic import Waves

Values: TypeAlias = ArrayLike | Sequence[float]
# Two data closer than this share of the box are at the same point.
_SAME_POINT = 1e-6
# Share of the variance along a direction below which the data do not constrain it.
_NOTHING = 1e-12


@pytree
@dataclass(frozen=True)
class Conditioning:
    """Distribution of the coefficients, given data.

    Args:
        mean: (M,) coefficients of the kriged field.
        basis: (M, r) orthonormal directions that the data constrain.
        shrink: (r,) in [0, 1], share of the deviation along each direction that the data remove.
        gain: (M, n), which the scores of the data are multiplied by for the mean.
    """

    mean: Array
    basis: Array
    shrink: Array
    gain: Array


def mode_matrix(expansion: Expansion | Waves, points: ArrayLike) -> Array:
    """Value of every mode at given points.

    Args:
        expansion: of dimension d, with M modes, or the waves of `isotropic`.
        points: (d, N) in metres.

    Returns:
        Matrix (N, M); multiplied by coefficients (M,) it gives the field.

    Raises:
        ValueError: If there are no points, or one lies outside the box.
    """
    if isinstance(expansion, Waves):
        return expansion.matrix(points)
    return _mode_matrix(expansion, points_in_box(expansion, points))


@jax.jit
def _mode_matrix(expansion: Expansion, points: Array) -> Array:
    product = jnp.ones((1, 1), points.dtype)
    for modes, row, x in zip(expansion.axes, expansion.index, points, strict=True):
        product = product * scaled_functions(modes, x)[row]
    return product.T


def condition(
    expansion: Expansion,
    points: ArrayLike,
    values: Values,
    *,
    error: Values = 0.0,
) -> Conditioning:
    """Condition the standard Gaussian field on data at points.

    The computation runs on the host in float64, once for all samples.

    Args:
        expansion: of the field; data without error need more modes than data.
        points: (d, n) positions of the data (m), at most a few thousand.
        values: (n,) Gaussian scores: `standardise` of the marginal, applied to the measured values.
        error: standard deviation of the measurement, in scores, a number or (n,).

    Returns:
        Conditioning.

    Raises:
        ValueError: If data lie outside the box or two at the same point, a value is not finite, an error is negative,
            or the modes cannot distinguish data without error.

    Example:
        >>> import jax, kl, numpy as np
        >>> lengths = (kl.SquaredExponential(20.0), kl.SquaredExponential(5.0))
        >>> expansion = kl.expand(lengths, (0.0, 0.0), (40.0, 10.0))
        >>> at = np.array([[10.0, 30.0], [5.0, 5.0]])  # two readings
        >>> data = kl.condition(expansion, at, [1.5, -0.5])
        >>> samples = kl.conditioned(data, kl.monte_carlo(jax.random.key(0), 8, expansion.modes))
        >>> fields = kl.field_at(expansion, samples, at)
        >>> bool(np.allclose(fields, [1.5, -0.5], atol=1e-2))
        True
    """
    points, values = jnp.asarray(points), np.asarray(values, np.float64)
    require(
        points.ndim == 2 and values.shape == points.shape[1:],
        f"data at points of shape {points.shape} with values of shape {values.shape}: give (d, n) and (n,)",
    )
    require(values.size > 0, "no data: give at least one point, or leave the field unconditioned")
    from scipy.spatial import cKDTree  # loads what only data need

    matrix, host = mode_matrix(expansion, points), np.asarray(points, np.float64)
    scaled = host / np.array(expansion.extent)[:, None]
    for one, other in sorted(cKDTree(scaled.T).query_pairs(_SAME_POINT, p=np.inf)):
        raise ValueError(f"data {one} and {other} lie at the same point, {host[:, one]}: keep one or average them")
    return condition_on(matrix, values, error=error)


def condition_on(matrix: ArrayLike, values: Values, *, error: Values = 0.0) -> Conditioning:
    """Condition coefficients on data that are linear in them, y = matrix xi + e, as for several correlated fields.

    Args:
        matrix: (n, M) derivative of each datum by each coefficient; for one field its `mode_matrix`.
        values: (n,) Gaussian scores.
        error: standard deviation of the measurement, in scores, a number or (n,).

    Returns:
        Conditioning.

    Raises:
        ValueError: If shapes do not fit, a value is not finite, an error is negative, or the modes cannot distinguish
            data without error.
    """
    real = jnp.asarray(matrix).dtype
    modes, values = np.asarray(matrix, np.float64), np.asarray(values, np.float64)
    require(
        modes.ndim == 2 and values.shape == modes.shape[:1],
        f"{values.shape} data for a matrix of shape {modes.shape}: give (n,) and (n, M)",
    )
    require(np.isfinite(values), "a datum is not finite: the marginal cannot take that value, or it is missing")
    noise = np.asarray(error, np.float64)
    require(noise.shape in ((), values.shape), f"error of shape {noise.shape} for {values.size} data: give one each")
    noise = np.broadcast_to(noise, values.shape)
    finite("error", noise, remedy="it is a standard deviation in scores", least=0)
    parts = (_many if len(values) > modes.shape[1] else _few)(modes, values, noise, np.finfo(real).eps)
    return Conditioning(*(jnp.asarray(part, real) for part in parts))


Parts: TypeAlias = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""Fields of a `Conditioning` on the host."""


def _few(modes: np.ndarray, values: np.ndarray, noise: np.ndarray, epsilon: float) -> Parts:
    """By the covariance of the data (n, n), of which there are no more than modes."""
    shares, directions = np.linalg.eigh(modes @ modes.T + np.diag(noise**2))
    # Field values are only as exact as the dtype of the modes.
    _distinguished(modes, shares[0], 100 * epsilon * shares[-1])
    # I - A^T K^-1 A = I - W W^T with W = A^T K^(-1/2), whose singular values lie in [0, 1].
    gain = modes.T @ (directions / np.sqrt(shares))
    removed, turns = np.linalg.eigh(gain.T @ gain)
    constrained = removed > _NOTHING
    basis = gain @ (turns[:, constrained] / np.sqrt(removed[constrained]))
    shrink = 1 - np.sqrt(np.maximum(1 - removed[constrained], 0))
    of_scores = modes.T @ ((directions / shares) @ directions.T)
    return of_scores @ values, basis, shrink, of_scores


def _many(modes: np.ndarray, values: np.ndarray, noise: np.ndarray, epsilon: float) -> Parts:
    """By the precision of the coefficients (M, M): the same where there are more data than modes."""
    # Beside an error, rounding of the modes acts by its square: what is known before bounds its effect along directions
    # that the data hardly constrain.
    largest = float(np.linalg.eigvalsh(modes.T @ modes)[-1])
    _distinguished(modes, float(noise.min() ** 2), (100 * epsilon) ** 2 * largest)
    white = modes / noise[:, None]
    eigenvalues, directions = np.linalg.eigh(white.T @ white)
    eigenvalues = np.maximum(eigenvalues, 0)
    constrained = eigenvalues > _NOTHING
    of_scores = (directions / (1 + eigenvalues)) @ directions.T @ (white / noise[:, None]).T
    return of_scores @ values, directions[:, constrained], 1 - 1 / np.sqrt(1 + eigenvalues[constrained]), of_scores


def _distinguished(modes: np.ndarray, least: float, limit: float) -> None:
    """Raise ValueError for data whose covariance has a least eigenvalue of rounding alone."""
    require(
        least > limit,
        f"{modes.shape[0]} data on {modes.shape[1]} modes cannot be distinguished (smallest eigenvalue {least:.1e}, "
        f"limit {limit:.1e}): give a larger error, keep more modes, use float64 or thin the data",
    )


def conditioned(conditioning: Conditioning, coefficients: ArrayLike) -> Array:
    """Coefficients of fields that honour the data, from unconditioned ones.

    Args:
        conditioning: from `condition` or `condition_on`.
        coefficients: (..., M), standard normal, finite.

    Returns:
        Coefficients (..., M).

    Raises:
        ValueError: If the number of coefficients is not M, or one is not finite.
    """
    vector = jnp.asarray(coefficients)
    modes = conditioning.mean.shape[0]
    require(vector.shape[-1:] == (modes,), f"coefficients of shape {vector.shape}: give (..., {modes}), one a mode")
    finite("coefficients", vector)
    return _conditioned(conditioning, vector)


@jax.jit
def _conditioned(conditioning: Conditioning, coefficients: Array) -> Array:
    along = coefficients @ conditioning.basis
    return conditioning.mean + coefficients - (along * conditioning.shrink) @ conditioning.basis.T


def kriging_variance(conditioning: Conditioning, expansion: Expansion, points: ArrayLike) -> Array:
    """Variance of the conditioned standard field.

    Args:
        conditioning: from `condition`.
        expansion: of the same field.
        points: (d, N) in metres.

    Returns:
        Variance (N,), at most the captured one.

    Raises:
        ValueError: If there are no points, or one lies outside the box.
    """
    modes = mode_matrix(expansion, points)
    removed = 1 - (1 - conditioning.shrink) ** 2
    return (modes**2).sum(axis=1) - ((modes @ conditioning.basis) ** 2) @ removed
