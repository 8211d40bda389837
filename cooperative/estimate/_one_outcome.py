"""Limits of P_f where all refined runs ended alike: none failed, or by the same argument all did.

Say that none failed. Whatever the ranks are worth, let K of the N samples fail; K is binomial, and the failures may
lie anywhere in the ranking. A draw of the audit is spread in a part f evenly over the U samples that are unknown when
its wave begins, d of which the wave has drawn before it. Given that no draw before has met a failure, it meets one with
a probability of at least

    a K,   a = f / (U - f d),

since what the wave has drawn had at least f d / U of its chances. While all runs end alike, f depends on the number of
draws alone (`cooperative.estimate._audit.even_share`), so that

    P(no failure met) <= sum over K of Bin(K; N, P_f) product over draws of (1 - a K) = T(P_f),

without regard to where the failures are, how they depend on the ranks, or which ranks were drawn. The limit is the P_f
at which T is 1 - level: the test of P_f is turned round (Neyman 1937, Philosophical Transactions A 236, 333-380), as
for the binomial limit of Clopper and Pearson (1934), Biometrika 26, 404-413. For draws that are all even T is
(1 - P_f)^n, the rule of three (Hanley and Lippman-Hand 1983, JAMA 249, 1743-1745). Every draw multiplies T by a factor
below 1, so the limit falls with every wave, and it holds at every look.

No limit that holds for every ranking can lie below the binomial one of the n refined runs: where ranks show nothing,
n draws meet no failure with a probability of (1 - P_f)^n, however they are chosen. That of all N samples presumes that
the rest stand as ranked. It is given beside (`Estimate.sampling_interval`), and nothing rests on it.

A run that gave no answer may have been a failure: with j of these the sum is over P(at most j failures met), by the
same chances.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy

from cooperative.estimate._audit import Wave
from cooperative.estimate._chains import Chains
from cooperative.estimate._estimates import LEAST_FREEDOM, exact_limit, lognormal_limits
from cooperative.estimate._protocol import Population, Zone

NEVER = 1e-12
"""Probability below which a number of failures is as good as certain to be met."""


def even_chance(waves: Sequence[Wave]) -> np.ndarray:
    """Least probability with which each draw meets one given unknown sample, given those before (draws,)."""
    chance: list[np.ndarray] = [np.zeros(0)]
    for wave in waves:
        unknown = int((wave.chance > 0).sum())
        chance.append(wave.even / (unknown - wave.even * np.arange(wave.ranks.size)))
    return np.concatenate(chance)


def missed(chance: np.ndarray, failures: np.ndarray, unanswered: int) -> np.ndarray:
    """Probability that draws meet at most so many of each number of failures (k,).

    Args:
        chance: of a draw to meet one given failure (draws,).
        failures: numbers of them, 0 or more (k,).
        unanswered: failures that may be met without being seen.
    """
    met = np.zeros((unanswered + 1, failures.size))
    met[0] = 1.0
    remaining = np.maximum(failures - np.arange(unanswered + 1)[:, None], 0)
    for value in chance:
        hit = met * np.minimum(value * remaining, 1.0)
        met -= hit
        met[1:] += hit[:-1]
    return met.sum(axis=0)


def even_limit(
    chance: np.ndarray, samples: int, *, unknown: int, certain: int = 0, unanswered: int = 0, level: float
) -> float:
    """Upper limit of P_f where no draw has met a failure, for samples of equal weight.

    Args:
        chance: as `even_chance` gives it (draws,).
        samples: N.
        unknown: samples that have not run refined.
        certain: runs without an answer that were not drawn.
        unanswered: draws without an answer.
        level: confidence level of the limit.
    """
    if not chance.sum():
        return 1.0
    from scipy.optimize import brentq  # these take half a second, which few commands need
    from scipy.stats import binom

    # Of more failures one is met for certain.
    most = int(np.ceil((-np.log(NEVER) + 10 * unanswered) / chance.sum())) + certain
    most = min(samples, unknown + certain + unanswered, most)
    count = np.arange(most + 1)
    none = missed(chance, np.maximum(count - certain, 0), unanswered)

    def excess(proportion: float) -> float:
        return float(binom.pmf(count, samples, proportion) @ none) - (1 - level)

    return float(brentq(excess, 0.0, 1.0, xtol=1e-15, rtol=1e-10)) if excess(1.0) < 0 else 1.0


def zone_limit(chance: np.ndarray, zones: Sequence[Zone], *, unanswered: int = 0, level: float) -> float:
    """The same limit where each sample stands for a zone of ranks on a coarser grid.

    Of the failures that a zone holds, its sample is one with a probability of at least their weight over the largest
    weight W of a zone, independently of other zones. With A the sum of the chances of the draws, and
    E exp(-g X) <= exp(-E X (1 - exp(-g w)) / w) for a sum X of independent values between 0 and w, one grid after
    another gives P(no failure met) <= (1 - P_f (1 - exp(-g / N)))^N.

    Args:
        chance: as `even_chance` gives it (draws,).
        zones: what each sample stands for (n,).
        unanswered: draws without an answer.
        level: confidence level of the limit.
    """
    rate, samples, level_of = float(chance.sum()), zones[0].samples, list(zones)
    if not rate:
        return 1.0
    weight = max(zone.weight for zone in level_of)
    rate /= weight
    while level_of:
        weight = max(zone.weight for zone in level_of)
        rate = -float(np.expm1(-rate * weight)) / weight
        level_of = [zone.earlier for zone in level_of if zone.earlier is not None]
    misses = -np.expm1(-float(scipy.special.gammaincinv(unanswered + 1, level)) / samples)
    return min(misses / -float(np.expm1(-rate / samples)), 1.0)


def ranked_limit(
    waves: Sequence[Wave],
    finished: np.ndarray,
    weight: np.ndarray,
    replicate: np.ndarray | None,
    *,
    chains: Chains | None = None,
    level: float,
) -> float:
    """Upper limit of P_f where no draw has met a failure, for an audit that trusts the ranks (exploration = 0).

    It presumes that failures rank above all that stands but what was drawn: it is the weight of the first ranks of
    which the draws would have met one with a probability of `level`. The weight of ranks is itself an estimate where
    chains of subset simulation gave it: its limit is that of a lognormal mean with the scatter of the replicates, or of
    their chains where that is larger.

    Args:
        waves: complete ones.
        finished: ranks that ran (N,) bool.
        weight: by rank (N,).
        replicate: by rank (N,), None for independent samples.
        chains: by rank, None where they are not known.
        level: confidence level of the limit.
    """
    # It holds at every look (Ville 1939), so what an earlier wave left open no later one opens again.
    earlier = 1.0
    if len(waves) > 1:
        before = finished.copy()
        before[waves[-1].ranks] = False
        earlier = ranked_limit(waves[:-1], before, weight, replicate, chains=chains, level=level)
    log_missed, open_ = np.zeros(weight.size), ~finished
    for wave in waves:
        reached = np.cumsum(np.where(open_, wave.chance, 0.0))
        for ratio in wave.chance[wave.ranks] / wave.probability:
            log_missed += np.log1p(-np.minimum(reached / ratio, 1 - NEVER))
    first = min(int((log_missed > np.log(1 - level)).sum()), weight.size - 1)
    ranks = np.arange(first + 1)
    proportion = float(weight[ranks].sum())
    if replicate is None:
        return min(proportion + exact_limit(weight.size, level), earlier)
    weights = np.bincount(np.unique(replicate, return_inverse=True)[1][ranks], weight[ranks], np.unique(replicate).size)
    square, freedom = float(weights.var(ddof=1)) * weights.size / proportion**2, weights.size - 1.0
    if chains is not None:
        square = max(square, chains.relative_variance((np.arange(weight.size) <= first).astype(float)))
        freedom = max(freedom, LEAST_FREEDOM)
    return min(lognormal_limits(proportion, float(np.sqrt(square)), freedom, 2 * level - 1)[1], 1.0, earlier)


def limit_of_one_outcome(
    population: Population,
    waves: Sequence[Wave],
    *,
    finished: np.ndarray,
    weight: np.ndarray,
    replicate: np.ndarray | None,
    chains: Chains | None = None,
    unanswered: tuple[int, int],
    exploration: int,
    level: float,
) -> float:
    """Upper limit of the probability of what no refined run showed.

    Args:
        population: samples of the first phase.
        waves: complete ones.
        finished: ranks that ran (N,) bool.
        weight: by rank (N,).
        replicate: by rank (N,), None for independent samples.
        chains: by rank, None where they are not known.
        unanswered: runs without an answer: draws, and others.
        exploration: 0 trusts the ranks.
        level: confidence level of the limit.
    """
    uncertain, certain = unanswered
    if finished.all() and not uncertain + certain and population.zones is None and replicate is None:
        return exact_limit(population.size, level)
    if not exploration:
        return ranked_limit(waves, finished, weight, replicate, chains=chains, level=level)
    chance = even_chance(waves)
    if population.zones is not None:
        return zone_limit(chance, population.zones, unanswered=uncertain + certain, level=level)
    unknown = int((~finished).sum())
    return even_limit(chance, population.size, unknown=unknown, certain=certain, unanswered=uncertain, level=level)
