"""Gamma, Weibull and beta marginals, whose quantiles have no closed form or a power of one."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jax import Array
from jax.scipy.special import betainc, gammainc, gammaincc

from kl._checks import pytree, require
from kl.marginal import _quantiles as quantiles
from kl.marginal._marginals import check_moments, finite_everywhere
from kl.types import Parameter, size_of


@pytree
@dataclass(frozen=True)
class Gamma:
    """Four-parameter (generalised) gamma: ((x - lower)/scale)^power has a gamma distribution.

    Shape and scale follow from mean and cov; power 1 and lower 0 give the ordinary gamma.

    Source: Stacy (1962), doi:10.1214/aoms/1177704481.

    Args:
        mean: in the property's unit, above `lower`; a number, or an array if `lower` is 0.
        cov: deviation over mean, above 0; a number.
        lower: bound in the property's unit.
        power: exponent above 0.
    """

    mean: Parameter
    cov: Parameter
    lower: Parameter = 0.0
    power: Parameter = 1.0

    def transform(self, gaussian: Array) -> Array:
        """Property at the scores `gaussian` (..., N)."""
        return _generalised_gamma(self, *self._exponents(), gaussian)

    def standardise(self, value: Array) -> Array:
        """Scores of values (..., N) of the property."""
        return _generalised_gamma_score(self, *self._exponents(), value)

    def _exponents(self) -> tuple[Parameter, Parameter]:
        cov = quantiles.cov_above(self.mean, self.cov, self.lower)
        require(jnp.asarray(self.power) > 0, f"power = {self.power} must be above 0: 1 is the ordinary gamma")
        return quantiles.require_rooted(quantiles.gamma_shape(cov, self.power), "shape", self.cov), self.power


@pytree
@dataclass(frozen=True)
class Weibull:
    """Four-parameter Weibull: ((x - lower)/scale)^power has a gamma distribution of the given shape.

    Power and scale follow from mean and cov; shape 1 and lower 0 give the ordinary Weibull. The family is that of
    `Gamma` with the other exponent free.

    Args:
        mean: in the property's unit, above `lower`; a number, or an array if `lower` is 0.
        cov: deviation over mean, above 0; a number.
        lower: bound in the property's unit.
        shape: of the gamma distribution, above 0.
    """

    mean: Parameter
    cov: Parameter
    lower: Parameter = 0.0
    shape: Parameter = 1.0

    def transform(self, gaussian: Array) -> Array:
        """Property at the scores `gaussian` (..., N)."""
        return _generalised_gamma(self, *self._exponents(), gaussian)

    def standardise(self, value: Array) -> Array:
        """Scores of values (..., N) of the property."""
        return _generalised_gamma_score(self, *self._exponents(), value)

    def _exponents(self) -> tuple[Parameter, Parameter]:
        cov = quantiles.cov_above(self.mean, self.cov, self.lower)
        require(jnp.asarray(self.shape) > 0, f"shape = {self.shape} must be above 0: 1 is the ordinary Weibull")
        return self.shape, quantiles.require_rooted(quantiles.weibull_power(cov, self.shape), "power", self.cov)


def _log_scale(marginal: Gamma | Weibull, shape: Parameter, power: Parameter) -> Array:
    """Logarithm of the value at which the gamma variable equals its shape."""
    rise = quantiles.log_gamma_rise(shape, 1 / jnp.asarray(power))
    return jnp.log(marginal.mean - marginal.lower) + jnp.log(shape) / power - rise


def _generalised_gamma(marginal: Gamma | Weibull, shape: Parameter, power: Parameter, gaussian: Array) -> Array:
    quantile = quantiles.log_gamma_quantile(shape, finite_everywhere(gaussian))
    return marginal.lower + jnp.exp(_log_scale(marginal, shape, power) + quantile / power)


def _generalised_gamma_score(marginal: Gamma | Weibull, shape: Parameter, power: Parameter, value: Array) -> Array:
    at = shape * jnp.exp((jnp.log(value - marginal.lower) - _log_scale(marginal, shape, power)) * power)
    return quantiles.from_both_tails(gammainc(shape, at), gammaincc(shape, at))


@pytree
@dataclass(frozen=True)
class Beta:
    """Beta distribution between two bounds (four parameters).

    Args:
        mean: in the property's unit, between the bounds; a number.
        cov: deviation over |mean|, above 0 and at most what the bounds allow; a number.
        lower: bound in the property's unit.
        upper: bound in the property's unit.
    """

    mean: Parameter
    cov: Parameter
    lower: Parameter
    upper: Parameter

    def transform(self, gaussian: Array) -> Array:
        """Property at the scores `gaussian` (..., N)."""
        first, second = self._shapes()
        return self.lower + (self.upper - self.lower) * jax.nn.sigmoid(
            quantiles.logit_beta_quantile(first, second, finite_everywhere(gaussian))
        )

    def standardise(self, value: Array) -> Array:
        """Scores of values (..., N) of the property."""
        first, second = self._shapes()
        at = (value - self.lower) / (self.upper - self.lower)
        return quantiles.from_both_tails(betainc(first, second, at), betainc(second, first, 1 - at))

    def _shapes(self) -> tuple[Parameter, Parameter]:
        check_moments(self.mean, self.cov, positive=False)
        share = (self.mean - self.lower) / (self.upper - self.lower)
        require(
            (jnp.asarray(self.upper) > self.lower) & (share > 0) & (share < 1),
            f"mean = {self.mean} must lie between the beta's bounds {self.lower} and {self.upper}: widen them",
        )
        variance = (self.mean * self.cov / (self.upper - self.lower)) ** 2
        most = jnp.sqrt(share * (1 - share)) * (self.upper - self.lower) / size_of(self.mean)
        require(
            (variance > 0) & (variance < share * (1 - share)),
            f"cov = {self.cov} must be above 0 and below {most}, the most that bounds {self.lower} and {self.upper} "
            "allow: lower it or widen the bounds",
        )
        total = share * (1 - share) / variance - 1
        return share * total, (1 - share) * total
