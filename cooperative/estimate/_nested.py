"""A first phase on a chain of grids: which samples of a coarser grid run on the next one, and what these stand for.

The samples of a grid lie in the order of their displacement there. Zones of successive ranks divide them, and one
sample of each zone runs on the next grid. It is drawn in proportion to its weight and stands for its zone, so every
weighted sum over the next grid is unbiased, whatever the ranks are worth: stratified sampling with one draw per stratum
(Cochran 1977, Sampling Techniques, Section 5A.12), repeated from grid to grid (sampling in several phases: Sarndal,
Swensson and Wretman 1992, Model Assisted Survey Sampling, Section 9.8). The better the ranks agree, the less varies
within a zone.

Where the class is in doubt is not known before refined runs. Half of the draws lie evenly along the ranks, which suits
a probability near one half, and half along their logarithm, which suits a rare failure.
"""

from __future__ import annotations

import numpy as np

from cooperative.estimate._logistic import fit_logistic, normal_scores, predict_logistic
from cooperative.estimate._protocol import Population, Zone
from cooperative.estimate._ranking import rank_samples


def draw_samples(population: Population, samples: int, seed: int) -> dict[int, Zone]:
    """The samples of a grid that run on the next one: number -> what it stands for.

    Args:
        population: samples of the grid, those of a chain with their zones.
        samples: to draw, from 1 to as many as there are.
        seed: of the draw.

    Raises:
        ValueError: a number of samples outside that range.
    """
    if not 1 <= samples <= population.size:
        raise ValueError(f"{samples} samples of {population.size} are to be drawn: give 1 to {population.size}")
    order = rank_samples(population.rough_displacement, population.broke_off).order
    weight, numbers = population.weights[order], population.numbers[order]
    score, zone = normal_scores(weight), _zones(weight, samples)
    # The first of exponential arrival times with the weights as rates is a draw in proportion to them.
    arrival = np.random.default_rng([seed, population.independent, samples]).exponential(size=zone.size) / weight
    by_zone = np.lexsort((arrival, zone))
    chosen = by_zone[np.flatnonzero(np.diff(zone[by_zone], prepend=-1))]
    stands_for, before = np.bincount(zone, weight)[zone[chosen]], population.zones
    return {
        int(numbers[rank]): Zone(
            float(whole), float(score[rank]), float(weight[rank]), population.independent,
            None if before is None else before[order[rank]],
        )
        for rank, whole in zip(chosen, stands_for, strict=True)
    }  # fmt: skip


def first_variance(population: Population, proportion: float, chance: np.ndarray) -> float:
    """Variance of the first phase: of independent samples, and of the draws from their zones.

    Args:
        population: samples, and what they stand for.
        proportion: that fails.
        chance: of failure of each, 0 or 1 where its class is known (N,).
    """
    return proportion * (1 - proportion) / population.independent + zone_variance(population, chance)


def zone_variance(population: Population, chance: np.ndarray) -> float:
    """Variance that the draws from zones bring to the weighted number of failures; 0 where there were none.

    A draw from a zone of weight W brings W^2 times the variance within the zone: that of the chance to fail about its
    course along the coarser ranks, by a logistic model, and that of the class about its chance.

    Args:
        population: samples, and what they stand for.
        chance: of failure of each, 0 or 1 where its class is known (N,).
    """
    variance, zones = 0.0, list(population.zones or ())
    while zones:
        zone, score, single = np.array([(member.weight, member.score, member.single) for member in zones]).T
        expected = predict_logistic(fit_logistic(score, chance, 0.0), score, 0.0)
        within = (chance - expected) ** 2 + chance * (1 - chance)
        variance += float((population.weights * (zone - single)) @ within)
        zones = [member.earlier for member in zones if member.earlier is not None]
    return variance


def _zones(weight: np.ndarray, samples: int) -> np.ndarray:
    """Number of the zone of each rank, ascending, of exactly so many (N,)."""
    beyond = np.cumsum(weight) - weight / 2
    density = weight * (1 + 1 / (np.log(samples + 1) * (beyond + 1 / samples)))
    chance, alone = np.ones(weight.size), np.zeros(weight.size, dtype=bool)
    # No rank takes more than a zone of its own.
    while not alone.all():
        others = density[~alone]
        chance[~alone] = (samples - alone.sum()) * others / others.sum()
        if chance[~alone].max() <= 1:
            break
        alone |= chance >= 1
        chance[alone] = 1.0
    # As no share is above 1, each zone ends within one of them.
    return np.minimum(np.ceil(np.cumsum(chance) - 1e-9).astype(int) - 1, samples - 1)
