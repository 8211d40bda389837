"""Which failures go on to the end of their slide, once a class was all that the audit asked for.

A class costs a tenth of a slide, so an audit may end its runs once they have failed and let a part of the failures
slide on. That part is a second probability sample, within the audit's: systematic, with chances in proportion to what
each run stands for in the audit, so that those that slide stand for about as much each. A total over the failures is
estimated without bias by the audit's weights over these chances. Sarndal, Swensson and Wretman (1992), Model Assisted
Survey Sampling, Sections 3.6.2 (systematic sampling) and 9.3 (two phases).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cooperative.estimate._phases import Phases

NOT_ASKED = "the scene asks for no slides (slides = 0)"
"""Why there are no consequences, in words, where refined runs only tell a class."""


def slide_chances(weight: np.ndarray, count: int | None) -> np.ndarray:
    """Chance of each failure to slide on (n,), in proportion to its weight (n,) and at most 1; they sum to `count`.

    None lets all slide, and so does a count of n or more.
    """
    if count is None or count >= np.count_nonzero(weight):
        return np.ones(weight.size)
    chance = np.zeros(weight.size)
    certain = np.zeros(weight.size, bool)
    while (left := count - certain.sum()) > 0:
        chance = np.where(certain, 1.0, left * weight / weight[~certain].sum())
        if not (chance > 1).any():
            break
        certain |= chance >= 1
    return np.where(certain, 1.0, chance)


def drawn_slides(number: np.ndarray, chance: np.ndarray, seed: int) -> np.ndarray:
    """Which failures slide on (n,) bool, each with its chance (n,); numbers, chances and seed alone decide.

    number: of the samples (n,). A comb of unit spacing falls at random on the chances laid end to end by number.
    """
    order = np.argsort(number)
    reached = np.cumsum(chance[order]) - np.random.default_rng([seed, 1]).random()
    before = np.concatenate([[-1.0], np.floor(reached)])
    drawn = np.zeros(chance.size, bool)
    drawn[order] = np.diff(before) > 0
    return drawn | (chance >= 1)


def slide_weights(weight: np.ndarray, failed: np.ndarray, chance: np.ndarray, slid: np.ndarray) -> np.ndarray:
    """What each run stands for in means and totals of what slides do (runs,).

    weight: of each run in the audit (runs,). failed: those that failed. chance: of those to slide on to their end.
    slid: those of them that did. Failures that did not slide on have none.
    """
    return np.where(slid, weight / np.where(slid, chance, 1.0), np.where(failed, 0.0, weight))


@dataclass(frozen=True)
class Slides:
    """Refined runs as means over failures see them, (runs,) each. failed: all failures. drawn: those that slide on to
    their end. slid: those that have. weight: what each run stands for, 0 for failures that did not slide."""

    failed: np.ndarray
    drawn: np.ndarray
    slid: np.ndarray
    weight: np.ndarray

    @classmethod
    def of(cls, phases: Phases, numbers: Sequence[int], ended: np.ndarray, count: int | None, seed: int) -> Slides:
        """Of the refined runs with these numbers. ended: whether each ran to its end (runs,)."""
        stands_for = phases.weights
        weight = np.array([stands_for[number] for number in numbers], float)
        failed = np.array([phases.answers[number] is True for number in numbers], bool)
        chance, drawn = np.ones(failed.size), failed.copy()
        chance[failed] = slide_chances(weight[failed], count)
        drawn[failed] = drawn_slides(np.asarray(numbers, int)[failed], chance[failed], seed)
        # One that slid for an earlier draw, before the campaign was allowed more runs, counts only if drawn again.
        slid = drawn & ended
        return cls(failed, drawn, slid, slide_weights(weight, failed, chance, slid))

    @property
    def notes(self) -> list[str]:
        """That not all failures slid on, or that none was asked to, in words."""
        if self.failed.sum() == self.slid.sum():
            return []
        if not self.drawn.any():
            return [
                f"{NOT_ASKED}: the {self.failed.sum()} refined failures ended once they had failed, and there are no "
                "modes, consequences, maps and fits"
            ]
        return [
            f"{self.slid.sum()} of {self.failed.sum()} refined failures slid on to their end; modes, consequences and "
            "fits are theirs, weighted for all. The others ended once they had failed"
        ]
