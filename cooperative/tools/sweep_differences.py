"""Differences between campaigns of the same samples, sharper than the two answers.

An estimator counts failures at each sample: z_i, whose mean is P_f and whose expectation, over the draws of the audit,
is the class of sample i (`Failures.count`, times the number of samples). Where sample i of two campaigns has the same
coefficients, their difference of P_f is the mean of d_i = z_i' - z_i. The spread of d_i over the samples gives its
variance: it holds that of the samples, in which what they have in common cancels, and that of both audits, in which
draws of the same sample cancel as far as its classes agree: campaigns of a sweep share all their draws
(`cooperative.tools.sweep_audit`). This is the variance of a mean of draws with replacement, as for other means
(Sarndal, Swensson and Wretman 1992, Model Assisted Survey Sampling, Sections 2.9 and 9.3): it neglects that a Latin
hypercube spreads the samples, and counts the draws of an audit as independent, both of which make it larger.

Half a refined sample that fails in one campaign alone is added on each side (Agresti and Min 2005, Statistics in
Medicine 24, 729-740, DOI 10.1002/sim.1781), without which campaigns of equal classes would have no interval. It counts
for as many samples as a refined run in doubt stands for (`unit_of`): one where all ran refined, several where few did.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student

from cooperative.estimate import LEAST_FREEDOM, LEVEL, Failures


@dataclass(frozen=True)
class Difference:
    """Difference of two probabilities of failure of the same samples.

    Args:
        difference: of P_f, to that of the base.
        interval: its confidence limits.
        unpaired: half the width of the interval that independent samples would give, over that of this one.
    """

    difference: float
    interval: tuple[float, float]
    unpaired: float

    @property
    def resolved(self) -> bool:
        """Whether its interval leaves one sign alone."""
        return not self.interval[0] <= 0 <= self.interval[1]


def by_sample(failures: Failures, probability: float, samples: int) -> np.ndarray:
    """Failures counted at each sample.

    Args:
        failures: of a campaign.
        probability: of failure, by its estimator.
        samples: number of them.

    Returns:
        (samples,), whose mean is the probability.
    """
    counted = np.bincount(failures.number, failures.count, samples) * samples
    mean = float(counted.mean())
    return counted * (probability / mean) if mean > 0 else np.full(samples, probability)


def unit_of(weights: Mapping[int, float], samples: int, doubt: Sequence[float] | None = None) -> float:
    """How many samples a refined run stands for on average, the more it counts the more doubt was in it.

    Args:
        weights: share of all samples that each refined run stands for, by its number.
        samples: number of them.
        doubt: of each sample (samples,), see `SharedAudit`; None for equal ones.
    """
    doubts = np.ones(len(weights)) if doubt is None else np.asarray(doubt)[list(weights)]
    mean = float(doubts @ np.fromiter(weights.values(), float)) / max(float(doubts.sum()), np.finfo(float).tiny)
    return max(samples * mean, 1.0)


def covariance_of(counted: Sequence[np.ndarray], variance: Sequence[float], *, unit: float = 1.0) -> np.ndarray:
    """Covariance of the probabilities of failure of campaigns of the same samples.

    Where no failure was found among few refined runs, the failures counted do not scatter, and the estimator's own
    variance is the larger one; rows and columns are multiplied up to that.

    Args:
        counted: at each sample, of every campaign (N,), see `by_sample`.
        variance: of each probability by its estimator (J,).
        unit: samples that a refined run stands for, see `unit_of`.

    Returns:
        (J, J).
    """
    z = np.stack(counted)
    spread = np.atleast_2d(np.cov(z)) / z.shape[1] + np.eye(len(z)) * (unit / z.shape[1]) ** 2 / 2
    up = np.sqrt(np.maximum(np.asarray(variance) / np.diag(spread), 1.0))
    return spread * np.outer(up, up)


def paired_difference(
    base: np.ndarray,
    other: np.ndarray,
    variance: Sequence[float] = (0.0, 0.0),
    *,
    unit: float = 1.0,
    level: float = LEVEL,
) -> Difference:
    """Difference of the probabilities of failure of two campaigns of the same samples.

    Args:
        base: failures counted at each sample (N,), see `by_sample`.
        other: those of the other campaign (N,).
        variance: of both probabilities by their estimator, see `covariance_of`.
        unit: samples that a refined run stands for, see `unit_of`.
        level: confidence level of the interval.
    """
    change = other - base
    difference = float(change.mean())
    squares = (change - difference) ** 2
    spread = float(squares.sum())
    both = covariance_of((base, other), variance, unit=unit)
    scatter = max((spread + unit**2) / change.size**2, float(both[0, 0] + both[1, 1] - 2 * both[0, 1]))
    freedom = max(spread**2 / float(squares @ squares), LEAST_FREEDOM) if spread > 0 else float(change.size)
    half = float(student.ppf(0.5 + level / 2, freedom)) * np.sqrt(scatter)
    interval = max(difference - half, -1.0), min(difference + half, 1.0)
    return Difference(difference, (float(interval[0]), float(interval[1])), float(np.sqrt(np.trace(both) / scatter)))
