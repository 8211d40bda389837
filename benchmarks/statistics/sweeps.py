"""Sweeps of made-up campaigns whose truth is known: do they call the right sign of a change.

A water level rises in four steps, and with it the probability of failure. Each sample has one rough and one refined
response, which hang together by a correlation; the water raises both by the same amount, but for a scatter of their
own, so that a sample may also fail at a lower level and stand at a higher one. `python -m benchmarks sweeps [--quick]`
repeats sweeps of them, once with the audit that the campaigns of a sweep share and once with an audit of its own in
each campaign.

`sweep_wrong_sign_share` is the share of differences that a sweep calls resolved (their interval does not hold 0) and
that have the wrong sign, the largest over the cases; `sweep_coverage_min` the least share of differences whose interval
holds the true one. `sweep_falls_share` is the share of sweeps whose P_f falls with a rise of the water, resolved or
not; `falls_of_all` of a row is that share when every sample runs refined. Values that end in `_apart` are those of
audits apart.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.stats import norm

from benchmarks.measure import Report
from benchmarks.statistics.estimators import measured
from cooperative.estimate import Estimate, Phases, Population, TwoPhase
from cooperative.tools.sweep_audit import shared_audit
from cooperative.tools.sweep_differences import by_sample, paired_difference, unit_of

LEVELS = (0.0, 0.1, 0.2, 0.4, 0.8)
"""What the water adds to the response; the first is the base."""
SCATTER = 0.1
"""Standard deviation of what the water adds to one sample."""


@dataclass(frozen=True)
class Case:
    """Sweeps of `samples` samples and `runs` refined runs, whose base fails with a probability of `pf`.

    correlation: of rough and refined responses.
    """

    pf: float
    correlation: float
    samples: int
    runs: int


CASES = (
    Case(0.08, 0.97, 60, 20),
    Case(0.08, 0.85, 60, 20),
    Case(0.3, 0.97, 200, 40),
    Case(0.3, 0.85, 200, 40),
    Case(0.01, 0.95, 200, 40),
)


def made_levels(case: Case, generator: np.random.Generator) -> tuple[list[np.ndarray], list[np.ndarray], list[float]]:
    """Rough displacements and refined failures (N,) of each level, and the true probability of failure there."""
    rough, other = generator.standard_normal((2, case.samples))
    refined = case.correlation * rough + np.sqrt(1 - case.correlation**2) * other
    limit = norm.isf(case.pf)
    displacements, failed, truth = [], [], []
    for level in LEVELS:
        added = level + (SCATTER * generator.standard_normal((2, case.samples)) if level else np.zeros((2, 1)))
        displacements.append(np.exp(rough + added[0] - norm.isf(case.pf / 2)))
        failed.append(refined + added[1] > limit)
        truth.append(float(norm.sf((limit - level) / np.hypot(1.0, SCATTER if level else 0.0))))
    return displacements, failed, truth


def answers(
    case: Case, displacements: list[np.ndarray], failed: list[np.ndarray], seed: int, *, share: bool
) -> list[tuple[Estimate, np.ndarray, float]]:
    """Estimate, failures counted at each sample (N,), and samples of a refined run, of each level."""
    populations, shared = [Population(values) for values in displacements], None
    if share:
        shared = shared_audit(populations)
        populations = [replace(screened, shared=shared) for screened in populations]
    estimator, answer = TwoPhase(refined_runs=case.runs, seed=seed), []
    for population, fails in zip(populations, failed, strict=True):
        answered: dict[int, bool | None] = {}
        while next_samples := estimator.next_runs(population, answered, case.runs, ()):
            answered |= {sample: bool(fails[sample]) for sample in next_samples}
        phases = Phases(estimator, 1.0, population=population, answers=answered)
        assert phases.failures is not None
        counted = by_sample(phases.failures, phases.estimate.probability, case.samples)
        unit = unit_of(phases.weights, case.samples, None if shared is None else shared.doubt)
        answer.append((phases.estimate, counted, unit))
    return answer


def repeat(case: Case, first: int, count: int) -> np.ndarray:
    """Sweeps number `first` to `first + count`, (count, 2, levels - 1, 6).

    By whether the audit is shared and level: difference, its limits, true difference, P_f less that of the level below,
    and the same of all samples refined.
    """
    rows: list[list[list[list[float]]]] = []
    for number in range(first, first + count):
        generator = np.random.default_rng([number, 11, case.samples, int(100 * case.correlation)])
        displacements, failed, truth = made_levels(case, generator)
        shares = [float(fails.mean()) for fails in failed]
        rows.append([])
        for share in (True, False):
            of_levels = answers(case, displacements, failed, number, share=share)
            spread = [((e.cov if np.isfinite(e.cov) else 0.0) * e.probability) ** 2 for e, _, _ in of_levels]
            unit = max(unit for _, _, unit in of_levels)
            compared = []
            for at in range(1, len(LEVELS)):
                change = paired_difference(of_levels[0][1], of_levels[at][1], (spread[0], spread[at]), unit=unit)
                step = of_levels[at][0].probability - of_levels[at - 1][0].probability
                whole = shares[at] - shares[at - 1]
                compared.append([change.difference, *change.interval, truth[at] - truth[0], step, whole])
            rows[-1].append(compared)
    return np.array(rows)


def summarise(case: Case, rows: np.ndarray) -> dict[str, Any]:
    """Wrong signs, resolved ones, coverage and error of a case, with the shared audit and with audits apart."""
    answer: dict[str, Any] = {
        "pf": case.pf,
        "correlation": case.correlation,
        "samples": case.samples,
        "refined_runs": case.runs,
    }
    for name, of in (("", rows[:, 0]), ("_apart", rows[:, 1])):
        difference, low, high, truth, step, whole = np.moveaxis(of, -1, 0)
        resolved = (low > 0) | (high < 0)
        answer |= {
            f"wrong_sign{name}": float((high < 0).sum() / max(resolved.sum(), 1)),
            f"resolved{name}": float(resolved.mean()),
            f"coverage{name}": float(np.min(np.mean((low <= truth) & (truth <= high), axis=0))),
            f"error{name}": float(np.sqrt(np.mean((difference - truth) ** 2))),
            f"falls{name}": float(np.mean((step < 0).any(axis=1))),
        }
        answer["falls_of_all"] = float(np.mean((whole < 0).any(axis=1)))
    return answer


def run(quick: bool) -> Report:
    """Repeat every case 200 times (20 if quick)."""
    count = 20 if quick else 200
    rows = [
        summarise(case, answer)
        for case, answer in zip(CASES, measured([(repeat, case, count) for case in CASES], quick), strict=True)
    ]
    values: dict[str, Any] = {"repetitions": count}
    for end in ("", "_apart"):
        values |= {
            f"sweep_wrong_sign_share{end}": max(row[f"wrong_sign{end}"] for row in rows),
            f"sweep_coverage_min{end}": min(row[f"coverage{end}"] for row in rows),
            f"sweep_falls_share{end}": max(row[f"falls{end}"] for row in rows),
            f"sweep_resolved_share{end}": float(np.mean([row[f"resolved{end}"] for row in rows])),
        }
    return Report(values, rows)
