"""A first phase that is the scene's own samples."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from cooperative.estimate._estimates import Estimate
from cooperative.estimate._protocol import Answers, Estimator, Population, Sampling, Screened, all_samples

POINTS = 60
"""At most so many points of a path."""


class SceneSamples(Estimator, Protocol):
    """Base of an estimator that refines some of the scene's own samples, each of which runs once on the rough grid.

    A class derives from it, is a frozen dataclass, and writes `name`, `check`, `budget`, `wanted`, `estimate`,
    `weights` and `why_finished`; what else it has it writes over. See `Estimator` for every member.
    """

    def rough_runs(self, sampling: Sampling) -> int:
        """One of each sample."""
        return sampling.samples

    def coefficients(self, sampling: Sampling, screened: Screened) -> np.ndarray:
        """Those of the scene's samples, (samples, modes)."""
        return sampling.draw()

    def population(self, sampling: Sampling, screened: Screened) -> Population | None:
        """The scene's samples."""
        return all_samples(sampling, screened)

    def path(self, population: Population, answers: Answers) -> list[Estimate]:
        """The estimate alone, without the way to it."""
        return [self.estimate(population, answers)]

    def beside(self, population: Population, answers: Answers) -> list[Estimate]:
        """None."""
        return []


def path_along(
    order: Sequence[int], step: int, estimator: Estimator, population: Population, answers: Answers
) -> list[Estimate]:
    """Estimates after every `step` of the samples that ran in this order, thinned to some 60, and after all of them."""
    every = step * max(1, -(-len(order) // (step * POINTS)))
    stops = sorted({*range(every, len(order), every), len(order)} - {0})
    return [estimator.estimate(population, {s: answers[s] for s in order[:stop]}) for stop in stops]
