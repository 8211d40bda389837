"""Gradients: against central differences, their cost beside the forward run, and the memory of long reverse runs.

Differences are in float64; the figure shows their error against the step length, rounding to the left and curvature to
the right, and how long softening runs lose the plateau between: particles then change branch within one step length.
Times are of one core, per particle and step; `reverse` is the time of value and gradient less that of the forward run.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import jax
import numpy as np
from matplotlib.figure import Figure

import jaxmpm as mpm
from benchmarks.measure import Report, on_cores
from cooperative.reporting import save
from jaxmpm.run import objectives

SLOPE = mpm.Slope(crest=10.0, height=6.0, run_per_rise=1.0, toe=14.0, foundation=2.0)
CLAY = mpm.Soil(young=1e7, strength=20e3, softening_modulus=60e3, tension_cutoff=None)
LENGTHS = 10.0 ** np.arange(-11, -1.5, 0.5)


def elastic_problem() -> tuple[mpm.Scene, mpm.State]:
    """An elastic block in the plane that falls onto a roller and rings."""
    soil = mpm.Soil(unit_weight=9810.0, young=1e6, poisson=0.3)
    return mpm.block(
        (4.0, 3.0), soil, mpm.Discretisation(0.5, (0.25, 0.25)), domain=(6.0, 5.0), corner=(1.0, 0.0),
        gravity=(0.0, -9.81), walls="roller", speed=2.0,
    )  # fmt: skip


def softening_problem() -> tuple[mpm.Scene, mpm.State]:
    """A slope that slides and softens."""
    scene, state = mpm.slope(SLOPE, CLAY, mpm.Discretisation(1.0, (0.5, 0.5)))
    return mpm.reduced(scene, 1.3), state


def by_parameter(problem: str, steps: int) -> dict[str, Callable[[Any], Any]]:
    """Objectives of a run, each as a function of a factor on one parameter."""
    scene, state = {"elastic": elastic_problem, "softening": softening_problem}[problem]()

    def run(scene: mpm.Scene, state: mpm.State) -> Any:
        return objectives.log_displacement(mpm.replay(scene, state, steps)[0])

    def material(**changed: Any) -> mpm.Scene:
        return replace(scene, material=replace(scene.material, **changed))

    law = scene.material
    result: dict[str, Callable[[Any], Any]] = {
        "moduli": lambda f: run(material(bulk=law.bulk * f, shear=law.shear * f), state),
        "gravity": lambda f: run(replace(scene, loads=replace(scene.loads, gravity=scene.loads.gravity * f)), state),
    }
    if problem == "softening":
        result["strength"] = lambda f: run(material(strength=law.strength * f), state)
        softening = law.softening
        result["softening"] = lambda f: run(
            material(softening=replace(softening, modulus=softening.modulus * f)), state
        )
    return result


def difference_rows(problem: str, steps: int) -> Iterator[dict[str, Any]]:
    """One row per parameter: derivative by reverse mode, and its distance to central differences by step length."""
    with jax.enable_x64(True):
        for name, function in by_parameter(problem, steps).items():
            reverse = float(jax.jit(jax.grad(function))(1.0))
            compiled = jax.jit(function)
            errors = [
                abs((float(compiled(1.0 + h)) - float(compiled(1.0 - h))) / (2 * h) / reverse - 1) for h in LENGTHS
            ]
            yield {
                "problem": problem,
                "steps": steps,
                "parameter": name,
                "derivative": reverse,
                "least_error": float(min(errors)),
                "at_step_length": float(LENGTHS[int(np.argmin(errors))]),
                "errors": errors,
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
    ladder = [r for r in rows if r["problem"] == "softening" and r["parameter"] == "strength"]
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
    long = on_cores(len(os.sched_getaffinity(0)), "benchmarks.speed.gradients_case", json.dumps(long_case))
    counts = (20,) if quick else (100, 500, 1500, 4000)
    rows = [*difference_rows("elastic", 50 if quick else 1000)]
    rows += [row for steps in counts for row in difference_rows("softening", steps)]
    named = [("elastic", 50 if quick else 1000), ("softening", 20 if quick else 500)]
    worst = {
        f"fd_rel_{problem}": max(r["least_error"] for r in rows if (r["problem"], r["steps"]) == (problem, steps))
        for problem, steps in named
    }
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
