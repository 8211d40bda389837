"""Shares, means and correlations of samples that do not all stand for the same number of others."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import norm
from scipy.stats import t as student

from cooperative.estimate._estimates import wilson_interval


def effective_size(weight: np.ndarray) -> float:
    """How many equally weighted samples tell as much as these (n,): Kish (1965), Survey Sampling, Section 11.7."""
    weight = np.asarray(weight, dtype=float)
    return float(weight.sum() ** 2 / (weight @ weight)) if weight.size else 0.0


def too_few(weight: np.ndarray) -> bool:
    """Whether samples with these weights (n,) are too few for the interval of a mean."""
    return effective_size(weight) < FEWEST * (1 - 1e-9)


@dataclass(frozen=True)
class Share:
    """A part of a whole. count: samples in it. share: weighted. interval: confidence limits."""

    count: int
    share: float
    interval: tuple[float, float]


def shares(group: np.ndarray, weight: np.ndarray, names: tuple[str, ...], *, level: float = 0.95) -> dict[str, Share]:
    """Share of each named group among samples (n,), n at least 1, with the Wilson interval of their effective size."""
    size, total = effective_size(weight), float(np.sum(weight))
    found = {}
    for name in names:
        mine = np.asarray(group) == name
        share = min(float(np.sum(weight[mine])) / total, 1.0)
        found[name] = Share(int(mine.sum()), share, wilson_interval(share * size, size, level))
    return found


def mean_interval(values: np.ndarray, weight: np.ndarray, *, level: float = 0.95) -> tuple[float, float] | None:
    """Confidence limits of the weighted mean of positive values (n,), None where they are effectively fewer than
    `FEWEST`, or all are 0. weight: above 0 (n,).

    The mean is a ratio of two totals, each of samples drawn with unequal chances, which the weights undo. Its variance
    is that of the linearised ratio for draws with replacement, the sum of the squared residuals times their shares of
    the weight: without a finite population's correction it holds both phases of draws and the sampling of the
    population itself (Sarndal, Swensson and Wretman 1992, Model Assisted Survey Sampling, Sections 2.9, 5.6 and 9.3).
    Residuals are over one less their share, since a heavy sample draws the mean to itself (MacKinnon and White 1985,
    Journal of Econometrics 29, 305-325, DOI 10.1016/0304-4076(85)90158-7). Student's t has the degrees of freedom that
    the variance tells (Satterthwaite 1946, DOI 10.2307/3002019), at least `LEAST_FREEDOM`. On the logarithm: a mean
    that is too low for want of its longest slides has a variance that is too low as well.
    """
    values, weight = np.asarray(values, float), np.asarray(weight, float)
    share = weight / weight.sum()
    mean = float(share @ values)
    if too_few(weight) or not mean > 0:
        return None
    parts = (share * (values - mean) / np.maximum(1 - share, MOST_LEVERAGE)) ** 2
    variance = float(parts.sum())
    if variance == 0:
        return mean, mean
    freedom = max(variance**2 / float(parts @ parts) - 1, LEAST_FREEDOM)
    half = float(student.ppf(0.5 + level / 2, freedom)) * np.sqrt(variance) / mean
    return mean * float(np.exp(-half)), mean * float(np.exp(half))


FEWEST = 5
"""Effective number of samples from which on a mean has an interval: fewer show too little of their scatter."""
LEAST_FREEDOM = 3.0
"""Degrees of freedom that a variance of `FEWEST` or more samples has at least. With 1 or 2 the upper limits of made-up
campaigns reached 15,000 and 46 times the truth, with 3 they reach 21 times, and hold it as often to within 1 %."""
MOST_LEVERAGE = 0.05
"""One less the share of a sample that weighs nearly all: its residual tells nothing, and is not taken for more."""


@dataclass(frozen=True)
class Correlation:
    """How well the rough grid tells the refined one, over samples run on both, each with its weight.

    samples: run on both. spearman: of the ranks, with its interval. pearson_log: of the logarithm of the largest
    displacement. same_class: share of samples that both grids call failed or both standing. phi: correlation of the
    two classes, None where either grid has one class only.
    """

    samples: int
    spearman: float
    interval: tuple[float, float]
    pearson_log: float
    same_class: float
    phi: float | None


def correlation(
    rough: np.ndarray, refined: np.ndarray, weight: np.ndarray, *, failure_displacement: float, level: float = 0.95
) -> Correlation | None:
    """Correlation between the grids; None for fewer than 4 samples, or without any spread.

    rough, refined: largest displacements (n,) m of the same samples. weight: (n,). failure_displacement: beyond which
    a sample has failed (m). The interval of the rank correlation is Fisher's, with the variance of Bonett and Wright
    (2000), Psychometrika 65, 23-28, for the effective number of samples.
    """
    if rough.size < 4 or np.ptp(rough) == 0 or np.ptp(refined) == 0:
        return None
    ranks = _ranks(rough, weight), _ranks(refined, weight)
    spearman = min(max(_pearson(*ranks, weight), -1.0), 1.0)
    size = max(effective_size(weight), 3.5)
    half = float(norm.ppf(0.5 + level / 2) * np.sqrt((1 + spearman**2 / 2) / (size - 3)))
    middle = np.arctanh(min(max(spearman, -1 + 1e-12), 1 - 1e-12))
    fails = (rough > failure_displacement).astype(float), (refined > failure_displacement).astype(float)
    both = np.ptp(fails[0]) > 0 and np.ptp(fails[1]) > 0
    tiny = np.finfo(float).tiny
    return Correlation(
        samples=rough.size,
        spearman=spearman,
        # At a correlation of 1 the limits round to just below it.
        interval=(min(float(np.tanh(middle - half)), spearman), max(float(np.tanh(middle + half)), spearman)),
        pearson_log=_pearson(np.log(np.maximum(rough, tiny)), np.log(np.maximum(refined, tiny)), weight),
        same_class=float(weight[fails[0] == fails[1]].sum() / weight.sum()),
        phi=_pearson(*fails, weight) if both else None,
    )


def _ranks(values: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Weighted ranks from 0 to 1: the share below, and half of that which is equal."""
    distinct, place = np.unique(values, return_inverse=True)
    share = np.bincount(place, weight, distinct.size) / weight.sum()
    return (np.cumsum(share) - share / 2)[place]


def _pearson(a: np.ndarray, b: np.ndarray, weight: np.ndarray) -> float:
    share = weight / weight.sum()
    a, b = a - share @ a, b - share @ b
    return float((share @ (a * b)) / np.sqrt((share @ a**2) * (share @ b**2)))
