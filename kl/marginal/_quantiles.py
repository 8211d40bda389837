"""Quantile functions in terms of a standard Gaussian score g, stable in both tails in float32.

Gamma and beta have no closed inverse. Their density, in the logarithm or logit of the variable, is integrated panel
by panel from both ends. This gives scores at equal steps of the variable with full relative accuracy in either tail.
The table is then inverted to equal steps of the score and interpolated by cubics with exact slopes. All of it is
differentiable in the parameters, and a field of any size costs one look-up per point.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.scipy.special import betaln, digamma, gammaln, log_ndtr, ndtr, ndtri, zeta
from jax.scipy.stats import norm

from kl._checks import require
from kl.types import Parameter, size_of

# Scores of the tables; Phi(-9) = 1e-19. Beyond, the quantile goes on along its tangent.
_REACH = 9.0
_LOG_REACH = -43.6 - 4.0
_PANELS = 1024
_SCORES = 513
_HALVINGS = 50


def log_normal_cdf(gaussian: Array) -> Array:
    """Logarithm of Phi(g), to full relative accuracy even where Phi is near 1."""
    below, above = jnp.minimum(gaussian, 0), jnp.maximum(gaussian, 0)
    return jnp.where(gaussian > 0, jnp.log1p(-ndtr(-above)), log_ndtr(below))


def normal_mass(low: Array, high: Array) -> Array:
    """Phi(high) - Phi(low), subtracted in the tail that preserves its digits."""
    upper = low > 0
    return ndtr(jnp.where(upper, -low, high)) - ndtr(jnp.where(upper, -high, low))


def from_both_tails(below: Array, above: Array) -> Array:
    """Score of a value from its probabilities below and above it.

    Args:
        below: probability of a smaller value, any shape.
        above: probability of a larger value, of the same shape.

    Returns:
        Gaussian scores.
    """
    # The smaller probability is the accurate one, and one call of `ndtri`, a large program, serves both tails.
    lower = below < above
    score = ndtri(jnp.where(lower, below, above))
    return jnp.where(lower, score, -score)


def log_gamma_quantile(shape: Parameter, gaussian: Array) -> Array:
    """Logarithm of (quantile of a gamma variable of scale 1 over its shape) at Gaussian scores.

    Args:
        shape: a number above 0.
        gaussian: scores of any shape.

    Returns:
        Logarithms, of the shape of `gaussian`.

    Raises:
        ValueError: If `shape` is an array.
    """
    require(jnp.ndim(shape) == 0, "shape of a gamma as an array: give numbers for cov, power and lower")
    return _log_gamma_quantile(jnp.asarray(shape), gaussian)


@jax.jit
def _log_gamma_quantile(shape: Parameter, gaussian: Array) -> Array:
    low = (_LOG_REACH + gammaln(shape + 1)) / shape - jnp.log(shape)
    # Chernoff's bound: a gamma variable exceeds a + sqrt(2 a t) + t with probability below exp(-t).
    high = jnp.log1p(jnp.sqrt(-2 * _LOG_REACH / shape) - _LOG_REACH / shape)
    return _quantile(lambda w: shape * (w - jnp.expm1(w)), low, high, gaussian)


def logit_beta_quantile(first: Parameter, second: Parameter, gaussian: Array) -> Array:
    """Logit of the quantile of a beta variable on (0, 1) with shapes `first`, `second` (numbers above 0)."""
    require(jnp.ndim(first) == 0 and jnp.ndim(second) == 0, "moments of a beta as arrays: give numbers")
    return _logit_beta_quantile(jnp.asarray(first), jnp.asarray(second), gaussian)


@jax.jit
def _logit_beta_quantile(first: Parameter, second: Parameter, gaussian: Array) -> Array:
    norm_constant = betaln(first, second)
    low = (_LOG_REACH + jnp.log(first) + norm_constant) / first
    high = -(_LOG_REACH + jnp.log(second) + norm_constant) / second
    log_sigmoid = jax.nn.log_sigmoid
    return _quantile(lambda u: first * log_sigmoid(u) + second * log_sigmoid(-u), low, high, gaussian)


def _quantile(log_density: Callable[[Array], Array], low: Array, high: Array, gaussian: Array) -> Array:
    """Variable at the scores `gaussian`, from its unnormalised log density, which falls off on both sides."""
    gaussian = jnp.asarray(gaussian)
    low, high = jax.lax.stop_gradient((low, high))
    dtype = jnp.result_type(low, float)
    width = (high - low) / _PANELS
    edges = low + width * jnp.arange(_PANELS + 1, dtype=dtype)
    points, weights = np.polynomial.legendre.leggauss(4)
    inner = edges[:-1, None] + width * jnp.asarray((points + 1) / 2, dtype)
    top = jax.lax.stop_gradient(log_density(inner).max())
    panels = jnp.exp(log_density(inner) - top) @ jnp.asarray(weights / 2, dtype) * width
    at_edges = jnp.exp(log_density(edges) - top)
    # Beyond the ends the density falls exponentially.
    rate = jax.vmap(jax.grad(log_density))(edges[jnp.array([0, -1])])
    tails = at_edges[jnp.array([0, -1])] / jnp.abs(rate)
    below = jnp.concatenate([tails[:1], tails[0] + jnp.cumsum(panels)])
    above = jnp.concatenate([tails[1] + jnp.cumsum(panels[::-1])[::-1], tails[1:]])
    total = below[-1] + tails[1]
    scores = from_both_tails(below / total, above / total)
    slopes = jnp.exp(norm.logpdf(scores) + jnp.log(total) + top - log_density(edges))
    even = jnp.linspace(-_REACH, _REACH, _SCORES, dtype=dtype)
    panel = jnp.clip(jnp.searchsorted(scores, even) - 1, 0, _PANELS - 1)
    values, value_slopes = _cubic(edges, slopes, scores, panel, even)
    interval = jnp.floor((gaussian + _REACH) * ((_SCORES - 1) / (2 * _REACH)))
    interval = jnp.clip(interval, 0, _SCORES - 2).astype(int)
    within = jnp.clip(gaussian, -_REACH, _REACH)
    value, slope = _cubic(values, value_slopes, even, interval, within.astype(dtype))
    return value + slope * (gaussian - within)


def _cubic(values: Array, slopes: Array, knots: Array, panel: Array, at: Array) -> tuple[Array, Array]:
    """Hermite's cubic and its slope in the given panel of `knots`."""
    step = knots[panel + 1] - knots[panel]
    s = (at - knots[panel]) / step
    left, right = values[panel], values[panel + 1]
    left_slope, right_slope = slopes[panel] * step, slopes[panel + 1] * step
    rise = right - left
    bend, twist = 3 * rise - 2 * left_slope - right_slope, left_slope + right_slope - 2 * rise
    return left + s * (left_slope + s * (bend + s * twist)), (left_slope + s * (2 * bend + 3 * s * twist)) / step


