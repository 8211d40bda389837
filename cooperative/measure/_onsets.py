"""When soil lets go: the past of a run, reduced as it goes, so that no snapshot is stored."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import ArrayLike

from jaxmpm.support.values import by_value


@by_value
@dataclass(frozen=True)
class ReleaseHistory:
    """The past of one run, reduced to a few numbers per particle, which stay on the device, and one per snapshot.

    Args:
        volume: (N,).
        failure_displacement: from which on soil has let go (m).
        times: of the snapshots seen so far (s), the first at rest.
        moved: how far each particle had moved by the last of them (N,) m.
        released: snapshot by which it had let go (N,), a place in `times`; 0 if it has not.
        around: how far it had moved by the snapshots before and after it let go (2, N) m.
    """

    volume: np.ndarray
    failure_displacement: float
    times: tuple[float, ...]
    moved: ArrayLike
    released: ArrayLike
    around: ArrayLike

    @classmethod
    def start(cls, volume: np.ndarray, failure_displacement: float) -> Self:
        """A run at rest at time 0."""
        volume, rest = np.asarray(volume, dtype=float), np.zeros(np.shape(volume), np.float32)
        return cls(volume, failure_displacement, (0.0,), rest, rest.astype(np.int32), np.stack([rest, rest]))

    def after(self, time: float, moved: ArrayLike) -> Self:
        """The past after one more snapshot, `moved` (N,) m at `time` (s). ValueError for times that do not ascend."""
        if not time > self.times[-1]:
            raise ValueError(f"times do not ascend: {time} s after {self.times[-1]} s, give snapshots in order")
        moved = jnp.asarray(moved)
        released, around = _let_go(
            self.moved, self.released, self.around, moved, len(self.times), self.failure_displacement
        )
        return replace(self, times=(*self.times, time), moved=moved, released=released, around=around)

    @property
    def onset(self) -> np.ndarray:
        """When each particle let go (N,) s, linear between snapshots, inf if it has not."""
        released, (before, now) = np.asarray(self.released), np.asarray(self.around, dtype=float)
        gone, times, onset = released > 0, np.asarray(self.times), np.full(released.shape, np.inf)
        earlier, later = times[released[gone] - 1], times[released[gone]]
        part = (self.failure_displacement - before[gone]) / (now[gone] - before[gone])
        onset[gone] = earlier + part * (later - earlier)
        return onset


@jax.jit
def _let_go(
    before: Array, released: Array, around: Array, moved: Array, snapshot: int, limit: float
) -> tuple[Array, Array]:
    """`released` and `around` of a history after one more snapshot."""
    lets_go = (released == 0) & (moved >= limit)
    return jnp.where(lets_go, snapshot, released), jnp.where(lets_go, jnp.stack([before, moved]), around)


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
