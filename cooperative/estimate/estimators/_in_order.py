"""A second phase that refines the first samples: their order says nothing about them, so they are a random subset."""

from __future__ import annotations

from collections.abc import Collection
from typing import Protocol

from cooperative.estimate._estimates import Estimate
from cooperative.estimate._protocol import Answers, Population, Sampling
from cooperative.estimate.estimators._budgeted import Budgeted
from cooperative.estimate.estimators._first_answers import first_answers, without_gap
from cooperative.estimate.estimators._published import check_rule
from cooperative.estimate.estimators._scene_samples import SceneSamples, path_along

LOOK = 10
"""A target is looked at after so many samples, and again after as many."""


class InOrder(Budgeted, SceneSamples, Protocol):
    """Base of an estimator that refines the scene's first samples, as many as its budget or target asks for.
    k_t: n/N by the published rule is told beside, where the runs allow it."""

    @property
    def k_t(self) -> int | None:
        """None without the published rule."""

    def check(self, sampling: Sampling) -> None:
        """ValueError for a budget, target or k_t that makes no sense."""
        super().check(sampling)
        check_rule(self.k_t)

    def wanted(self, population: Population, answers: Answers, places: int, under_way: Collection[int]) -> list[int]:
        """The first samples, as many as the budget allows, or until the target is met at a multiple of 10."""
        runs, target, there = self.budget(population.size), self.target_cov, without_gap(answers)
        if target is not None:
            met = (
                stop
                for stop in range(LOOK, there + 1, LOOK)
                if self.estimate(population, {s: answers[s] for s in range(stop)}).cov <= target
            )
            runs = next(met, runs)
            # Not beyond the next look: what is run after it might not be needed.
            runs = min(runs, LOOK * (there // LOOK + 1))
        missing = [number for number in range(runs) if number not in answers and number not in under_way]
        return missing[: max(places - len(under_way), 0)]

    def path(self, population: Population, answers: Answers) -> list[Estimate]:
        """After every 10 samples, or more."""
        return path_along(range(without_gap(answers)), LOOK, self, population, answers)

    def weights(self, population: Population, answers: Answers) -> dict[int, float]:
        """Each run with an answer counts once."""
        return dict.fromkeys(first_answers(answers)[0], 1.0)
