"""How far a campaign is: samples done, how fast, how long still, and what is known by now. Read from its folder alone.

The folder's lock is not touched, so a campaign may be looked at while it runs, or after it was killed.
"""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cooperative import runs
from cooperative.estimate import Estimate, Estimator
from cooperative.scene import Campaign, campaign_of
from cooperative.store import GRIDS, SLIDES, Rows, Store, lock_holder, read_rows, read_store, sample_path
from cooperative.summary import slides_of
from foundation.text import duration, printable

RECENT = 20
"""How many of the last finished samples the pace is taken from."""


@dataclass(frozen=True)
class GridProgress:
    """One grid, or the slides on the refined one.

    Args:
        done: finished samples.
        planned: of how many, None where the stopping rule alone will tell.
        at_least: whether `planned` may grow.
        hourly: samples per hour of late, nan before the second.
        seconds_left: to go, nan where nothing tells.
        broke_off: runs that broke off.
        damaged: files that cannot be trusted and will be redone.
    """

    grid: str
    done: int
    planned: int
    at_least: bool
    hourly: float
    seconds_left: float
    broke_off: int
    damaged: tuple[str, ...]


@dataclass(frozen=True)
class Progress:
    """How far a campaign is.

    Args:
        name: of the campaign.
        controller: who holds the folder, in words.
        running: whether that runs, as far as can be seen.
        grids: rough, then refined, then the slides where not all failures run to their end.
        estimate: from the refined runs so far, or while screening the share of rough failures; None before the first
            sample.
    """

    name: str
    controller: str
    running: bool
    grids: tuple[GridProgress, ...]
    estimate: Estimate | None


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
    rows = dict(zip(GRIDS, map(runs.rows_reader(store, runs.samples_of(campaign)), GRIDS), strict=True))
    pace = {grid: _pace(store, grid, rows[grid]) for grid in GRIDS}
    if not np.isfinite(pace["refined"]):
        pace["refined"] = pace["rough"] * cost_ratio(campaign)
    grids = tuple(_grid(campaign, grid, rows, pace[grid]) for grid in GRIDS)
    if campaign.plan.slides:
        grids += (_slides(campaign, store, rows),)
    # Before the screening is complete it is the share that fails on the rough grid.
    estimate = runs.phases_of(campaign, *(rows[grid] for grid in GRIDS)).estimate if rows["rough"].numbers else None
    return Progress(campaign.name, *_controller(store), grids, estimate)


def watched(folder: str | Path, every: float, *, estimator: Estimator | None = None) -> Iterator[str]:
    """The progress in words, again and again `every` (s) after the last, until nobody runs the campaign any more.

    Args:
        folder: as for `progress_of`.
        every: seconds between two readings.
        estimator: as for `progress_of`.

    Raises:
        ValueError: a folder that is none, or for no time in between.
    """
    if not 0 < every < float("inf"):
        raise ValueError(f"--watch {every:g}: give the seconds between two looks, above 0")
    while True:
        now = progress_of(folder, estimator=estimator)
        yield words(now)
        if not now.running:
            return
        time.sleep(every)


def planned_refined(campaign: Campaign, rough: Rows, refined: Rows) -> tuple[int, bool]:
    """Refined runs of the campaign in all, and whether they may become more.

    The budget, or where there is none the runs asked for so far.
    """
    most, done = campaign.estimator.budget(planned_rough(campaign)), len(refined.numbers)
    if most is not None:
        # Slides may have wanted more than the estimator.
        return max(most, done), False
    if len(rough.numbers) < planned_rough(campaign):
        return done + 1, True
    missing = runs.phases_of(campaign, rough, refined).next_runs(campaign.plan.samples, ())
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
            line += f", {grid.hourly:.3g} per hour"
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
    low, high = estimate.interval
    lines.append(
        f"  probability of failure so far  {estimate.probability:.3f}  "
        f"({estimate.level:.0%} interval {low:.3f} to {high:.3f}; {estimate.method})"
    )
    lines += [f"  note: {note}" for note in estimate.notes]
    return "\n".join(map(printable, lines))


def _grid(campaign: Campaign, grid: str, rows: dict[str, Rows], pace: float) -> GridProgress:
    mine = rows[grid]
    done = len(mine.numbers)
    planned, at_least = planned_rough(campaign), False
    if grid == "refined":
        planned, at_least = planned_refined(campaign, rows["rough"], rows["refined"])
    return GridProgress(
        grid,
        done,
        planned,
        at_least=at_least,
        hourly=3600 / pace if done > 1 and pace > 0 else float("nan"),
        seconds_left=max(planned - done, 0) * pace,
        broke_off=int(np.sum(mine.columns.get("broke_off", np.zeros(0)))),
        damaged=mine.damaged,
    )


def _slides(campaign: Campaign, store: Store, rows: dict[str, Rows]) -> GridProgress:
    """Failures that slide on to their end; of how many is known once the audit has ended."""
    phases = runs.phases_of(campaign, *(rows[grid] for grid in GRIDS))
    drawn = slides_of(campaign, phases, rows["refined"])
    pace = _pace(store, SLIDES, read_rows(store, SLIDES))
    done, planned = int(drawn.slid.sum()), drawn.planned
    return GridProgress(
        SLIDES, done, planned, at_least=phases.why_finished is None, hourly=3600 / pace if pace > 0 else float("nan"),
        seconds_left=(planned - done) * pace, broke_off=0, damaged=(),
    )  # fmt: skip


def _pace(store: Store, grid: str, rows: Rows) -> float:
    """Seconds from one finished sample to the next, by when their files were written."""
    ended = sorted(sample_path(store, grid, number).stat().st_mtime for number in rows.numbers)
    return seconds_per_sample(ended, rows.columns["seconds"].tolist())


def _controller(store: Store) -> tuple[str, bool]:
    """Who holds the folder, and whether that runs as far as can be seen.

    The lock itself is left alone: taking it, even for a moment, could refuse a controller.
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
