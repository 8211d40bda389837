"""Which failures go on to the end of their slide, and how many failures each slide stands for.

An audit looks where it doubts. Slopes that fail for sure it seldom draws, and these slide farthest: means of what
slides do, weighed by the audit's draws, rest on the few of them that it met. Two things put that right.

Slides are drawn along the ranks, among all samples, as densely as failures lie there by the audit's model: a class that
is known counts as 0 or 1. A sample that is drawn and has no class yet runs to its end; if it stands, the next takes its
place. The order is that of a golden section sequence along the modelled failures laid end to end by rank, whose points
lie evenly however many of them there are (Kronecker sequences: Niederreiter 1992, Random Number Generation and
Quasi-Monte Carlo Methods, Section 3.1). It follows from the audit and the seed alone, so that the slides do not depend
on what ran at once. `slides` = "all" draws none: all failures of the audit slide.

Each slide stands for the failures whose ranks are nearest to its own, as the audit counts them there: the totals of its
difference estimator over such zones, which add up to P_f. Neither draw looks at what a slide does, but at ranks and
classes alone, so the failures that slid near a rank are like those near it that did not (Rubin 1976, Biometrika 63,
581-592, DOI 10.1093/biomet/63.3.581). Hence all slides count, whatever draw they slid for. Post-stratification:
Sarndal, Swensson and Wretman (1992), Model Assisted Survey Sampling, Section 7.6; difference estimator: Section 6.3.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cooperative.estimate._audit import FAR_DOWN
from cooperative.estimate._phases import Phases
from cooperative.estimate._protocol import Failures

NOT_ASKED = "the scene asks for no slides (slides = 0)"
"""Why there are no consequences, in words, where refined runs only tell a class."""

GOLDEN = (np.sqrt(5) - 1) / 2


def slide_order(size: np.ndarray, seed: int) -> np.ndarray:
    """Ranks in the order in which they are to slide (n,), those with a size above 0. size: failures expected of each
    rank (N,). A part of the order from its start on lies along the ranks as densely as the sizes do."""
    reached, points = np.cumsum(size), np.arange(32 * size.size)
    at = (np.random.default_rng([seed, 1]).random() + GOLDEN * points) % 1 * reached[-1]
    hit, first = np.unique(np.searchsorted(reached, at, side="right"), return_index=True)
    met = hit[np.argsort(first)]
    met = met[met < size.size]
    # What 32 points for each rank have not met comes last, the largest first.
    rest = np.setdiff1d(np.flatnonzero(size > 0), met)
    return np.concatenate([met[size[met] > 0], rest[np.argsort(-size[rest], kind="stable")]])


def zone_weights(failures: Failures, slid: np.ndarray) -> np.ndarray:
    """How many failures each slide stands for (n,), as a share of all samples, at least itself. slid: its rank (n,),
    ascending."""
    reached = np.cumsum(failures.size) - failures.size / 2
    borders = (reached[slid][1:] + reached[slid][:-1]) / 2
    counted = np.bincount(np.searchsorted(borders, reached), failures.count, slid.size)
    return np.maximum(counted, failures.weight[slid])


@dataclass(frozen=True)
class Slides:
    """Refined runs as means over failures see them, (runs,) each. failed: all failures. slid: those that slid on to
    their end. weight: what each run stands for, 0 for failures that did not slide. wanted: samples that are to slide
    still, as far as is known: failures that wait, and samples that have not run refined yet."""

    failed: np.ndarray
    slid: np.ndarray
    weight: np.ndarray
    wanted: tuple[int, ...]

    @classmethod
    def of(cls, phases: Phases, numbers: Sequence[int], ended: np.ndarray, count: int | None, seed: int) -> Slides:
        """Of the refined runs with these numbers. ended: whether each ran to its end (runs,). count: slides asked for,
        None for all failures of the audit."""
        stands_for = phases.weights
        weight = np.array([stands_for[number] for number in numbers], float)
        failed = np.array([phases.answers[number] is True for number in numbers], bool)
        slid = failed & ended if count != 0 else np.zeros(failed.size, bool)
        failures = phases.failures
        if failures is None:
            return cls(failed, slid, np.where(failed & ~slid, 0.0, weight), ())
        weight = np.where(failed, 0.0, weight)
        # A sample at which a chain stood still has several ranks.
        place = {number: at for at, number in enumerate(numbers)}
        ranks = np.array([r for r, n in enumerate(failures.number) if n in place and slid[place[n]]], int)
        if ranks.size:
            share = zone_weights(failures, ranks)
            share *= phases.estimate.probability / share.sum()
            np.add.at(weight, [place[n] for n in failures.number[ranks]], share)
        return cls(failed, slid, weight, _wanted(phases, failures, set(np.array(numbers)[slid]), count, seed))

    @property
    def planned(self) -> int:
        """Slides that there are in the end, as far as is known."""
        return int(self.slid.sum()) + len(self.wanted)

    @property
    def notes(self) -> list[str]:
        """That not all failures slid on, or that none was asked to, in words."""
        if self.failed.sum() == self.slid.sum():
            return []
        if not self.planned:
            return [
                f"{NOT_ASKED}: the {self.failed.sum()} refined failures ended once they had failed, and there are no "
                "modes, consequences, maps and fits"
            ]
        return [
            f"{self.slid.sum()} of {self.failed.sum()} refined failures slid on to their end; modes, consequences and "
            "fits are theirs, weighted for all. The others ended once they had failed"
        ]


def _wanted(phases: Phases, failures: Failures, slid: set[int], count: int | None, seed: int) -> tuple[int, ...]:
    """The next in order that fail, or may, until so many slide; those that stand or gave no answer are passed over."""
    size = np.where(failures.chance < FAR_DOWN, 0.0, failures.size)
    found: dict[int, None] = {}
    if not count or not size.any():
        return ()
    for number in failures.number[slide_order(size, seed)].tolist():
        if len(slid) + len(found) >= count:
            break
        if number not in slid and phases.answers.get(number, True):
            found[number] = None
    return tuple(found)
