"""Answers of the study and the published values: intervals, hours and verdicts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import t as student

from benchmarks.study.rows import CPU, Outcome, Run

FEW_RUNS = 8
"""Runs from which on the mean of their seconds has an interval."""


class Hours(NamedTuple):
    """What runs took: hours of one core, hours of a GPU."""

    core: float
    gpu: float

    def __str__(self) -> str:
        parts = [f"{hours:.3f} {kind}" for hours, kind in ((self.core, "core"), (self.gpu, "GPU")) if hours]
        return " + ".join(parts) or "none"


@dataclass(frozen=True)
class Answer:
    """One answer of this study.

    Attributes:
        value: the answer.
        interval: its limits.
        rests_on: the runs behind it, in words.
        hours: of these runs.
    """

    value: float
    interval: tuple[float, float]
    rests_on: str
    hours: Hours


@dataclass(frozen=True)
class Line:
    """One row of the table.

    Attributes:
        what: the row in words.
        name: of the value, None for a row without one.
        printed: the published value, None if there is none.
        answer: of this study, or the runs that are missing.
        cause: measured reasons of a difference.
        counted: interval of the published value, where it is a share that was counted.
    """

    what: str
    name: str | None
    printed: float | None
    answer: Answer | str
    cause: str = ""
    counted: tuple[float, float] | None = None

    def verdict(self) -> str:
        """Whether the published value lies in the interval, and the cause if it does not.

        Two shares that were both counted agree where their difference is at most the root of the sum of squares of the
        half widths between them. An interval of a share of 0 that holds the published value decides nothing.
        """
        if isinstance(self.answer, str):
            return f"not run yet: {self.answer}"
        value, (low, high) = self.answer.value, self.answer.interval
        if self.printed is None:
            return self.cause or "not published"
        if low - 1e-9 <= self.printed <= high + 1e-9:
            return "agrees" if value else f"not resolved: none was found, up to {high:.2g} may be"
        difference = f"{value - self.printed:+.3g}"
        if self.counted is not None:
            above = value > self.printed
            half_widths = (
                (value - low, self.counted[1] - self.printed)
                if above
                else (high - value, self.printed - self.counted[0])
            )
            reach = float(np.hypot(*half_widths))
            difference += f", where the two samples leave {reach:.3g} open"
            if abs(value - self.printed) <= reach:
                return f"agrees: {difference}"
        return f"differs by {difference}: {self.cause or 'cause not measured yet'}"

    def as_row(self) -> dict[str, Any]:
        """The line with the same columns for all."""
        answer = None if isinstance(self.answer, str) else self.answer
        return {
            "what": self.what,
            "published": "none" if self.printed is None else self.printed,
            "ours": "none" if answer is None else round(answer.value, 4),
            "low": "none" if answer is None else round(answer.interval[0], 4),
            "high": "none" if answer is None else round(answer.interval[1], 4),
            "rests on": "nothing" if answer is None else answer.rests_on,
            "hours": "none" if answer is None else str(answer.hours),
            "verdict": self.verdict(),
        }


def hours_of(rows: Mapping[Run, Outcome], **which: Any) -> Hours:
    """Hours of the runs whose fields have these values."""
    chosen = [o for run, o in rows.items() if all(getattr(run, name) == value for name, value in which.items())]
    core = sum(outcome.seconds for outcome in chosen if outcome.device == CPU)
    return Hours(core / 3600, (sum(outcome.seconds for outcome in chosen) - core) / 3600)


def paired_change(before: list[bool], after: list[bool]) -> tuple[float, tuple[float, float]]:
    """Change of a share between two answers for the same samples, with its interval.

    The adjusted Wald interval of Agresti and Min (2005), Statistics in Medicine 24, 729-740: half a sample more in each
    of the four kinds of pairs, so that pairs without any change still leave room for one.
    """
    first, second = np.asarray(before, float), np.asarray(after, float)
    gained, lost = float(np.sum(second > first)), float(np.sum(second < first))
    size = first.size + 2.0
    middle = (gained - lost) / size
    deviation = np.sqrt((gained + lost + 1.0) - (gained - lost) ** 2 / size) / size
    half = 1.959964 * deviation
    return (gained - lost) / first.size, (middle - half, middle + half)


def difference(first: Answer, last: Answer) -> tuple[float, tuple[float, float]]:
    """By how much the second of two independent answers is larger, with its interval, from their own intervals.

    Zou and Donner (2008), Statistics in Medicine 27, 1693-1702, DOI 10.1002/sim.3095: on each side the distances of the
    two limits that lie that way add up as squares.
    """
    change = last.value - first.value
    below = float(np.hypot(last.value - last.interval[0], first.interval[1] - first.value))
    above = float(np.hypot(last.interval[1] - last.value, first.value - first.interval[0]))
    return change, (change - below, change + above)


def rises(limits: tuple[float, float]) -> str:
    """An interval of a rise beside the published one, upwards."""
    return "rises, as published" if limits[0] > 0 else "falls, published as rising" if limits[1] < 0 else "not resolved"


def mean_seconds(seconds: np.ndarray) -> tuple[float, tuple[float, float], str]:
    """Mean of the seconds of some runs (n,) with its interval by Student's t; of too few runs the least and the most
    instead, and words that state it."""
    middle = float(seconds.mean())
    if seconds.size < FEW_RUNS:
        return middle, (float(seconds.min()), float(seconds.max())), "; the interval is from the least to the most"
    half = float(student.ppf(0.975, seconds.size - 1) * seconds.std(ddof=1) / np.sqrt(seconds.size))
    return middle, (middle - half, middle + half), ""
