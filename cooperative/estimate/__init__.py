"""Estimates from rows: which refined runs are wanted, probability of failure, weights, shares, fits."""

from cooperative.estimate._audit import AuditPlan
from cooperative.estimate._designs import DESIGNS, Answers, Design, budget, replay_subset, rough_runs, subset_plan
from cooperative.estimate._estimates import (
    Estimate,
    after_more_runs,
    control_variate,
    monte_carlo,
    published,
    wilson_interval,
    with_variance,
)
from cooperative.estimate._fits import CANDIDATES, ENOUGH, Fit, Fits, Severity, fit_distributions, severity_ranking
from cooperative.estimate._ranking import Ranking, next_refined, rank_samples, stopping_rank
from cooperative.estimate._shares import Correlation, Share, correlation, shares
from cooperative.estimate._subset import SubsetPlan, SubsetSamples, subset_simulation
from cooperative.estimate._twophase import Population, next_audit, sample_weights, two_phase

__all__ = [
    "CANDIDATES",
    "DESIGNS",
    "ENOUGH",
    "Answers",
    "AuditPlan",
    "Correlation",
    "Design",
    "Estimate",
    "Fit",
    "Fits",
    "Population",
    "Ranking",
    "Severity",
    "Share",
    "SubsetPlan",
    "SubsetSamples",
    "after_more_runs",
    "budget",
    "control_variate",
    "correlation",
    "fit_distributions",
    "monte_carlo",
    "next_audit",
    "next_refined",
    "published",
    "rank_samples",
    "replay_subset",
    "rough_runs",
    "sample_weights",
    "severity_ranking",
    "shares",
    "stopping_rank",
    "subset_plan",
    "subset_simulation",
    "two_phase",
    "wilson_interval",
    "with_variance",
]
