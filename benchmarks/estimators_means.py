"""Means of consequences over the failures of made-up campaigns: do their intervals hold the truth?

Rough and refined responses X and Y are normal with a correlation of 0.95, as in `benchmarks.estimators`; what a failure
does is exp(2 + 0.6 (Y - threshold) + 0.3 Z), so that the slopes that fail for sure slide farther. 750 samples, an audit
of 60 or 120 runs, and of its failures all slide on to their end or 15. The mean and its interval are those of a
campaign's summary.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import norm

from cooperative import AuditPlan, Population, sample_weights
from cooperative.estimate import drawn_slides, mean_interval, slide_chances, slide_weights

SAMPLES = 750
CORRELATION = 0.95
GROWTH, SCATTER = 0.6, 0.3


@dataclass(frozen=True)
class Means:
    """pf: truth. runs: of the audit. slides: failures that slide on, None for all."""

    pf: float
    runs: int
    slides: int | None


CASES = [Means(pf, runs, slides) for pf in (0.05, 0.244) for runs in (60, 120) for slides in (None, 15)]


def truth(pf: float) -> float:
    """Mean consequence of all failures: that of a lognormal cut off below."""
    at = norm.isf(pf)
    return float(np.exp(2 - GROWTH * at + (GROWTH**2 + SCATTER**2) / 2) * norm.sf(at - GROWTH) / pf)


def repeat(case: Means, first: int, count: int) -> np.ndarray:
    """Campaigns number `first` to `first + count`: rows of mean, limits (nan for none), failures that slid."""
    return np.array([_campaign(case, number) for number in range(first, first + count)])


def _campaign(case: Means, number: int) -> tuple[float, ...]:
    generator = np.random.default_rng([number, int(1e4 * case.pf), case.runs])
    rough, other, scatter = generator.standard_normal((3, SAMPLES))
    beyond = CORRELATION * rough + np.sqrt(1 - CORRELATION**2) * other - norm.isf(case.pf)
    failed, consequence = beyond > 0, np.exp(2 + GROWTH * beyond + SCATTER * scatter)
    plan = AuditPlan(runs=case.runs, seed=number)
    stands_for = sample_weights(
        Population(np.exp(rough - norm.isf(case.pf / 2))), dict(enumerate(failed.tolist())), plan
    )
    ran = np.array(list(stands_for))
    weight, fails = np.array(list(stands_for.values())), failed[ran]
    chance, slid = np.ones(ran.size), fails.copy()
    chance[fails] = slide_chances(weight[fails], case.slides)
    slid[fails] = drawn_slides(ran[fails], chance[fails], number)
    weight = slide_weights(weight, fails, chance, slid)[slid]
    if not weight.size:
        return np.nan, np.nan, np.nan, 0
    found = mean_interval(consequence[ran[slid]], weight) or (np.nan, np.nan)
    return float(weight @ consequence[ran[slid]] / weight.sum()), *found, weight.size


def summarise(case: Means, rows: np.ndarray) -> dict[str, Any]:
    """Bias, error, coverage and width, relative to the true mean. A campaign without an interval covers nothing."""
    mean, low, high, slid = rows.T
    true = truth(case.pf)
    return {
        "pf": case.pf,
        "refined_runs": case.runs,
        "slides": "all" if case.slides is None else case.slides,
        "slid": float(slid.mean()),
        "bias": float(np.nanmean(mean) / true - 1),
        "rmse": float(np.sqrt(np.nanmean((mean / true - 1) ** 2))),
        "coverage": float(np.mean((low <= true) & (true <= high))),
        "width_median": float(np.nanmedian(high - low) / true),
        "without_interval": int(np.isnan(low).sum()),
    }
