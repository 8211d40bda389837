"""Marginal distributions by equiprobable transform of a standard Gaussian field: x = F^-1(Phi(g)).

Each is a frozen dataclass of a mean and a coefficient of variation of the soil property itself (and bounds where
the family has them). All are dynamic: numbers, or arrays that broadcast against the points for a trend. `transform`
maps the Gaussian field (..., N) to the property and `standardise` maps values back. Both are stable in either tail
in float32: probabilities near 1 are never formed, the upper tail goes through 1 - Phi(g) = Phi(-g).

`transform` raises ValueError for a cov below 0, a mean of the wrong sign or bounds that exclude the mean, if their
values are known on the host.

Sources: method: Grigoriu (1995), Applied Non-Gaussian Processes, Section 3.1 (translation fields); families: Ang and
Tang (2007), Probability Concepts in Engineering, Chapter 3.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.scipy.special import ndtr, ndtri

from kl._checks import finite, is_traced, pytree, require
from kl.marginal import _quantiles as quantiles
from kl.types import Parameter, size_of


class Marginal(Protocol):
    """A map from a standard Gaussian field to a soil property and back."""

    def transform(self, gaussian: Array) -> Array:
        """Values of the property, of the shape of `gaussian`, in the property's unit."""

    def standardise(self, value: Array) -> Array:
        """Gaussian scores of values of the property, of the shape of `value`."""


# Deviations from the mean within which a marginal's values must be numbers of the working precision.
_REACH = 9.0


def check_moments(mean: Parameter, cov: Parameter, *, positive: bool) -> None:
    """Raise ValueError for moments that overflow or that no marginal has; `positive` requires a mean above 0."""
    library = jnp if is_traced(mean, cov) else np
    require(library.isfinite(mean) & library.isfinite(cov), f"mean = {mean}, cov = {cov}: give finite numbers")
    require(library.asarray(cov) >= 0, f"cov = {cov} is negative: give a coefficient of variation of 0 or more")
    if positive:
        require(library.asarray(mean) > 0, f"mean = {mean} must be above 0 for a positive property: or use Normal")
    if not is_traced(mean, cov):
        farthest = float(np.max(np.abs(np.asarray(mean, np.float64)) * (1 + _REACH * np.asarray(cov, np.float64))))
        precision = jnp.finfo(jnp.result_type(float))
        require(
            farthest < float(precision.max),
            f"mean = {mean}, cov = {cov}: values {_REACH:g} deviations out come to {farthest:.3g}, {precision.dtype} "
            f"holds up to {float(precision.max):.3g}: lower the cov",
        )


def check_marginal(marginal: Marginal) -> None:
    """Check on the host that a marginal exists and stays within the working precision.

    `transform` checks the same where values are known. In a traced function they are not, so call this before.

    Args:
        marginal: to check between -9 and 9 deviations.

    Raises:
        ValueError: If no such distribution exists, or its values overflow.
    """
    ends = np.asarray(marginal.transform(jnp.asarray([-_REACH, 0.0, _REACH])), np.float64)
    require(
        np.isfinite(ends) & (np.diff(ends, prepend=ends[0]) >= 0),
        f"{marginal}: its values at -9, 0 and 9 deviations come to {ends.tolist()}: lower its cov",
    )


def finite_everywhere(gaussian: Array) -> Array:
    """The field, after a check on the host that it is finite."""
    finite("gaussian field", gaussian, remedy="check the coefficients or the points")
    return gaussian


@pytree
@dataclass(frozen=True)
class Normal:
    """Gaussian of deviation cov |mean|.

    It reaches below 0, where a strength has no meaning: use `TruncatedNormal` there.

    Args:
        mean: in the property's unit.
        cov: deviation over |mean|, 0 or more.
    """

    mean: Parameter
    cov: Parameter

    def transform(self, gaussian: Array) -> Array:
        """Property at the scores `gaussian` (..., N)."""
        check_moments(self.mean, self.cov, positive=False)
        return self.mean + size_of(self.mean) * self.cov * finite_everywhere(gaussian)

    def standardise(self, value: Array) -> Array:
        """Scores of values (..., N) of the property."""
        return (value - self.mean) / (size_of(self.mean) * self.cov)


