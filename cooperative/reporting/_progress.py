"""How far a campaign is: samples done, how fast, how long still, and what is known by now. Read from its folder alone.

The folder's lock is not touched, so a campaign may be looked at while it runs, or after it was killed.
"""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cooperative import runs
from cooperative.estimate import Estimate, Estimator, Phases
from cooperative.reporting._sentences import number, probability
from cooperative.scene import Campaign, campaign_of
from cooperative.store import (
    GRIDS,
    SLIDES,
    Rows,
    Store,
    lock_holder,
    mixed_versions,
    read_rows,
    read_store,
)
from cooperative.summary import slides_of
from jaxmpm.support.text import duration, printable

RECENT = 20
"""How many of the last finished samples the pace is taken from."""


@dataclass(frozen=True)
class GridProgress:
    """One grid, or the slides on the refined one.

    Args:
        grid: its name.
        done: finished samples.
        planned: of how many.
        at_least: whether `planned` may grow.
        pace: seconds from one finished sample to the next, nan where unknown.
        broke_off: runs that broke off.
        damaged: runs that cannot be trusted and will be redone.
    """

    grid: str
    done: int
    planned: int
    at_least: bool
    pace: float
    broke_off: int = 0
    damaged: tuple[str, ...] = ()

    @property
    def hourly(self) -> float:
        """Samples per hour of late, nan before the second."""
        return 3600 / self.pace if self.done > 1 and self.pace > 0 else float("nan")

    @property
    def seconds_left(self) -> float:
        """To go (s), nan where unknown."""
        return max(self.planned - self.done, 0) * self.pace


@dataclass(frozen=True)
class Progress:
    """How far a campaign is.

    Args:
        name: of the campaign.
        controller: who holds the folder, in words.
        running: whether that runs, as far as can be seen.
        grids: coarse where there is one, rough, refined, then the slides where not all failures run to their end.
        estimate: from the refined runs so far, or while screening the share of rough failures; None before the first
            sample.
        versions: which samples were made by which versions, where these differ, in words.
    """

    name: str
    controller: str
    running: bool
    grids: tuple[GridProgress, ...]
    estimate: Estimate | None
    versions: str = ""


def progress_of(folder: str | Path, *, estimator: Estimator | None = None) -> Progress:
    """Read how far the campaign in `folder` is.

    Args:
        folder: of the campaign.
        estimator: the one that `cooperative.campaign.run` was given, where it was given one.

    Raises:
        ValueError: the folder is none.
    """
    store = read_store(folder)
    campaign = campaign_of(store, estimator)
    read = runs.rows_reader(store, runs.samples_of(campaign))
    rows = {grid: read(grid) for grid in campaign.grids}
    pace = {grid: _pace(table) for grid, table in rows.items()}
    if not np.isfinite(pace["refined"]):
        pace["refined"] = pace["rough"] * cost_ratio(campaign)
    rough, refined = (rows[grid] for grid in GRIDS)
    phases = runs.phases_of(campaign, rough, refined)
    planned = {
        "coarse": (campaign.plan.samples, False),
        "rough": (planned_rough(campaign), False),
        "refined": planned_refined(campaign, phases, rough, refined),
    }
    grids = [
        GridProgress(
            grid, len(of_grid.numbers), *planned[grid], pace[grid],
            int(np.sum(of_grid.columns.get("broke_off", np.zeros(0)))), of_grid.damaged,
        )
        for grid, of_grid in rows.items()
    ]  # fmt: skip
    if campaign.plan.slides:
        # Of how many is known once the audit has ended.
        slides, may_grow = slides_of(campaign, phases, refined), phases.why_finished is None
        of_slides = _pace(read_rows(store, SLIDES))
        grids.append(GridProgress(SLIDES, int(slides.slid.sum()), slides.planned, may_grow, of_slides))
    # Before the screening is complete it is the share that fails on the rough grid.
    estimate = phases.estimate if rough.numbers else None
    return Progress(campaign.name, *controller_of(store), tuple(grids), estimate, mixed_versions(rows))


