"""Samples in the order of their factor of safety by slices, for the coarse phase of a campaign."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np

from cooperative.runs import build, random_soil
from cooperative.scene import Campaign
from cooperative.tools.safety._factor import slices_of_sample
from cooperative.tools.safety._search import factors_of_circles, first_circles

KEPT = 400
"""Circles of the least factors of median soil, over which that of each sample is the least."""


def rank_by_slices(campaign: Campaign, coefficients: np.ndarray) -> np.ndarray:
    """Score samples of a section by their factor of safety by slices, as `coarse` of a campaign.

    The factor of a sample is the least one by Bishop's method of a set of circles, the same for all samples: KEPT
    circles with the least factors of the median soil. That takes some hundredths of a second. Without the search for
    the critical circle it is 2 to 7 per cent above the factor of `jaxmpm fos`, which changes no rank much.

    Args:
        campaign: on a section, whose rough grid has the fields.
        coefficients: of its samples (samples, modes).

    Returns:
        Minus the factor of each sample (samples,); nan where no circle has one.

    Raises:
        ValueError: ground that is no section, or soil without a strength.
    """
    model = build(campaign, "rough", random_soil(campaign), at_rest=False)
    median = slices_of_sample(model, None)
    circles = first_circles(median)
    factors = factors_of_circles(median, circles)
    circles = circles[np.argsort(factors)[:KEPT]]
    least = [factors_of_circles(slices_of_sample(model, sample), circles).min() for sample in coefficients]
    return -np.where(np.isfinite(least), least, np.nan)


RANKS: Mapping[str, Callable[[Campaign, np.ndarray], np.ndarray]] = MappingProxyType({"slices": rank_by_slices})
"""Functions that rank samples, by the names that `coarse` of a scene has for them, for `cooperative.run`."""
