"""`python -m benchmarks.study.missing [CASE ...]`: run what the study lacks, and add it to the rows of benchmarks/data.

Slides of the slope of mean strength at its factors of safety. The cases with default settings: factors of safety,
random slopes and their audit. Slides of the failures on the calibrated rough grid, and refined ones of the failures
that the audits drew, once more with more air above them where soil left the grid. In 3D a refined class takes a core
one to seven minutes, a slide three to eight, on the rough grid some seconds.
A command that was stopped goes on from the last restart point of a slide, in out/study/missing.
"""

from __future__ import annotations

import csv
import json
import math
import sys
from collections.abc import Callable, Iterable, Iterator
from dataclasses import astuple, fields, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from benchmarks.measure import ROOT
from benchmarks.study.cases import (
    AUDIT,
    CASES,
    MORE_AIR,
    SAMPLES,
    SECTION_SAMPLES,
    SWEEP,
    SWEEP_AUDIT,
    SWEEP_SAMPLES,
    campaign_of,
    plan_of,
    sweep_case,
)
from benchmarks.study.factors import STEP
from benchmarks.study.probability import audit_weights
from benchmarks.study.rows import (
    COLUMNS,
    DATA,
    Outcome,
    Rows,
    Run,
    Until,
    classes,
    factor_of_safety,
    of_search,
    population,
    read_study,
)
from cooperative import build, coefficients_of, random_soil
from cooperative.estimate import next_audit
from cooperative.runs import GridModel, Stopped, run_samples, stop_by_signals
from cooperative.scene import Campaign
from cooperative.store import FinishedRun, open_store

BRACKET = 0.98, 1.3
"""Of the search for a factor of safety: reductions that stand and that fail, of which the second is run."""


def missing_runs(rows: Rows) -> Iterator[Run]:
    """The runs in the order in which they are made, as far as the rows show which are needed."""
    for case in CASES:
        if not plan_of(case):
            yield from _factors(rows, case)
        elif "default" in case:
            yield from _random(rows, case)
    if Run("published", "rough") in rows:
        yield from _slides(rows, "published", audit_weights(rows, "published", SAMPLES, AUDIT))
    for case in (case for case in SWEEP if case != sweep_case("lx", 60)):
        yield from _slides(rows, case, classes(rows, case, "refined"))
    rough = [run for run in rows if run.case in SWEEP and (run.grid, run.until) == ("rough", "class")]
    yield from (replace(run, until="end") for run in rough if rows[run].failed)


def _slides(rows: Rows, case: str, samples: Iterable[int]) -> Iterator[Run]:
    """Refined slides of those samples that fail, and with more air of those that broke off."""
    for sample in samples:
        run = Run(case, "refined", sample)
        if rows[run].failed:
            yield (slide := replace(run, until="end"))
            if case == "published" and slide in rows and rows[slide].broke_off:
                yield replace(slide, case=MORE_AIR)


def _factors(rows: Rows, case: str) -> Iterator[Run]:
    """A search by bisection on each grid, on cells of 0.75 m and in 2D on the refined one, and the slide there."""
    for grid in ("refined",) if "section" in case or "cells of" in case else ("rough", "refined"):
        tried = of_search(rows, case, grid)
        fails = min((reduction for reduction, fails in tried.items() if fails), default=None)
        below = math.inf if fails is None else fails
        stands = max(
            (reduction for reduction, failed in tried.items() if failed is False and reduction < below),
            default=BRACKET[0],
        )
        if below - stands > 1.5 * STEP:
            reduction = BRACKET[1] if fails is None else round((below + stands) / 2, 2)
            if reduction in tried:
                raise ValueError(
                    f"{case!r}, {grid}: at a reduction of {reduction:g} the slope stands, or its run broke off: change "
                    "BRACKET, or delete the row"
                )
            yield Run(case, grid, 0, reduction)
            return
    if "rollers" not in case:
        factor = factor_of_safety(rows, case, "refined")
        assert factor is not None
        yield Run(case, "refined", 0, factor, "end")


def _random(rows: Rows, case: str) -> Iterator[Run]:
    """All samples on both grids in 2D; in 3D all on the rough one and those of the audit on the refined one."""
    section = case.startswith("section, ")
    for sample in range(SECTION_SAMPLES if section else SWEEP_SAMPLES):
        yield from (Run(case, grid, sample) for grid in (("rough", "refined") if section else ("rough",)))
    if not section:
        ranked = population(rows, case, SWEEP_SAMPLES)
        yield from (Run(case, "refined", n) for n in next_audit(ranked, classes(rows, case, "refined"), SWEEP_AUDIT))


