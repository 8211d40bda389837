"""The published study beside this one: tables and figures of Jiang et al. (2024), from benchmarks/data/study_*.csv.

Source: Jiang, Li, Ma and Rezania (2024), Computers and Geotechnics 172, 106413. Nothing is run here; `python -m
benchmarks.study` runs the campaigns anew. An interval holds 95 per cent, of a median 90; that of a factor of safety is
one step of the search. Hours are processor time of one core, or those of a GPU, of the runs behind an answer.
`python -m benchmarks.study.published` draws the figures anew.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np

from benchmarks.measure import Report
from benchmarks.results import FIGURES
from benchmarks.study import figures
from benchmarks.study.answers import Answer, Line, hours_of, mean_seconds
from benchmarks.study.cases import ON_CPU
from benchmarks.study.factors import factors, table_3
from benchmarks.study.modes import modes
from benchmarks.study.probability import lengths, probabilities, readings
from benchmarks.study.rows import CPU, Rows, read_study


def run(quick: bool) -> Report:
    """Compare; there is nothing to leave out when `quick`."""
    del quick
    study = compared(read_study())
    values: dict[str, float] = {}
    for line in study.lines:
        if line.name and isinstance(line.answer, Answer):
            values[line.name] = round(line.answer.value, 4)
    low, high = study.answer("pf_3d").interval
    values |= {"pf_3d_low": round(low, 4), "pf_3d_high": round(high, 4)}
    return Report(values, [line.as_row() for line in study.lines], partial(figures.draw, study))


def compared(rows: Rows) -> figures.Study:
    """All lines of the table."""
    parts = (factors, table_3, probabilities, readings, lengths, modes, hours)
    return figures.Study(rows, [line for part in parts for line in part(rows)])


def hours(rows: Rows) -> Iterator[Line]:
    """Hours of the study, and the published ones."""
    for grid, printed, run_count in (("rough", 11.3, 1000), ("refined", 92.4, 280)):
        for kind, unit in (("core", "one core"), ("GPU", "one GPU, which no published hour is beside")):
            chosen = ON_CPU if kind == "core" else "published", grid, "class"
            done = {run: o for run, o in rows.items() if (run.case, run.grid, run.until) == chosen}
            done = {run: o for run, o in done.items() if (o.device == CPU) == (kind == "core")}
            middle, limits, spread = mean_seconds(np.array([o.seconds for o in done.values()]))
            low, high = (limit * run_count / 3600 for limit in limits)
            words = f"{len(done)} runs to their class, scaled to {run_count}{spread}"
            answer = Answer(middle * run_count / 3600, (low, high), words, hours_of(done))
            cause = f"theirs ran on to 20 s, ten at a time on a desktop with 12 cores; ours are hours of {unit}"
            yield Line(f"{kind} hours of {grid} runs", None, printed if kind == "core" else None, answer, cause)
    spent = hours_of(rows)
    for name, kind, total in (("hours_total", "core", spent.core), ("gpu_hours_total", "GPU", spent.gpu)):
        answer = Answer(total, (total, total), f"{len(rows)} runs, all pieces", spent)
        yield Line(f"{kind} hours of the whole study", name, None, answer)


if __name__ == "__main__":
    figures.draw(compared(read_study()), FIGURES)
