"""Error against run time: bar, manufactured wave and footing against theory, the published slope over cells.

Published (Jiang et al. 2024, Table 3): factor of safety 1.15 at cells of 1, 0.75 and 0.5 m, run-out 14.17, 14.52 and
14.76 m, in 12,240, 24,503 and 48,976 s. Seconds are those of runs already compiled; of a slope those of finding its
factor of safety and of the slide. `python -m benchmarks.accuracy.work_precision` draws both figures anew from
the stored answer."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

import jaxmpm as mpm
from benchmarks.accuracy.collapse import collapsed
from benchmarks.accuracy.footing import CAPACITY, capacity
from benchmarks.accuracy.manufactured import manufactured_run
from benchmarks.measure import Report, scene_campaign, timed
from benchmarks.results import FIGURES, stored_rows
from cooperative.measure import Consequences, consequences
from cooperative.reporting import panels, save
from jaxmpm import diagnostics

Row = dict[str, Any]
BAR = mpm.Soil(unit_weight=9.81e3, young=1e6, poisson=0.0)
# Cell and particle spacing (m) of the section: 2 particles a cell where that divides its sizes, else 3.
GRIDS = ((3.0, 1.0), (2.0, 1.0), (1.5, 0.5), (1.0, 0.5), (0.75, 0.25), (0.5, 0.25))
PUBLISHED = {
    1.0: {"fos": 1.15, "runout_m": 14.17, "seconds": 12240},
    0.75: {"fos": 1.15, "runout_m": 14.52, "seconds": 24503},
    0.5: {"fos": 1.15, "runout_m": 14.76, "seconds": 48976},
}
DEFAULT = scene_campaign("section")
BAND = DEFAULT.soil.softening_length
"""Thickness of the shear band (m) to which the published softening is taken to refer, where a setting has one: a fifth
of the slope's height, as in scenes that give none."""
# What of the soil and of the discretisation a setting changes, and the largest cell that can have it (m).
AVERAGED = {"internal_length": DEFAULT.grids["refined"].internal_length}
IN_CELLS = {"cell_average": True}
SETTINGS: dict[str, tuple[dict[str, Any], dict[str, Any], float]] = {
    "plain": ({}, {}, 3.0),
    "F-bar": ({}, {"fbar": True}, 3.0),
    "scaled softening": ({"softening_length": BAND}, {}, 3.0),
    "F-bar, scaled softening": ({"softening_length": BAND}, {"fbar": True}, 3.0),
    "averaged plastic strain": ({"softening_length": BAND}, AVERAGED, 1.5),
    "F-bar, averaged plastic strain": ({"softening_length": BAND}, {"fbar": True} | AVERAGED, 1.5),
    "average over cells": ({}, IN_CELLS, 3.0),
    "average over cells, scaled softening": ({"softening_length": BAND}, IN_CELLS, 3.0),
    "average over cells, averaged plastic strain": ({"softening_length": BAND}, IN_CELLS | AVERAGED, 1.5),
}
BEST_BUY = "average over cells, averaged plastic strain"
ON_LARGE_CELLS = "average over cells, scaled softening"
"""On cells too large for the average. Scenes have both by default."""
FIXED = 1.4
"""Strength reduction at which every setting fails at every cell: there run-outs are of one soil."""
ADVICE = (
    "Screening and refined runs: GIMP, MUSL, two particles a cell, float32, volumetric strain averaged over cells; "
    "refined runs on cells that resolve the shear band, with plastic strain averaged to its thickness; screening on "
    "twice the cell, with softening scaled to it. Scenes do so by default. The table is of CFL 0.5; at 0.8 the slope "
    "has the same factor of safety and run-out on cells of 2 m. Scenes have CFL 0.9, which `levers` holds against 0.5."
)
CHOICES: dict[str, dict[str, Any]] = {
    "default: GIMP, MUSL, 2 a cell, CFL 0.5, float32": {},
    "USL": {"scheme": mpm.Scheme.USL},
    "USF": {"scheme": mpm.Scheme.USF},
    "linear kernel": {"kernel": mpm.Linear},
    "quadratic B-splines": {"kernel": mpm.QuadraticBSpline},
    "APIC, quadratic B-splines": {"kernel": mpm.QuadraticBSpline, "apic": True, "flip": 0.0},
    "1 particle a cell": {"particles": 1},
    "3 particles a cell": {"particles": 3},
    "CFL 0.1": {"cfl": 0.1},
    "CFL 0.2": {"cfl": 0.2},
    "CFL 0.8": {"cfl": 0.8},
    "float64": {"dtype": "float64"},
}


