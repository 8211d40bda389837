"""The error that residual strengths of two dams share, corrected by the slide of one, and the other by it.

Both dams have their residual strengths by one correlation with blow counts, whose error is one lognormal factor for all
zones (`factor_cov`). Each slide of the first dam is weighed by how likely its run-out and loss of crest make what was
surveyed: normal, with the deviation of the surveyed range, as of all values in it alike, and of MODEL times the value
for what the model and the cells leave open. The weighted mean and deviation of the factor's logarithm then make another
lognormal prior, by whose density over that of the first the slides of the second dam are weighed again.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from statistics import NormalDist
from typing import TYPE_CHECKING

import numpy as np

from benchmarks.sites.real_surveys import MISS, Survey
from cooperative.runs import RandomSoil
from cooperative.scene import Campaign

if TYPE_CHECKING:
    from benchmarks.sites.real_slides import Slid

MODEL = 0.2
"""Deviation of a surveyed quantity by the model and its cells, over its value; decided before the runs."""

FITTED = ("runout", "crest_loss")
"""Quantities by which the slides of the first dam are weighed."""

FACTOR = "shared_factor"


def shared_factor(soil: RandomSoil, campaign: Campaign, coefficients: np.ndarray) -> dict[str, np.ndarray]:
    """The factor of each sample (n,) by its name, nothing where no field has one.

    Args:
        soil: what is random.
        campaign: of the samples.
        coefficients: of the samples (n, modes).
    """
    field = next((random_field for random_field in campaign.random.values() if random_field.factor_cov > 0), None)
    if field is None:
        return {}
    return {FACTOR: np.array([soil.factor(field, sample) for sample in coefficients], float)}


def likelihood(slides: Slid, surveys: Mapping[str, Survey]) -> np.ndarray:
    """How likely each slide (n,) makes what was surveyed, over the likeliest."""
    exponent = np.zeros(slides.weight.size)
    for quantity in FITTED:
        survey = surveys[quantity]
        variance = (survey.high - survey.low) ** 2 / 12 + (MODEL * survey.value) ** 2
        exponent -= (slides.quantities[quantity] - survey.value) ** 2 / (2 * variance)
    return np.exp(exponent - exponent.max())


def calibrated(
    first: Slid, second: Slid, surveys: Mapping[str, Survey], factor_cov: float
) -> tuple[Slid, dict[str, float]]:
    """The slides of the second dam weighed by the factor that the first one's slide leaves, and what that is.

    Args:
        first: slides of the dam that corrects the factor.
        second: of the other.
        surveys: of the first dam, by quantity.
        factor_cov: of the factor before, lognormal of mean 1.
    """
    weight, logarithm = first.weight * likelihood(first, surveys), np.log(first.quantities[FACTOR])
    mean = float(np.average(logarithm, weights=weight))
    deviation = math.sqrt(float(np.average((logarithm - mean) ** 2, weights=weight)))
    variance, score = math.log1p(factor_cov**2), np.log(second.quantities[FACTOR])
    ratio = _exponent(score, mean, deviation) - _exponent(score, -variance / 2, math.sqrt(variance))
    low, median, high = np.exp(mean + deviation * np.array([-1, 0, 1]) * NormalDist().inv_cdf(1 - MISS / 2))
    figures = {
        "factor_low": low,
        "factor_median": median,
        "factor_high": high,
        "lower_dam_effective_slides": weight.sum() ** 2 / (weight**2).sum(),
    }
    reweighted = replace(second, weight=second.weight * np.exp(ratio - ratio.max()))
    return reweighted, {name: round(float(value), 3) for name, value in figures.items()}


def _exponent(values: np.ndarray, mean: float, deviation: float) -> np.ndarray:
    """Logarithm of a normal density, but for a constant."""
    return -(((values - mean) / deviation) ** 2) / 2
