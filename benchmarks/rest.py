"""What is lost and what is saved by ending a slide once its deposit rests, instead of at 20 s.

`python -m benchmarks.rest` runs what benchmarks/data/rest.csv lacks: the first failures of the section's refined grid,
with published and with default settings, and of the published slope in 3D on its calibrated rough grid, each once with
the rule and once without. `python -m benchmarks rest` tells what the file holds.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.measure import ROOT, Report, scene_campaign
from benchmarks.section_pairs import study
from cooperative import runs
from jaxmpm import Settle

DATA = ROOT / "benchmarks" / "data" / "rest.csv"
LENGTHS = ("displacement", "depth", "runout")
"""Measures in metres."""
AMOUNTS = ("volume", "area")
MEASURED = ("status", "steps", *LENGTHS, *AMOUNTS, "mode")
COLUMNS = ("case", "rest", "number", *MEASURED)
Row = dict[str, str]


@dataclass(frozen=True)
class Case:
    """Slides of a scene's grid: how many, and a factor on the strength."""

    scene: str
    grid: str
    slides: int
    factor: float = 1.0


CASES = {
    "section, published": Case("paper_section", "refined", 50),
    "section, default": Case("section", "refined", 50),
    "3D, published, rough grid calibrated": Case("paper", "rough", 10, 1.18 / 1.29),
}


def read(path: Path) -> dict[tuple[str, bool], dict[int, Row]]:
    """The file: (case, with the rule) -> number -> row. ValueError for a line that does not parse."""
    found: dict[tuple[str, bool], dict[int, Row]] = {}
    if not path.exists():
        return found
    with path.open(newline="") as file:
        for line, row in enumerate(csv.DictReader(file), start=2):
            try:
                if row["case"] not in CASES or row["rest"] not in ("0", "1"):
                    raise ValueError(f"case {row['case']!r}, rest {row['rest']!r}")
                values = [float(row[name]) for name in ("steps", *LENGTHS)]
                if not np.isfinite(values).all():
                    raise ValueError("not finite")
                found.setdefault((row["case"], row["rest"] == "1"), {})[int(row["number"])] = row
            except (KeyError, TypeError, ValueError) as error:
                raise ValueError(f"{path.name}, line {line} is no row of a run ({error}): mend or delete it") from error
    return found


def main() -> None:
    """Run what is missing, one slide after the other."""
    new, done = not DATA.exists(), read(DATA)
    with DATA.open("a", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        if new:
            writer.writerow(COLUMNS)
        for name, case in CASES.items():
            with_rule, without = (done.get((name, rest), {}) for rest in (True, False))
            for row in _rows(name, case, set(with_rule), set(without)):
                writer.writerow(row)
                file.flush()


def _rows(name: str, case: Case, with_rule: set[int], without: set[int]) -> Iterator[tuple[object, ...]]:
    """Sample after sample to its end under the rule; of those that slid, once more without."""
    campaign = scene_campaign(case.scene)
    campaign = study(campaign) if case.grid == "refined" else campaign
    plan = replace(campaign.plan, fields=(), modes=(case.grid,))
    soil = runs.random_soil(campaign)
    coefficients = runs.coefficients_of(campaign, soil)

    def model_with(settle: Settle | None) -> runs.GridModel:
        run = replace(campaign.run, settle=settle)
        built = runs.build(replace(campaign, run=run, plan=plan), case.grid, soil)
        return replace(built, strength_factor=case.factor)

    ruled, unruled = model_with(campaign.run.settle), model_with(Settle())
    limit = campaign.run.failure_displacement
    slid = len(with_rule)
    for number in range(max(with_rule, default=-1) + 1, len(coefficients)):
        if slid >= case.slides:
            break
        (first,) = runs.run_samples(ruled, coefficients, [number], width=1, stop_at=limit)
        if float(first.row["displacement"]) <= limit:
            continue
        slid += 1
        for rest, model in ((0, unruled), (1, ruled)):
            if number not in (with_rule if rest else without):
                (sample,) = runs.run_samples(model, coefficients, [number], width=1)
                measured = [sample.row.get(each, "") for each in (*LENGTHS, *AMOUNTS, "mode")]
                yield name, rest, number, sample.status, sample.steps, *measured


def run(quick: bool) -> Report:
    """What the file holds; `quick` changes nothing, there is nothing to run."""
    del quick
    found = read(DATA)
    rows = [
        compared(name, case, found[name, True], found[name, False])
        for name, case in CASES.items()
        if (name, True) in found and (name, False) in found
    ]
    values: dict[str, Any] = {
        "slides": sum(row["slides"] for row in rows),
        "modes_changed": sum(row["modes_changed"] for row in rows),
        "largest_change_of_a_length_cells": max((row["largest_change_cells"] for row in rows), default=None),
        "largest_change_of_an_amount": max((row["largest_change_share"] for row in rows), default=None),
    }
    return Report(values | {f"saved_{n}": row["steps_saved"] for n, row in enumerate(rows)}, rows)


def compared(name: str, case: Case, ruled: dict[int, Row], unruled: dict[int, Row]) -> dict[str, Any]:
    """Slides that ran both ways: the share of steps saved, the largest change of any measure, modes that changed."""
    both = [(ruled[n], unruled[n]) for n in sorted(ruled.keys() & unruled.keys())]
    whole = [(a, b) for a, b in both if a["mode"] and b["mode"]]
    cell = scene_campaign(case.scene).grids[case.grid].cell

    def largest(measures: tuple[str, ...], scale: float | None) -> float:
        changes = [
            abs(float(a[each]) - float(b[each])) / (scale or max(float(b[each]), 1e-9))
            for a, b in whole
            for each in measures
        ]
        return round(max(changes, default=0.0), 4)

    steps = [sum(int(row["steps"]) for row in column) for column in zip(*both, strict=True)]
    return {
        "case": name,
        "slides": len(both),
        "broke_off": len(both) - len(whole),
        "progressive": sum(b["mode"] == "progressive" for _, b in both),
        "at_rest": sum(a["status"] == "SETTLED" for a, _ in both),
        "steps_saved": round(1 - steps[0] / steps[1], 4),
        "largest_change_cells": largest(LENGTHS, cell),
        "largest_change_share": largest(AMOUNTS, None),
        "modes_changed": sum(a["mode"] != b["mode"] for a, b in whole),
    }


if __name__ == "__main__":
    main()
