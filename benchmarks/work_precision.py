"""Error against run time: bar and manufactured wave against theory, the published slope against its finest run.

Published (Jiang et al. 2024, Table 3): factor of safety 1.15 at cells of 1, 0.75 and 0.5 m, run-out 14.17, 14.52 and
14.76 m, in 12,240, 24,503 and 48,976 s.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

import jaxmpm as mpm
from benchmarks.measure import ROOT, Report, scene_config, timed
from cooperative.consequences import SlopeGeometry, consequences
from jaxmpm import diagnostics

Row = dict[str, Any]
BAR = mpm.Soil(unit_weight=9.81e3, young=1e6, poisson=0.0)
# Cell and particle spacing (m) of the section: 2 particles a cell where that divides its sizes, else 3.
GRIDS = ((3.0, 1.0), (2.0, 1.0), (1.5, 0.5), (1.0, 0.5), (0.75, 0.25), (0.5, 0.25))
BAND = 1.0
"""Thickness of the shear band (m) to which the published softening is taken to refer, where it is scaled."""
SETTINGS: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "plain": ({}, {}),
    "F-bar": ({}, {"fbar": True}),
    "scaled softening": ({"softening_length": BAND}, {}),
    "F-bar, scaled softening": ({"softening_length": BAND}, {"fbar": True}),
}
BEST_BUY = "F-bar, scaled softening"


def bar_row(cells: int, particles: int, cfl: float, dtype: str, **choices: Any) -> Row:
    """Largest error of the centre-of-mass velocity over its amplitude, in one period of the axial bar."""
    with jax.enable_x64(dtype == "float64"):
        cell = 25.0 / cells
        numerics = mpm.Discretisation(cell, (cell / particles,), cfl=cfl, dtype=dtype, **choices)
        scene, state = mpm.bar(25.0, BAR, numerics, velocity=0.1)
        omega = np.pi / 50 * np.sqrt(1e6 / 1e3)
        times = np.linspace(0, 2 * np.pi / omega, 17)[1:]
        result = mpm.solve(scene, state, t_end=float(times[-1]), snapshots=times.tolist())
        reached = np.array([int(s.step) for s in result.snapshots]) * float(scene.time_step)
        moved = np.array([float(diagnostics.momentum(scene, s)[0]) for s in result.snapshots])
        error = np.max(np.abs(moved / float(diagnostics.momentum(scene, state)[0]) - np.cos(omega * reached)))
        steps = jnp.asarray(int(result.state.step))
        run = jax.jit(mpm.advance)
        seconds = timed(lambda: jax.block_until_ready(run(scene, state, steps)), repeats=3)
        return {
            "problem": "axial bar",
            "cell_m": cell,
            "particles_per_cell": particles,
            "cfl": cfl,
            "dtype": dtype,
            "kernel": numerics.kernel.__name__,
            "scheme": numerics.scheme.name,
            "error": float(f"{error:.3g}"),
            "error_of": "largest of the centre-of-mass velocity, over its amplitude",
            "seconds": float(f"{seconds.median:.3g}"),
        }


def bar_rows(quick: bool) -> Iterator[Row]:
    """One choice at a time around GIMP, MUSL, 2 particles a cell, CFL 0.5, float32."""
    base: dict[str, Any] = {"particles": 2, "cfl": 0.5, "dtype": "float32"}
    other: list[dict[str, Any]] = [
        {},
        *({"scheme": scheme} for scheme in (mpm.Scheme.USL, mpm.Scheme.USF)),
        *({"kernel": kernel} for kernel in (mpm.Linear, mpm.QuadraticBSpline)),
        {"kernel": mpm.QuadraticBSpline, "apic": True, "flip": 0.0},
        *({"particles": n} for n in (1, 3)),
        *({"cfl": c} for c in (0.1, 0.2, 0.8)),
        {"dtype": "float64"},
    ]
    for cells in (25,) if quick else (12, 25, 50, 100):
        for choice in other:
            found = bar_row(cells, **(base | choice))
            yield found | ({"apic": True} if "apic" in choice else {})


def slope_row(cell: float, spacing: float, setting: str, resolution: float) -> Row:
    """Factor of safety of the published section without random field, and the run-out of its first failing slide."""
    config = scene_config("paper_section")
    soil_choice, choice = SETTINGS[setting]
    start = time.perf_counter()
    soil = replace(config.soil, **soil_choice)
    numerics = replace(config.grids["rough"], cell=cell, spacing=(spacing, spacing), **choice)
    scene, state = mpm.slope(config.slope, soil, numerics)
    found = mpm.factor_of_safety(scene, state, bracket=(0.8, 1.8), resolution=resolution, batch=4)
    slide = mpm.solve(mpm.reduced(scene, found.fails), state, t_end=config.run.t_end, settle=mpm.Settle())
    slide.raise_if_failed()
    seconds = time.perf_counter() - start
    shape = config.slope
    done = consequences(
        np.asarray(scene.particles.position),
        np.asarray(slide.state.displacement),
        np.asarray(scene.particles.volume),
        SlopeGeometry(shape.toe_x, shape.foundation, shape.height),
        half_size=np.asarray(numerics.spacing) / 2,
    )
    return {
        "problem": "slope",
        "setting": setting,
        "cell_m": cell,
        "particles_per_cell": round(cell / spacing),
        "stable_R": found.stable,
        "fails_R": found.fails,
        "runout_m": round(done.runout, 2),
        "seconds": round(seconds, 1),
    }


def draw(rows: list[Row]) -> None:
    """Run-out and factor of safety against cell size, one line a setting; error against seconds of the bar."""
    figure, axes = plt.subplots(1, 3, figsize=(13, 4), layout="constrained")
    for setting, marker in zip(SETTINGS, "os^D", strict=True):
        lines = [r for r in rows if r.get("setting") == setting]
        for ax, key in ((axes[0], "fails_R"), (axes[1], "runout_m")):
            ax.plot([r["cell_m"] for r in lines], [r[key] for r in lines], marker=marker, label=setting)
    axes[1].plot([1, 0.75, 0.5], [14.17, 14.52, 14.76], "k*", label="published")
    axes[0].plot([1, 0.75, 0.5], [1.15] * 3, "k*", label="published")
    axes[0].set(xlabel="cell (m)", ylabel="smallest R that fails")
    axes[1].set(xlabel="cell (m)", ylabel="run-out at that R (m)")
    axes[0].legend()
    for scheme in mpm.Scheme:
        lines = [
            r
            for r in rows
            if (r["problem"], r.get("scheme"), r.get("kernel"), r.get("cfl")) == ("axial bar", scheme.name, "GIMP", 0.5)
            and (r["particles_per_cell"], r["dtype"]) == (2, "float32")
        ]
        axes[2].loglog([r["seconds"] for r in lines], [r["error"] for r in lines], "o-", label=f"GIMP {scheme.name}")
    axes[2].set(xlabel="seconds", ylabel="error of the bar's velocity")
    axes[2].legend()
    figure.savefig(ROOT / "benchmarks" / "figures" / "work_precision.png", dpi=120)
    plt.close(figure)


def run(quick: bool) -> Report:
    """Bar over its choices; the slope over cells and settings, and how far its answers spread from 1 to 0.5 m."""
    rows = list(bar_rows(quick))
    if quick:
        rows += [slope_row(*GRIDS[1], setting, 0.05) for setting in ("plain", BEST_BUY)]
        return Report({}, rows)
    rows += [slope_row(*grid, setting, 0.01) for setting in SETTINGS for grid in GRIDS]
    draw(rows)
    values: dict[str, Any] = {"best_buy": BEST_BUY}
    for key, name in (("fails_R", "fos"), ("runout_m", "runout")):
        fine = [r[key] for r in rows if r.get("setting") == BEST_BUY and r["cell_m"] <= 1.0]
        values[f"slope_{name}_spread_cells_1_to_05"] = round(max(fine) - min(fine), 3)
    return Report(values, rows)
