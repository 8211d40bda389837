"""Core seconds of a run of which only the class is asked for: seconds of a step here, times the mean number of steps.

`python -m benchmarks class_runs [--quick]` measures a step of the median soil of both grids of the published slope in
3D, with published and default settings, in a process bound to one core. Rough runs take the steps of
benchmarks/data/early.csv, with the early rule and without. Refined ones took those of an audit without it
(benchmarks/data/study_audit.csv), and take the share that the rule leaves of the time of rough runs of the same class.

`expected_hours_to_cov_10` are those of a campaign with PLANNED samples on two cores, one worker each: its rough runs,
and as many refined ones as half of the campaigns of `estimators` take for a coefficient of variation of 10 per cent.
The correlation of the grids is 0.98 with published settings, where 0.979 was measured, and 0.95 with default ones.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from typing import Any

import numpy as np

from benchmarks.measure import Report, on_cores, scene_campaign
from benchmarks.results import FOLDER
from benchmarks.settings.early import fails, ratio
from benchmarks.settings.early_runs import CASES, Run, read
from benchmarks.study.rows import DATA, read_table
from cooperative import runs

SECONDS = {True: 4.0, False: 20.0}
"""Of the trial of each grid, quick and whole."""
NAMES = {
    "3D, rough": "rough_core_seconds",
    "3D, default, rough": "rough_core_seconds_default",
    "3D, refined": "refined_class_core_seconds",
    "3D, default, refined": "refined_class_core_seconds_default",
}
PLANNED, CORES = 1000, 2
HOURS = {"": "target_cov_runs_q50_r098", "_default": "target_cov_runs_q50_r095"}
"""Ending of a value's name -> the value of `estimators` that counts the refined runs."""
AUDITS = {"3D, refined": ("audit", "3D, rough"), "3D, default, refined": ("default", "3D, default, rough")}
"""Cases too dear to have many runs -> the study's rows of them, and the case whose share of time stands for theirs."""


def run(quick: bool) -> Report:
    """Core seconds of each case, with the early rule and without."""
    result, rows = read(), []
    for case, name in NAMES.items():
        step = on_cores(1, "benchmarks.speed.class_runs", case, str(SECONDS[quick]))
        early, before = times(case, result)
        second_cost = step["step"] / step["time_step"]
        rows.append(
            {
                "case": case,
                "value": name,
                "ms_per_step": 1e3 * step["step"],
                "simulated_s": early,
                "core_seconds": early * second_cost,
                "simulated_before_s": before,
                "core_seconds_before": before * second_cost,
            }
        )
    values = {row["value"]: row["core_seconds"] for row in rows}
    return Report(values | expected_hours(values), rows)


def expected_hours(core_seconds: Mapping[str, float]) -> dict[str, float]:
    """Hours of a campaign to a coefficient of variation of 10 per cent, by the core seconds of its runs."""
    return {
        f"expected_hours_to_cov_10{end}": (
            PLANNED * core_seconds[f"rough_core_seconds{end}"]
            + count * core_seconds[f"refined_class_core_seconds{end}"]
        )
        / (3600 * CORES)
        for end, count in refined_runs_needed().items()
    }


def refined_runs_needed() -> dict[str, int]:
    """Refined runs of half of the campaigns of `estimators`, by the ending of the settings' names."""
    counts = json.loads((FOLDER / "estimators.json").read_text())["values"]
    return {end: int(counts[count]) for end, count in HOURS.items()}


def times(case: str, result: Mapping[str, Mapping[int, Run]]) -> tuple[float, float]:
    """Mean simulated time (s) of the runs of a case, with the early rule and without."""
    if case not in AUDITS:
        runs_of = result[case].values()
        return float(np.mean([run.early_time for run in runs_of])), float(np.mean([run.time for run in runs_of]))
    table, like = AUDITS[case]
    audit = [
        outcome
        for run, outcome in read_table(DATA / f"study_{table}.csv").items()
        if (run.grid, run.until) == ("refined", "class") and not outcome.broke_off
    ]
    share = {
        failed: ratio([run for run in result[like].values() if fails(run.status) == failed]) or 1.0
        for failed in (False, True)
    }
    early = [outcome.time * share[bool(outcome.failed)] for outcome in audit]
    return float(np.mean(early)), float(np.mean([outcome.time for outcome in audit]))


def main(case: str, seconds: str) -> None:
    """Print seconds of a step and the time step as JSON."""
    campaign = scene_campaign(CASES[case].scene)
    model = runs.build(campaign, CASES[case].grid, runs.random_soil(campaign), at_rest=False)
    answer: dict[str, Any] = {
        "step": runs.seconds_per_step(model, float(seconds)),
        "time_step": float(model.scene.numerics.time_step),
    }
    print(json.dumps(answer))


if __name__ == "__main__":
    main(*sys.argv[1:])
