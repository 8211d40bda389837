"""The published study beside ours: every table and figure of Jiang et al. (2024), from the files of `benchmarks.study`.

Source: Jiang, Li, Ma and Rezania (2024), Computers and Geotechnics 172, 106413. Nothing is run here: what the files
`benchmarks/data/study_*.csv` do not hold is not run yet, and has no value. An interval is that of 95 per cent; of a
factor of safety, one step of the search. Hours are processor time of one core, or those of a GPU, of the runs that an
answer rests on. `python -m benchmarks.study.published` draws the figures anew.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.measure import Report
from benchmarks.study import study_figures as figures
from benchmarks.study.published_answers import Found, Line, hours_of, mean_seconds
from benchmarks.study.published_factors import factors, table_3
from benchmarks.study.published_modes import modes
from benchmarks.study.published_probability import lengths, probabilities, readings
from benchmarks.study.study import DATA, FIGURES, read_study
from benchmarks.study.study_runs import ON_CPU
from benchmarks.study.study_table import CPU, Rows, merged


def run(quick: bool) -> Report:
    """All rows, from the files. `quick` changes nothing, there is nothing to run."""
    del quick
    return report(DATA)


def report(folder: Path) -> Report:
    """Rows and values from the files in a folder, and what draws the figures of what is there. ValueError for a damaged
    file."""
    study = study_in(folder)
    lines = study.lines
    values = {line.name: line.found.value for line in lines if line.name and isinstance(line.found, Found)}
    for line in lines:
        if line.name == "pf_3d" and isinstance(line.found, Found):
            values |= dict(zip(("pf_3d_low", "pf_3d_high"), line.found.interval, strict=True))
    values = {name: round(value, 4) for name, value in values.items()}
    return Report(values, [line.as_row() for line in lines], partial(figures.draw, study))


def study_in(folder: Path) -> figures.Study:
    """What a folder has of the study. ValueError for a damaged file."""
    rows = merged(read_study(folder).values())
    lines = [*factors(rows), *table_3(rows), *probabilities(rows), *readings(rows), *lengths(rows), *modes(rows)]
    return figures.Study(rows, [*lines, *hours(rows)])


def hours(rows: Rows) -> Iterator[Line]:
    """What the study took, beside the published hours."""
    for grid, printed in (("rough", 11.3), ("refined", 92.4)):
        for kind, unit in (("core", "one core"), ("GPU", "one GPU, which no published hour is beside")):
            mine = ON_CPU if kind == "core" else "published", grid, "class"
            done = {run: o for run, o in rows.items() if (run.case, run.grid, run.until) == mine}
            done = {run: o for run, o in done.items() if (o.device == CPU) == (kind == "core")}
            answer: Found | str = "no run is there"
            if done:
                wanted = 1000 if grid == "rough" else 280
                middle, limits, spread = mean_seconds(np.array([o.seconds for o in done.values()]))
                low, high = (each * wanted / 3600 for each in limits)
                words = f"{len(done)} runs to their class, scaled to {wanted}{spread}"
                answer = Found(middle * wanted / 3600, (low, high), words, hours_of(done))
            yield Line(
                f"{kind} hours of {grid} runs",
                None,
                printed if kind == "core" else None,
                answer,
                f"theirs ran on to 20 s, ten at a time on a desktop with 12 cores; ours are hours of {unit}",
            )
    spent = hours_of(rows)
    for name, total in (("hours_total", spent.core), ("gpu_hours_total", spent.gpu)):
        kind = "GPU" if name.startswith("gpu") else "core"
        everything = Found(total, (total, total), f"{len(rows)} runs, all pieces", spent) if rows else "no run is there"
        yield Line(f"{kind} hours of the whole study", name, None, everything)


if __name__ == "__main__":
    figures.draw(study_in(DATA), FIGURES)