@lru_cache(maxsize=2)
def _built(case: str, grid: str, reduction: float) -> tuple[Campaign, GridModel, np.ndarray]:
    """Campaign, model and coefficients of a case with strength that is divided."""
    definition = CASES[case]
    changes = definition["changes"]
    # Samples are ranked by the displacement at their class, which `early` does not wait for.
    run = {**changes.get("run", {}), "strength_factor": 1 / reduction, "early": False}
    plan = {**changes.get("campaign", {}), "modes": "both"}
    campaign = campaign_of(definition["scene"], {**changes, "run": run, "campaign": plan})
    soil = random_soil(campaign)
    return campaign, build(campaign, grid, soil), coefficients_of(campaign, soil)


def outcome_of(run: Run, folder: Path, stop: Callable[[], bool] = lambda: False) -> Outcome:
    """Run a slide to its end, from its restart point where it has one, or a slope until its class is decided.

    Args:
        run: the run.
        folder: of the restart points of a slide.
        stop: whether to end, called after every chunk of steps.

    Raises:
        Stopped: `stop` was true; a restart point of a slide is there.
    """
    campaign, model, coefficients = _built(run.case, run.grid, run.reduction)
    sample_coefficients, numbers = {run.sample: coefficients[run.sample]}, [run.sample]
    if run.until == "class":
        (sample,) = run_samples(
            model, sample_coefficients, numbers, rules=campaign.rules(campaign.run.failure_displacement), stop=stop
        )
    else:
        with open_store(folder, campaign.source):
            (sample,) = run_samples(model, sample_coefficients, numbers, restart_in=folder, stop=stop)
    return as_outcome(sample, run.until)


def as_outcome(sample: FinishedRun, until: Until) -> Outcome:
    """A sample as the study's rows have it. until: see `Run`."""
    names = ["displacement", "time"] if until == "class" else [field.name for field in fields(Outcome)]
    measured = {name: sample.row[name] for name in names if name in sample.row}
    rounded = {name: float(f"{value:.6g}") if isinstance(value, float) else value for name, value in measured.items()}
    return Outcome(
        status=sample.status,
        steps=sample.steps,
        seconds=round(sample.seconds, 3),
        device=sample.device,
        **rounded,  # type: ignore[arg-type]
    )


def add(path: Path, run: Run, outcome: Outcome) -> None:
    """Write a row to the end of a file of the study, whose first line describes its cases."""
    new = not path.is_file()
    with path.open("a", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        if new:
            cases = {case: known for case, known in CASES.items() if file_of(case, run.grid).name == path.name}
            file.write(f"# {json.dumps({'cases': cases})}\n")
            writer.writerow(COLUMNS)
        writer.writerow("" if cell is None else cell for cell in (*astuple(run), *astuple(outcome)))


def file_of(case: str, grid: str) -> Path:
    """The file of the study that runs of a case on a grid are added to."""
    if case in SWEEP and grid == "rough":
        return DATA / "study_sweep_slides.csv"
    slides = {"published": "slides", MORE_AIR: "slides_more_air"}
    if "default" not in case:
        return DATA / f"study_{slides.get(case, 'slides_added' if plan_of(case) else 'slide')}.csv"
    kind = "fos_" if not plan_of(case) else "section_" if case.startswith("section, ") else ""
    return DATA / f"study_{kind}default.csv"


def main() -> None:
    """Run what the files lack, of the cases that are named or of all."""
    cases = sys.argv[1:] or list(CASES)
    if unknown := set(cases) - set(CASES):
        sys.exit(f"case {min(unknown)!r}: give some of {'; '.join(CASES)}")
    rows = read_study()
    with stop_by_signals() as stop:
        while run := next((run for run in missing_runs(rows) if run.case in cases and run not in rows), None):
            folder = ROOT / "out" / "study" / "missing" / f"{run.case}, {run.sample}, {run.reduction:g}"
            try:
                rows[run] = outcome_of(run, folder, stop.requested)
            except Stopped:
                sys.exit("stopped: the same command goes on")
            add(file_of(run.case, run.grid), run, rows[run])
            print(f"{run}: {rows[run].status}, {rows[run].displacement:.2f} m", flush=True)


if __name__ == "__main__":
    main()
