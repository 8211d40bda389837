"""The samples of a campaign as its estimator draws and sees them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

import jax
import numpy as np

from cooperative.estimate import Phases, Sampling, Screened, Zone, all_samples, draw_samples
from cooperative.runs._random_soil import RandomSoil, random_soil
from cooperative.scene import Campaign, FromScript
from cooperative.store import Rows
from jaxmpm.support.text import short

COLUMNS_OF_ZONES = {
    "zone_weight": "weight",
    "coarse_score": "score",
    "coarse_weight": "single",
    "coarse_samples": "samples",
}
"""Column of a rough row -> field of `Zone`."""


def coefficients_of(campaign: Campaign, soil: RandomSoil) -> np.ndarray:
    """Coefficients of the scene's samples (samples, modes), by the design that it asks for; of soil without none.

    Args:
        campaign: the campaign.
        soil: its random soil.
    """
    plan = campaign.plan
    if not soil.modes:
        return np.zeros((plan.samples, 0))
    return np.asarray(plan.coefficients(jax.random.key(plan.seed), plan.samples, soil.modes))


def sampling_of(campaign: Campaign, zones: Mapping[int, Zone] | None = None) -> Sampling:
    """The first phase as the campaign's estimator sees it; random fields are expanded when first asked for.

    Args:
        campaign: the campaign.
        zones: what each rough sample stands for, where the campaign has a coarse phase.
    """
    return Sampling(
        campaign.plan.samples,
        campaign.run.failure_displacement,
        campaign.plan.screening_stop,
        modes=lambda: int(random_soil(campaign).modes),
        draw=lambda: coefficients_of(campaign, random_soil(campaign)),
        rough_samples=campaign.plan.rough_samples,
        zones=zones,
        shared=campaign.measured.shared,
    )


def samples_of(campaign: Campaign) -> int | None:
    """Samples of the first phase, of the coarse one where there is one.

    None where the estimator of a script, which alone knows, is not here.

    Args:
        campaign: the campaign.
    """
    if campaign.coarse is not None:
        return campaign.plan.samples
    if isinstance(campaign.estimator, FromScript):
        return None
    return campaign.estimator.rough_runs(sampling_of(campaign))


def phases_of(campaign: Campaign, rough: Rows, refined: Rows) -> Phases:
    """Both phases by the rows of both grids, for the campaign's estimator.

    Args:
        campaign: the campaign.
        rough: rows of the rough grid.
        refined: rows of the refined grid.
    """
    campaign.require("estimator")
    zones = None if campaign.coarse is None else zones_of(rough)
    return Phases.of(campaign.estimator, sampling_of(campaign, zones), rough.results, refined.results)


def draw_by(campaign: Campaign, coarse: Screened) -> dict[int, Zone]:
    """The samples that run on the rough grid, drawn by the coarse one: number -> what it stands for.

    Args:
        campaign: with a coarse phase.
        coarse: results of all samples there: displacements, or scores.
    """
    plan = campaign.plan
    assert plan.rough_samples is not None
    population = all_samples(Sampling(plan.samples, campaign.run.failure_displacement), coarse)
    assert population is not None
    return draw_samples(population, plan.rough_samples, plan.seed)


def scores_of(
    campaign: Campaign, coefficients: np.ndarray, ranks: Mapping[str, Callable[..., Any]] = MappingProxyType({})
) -> np.ndarray:
    """What the campaign's rank makes of its samples (samples,), nan where it has no answer.

    Args:
        campaign: whose coarse phase is a function.
        coefficients: of all samples (samples, modes).
        ranks: functions that rank, by the names that a campaign may have for them.

    Raises:
        ValueError: it gives no number for each sample.
    """
    campaign.require("coarse")
    rank = ranks[campaign.rank] if isinstance(campaign.rank, str) else campaign.rank
    assert callable(rank)
    scores = np.asarray(rank(campaign, coefficients))
    if scores.shape != coefficients.shape[:1] or scores.dtype.kind not in "buif" or np.isinf(scores).any():
        raise ValueError(
            f"coarse = {short(repr(rank), 200)} gives {scores.dtype} numbers of shape {scores.shape}, "
            f"{int(np.isinf(scores).sum()) if scores.dtype.kind == 'f' else 0} of them infinite: give one finite number"
            f" for each of the {len(coefficients)} samples, the larger the likelier it fails, or nan for no answer"
        )
    return scores.astype(float)


def name_of_rank(campaign: Campaign) -> str | None:
    """Name of the function that ranks samples in place of a coarse grid, None for none.

    Args:
        campaign: the campaign.
    """
    rank = campaign.rank
    if isinstance(rank, str):
        return rank
    if isinstance(rank, FromScript):
        return rank.words.partition("(")[0]
    kind = rank if rank is None or hasattr(rank, "__qualname__") else type(rank)
    return None if kind is None else short(f"{kind.__module__}.{kind.__qualname__}", 200)


def screened_by(scores: np.ndarray) -> Screened:
    """Scores as results of a coarse grid: a sample without one leads the ranks, as a run that broke off does.

    Args:
        scores: of all samples (samples,).
    """
    return {number: (float(score), bool(np.isnan(score))) for number, score in enumerate(scores)}


def zone_row(zone: Zone) -> dict[str, float | int]:
    """What the row of a rough run holds of the zone that its sample stands for.

    Args:
        zone: of the sample.
    """
    return {name: getattr(zone, of) for name, of in COLUMNS_OF_ZONES.items()}


def zones_of(rough: Rows) -> dict[int, Zone]:
    """The zones of rough rows, by number.

    Args:
        rough: rows of a campaign with a coarse phase.
    """
    columns = [rough.columns.get(name, np.zeros(0)) for name in COLUMNS_OF_ZONES]
    return {
        number: Zone(float(weight), float(score), float(single), int(samples))
        for number, weight, score, single, samples in zip(rough.numbers, *columns, strict=True)
    }
