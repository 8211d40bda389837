"""What is lost and what is saved by ending a slide once its deposit rests, instead of at 20 s.

`python -m benchmarks.settings.rest` runs what benchmarks/data/rest.csv lacks: the first failures of the section's
refined grid, with published and with default settings, and of the published slope in 3D on its calibrated rough grid,
each once with the rule and once without. `python -m benchmarks rest` prints what the file holds.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.csv_rows import ENDED, Row, appending, optional, read_rows, size, whole, word
from benchmarks.measure import ROOT, Report, scene_campaign
from cooperative import runs
from cooperative.measure import SEVERITY
from cooperative.runs import GridModel
from cooperative.scene import Campaign
from jaxmpm import Settle

DATA = ROOT / "benchmarks" / "data" / "rest.csv"
SIZES = ("depth", "runout")
LENGTHS = ("displacement", "runout_foremost", *SIZES)
"""Measures in metres."""
AMOUNTS = ("volume", "area")


@dataclass(frozen=True)
class Case:
    """Slides of a scene's grid: how many, and a factor on the strength."""

    scene: str
    grid: str
    slides: int
    factor: float = 1.0


SAMPLES = 1000
"""Of each case, more than it takes for the slides."""
CASES = {
    "section, published": Case("paper_section", "refined", 50),
    "section, default": Case("section", "refined", 50),
    "3D, published, rough grid calibrated": Case("paper", "rough", 10, 1.18 / 1.29),
}
MODE = optional(word(*SEVERITY))
COLUMNS = {
    **{"case": word(*CASES), "rest": whole, "number": whole, "status": word(*ENDED), "steps": whole},
    **dict.fromkeys((*LENGTHS, *AMOUNTS), optional(size)),
    "mode": MODE,
}


def read(path: Path) -> dict[tuple[str, bool], dict[int, Row]]:
    """The file: (case, with the rule) -> number -> row. ValueError for a row that does not parse or occurs twice."""
    answer: dict[tuple[str, bool], dict[int, Row]] = {}
    for (case, rest, sample), row in read_rows(path, COLUMNS, ("case", "rest", "number")).items():
        answer.setdefault((case, rest == 1), {})[sample] = row
    return answer


def main() -> None:
    """Run what is missing, one slide after the other."""
    done = read(DATA)
    with appending(DATA, COLUMNS) as put:
        for name, case in CASES.items():
            with_rule, without = (set(done.get((name, rest), {})) for rest in (True, False))
            if len(with_rule) < case.slides:
                for row in _rows(name, case, with_rule, without):
                    put(row)


def campaign_of(case: Case) -> Campaign:
    """The campaign of a case."""
    campaign = scene_campaign(case.scene)
    return replace(campaign, plan=replace(campaign.plan, samples=SAMPLES, fields=(), modes=("rough", "refined")))


def prepared(case: Case) -> tuple[GridModel, np.ndarray]:
    """The model of a case, whose runs end as in its scene, and the coefficients of its samples (samples, modes)."""
    campaign = campaign_of(case)
    soil = runs.random_soil(campaign)
    model = replace(runs.build(campaign, case.grid, soil), strength_factor=case.factor)
    return model, runs.coefficients_of(campaign, soil)


def _rows(name: str, case: Case, with_rule: set[int], without: set[int]) -> Iterator[tuple[object, ...]]:
    """Sample after sample to its end under the rule; of those that slid, once more without."""
    ruled, coefficients = prepared(case)
    campaign = ruled.campaign
    unruled = replace(
        ruled,
        campaign=replace(campaign, run=replace(campaign.run, settle=Settle(least_volume=campaign.failing_volume))),
    )
    limit = campaign.run.failure_displacement
    slid = len(with_rule)
    for sample in range(max(with_rule, default=-1) + 1, len(coefficients)):
        if slid >= case.slides:
            break
        (first,) = runs.run_samples(ruled, coefficients, [sample], width=1, rules=ruled.campaign.rules(limit))
        if float(first.row["displacement"]) <= limit:
            continue
        slid += 1
        for rest, model in ((0, unruled), (1, ruled)):
            if sample not in (with_rule if rest else without):
                (done,) = runs.run_samples(model, coefficients, [sample], width=1)
                measured = [done.row.get(measure, "") for measure in (*LENGTHS, *AMOUNTS, "mode")]
                yield name, rest, sample, done.status, done.steps, *measured


def run(quick: bool) -> Report:
    """What the file holds; `quick` changes nothing, there is nothing to run."""
    del quick
    answer = read(DATA)
    rows = [
        compared(name, case, answer[name, True], answer[name, False])
        for name, case in CASES.items()
        if (name, True) in answer and (name, False) in answer
    ]
    values: dict[str, Any] = {
        "slides": sum(row["slides"] for row in rows),
        "modes_changed": sum(row["modes_changed"] for row in rows),
        "largest_change_of_a_length_cells": max((row["largest_change_cells"] for row in rows), default=None),
        "largest_change_of_depth_or_runout_cells": max((row["largest_change_of_sizes"] for row in rows), default=None),
        "largest_change_of_an_amount": max((row["largest_change_share"] for row in rows), default=None),
    }
    values |= {f"saved_{n}": row["steps_saved"] for n, row in enumerate(rows)}
    return Report(values, rows)


def compared(name: str, case: Case, ruled: dict[int, Row], unruled: dict[int, Row]) -> dict[str, Any]:
    """Slides that ran both ways: the share of steps saved, the largest change of any measure, modes that changed."""
    both = [(ruled[n], unruled[n]) for n in sorted(ruled.keys() & unruled.keys())]
    whole = [(a, b) for a, b in both if a["mode"] and b["mode"]]
    cell = scene_campaign(case.scene).grids[case.grid].cell

    def largest(measures: tuple[str, ...], scale: float | None) -> float:
        changes = [
            abs(a[measure] - b[measure]) / (scale or max(b[measure], 1e-9)) for a, b in whole for measure in measures
        ]
        return round(max(changes, default=0.0), 4)

    steps = [sum(row["steps"] for row in column) for column in zip(*both, strict=True)]
    return {
        "case": name,
        "slides": len(both),
        "broke_off": len(both) - len(whole),
        "progressive": sum(b["mode"] == "progressive" for _, b in both),
        "at_rest": sum(a["status"] == "SETTLED" for a, _ in both),
        "steps_saved": round(1 - steps[0] / steps[1], 4),
        "largest_change_cells": largest(LENGTHS, cell),
        "largest_change_of_sizes": largest(SIZES, cell),
        "largest_change_share": largest(AMOUNTS, None),
        "modes_changed": sum(a["mode"] != b["mode"] for a, b in whole),
    }


if __name__ == "__main__":
    main()
