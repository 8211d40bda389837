"""Gradients: against central differences, their cost beside the forward run, and the memory of long reverse runs.

Differences are in float64; the figure shows their error against the step length, rounding to the left and curvature to
the right, and how long softening runs lose the plateau between: particles then change branch within one step length.
Times are of one core, per particle and step; `reverse` is the time of value and gradient less that of the forward run.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import jax
import numpy as np
from matplotlib.figure import Figure

from benchmarks.measure import Report, on_cores
from benchmarks.speed import gradients_problems as problems
from cooperative.reporting import save

LENGTHS = 10.0 ** np.arange(-11, -1.5, 0.5)
PROBLEMS: dict[str, Callable[[int], problems.Problem]] = {
    "elastic": problems.elastic,
    "softening": problems.softening,
    "contact": problems.contact,
    "set-up": problems.set_up,
    **problems.BY_LAW,
}


def difference_rows(problem: str, steps: int) -> Iterator[dict[str, Any]]:
    """One row per number: derivative by reverse mode, and its distance to central differences by step length."""
    with jax.enable_x64(True):
        run, derivatives = PROBLEMS[problem](steps)
        compiled = jax.jit(run)
        ones = dict.fromkeys(derivatives, 1.0)
        for name, derivative in derivatives.items():
            ahead, behind = (
                np.array([float(compiled(ones | {name: 1.0 + sign * h})) for h in LENGTHS]) for sign in (1, -1)
            )
            errors = abs((ahead - behind) / (2 * LENGTHS) / derivative - 1)
            yield {
                "problem": problem,
                "steps": steps,
                "parameter": name,
                "derivative": derivative,
                "least_error": float(errors.min()),
                "at_step_length": float(LENGTHS[errors.argmin()]),
                "errors": errors.tolist(),
            }


def draw(rows: list[dict[str, Any]], folder: Path) -> None:
    """Error of central differences against step length: elastic, softening, and softening ever longer."""
    figure = Figure(figsize=(9, 4), layout="constrained")
    panels = figure.subplots(1, 3, sharey=True)
    colours = {"moduli": "#0072B2", "gravity": "#E69F00", "strength": "#009E73", "softening": "#D55E00"}
    shown = {
        "elastic": [r for r in rows if r["problem"] == "elastic"],
        "softening": [r for r in rows if r["problem"] == "softening" and r["steps"] == 500],
    }
    for panel, (problem, chosen) in zip(panels, shown.items(), strict=False):
        for row in chosen:
            panel.loglog(LENGTHS, row["errors"], ".-", color=colours[row["parameter"]], label=f"by {row['parameter']}")
        panel.set(title=f"{problem}, {chosen[0]['steps']} steps", xlabel="step length (relative)")
    ladder = sorted(
        (r for r in rows if r["problem"] == "softening" and r["parameter"] == "strength"), key=lambda r: r["steps"]
    )
    for row, shade in zip(ladder, ("#56B4E9", "#009E73", "#E69F00", "#CC79A7"), strict=False):
        panels[2].loglog(LENGTHS, row["errors"], ".-", color=shade, label=f"{row['steps']} steps")
    panels[2].set(title="softening, by strength", xlabel="step length (relative)")
    panels[0].set(ylabel="|difference / reverse mode - 1|", ylim=(1e-11, 1e2))
    for panel in panels:
        panel.legend(fontsize=9)
        panel.grid(alpha=0.3)
    save(figure, folder / "gradients_step_length.png", dpi=90)


def cost_row(engine: str | None, quick: bool) -> dict[str, Any]:
    """Times of the rough 3D slope, or of its section where that is enough."""
    case = {
        "scene": "paper_section" if quick else "paper",
        "engine": engine,
        "steps": 10 if engine == "XLA" else 40,
        "memory": 4e9,
        "repeats": 3 if quick else 5,
    }
    result = on_cores(1, "benchmarks.speed.gradients_case", json.dumps(case))
    forward, both = result["forward_us"]["median"], result["value_and_gradient_us"]["median"]
    return {
        **case,
        **result,
        "reverse_over_forward": both / forward - 1,
        "value_and_gradient_over_forward": both / forward,
    }


def run(quick: bool) -> Report:
    """Differences, costs by engine, and one long reverse run on the rough 3D slope."""
    # Processes are started before JAX has threads here.
    costs = [cost_row(engine, quick) for engine in (None, "XLA")]
    long_case = {"scene": "paper", "engine": None, "steps": 5000, "memory": 3e9, "repeats": 0}
    if quick:
        long_case |= {"scene": "paper_section", "steps": 200}
    long = on_cores(1, "benchmarks.speed.gradients_case", json.dumps(long_case))
    parts = {
        "elastic": [*difference_rows("elastic", 50 if quick else 1000)],
        "softening": [*difference_rows("softening", 20 if quick else 500)],
        "contact": [*difference_rows("contact", 60)],
    }
    longer: list[dict[str, Any]] = []
    if not quick:
        parts["set_up"] = [*difference_rows("set-up", 100)]
        parts["laws"] = [row for law in problems.BY_LAW for row in difference_rows(law, 40)]
        longer = [row for steps in (100, 1500, 4000) for row in difference_rows("softening", steps)]
    rows = [*(row for part in parts.values() for row in part), *longer]
    worst = {f"fd_rel_{name}": max(row["least_error"] for row in part) for name, part in parts.items()}
    native, xla = (cost["reverse_over_forward"] for cost in costs)
    values = {
        **worst,
        "reverse_over_forward_native": native,
        "reverse_over_forward_xla": xla,
        "rough_reverse_peak_gb": long["peak_mb"] / 1024,
        "rough_reverse_steps": long_case["steps"],
        "rough_reverse_seconds": long["seconds"],
    }
    tabled = [{k: v for k, v in r.items() if k != "errors"} for r in rows]
    return Report(values, [*tabled, *costs, {**long_case, **long}], partial(draw, rows))
