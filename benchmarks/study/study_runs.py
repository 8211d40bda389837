"""The cases of the study and how one run of them is done."""

from __future__ import annotations

import time
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import islice, takewhile
from typing import Any

import jax
import numpy as np

from benchmarks.measure import ROOT
from benchmarks.study.study_table import CPU, Outcome, Run, Until
from cooperative.runs import GridModel, build, coefficients_of, random_soil, run_samples
from cooperative.scene import Campaign, parse, to_toml
from cooperative.store import Sample

Changes = Mapping[str, Mapping[str, Any]]

SAMPLES = 750
"""Random slopes of the headline campaign; the publication ran 1000."""
SWEEP_SAMPLES = 200
"""Random slopes at each correlation length, the same ones at all of them."""
SECTION_SAMPLES = 400
LENGTHS = (10, 30, 60, 120)
"""Horizontal correlation lengths (m) of the sweep, one axis at a time, the other at 60 m."""

ON_CPU = "published, on a CPU"
"""The first samples of the headline campaign once more on a CPU: what they cost there, and whether both agree."""

MORE_AIR = "published, more air"
"""The headline campaign's slopes on a refined grid that is higher, for slides whose soil is thrown out of the other."""

EVEN = {"strength": {"cov": 0.0}}
ROLLERS = {"slope": {"y_ends": "roller"}}
FAST = {"rough": {"cfl": 0.9}, "refined": {"cfl": 0.9}}
"""Time steps of 0.9 of the limit: on the section no class changes (reading "CFL 0.9")."""


def _both(key: str, value: Any) -> Changes:
    return {"rough": {key: value}, "refined": {key: value}}


READINGS: dict[str, Changes] = {
    "as here": {},
    "one strength per cell": {"strength": {"sampled_at": "cells"}},
    "equivalent plastic strain": {"soil": {"plastic_strain": "equivalent"}},
    "published time step": {"rough": {"cfl": 0.111}, "refined": {"cfl": 0.222}},
    "CFL 0.9": FAST,
    "one particle a cell": {"rough": {"spacing": [2.0, 2.0]}, "refined": {"spacing": [1.0, 1.0]}},
    "stress first (USF)": _both("scheme", "usf"),
    "stress last (USL)": _both("scheme", "usl"),
    "F-bar": _both("fbar", True),
}
"""What the publication leaves open, each as a change of the section; F-bar and one particle show what locking costs."""


def _case(scene: str, samples: int | None, *changes: Changes) -> dict[str, Any]:
    plan = {} if samples is None else {"campaign": {"samples": samples}}
    tables: dict[str, dict[str, Any]] = {}
    for change in (plan, *changes):
        for table, keys in change.items():
            tables[table] = {**tables.get(table, {}), **keys}
    return {"scene": scene, "changes": tables}


def sweep_case(axis: str, length: float) -> str:
    """Name of the case with this horizontal correlation length (m) along "lx" or "ly"."""
    return "lx = ly = 60" if length == 60 else f"{axis} = {length:g}"


def _sweep_cases() -> dict[str, dict[str, Any]]:
    lengths = {sweep_case("lx", lx): [float(lx), 60.0, 2.0] for lx in LENGTHS}
    lengths |= {sweep_case("ly", ly): [60.0, float(ly), 2.0] for ly in LENGTHS}
    return {name: _case("paper", SWEEP_SAMPLES, FAST, {"strength": {"length": to}}) for name, to in lengths.items()}


def _cell(cell: float, spacing: float, dimension: int) -> Changes:
    return {"refined": {"cell": cell, "spacing": [spacing] * dimension}}


