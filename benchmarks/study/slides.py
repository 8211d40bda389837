"""`python -m benchmarks.study.slides`: slides that the study lacks, each run to its end and added to benchmarks/data.

In turn: the slide at the factor of safety with default settings, then refined slides of the failures that the audits
at other correlation lengths drew. A slide takes hours on one core. A command that was stopped goes on from the last
restart point, in out/study/slides.
"""

from __future__ import annotations

import csv
import json
import sys
from collections.abc import Callable, Iterator
from dataclasses import astuple, fields, replace
from pathlib import Path

from benchmarks.measure import ROOT
from benchmarks.study.cases import CASES, SWEEP, campaign_of, sweep_case
from benchmarks.study.factors import DEFAULT
from benchmarks.study.rows import COLUMNS, DATA, Outcome, Rows, Run, factor_of_safety, read_study, read_table
from cooperative import build, coefficients_of, random_soil
from cooperative.runs import Stopped, run_samples, stop_by_signals
from cooperative.store import Sample, open_store

ADDED = DATA / "study_slides_added.csv"
"""Read with the study, of which it is a part."""


def wanted(rows: Rows) -> Iterator[Run]:
    """The slides in the order in which they are run."""
    factor = factor_of_safety(rows, DEFAULT, "refined")
    assert factor is not None
    yield Run(DEFAULT, "refined", 0, factor, "end")
    for run, outcome in rows.items():
        others = run.case in SWEEP and run.case != sweep_case("lx", 60)
        if others and run.grid == "refined" and run.until == "class" and outcome.failed:
            yield replace(run, until="end")


def outcome_of(run: Run, folder: Path, stop: Callable[[], bool] = lambda: False) -> Outcome:
    """Run a slide to its end, from its restart point where it has one.

    Args:
        run: the slide.
        folder: of restart points.
        stop: whether to end, called after every chunk of steps.

    Raises:
        Stopped: `stop` was true; a restart point is there.
    """
    definition = CASES[run.case]
    changes = definition["changes"]
    reduced = {**changes.get("run", {}), "strength_factor": 1 / run.reduction}
    campaign = campaign_of(definition["scene"], {**changes, "run": reduced})
    soil = random_soil(campaign)
    model = build(campaign, run.grid, soil)
    with open_store(folder, campaign.source):
        own = {run.sample: coefficients_of(campaign, soil)[run.sample]}
        (sample,) = run_samples(model, own, [run.sample], restart_in=folder, stop=stop)
    return as_outcome(sample, float(model.scene.time_step))


def as_outcome(sample: Sample, dt: float) -> Outcome:
    """A sample as the study's rows have it. dt: its time step (s)."""
    measured = {each.name: sample.row[each.name] for each in fields(Outcome) if each.name in sample.row}
    rounded = {name: float(f"{value:.6g}") if isinstance(value, float) else value for name, value in measured.items()}
    return Outcome(
        status=sample.status,
        time=round(sample.steps * dt, 5),
        steps=sample.steps,
        seconds=round(sample.seconds, 3),
        device=sample.device,
        **rounded,  # type: ignore[arg-type]
    )


def add(path: Path, run: Run, outcome: Outcome) -> None:
    """Write a row to the end of a file of the study, whose first line says what its cases are."""
    rows = (read_table(path) if path.is_file() else {}) | {run: outcome}
    cases = {case: CASES[case] for case in sorted({each.case for each in rows})}
    with path.open("w", newline="") as file:
        file.write(f"# {json.dumps({'cases': cases})}\n")
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(COLUMNS)
        for each, result in rows.items():
            writer.writerow("" if cell is None else cell for cell in (*astuple(each), *astuple(result)))


def main() -> None:
    """Run the slides that the file lacks."""
    done = read_table(ADDED) if ADDED.is_file() else {}
    with stop_by_signals() as stop:
        for run in wanted(read_study()):
            if run not in done:
                folder = ROOT / "out" / "study" / "slides" / f"{run.case}, {run.sample}, {run.reduction:g}"
                try:
                    outcome = outcome_of(run, folder, stop.asked)
                except Stopped:
                    sys.exit("stopped: the same command goes on")
                add(ADDED, run, outcome)
                print(f"{run.case}, sample {run.sample}: {outcome.status}, {outcome.mode}", flush=True)


if __name__ == "__main__":
    main()
