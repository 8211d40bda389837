"""Correlation of the Gaussian field whose transformed field has a given correlation."""

from __future__ import annotations

from dataclasses import dataclass
from types import ModuleType

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from kl._checks import pytree
from kl.axis._covariance import Covariance
from kl.types import EitherArray


@pytree
@dataclass(frozen=True)
class Corrected:
    """c(t) = the Gaussian correlation whose transform has the correlation b(t): Nataf's correction along an axis.

    `nataf_corrected` makes it. `expand` raises ValueError if the corrected function is not positive definite.

    Args:
        base: the property's correlation b.
        hermite: (K,) Hermite coefficients of the marginal, of sum of squares 1.
    """

    base: Covariance
    hermite: Array

    def __call__(self, lag: EitherArray) -> EitherArray:
        return gaussian_correlation(self.hermite**2, self.base(lag))

    def spectral_density(self, wavenumber: EitherArray) -> EitherArray:
        """Raise ValueError: no closed form is known."""
        raise ValueError("a corrected covariance has no closed spectral density: use Nystrom() or Legendre()")


def transformed_correlation(powers: EitherArray, gaussian: EitherArray) -> EitherArray:
    """Correlation of two transformed variables of Gaussian correlation: sum over k of powers[k - 1] gaussian^k.

    Args:
        powers: (K,) products of the variables' Hermite coefficients, degree 1 up.
        gaussian: Gaussian correlation in [-1, 1], any shape.

    Returns:
        Correlation, of the shape of `gaussian`.
    """
    total = 0 * gaussian
    for coefficient in powers[::-1]:
        total = (total + coefficient) * gaussian
    return total


def gaussian_correlation(powers: EitherArray, target: EitherArray) -> EitherArray:
    """Gaussian correlation at which `transformed_correlation` equals a target, by bisection.

    A last Newton step carries the derivatives.

    Args:
        powers: (K,) products of the variables' Hermite coefficients, degree 1 up.
        target: correlation of the transformed variables, any shape.

    Returns:
        Gaussian correlation in [-1, 1], of the shape of `target`.
    """
    if isinstance(target, jax.Array) or isinstance(powers, jax.Array):
        return _gaussian_correlation(jnp.asarray(powers), jnp.asarray(target))
    low: EitherArray = -np.ones_like(target)
    high: EitherArray = np.ones_like(target)
    for _ in range(_HALVINGS):
        low, high = _halved(np, powers, target, low, high)
    return (low + high) / 2


@jax.jit
def _gaussian_correlation(powers: Array, target: Array) -> Array:
    fixed = jax.lax.stop_gradient((powers, target))
    bracket = (-jnp.ones_like(target), jnp.ones_like(target))
    low, high = jax.lax.fori_loop(0, _HALVINGS, lambda _, ends: _halved(jnp, *fixed, *ends), bracket)
    root = jax.lax.stop_gradient((low + high) / 2)
    # d/dr of sum p_k r^k is the sum of k p_k r^(k - 1).
    order = jnp.arange(1, powers.shape[0] + 1)
    slope = fixed[0][0] + transformed_correlation((fixed[0] * order)[1:], root)
    return root - (transformed_correlation(powers, root) - target) / slope


def _halved(
    namespace: ModuleType, powers: EitherArray, target: EitherArray, low: EitherArray, high: EitherArray
) -> tuple[EitherArray, EitherArray]:
    middle = (low + high) / 2
    below = transformed_correlation(powers, middle) < target
    return namespace.where(below, middle, low), namespace.where(below, high, middle)


_HALVINGS = 45
