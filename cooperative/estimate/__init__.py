"""Estimators, one class each: which runs they want, probability of failure, weights; shares and fits beside."""

from cooperative.estimate._audit import AuditPlan
from cooperative.estimate._estimates import (
    Estimate,
    after_more_runs,
    control_variate,
    monte_carlo,
    published,
    wilson_interval,
    with_variance,
)
from cooperative.estimate._exceedance import Chances, Curve, chance_of, exceedance, mean_of
from cooperative.estimate._fits import CANDIDATES, ENOUGH, Fit, Fits, Severity, fit_distributions, severity_ranking
from cooperative.estimate._phases import Phases
from cooperative.estimate._protocol import Answers, Estimator, Failures, Population, Sampling, Screened, all_samples
from cooperative.estimate._ranking import Ranking, next_refined, rank_samples, stopping_rank
from cooperative.estimate._shares import Correlation, Share, correlation, effective_size, mean_interval, shares
from cooperative.estimate._slides import NOT_ASKED, Slides, slide_order, zone_weights
from cooperative.estimate._subset import SubsetPlan, SubsetSamples, subset_simulation
from cooperative.estimate._twophase import next_audit, sample_weights, two_phase
from cooperative.estimate.estimators import (
    ESTIMATORS,
    SETTINGS,
    ControlVariate,
    MonteCarlo,
    Published,
    SceneSamples,
    Subset,
    TwoPhase,
    named_estimator,
)

__all__ = [
    "CANDIDATES",
    "ENOUGH",
    "ESTIMATORS",
    "NOT_ASKED",
    "SETTINGS",
    "Answers",
    "AuditPlan",
    "Chances",
    "ControlVariate",
    "Correlation",
    "Curve",
    "Estimate",
    "Estimator",
    "Failures",
    "Fit",
    "Fits",
    "MonteCarlo",
    "Phases",
    "Population",
    "Published",
    "Ranking",
    "Sampling",
    "SceneSamples",
    "Screened",
    "Severity",
    "Share",
    "Slides",
    "Subset",
    "SubsetPlan",
    "SubsetSamples",
    "TwoPhase",
    "after_more_runs",
    "all_samples",
    "chance_of",
    "control_variate",
    "correlation",
    "effective_size",
    "exceedance",
    "fit_distributions",
    "mean_interval",
    "mean_of",
    "monte_carlo",
    "named_estimator",
    "next_audit",
    "next_refined",
    "published",
    "rank_samples",
    "sample_weights",
    "severity_ranking",
    "shares",
    "slide_order",
    "stopping_rank",
    "subset_simulation",
    "two_phase",
    "wilson_interval",
    "with_variance",
    "zone_weights",
]