CASES: dict[str, dict[str, Any]] = {
    "mean strength": _case("paper", None, EVEN),
    "mean strength, rollers": _case("paper", None, EVEN, ROLLERS),
    "mean strength, default": _case("slope", None, EVEN),
    "mean strength, default, rollers": _case("slope", None, EVEN, ROLLERS),
    "mean strength, cells of 0.75 m": _case("paper", None, EVEN, _cell(0.75, 0.25, 3)),
    **{
        f"section of mean strength{setting}{words}": _case(scene, None, EVEN, change)
        for setting, scene in (("", "paper_section"), (", default", "section"))
        for words, change in (
            ("", {}),
            (", cells of 0.75 m", _cell(0.75, 0.25, 2)),
            (", cells of 0.5 m", _cell(0.5, 0.25, 2)),
        )
    },
    "published": _case("paper", SAMPLES, FAST),
    ON_CPU: _case("paper", SAMPLES, FAST),
    MORE_AIR: _case("paper", SAMPLES, FAST, {"refined": {"air": 8.0}}),
    "default": _case("slope", SAMPLES, FAST),
    "rollers": _case("paper", SAMPLES, FAST, ROLLERS),
    **_sweep_cases(),
    **{f"section, {name}": _case("paper_section", SECTION_SAMPLES, change) for name, change in READINGS.items()},
    "section, default": _case("section", SECTION_SAMPLES),
}
"""Scene of `benchmarks/scenes` and what is changed in it, by name. A case that rows rest on is never changed: another
one gets another name."""


SLIDE = (
    *("runout", "depth", "volume", "area", "mode", "masses", "onset", "onset_second"),
    *("displacement_any", "runout_any"),
)
"""What is kept of a slide."""


def campaign_of(case: str) -> Campaign:
    """The scene of a case. ValueError for a case that is none."""
    if case not in CASES:
        raise ValueError(f"case {case!r}: give one of {', '.join(CASES)}")
    return campaign_with(CASES[case]["scene"], CASES[case]["changes"])


def campaign_with(scene: str, changes: Changes) -> Campaign:
    """A scene that stands in benchmarks/scenes, changed, and as it was by default when the first rows were made."""
    tables = tomllib.loads((ROOT / "benchmarks" / "scenes" / f"{scene}.toml").read_text())
    for table, keys in changes.items():
        tables[table] |= keys
    # Rows rest on cases that do not say these, from when they were the defaults.
    for grid in ("rough", "refined"):
        tables[grid].setdefault("cfl", 0.5)
    tables["soil"].setdefault("gap_memory", False)
    return parse(to_toml(tables))


@lru_cache(maxsize=3)
def prepared(case: str, grid: str) -> tuple[GridModel, np.ndarray]:
    """The model of a grid of a case, and the coefficients of its samples (samples, modes)."""
    campaign = campaign_of(case)
    soil = random_soil(campaign)
    return build(campaign, grid, soil), coefficients_of(campaign, soil)


def alike(runs: Iterable[Run], most: int) -> tuple[Run, ...]:
    """The first of the runs and those behind it, at most so many in all, that differ from it in their sample alone."""
    runs = iter(runs)
    first = next(runs, None)
    if first is None:
        return ()
    return (first, *islice(takewhile(lambda run: replace(run, sample=first.sample) == first, runs), most - 1))


def carry_out(runs: Sequence[Run], lanes: int = 1) -> list[Outcome]:
    """Do runs that are alike, so many side by side. A run that breaks off says so in its status."""
    run = runs[0]
    model, coefficients = prepared(run.case, run.grid)
    campaign = model.campaign
    plan = replace(campaign.plan, fields=(), modes=("rough", "refined") if run.until == "end" else ())
    model = replace(model, campaign=replace(campaign, plan=plan), strength_factor=1 / run.reduction)
    stop_at = campaign.run.failure_displacement if run.until == "class" else None
    clock = time.process_time if jax.default_backend() == CPU else time.perf_counter
    before = clock()
    numbers = [each.sample for each in runs]
    done = {
        sample.number: sample
        for sample in run_samples(model, coefficients, numbers, width=min(lanes, len(runs)), stop_at=stop_at)
    }
    a_step = (clock() - before) / max(1, sum(sample.steps for sample in done.values()))
    return [_outcome(done[number], model, run.until, a_step) for number in numbers]


def _outcome(sample: Sample, model: GridModel, until: Until, a_step: float) -> Outcome:
    """A run that has ended, of so many seconds a step."""
    row = sample.row
    displacement = float(row["displacement"])
    slid = until == "end" and not row["broke_off"] and displacement > model.campaign.run.failure_displacement
    kept = SLIDE if slid else ()
    return Outcome(
        status=sample.status,
        displacement=displacement,
        time=sample.steps * float(jax.device_get(model.scene.time_step)),
        steps=sample.steps,
        seconds=sample.steps * a_step,
        device=sample.device,
        **{name: row.get(name) for name in kept},  # type: ignore[arg-type]
    )
