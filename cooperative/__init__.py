"""Campaigns: screen samples on a rough grid, refine the ranked ones, estimate how likely the slope runs out.

from cooperative import open_store, rank_samples, next_refined, published, consequences
"""

from cooperative.audit import AuditPlan
from cooperative.consequences import Consequences, SlopeGeometry, consequences
from cooperative.distributions import Fit, Fits, Severity, fit_distributions, severity_ranking
from cooperative.estimators import (
    Estimate,
    after_more_runs,
    control_variate,
    monte_carlo,
    published,
    wilson_interval,
)
from cooperative.modes import FailureMode, ModeRules, failure_mode
from cooperative.onsets import Motion
from cooperative.ranking import Ranking, next_refined, rank_samples, stopping_rank
from cooperative.shares import Correlation, Share, correlation, shares
from cooperative.store import (
    DamagedFile,
    Rows,
    Sample,
    Store,
    open_store,
    read_rows,
    read_sample,
    read_store,
    sample_path,
    scene_digest,
    write_aside,
    write_sample,
)
from cooperative.subset import SubsetPlan, SubsetSamples, subset_simulation
from cooperative.tables import consolidate, write_table
from cooperative.twophase import Population, next_audit, sample_weights, two_phase

__all__ = [
    "AuditPlan",
    "Consequences",
    "Correlation",
    "DamagedFile",
    "Estimate",
    "FailureMode",
    "Fit",
    "Fits",
    "ModeRules",
    "Motion",
    "Population",
    "Ranking",
    "Rows",
    "Sample",
    "Severity",
    "Share",
    "SlopeGeometry",
    "Store",
    "SubsetPlan",
    "SubsetSamples",
    "after_more_runs",
    "consequences",
    "consolidate",
    "control_variate",
    "correlation",
    "failure_mode",
    "fit_distributions",
    "monte_carlo",
    "next_audit",
    "next_refined",
    "open_store",
    "published",
    "rank_samples",
    "read_rows",
    "read_sample",
    "read_store",
    "sample_path",
    "sample_weights",
    "scene_digest",
    "severity_ranking",
    "shares",
    "stopping_rank",
    "subset_simulation",
    "two_phase",
    "wilson_interval",
    "write_aside",
    "write_sample",
    "write_table",
]
