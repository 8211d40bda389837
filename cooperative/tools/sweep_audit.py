"""One audit for several campaigns of the same samples, which differ by what is varied.

Campaigns that draw their refined runs apart differ by the luck of their draws too. Here each draw is made once for all
of them: with a chance that follows from the rough results of all campaigns alone, it asks for the same sample in each.
A sample's doubt is the largest sqrt(p (1 - p)) over the campaigns, p by the logistic model of
`cooperative.estimate.prior_chances` before any refined result. The chances are known and the same in every campaign, so
the ordered estimator of each stays unbiased, whatever model it starts from (`_audit`). That model is the same in all,
the mean of p over the campaigns. The difference of two campaigns is then one of the same sampled units, in which what
they have in common cancels (paired units of a panel: Sarndal, Swensson and Wretman 1992, Model Assisted Survey
Sampling, Section 9.9): where no drawn sample changes its class the probabilities are equal, and where samples only turn
from standing to failing it rises. With a model of each campaign's own it would fall by chance.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cooperative.estimate import Population, SharedAudit, prior_chances, rank_samples


def shared_audit(populations: Sequence[Population]) -> SharedAudit:
    """The audit that campaigns of the same samples have in common.

    Args:
        populations: first phase of each campaign, with equal numbers of samples.

    Raises:
        ValueError: the populations have other samples, or weights.
    """
    size = populations[0].size
    if any(
        population.size != size or population.weight is not None or (population.numbers != np.arange(size)).any()
        for population in populations
    ):
        sizes = ", ".join(str(population.size) for population in populations)
        raise ValueError(f"populations of {sizes} samples: give populations of the same, equally weighted samples")
    chances = [prior_chances(population) for population in populations]
    doubt = np.max([np.sqrt(chance * (1 - chance)) for chance in chances], axis=0)
    mean = sum(chance / len(populations) for chance in chances)
    lost = [rank_samples(first.rough_displacement, first.broke_off).broke_off for first in populations]
    certain = np.unique(np.concatenate(lost))
    return SharedAudit(tuple(doubt.tolist()), tuple(np.asarray(mean).tolist()), tuple(certain.tolist()))
