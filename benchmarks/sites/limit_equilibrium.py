"""Slopes with known factors of safety by limit equilibrium, as a comparator of the solver, with `xslope` as its peer.

The section, layers, loads and water of each slope of `benchmarks.sites.slopes` are those of the solver. The search is
that of `jaxmpm fos`: circles all over the section, then surfaces of other shapes, along weak bands too; in clay without
friction, circles alone. References are by strength reduction where published, so that the error is the difference of
two methods. `peer` is the factor that xslope gives the same surface, from what stands in
benchmarks/data/limit_equilibrium. Sources: Spencer (1967), 10.1680/geot.1967.17.1.11, and for clay Bishop (1955),
10.1680/geot.1955.5.1.7."""

from __future__ import annotations

import json
import statistics
import time
from collections.abc import Sequence
from typing import Any

from benchmarks.measure import ROOT, Report
from benchmarks.sites import by_xslope
from benchmarks.sites.slopes import FAMILIES, Case, cases
from cooperative.store import write_aside
from cooperative.tools import safety
from jaxmpm import Layer

INPUTS = ROOT / "benchmarks" / "data" / "limit_equilibrium"


def layers_of(case: Case) -> list[Layer]:
    """From the top down."""
    return list(case.soil) if isinstance(case.soil, Sequence) else [Layer(case.soil)]


def factors(case: Case) -> dict[str, Any]:
    """The slope's factors of safety: of the critical circle, and of the critical slip surface of any shape."""
    start = time.process_time()
    answer = safety.critical_surface(safety.Slices.of(case.shape, layers_of(case), **case.loads))
    seconds = time.process_time() - start
    slip, circle = answer.slip, answer.circle
    surface = slip.points if slip.circle is None else slip.circle
    peer = by_xslope.factor(by_xslope.inputs(case.shape, layers_of(case), **case.loads), surface, slip.method)
    return {
        "case": case.name,
        "reference": case.reference,
        "circle": None if circle is None else round(circle.factor, 3),
        "any_shape": "none less" if answer.slip is answer.circle else round(answer.slip.factor, 3),
        "fos": round(answer.slip.factor, 3),
        "error": round(answer.slip.factor / case.reference - 1, 4),
        "method": answer.slip.method,
        "deep_m": round(slip.thickness, 2),
        "area_m2": round(slip.area, 1),
        "peer": None if peer is None else round(peer, 3),
        "surfaces": answer.surfaces,
        "cpu_s": round(seconds, 2),
    }


def write_inputs(selected: Sequence[Case]) -> None:
    """Write what xslope is given of each slope into benchmarks/data/limit_equilibrium."""
    INPUTS.mkdir(exist_ok=True)
    for case in selected:
        text = (
            json.dumps(
                by_xslope.inputs(case.shape, layers_of(case), **case.loads), default=lambda shape: shape.wkt, indent=1
            )
            + "\n"
        )
        write_aside(INPUTS / f"{case.name.replace('/', ' of ')}.json", text.encode())


def run(quick: bool) -> Report:
    """All slopes; `quick` takes the first. Raises ValueError without xslope."""
    by_xslope.module("slice")
    selected = FAMILIES[0]()[:1] if quick else cases()
    rows = [factors(case) for case in selected]
    return Report(
        {
            "lem_cases": len(rows),
            "lem_error_max": max(abs(row["error"]) for row in rows),
            "lem_cases_within_4_percent": sum(abs(row["error"]) <= 0.04 for row in rows),
            "lem_circle_error_max": round(
                max(abs(row["circle"] / row["reference"] - 1) for row in rows if row["circle"]), 4
            ),
            "lem_peer_difference_max": round(max(abs(row["fos"] / row["peer"] - 1) for row in rows if row["peer"]), 4),
            "lem_cpu_s_max": max(row["cpu_s"] for row in rows),
            "lem_cpu_s_median": statistics.median(row["cpu_s"] for row in rows),
        },
        rows,
        lambda _: write_inputs(selected),
    )
