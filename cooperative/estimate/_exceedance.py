"""How likely it is that a slide does this or that: probabilities and expected values over all samples, from the slides.

What happens needs a failure, so its probability is P_f, by the campaign's estimator, times the share of the failures
that do it, by what the slides stand for. Both draws of the design are in those weights: which samples ran refined, and
which failures slid on to their end. Two-phase sampling: Sarndal, Swensson and Wretman (1992), Model Assisted Survey
Sampling, Sections 5.6 (ratios), 9.3 (two phases).

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
from scipy.stats import norm
from scipy.stats import t as student

from cooperative.estimate._estimates import Estimate, wilson_interval
from cooperative.estimate._shares import LEAST_FREEDOM, MOST_LEVERAGE, too_few

POINTS = 61
"""Thresholds of a curve."""


@dataclass(frozen=True)
class Chances:
    """Probabilities, or expected values, one for each place or threshold (...). value: the estimate. low, high:
    pointwise confidence limits, of the sampling. count: slides that do it (...) int."""

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
    probability, (least, most) = found.probability, _of_sampling(found)
    ratio, low, high = _share_limits(share, does, found.level)
    value = probability * ratio
    low = np.maximum(value - np.hypot(ratio * (probability - least), probability * (ratio - low)), 0.0)
    high = value + np.hypot(ratio * (most - probability), probability * (high - ratio))
    # What no slide did is what none of as many independent samples did, each as heavy as the heaviest slide.
    heaviest = probability * float(share.max())
    none = wilson_interval(0, 1 / heaviest, found.level)[1] if heaviest else found.interval[1]
    high = np.minimum(np.where(ratio == 0, none, high), found.interval[1])
    count = (does > 0).sum(axis=0)
    return Chances(value.reshape(shape), low.reshape(shape), high.reshape(shape), count.reshape(shape))


@dataclass(frozen=True)
class Curve:
    """Probability that a sample fails and its slide exceeds each of `thresholds` (k,): `chance`, with intervals."""

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
            (found.probability, *_of_sampling(found), weight.size),
            strict=True,
        ):
            values[0] = of_failure
    return Curve(at, chance)


def mean_of(found: Estimate, weight: np.ndarray, amount: np.ndarray) -> Chances:
    """Expected value over all samples of what slides bring, 0 where nothing fails, for many things at once.

    found, weight: as for `chance_of`. amount: of each slide (n, ...), 0 or more. The interval is on the logarithm, as
    that of `mean_interval`; it is 0 to nan where the slides are too few for that one, or none brings anything.
    Raises ValueError for shapes that do not fit and amounts below 0 or not finite.
    """
    weight, amount = _checked(weight, amount)
    _check_amounts(amount)
    shape = amount.shape[1:]
    brings = amount.reshape(weight.size, math.prod(shape)).astype(float)
    count = (brings > 0).sum(axis=0).reshape(shape)
    if too_few(weight):
        share = weight / weight.sum() if weight.size else weight
        value = (found.probability * (share @ brings)).reshape(shape)
        return Chances(value, np.zeros(shape), np.full(shape, np.nan), count)
    share = weight / weight.sum()
    ratio = share @ brings
    spread, freedom = _of_ratio(share, brings, ratio)
    # What few slides bring shows too little of its scatter, which is at least that of as many draws that are all alike.
    alike = float(share @ share)
    spread = np.maximum(spread, np.maximum(share @ brings**2 - ratio**2, 0.0) * alike / max(1 - alike, MOST_LEVERAGE))
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = np.where(ratio > 0, spread / ratio**2, np.nan)
    of_pf = found.cov**2 if found.probability else np.nan
    freedom = _welch((np.full_like(relative, of_pf), found.freedom), (relative, freedom))
    half = _quantile(found.level, np.maximum(freedom, LEAST_FREEDOM)) * np.sqrt(relative + of_pf)
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


def _of_sampling(found: Estimate) -> tuple[float, float]:
    """Limits of P_f without an allowance for failures that no run has met."""
    return found.interval if found.sampling_interval is None else found.sampling_interval


def _share_limits(share: np.ndarray, does: np.ndarray, level: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Share of the slides that do something, and its confidence limits, (k,) each. share: of each slide in the weight
    (n,). does: 0 or 1 (n, k)."""
    every = does.all(axis=0)
    ratio = np.where(every, 1.0, np.minimum(share @ does, 1.0))
    low, _ = _wilson_of(ratio, ratio, share, does, level)
    # Of what all slides did, the standard deviation by Jeffreys' prior.
    apart = _quantile(level, np.array(np.inf)) * float(share @ share) / math.sqrt(2)
    low = np.where(every, max(1 - float(apart), 0.0), low)
    whole = 1 + share.max()
    with_one_more = np.append(share, share.max()) / whole, np.vstack([does, np.ones(does.shape[1])])
    _, high = _wilson_of(ratio, (ratio + share.max()) / whole, *with_one_more, level)
    return ratio, low, np.where(every, 1.0, high)


def _wilson_of(
    ratio: np.ndarray, nearer: np.ndarray, share: np.ndarray, does: np.ndarray, level: float
) -> tuple[np.ndarray, np.ndarray]:
    """Wilson's limits of a ratio (k,), of as many independent slides as scatter about `nearer` (k,) as these do."""
    spread, freedom = _of_ratio(share, does, nearer)
    some = spread > 0
    slides = np.where(some, nearer * (1 - nearer) / np.where(some, spread, 1.0), np.inf)
    return _wilson(ratio, slides, freedom, level)


def _of_ratio(share: np.ndarray, values: np.ndarray, ratio: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Variance of weighted means (k,) of values (n, k), and its degrees of freedom, as in `mean_interval`; these are at
    least those of as many draws that are all alike."""
    parts = (share[:, None] * (values - ratio)) ** 2 / np.maximum(1 - share, MOST_LEVERAGE)[:, None] ** 2
    variance, squares = parts.sum(axis=0), (parts**2).sum(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        freedom = np.where(squares > 0, variance**2 / squares - 1, np.inf)
    return variance, np.maximum(freedom, max(1 / float(share @ share) - 1, 1.0))


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