def made(problem: str, choice: str, cell: float, error: float, error_of: str, seconds: float) -> Row:
    """A row of a problem with a theory."""
    return {
        "problem": problem,
        "choice": choice,
        "cell_m": cell,
        "error": float(f"{error:.3g}") if np.isfinite(error) else None,
        "error_of": error_of,
        "seconds": float(f"{seconds:.3g}"),
    }


def bar(cells: int, *, particles: int = 2, dtype: str = "float32", **choices: Any) -> tuple[float, float]:
    """Largest error of the centre-of-mass velocity over its amplitude in one period of the axial bar; seconds."""
    cell = 25.0 / cells
    numerics = mpm.Discretisation(cell, (cell / particles,), dtype=dtype, **choices)
    scene, state = mpm.bar(25.0, BAR, numerics, velocity=0.1)
    omega = np.pi / 50 * np.sqrt(1e6 / 1e3)
    times = np.linspace(0, 2 * np.pi / omega, 17)[1:]
    result = mpm.solve(scene, state, t_end=float(times[-1]), snapshots=times.tolist())
    reached = np.array([int(s.step) for s in result.snapshots]) * float(scene.numerics.time_step)
    distance = np.array([float(diagnostics.momentum(scene, s)[0]) for s in result.snapshots])
    error = np.max(np.abs(distance / float(diagnostics.momentum(scene, state)[0]) - np.cos(omega * reached)))
    steps, run = jnp.asarray(int(result.state.step)), jax.jit(mpm.advance)
    return float(error), timed(lambda: jax.block_until_ready(run(scene, state, steps)), repeats=3).median


def wave(cells: int, *, dtype: str = "float32", cfl: float = 0.5, **choices: Any) -> tuple[float, float]:
    """The manufactured wave in the plane: its largest error over its amplitude after a third of a period; seconds."""
    return manufactured_run(cells, 2, amplitude=0.01, cfl=cfl, dtype=dtype, **choices)


def footing(cells: int, *, particles: int = 2, dtype: str = "float64", **choices: Any) -> tuple[float, float]:
    """The strip footing: error of its bearing capacity over theory, `cells` on half its width; seconds."""
    cell = 1 / cells
    answer = capacity(cell, spacing=cell / particles, dtype=dtype, **choices)
    return abs(answer["load"] / CAPACITY - 1), answer["seconds"]


def theory_rows(quick: bool) -> Iterator[Row]:
    """One choice at a time around the defaults, on three problems with a theory."""
    locking: dict[str, dict[str, Any]] = {
        "F-bar": {"fbar": True},
        "F-bar, 1 particle a cell": {"fbar": True, "particles": 1},
        "average over cells": IN_CELLS,
    }
    # The load is a small change of a great momentum: float64 only.
    on_clay = {name: choice for name, choice in CHOICES.items() if name != "float64"} | locking
    problems: list[tuple[str, Callable[..., Any], dict[str, Any], float, tuple[int, ...], str]] = [
        ("axial bar", bar, CHOICES, 25.0, (25,) if quick else (12, 25, 50, 100), "velocity, over its amplitude"),
        ("manufactured wave, 2D", wave, CHOICES, 1.0, (8,) if quick else (8, 16, 32), "displacement, over amplitude"),
        ("strip footing, nu = 0.49", footing, on_clay, 1.0, (2,) if quick else (2, 4, 8), "bearing capacity"),
    ]
    for problem, solve, choices, size, grids, error_of in problems:
        for name in list(choices)[:2] if quick else choices:
            for cells in grids:
                choice = choices[name]
                with jax.enable_x64(solve is footing or choice.get("dtype") == "float64"):
                    try:
                        error, seconds = solve(cells, **choice)
                    except FloatingPointError as broken:
                        yield made(problem, name, size / cells, float("inf"), str(broken).split(":")[1], 0.0)
                        continue
                yield made(problem, name, size / cells, error, error_of, seconds)


