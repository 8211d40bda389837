"""When soil lets go: the past of a run, reduced as it goes, so that no snapshot is stored."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np


@dataclass(frozen=True)
class Motion:
    """The past of one run, reduced to one number per particle and a few per pair of snapshots.

    Args:
        volume: (N,).
        failure_displacement: from which on soil has let go (m).
        times: of the snapshots seen so far (s).
        moved: how far each particle had moved by the last of them (N,) m.
        onset: when it let go (N,) s, linear between snapshots, inf if it has not.
        seen: number of the first snapshot that shows it (N,), -1 if none has.
        travel: per interval between snapshots, (k,) each, how much farther the soil first seen to have let go at
            snapshot 0, 1 ... k - 1 moved in it, times its volume. What soil does before it lets go, less than that, is
            no part.
    """

    volume: np.ndarray
    failure_displacement: float
    times: tuple[float, ...]
    moved: np.ndarray
    onset: np.ndarray
    seen: np.ndarray
    travel: tuple[np.ndarray, ...] = ()

    @classmethod
    def start(cls, volume: np.ndarray, failure_displacement: float) -> Self:
        """A run at rest at time 0."""
        volume = np.asarray(volume, dtype=float)
        nothing = np.zeros(volume.shape)
        return cls(
            volume,
            failure_displacement,
            (0.0,),
            nothing,
            np.full(volume.shape, np.inf),
            np.full(volume.shape, -1, np.int32),
        )

    def after(self, time: float, moved: np.ndarray) -> Self:
        """The past after one more snapshot, `moved` (N,) m at `time` (s). ValueError for times that do not ascend."""
        if not time > self.times[-1]:
            raise ValueError(f"times do not ascend: {time} s after {self.times[-1]} s, give snapshots in order")
        moved = np.asarray(moved, dtype=float)
        number = len(self.times)
        lets_go = (self.seen < 0) & (moved >= self.failure_displacement)
        onset, seen = self.onset.copy(), self.seen.copy()
        before, now = self.moved[lets_go], moved[lets_go]
        part = (self.failure_displacement - before) / (now - before)
        onset[lets_go] = self.times[-1] + part * (time - self.times[-1])
        seen[lets_go] = number
        gone = seen >= 0
        farther = self.volume[gone] * (moved[gone] - self.moved[gone])
        travel = np.bincount(seen[gone], farther, number + 1)
        return replace(
            self, times=(*self.times, time), moved=moved, onset=onset, seen=seen, travel=(*self.travel, travel)
        )


def releases(
    motion: Motion, sliding: np.ndarray, *, smallest_share: float, lull: float, lull_share: float, slowed: float
) -> tuple[float, ...]:
    """Times (s) at which masses began to let go: one, or two if a second followed when the first had slowed.

    Args:
        motion: past of the run.
        sliding: (N,) bool, the soil to look at. Two releases are separated by a lull, and by the mean speed of the
            first mass; the limits are those of `cooperative.modes.ModeRules`.
        smallest_share: as in `ModeRules`.
        lull: as in `ModeRules` (s).
        lull_share: as in `ModeRules`.
        slowed: as in `ModeRules`.
    """
    onset, volume, seen = motion.onset[sliding], motion.volume[sliding], motion.seen[sliding]
    order = np.argsort(onset, kind="stable")
    at, share = onset[order], np.cumsum(volume[order]) / volume.sum()
    finite = int(np.isfinite(at).sum())
    if not finite:
        return ()
    # Shares released up to each onset, and up to one lull later.
    resumed = np.searchsorted(at, at + lull, side="left")
    by_then = share[np.maximum(resumed - 1, 0)]
    lulls = (
        (share >= smallest_share)
        & (1 - by_then >= smallest_share)
        & (by_then - share <= lull_share)
        & (resumed < finite)
    )
    first, again = seen[order][lulls], at[np.minimum(resumed[lulls], at.size - 1)]
    during = np.searchsorted(motion.times[1:], again, side="right")
    for snapshot, interval in dict.fromkeys(zip(first.tolist(), during.tolist(), strict=True)):
        if _has_slowed(motion, snapshot, max(interval, 1), slowed):
            return (float(at[0]), float(again[(first == snapshot) & (during == interval)][0]))
    return (float(at[0]),)


def _has_slowed(motion: Motion, snapshot: int, intervals: int, share: float) -> bool:
    """Whether the soil released up to a snapshot has slowed in the last of the first `intervals` intervals.

    Its mean speed is then at most `share` of its peak so far.
    """
    travelled = np.array([travel[: snapshot + 1].sum() for travel in motion.travel[:intervals]])
    speed = travelled / np.diff(motion.times[: intervals + 1])
    return bool(speed[-1] <= share * speed.max())
