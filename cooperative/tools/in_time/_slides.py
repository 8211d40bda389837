"""Slides of the samples that fail in time, each from its first failure to its end."""

from __future__ import annotations

from collections.abc import Callable, Container, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from cooperative import runs
from cooperative.folder import Results, models_of, write_results
from cooperative.measure import SEVERITY
from cooperative.names import GRIDS
from cooperative.store import FAILED_AT, SLIDES_IN_TIME, Rows, Store, read_rows, write_sample
from cooperative.summary import Summary, summarise_slides
from cooperative.tools.in_time._answer import InTime, running, states_in_time
from cooperative.tools.seepage import in_hours


@dataclass(frozen=True)
class SlidesInTime:
    """Slides of samples that fail, in ascending order of the samples.

    Args:
        grid: on which they ran.
        at: number of the time of the first failure of each (n,).
        columns: (n,) each, of their rows: sample, displacement, runout, depth, volume, area, mode and others.
        notes: what limits them, in words.
    """

    grid: str
    at: np.ndarray
    columns: dict[str, np.ndarray]
    notes: tuple[str, ...] = ()

    def column(self, name: str) -> np.ndarray:
        """A measure of the slides (n,), nan of one that broke off; a name that no slide has is nan for all."""
        return np.asarray(self.columns.get(name, np.full(self.at.size, np.nan)), float)

    def modes(self, at: int) -> dict[str, int]:
        """Slides of each failure mode among those that failed first at a time, the severest first.

        Args:
            at: number of the time.
        """
        mode = np.asarray(self.columns.get("mode", np.full(self.at.size, "")))
        return {name: int(((mode == name) & (self.at == at)).sum()) for name in SEVERITY}


def slides_in_time(
    result: InTime, folder: Path, *, workers: int = 1, progress: Callable[[str], None] = lambda line: None
) -> SlidesInTime:
    """Let the samples that fail slide to their end, from rest under the pressure of their first failure.

    They run on the finest grid that was asked; at most as many as `slides` of the campaign allows, in the order of
    their numbers. Each that has ended is a row of the database in the folder `slides`, and the same call goes on.

    Args:
        result: of `probability_in_time`.
        folder: that it kept its answers in.
        workers: processes that run samples.
        progress: called with a line after each time.

    Returns:
        The slides.

    Raises:
        ValueError: the folder is of another scene, or another process runs its slides.
    """
    campaign, grid, chosen = result.campaign, result.grid, to_slide(result)
    states, workers = states_in_time(campaign), workers if chosen else 1
    with running(campaign, states, folder / SLIDES_IN_TIME, len(result.refined), workers) as runner:
        store = runner.kept.store
        there = set(rows_of_slides(store, chosen)[grid].numbers)
        for at, time in enumerate(result.times):
            to_run = [number for number, first in chosen.items() if first == at and number not in there]
            for sample in runner.run(grid, at, to_run, None) if to_run else ():
                write_sample(store, grid, replace(sample, row={**sample.row, FAILED_AT: time}))
                runner.stop.check()
            if to_run:
                progress(f"{grid} grid: {len(to_run)} slides from {in_hours(time)}")
        rows = rows_of_slides(store, chosen)
        notes = summarised(store, result, rows).notes if rows[grid].numbers else ()
    return slides_of_rows(rows[grid], chosen, grid, notes)


def to_slide(result: InTime) -> dict[int, int]:
    """The samples that are to slide, and the number of the time at which each fails first."""
    return dict(sorted(result.first.items())[: result.campaign.plan.slides])


def rows_of_slides(store: Store, chosen: Container[int]) -> dict[str, Rows]:
    """The rows of both grids of samples that are to slide."""
    tables = {grid: read_rows(store, grid) for grid in GRIDS}
    here = {grid: np.array([number in chosen for number in rows.numbers], bool) for grid, rows in tables.items()}
    return {
        grid: replace(rows, columns={name: values[here[grid]] for name, values in rows.columns.items()})
        for grid, rows in tables.items()
    }


def summarised(store: Store, result: InTime, rows: Mapping[str, Rows]) -> Summary:
    """What the slides are in numbers, kept with what draws them, as a campaign does."""
    models, last = models_of(result.campaign), len(result.times)
    runs.keep_ground(store.folder, models)
    fails = {
        "rough": [0 <= first < last for first in result.rough.tolist()],
        "refined": [0 <= first < last for first in result.refined.values()],
    }
    summary = summarise_slides(result.campaign, result.estimates[-1], rows, fails)
    write_results(Results(store, runs.ground_of(models), rows["rough"], rows["refined"], summary), models)
    return summary


def slides_of_rows(rows: Rows, chosen: Mapping[int, int], grid: str, notes: tuple[str, ...]) -> SlidesInTime:
    """The slides of a table."""
    return SlidesInTime(grid, np.array([chosen[number] for number in rows.numbers], int), rows.columns, notes)