def slope_row(
    cell: float,
    spacing: float,
    soil_choice: dict[str, Any],
    choice: dict[str, Any],
    resolution: float,
    guess: float | None = None,
    also_at: float | None = None,
) -> Row:
    """Factor of safety of the published section without random field, and the run-out of its first failing slide.

    guess: near which the factor is sought first. also_at: a strength reduction whose slide is reported too.
    """
    campaign = scene_campaign("paper_section")
    start = time.perf_counter()
    soil = replace(campaign.soil, **soil_choice)
    # CFL 0.5 is what choices stand beside, whatever scenes have.
    choice = {"cfl": 0.5, "spacing": (spacing, spacing), **choice}
    with jax.enable_x64(choice.get("dtype") == "float64"):
        numerics = replace(campaign.grids["rough"], cell=cell, **choice)
        scene, state = campaign.site.built(soil, numerics, campaign.run.gravity, at_rest=True)
        answer = factor(scene, state, resolution, guess)
        first = slide(scene, state, answer.fails, numerics)
        row: Row = {
            "problem": "slope",
            "setting": "plain",
            "cell_m": cell,
            "particles_a_cell": round(cell / numerics.spacing[0]),
            "stands_at_R": answer.stable,
            "fails_at_R": answer.fails,
            "runout_m": round(first.runout, 2),
            "seconds": round(time.perf_counter() - start, 1),
            "published": PUBLISHED.get(cell, "none"),
        }
        if also_at is not None:
            start = time.perf_counter()
            fixed = slide(scene, state, also_at, numerics)
            row |= {
                f"runout_at_R_{also_at:g}_m": round(fixed.runout, 2),
                f"volume_at_R_{also_at:g}_m3_per_m": round(fixed.volume, 1),
                f"seconds_at_R_{also_at:g}": round(time.perf_counter() - start, 1),
            }
    return row


def slide(scene: mpm.Scene, state: mpm.State, reduction: float, numerics: mpm.Discretisation) -> Consequences:
    """What the section's slide at this strength reduction leaves."""
    campaign = scene_campaign("paper_section")
    ended = mpm.solve(mpm.reduced(scene, reduction), state, t_end=campaign.run.t_end, rules=[mpm.Settle()])
    face = campaign.site.shape.face
    assert face is not None
    return consequences(
        np.asarray(scene.particles.position),
        np.asarray(ended.raise_if_failed().state.displacement),
        np.asarray(scene.particles.volume),
        face,
        half_size=np.asarray(numerics.spacing) / 2,
    )


def factor(scene: mpm.Scene, state: mpm.State, resolution: float, guess: float | None) -> mpm.run.FactorOfSafety:
    """The factor of safety, sought within 0.1 of the guess and, where it is not there, in all the range."""
    if guess is not None:
        try:
            near = (guess - 0.1, guess + 0.1)
            return mpm.factor_of_safety(scene, state, bracket=near, resolution=resolution, batch=3)
        except ValueError:
            pass
    return mpm.factor_of_safety(scene, state, bracket=(0.8, 1.8), resolution=resolution, batch=4)


def slope_rows(quick: bool) -> Iterator[Row]:
    """Every setting over cells, coarse to fine; and at cells of 2 m one numerical choice at a time."""
    if quick:
        for setting in ("plain", BEST_BUY):
            soil, choice, largest = SETTINGS[setting]
            grid = next(grid for grid in GRIDS[1:] if grid[0] <= largest)
            yield slope_row(*grid, soil, choice, 0.05) | {"setting": setting}
        return
    for setting, (soil, choice, largest) in SETTINGS.items():
        guess = None
        for cell, spacing in GRIDS:
            if cell > largest:
                continue
            row = slope_row(cell, spacing, soil, choice, 0.01, guess, FIXED)
            guess = row["fails_at_R"]
            yield row | {"setting": setting}
    guess = 1.23
    for name, choice in CHOICES.items():
        particles = choice.get("particles", 2)
        numerics = {key: value for key, value in choice.items() if key != "particles"}
        if particles == 2 and not numerics:
            continue  # the default stands above
        if particles == 3:
            name, particles = "4 particles a cell", 4  # 3 do not divide the section
        yield slope_row(2.0, 2.0 / particles, {}, numerics, 0.01, guess) | {"setting": f"plain, {name}"}


def sand_rows(quick: bool) -> Iterator[Row]:
    """A column of sand as high as wide, over cells a width: how far its front runs, and 95 % of it."""
    for cells in (8,) if quick else (8, 16, 32, 64, 128):
        answer = collapsed(1.0, cells)
        yield {
            "problem": "sand column, run-out over its width",
            "cells_a_width": cells,
            "front": round(answer["front"], 3),
            "front_of_95_percent": round(answer["front_of_95_percent"], 3),
            "seconds": round(answer["seconds"], 1),
        }


