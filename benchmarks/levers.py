"""What one particle a cell instead of four, and CFL 0.9 instead of 0.5, do to classes, ranks, run-outs and cost.

Told from benchmarks/data/levers.csv, which `python -m benchmarks.levers_runs` makes. Everything is beside four
particles a cell at CFL 0.5 on the same grid with the same samples. The cost is steps times particles, so that it does
not depend on what else the machine did.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.stats import spearmanr

from benchmarks.levers_runs import MEASURED, SPACINGS, Variant, read, variants
from benchmarks.measure import Report


def beside(variant: Variant) -> Variant:
    """The published variant that one is held against."""
    scene, grid, *_ = variant
    return scene, grid, SPACINGS[grid][0], 0.5


def row(variant: Variant, found: dict[Variant, dict[int, dict[str, float]]], limit: float = 1.0) -> dict[str, Any]:
    """One variant beside the published one, over the samples that both have."""
    scene, grid, spacing, cfl = variant
    plain = beside(variant)
    both = sorted(found[variant].keys() & found[plain].keys())
    mine, base = ({name: np.array([found[of][n][name] for n in both]) for name in MEASURED} for of in (variant, plain))
    fails = (mine["displacement"] > limit, base["displacement"] > limit)
    slide = fails[0] & fails[1]
    change = {name: (mine[name] - base[name])[slide] for name in ("displacement", "runout")}
    share = (SPACINGS[grid][0] / spacing) ** 2
    return {
        "scene": scene, "grid": grid, "particles_a_cell": round(4 * share), "cfl": cfl, "samples": len(both),
        "fail": int(fails[0].sum()), "classes_changed": int((fails[0] != fails[1]).sum()),
        "spearman": round(float(spearmanr(mine["displacement"], base["displacement"]).statistic), 4),
        **{f"median_change_{name}_m": round(float(np.median(moved)), 3) for name, moved in change.items()},
        **{f"largest_change_{name}_m": round(float(np.abs(moved).max()), 3) for name, moved in change.items()},
        "runs_that_gain_energy": int((mine["energy"] > 0).sum()),
        "cost_share": round(float(mine["steps"].sum() * share / base["steps"].sum()), 3),
    }  # fmt: skip


def run(quick: bool) -> Report:
    """The table; `quick` makes no difference, since nothing is run."""
    found = read()
    rows = [row(variant, found) for variant in variants() if {variant, beside(variant)} <= found.keys()]
    faster = [one for one in rows if one["cfl"] == 0.9 and one["particles_a_cell"] == 4]
    single = [one for one in rows if one["particles_a_cell"] == 1]
    return Report(
        {
            "classes_changed_cfl": sum(one["classes_changed"] for one in faster),
            "spearman_cfl": min(one["spearman"] for one in faster),
            "cost_share_cfl": max(one["cost_share"] for one in faster),
            "classes_changed_one_particle": sum(one["classes_changed"] for one in single),
        },
        rows,
    )