@pytree
@dataclass(frozen=True)
class Lognormal:
    """The logarithm of x is Gaussian of variance s^2 = ln(1 + cov^2) and mean ln(mean) - s^2 / 2.

    Args:
        mean: in the property's unit, above 0.
        cov: deviation over mean, 0 or more.

    Example:
        >>> import kl
        >>> strength = kl.Lognormal(mean=42e3, cov=0.3)
        >>> round(float(strength.transform(0.0)))  # median (Pa)
        40229
    """

    mean: Parameter
    cov: Parameter

    def transform(self, gaussian: Array) -> Array:
        """Property at the scores `gaussian` (..., N)."""
        check_moments(self.mean, self.cov, positive=True)
        variance, deviation = self._log_moments()
        self._check_range()
        return self.mean * jnp.exp(deviation * finite_everywhere(gaussian) - variance / 2)

    def standardise(self, value: Array) -> Array:
        """Scores of values (..., N) of the property."""
        variance, deviation = self._log_moments()
        return (jnp.log(value / self.mean) + variance / 2) / deviation

    def _check_range(self) -> None:
        if is_traced(self.mean, self.cov):
            return
        mean, cov = np.asarray(self.mean, np.float64), np.asarray(self.cov, np.float64)
        variance = np.log1p(cov**2)
        lowest = float(np.min(np.log10(mean) - (_REACH * np.sqrt(variance) + variance / 2) / math.log(10)))
        precision = jnp.finfo(jnp.result_type(float))
        require(
            lowest > math.log10(float(precision.tiny)),
            f"mean = {self.mean}, cov = {self.cov}: values {_REACH:g} deviations down come to 1e{lowest:.0f}, "
            f"{precision.dtype} holds down to {float(precision.tiny):.3g}: lower the cov",
        )

    def _log_moments(self) -> tuple[Array, Array]:
        variance = jnp.log1p(jnp.square(self.cov))
        # The root of 0 has no derivative, a cov of 0 is allowed.
        positive = variance > 0
        return variance, jnp.where(positive, jnp.sqrt(jnp.where(positive, variance, 1)), 0)


@pytree
@dataclass(frozen=True)
class TruncatedNormal:
    """Gaussian cut to [lower, upper]; mean and cov are those after the cut.

    With the lower bound at 0, cov must stay below 1 (the limit is an exponential distribution).

    Source of the moments: Johnson, Kotz and Balakrishnan (1994), Continuous Univariate Distributions 1, Section
    13.10.1.

    Args:
        mean: in the property's unit, between the bounds; a number.
        cov: deviation over |mean|, above 0; a number.
        lower: bound in the property's unit, None for none.
        upper: bound in the property's unit, None for none.
    """

    mean: Parameter
    cov: Parameter
    lower: Parameter | None = 0.0
    upper: Parameter | None = None

    def transform(self, gaussian: Array) -> Array:
        """Property at the scores `gaussian` (..., N)."""
        centre, scale, low, high = self._parent()
        inside = quantiles.normal_mass(low, high)
        below = finite_everywhere(gaussian) < 0
        score = ndtri(ndtr(jnp.where(below, low, -high)) + ndtr(jnp.where(below, gaussian, -gaussian)) * inside)
        # Rounding at the end of a tail must not leave the bounds.
        return centre + scale * jnp.clip(jnp.where(below, score, -score), low, high)

    def standardise(self, value: Array) -> Array:
        """Scores of values (..., N) of the property."""
        centre, scale, low, high = self._parent()
        at = (value - centre) / scale
        inside = quantiles.normal_mass(low, high)
        below, above = quantiles.normal_mass(low, at), quantiles.normal_mass(at, high)
        return quantiles.from_both_tails(below / inside, above / inside)

    def _parent(self) -> tuple[Array, Array, Array, Array]:
        """Centre and scale of the uncut Gaussian, and the bounds as its scores."""
        check_moments(self.mean, self.cov, positive=False)
        lower = -math.inf if self.lower is None else self.lower
        upper = math.inf if self.upper is None else self.upper
        require(
            (jnp.asarray(lower) < self.mean) & (jnp.asarray(self.mean) < upper),
            f"mean = {self.mean} must lie between the bounds {lower} and {upper}: move them",
        )
        require(jnp.asarray(self.cov) > 0, f"cov = {self.cov} must be above 0: use Normal for a constant")
        return quantiles.truncated_parent(self.mean, size_of(self.mean) * self.cov, self.lower, self.upper)