def draw(rows: list[Row], folder: Path) -> None:
    """Both figures, legible at the width of a page: the slope over cells, and problems with a theory."""
    of_choices = [row for row in rows if row.get("choice") is not None and row["error"] is not None]
    save(slopes([row for row in rows if row.get("setting") in SETTINGS]), folder / "work_precision.png", dpi=90)
    save(theory(of_choices), folder / "work_precision_theory.png", dpi=90)


def slopes(rows: list[Row]) -> Figure:
    """Factor of safety and run-out against cell size, and against seconds; a line per setting."""
    figure, axes = panels(2, 2, size=(4.4, 3.2))
    across = ("cell_m", "fails_at_R", "seconds"), ("cell_m", f"runout_at_R_{FIXED:g}_m", f"seconds_at_R_{FIXED:g}")
    names = "smallest R that fails", f"run-out at R = {FIXED:g} [m]"
    for (left, right), (cell, key, seconds), name in zip((axes[::2], axes[1::2]), across, names, strict=True):
        for setting, marker in zip(SETTINGS, "os^Dv*<>p", strict=True):
            lines = [row for row in rows if row["setting"] == setting]
            for axis, at in ((left, cell), (right, seconds)):
                axis.plot([row[at] for row in lines], [row[key] for row in lines], marker=marker, label=setting)
        left.set(ylabel=name, xlabel="cell [m]")
        right.set(ylabel=name, xlabel="seconds", xscale="log")
    axes[0].plot(list(PUBLISHED), [p["fos"] for p in PUBLISHED.values()], "kP", label="published")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False)
    return figure


def theory(rows: list[Row]) -> Figure:
    """Error against seconds of each problem with a theory, a line per choice."""
    problems = list(dict.fromkeys(row["problem"] for row in rows))
    figure, axes = panels(1, len(problems), size=(3.0, 4.6))
    choices = {name: number for number, name in enumerate(dict.fromkeys(row["choice"] for row in rows))}
    for axis, problem in zip(axes, problems, strict=True):
        for name, number in choices.items():
            lines = [row for row in rows if (row["problem"], row["choice"]) == (problem, name)]
            style = ("o-", "s--", "^:")[number % 3]
            axis.loglog(
                [row["seconds"] for row in lines], [row["error"] for row in lines], style, ms=4,
                color=f"C{number % 10}", label=name,
            )  # fmt: skip
        axis.set(xlabel="seconds", title=problem)
        axis.xaxis.set_minor_formatter(NullFormatter())  # less than a decade
    axes[0].set(ylabel="error")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False)
    return figure


def finest_with_its_error(rows: list[Row], key: str) -> dict[str, float]:
    """The value at cells of 0.5 m, and what is left to a cell of none if the error is of first order (Richardson)."""
    at = {row["cell_m"]: row[key] for row in rows}
    return {"at_05": at[0.5], "left": round(at[0.5] - at[1.0], 3)}


def run(quick: bool) -> Report:
    """Problems with a theory; the slope over cells and settings, and how far its answers spread from 1 to 0.5 m."""
    rows = []
    for row in chain(theory_rows(quick), sand_rows(quick), slope_rows(quick)):
        print(json.dumps(row), file=sys.stderr, flush=True)  # a run cut short has not run for nothing
        rows.append(row)
    if quick:
        return Report({"rows": len(rows)}, rows)
    values: dict[str, Any] = {"best_buy": BEST_BUY, "best_buy_on_large_cells": ON_LARGE_CELLS, "advice": ADVICE}
    at_fixed = f"runout_at_R_{FIXED:g}"
    for key, name in (("fails_at_R", "fos"), ("runout_m", "runout"), (f"{at_fixed}_m", at_fixed)):
        for setting in SETTINGS:
            fine = [row for row in rows if row.get("setting") == setting and row["cell_m"] <= 1.0]
            spread = round(max(row[key] for row in fine) - min(row[key] for row in fine), 3)
            label = setting.replace(", ", "_").replace(" ", "_").replace("-", "")
            values[f"slope_{name}_spread_{label}"] = spread
            if setting == BEST_BUY:
                values[f"slope_{name}_spread_cells_1_to_05"] = spread
                values[f"slope_{name}_finest_and_first_order_rest"] = finest_with_its_error(fine, key)
    *_, coarser, finest = (row for row in rows if row["problem"].startswith("sand"))
    for name in ("front", "front_of_95_percent"):
        values[f"sand_{name}_at_128_cells"] = finest[name]
        values[f"sand_{name}_change_from_64_to_128_cells"] = round(finest[name] - coarser[name], 3)
    return Report(values, rows, partial(draw, rows))


if __name__ == "__main__":
    draw(stored_rows("work_precision"), FIGURES)