@jax.jit
def log_gamma_rise(shape: Parameter, step: Array) -> Array:
    """Difference log Gamma(shape + step) - log Gamma(shape), without cancellation."""
    points, weights = np.polynomial.legendre.leggauss(24)
    shape, step = jnp.asarray(shape), jnp.asarray(step)
    values = digamma(shape[..., None] + step[..., None] * (points + 1) / 2)
    return step * (values @ jnp.asarray(weights / 2, values.dtype))


def log_moment_ratio(shape: Parameter, power: Parameter) -> Array:
    """Logarithm of E[x^2] / E[x]^2, which is log(1 + cov^2), of x = G^(1/power), G gamma of `shape`.

    The second difference of log Gamma is the integral of its second derivative, Hurwitz's zeta(2, x), times a hat
    function. This form has no cancellation.

    Args:
        shape: above 0.
        power: above 0; broadcasts against `shape`.

    Returns:
        log(1 + cov^2).
    """
    step = 1 / jnp.asarray(power)
    points, weights = np.polynomial.legendre.leggauss(24)
    ramp = (points + 1) / 2
    shape, step = jnp.broadcast_arrays(jnp.asarray(shape), step)
    # Both sides of the hat in one call: zeta is a large program.
    offsets = np.concatenate([ramp, 2 - ramp])
    values = zeta(2.0, shape[..., None] + step[..., None] * offsets)
    return step**2 * (values @ jnp.asarray(np.tile(ramp * weights / 2, 2), values.dtype))


@jax.jit
def gamma_shape(cov: Parameter, power: Parameter) -> Array:
    """Shape of the generalised gamma of exponent `power` with coefficient of variation `cov`."""
    return _falling_root(lambda shape: log_moment_ratio(shape, power), jnp.log1p(jnp.square(cov)))


@jax.jit
def weibull_power(cov: Parameter, shape: Parameter) -> Array:
    """Exponent of the generalised gamma of `shape` with coefficient of variation `cov`."""
    return _falling_root(lambda power: log_moment_ratio(shape, power), jnp.log1p(jnp.square(cov)))


def _falling_root(function: Callable[[Array], Array], target: Array) -> Array:
    """Root x in (1e-2, 1e8) of function(x) = target, function falling; differentiable by one last Newton step."""

    def halve(_: Array, bracket: tuple[Array, Array]) -> tuple[Array, Array]:
        low, high = bracket
        middle = (low + high) / 2
        above = function(jnp.exp(middle)) > target
        return jnp.where(above, middle, low), jnp.where(above, high, middle)

    target = jnp.asarray(target)
    bracket = (jnp.full_like(target, math.log(1e-2)), jnp.full_like(target, math.log(1e8)))
    low, high = jax.lax.stop_gradient(jax.lax.fori_loop(0, _HALVINGS, halve, bracket))
    root = jax.lax.stop_gradient((low + high) / 2)
    slope = jax.lax.stop_gradient(jax.grad(lambda w: function(jnp.exp(w)).sum())(root))
    return jnp.exp(root - (function(jnp.exp(root)) - target) / slope)


