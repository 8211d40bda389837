"""Slopes with known factors of safety, by the limit load: error against cell and seconds.

Eighteen answers of the literature, by strength reduction where published. Each slope is solved on one or two cells,
with the settings that its soil has by default, volumetric strain averaged over cells. The factor is the kink of
displacement over R (see `jaxmpm.factor_of_safety`). What random soil does to such slopes, Example 2 of Jiang et al.
(2024) among them, is in `random_slopes`.

Special cases have figures of their own, on their finest cell: a weak seam on rock in half a cell and in one, and as the
strength of the base; a weak band that falls with the slope; sand half of whose weight water bears, with 5 % of PIC.

Slopes are solved side by side, one to a core, so seconds are those of a core with the others busy. Rows that have ended
stand in out/stability_of_slopes, and a command that was stopped goes on behind them.
"""

from __future__ import annotations

import time
from concurrent.futures import Future
from functools import partial
from pathlib import Path
from typing import Any

import jaxmpm as mpm
from benchmarks.measure import ROOT, Report, code_digest, stored_row
from benchmarks.sites.slopes import Case, cases, special_cases
from benchmarks.speed.leave_out import microseconds
from cooperative.runs import cores_to_use, process_pool

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


def row(case: Case, cell: float, **choices: Any) -> dict[str, Any]:
    """The factor of one slope on cells of this size (m), beside its reference."""
    start = time.perf_counter()
    scene, state = case.built(cell, **choices)
    bracket = (0.8 * case.reference, case.highest * case.reference)
    answer = mpm.factor_of_safety(scene, state, criterion="limit load", bracket=bracket, resolution=0.02, batch=6)
    assert answer.kink is not None
    return {
        "case": case.name,
        "cell_m": round(cell, 4),
        "particles": scene.particles.mass.size,
        "reference": case.reference,
        "fos": round(answer.kink, 3),
        "error": round(answer.kink / case.reference - 1, 4),
        "stands_at": answer.stable,
        "moves_on_at": answer.fails,
        "sharpness": answer.sharpness,
        "seconds": round(time.perf_counter() - start, 1),
        "source": case.source,
    }


def cured(case: Case, cell: float, cure: str) -> dict[str, Any]:
    """One slope with one of the cures."""
    return {"cure": cure, **row(case, cell, **CURES[cure])}


def costs(case: Case, cell: float) -> dict[str, Any]:
    """Microseconds per step of a lane with each cure, taken in turn."""
    steps = microseconds([case.built(cell, **choices) for choices in CURES.values()], repeats=5)
    return {cure: round(us, 1) for cure, us in zip(CURES, steps, strict=True)}


def run(quick: bool) -> Report:
    """All slopes on their cells, and two of them with every cure on the coarse ones; `quick` takes those alone, without
    cures."""
    known = [*cases(), *special_cases()]
    folder = ROOT / "out" / "stability_of_slopes" / code_digest((Path(__file__).parent / "slopes.py").read_text())
    locked = [(case, case.cells[0]) for case in known if case.name in LOCKED and not quick]
    with process_pool(len(cores_to_use())) as pool:

        def begun(what: str, make: Any, case: Case, *given: Any) -> Future[dict[str, Any]]:
            name = " ".join([what, case.name.replace("/", " of "), *map(str, given)])
            return pool.submit(stored_row, folder, name, partial(make, case, *given))

        # What takes longest begins first.
        ours = {
            (case.name, cell): begun("slope", row, case, cell) for case in known for cell in _finest_first(case, quick)
        }
        cost = [begun("steps", costs, case, cell) for case, cell in locked]
        treated = [[begun("cure", cured, case, cell, cure) for cure in CURES] for case, cell in locked]
        rows = [ours[case.name, cell].result() for case in known for cell in reversed(_finest_first(case, quick))]
        for runs, steps in zip(treated, cost, strict=True):
            rows += [one.result() | {"us_per_step": steps.result()[one.result()["cure"]]} for one in runs]
    figures = {case.name: case.figure for case in known if case.figure}
    usual = [one for one in rows if "cure" not in one and one["case"] not in figures]
    return Report(summarised(usual) | special(rows, figures), rows)


def _finest_first(case: Case, quick: bool) -> list[float]:
    return sorted(case.cells[:1] if quick else case.cells)


def special(rows: list[dict[str, Any]], figures: dict[str, str]) -> dict[str, Any]:
    """The error of each special case, named by its figure, on its finest cell."""
    return {figures[one["case"]]: one["error"] for one in rows if one["case"] in figures}


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
