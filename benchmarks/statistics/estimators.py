"""Estimators of the failure probability on synthetic pairs of grids whose truth is known.

A sample has a rough response X and a refined one r X + sqrt(1 - r^2) Z, X and Z standard normal and independent;
it fails where the refined response exceeds the quantile of P_f. Repeating the whole campaign, sampling included,
gives bias, root mean square error and coverage of the 95 % interval. Costs are in refined-run equivalents: a
rough run counts 1/30.

The bias is measured against the failures of the very samples drawn, whose mean is P_f exactly: that takes the
sampling noise of phase one out of it (not for Monte Carlo and subset simulation, measured against P_f itself).
`bias_error` is the standard error of what is left.

Four links more, of P_f 0.05 and 0.244 with 60 and 120 refined runs of 750 samples, put the interval to the test where
the ranking is bad: a t-copula of 3 degrees of freedom, responses that have nothing to do with each other, responses
that go against each other, and failures at both ends of the ranking, where r X + sqrt(1 - r^2) Z is far from 0 on
either side. The normal link stands beside them. `coverage` and `width` are those of the whole interval, with its
allowance for what no run has looked at; `coverage_sampling` and `width_sampling` those without, which should hold
95 % where the ranking is good (`two_phase_coverage_*`). With the allowance they hold more there, and at least 90 %
wherever the failures hide (`coverage_bad_ranking_min`).

A campaign may also end by itself, once the coefficient of variation that it claims is at most `target_cov`: then its
cost is as random as its answer. Two cases have 1000 samples, P_f 0.28 and a target of 0.1, as `benchmarks campaign`
asks, with the audit of a campaign. Of each correlation, as `r095` and `r098`, the figures are the true error of P_f
(`target_cov_rmse_*`) beside the mean of what is claimed at the end (`target_cov_claimed_*`), the coverage of the whole
interval and of sampling alone (`target_cov_coverage_*`, `target_cov_coverage_sampling_*`), and the quartiles of the
refined runs (`target_cov_runs_q25_*`, `_q50_*`, `_q75_*`). With 750 samples, P_f 0.1 and 0.244 and targets of 0.1, 0.15
and 0.25 the normal link stands beside a Clayton and a Gumbel copula of rank correlation 0.85, a t-copula of 2 degrees,
3 % of the samples failing whatever their response in the fifth that ranks lowest, and failures at both ends:
`target_cov_rmse_over_claimed_max` and `target_cov_bias_max` are over all but the last. The control variate and Monte
Carlo go to the same targets with the normal link (`target_cov_rmse_over_claimed_in_order_max`,
`target_cov_bias_in_order_max`).

Slopes that all stand, nearly all, or all fail, have P_f 0, 1e-6, 1e-4 and 1, with 60, 200 and 750 samples of which a
campaign's usual number runs refined, and with good ranks and ranks that go against the truth:
`coverage_without_failures_min` is the least coverage of the interval. Where no refined run fails, or all do, what the
interval leaves open stands over the one-sided binomial limit of as many refined runs,
`upper_without_failures_over_binomial_max`. No interval that holds whatever the ranks are worth can be narrower than
that (`cooperative.estimate._one_outcome`); the limit of all N samples is a fifth of it.

Subset simulation goes down 2 to 7 levels to a P_f of as many powers of ten, with 10 and 50 chains in each of 8
replicates: `coverage_subset_min` and `coverage_subset_max` are over all twelve.

Means of consequences over the failures, from the audit or from a part of its failures that slid on, have intervals of
their own (`coverage_mean_min`, `coverage_mean_max`; `benchmarks.statistics.estimators_means`).

Another table takes campaigns from a real population, the plane-strain section with all its samples run on both grids
(`benchmarks.statistics.estimators_section`): there error stands against run time, in the figure too.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from concurrent.futures import Future
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.measure import ROOT, Report, stored_row
from benchmarks.statistics import estimators_means as means
from benchmarks.statistics import estimators_section as section
from benchmarks.statistics.estimators_campaigns import Case, repeat
from cooperative.estimate import TwoPhase, exact_limit
from cooperative.runs import cores_to_use, process_pool

ROUGH_COST = 1 / 30
Repeat = Callable[[Any, int, int], np.ndarray]
CORRELATIONS = (0.8, 0.9, 0.95, 0.98)
BAD_RANKING = (("t-copula", 0.9), ("normal", 0.0), ("normal", -0.9), ("both ends", 0.95))
TARGET_LINKS = (
    *(("normal", 0.95), ("normal", 0.98), ("Clayton", 0.85), ("Gumbel", 0.85), ("both ends", 0.95)),
    *(("t-copula of 2 degrees", 0.9), ("safest fifth", 0.95)),
)
"""Link and correlation of campaigns that end by a target."""
IN_ORDER = ("control variate", "Monte Carlo")


def summarise(case: Case, rows: np.ndarray) -> dict[str, Any]:
    """Bias, error, coverage and cost of one case, relative to P_f; with a target, what was claimed at the end and the
    quartiles of the refined runs."""
    probability, low, high, sampling_high, claimed, refined_runs, rough_runs, share = rows.T
    off = (probability - share) / case.pf
    row: dict[str, Any] = {
        "method": case.method + (f", {case.contaminated:.0%} contaminated" if case.contaminated else ""),
        "pf": case.pf,
        "link": case.link,
        "correlation": case.correlation,
        "bias": float(off.mean()),
        "bias_error": float(off.std() / np.sqrt(len(rows))),
        "rmse": float(np.sqrt(np.mean((probability / case.pf - 1) ** 2))),
        "coverage": float(np.mean((low <= case.pf) & (case.pf <= high))),
        "coverage_sampling": float(np.mean((low <= case.pf) & (case.pf <= sampling_high))),
        "width": float(np.mean(high - low) / case.pf),
        "width_sampling": float(np.mean(sampling_high - low) / case.pf),
        "refined_runs": float(refined_runs.mean()),
        "equivalents": float(refined_runs.mean() + ROUGH_COST * rough_runs.mean()),
    }
    if case.target_cov is None:
        return row
    quartiles = np.quantile(refined_runs, (0.25, 0.5, 0.75), method="inverted_cdf")
    # Of a campaign without any failure nothing is claimed.
    row |= {"target_cov": case.target_cov, "claimed": float(claimed[np.isfinite(claimed)].mean())}
    return row | {f"runs_q{at}": int(runs) for at, runs in zip((25, 50, 75), quartiles, strict=True)}


def cases() -> list[Case]:
    """Every cell: two-phase everywhere, the other estimators at the same cost, subset simulation where rare."""
    sizes = {0.244: (750, 76), 1e-2: (5000, 400), 1e-3: (20000, 1500)}
    answer = []
    for pf, (samples, runs) in sizes.items():
        cost = round(runs + ROUGH_COST * samples)
        for r in CORRELATIONS:
            answer.append(Case("two-phase", pf, r, samples, runs))
            answer.append(Case("published n/N", pf, r, samples, runs))
            if pf > 2e-3:
                answer.append(Case("control variate", pf, r, samples, runs))
            else:
                answer.append(Case("subset simulation, two-phase", pf, r, 500, 400))
        answer.append(Case("Monte Carlo", pf, 1.0, cost, cost))
        answer.append(Case("two-phase", pf, 0.95, samples, runs, contaminated=0.02))
    return answer


def ranking_cases() -> list[Case]:
    """Two-phase with links of which the ranking shows little, or the wrong thing, and with the normal one."""
    links = (*BAD_RANKING, ("normal", 0.95))
    return [
        Case("two-phase", pf, correlation, 750, runs, link=link)
        for pf in (0.05, 0.244)
        for runs in (60, 120)
        for link, correlation in links
    ]


def ranking_values(rows: list[dict[str, Any]]) -> dict[str, float]:
    """Coverage where the ranking is bad, and where it is good the width with and without the guard, over P_f."""
    good = [row for row in rows if (row["link"], row["correlation"]) not in BAD_RANKING]
    bad = [row for row in rows if row not in good]
    named = {
        "coverage_bad_ranking_min": min(row["coverage"] for row in bad),
        "coverage_bad_ranking_min_without_guard": min(row["coverage_sampling"] for row in bad),
        "bias_bad_ranking_over_error_max": max(abs(row["bias"]) / row["bias_error"] for row in bad),
    }
    for row in good:
        where = f"pf{row['pf']:g}_{row['refined_runs']:g}_runs".replace(".", "")
        named[f"width_{where}"] = row["width"]
        named[f"width_{where}_without_guard"] = row["width_sampling"]
    return named


def target_cases() -> list[Case]:
    """Campaigns that end by their target, however many of their samples that takes."""
    return [Case("two-phase", 0.28, correlation, 1000, 1000, target_cov=0.1) for correlation in (0.95, 0.98)]


def target_values(rows: list[dict[str, Any]]) -> dict[str, float]:
    """The true error beside the claimed one, coverage, and quartiles of the refined runs, by correlation."""
    line = ("rmse", "claimed", "coverage", "coverage_sampling", "runs_q25", "runs_q50", "runs_q75")
    return {f"target_cov_{name}_r{100 * row['correlation']:03.0f}": row[name] for row in rows for name in line}


def link_cases() -> list[Case]:
    """Campaigns that end by a target, with other links and probabilities, where the sampling of 750 fields alone does
    not scatter more than the target: at P_f 0.02 it does for all."""
    methods = [("two-phase", *link) for link in TARGET_LINKS]
    methods += [(method, "normal", 0.95) for method in IN_ORDER]
    return [
        Case(method, pf, correlation, 750, 750, link=link, target_cov=target)
        for method, link, correlation in methods
        for pf in (0.02, 0.1, 0.244)
        for target in (0.1, 0.15, 0.25)
        if np.sqrt((1 - pf) / (750 * pf)) < target
    ]


def link_values(rows: list[dict[str, Any]]) -> dict[str, float]:
    """The largest true error over what is claimed, and the largest bias, wherever the ranking has one end; coverage of
    the whole interval where it has two."""
    in_order = [row for row in rows if row["method"] in IN_ORDER]
    one = [row for row in rows if row["link"] != "both ends" and row not in in_order]
    both = [row for row in rows if row["link"] == "both ends"]
    return {
        "target_cov_rmse_over_claimed_max": max(row["rmse"] / row["claimed"] for row in one),
        "target_cov_bias_max": max(abs(row["bias"]) for row in one),
        "target_cov_bias_max_standard_error": max(row["bias_error"] for row in one),
        "target_cov_coverage_both_ends_min": min(row["coverage"] for row in both),
        "target_cov_rmse_over_claimed_in_order_max": max(row["rmse"] / row["claimed"] for row in in_order),
        "target_cov_bias_in_order_max": max(abs(row["bias"]) for row in in_order),
        "target_cov_bias_in_order_max_standard_error": max(row["bias_error"] for row in in_order),
    }


def alike_cases() -> list[Case]:
    """Campaigns of which the refined runs all end alike, or nearly all, with the budget that is usual."""
    return [
        Case("two-phase", pf, correlation, samples, TwoPhase().budget(samples))
        for pf in (0.0, 1e-6, 1e-4, 1.0)
        for samples in (60, 200, 750)
        for correlation in (0.95, -0.9)
    ]


def alike_row(case: Case, rows: np.ndarray) -> dict[str, Any]:
    """Coverage, and what is left open where all refined runs ended alike, over the binomial limit of as many."""
    probability, low, high, refined_runs = rows[:, 0], rows[:, 1], rows[:, 2], rows[:, 5]
    alike = (probability == 0) | (probability == 1)
    width = (high - low)[alike] / np.array([exact_limit(runs) for runs in refined_runs[alike]])
    return {
        "method": f"{case.method}, {case.samples} samples",
        "pf": case.pf,
        "correlation": case.correlation,
        "refined_runs": float(refined_runs.mean()),
        "coverage": float(np.mean((low <= case.pf) & (case.pf <= high))),
        "alike": float(alike.mean()),
        "open_over_binomial": float(width.max(initial=0.0)),
    }


def alike_values(rows: list[dict[str, Any]]) -> dict[str, float]:
    """The least coverage, and the widest interval without a failure, or without a run that stands."""
    return {
        "coverage_without_failures_min": min(row["coverage"] for row in rows),
        "upper_without_failures_over_binomial_max": max(row["open_over_binomial"] for row in rows),
    }


def subset_cases() -> list[Case]:
    """Subset simulation down to where its last level begins, with few chains and with more."""
    return [
        Case("subset simulation, two-phase", 10.0**-levels, 0.98, per_level, runs, levels=levels)
        for levels in range(2, 8)
        for per_level, runs in ((100, 60), (500, 200))
    ]


def subset_values(rows: list[dict[str, Any]]) -> dict[str, float]:
    """Coverage over levels and chains."""
    coverage = [row["coverage"] for row in rows]
    return {"coverage_subset_min": min(coverage), "coverage_subset_max": max(coverage)}


def runs_for_cov(rows: list[dict[str, Any]], target: float) -> float:
    """Refined runs at which the measured error meets `target`, from a fit of rmse^2 = a + b / refined runs."""
    runs = np.array([row["refined_runs"] for row in rows])
    square = np.array([row["rmse"] ** 2 for row in rows])
    slope, level = np.polyfit(1 / runs, square, 1)
    return float(slope / (target**2 - level))


def measured(tasks: list[tuple[Repeat, Any, int]], quick: bool) -> list[np.ndarray]:
    """The rows of every task, in its order: campaigns of a case, so many. Run by as many processes as there are cores
    to use, in pieces that stay in out/estimators: a run that was stopped goes on from them."""
    sources = [
        *sorted((ROOT / "cooperative" / "estimate").rglob("*.py")),
        *sorted(Path(__file__).parent.glob("est*.py")),
    ]
    digest = sha256(b"\0".join(path.read_bytes() for path in sources)).hexdigest()[:16]
    folder, parts = ROOT / "out" / "estimators" / digest, 2 if quick else 20
    with process_pool(len(cores_to_use())) as pool:

        def submit(what: Repeat, case: Any, count: int) -> list[Future[dict[str, Any]]]:
            name = f"{what.__module__.split('.')[-1]} {re.sub(r'[^a-zA-Z0-9.=-]+', ' ', repr(case))}"
            size = count // parts
            return [
                pool.submit(stored_row, folder, f"{name} {at} {size}", partial(_piece, what, case, at, size))
                for at in range(0, count, size)
            ]

        pieces = [submit(*task) for task in tasks]
        return [np.concatenate([part.result()["rows"] for part in futures]) for futures in pieces]


def _piece(what: Repeat, case: Any, first: int, count: int) -> dict[str, Any]:
    return {"rows": what(case, first, count).tolist()}


def run(quick: bool = False) -> Report:
    """Study all cases with 2000 repetitions each, those of means and most of a target with other links with 500 (40 if
    quick), the synthetic ones and the section's."""
    repetitions, fewer = (40, 40) if quick else (2000, 500)
    study, ranking = cases(), ranking_cases()
    budgets = [Case("two-phase", 0.244, 0.95, 750, runs) for runs in (52, 64, 90)]
    to_target, linked, same, deep = target_cases(), link_cases(), alike_cases(), subset_cases()
    todo = sorted([*study, *budgets, *ranking, *to_target], key=lambda case: -case.samples)
    if quick:
        todo = [case for case in todo if case.samples <= 5000]
    on_section = [(method, runs) for method in section.METHODS for runs in section.BUDGETS]
    tasks: list[tuple[Repeat, Any, int]] = [(repeat, case, repetitions) for case in todo]
    # The shortest campaigns scatter most.
    shortest = [case for case in linked if (case.pf, case.target_cov) == (0.244, 0.25)]
    tasks += [(repeat, case, repetitions if case in shortest else fewer) for case in linked]
    tasks += [(repeat, case, fewer) for case in (*same, *deep)]
    tasks += [(means.repeat, case, fewer) for case in means.CASES]
    tasks += [(section.repeat, case, repetitions) for case in on_section]
    answer = {(what, case): rows for (what, case, _), rows in zip(tasks, measured(tasks, quick), strict=True)}
    table = {case: summarise(case, answer[repeat, case]) for case in [*todo, *linked, *deep]}
    alike = [alike_row(case, answer[repeat, case]) for case in same]
    of_failures = [means.summarise(case, answer[means.repeat, case]) for case in means.CASES]
    population = [section.summarise(*case, answer[section.repeat, case]) for case in on_section]
    ours = [
        row for case, row in table.items() if case.method == "two-phase" and not case.contaminated and case in study
    ]
    runs_of_10 = runs_for_cov([table[case] for case in (*budgets, Case("two-phase", 0.244, 0.95, 750, 76))], 0.1)
    values = {
        "repetitions": repetitions,
        "two_phase_bias_max": max(abs(row["bias"]) for row in ours),
        "two_phase_bias_max_standard_error": max(row["bias_error"] for row in ours),
        "two_phase_coverage_min": min(row["coverage_sampling"] for row in ours),
        "two_phase_coverage_max": max(row["coverage_sampling"] for row in ours),
        "two_phase_coverage_guarded_min": min(row["coverage"] for row in ours),
        "two_phase_coverage_guarded_max": max(row["coverage"] for row in ours),
        "two_phase_runs_pf0244_r095": runs_of_10 + ROUGH_COST * 750,
        "two_phase_refined_runs_pf0244_r095": runs_of_10,
        **ranking_values([table[case] for case in ranking]),
        **target_values([table[case] for case in to_target]),
        "link_repetitions": fewer,
        "mean_repetitions": fewer,
        **link_values([table[case] for case in [*to_target, *linked]]),
        **alike_values(alike),
        **subset_values([table[case] for case in deep]),
        **means.values(of_failures),
        **section.values(population),
    }
    return Report(values, [*table.values(), *alike, *of_failures, *population], partial(section.draw, population))
