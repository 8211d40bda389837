"""Nataf's correction: the Gaussian correlation that gives a required correlation after the marginal transform.

With the transform expanded in Hermite polynomials, x = sum of a_k He_k(g) / sqrt(k!), two transformed variables of
Gaussian correlation r correlate by the sum of a_k b_k r^k over the root of the sums of squares.

Sources: Grigoriu (1995), Applied Non-Gaussian Processes, Section 3.1; Liu and Der Kiureghian (1986),
doi:10.1016/0266-8920(86)90033-0.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
import scipy
from jax import Array
from jax.typing import ArrayLike

from kl._checks import require
from kl.axis import Corrected, Covariance, gaussian_correlation, transformed_correlation
from kl.marginal._marginals import Marginal

_TERMS = 20
_POINTS = 80


def hermite_coefficients(marginal: Marginal) -> Array:
    """Coefficients of a marginal's standardised transform in normalised Hermite polynomials, degree 1 up.

    They are scaled to a sum of squares of 1, so what higher degrees contain is assigned to these.

    Args:
        marginal: of moments that are numbers.

    Returns:
        Coefficients (20,).
    """
    points, weights = np.polynomial.hermite_e.hermegauss(_POINTS)
    keep = weights > 1e-30
    points, weights = points[keep], weights[keep] / weights.sum()
    degrees = np.arange(1, _TERMS + 1)
    basis = np.polynomial.hermite_e.hermevander(points, _TERMS)[:, 1:] / np.sqrt(scipy.special.factorial(degrees))
    coefficients = jnp.asarray(basis.T * weights) @ marginal.transform(jnp.asarray(points))
    return coefficients / jnp.linalg.norm(coefficients)


def nataf_correlation(first: Marginal, second: Marginal, correlation: ArrayLike) -> Array:
    """Gaussian correlation that gives a required correlation between two properties.

    Args:
        first: marginal of one property.
        second: marginal of the other.
        correlation: of the properties, in [-1, 1], any shape.

    Returns:
        Gaussian correlation, of the shape of `correlation`.

    Raises:
        ValueError: If no Gaussian correlation gives it.
    """
    powers = hermite_coefficients(first) * hermite_coefficients(second)
    correlation = jnp.asarray(correlation)
    reach = transformed_correlation(powers, jnp.array([-1.0, 1.0]))
    require(
        (correlation >= reach[0] - 1e-5) & (correlation <= reach[1] + 1e-5),
        f"correlation {correlation} cannot be had between these marginals: stay in {reach[0]:.4f} to {reach[1]:.4f}",
    )
    return jnp.asarray(gaussian_correlation(powers, correlation))


def nataf_corrected(covariance: Covariance, marginal: Marginal) -> Corrected:
    """Correct the covariance of one axis so that the property, not the Gaussian field, has it along that axis.

    Args:
        covariance: of the property along the axis.
        marginal: of the property.

    Returns:
        Covariance of the Gaussian field.
    """
    return Corrected(covariance, hermite_coefficients(marginal))


@dataclass(frozen=True)
class NatafError:
    """Largest error in the property's correlation, over all target correlations in [0, 1].

    Args:
        uncorrected: if the Gaussian field gets the target correlation.
        corrected: if `nataf_corrected` corrects every axis. It is 0 along an axis but not across axes, because
            products of corrected correlations are not the corrected product.
    """

    uncorrected: float
    corrected: float


def nataf_error(marginal: Marginal, axes: int = 3) -> NatafError:
    """Size of the Nataf effect in a field with a product covariance.

    Args:
        marginal: of the property.
        axes: number of axes.

    Returns:
        Largest error with and without correction.
    """
    powers = hermite_coefficients(marginal) ** 2
    line = jnp.linspace(0, 1, 101)
    uncorrected = jnp.abs(transformed_correlation(powers, line) - line).max()
    coarse = np.linspace(0, 1, 21)
    targets = jnp.asarray(list(itertools.product(coarse, repeat=axes)))
    gaussian = gaussian_correlation(powers, targets).prod(axis=1)
    corrected = jnp.abs(transformed_correlation(powers, gaussian) - targets.prod(axis=1)).max()
    return NatafError(float(uncorrected), float(corrected))
