"""Probability of failure against time: when samples fail first, and estimates at each time from the same samples."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from cooperative.estimate._estimates import LEVEL, Estimate, with_variance
from cooperative.estimate._formulas import control_variate, monte_carlo

RECORD = 1e-3
"""Share by which a factor of safety falls below all before, for a time at which a sample may fail first."""


@dataclass(frozen=True)
class Bracket:
    """What is known of the first failure of a sample among so many times, in their order.

    A sample that has failed at a time counts as failed after it, so that its first failure is found by bisection.

    Args:
        count: of the times.
        stands: the last one at which it is known to stand, -1 for none.
        fails: the first one at which it is known to fail, `count` for none.
        asked: how often.
        lost: whether an answer is missing, since a run broke off.
    """

    count: int
    stands: int = -1
    fails: int = -1
    asked: int = 0
    lost: bool = False

    @classmethod
    def of(cls, count: int) -> Bracket:
        """Of a sample of which nothing is known."""
        return cls(count, fails=count)

    @property
    def known(self) -> bool:
        """Whether nothing is left to ask."""
        return self.lost or self.fails == self.stands + 1

    def told(self, at: int, failed: bool | None) -> Bracket:
        """With the answer at a time, None for a run that broke off."""
        now = replace(self, asked=self.asked + 1)
        if failed is None:
            return replace(now, lost=True)
        return replace(now, fails=min(self.fails, at)) if failed else replace(now, stands=max(self.stands, at))

    def next(self, guess: int) -> int | None:
        """The time to ask next, None where all is known.

        The guess is asked first, then its neighbour, which settles a right guess; then the last time, and halves.

        Args:
            guess: of the first failure, `count` for none.
        """
        if self.known:
            return None
        last = self.count - 1
        if not self.asked:
            return min(guess, last)
        if self.fails == self.count:
            return self.stands + 1 if self.asked == 1 else last
        return self.fails - 1 if self.asked == 1 else (self.stands + self.fails) // 2


def record_lows(factors: np.ndarray) -> list[int]:
    """Times at which a sample may fail first: the first one, and those with a lower factor of safety than all before.

    Args:
        factors: of safety at the times (m,); one that is not finite is no reason to leave its time out.

    Returns:
        Their numbers.
    """
    lows, least = [0], factors[0]
    for at, factor in enumerate(factors[1:], 1):
        if not np.isfinite(factor) or not np.isfinite(least) or factor < (1 - RECORD) * least:
            lows.append(at)
            least = factor
    return lows


def first_guess(factors: np.ndarray, lows: Sequence[int], critical: float = 1.0) -> int:
    """Which of the record lows is the first below a critical factor of safety.

    Args:
        factors: of safety at the times (m,).
        lows: as of `record_lows`.
        critical: factor.

    Returns:
        Its place among the lows; their number where none is.
    """
    below = [n for n, at in enumerate(lows) if factors[at] < critical]
    return below[0] if below else len(lows)


def critical_factor(factors: Sequence[float], failed: Sequence[bool]) -> float:
    """The factor of safety that parts runs which failed from those which stood with the fewest errors, next to 1.

    Limit equilibrium and the solver differ by their methods and by how far soil moves before it counts as failed.

    Args:
        factors: of the runs, by slices.
        failed: whether each failed.

    Returns:
        Factor; 1 without any run.
    """
    pairs = [(f, bad) for f, bad in zip(factors, failed, strict=True) if np.isfinite(f)]
    if not pairs:
        return 1.0
    ordered = np.sort([f for f, _ in pairs])
    tried = np.array([ordered[0], *(ordered[1:] + ordered[:-1]) / 2, ordered[-1] * (1 + RECORD), 1.0])
    errors = [sum(bad != (f < split) for f, bad in pairs) for split in tried]
    best = tried[np.array(errors) == min(errors)]
    return float(best[np.argmin(np.abs(np.log(best)))])


def in_time(
    first: np.ndarray,
    refined: Mapping[int, int] | None,
    factors: np.ndarray | None,
    times: int,
    *,
    level: float = LEVEL,
) -> list[Estimate]:
    """The probability that a slope has failed by each time.

    All times have the same samples. Where only some of these ran on the refined grid, the others count by their rough
    answers, corrected by what both grids say of the former (`control_variate`).

    Args:
        first: number of the time (n,) at which each sample fails first on the rough grid, `times` for never, -1 where a
            run broke off.
        refined: the same on the refined grid, of samples drawn without regard to their rough answer; None without one.
        factors: of safety of each sample at each time (n, times), by which samples of one class rank; None for none.
        times: number of the times.
        level: confidence level of the interval at each time.

    Returns:
        An estimate for each time.

    Raises:
        ValueError: No run has an answer, or there are too few refined ones.
    """
    first = np.asarray(first)
    if refined is None:
        failed_at = first[first >= 0]
        return [monte_carlo(failed_at <= at, level=level) for at in range(times)]
    answered = {sample: when for sample, when in refined.items() if when >= 0}
    if len(answered) == first.size:
        when = np.array([answered[sample] for sample in range(first.size)])
        return [monte_carlo(when <= at, level=level) for at in range(times)]
    estimates = []
    for at in range(times):
        failed = {sample: when <= at for sample, when in answered.items()}
        estimate = control_variate(_scores(first, factors, at, times), failed, level=level)
        estimates.append(_allowing(estimate, first, failed, at))
    return _rising(estimates)


def _allowing(estimate: Estimate, first: np.ndarray, failed: Mapping[int, bool], at: int) -> Estimate:
    """The estimate, whose interval allows for samples on which the grids differ and that the audit may have missed.

    Few or none of the audited samples differ where the rough grid is good, and their scatter then shows too little of
    itself. The share that differs is at least Laplace's, one more of two more.
    """
    differ = sum((first[sample] <= at) != fails for sample, fails in failed.items() if first[sample] >= 0)
    share = (differ + 1) / (len(failed) + 2)
    least = share * (1 - share) * (1 / len(failed) - 1 / first.size)
    if estimate.audit_variance >= least:
        return estimate
    chance = estimate.probability
    wider = with_variance(
        estimate.method, chance, chance * (1 - chance) / first.size + least, estimate.refined_runs,
        freedom=len(failed) - 1, audit_variance=least, level=estimate.level, notes=estimate.notes,
    )  # fmt: skip
    (low, high), (also_low, also_high) = estimate.interval, wider.interval
    return replace(wider, interval=(min(low, also_low), max(high, also_high)))


def _rising(estimates: Sequence[Estimate]) -> list[Estimate]:
    """Estimates that rise with time, as the probability does: their values and the ends of their intervals in order.

    Source: Chernozhukov, Fernandez-Val and Galichon (2009), doi:10.1093/biomet/asp030 (rearrangement brings the
    estimate of a monotone function, and its band, no farther from it).
    """
    chances = np.sort([estimate.probability for estimate in estimates])
    low, high = np.sort([estimate.interval for estimate in estimates], axis=0).T
    return [
        replace(estimate, probability=float(chance), interval=(float(lower), float(upper)))
        for estimate, chance, lower, upper in zip(estimates, chances, low, high, strict=True)
    ]


def _scores(first: np.ndarray, factors: np.ndarray | None, at: int, times: int) -> np.ndarray:
    """A displacement that ranks the samples at a time: above 1 where one has failed by then, nan where a run broke off.

    Those that failed early rank first; of samples that fail at one time, or have not yet, that with the lower factor.
    """
    safe = 0.5 if factors is None else np.nanmin(factors[:, : at + 1], axis=1)
    safe = np.clip(np.nan_to_num(safe, nan=1.0), 1e-3, 1e3) / 1e3
    earlier = np.where(first < 0, np.nan, (times - first).astype(float))
    has = (first >= 0) & (first <= at)
    return np.where(first < 0, np.nan, np.where(has, 1 + earlier + (1 - safe), (1 - safe) * 0.9))
