"""One audit for several campaigns of the same samples, which differ by what is varied.

Campaigns that draw their refined runs apart differ by the luck of their draws too. Here each draw is made once for all
of them: with a chance that follows from the rough results of all campaigns alone, it asks for the same sample in each.
A sample's doubt is the largest sqrt(p (1 - p)) over the campaigns, p by the logistic model of
`cooperative.estimate._logistic` before any refined result. The chances are known and the same in every campaign, so
the ordered estimator of each stays unbiased, whatever model it starts from (`_audit`). That model is the same in all,
the mean of p over the campaigns. The difference of two campaigns is then one of the same sampled units, in which what
they have in common cancels (paired units of a panel: Sarndal, Swensson and Wretman 1992, Model Assisted Survey
Sampling, Section 9.9): where no drawn sample changes its class the probabilities are equal, and where samples only turn
from standing to failing it rises. With a model of each campaign's own it would fall by chance.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cooperative.estimate._logistic import fit_logistic, normal_scores, predict_logistic, rough_centre
from cooperative.estimate._protocol import Population, SharedAudit
from cooperative.estimate._ranking import rank_samples


def shared_audit(populations: Sequence[Population]) -> SharedAudit:
    """The audit that campaigns of the same samples have in common.

    Args:
        populations: first phase of each campaign, with equal numbers of samples.

    Raises:
        ValueError: the populations have other samples, or weights.
    """
    size = populations[0].size
    if any(
        each.size != size or each.weight is not None or (each.numbers != np.arange(size)).any() for each in populations
    ):
        sizes = ", ".join(str(each.size) for each in populations)
        raise ValueError(f"populations of {sizes} samples: give populations of the same, equally weighted samples")
    doubt, mean, certain = np.zeros(size), np.zeros(size), np.zeros(size, dtype=bool)
    prior = fit_logistic(np.zeros(0), np.zeros(0), 0.0)
    weight = np.full(size, 1 / size)
    for population in populations:
        ranking = rank_samples(population.rough_displacement, population.broke_off)
        centre = rough_centre(population.rough_displacement[ranking.order], weight, population.failure_displacement)
        model = predict_logistic(prior, normal_scores(weight), centre)
        doubt[ranking.order] = np.maximum(doubt[ranking.order], np.sqrt(model * (1 - model)))
        mean[ranking.order] += model / len(populations)
        certain[ranking.broke_off] = True
    return SharedAudit(tuple(doubt.tolist()), tuple(mean.tolist()), tuple(np.flatnonzero(certain).tolist()))