def require_rooted(root: Array, name: str, cov: Parameter) -> Array:
    """The root, unless it lies at an end of the bracket of `_falling_root`: no member of the family then has it."""
    require(
        (root > 1e-2) & (root < 1e8),
        f"cov = {cov} needs a {name} of {root}, outside 0.01 to 1e8: give a cov that the family can have",
    )
    return root


def cov_above(mean: Parameter, cov: Parameter, lower: Parameter) -> Parameter:
    """Coefficient of variation of x - lower, checked."""
    require(jnp.isfinite(mean) & (jnp.asarray(mean) > lower), f"mean = {mean} must be above the lower bound {lower}")
    require(
        jnp.isfinite(cov) & (jnp.asarray(cov) > 0),
        f"cov = {cov} must be above 0 for this family: use Normal or Lognormal for a constant",
    )
    # Exactly cov where there is no bound, so that the mean may be an array.
    return cov if isinstance(lower, int | float) and lower == 0 else cov * size_of(mean) / (mean - lower)


def truncated_parent(
    mean: Parameter, deviation: Parameter, lower: Parameter | None, upper: Parameter | None
) -> tuple[Array, Array, Array, Array]:
    """Centre and scale of the Gaussian that has a given mean and deviation once cut to [lower, upper].

    Args:
        mean: after the cut; a number.
        deviation: after the cut; a number.
        lower: bound, or None.
        upper: bound, or None.

    Returns:
        Centre, scale, and the bounds as scores of that Gaussian; an absent one lies 40 deviations out.

    Raises:
        ValueError: If there is no such Gaussian: the deviation is too large for the bounds.
    """
    mean, deviation = jnp.asarray(mean, float), jnp.asarray(deviation, float)
    require(
        mean.ndim == 0 and deviation.ndim == 0, "moments of a truncated normal as arrays: give numbers for mean and cov"
    )
    *parent, mismatch = _solve_parent(mean, deviation, lower, upper)
    require(
        mismatch < 1e-3,
        f"deviation = {deviation} about mean = {mean} cannot be had within the bounds {lower} and {upper}: "
        "lower the cov or widen the bounds",
    )
    centre, scale, low, high = parent
    return centre, scale, low, high


@jax.jit
def _solve_parent(
    mean: Array, deviation: Array, lower: Parameter | None, upper: Parameter | None
) -> tuple[Array, Array, Array, Array, Array]:
    """Newton's method on both moments; centre, scale, scores of the bounds, and the moments' largest mismatch."""

    def parent(unknown: Array, mean: Parameter, deviation: Parameter) -> tuple[Array, Array, Array, Array]:
        centre, scale = mean + unknown[0] * deviation, deviation * jnp.exp(unknown[1])
        low = jnp.full_like(centre, -40.0) if lower is None else (lower - centre) / scale
        high = jnp.full_like(centre, 40.0) if upper is None else (upper - centre) / scale
        return centre, scale, low, high

    def residual(unknown: Array, mean: Parameter, deviation: Parameter) -> Array:
        centre, scale, low, high = parent(unknown, mean, deviation)
        mass = normal_mass(low, high)
        low_pull, high_pull = norm.pdf(low) / mass, norm.pdf(high) / mass
        pull = low_pull - high_pull
        variance = 1 + low * low_pull - high * high_pull - pull**2
        return jnp.stack([(centre + scale * pull - mean) / deviation, jnp.log(variance) / 2 + unknown[1]])

    slopes = jax.jacfwd(residual)

    def step(_: Array, unknown: Array) -> Array:
        change = _solved(slopes(unknown, mean, deviation), residual(unknown, mean, deviation))
        return unknown - change / jnp.maximum(1, jnp.abs(change).max() / 0.5)

    unknown = jax.lax.stop_gradient(jax.lax.fori_loop(0, 60, step, jnp.zeros(2, mean.dtype)))
    mismatch = jnp.nan_to_num(jnp.abs(residual(unknown, mean, deviation)).max(), nan=jnp.inf)
    # One step more carries the derivatives by the implicit function theorem.
    jacobian = jax.lax.stop_gradient(slopes(unknown, mean, deviation))
    unknown = unknown - _solved(jacobian, residual(unknown, mean, deviation))
    return *parent(unknown, mean, deviation), jax.lax.stop_gradient(mismatch)


def _solved(matrix: Array, right: Array) -> Array:
    """Solution of two linear equations by Cramer's rule."""
    (a, b), (c, d) = matrix
    return jnp.stack([d * right[0] - b * right[1], a * right[1] - c * right[0]]) / (a * d - b * c)
