"""What one particle a cell instead of four, and CFL 0.9 instead of 0.5, do to classes, ranks, run-outs and cost.

Told from benchmarks/data/levers.csv, which `python -m benchmarks.settings.levers_runs` makes. Everything is beside four
particles a cell at CFL 0.5 on the same grid with the same samples. The cost is steps times particles, so that it does
not depend on what else the machine did.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.stats import spearmanr

from benchmarks.csv_rows import Row
from benchmarks.measure import Report
from benchmarks.settings.levers_runs import MEASURED, SPACINGS, Variant, read, variants
from jaxmpm import Status

LIMIT = 1.0
"""Displacement (m) from which on a slope has failed, as published."""
END = 20.0
"""Of a run (s)."""


def beside(variant: Variant) -> Variant:
    """The published variant that one is held against."""
    scene, grid, _, _, until = variant
    return scene, grid, SPACINGS[grid][0], 0.5, until


def row(variant: Variant, result: dict[Variant, dict[int, Row]]) -> dict[str, Any]:
    """One variant beside the published one, over the samples that both have."""
    scene, grid, spacing, cfl, until = variant
    plain = beside(variant)
    both = sorted(result[variant].keys() & result[plain].keys())
    measured, base = (
        {name: np.array([result[of][n][name] for n in both]) for name in MEASURED} for of in (variant, plain)
    )
    fails = (measured["displacement"] > LIMIT, base["displacement"] > LIMIT)
    share = (SPACINGS[grid][0] / spacing) ** 2
    values = {
        "scene": scene, "grid": grid, "until": until, "particles_a_cell": round(4 * share), "cfl": cfl,
        "samples": len(both), "fail": int(fails[0].sum()), "classes_changed": int((fails[0] != fails[1]).sum()),
        "spearman": round(float(spearmanr(rank_by(measured), rank_by(base)).statistic), 4),
        "broke_off": int((measured["status"] > Status.DECIDED).sum()),
        "runs_that_gain_energy": int((measured["energy"] > 0).sum()),
        "cost_share": round(float(measured["steps"].sum() * share / base["steps"].sum()), 3),
    }  # fmt: skip
    if until == "class":
        return values
    slide = fails[0] & fails[1]
    lengths = ("displacement", "runout", "runout_foremost")
    change = {name: (measured[name] - base[name])[slide] for name in lengths}
    values |= {
        f"median_change_{name}_m": round(float(np.median(displacement)), 3) for name, displacement in change.items()
    }
    return values | {
        f"largest_change_{name}_m": round(float(np.abs(displacement).max()), 3) for name, displacement in change.items()
    }


def rank_by(of: Mapping[str, np.ndarray]) -> np.ndarray:
    """What samples are ranked by (n,) m. Of a run that ended once it had failed: where its mean speed would have
    brought it by the end, so that slopes that fail sooner rank above."""
    decided = of["status"] == Status.DECIDED
    return np.where(decided, of["displacement"] * np.maximum(1.0, END / of["time"]), of["displacement"])


def run(quick: bool) -> Report:
    """The table; `quick` makes no difference, since nothing is run."""
    result = read()
    rows = [row(variant, result) for variant in variants() if {variant, beside(variant)} <= result.keys()]
    rows = [one for one in rows if (one["particles_a_cell"], one["cfl"]) != (4, 0.5)]
    faster = [one for one in rows if one["particles_a_cell"] == 4]
    single = [one for one in rows if one["particles_a_cell"] == 1 and one["cfl"] == 0.5]
    return Report(
        {
            "samples_cfl": sum(one["samples"] for one in faster if one["until"] == "class"),
            "classes_changed_cfl": sum(one["classes_changed"] for one in faster),
            "spearman_cfl": min(one["spearman"] for one in faster),
            "broke_off_cfl": sum(one["broke_off"] for one in faster),
            "runs_that_gain_energy_cfl": sum(one["runs_that_gain_energy"] for one in faster),
            "median_change_runout_cfl_m": max(
                (abs(one["median_change_runout_m"]) for one in faster if one["until"] == "end"), default=None
            ),
            "cost_share_cfl": max(one["cost_share"] for one in faster),
            "classes_changed_one_particle": sum(one["classes_changed"] for one in single),
        },
        rows,
    )
