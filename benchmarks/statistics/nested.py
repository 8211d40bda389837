"""One, two and three grids: what a campaign with a coarse grid claims, and the hours that it takes.

`python -m benchmarks nested [--quick]` first runs the study's samples on cells twice as large as the rough ones, in 3D
with published and default settings, in a process bound to one core: seconds of a run (`coarse_core_seconds*`) and the
correlation of its ranks, as normal scores, with those of the rough grid (`coarse_correlation*`). Then it repeats
made-up campaigns whose truth is known, with about that correlation (`coverage_*`, `bias_over_error_max`). Given the
rough response, the coarse one has nothing to do with the refined one. Where the coarse ranks mislead (correlations of 0
and -0.9), `coverage_bad_ranking_min` counts.

`expected_hours_to_cov_10_*` are those of two cores, one worker each: what its runs take on each grid, by the core
seconds of `class_runs`, and as many refined ones as half of the campaigns take for a coefficient of variation of 10 per
cent. One grid is Monte Carlo. `expected_hours_rare_*` are of a probability of 0.05 and 15 per cent, with published
settings.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.stats import norm, rankdata

from benchmarks.measure import Report, on_cores, scene_campaign
from benchmarks.results import FOLDER
from benchmarks.statistics.estimators import measured
from benchmarks.study.rows import DATA, read_table
from cooperative.estimate import Population, Sampling, TwoPhase, all_samples, draw_samples, two_phase
from cooperative.runs import build, coefficients_of, random_soil, run_samples

SCENES = {"": ("paper", "screening"), "_default": ("slope", "default")}
"""Ending of a value's name -> scene, and the study's rows of its rough grid."""
STUDIED, CORES = 750, 2
"""Samples of the study's design; cores of a campaign."""


@dataclass(frozen=True)
class Case:
    """Campaigns that end by a target, of a probability of failure `pf`.

    correlation: of rough and refined responses. samples: on each grid before the refined one, coarsest first. coarser:
    correlation of each of these grids with the next.
    """

    name: str
    pf: float
    correlation: float
    target_cov: float
    samples: tuple[int, ...]
    coarser: tuple[float, ...] = ()


GOOD = (
    Case("two grids", 0.28, 0.98, 0.1, (1000,)),
    Case("three grids", 0.28, 0.98, 0.1, (3000, 500), (0.97,)),
    Case("two grids, default", 0.28, 0.95, 0.1, (1000,)),
    Case("three grids, default", 0.28, 0.95, 0.1, (3000, 500), (0.91,)),
    Case("two grids, rare", 0.05, 0.98, 0.15, (1500,)),
    Case("three grids, rare", 0.05, 0.98, 0.15, (4000, 700), (0.97,)),
    Case("four grids", 0.28, 0.98, 0.1, (4000, 1500, 500), (0.95, 0.97)),
)
BAD = tuple(
    Case(f"coarse ranks mislead ({coarse:g})", 0.28, 0.95, 0.1, (2000, 500), (coarse,)) for coarse in (0.0, -0.9)
)


def repeat(case: Case, first: int, count: int) -> np.ndarray:
    """Campaigns number `first` to `first + count`: rows of P_f, limits, upper limit of sampling alone, coefficient of
    variation claimed, and refined runs."""
    rows = []
    for number in range(first, first + count):
        responses = np.random.default_rng([number, 7, *case.samples]).standard_normal(
            (len(case.samples) + 1, case.samples[0])
        )
        chain = [responses[0]]
        for correlation, other in zip((*case.coarser, case.correlation), responses[1:], strict=True):
            chain.append(correlation * chain[-1] + np.sqrt(1 - correlation**2) * other)
        population = screened(case, chain[:-1], number)
        failed = chain[-1][population.numbers] > norm.isf(case.pf)
        plan = TwoPhase(population.size, case.target_cov, seed=number).audit(population)
        answer = two_phase(population, dict(enumerate(failed.tolist())), plan)
        high = (answer.sampling_interval or answer.interval)[1]
        rows.append((answer.probability, *answer.interval, high, answer.cov, answer.refined_runs))
    return np.array(rows)


def screened(case: Case, responses: list[np.ndarray], seed: int) -> Population:
    """The first phase; half as many samples fail on each coarser grid as on the next finer one."""
    sampling = Sampling(case.samples[0], 1.0)
    population: Population | None = None
    for coarser, response in zip(range(len(responses) - 1, -1, -1), responses, strict=True):
        displacement = np.exp(response - norm.isf(case.pf / 2 ** (coarser + 1)))
        population = all_samples(sampling, {n: (float(u), False) for n, u in enumerate(displacement)})
        assert population is not None
        if coarser:
            samples = case.samples[len(responses) - coarser]
            sampling = replace(sampling, rough_samples=samples, zones=draw_samples(population, samples, seed))
    assert population is not None
    return population


