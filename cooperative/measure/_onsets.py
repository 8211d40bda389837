"""When soil lets go: the past of a run, reduced as it goes, so that no snapshot is stored."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from jaxmpm.support.values import by_value


@by_value
@dataclass(frozen=True)
class ReleaseHistory:
    """The past of one run, reduced to one number per particle and a few per pair of snapshots.

    Args:
        volume: (N,).
        failure_displacement: from which on soil has let go (m).
        times: of the snapshots seen so far (s).
        moved: how far each particle had moved by the last of them (N,) m.
        onset: when it let go (N,) s, linear between snapshots, inf if it has not.
    """

    volume: np.ndarray
    failure_displacement: float
    times: tuple[float, ...]
    moved: np.ndarray
    onset: np.ndarray

    @classmethod
    def start(cls, volume: np.ndarray, failure_displacement: float) -> Self:
        """A run at rest at time 0."""
        volume = np.asarray(volume, dtype=float)
        return cls(volume, failure_displacement, (0.0,), np.zeros(volume.shape), np.full(volume.shape, np.inf))

    def after(self, time: float, moved: np.ndarray) -> Self:
        """The past after one more snapshot, `moved` (N,) m at `time` (s). ValueError for times that do not ascend."""
        if not time > self.times[-1]:
            raise ValueError(f"times do not ascend: {time} s after {self.times[-1]} s, give snapshots in order")
        moved = np.asarray(moved, dtype=float)
        lets_go = np.isinf(self.onset) & (moved >= self.failure_displacement)
        onset = self.onset.copy()
        before, now = self.moved[lets_go], moved[lets_go]
        part = (self.failure_displacement - before) / (now - before)
        onset[lets_go] = self.times[-1] + part * (time - self.times[-1])
        return replace(self, times=(*self.times, time), moved=moved, onset=onset)


BINS = 4
"""Of the window over which the rate of release is averaged."""


def releases(
    motion: ReleaseHistory, sliding: np.ndarray, *, smallest_share: float, window: float, valley: float
) -> tuple[float, ...]:
    """Times (s) at which masses began to let go: one, or two where the rate of release has two peaks.

    Args:
        motion: past of the run.
        sliding: (N,) bool, the soil to look at.
        smallest_share: as in `cooperative.measure.ModeRules`.
        window: as there (s).
        valley: as there.
    """
    onset, volume = motion.onset[sliding], motion.volume[sliding]
    gone = np.isfinite(onset)
    if not gone.any():
        return ()
    start, width = float(onset[gone].min()), window / BINS
    bins = np.arange(start, onset[gone].max() + 2 * width, width)
    released = np.histogram(onset[gone], bins, weights=volume[gone])[0] / volume.sum()
    lowest = second_release(released, smallest_share, valley)
    if lowest is None:
        return (start,)
    return (start, float(onset[onset >= bins[lowest]].min()))


def second_release(released: np.ndarray, smallest_share: float, valley: float) -> int | None:
    """Number of the last bin of the valley between two pulses, None where there is one pulse.

    Args:
        released: share of the volume that lets go in each bin (k,), BINS of them in the window.
        smallest_share: as in `cooperative.measure.ModeRules`.
        valley: as there.
    """
    from scipy.ndimage import uniform_filter1d  # loads what only slides need

    rate = uniform_filter1d(released, BINS, mode="constant")
    before, after = np.cumsum(released), np.cumsum(released[::-1])[::-1]
    lesser = np.minimum(np.maximum.accumulate(rate), np.maximum.accumulate(rate[::-1])[::-1])
    between = (before >= smallest_share) & (after >= smallest_share) & (rate <= valley * lesser)
    if not between.any():
        return None
    lowest = np.where(between, rate, np.inf)
    return int(np.flatnonzero(lowest == lowest.min())[-1])
