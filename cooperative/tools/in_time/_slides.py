"""Slides of the samples that fail in time, each from its first failure to its end."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from cooperative.measure import SEVERITY
from cooperative.scene import read
from cooperative.store import Rows, open_store, read_rows, write_sample
from cooperative.tools.in_time._answer import InTime, WaterState, running
from cooperative.tools.seepage import in_hours

SLIDES = "slides"
"""Folder of the database with a row for each slide."""
FAILED_AT = "failed_at"
"""Its column with the time of the first failure (s)."""


@dataclass(frozen=True)
class SlidesInTime:
    """Slides of samples that fail, in ascending order of the samples.

    Args:
        grid: on which they ran.
        at: number of the time of the first failure of each (n,).
        columns: (n,) each, of their rows: sample, displacement, runout, depth, volume, area, mode and others.
    """

    grid: str
    at: np.ndarray
    columns: dict[str, np.ndarray]

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
    campaign, grid = result.campaign, result.grid
    chosen = dict(sorted(result.first.items())[: campaign.plan.slides])
    states = [WaterState(in_hours(time), campaign, time) for time in result.times]
    with (
        running(campaign, states, folder, workers if chosen else 1) as runner,
        open_store(folder / SLIDES, read(campaign).source) as store,
    ):
        there = set(read_rows(store, grid).numbers)
        for at, time in enumerate(result.times):
            left = [number for number, first in chosen.items() if first == at and number not in there]
            for sample in runner.run(grid, at, left, None) if left else ():
                write_sample(store, grid, replace(sample, row={**sample.row, FAILED_AT: time}))
                runner.stop.check()
            if left:
                progress(f"{grid} grid: {len(left)} slides from {in_hours(time)}")
        rows = read_rows(store, grid)
    return _of_rows(rows, chosen, grid)


def _of_rows(rows: Rows, chosen: dict[int, int], grid: str) -> SlidesInTime:
    here = np.isin(rows.numbers, list(chosen)) if rows.numbers else np.zeros(0, bool)
    columns = {name: values[here] for name, values in rows.columns.items()}
    return SlidesInTime(grid, np.array([chosen[int(number)] for number in columns["sample"]], int), columns)