def summarise(case: Case, rows: np.ndarray) -> dict[str, Any]:
    """Bias, error and coverage of a case, relative to P_f, and the quartiles of the refined runs."""
    probability, low, high, sampling_high, claimed, runs = rows.T
    return {
        "campaign": case.name,
        "pf": case.pf,
        "correlation": case.correlation,
        "samples": ", ".join(map(str, case.samples)),
        "bias": float(probability.mean() / case.pf - 1),
        "bias_error": float(probability.std() / case.pf / np.sqrt(len(rows))),
        "rmse": float(np.sqrt(np.mean((probability / case.pf - 1) ** 2))),
        "claimed": float(claimed[np.isfinite(claimed)].mean()),
        "coverage": float(np.mean((low <= case.pf) & (case.pf <= high))),
        "coverage_sampling": float(np.mean((low <= case.pf) & (case.pf <= sampling_high))),
        **{f"runs_q{at}": int(np.quantile(runs, at / 100, method="inverted_cdf")) for at in (25, 50, 75)},
    }


def hours(seconds: Mapping[str, float], rows: Mapping[str, Mapping[str, Any]]) -> dict[str, float]:
    """Expected hours by core seconds of a run, and rows by the name of their campaign."""
    values = {}
    for end, of in (("", ""), ("_default", ", default"), ("_rare", ", rare")):
        costs = [seconds[f"{grid}{'' if end == '_rare' else end}"] for grid in GRIDS]
        case = next(case for case in GOOD if case.name == f"two grids{of}")
        alone = (1 - case.pf) / (case.pf * case.target_cov**2)
        name = "expected_hours_rare" if end == "_rare" else f"expected_hours_to_cov_10{end}"
        values[f"{name}_one_grid"] = alone * costs[-1] / (3600 * CORES)
        for grids in ("two", "three"):
            case = next(case for case in GOOD if case.name == f"{grids} grids{of}")
            runs = (*case.samples, rows[case.name]["runs_q50"])
            spent = sum(count * cost for count, cost in zip(runs, costs[-len(runs) :], strict=True))
            values[f"{name}_{grids}_grids"] = spent / (3600 * CORES)
    return values


GRIDS = ("coarse_core_seconds", "rough_core_seconds", "refined_class_core_seconds")


def run(quick: bool) -> Report:
    """Measure the coarse grid, and repeat every case 500 times (20 if quick)."""
    coarse: dict[str, float] = {}
    for end in SCENES:
        answer = on_cores(1, "benchmarks.statistics.nested", end, "12" if quick else "200")
        coarse |= {f"{name}{end}": value for name, value in answer.items()}
    count = 20 if quick else 500
    cases = (*GOOD, *BAD)
    answers = measured([(repeat, case, count) for case in cases], quick)
    rows = {case.name: summarise(case, answer) for case, answer in zip(cases, answers, strict=True)}
    good, bad = ([rows[case.name] for case in some] for some in (GOOD, BAD))
    nested = [row for case, row in zip(GOOD, good, strict=True) if case.coarser]
    seconds = json.loads((FOLDER / "class_runs.json").read_text())["values"] | coarse
    values = {
        **coarse,
        "repetitions": count,
        "coverage_min": min(row["coverage"] for row in nested),
        "coverage_sampling_min": min(row["coverage_sampling"] for row in nested),
        "coverage_sampling_max": max(row["coverage_sampling"] for row in nested),
        "coverage_bad_ranking_min": min(row["coverage"] for row in bad),
        "bias_over_error_max": max(abs(row["bias"]) / row["bias_error"] for row in (*nested, *bad)),
        **hours(seconds, rows),
    }
    return Report(values, list(rows.values()))


def main(end: str, count: str) -> None:
    """Print core seconds of a coarse run, and the correlation of its ranks with the rough ones, as JSON."""
    scene, table = SCENES[end]
    campaign = scene_campaign(scene)
    rough = campaign.rough
    coarse = replace(rough, cell=2 * rough.cell, spacing=tuple(2 * edge for edge in rough.spacing))
    campaign = replace(campaign, coarse=coarse, plan=replace(campaign.plan, samples=STUDIED, rough_samples=STUDIED))
    soil = random_soil(campaign)
    model, coefficients = build(campaign, "coarse", soil), coefficients_of(campaign, soil)
    rows = read_table(DATA / f"study_{table}.csv")
    before = {run.sample: outcome.displacement for run, outcome in rows.items() if run.grid == "rough"}
    numbers = list(before)[: int(count)]
    stop = campaign.run.failure_displacement
    list(run_samples(model, coefficients, numbers[:1], rules=model.campaign.rules(stop)))
    start = time.process_time()
    ended = {
        sample.number: sample.result[0]
        for sample in run_samples(model, coefficients, numbers, rules=model.campaign.rules(stop))
    }
    spent = time.process_time() - start
    scores = [norm.ppf((rankdata([of[n] for n in numbers]) - 0.5) / len(numbers)) for of in (ended, before)]
    answer = {
        "coarse_core_seconds": spent / len(numbers),
        "coarse_correlation": float(np.corrcoef(*scores)[0, 1]),
    }
    print(json.dumps(answer))


if __name__ == "__main__":
    main(*sys.argv[1:])
