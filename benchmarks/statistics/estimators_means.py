"""Means of consequences over the failures of made-up campaigns: do their intervals hold the truth?

Rough and refined responses X and Y are normal with a correlation of 0.95, as in `benchmarks.statistics.estimators`;
what a failure does is exp(2 + 0.6 (Y - threshold) + 0.3 Z), so that the slopes that fail for sure slide farther. 750
samples, an audit of 60 or 120 runs, and slides: those of its failures, or 15 along the ranks, or along the ranks as
many as it has failures. The mean and its interval are those of a campaign's summary. `extra_runs` are the refined runs
that the slides took beyond the audit's.

Beside stands the draw of before, of the same audits: all of its failures or as many of them, drawn and weighed by what
each stands for in the audit (Hansen and Hurwitz 1943, Annals of Mathematical Statistics 14, 333-362).
`mean_rmse_over_former` is the ratio of the errors of as many slides, its range over the cases drawn along the ranks;
`mean_rmse_over_former_of_the_audits` that of the failures of the audit alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import norm

from cooperative import TwoPhase
from cooperative.estimate import Phases, Population, Slides, mean_interval

SAMPLES = 750
CORRELATION = 0.95
GROWTH, SCATTER = 0.6, 0.3
AS_MANY = -1
"""As many slides along the ranks as the audit has failures."""


@dataclass(frozen=True)
class Means:
    """pf: truth. runs: of the audit. slides: along the ranks; None for those of the audit's failures."""

    pf: float
    runs: int
    slides: int | None


CASES = [Means(pf, runs, slides) for pf in (0.05, 0.244) for runs in (60, 120) for slides in (None, 15, AS_MANY)]


def truth(pf: float) -> float:
    """Mean consequence of all failures: that of a lognormal cut off below."""
    at = norm.isf(pf)
    return float(np.exp(2 - GROWTH * at + (GROWTH**2 + SCATTER**2) / 2) * norm.sf(at - GROWTH) / pf)


def repeat(case: Means, first: int, count: int) -> np.ndarray:
    """Campaigns number `first` to `first + count`: rows of mean, limits (nan for none), slides, extra runs, and the
    mean by the draw of before."""
    return np.array([_campaign(case, number) for number in range(first, first + count)])


def audited(estimator: Any, rough: np.ndarray, failed: np.ndarray) -> Phases:
    """A campaign whose audit has ended. rough: displacements (N,) m. failed: on the refined grid (N,)."""
    population = Population(rough)
    weights = estimator.weights(population, dict(enumerate(failed.tolist())))
    return Phases(estimator, 1.0, population=population, answers={n: bool(failed[n]) for n in weights})


def slid(phases: Phases, failed: np.ndarray, count: int | None, seed: int) -> tuple[Phases, list[int], Slides]:
    """The same campaign once its slides are there; its refined runs, and how they slid."""
    ended: set[int] = {n for n, fails in phases.answers.items() if count is None or not fails}
    while True:
        numbers = sorted(phases.answers)
        slides = Slides.of(phases, numbers, np.array([n in ended for n in numbers]), count, seed)
        if not slides.missing:
            return phases, numbers, slides
        ended |= set(slides.missing)
        phases = phases.refined({n: (2.0 * failed[n], False) for n in {*numbers, *slides.missing}})


def _campaign(case: Means, number: int) -> tuple[float, ...]:
    generator = np.random.default_rng([number, int(1e4 * case.pf), case.runs])
    rough, other, scatter = generator.standard_normal((3, SAMPLES))
    beyond = CORRELATION * rough + np.sqrt(1 - CORRELATION**2) * other - norm.isf(case.pf)
    failed, consequence = beyond > 0, np.exp(2 + GROWTH * beyond + SCATTER * scatter)
    audit = audited(TwoPhase(refined_runs=case.runs, seed=number), np.exp(rough - norm.isf(case.pf / 2)), failed)
    count = sum(map(bool, audit.answers.values())) if case.slides == AS_MANY else case.slides
    former = _former_mean(audit, consequence, count, generator)
    _, numbers, slides = slid(audit, failed, count, number)
    if not slides.slid.any():
        return np.nan, np.nan, np.nan, 0, 0, former
    values, weight = consequence[np.array(numbers)[slides.slid]], slides.weight[slides.slid]
    limits = mean_interval(values, weight) or (np.nan, np.nan)
    extra = len(numbers) - len(audit.answers)
    return float(weight @ values / weight.sum()), *limits, weight.size, extra, former


def _former_mean(audit: Phases, consequence: np.ndarray, count: int | None, generator: np.random.Generator) -> float:
    """Of failures of the audit alone, systematically drawn in proportion to their weight in it; nan without any."""
    weight = {n: w for n, w in audit.weights.items() if audit.answers[n] and w}
    if not weight:
        return float("nan")
    numbers, weights = np.array(list(weight)), np.array(list(weight.values()))
    if count is not None and count < numbers.size:
        chance = np.zeros(numbers.size)
        sure = np.zeros(numbers.size, bool)
        while not sure.all() and ((chance := (count - sure.sum()) * weights / weights[~sure].sum())[~sure] >= 1).any():
            sure |= chance >= 1
        chance = np.where(sure, 1.0, chance)
        selected = np.diff(np.floor(np.concatenate([[0.0], np.cumsum(chance)]) + generator.random())) > 0
        selected |= sure
        numbers, weights = numbers[selected], weights[selected] / chance[selected]
    return float(weights @ consequence[numbers] / weights.sum())


def summarise(case: Means, rows: np.ndarray) -> dict[str, Any]:
    """Bias, error, coverage and width, relative to the true mean. Coverage is of the campaigns that give an interval;
    the others, `without_interval`, have effectively too few slides for one."""
    mean, low, high, count, extra, former = rows.T
    true = truth(case.pf)
    named = {None: "of the audit", AS_MANY: "as many as of the audit"}
    return {
        "pf": case.pf,
        "refined_runs": case.runs,
        "slides": named.get(case.slides, case.slides),
        "slid": float(count.mean()),
        "extra_runs": float(extra.mean()),
        "bias": float(np.nanmean(mean) / true - 1),
        "rmse": float(np.sqrt(np.nanmean((mean / true - 1) ** 2))),
        "former_rmse": float(np.sqrt(np.nanmean((former / true - 1) ** 2))),
        "campaigns": len(rows),
        "coverage": float(np.mean((low <= true) & (true <= high)) / np.isfinite(low).mean()),
        "width_median": float(np.nanmedian(high - low) / true),
        "without_interval": int(np.isnan(low).sum()),
    }


def values(rows: list[dict[str, Any]]) -> dict[str, float]:
    """Coverage, and the error over that of the draw of before."""
    ratio = [(row["slides"] == "of the audit", row["rmse"] / row["former_rmse"]) for row in rows]
    along = [error_ratio for of_audit, error_ratio in ratio if not of_audit]
    return {
        "coverage_mean_min": min(row["coverage"] for row in rows),
        "coverage_mean_max": max(row["coverage"] for row in rows),
        "mean_without_interval_max": max(row["without_interval"] / row["campaigns"] for row in rows),
        "mean_rmse_over_former_min": min(along),
        "mean_rmse_over_former_max": max(along),
        "mean_rmse_over_former_of_the_audits_max": max(error_ratio for of_audit, error_ratio in ratio if of_audit),
    }
