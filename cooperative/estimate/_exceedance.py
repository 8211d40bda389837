"""How likely it is that a slide does this or that: probabilities and expected values over all samples, from the slides.

What happens needs a failure, so its probability is P_f, by the campaign's estimator, times the share of the failures
that do it, by what the slides stand for. Both draws of the design are in those weights: which samples ran refined, and
which failures slid on to their end. Two-phase sampling: Sarndal, Swensson and Wretman (1992), Model Assisted Survey
Sampling, Sections 5.6 (ratios), 9.3 (two phases).

The variance is that of a product of two estimates, P_f with its own and the share with that of a linearised ratio. An
interval is Wilson's of as many independent samples as would scatter as much, with Student's t, as that of P_f itself.
Failures that no run has met are allowed for upwards, as in P_f, and taken to do it as often as others.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.stats import norm
from scipy.stats import t as student

from cooperative.estimate._estimates import Estimate
from cooperative.estimate._shares import MOST_LEVERAGE

POINTS = 61
"""Thresholds of a curve."""


@dataclass(frozen=True)
class Chances:
    """Probabilities, or expected values, one for each place or threshold (...). value: the estimate. low, high:
    pointwise confidence limits. count: slides that do it (...) int."""

    value: np.ndarray
    low: np.ndarray
    high: np.ndarray
    count: np.ndarray


def chance_of(found: Estimate, weight: np.ndarray, happens: np.ndarray) -> Chances:
    """Probability that a sample fails and does something, for many somethings at once.

    found: P_f. weight: what each slide stands for (n,), above 0; their scale does not matter. happens: whether each
    slide does it (n, ...) bool. Without a slide the probability is 0 and its upper limit that of P_f.
    Raises ValueError for shapes that do not fit.
    """
    weight, happens = _checked(weight, happens)
    shape = happens.shape[1:]
    if not weight.size:
        nothing = np.zeros(shape)
        return Chances(nothing, nothing, np.full(shape, found.interval[1]), nothing.astype(int))
    share, does = weight / weight.sum(), happens.reshape(weight.size, math.prod(shape)).astype(float)
    ratio = np.minimum(share @ does, 1.0)
    spread, freedom = _of_ratio(share, does, ratio)
    # None or all of the slides show no scatter: it is at least that of the mean share by Jeffreys' prior.
    alike = float(share @ share)
    nearer = (ratio + alike / 2) / (1 + alike)
    spread = np.maximum(spread, nearer * (1 - nearer) * alike)
    value = found.probability * ratio
    of_pf = (found.cov * found.probability) ** 2 if found.probability else 0.0
    variance = ratio**2 * of_pf + found.probability**2 * spread
    freedom = _welch((ratio**2 * of_pf, found.freedom), (found.probability**2 * spread, freedom))
    # What no slide did is what none of as many independent samples did.
    none = found.probability * alike
    with np.errstate(divide="ignore", invalid="ignore"):
        samples = np.where(value > 0, value * (1 - value) / variance, 1 / none if none else np.inf)
    low, high = _wilson(value, samples, freedom, found.level)
    # Failures that no run has met are taken to do it as often as others; none of it is likelier than a failure.
    high = np.minimum(value + np.hypot(high - value, ratio * found.unseen), found.interval[1])
    count = (does > 0).sum(axis=0)
    return Chances(value.reshape(shape), low.reshape(shape), high.reshape(shape), count.reshape(shape))


@dataclass(frozen=True)
class Curve:
    """Probability that a sample fails and its slide exceeds each of `thresholds` (k,)."""

    thresholds: np.ndarray
    chance: Chances


def exceedance(found: Estimate, weight: np.ndarray, values: np.ndarray, thresholds: np.ndarray | None = None) -> Curve:
    """Exceedance curve of what slides bring.

    found, weight: as for `chance_of`. values: of each slide (n,), 0 or more. thresholds: (k,); where none are given, 61
    even steps from 0 to the largest value, the first of which counts every failure, also those that bring nothing.
    Raises ValueError for shapes that do not fit and for values below 0 or not finite.
    """
    weight, values = _checked(weight, values)
    _check_amounts(values)
    at = np.linspace(0.0, float(values.max(initial=0.0)), POINTS) if thresholds is None else np.asarray(thresholds)
    beyond = values[:, None] > at
    chance = chance_of(found, weight, beyond)
    if thresholds is None:
        for values, of_failure in zip(
            (chance.value, chance.low, chance.high, chance.count),
            (found.probability, *found.interval, weight.size),
            strict=True,
        ):
            values[0] = of_failure
    return Curve(at, chance)


def mean_of(found: Estimate, weight: np.ndarray, amount: np.ndarray) -> Chances:
    """Expected value over all samples of what slides bring, 0 where nothing fails, for many things at once.

    found, weight: as for `chance_of`. amount: of each slide (n, ...), 0 or more. The interval is on the logarithm, as
    that of `mean_interval`; its upper limit is nan with fewer than 3 slides or where none brings anything.
    Raises ValueError for shapes that do not fit and amounts below 0 or not finite.
    """
    weight, amount = _checked(weight, amount)
    _check_amounts(amount)
    shape = amount.shape[1:]
    brings = amount.reshape(weight.size, math.prod(shape)).astype(float)
    count = (brings > 0).sum(axis=0).reshape(shape)
    if weight.size < 3:
        share = weight / weight.sum() if weight.size else weight
        value = (found.probability * (share @ brings)).reshape(shape)
        return Chances(value, np.zeros(shape), np.full(shape, np.nan), count)
    share = weight / weight.sum()
    ratio = share @ brings
    spread, freedom = _of_ratio(share, brings, ratio)
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = np.where(ratio > 0, spread / ratio**2, np.nan)
    of_pf = found.cov**2 if found.probability else np.nan
    freedom = _welch((np.full_like(relative, of_pf), found.freedom), (relative, freedom))
    half = _quantile(found.level, freedom) * np.sqrt(relative + of_pf)
    value = found.probability * ratio
    low = np.where(ratio > 0, value * np.exp(-half), 0.0)
    high = value * np.exp(np.minimum(half, 700.0))
    return Chances(value.reshape(shape), low.reshape(shape), high.reshape(shape), count)


def _checked(weight: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    weight, values = np.asarray(weight, float), np.asarray(values)
    if weight.ndim != 1 or values.shape[:1] != weight.shape or not (weight > 0).all():
        raise ValueError(
            f"weights have shape {weight.shape}, values {values.shape}: give (n,) above 0 and (n, ...), one for each "
            "slide"
        )
    return weight, values


def _check_amounts(values: np.ndarray) -> None:
    bad = values[~(np.isfinite(values) & (values >= 0))]
    if bad.size:
        raise ValueError(f"a slide brings {bad.flat[0]}: give finite amounts of 0 or more, and leave out the others")


def _of_ratio(share: np.ndarray, values: np.ndarray, ratio: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Variance of weighted means (k,) of values (n, k), and its degrees of freedom, as in `mean_interval`.

    What few slides do shows too little of its scatter: both are at least those of as many draws that are all alike.
    """
    parts = (share[:, None] * (values - ratio)) ** 2 / np.maximum(1 - share, MOST_LEVERAGE)[:, None] ** 2
    variance, squares = parts.sum(axis=0), (parts**2).sum(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        freedom = np.where(squares > 0, variance**2 / squares - 1, np.inf)
    alike = float(share @ share)
    plain = np.maximum(share @ values**2 - ratio**2, 0.0) * alike / max(1 - alike, MOST_LEVERAGE)
    return np.maximum(variance, plain), np.maximum(freedom, max(1 / alike - 1, 1.0))


def _welch(*parts: tuple[np.ndarray, np.ndarray | float]) -> np.ndarray:
    """Degrees of freedom of a sum of independent variances, each with its own: Satterthwaite (1946)."""
    whole = sum(variance for variance, _ in parts)
    square = sum(variance**2 / freedom for variance, freedom in parts)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(square > 0, np.maximum(whole**2 / square, 1.0), np.inf)


def _quantile(level: float, freedom: np.ndarray) -> np.ndarray:
    normal = norm.ppf(0.5 + level / 2)
    return np.where(np.isinf(freedom), normal, student.ppf(0.5 + level / 2, np.where(np.isinf(freedom), 1e9, freedom)))


def _wilson(share: np.ndarray, samples: np.ndarray, freedom: np.ndarray, level: float) -> tuple[np.ndarray, np.ndarray]:
    """`wilson_interval` of many shares at once."""
    z = _quantile(level, freedom)
    each = z**2 / samples
    centre = (share + each / 2) / (1 + each)
    half = z / (1 + each) * np.sqrt(share * (1 - share) / samples + each / (4 * samples))
    return np.where(share == 0, 0.0, np.maximum(centre - half, 0.0)), np.where(share == 1, 1.0, centre + half)