def watched(progress: Callable[[], Progress], every: float) -> Iterator[str]:
    """The progress in words, again and again `every` (s) after the last, until nobody runs the campaign any more.

    Args:
        progress: gives it.
        every: seconds between two readings.

    Raises:
        ValueError: for no time in between.
    """
    if not 0 < every < float("inf"):
        raise ValueError(f"--watch {every:g}: give the seconds between two looks, above 0")
    while True:
        now = progress()
        yield words(now)
        if not now.running:
            return
        time.sleep(every)


def planned_refined(campaign: Campaign, phases: Phases, rough: Rows, refined: Rows) -> tuple[int, bool]:
    """Refined runs of the campaign in all, and whether they may become more.

    The budget, or where there is none the runs asked for so far.
    """
    most, done = campaign.estimator.budget(planned_rough(campaign)), len(refined.numbers)
    if most is not None:
        # Slides may have wanted more than the estimator.
        return max(most, done), False
    if len(rough.numbers) < planned_rough(campaign):
        return done + 1, True
    missing = phases.next_runs(campaign.plan.samples, ())
    return done + len(missing), bool(missing)


def planned_rough(campaign: Campaign) -> int:
    """Samples that the campaign's estimator runs on the rough grid."""
    return campaign.estimator.rough_runs(runs.sampling_of(campaign))


def seconds_per_sample(ended: Sequence[float], seconds: Sequence[float]) -> float:
    """Seconds from one finished sample to the next, of late; nan for fewer than two.

    Args:
        ended: when each sample was finished (s, ascending).
        seconds: how long each ran. A gap far longer than any run is a pause of the campaign and does not count.
    """
    gaps = np.diff(np.asarray(ended, float))[-RECENT:]
    gaps = gaps[gaps <= 3 * max(seconds, default=0.0) + 60.0]
    return float(gaps.mean()) if gaps.size else float("nan")


def cost_ratio(campaign: Campaign) -> float:
    """What a refined run should cost in rough ones: particles times steps."""
    rough, refined = (campaign.grids[grid] for grid in GRIDS)
    particles = float(np.prod(np.asarray(rough.spacing) / np.asarray(refined.spacing)))
    return particles * (rough.cell * rough.cfl) / (refined.cell * refined.cfl)


def words(progress: Progress) -> str:
    """The progress in lines of text.

    Args:
        progress: of a campaign.
    """
    lines = [progress.name, f"  controller     {progress.controller}"]
    for grid in progress.grids:
        most = f"at least {grid.planned}" if grid.at_least else f"{grid.planned}"
        name = grid.grid if grid.grid == SLIDES else f"{grid.grid} grid"
        line = f"  {name:<14} {grid.done} of {most} samples"
        if np.isfinite(grid.hourly):
            line += f", {number(grid.hourly)} per hour"
        if grid.done < grid.planned and np.isfinite(grid.seconds_left):
            line += f", {duration(grid.seconds_left)} left"
        lines.append(line)
        if grid.broke_off:
            lines.append(f"                 {grid.broke_off} broke off")
        lines += [f"  DAMAGED        {why}: will be run again" for why in grid.damaged]
    estimate = progress.estimate
    if estimate is None:
        lines.append("  no finished sample yet")
        return "\n".join(map(printable, lines))
    lines.append(f"  probability of failure so far  {probability(estimate)}")
    lines += [f"  note: {note}" for note in (*estimate.notes, *filter(None, [progress.versions]))]
    return "\n".join(map(printable, lines))


def _pace(rows: Rows) -> float:
    """Seconds from one finished sample to the next, by when their rows were written."""
    return seconds_per_sample(sorted(rows.written.values()), rows.columns["seconds"].tolist())


def controller_of(store: Store) -> tuple[str, bool]:
    """Who holds a folder, and whether that runs as far as can be seen.

    The lock itself is left alone: taking it, even for a moment, could refuse a controller.

    Args:
        store: the campaign's folder.
    """
    try:
        holder = lock_holder(store.folder)
        process, host = holder.removeprefix("process ").split(" on ")
    except (OSError, ValueError):
        return "none yet", False
    if host != socket.gethostname():
        return f"{holder} (whether it still runs cannot be seen from here)", True
    try:
        os.kill(int(process), 0)
    except ProcessLookupError:
        return f"none, the last one ({holder}) has ended", False
    except PermissionError:
        pass
    return holder, True
