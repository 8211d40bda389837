"""Cases of the published study: each a scene of benchmarks/scenes with changes, and the plan of its campaign."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from typing import Any

from benchmarks.measure import ROOT
from cooperative.estimate import AuditPlan
from cooperative.scene import Campaign, parse, to_toml

Changes = Mapping[str, Mapping[str, Any]]

SAMPLES = 750
"""Random slopes of the headline campaign; the publication ran 1000."""
SWEEP_SAMPLES = 200
"""Random slopes at each correlation length, the same ones at all of them."""
SECTION_SAMPLES = 400
LENGTHS = (10, 30, 60, 120)
"""Horizontal correlation lengths (m) of the sweep, one axis at a time, the other at 60 m."""
CELLS = (1.0, 0.75, 0.5)
"""Of Table 3 (m)."""
FAILS_ABOVE = 1.0
"""Displacement from which on a slope fails, as published (m)."""
AUDIT = AuditPlan(runs=100, seed=2024)
SWEEP_AUDIT = AuditPlan(runs=24, seed=2024)
K_T = SAMPLES // 50
"""Standing samples in a row at which the published rule ends: 2 per cent of the samples, of 1 to 10 published."""

ON_CPU = "published, on a CPU"
"""The first samples of the headline campaign once more on a CPU: what they cost there, and whether both agree."""
MORE_AIR = "published, more air"
"""The headline campaign on a higher refined grid, for slides whose soil is thrown out of the other."""

EVEN = {"strength": {"cov": 0.0}}
ROLLERS = {"slope": {"y_ends": "roller"}}
FAST = {"rough": {"cfl": 0.9}, "refined": {"cfl": 0.9}}
"""Time steps of 0.9 of the limit: on the section no class changes (reading "CFL 0.9")."""

READINGS: dict[str, Changes] = {
    "as here": {},
    "one strength per cell": {"strength": {"sampled_at": "cells"}},
    "equivalent plastic strain": {"soil": {"plastic_strain": "equivalent"}},
    "published time step": {"rough": {"cfl": 0.111}, "refined": {"cfl": 0.222}},
    "CFL 0.9": FAST,
    "one particle a cell": {"rough": {"spacing": [2.0, 2.0]}, "refined": {"spacing": [1.0, 1.0]}},
    "stress first (USF)": {"rough": {"scheme": "usf"}, "refined": {"scheme": "usf"}},
    "stress last (USL)": {"rough": {"scheme": "usl"}, "refined": {"scheme": "usl"}},
    "F-bar": {"rough": {"fbar": True}, "refined": {"fbar": True}},
}
"""What the publication leaves open, each as a change of the section; F-bar and one particle show what locking costs."""


def _case(scene: str, samples: int | None, *changes: Changes) -> dict[str, Any]:
    plan = {} if samples is None else {"campaign": {"samples": samples}}
    tables: dict[str, dict[str, Any]] = {}
    for change in (plan, *changes):
        for table, keys in change.items():
            tables[table] = {**tables.get(table, {}), **keys}
    return {"scene": scene, "changes": tables}


def of_cell(case: str, cell: float) -> str:
    """Name of a case without random field whose refined grid has these cells (m)."""
    return case if cell == 1 else f"{case}, cells of {cell:g} m"


def _cells(case: str, scene: str, cells: tuple[float, ...], dimension: int) -> dict[str, dict[str, Any]]:
    grids = {cell: {"refined": {"cell": cell, "spacing": [0.25] * dimension}} if cell != 1 else {} for cell in cells}
    return {of_cell(case, cell): _case(scene, None, EVEN, grid) for cell, grid in grids.items()}


def sweep_case(axis: str, length: float) -> str:
    """Name of the case with this horizontal correlation length (m) along "lx" or "ly"."""
    return "lx = ly = 60" if length == 60 else f"{axis} = {length:g}"


SWEEP = {sweep_case("lx", length): [float(length), 60.0, 2.0] for length in LENGTHS}
SWEEP |= {sweep_case("ly", length): [60.0, float(length), 2.0] for length in LENGTHS}
"""Correlation lengths (m) of each case of the sweep."""

CASES: dict[str, dict[str, Any]] = {
    **_cells("mean strength", "paper", CELLS[:2], 3),
    "mean strength, rollers": _case("paper", None, EVEN, ROLLERS),
    "mean strength, default": _case("slope", None, EVEN),
    "mean strength, default, rollers": _case("slope", None, EVEN, ROLLERS),
    **_cells("section of mean strength", "paper_section", CELLS, 2),
    **_cells("section of mean strength, default", "section", CELLS, 2),
    "published": _case("paper", SAMPLES, FAST),
    ON_CPU: _case("paper", SAMPLES, FAST),
    MORE_AIR: _case("paper", SAMPLES, FAST, {"refined": {"air": 8.0}}),
    "default": _case("slope", SAMPLES),
    "rollers": _case("paper", SAMPLES, FAST, ROLLERS),
    **{name: _case("paper", SWEEP_SAMPLES, FAST, {"strength": {"length": to}}) for name, to in SWEEP.items()},
    **{f"section, {name}": _case("paper_section", SECTION_SAMPLES, change) for name, change in READINGS.items()},
    "section, default": _case("section", SECTION_SAMPLES),
}
"""Scene and changes by name. The rows in benchmarks/data rest on them: a changed case gets another name."""


def plan_of(case: str) -> dict[str, Any]:
    """What the campaign of a case adds to `[campaign]`; empty for a case without a random field."""
    if "mean strength" in case:
        return {}
    if case.startswith("section, "):
        return {"estimator": "monte carlo", "slides": 0}
    if case in SWEEP:
        return {"refined_runs": SWEEP_AUDIT.runs, "calibrate": True, "modes": "both"}
    if case in ("default", "rollers"):
        return {"samples": SWEEP_SAMPLES, "refined_runs": SWEEP_AUDIT.runs, "slides": 0}
    return {"refined_runs": AUDIT.runs}


PUBLISHED: Changes = {"rough": {"cfl": 0.5}, "refined": {"cfl": 0.5}, "soil": {"gap_memory": False}}
"""Settings of the rows with published settings, where the scene leaves them out."""


def campaign_of(scene: str, changes: Changes) -> Campaign:
    """A scene of benchmarks/scenes, changed; published settings where it has those."""
    tables = tomllib.loads((ROOT / "benchmarks" / "scenes" / f"{scene}.toml").read_text())
    for table, keys in changes.items():
        tables[table] |= keys
    for table, keys in (PUBLISHED if scene.startswith("paper") else {}).items():
        tables[table] = {**keys, **tables[table]}
    return parse(to_toml(tables))