@pytree
@dataclass(frozen=True)
class Uniform:
    """Uniform between mean (1 - sqrt(3) cov) and mean (1 + sqrt(3) cov).

    Args:
        mean: in the property's unit.
        cov: deviation over |mean|, 0 or more.
    """

    mean: Parameter
    cov: Parameter

    def transform(self, gaussian: Array) -> Array:
        """Property at the scores `gaussian` (..., N)."""
        check_moments(self.mean, self.cov, positive=False)
        return self.mean + math.sqrt(3) * size_of(self.mean) * self.cov * (
            ndtr(finite_everywhere(gaussian)) - ndtr(-gaussian)
        )

    def standardise(self, value: Array) -> Array:
        """Scores of values (..., N) of the property."""
        share = (value - self.mean) / (math.sqrt(3) * size_of(self.mean) * self.cov)
        return quantiles.from_both_tails((1 + share) / 2, (1 - share) / 2)


@pytree
@dataclass(frozen=True)
class Gumbel:
    """Largest values: F(x) = exp(-exp(-(x - u)/b)), b = deviation sqrt(6)/pi, u = mean - 0.5772 b.

    Args:
        mean: in the property's unit; may be an array.
        cov: deviation over |mean|; may be an array.
    """

    mean: Parameter
    cov: Parameter

    def transform(self, gaussian: Array) -> Array:
        """Property at the scores `gaussian` (..., N)."""
        scale, mode = self._parameters()
        return mode - scale * jnp.log(-quantiles.log_normal_cdf(finite_everywhere(gaussian)))

    def standardise(self, value: Array) -> Array:
        """Scores of values (..., N) of the property."""
        scale, mode = self._parameters()
        minus_log = jnp.exp(-(value - mode) / scale)
        return quantiles.from_both_tails(jnp.exp(-minus_log), -jnp.expm1(-minus_log))

    def _parameters(self) -> tuple[Parameter, Parameter]:
        check_moments(self.mean, self.cov, positive=False)
        scale = size_of(self.mean) * self.cov * (math.sqrt(6) / math.pi)
        return scale, self.mean - 0.5772156649015329 * scale


@pytree
@dataclass(frozen=True)
class Empirical:
    """Quantiles of data, linear between the ordered values at probabilities (k - 1/2)/n.

    The smallest and the largest datum bound the field: nothing is known beyond them.

    Args:
        data: (n,) values of the property, n 2 or more.
    """

    data: Array

    def transform(self, gaussian: Array) -> Array:
        """Property at the scores `gaussian` (..., N)."""
        scores, ordered = self._table()
        return jnp.interp(finite_everywhere(gaussian), scores, ordered)

    def standardise(self, value: Array) -> Array:
        """Scores of values (..., N) of the property."""
        scores, ordered = self._table()
        return jnp.interp(value, ordered, scores)

    def _table(self) -> tuple[Array, Array]:
        ordered = jnp.sort(jnp.asarray(self.data))
        count = ordered.shape[0]
        require(count >= 2 and ordered.ndim == 1, f"data of shape {ordered.shape}: give (n,) with n of 2 or more")
        require(jnp.isfinite(ordered), "data hold a value that is not finite: remove it")
        below = (jnp.arange(count) + 0.5) / count
        return quantiles.from_both_tails(below, below[::-1]).astype(ordered.dtype), ordered
