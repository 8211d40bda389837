"""The published rule, as an estimator and beside others."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from cooperative.estimate._estimates import Estimate, published
from cooperative.estimate._protocol import Answers, Population, Sampling
from cooperative.estimate._ranking import next_refined, rank_samples, stopping_rank
from cooperative.estimate.estimators._first_answers import monte_carlo_of_all
from cooperative.estimate.estimators._scene_samples import SceneSamples, path_along


@dataclass(frozen=True)
class Published(SceneSamples):
    """Refined runs in rank order until k_t in a row stand, and n/N: `published`."""

    name: ClassVar[str] = "published"
    k_t: int

    def check(self, sampling: Sampling) -> None:
        """ValueError for a k_t below 1."""
        check_rule(self.k_t)

    def budget(self, samples: int) -> None:
        """The stopping rule alone tells."""

    def wanted(self, population: Population, answers: Answers, places: int, under_way: Collection[int]) -> list[int]:
        """The next ranks that the rule needs whatever those under way turn out to be."""
        return next_refined(
            population.rough_displacement, answers, self.k_t, places, broke_off=population.broke_off,
            under_way=under_way,
        )  # fmt: skip

    def estimate(self, population: Population, answers: Answers) -> Estimate:
        """n/N."""
        return published(population.rough_displacement, answers, self.k_t, broke_off=population.broke_off)

    def path(self, population: Population, answers: Answers) -> list[Estimate]:
        """Down the ranks."""
        ranked = [sample for sample in _order(population).tolist() if sample in answers]
        return path_along(ranked, 1, self, population, answers)

    def weights(self, population: Population, answers: Answers) -> dict[int, float]:
        """Each run with an answer counts once."""
        return {sample: 1.0 for sample, failed in answers.items() if failed is not None}

    def beside(self, population: Population, answers: Answers) -> list[Estimate]:
        """Plain Monte Carlo where every sample ran."""
        return monte_carlo_of_all(population, answers)

    def why_finished(self, population: Population, answers: Answers) -> str | None:
        """All ran, or k_t in a row stand."""
        if self.wanted(population, answers, 1, ()):
            return None
        everything = len(answers) == population.size
        return "all samples ran on the refined grid" if everything else f"{self.k_t} samples in a row stand"


def check_rule(k_t: int | None) -> None:
    """ValueError for a k_t below 1."""
    if k_t is not None and k_t < 1:
        raise ValueError(f"[campaign] k_t = {k_t}: give 1 or more")


def published_where_met(k_t: int | None, population: Population, answers: Answers) -> list[Estimate]:
    """n/N, where a k_t is given and the runs meet its rule."""
    if k_t is None or stopping_rank(_order(population), answers, k_t) is None:
        return []
    return [Published(k_t).estimate(population, answers)]


def _order(population: Population) -> np.ndarray:
    return rank_samples(population.rough_displacement, population.broke_off).order
