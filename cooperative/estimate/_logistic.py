"""A logistic model of failure on the refined grid, given the rank on the rough one."""

from __future__ import annotations

import numpy as np
import scipy

from cooperative.estimate._protocol import Population
from cooperative.estimate._ranking import rank_samples


def fit_logistic(score: np.ndarray, failed: np.ndarray, centre: float) -> tuple[float, float]:
    """Intercept a and slope b of P(failure) = 1 / (1 + exp(-(a + b (score - centre)))), b at least 0.3.

    Maximum a posteriori with a ~ N(0, 3^2), b ~ N(4, 2^2): scores are normal, so that grids correlated by 0.8 to 0.98
    have slopes of 2 to 9. Newton steps on a concave function.

    Args:
        score: normal scores (n,), n may be 0.
        failed: 0 or 1 (n,).
        centre: score at which the model is centred.
    """
    x = score - centre
    a, b = 0.0, 4.0
    for _ in range(50):
        p = scipy.special.expit(a + b * x)
        off, weight = failed - p, p * (1 - p)
        # Gradient and curvature of the two coefficients: the system is solved by Cramer's rule.
        of_a, of_b = float(off.sum()) - a / 9, float(off @ x) - (b - 4.0) / 4
        slant = weight * x
        aa, ab, bb = float(weight.sum()) + 1 / 9, float(slant.sum()), float(slant @ x) + 1 / 4
        determinant = aa * bb - ab * ab
        step_a, step_b = (bb * of_a - ab * of_b) / determinant, (aa * of_b - ab * of_a) / determinant
        shorter = min(1.0, 2.0 / max(abs(step_a), abs(step_b), 1e-300))
        before, a, b = (a, b), a + shorter * step_a, max(b + shorter * step_b, 0.3)
        if max(abs(a - before[0]), abs(b - before[1])) < 1e-8:
            break
    return a, b


def predict_logistic(coefficients: tuple[float, float], score: np.ndarray, centre: float) -> np.ndarray:
    """Probability of failure at each score, at least 1e-30, below what any rank far out is worth, at most 1 - 1e-9."""
    return np.clip(scipy.special.expit(coefficients[0] + coefficients[1] * (score - centre)), 1e-30, 1 - 1e-9)


TAIL = 0.6
"""Scale of the scores of rare ranks: the usual slope of 4 is then a power of 1.5 of the share that ranks above."""


def score_of(share: np.ndarray, *, rare: bool = False) -> np.ndarray:
    """Score at which so many of all samples rank above: the normal quantile, far out the logarithm.

    Far out the density of normal scores falls faster than a logistic in them, whatever the slope: with a slope of 4 and
    the middle at a share of 1e-6, the model would have 16 times as many failures, most at a share of 1e-4. In the
    logarithm of the share the ratio is the same at any depth.

    Args:
        share: that ranks above (...), above 0.
        rare: whether ranks far out matter, those of subset simulation.
    """
    return -TAIL * np.log(share) if rare else -scipy.special.ndtri(share)


def normal_scores(weight: np.ndarray, *, rare: bool = False) -> np.ndarray:
    """Scores of the ranks, largest first, of samples with the given weights (N,), as in `score_of`."""
    share = weight / weight.sum()
    return score_of(np.cumsum(share) - share / 2, rare=rare)


def rough_centre(
    rough_displacement: np.ndarray, weight: np.ndarray, failure_displacement: float, *, rare: bool = False
) -> float:
    """Score at which the rough displacement reaches the failure displacement.

    It is a first guess of where the probability of failure is one half, between the median and the worst sample, and
    affects efficiency alone. Rough runs that broke off (not finite) count as beyond.

    Args:
        rough_displacement: by rank (N,) m.
        weight: of each rank (N,).
        failure_displacement: beyond which a sample has failed (m).
        rare: as in `score_of`.
    """
    whole = weight.sum()
    share = float(weight[~(np.asarray(rough_displacement) < failure_displacement)].sum() / whole)
    return float(score_of(np.array(min(max(share, 0.5 * weight.min() / whole), 0.5)), rare=rare))


def prior_chances(population: Population) -> np.ndarray:
    """Probability that each sample fails, by the model before any refined result (N,).

    Args:
        population: first phase, of equally weighted samples.
    """
    order, weight = rank_samples(population.rough_displacement, population.broke_off).order, population.weights
    centre = rough_centre(population.rough_displacement[order], weight, population.failure_displacement)
    chances = np.empty(population.size)
    prior = fit_logistic(np.zeros(0), np.zeros(0), 0.0)
    chances[order] = predict_logistic(prior, normal_scores(weight), centre)
    return chances
