"""Failures near 1e-3 on the plane-strain section: gradients, subset simulation and plain Monte Carlo by run time.

The published section on its rough grid with more strength than published, so that it fails rarely. Every estimator
counts the same hard failures, runs whose largest displacement exceeds 1 m. The design point's gradients are in the
time of importance sampling. `cov` is each estimator's own; `work` is cov^2 times seconds, the time for a coefficient
of variation of 1, which does not depend on how long it ran.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import t as student

from benchmarks.measure import Report, scene_campaign
from cooperative import runs
from cooperative.estimate import Estimate, SubsetPlan, monte_carlo, subset_simulation
from cooperative.reporting import save
from cooperative.tools.research.rare import design_point, importance_sampling, slide_limit_state

MEAN = 57e3
# The smooth measure for the design point: root mean square displacement (m) after so many seconds.
SECONDS, DISPLACEMENT = 2.5, 0.5


def displacements(model: runs.GridModel) -> Callable[[np.ndarray], np.ndarray]:
    """Coefficients (n, M) -> largest displacement (m); a run ends once it fails, and a broken one counts as failed."""

    def run(coefficients: np.ndarray) -> np.ndarray:
        table = np.asarray(coefficients, np.float32)
        limit = model.campaign.run.failure_displacement
        done = {
            s.number: s.row
            for s in runs.run_samples(model, table, range(len(table)), rules=model.campaign.rules(limit))
        }
        rows = [done[number] for number in range(len(table))]
        return np.array([np.inf if row["broke_off"] else row["displacement"] for row in rows])

    return run


def row(name: str, estimate: Estimate, runs: int, seconds: float, **more: Any) -> dict[str, Any]:
    """One estimator: probability with its interval, what it spent, and its work."""
    return {
        "estimator": name,
        "probability": estimate.probability,
        "interval": list(estimate.interval),
        "cov": estimate.cov,
        "runs": runs,
        "seconds": round(seconds, 1),
        "work_s": estimate.cov**2 * seconds,
        **more,
    }


def subset(run: Callable[[np.ndarray], np.ndarray], modes: int, limit: float, plan: SubsetPlan) -> tuple[Estimate, int]:
    """Mean over independent runs of subset simulation, with Student's interval of their scatter."""
    sampled = subset_simulation(run, modes, plan)
    parts = (
        np.array(
            [
                np.sum(
                    sampled.weight[sampled.replicate == r]
                    * (sampled.rough_displacement[sampled.replicate == r] > limit)
                )
                for r in range(plan.replicates)
            ]
        )
        * plan.replicates
    )
    mean, error = float(parts.mean()), float(parts.std(ddof=1) / np.sqrt(plan.replicates))
    half = float(student.ppf(0.975, plan.replicates - 1)) * error
    reach = (max(mean - half, 0.0), mean + half)
    return Estimate(
        mean, reach, error / mean if mean else float("inf"), sampled.rough_runs, "subset simulation"
    ), sampled.rough_runs


def draw(rows: list[dict[str, Any]], folder: Path) -> None:
    """Coefficient of variation against seconds, each estimator's point and the line it moves along."""
    figure = Figure(figsize=(6, 4), layout="constrained")
    ax = figure.subplots()
    for result, colour, marker in zip(rows, ("#000000", "#E69F00", "#0072B2"), "sov", strict=False):
        start = result.get("setup_s", 0.0)
        seconds = np.geomspace(10, 1e5, 200)
        ax.loglog(start + seconds, np.sqrt(result["cov"] ** 2 * (result["seconds"] - start) / seconds), color=colour)
        ax.loglog([result["seconds"]], [result["cov"]], marker, color=colour, label=result["estimator"])
    ax.set(xlabel="seconds, one process", ylabel="coefficient of variation of P_f", ylim=(0.02, 2), xlim=(10, 1e5))
    ax.axhline(0.1, color="grey", lw=0.8, ls=":")
    ax.legend(fontsize=8)
    ax.grid(alpha=0.3)
    save(figure, folder / "rare_events.png", dpi=90)


def run(quick: bool) -> Report:
    """The three estimators on one section."""
    campaign = scene_campaign("paper_section")
    campaign = replace(
        campaign, random={"strength": replace(campaign.random["strength"], mean=45e3 if quick else MEAN)}
    )
    soil = runs.random_soil(campaign)
    model = runs.build(campaign, "rough", soil)
    solve, limit, modes = displacements(model), campaign.run.failure_displacement, soil.modes
    solve(np.zeros((1, modes)))  # compiles

    start = time.perf_counter()
    limit_state = slide_limit_state(model.scene, model.state, model.varied, seconds=SECONDS, displacement=DISPLACEMENT)
    point = design_point(limit_state, modes)
    setup = time.perf_counter() - start
    count = 20 if quick else 1000
    weighted = importance_sampling(lambda xi: solve(xi) > limit, point.coefficients, count, seed=1)
    rows = [row("importance sampling at the design point", weighted, count, time.perf_counter() - start, setup_s=setup)]

    start = time.perf_counter()
    plan = SubsetPlan(per_level=20, replicates=2, levels=1) if quick else SubsetPlan(per_level=250, replicates=6)
    estimate, spent = subset(solve, modes, limit, plan)
    rows.append(row("subset simulation", estimate, spent, time.perf_counter() - start))

    start = time.perf_counter()
    count = 20 if quick else 8000
    failed = solve(np.random.default_rng(3).standard_normal((count, modes))) > limit
    rows.append(
        row(
            "plain Monte Carlo",
            monte_carlo(failed),
            count,
            time.perf_counter() - start,
        )
    )
    values = {
        "form_probability": point.probability,
        "form_beta": point.beta,
        "form_gradients": point.gradients,
        "form_converged": point.converged,
        "form_seconds": round(setup, 1),
        "importance_probability": rows[0]["probability"],
        "subset_probability": rows[1]["probability"],
        "monte_carlo_probability": rows[2]["probability"],
        "work_monte_carlo_over_importance": rows[2]["work_s"] / rows[0]["work_s"] if rows[0]["work_s"] else None,
        "work_subset_over_importance": rows[1]["work_s"] / rows[0]["work_s"] if rows[0]["work_s"] else None,
    }
    return Report(values, rows, partial(draw, rows))
