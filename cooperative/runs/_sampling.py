"""The samples of a campaign as its estimator draws and sees them."""

from __future__ import annotations

import jax
import numpy as np

from cooperative.estimate import Phases, Sampling
from cooperative.runs._random_soil import RandomSoil, random_soil
from cooperative.scene import Campaign, Given
from cooperative.store import Rows


def coefficients_of(campaign: Campaign, soil: RandomSoil) -> np.ndarray:
    """Coefficients of the scene's samples (samples, modes), by the design that it asks for.

    Args:
        campaign: the campaign.
        soil: its random soil.
    """
    plan = campaign.plan
    return np.asarray(plan.coefficients(jax.random.key(plan.seed), plan.samples, soil.modes))


def sampling_of(campaign: Campaign) -> Sampling:
    """The first phase as the campaign's estimator sees it; random fields are expanded when first asked for.

    Args:
        campaign: the campaign.
    """
    return Sampling(
        campaign.plan.samples,
        campaign.run.failure_displacement,
        campaign.plan.screening_stop,
        modes=lambda: int(random_soil(campaign).modes),
        draw=lambda: coefficients_of(campaign, random_soil(campaign)),
    )


def samples_of(campaign: Campaign) -> int | None:
    """Samples of the first phase; None where the estimator of a script, which alone knows, is not here.

    Args:
        campaign: the campaign.
    """
    if isinstance(campaign.estimator, Given):
        return None
    return campaign.estimator.rough_runs(sampling_of(campaign))


def phases_of(campaign: Campaign, rough: Rows, refined: Rows) -> Phases:
    """Both phases by the rows of both grids, for the campaign's estimator.

    Args:
        campaign: the campaign.
        rough: rows of the rough grid.
        refined: rows of the refined grid.
    """
    return Phases.known(campaign.estimator, sampling_of(campaign), rough.results, refined.results)
