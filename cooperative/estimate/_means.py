"""Weighted shares and means of what slides do, with their intervals.

What a slide does needs a failure, so its probability is P_f, by the campaign's estimator, times the share of the
failures that do it, by what the slides stand for. Both draws of the design are in those weights: which samples ran
refined, and which failures slid on to their end. Two-phase sampling: Sarndal, Swensson and Wretman (1992), Model
Assisted Survey Sampling, Sections 5.6 (ratios), 9.3 (two phases).

The interval is put together from those of P_f and of the share, two independent factors, whose distances from the
estimates add up as squares (Zou and Donner 2008, Statistics in Medicine 27, 1693-1702, DOI 10.1002/sim.3095). That of
the share is Wilson's of as many independent slides as would scatter as much as the linearised ratio does, with
Student's t. Slides that are seldom drawn weigh most, so few slides, or none, that do something show too little of its
scatter: the upper limit allows for one slide more, as heavy as the heaviest (as Fay and Feuer do for weighted counts,
1997, Statistics in Medicine 16, 791-801).

The interval of P_f that goes in is that of the sampling. What P_f's own allows above it, for failures that no run has
met wherever they hide, is in none of these: nobody knows what such failures would do.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy

from cooperative.estimate._estimates import (
    ALIKE,
    LEAST_FREEDOM,
    LEVEL,
    MOST_LEVERAGE,
    Estimate,
    quantile,
    too_few,
    wilson_interval,
    wilson_limits,
)

POINTS = 61
"""Thresholds of a curve."""


@dataclass(frozen=True)
class Chances:
    """Probabilities, or expected values, one for each column or threshold (...).

    Args:
        value: the estimate.
        low: pointwise confidence limits, of the sampling.
        high: pointwise confidence limits, of the sampling.
        count: slides that do it (...) int.
    """

    value: np.ndarray
    low: np.ndarray
    high: np.ndarray
    count: np.ndarray


def chance_of(estimate: Estimate, weight: np.ndarray, happens: np.ndarray) -> Chances:
    """Probability that a sample fails and does something, for many somethings at once.

    Args:
        estimate: P_f.
        weight: what each slide stands for (n,), above 0; their scale does not matter.
        happens: whether each slide does it (n, ...) bool. Without a slide the probability is 0 and its upper limit that
            of P_f.

    Raises:
        ValueError: shapes that do not fit.
    """
    normalised, does, shape = _by_slide(weight, happens)
    if not normalised.size:
        return Chances(np.zeros(shape), np.zeros(shape), np.full(shape, estimate.interval[1]), np.zeros(shape, int))
    probability, (least, most) = estimate.probability, estimate.sampling_interval or estimate.interval
    ratio, low, high = _share_limits(normalised, does, estimate.level)
    value = probability * ratio
    low = np.maximum(value - np.hypot(ratio * (probability - least), probability * (ratio - low)), 0.0)
    high = value + np.hypot(ratio * (most - probability), probability * (high - ratio))
    # What no slide did is what none of as many independent samples did, each as heavy as the heaviest slide.
    heaviest = probability * float(normalised.max())
    none = wilson_interval(0, 1 / heaviest, estimate.level)[1] if heaviest else estimate.interval[1]
    high = np.minimum(np.where(ratio == 0, none, high), estimate.interval[1])
    return Chances(*(values.reshape(shape) for values in (value, low, high, (does > 0).sum(axis=0))))


@dataclass(frozen=True)
class Exceedance:
    """Probability that a sample fails and exceeds each of some thresholds.

    Args:
        thresholds: (k,), ascending.
        probability: (k,).
        low: lower confidence limits (k,).
        high: upper confidence limits (k,).
    """

    thresholds: tuple[float, ...]
    probability: tuple[float, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]


def exceedance(
    estimate: Estimate, weight: np.ndarray, values: np.ndarray, thresholds: np.ndarray | None = None
) -> Exceedance:
    """Exceedance curve of what slides bring, failures that stay below included.

    Args:
        estimate: as for `chance_of`.
        weight: as for `chance_of`.
        values: of each slide (n,), 0 or more.
        thresholds: (k,); where none are given, 61 even steps from 0 to the largest value, the first of which counts
            every failure, also those that bring nothing.

    Raises:
        ValueError: shapes that do not fit and for values below 0 or not finite.
    """
    _, brings, _ = _by_slide(weight, values)
    _check_amounts(brings)
    at = np.linspace(0.0, float(brings.max(initial=0.0)), POINTS) if thresholds is None else np.asarray(thresholds)
    chance = chance_of(estimate, weight, brings > at)
    if thresholds is None:
        chance.value[0] = estimate.probability
        chance.low[0], chance.high[0] = estimate.sampling_interval or estimate.interval
    return Exceedance(*(tuple(values.tolist()) for values in (at, chance.value, chance.low, chance.high)))


def mean_of(estimate: Estimate, weight: np.ndarray, amount: np.ndarray) -> Chances:
    """Expected value over all samples of what slides bring, 0 where nothing fails, for many things at once.

    Args:
        estimate: as for `chance_of`.
        weight: as for `chance_of`.
        amount: of each slide (n, ...), 0 or more. The interval is that of `mean_interval` with the variance of P_f; it
            is 0 to nan where the slides are too few for that one, none brings anything, or P_f has no variance yet.

    Raises:
        ValueError: shapes that do not fit and amounts below 0 or not finite.
    """
    normalised, brings, shape = _by_slide(weight, amount)
    _check_amounts(brings)
    ratio, count = normalised @ brings, (brings > 0).sum(axis=0)
    value, low, high = estimate.probability * ratio, np.zeros(ratio.shape), np.full(ratio.shape, np.nan)
    if not too_few(normalised) and np.isfinite(estimate.cov):
        spread, freedom = _of_ratio(normalised, brings, ratio)
        relative, of_pf = spread / np.where(ratio > 0, ratio, np.nan) ** 2, estimate.cov**2
        # Degrees of freedom of a sum of independent variances: Satterthwaite (1946).
        square = of_pf**2 / estimate.freedom + relative**2 / freedom
        freedom = np.where(square > 0, (of_pf + relative) ** 2 / np.where(square > 0, square, 1.0), np.inf)
        half = _half_width(relative + of_pf, freedom, estimate.level)
        low = np.where(ratio > 0, value * np.exp(-half), 0.0)
        # P_f at its lower limit, whatever its variance, which is 0 where all samples fail.
        low = np.minimum(low, estimate.interval[0] * brings.max(axis=0, initial=0.0))
        high = value * np.exp(np.minimum(half, 700.0))
    return Chances(*(values.reshape(shape) for values in (value, low, high, count)))


def mean_interval(values: np.ndarray, weight: np.ndarray, *, level: float = LEVEL) -> tuple[float, float] | None:
    """Confidence limits of the weighted mean of positive values.

    The mean is a ratio of two totals, each of samples drawn with unequal chances, which the weights undo. Its variance
    is that of the linearised ratio for draws with replacement, the sum of the squared residuals times their shares of
    the weight: without a finite population's correction it holds both phases of draws and the sampling of the
    population itself (Sarndal, Swensson and Wretman 1992, Model Assisted Survey Sampling, Sections 2.9, 5.6 and 9.3).
    Residuals are over one less their share, since a heavy sample draws the mean to itself (MacKinnon and White 1985,
    Journal of Econometrics 29, 305-325, DOI 10.1016/0304-4076(85)90158-7). Student's t has the degrees of freedom that
    the variance has (Satterthwaite 1946, DOI 10.2307/3002019), at least `LEAST_FREEDOM`. On the logarithm: a mean
    that is too low for want of its longest slides has a variance that is too low as well.

    Args:
        values: (n,), 0 or more.
        weight: (n,), above 0.
        level: confidence level of the interval.

    Returns:
        The limits, None for effectively fewer values than `FEWEST`, and where all are 0 or alike, which shows nothing
        of how they scatter.
    """
    normalised, brings, _ = _by_slide(weight, values)
    mean = float(normalised @ brings[:, 0])
    if too_few(normalised) or not mean > 0 or float(np.ptp(brings)) <= ALIKE * mean:
        return None
    # Relative to the mean, so that no square leaves the range of floating point.
    half = float(_half_width(*_of_ratio(normalised, brings / mean, np.ones(1)), level)[0])
    return mean * math.exp(-half), mean * math.exp(half)


def _half_width(variance: np.ndarray, freedom: np.ndarray, level: float) -> np.ndarray:
    """Half of the interval (k,) of the logarithm of means, whose relative variance has so many degrees of freedom."""
    return quantile(level, np.maximum(freedom, LEAST_FREEDOM)) * np.sqrt(variance)


def _by_slide(weight: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray, tuple[int, ...]]:
    """Share of each slide in the weight (n,), its values in a row (n, k), and their shape."""
    weight, values = np.asarray(weight, float), np.asarray(values)
    if weight.ndim != 1 or values.shape[:1] != weight.shape or not (weight > 0).all():
        raise ValueError(
            f"weights have shape {weight.shape}, values {values.shape}: give (n,) above 0 and (n, ...), one for each "
            "slide"
        )
    shape = values.shape[1:]
    return weight / (weight.sum() or 1.0), values.reshape(weight.size, math.prod(shape)).astype(float), shape


def _check_amounts(values: np.ndarray) -> None:
    bad = values[~(np.isfinite(values) & (values >= 0))]
    if bad.size:
        raise ValueError(f"a slide brings {bad.flat[0]}: give finite amounts of 0 or more, and leave out the others")


def _share_limits(normalised: np.ndarray, does: np.ndarray, level: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Share of the slides that do something, and its confidence limits, (k,) each.

    Args:
        normalised: of each slide in the weight (n,).
        does: 0 or 1 (n, k).
        level: confidence level of the interval.
    """
    every = does.all(axis=0)
    ratio = np.where(every, 1.0, np.minimum(normalised @ does, 1.0))
    low, _ = _limits_of_ratio(ratio, ratio, normalised, does, level)
    # Of what all slides did, the standard deviation by Jeffreys' prior.
    apart = scipy.special.ndtri(0.5 + level / 2) * float(normalised @ normalised) / math.sqrt(2)
    low = np.where(every, max(1 - float(apart), 0.0), low)
    whole = 1 + normalised.max()
    with_one_more = np.append(normalised, normalised.max()) / whole, np.vstack([does, np.ones(does.shape[1])])
    _, high = _limits_of_ratio(ratio, (ratio + normalised.max()) / whole, *with_one_more, level)
    return ratio, low, np.where(every, 1.0, high)


def _limits_of_ratio(
    ratio: np.ndarray, nearer: np.ndarray, normalised: np.ndarray, does: np.ndarray, level: float
) -> tuple[np.ndarray, np.ndarray]:
    """Wilson's limits of a ratio (k,), of as many independent slides as scatter about `nearer` (k,) as these do."""
    spread, freedom = _of_ratio(normalised, does, nearer)
    # At least those of as many draws that are all alike.
    freedom = np.maximum(freedom, max(1 / float(normalised @ normalised) - 1, 1.0))
    some = spread > 0
    slides = np.where(some, nearer * (1 - nearer) / np.where(some, spread, 1.0), np.inf)
    return wilson_limits(ratio, slides, freedom, level)


def _of_ratio(normalised: np.ndarray, values: np.ndarray, ratio: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Variance of weighted means (k,) of values (n, k), and its degrees of freedom, see `mean_interval`."""
    parts = (normalised[:, None] * (values - ratio) / np.maximum(1 - normalised, MOST_LEVERAGE)[:, None]) ** 2
    variance, squares = parts.sum(axis=0), (parts**2).sum(axis=0)
    return variance, np.where(squares > 0, variance**2 / np.where(squares > 0, squares, 1.0) - 1, np.inf)
