"""Estimators, one class each: which runs they want, probability of failure, weights; shares and fits beside."""

from cooperative.estimate._audit import AuditPlan
from cooperative.estimate._audited import Audited, Subset, TwoPhase
from cooperative.estimate._estimates import (
    LEAST_FREEDOM,
    LEVEL,
    Estimate,
    after_more_runs,
    effective_size,
    exact_limit,
    shares,
    wilson_interval,
    with_variance,
)
from cooperative.estimate._fits import (
    ENOUGH,
    FITTED,
    Fit,
    Fits,
    Severity,
    fit_distributions,
    severity_ranking,
)
from cooperative.estimate._formulas import annual, as_answers, control_variate, monte_carlo, published
from cooperative.estimate._in_time import Bracket, critical_factor, first_guess, in_time, record_lows
from cooperative.estimate._logistic import prior_chances
from cooperative.estimate._means import Chances, Exceedance, chance_of, exceedance, mean_interval, mean_of
from cooperative.estimate._named import ESTIMATORS, SETTINGS, named_estimator
from cooperative.estimate._nested import draw_samples
from cooperative.estimate._on_chart import fails_under, falling_chain, on_chart
from cooperative.estimate._phases import NOT_ASKED, Phases, Slides
from cooperative.estimate._plain import ControlVariate, MonteCarlo, Published, SceneSamples
from cooperative.estimate._protocol import (
    Answers,
    Estimator,
    Failures,
    Population,
    Sampling,
    Screened,
    SharedAudit,
    Zone,
    all_samples,
)
from cooperative.estimate._ranking import Correlation, correlation, next_refined, rank_samples, stopping_rank
from cooperative.estimate._subset import SubsetPlan, subset_simulation
from cooperative.estimate._twophase import next_audit, sample_weights, two_phase

__all__ = [
    "ENOUGH",
    "ESTIMATORS",
    "FITTED",
    "LEAST_FREEDOM",
    "LEVEL",
    "NOT_ASKED",
    "SETTINGS",
    "Answers",
    "AuditPlan",
    "Audited",
    "Bracket",
    "Chances",
    "ControlVariate",
    "Correlation",
    "Estimate",
    "Estimator",
    "Exceedance",
    "Failures",
    "Fit",
    "Fits",
    "MonteCarlo",
    "Phases",
    "Population",
    "Published",
    "Sampling",
    "SceneSamples",
    "Screened",
    "Severity",
    "SharedAudit",
    "Slides",
    "Subset",
    "SubsetPlan",
    "TwoPhase",
    "Zone",
    "after_more_runs",
    "all_samples",
    "annual",
    "as_answers",
    "chance_of",
    "control_variate",
    "correlation",
    "critical_factor",
    "draw_samples",
    "effective_size",
    "exact_limit",
    "exceedance",
    "fails_under",
    "falling_chain",
    "first_guess",
    "fit_distributions",
    "in_time",
    "mean_interval",
    "mean_of",
    "monte_carlo",
    "named_estimator",
    "next_audit",
    "next_refined",
    "on_chart",
    "prior_chances",
    "published",
    "rank_samples",
    "record_lows",
    "sample_weights",
    "severity_ranking",
    "shares",
    "stopping_rank",
    "subset_simulation",
    "two_phase",
    "wilson_interval",
    "with_variance",
]
