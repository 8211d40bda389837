"""Slopes with known factors of safety, by the limit load: error against cell and seconds.

Twenty-six answers of the literature, by strength reduction where published. Each slope is solved on one or two cells,
with the settings that its soil has by default, volumetric strain averaged over cells. The factor is the kink of
displacement over R (see `jaxmpm.factor_of_safety`). What random soil does to such slopes, Example 2 of Jiang et al.
(2024) among them, is in `random_slopes`.

Special cases have figures of their own, on their finest cell: a weak seam on rock in half a cell and in one, and as the
strength of the base; a weak band that falls with the slope; sand half of whose weight water bears, with 5 % of PIC.

Three slopes have soil of 200, 1000 and 3000 times its strength in the middle of the slope as Young's modulus, on their
coarse cells, and the middle one besides at a quarter and at four times the stiffness at which a limit load is sought.
`fos_spread_young` and `fos_spread_reference` are the largest factor over the smallest, less 1.

Slopes are solved side by side, one to a core, so seconds are those of a core with the others busy. Rows that have ended
stand in out/stability_of_slopes, and a command that was stopped goes on behind them.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from concurrent.futures import Future
from dataclasses import replace
from functools import partial
from typing import Any

import jaxmpm as mpm
from benchmarks.measure import ROOT, Report, code_digest, sources, stored_row
from benchmarks.sites.slopes import Case, cases, special_cases
from benchmarks.speed.leave_out import microseconds
from cooperative.runs import cores_to_use, process_pool
from jaxmpm.run._limit_load import YOUNG
from jaxmpm.run._strength_reduction import by_limit_load

CURES: dict[str, dict[str, Any]] = {
    "none": {"cell_average": False},
    "volumetric strain averaged over cells": {},
    "one particle a cell": {"cell_average": False, "across": 1},
    "B-splines": {"cell_average": False, "kernel": mpm.QuadraticBSpline},
    "B-splines, averaged over cells": {"kernel": mpm.QuadraticBSpline},
}
"""Settings against the locking of soil with friction. One particle a cell is the same with B-splines as with GIMP."""

STIFF = {"Griffiths and Lane 4, ratio 1": 74813.0, "Published section": 42e3, "Griffiths and Lane 1": 42.2e3}
"""Slopes of several stiffnesses, and their strength (Pa), of soil with friction that under half the height."""

OVER_STRENGTH, OVER_REFERENCE = (200, 1000, 3000), (0.25, 4.0)
"""Young's moduli over that strength, and stiffnesses over that at which a limit load is sought."""

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


def of_stiffness(case: Case, cell: float, ratio: float, reference: float) -> dict[str, Any]:
    """The factor of one slope whose soil has a Young's modulus of `ratio` times its strength, at `reference` times the
    usual stiffness of a limit load."""
    start = time.perf_counter()
    young = ratio * STIFF[case.name]
    layers = case.soil if isinstance(case.soil, Sequence) else [mpm.Layer(case.soil)]
    soil = [replace(layer, soil=replace(layer.soil, young=young)) for layer in layers]
    scene, state = replace(case, soil=soil).built(cell)
    bracket = (0.8 * case.reference, case.highest * case.reference)
    answer = by_limit_load(
        scene, state, bracket=bracket, resolution=0.01, t_end=20.0, batch=6, young=reference * YOUNG
    )  # fmt: skip
    assert answer.kink is not None
    return {
        "slope": case.name,
        "cell_m": round(cell, 4),
        "young_over_strength": ratio,
        "stiffness_over_reference": reference,
        "fos": round(answer.kink, 4),
        "stands_at": answer.stable,
        "moves_on_at": answer.fails,
        "sharpness": answer.sharpness,
        "seconds": round(time.perf_counter() - start, 1),
    }


def spreads(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Largest spread of the factor of a slope over Young's moduli, and over stiffnesses of the limit load."""

    def largest(rows: list[dict[str, Any]]) -> float | None:
        factors: dict[str, list[float]] = {}
        for one in rows:
            factors.setdefault(one["slope"], []).append(one["fos"])
        return max((round(max(of_slope) / min(of_slope) - 1, 4) for of_slope in factors.values()), default=None)

    usual = [one for one in rows if one["stiffness_over_reference"] == 1]
    return {
        "fos_spread_young": largest(usual),
        "fos_spread_reference": largest([one for one in rows if one["young_over_strength"] == OVER_STRENGTH[1]]),
    }


def costs(case: Case, cell: float) -> dict[str, Any]:
    """Microseconds per step of a lane with each cure, taken in turn."""
    steps = microseconds([case.built(cell, **choices) for choices in CURES.values()], repeats=5)
    return {cure: round(us, 1) for cure, us in zip(CURES, steps, strict=True)}


def run(quick: bool) -> Report:
    """All slopes on their cells, and two of them with every cure on the coarse ones; `quick` takes those alone, without
    cures."""
    all_cases = [*cases(), *special_cases()]
    folder = ROOT / "out" / "stability_of_slopes" / code_digest(*sources(run, cases))
    locked = [(case, case.cells[0]) for case in all_cases if case.name in LOCKED and not quick]
    with process_pool(len(cores_to_use())) as pool:

        def submit(what: str, make: Any, case: Case, *arguments: Any) -> Future[dict[str, Any]]:
            name = " ".join([what, case.name.replace("/", " of "), *map(str, arguments)])
            return pool.submit(stored_row, folder, name, partial(make, case, *arguments))

        # What takes longest begins first.
        ours = {
            (case.name, cell): submit("slope", row, case, cell)
            for case in all_cases
            for cell in _finest_first(case, quick)
        }
        cost = [submit("steps", costs, case, cell) for case, cell in locked]
        treated = [[submit("cure", cured, case, cell, cure) for cure in CURES] for case, cell in locked]
        stiff = [
            submit("stiffness", of_stiffness, case, case.cells[0], ratio, reference)
            for case in all_cases
            if case.name in STIFF and not quick
            for ratio, reference in [
                *((r, 1.0) for r in OVER_STRENGTH),
                *((OVER_STRENGTH[1], f) for f in OVER_REFERENCE),
            ]
        ]
        rows = [ours[case.name, cell].result() for case in all_cases for cell in reversed(_finest_first(case, quick))]
        for runs, steps in zip(treated, cost, strict=True):
            rows += [one.result() | {"us_per_step": steps.result()[one.result()["cure"]]} for one in runs]
    figures = {case.name: case.figure for case in all_cases if case.figure}
    usual = [one for one in rows if "cure" not in one and one["case"] not in figures]
    stiffnesses = [one.result() for one in stiff]
    return Report(summarised(usual) | special(rows, figures) | spreads(stiffnesses), rows + stiffnesses)


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
