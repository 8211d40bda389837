"""Slopes with known factors of safety, by the limit load: error against cell and seconds.

Eighteen answers of the literature, by strength reduction where published. Each slope is solved on two cells, with the
settings that its soil has by default: clay with F-bar, soil with friction with its volumetric strain averaged over
cells. The factor is the kink of displacement over R (see `jaxmpm.factor_of_safety`).
"""

from __future__ import annotations

import time
from typing import Any

import jaxmpm as mpm
from benchmarks.leave_out import microseconds
from benchmarks.measure import Report
from benchmarks.slopes import Case, cases

CURES: dict[str, dict[str, Any]] = {
    "none": {"cell_average": False},
    "volumetric strain averaged over cells": {},
    "one particle a cell": {"cell_average": False, "across": 1},
    "B-splines": {"cell_average": False, "kernel": mpm.QuadraticBSpline},
    "B-splines, averaged over cells": {"kernel": mpm.QuadraticBSpline},
}
"""Settings against the locking of soil with friction. One particle a cell is the same with B-splines as with GIMP."""

LOCKED = ("ACADS 1a", "Griffiths and Lane 1")
"""Slopes that the cures are held against."""

AROUND = (0.8, 1.25)
"""Bracket of the search, over the reference."""


def row(case: Case, cell: float, **choices: Any) -> dict[str, Any]:
    """The factor of one slope on cells of this size (m), beside its reference."""
    start = time.perf_counter()
    scene, state = case.built(cell, **choices)
    bracket = (AROUND[0] * case.reference, AROUND[1] * case.reference)
    found = mpm.factor_of_safety(scene, state, criterion="limit load", bracket=bracket, resolution=0.02, batch=6)
    assert found.kink is not None
    return {
        "case": case.name,
        "cell_m": round(cell, 4),
        "particles": scene.particles.mass.size,
        "reference": case.reference,
        "fos": round(found.kink, 3),
        "error": round(found.kink / case.reference - 1, 4),
        "stands_at": found.stable,
        "moves_on_at": found.fails,
        "sharpness": found.sharpness,
        "seconds": round(time.perf_counter() - start, 1),
        "source": case.source,
    }


def cures(case: Case, cell: float) -> list[dict[str, Any]]:
    """One slope with every cure, and microseconds per step of a lane of each, taken in turn."""
    steps = microseconds([case.built(cell, **choices) for choices in CURES.values()], repeats=5)
    return [
        {"cure": cure, **row(case, cell, **choices), "us_per_step": round(us, 1)}
        for (cure, choices), us in zip(CURES.items(), steps, strict=True)
    ]


def run(quick: bool) -> Report:
    """All slopes on both of their cells, and two of them with every cure; `quick` takes the coarse cells, no cures."""
    known = cases()
    rows = [row(case, cell) for case in known for cell in (case.cells[:1] if quick else case.cells)]
    values = summarised(rows)
    locked = [] if quick else [case for case in known if case.name in LOCKED]
    return Report(values, rows + [one for case in locked for cell in case.cells for one in cures(case, cell)])


def summarised(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """The named figures: errors on the finest cell of each slope, and on its coarsest."""
    finest = {one["case"]: one for one in rows}
    coarsest = {one["case"]: one for one in reversed(rows)}
    return {
        "fos_error_max": max(abs(one["error"]) for one in finest.values()),
        "fos_error_max_coarse": max(abs(one["error"]) for one in coarsest.values()),
        "fos_cases": len(finest),
        "fos_cases_within_4_percent": sum(abs(one["error"]) <= 0.04 for one in finest.values()),
        "fos_seconds": round(sum(one["seconds"] for one in rows), 1),
    }
