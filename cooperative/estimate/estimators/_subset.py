"""Subset simulation on the rough grid, and the audit of its samples."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from cooperative.estimate._audit import AuditPlan
from cooperative.estimate._estimates import Estimate
from cooperative.estimate._protocol import Answers, Population, Sampling, Screened
from cooperative.estimate._subset import SubsetPlan, SubsetSamples, subset_simulation
from cooperative.estimate.estimators._audited import Audited


@dataclass(frozen=True)
class Subset(Audited):
    """Subset simulation on the rough grid, for rare failures, and the audit of its samples: `subset_simulation`.

    The scene's `samples` are per level, in all replicates together. levels, replicates: as in `SubsetPlan`.
    refined_runs, target_cov: as for `TwoPhase`. seed: of all draws.
    """

    name: ClassVar[str] = "subset"
    refined_runs: int | None = None
    target_cov: float | None = None
    levels: int | None = None
    replicates: int | None = None
    seed: int = 0

    def plan(self, sampling: Sampling) -> SubsetPlan:
        """Subset simulation with these settings."""
        usual = SubsetPlan()
        replicates = usual.replicates if self.replicates is None else self.replicates
        levels = usual.levels if self.levels is None else self.levels
        return SubsetPlan(sampling.samples // replicates, levels, replicates, seed=self.seed)

    def check(self, sampling: Sampling) -> None:
        """ValueError for levels that chains do not fill, or a budget or target that an audit cannot do with."""
        super().check(sampling)
        replicates = SubsetPlan.replicates if self.replicates is None else self.replicates
        if replicates < 2 or (self.levels is not None and self.levels < 1):
            raise ValueError(f"[campaign] replicates = {replicates}, levels = {self.levels}: give 2 or more, 1 or more")
        if sampling.samples % (10 * replicates) or sampling.samples < 20 * replicates:
            raise ValueError(
                f"[campaign] samples = {sampling.samples} per level with {replicates} replicates: give a multiple of "
                f"{10 * replicates}, at least {20 * replicates}"
            )
        if sampling.screening_stop is not None:
            raise ValueError("[campaign] screening_stop cuts off what subset simulation ranks by: leave it out")

    def rough_runs(self, sampling: Sampling) -> int:
        """Those of all levels."""
        return self.plan(sampling).rough_runs

    def coefficients(self, sampling: Sampling, screened: Screened) -> np.ndarray:
        """Those of the levels and steps of chains that the results so far lead to (n, modes)."""
        return _replay(self.plan(sampling), sampling.modes(), screened)[0]

    def population(self, sampling: Sampling, screened: Screened) -> Population | None:
        """Samples of all levels, weighted; None while some are to come."""
        found = _replay(self.plan(sampling), sampling.modes(), screened)[1]
        if found is None:
            return None
        return Population(
            found.rough_displacement, weight=found.weight, replicate=found.replicate, number=found.number,
            failure_displacement=sampling.failure_displacement,
        )  # fmt: skip

    def audit(self, population: Population) -> AuditPlan:
        """How the refined runs are spent. The ranks are trusted, as the levels trust them: no affordable number of even
        draws rules out a rare failure."""
        runs = self.budget(population.size)
        return AuditPlan(runs, seed=self.seed, target_cov=self.target_cov, growth=0.5, proving=0)

    def beside(self, population: Population, answers: Answers) -> list[Estimate]:
        """None: no other estimator knows samples that weigh differently."""
        return []


class _NotYet(Exception):
    """A rough result that subset simulation asks for is not there yet."""


def _replay(plan: SubsetPlan, modes: int, screened: Screened) -> tuple[np.ndarray, SubsetSamples | None]:
    """Subset simulation gone through again: coefficients asked for (n, modes), and its samples once it is complete."""
    asked: list[np.ndarray] = [np.zeros((0, modes))]

    def rough(xi: np.ndarray) -> np.ndarray:
        first = sum(map(len, asked))
        asked.append(xi)
        numbers = range(first, first + len(xi))
        if not all(number in screened for number in numbers):
            raise _NotYet
        return np.array([np.nan if screened[n][1] else screened[n][0] for n in numbers])

    try:
        found = subset_simulation(rough, modes, plan)
    except _NotYet:
        found = None
    return np.concatenate(asked), found
