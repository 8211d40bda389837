"""Slopes with known factors of safety, by the limit load: error against cell and seconds.

Eighteen answers of the literature, by strength reduction where published. Each slope is solved on two cells, with the
settings that its soil has by default: clay with F-bar, soil with friction with its volumetric strain averaged over
cells. The factor is the kink of displacement over R (see `jaxmpm.factor_of_safety`).
"""

from __future__ import annotations

import time
from typing import Any

import jaxmpm as mpm
from benchmarks.measure import Report
from benchmarks.slopes import Case, cases

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


def run(quick: bool) -> Report:
    """All slopes on both of their cells; `quick` takes the coarse ones."""
    rows = [row(case, cell) for case in cases() for cell in (case.cells[:1] if quick else case.cells)]
    return Report(summarised(rows), rows)


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
