"""What the early rule changes: classes, ranks, and the time that runs take until their class is known.

From benchmarks/data/early.csv, which `python -m benchmarks.settings.early_runs` makes. The rule was chosen on the first
`Case.chosen_on` runs of a case and is tested on the others. The bound of its error is one-sided, at 95 per cent: three
over the number of runs where no class changes.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.stats import beta, spearmanr

from benchmarks.measure import Report
from benchmarks.settings.early_runs import CASES, Run, read
from benchmarks.statistics import section_pairs

LEVEL = 0.95
WHOLE = {"section, rough": "published", "section, default, rough": "default"}
"""Cases whose samples ran to the end of their slides in `section_pairs`."""


def row(name: str, result: Mapping[int, Run]) -> dict[str, Any]:
    """Runs of a case by both rules. A run that broke off has no class."""
    runs = {number: run for number, run in sorted(result.items()) if run.status in ("SETTLED", "DECIDED", "FINISHED")}
    tested = {number: run for number, run in runs.items() if number >= CASES[name].chosen_on}
    changed = [run for run in tested.values() if fails(run.status) != fails(run.early_status)]
    values: dict[str, Any] = {
        "case": name,
        "runs": len(runs),
        "fail": sum(fails(run.status) for run in runs.values()),
        "tested": len(tested),
        "classes_changed": len(changed),
        "changed_where_chosen": sum(
            fails(run.status) != fails(run.early_status) for number, run in runs.items() if number not in tested
        ),
        "share_of_time": ratio(list(runs.values())),
        "share_of_time_stands": ratio([run for run in runs.values() if not fails(run.status)]),
        "share_of_time_fails": ratio([run for run in runs.values() if fails(run.status)]),
        "seconds_simulated": round(float(np.mean([run.early_time for run in runs.values()])), 3),
    }
    if name in WHOLE:
        values |= ranks(runs, section_pairs.read(WHOLE[name]).displacement["rough"])
    return values


def fails(status: str) -> bool:
    """Whether a run with such an end has failed."""
    return status == "DECIDED"


def ratio(runs: list[Run]) -> float | None:
    """Simulated time by the early rule over that by the others; None without runs."""
    if not runs:
        return None
    return round(sum(run.early_time for run in runs) / sum(run.time for run in runs), 4)


def ranks(runs: Mapping[int, Run], whole: np.ndarray) -> dict[str, float]:
    """Spearman's correlation of what rough runs are ranked by with the displacement at the end of the slide.

    Of all, and of those that fail; by the early rule, and by the displacement at which runs ended before.
    """
    end = whole[list(runs)]
    by = {
        "early": np.array([run.early_displacement for run in runs.values()]),
        "before": np.array([run.displacement for run in runs.values()]),
    }
    slid = np.array([fails(run.status) for run in runs.values()])
    values = {}
    for name, displacement in by.items():
        values[f"spearman_{name}"] = round(float(spearmanr(displacement, end).statistic), 4)
        values[f"spearman_{name}_failures"] = round(float(spearmanr(displacement[slid], end[slid]).statistic), 4)
    return values


def error_bound(changed: int, runs: int) -> float | None:
    """Clopper and Pearson's upper limit of a share; None without runs."""
    return round(float(beta.ppf(LEVEL, changed + 1, runs - changed)), 5) if runs > changed else None


def run(quick: bool) -> Report:
    """The table; `quick` makes no difference, since nothing is run."""
    del quick
    result = read()
    rows = [row(name, result[name]) for name in CASES if name in result]
    tested, changed = (sum(row[what] for row in rows) for what in ("tested", "classes_changed"))
    solid = [row for row in rows if row["case"].startswith("3D")]
    solid_tested, solid_changed = (sum(row[what] for row in solid) for what in ("tested", "classes_changed"))
    return Report(
        {
            "runs": sum(row["runs"] for row in rows),
            "tested": tested,
            "classes_changed": changed,
            "error_at_most": error_bound(changed, tested),
            "tested_3d": solid_tested,
            "classes_changed_3d": solid_changed,
            "error_3d_at_most": error_bound(solid_changed, solid_tested),
            "share_of_time": max(row["share_of_time"] for row in rows),
            "spearman": min(row["spearman_early"] for row in rows if "spearman_early" in row),
        },
        rows,
    )
