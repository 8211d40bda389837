"""What `cooperative` offers, and where each name stands; read by type checkers, and at run time by `__init__.py`."""

from .campaign import run
from .estimate import (
    ControlVariate,
    Estimator,
    MonteCarlo,
    Published,
    Subset,
    TwoPhase,
    monte_carlo,
    rank_samples,
)
from .exports import export
from .hazard import hazard_maps
from .measure import consequences, failure_mode
from .one_run import slide
from .reporting import progress_of, report
from .runs import build, coefficients_of, dask_executor, phases_of, random_soil
from .scene import (
    Campaign,
    CampaignGrid,
    CrossCorrelation,
    Hazard,
    Plan,
    RandomField,
    Run,
    Site,
    SiteLayer,
    read,
)
from .store import (
    read_rows,
    read_sample,
    read_store,
)
from .summary import Summary

__all__ = [
    "Campaign",
    "CampaignGrid",
    "ControlVariate",
    "CrossCorrelation",
    "Estimator",
    "Hazard",
    "MonteCarlo",
    "Plan",
    "Published",
    "RandomField",
    "Run",
    "Site",
    "SiteLayer",
    "Subset",
    "Summary",
    "TwoPhase",
    "build",
    "coefficients_of",
    "consequences",
    "dask_executor",
    "export",
    "failure_mode",
    "hazard_maps",
    "monte_carlo",
    "phases_of",
    "progress_of",
    "random_soil",
    "rank_samples",
    "read",
    "read_rows",
    "read_sample",
    "read_store",
    "report",
    "run",
    "slide",
]
