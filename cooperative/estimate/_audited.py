"""Estimators that audit the answer of the rough grid: two-phase sampling, subset simulation.

Their refined runs are drawn at random where the rough result leaves most doubt.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from cooperative.estimate._audit import AuditPlan
from cooperative.estimate._estimates import Estimate
from cooperative.estimate._plain import (
    Budgeted,
    check_all_run,
    check_rule,
    monte_carlo_of_all,
    out_of_reach,
    published_where_met,
    usual_budget,
)
from cooperative.estimate._protocol import Answers, Failures, Population, Sampling, Screened
from cooperative.estimate._subset import SubsetPlan, replayed
from cooperative.estimate._twophase import failures, next_audit, path, sample_weights, two_phase


@dataclass(frozen=True)
class Audited(Budgeted):
    """Base of an estimator whose refined runs are an audit of its first phase, with the given waves.

    Args:
        refined_runs: budget, None for the usual one.
        target_cov: coefficient of variation at which to stop before the budget is spent, None for none.
        seed: of the draws.
    """

    growth: ClassVar[float] = AuditPlan.growth
    exploration: ClassVar[int] = AuditPlan.exploration
    seed: int = field(default=0, kw_only=True)

    def audit(self, population: Population) -> AuditPlan:
        """Budget and waves of the refined runs."""
        if population.shared is not None and population.shared.runs is not None:
            return AuditPlan(population.shared.runs, self.seed, growth=self.growth, exploration=self.exploration)
        return AuditPlan(
            self.budget(population.size), self.seed, target_cov=self.target_cov, growth=self.growth,
            exploration=self.exploration,
        )  # fmt: skip

    def next_runs(self, population: Population, answers: Answers, lanes: int, under_way: Collection[int]) -> list[int]:
        """The rest of the wave; nothing once a target alone is seen to be out of reach."""
        audit = self.audit(population)
        numbers = [sample for sample in next_audit(population, answers, audit) if sample not in under_way]
        if numbers and audit.target_cov is not None and self.refined_runs is None:
            estimate = two_phase(population, answers, audit)
            if estimate.refined_runs >= usual_budget(population.size) and out_of_reach(estimate, audit.target_cov):
                return []
        return numbers

    def why_finished(self, population: Population, answers: Answers) -> str | None:
        """As for any budget; in a sweep with a target, that the base's runs are made."""
        why = super().why_finished(population, answers)
        if why is not None and population.shared is not None and population.shared.runs is not None:
            return "the refined runs that the base of the sweep took are made"
        return why

    def estimate(self, population: Population, answers: Answers) -> Estimate:
        """From the complete waves."""
        return two_phase(population, answers, self.audit(population))

    def path(self, population: Population, answers: Answers) -> list[Estimate]:
        """After every complete wave."""
        return path(population, answers, self.audit(population))

    def weights(self, population: Population, answers: Answers) -> dict[int, float]:
        """Those of the ordered draws."""
        return sample_weights(population, answers, self.audit(population))

    def failures(self, population: Population, answers: Answers) -> Failures:
        """By the audit's model and its draws."""
        return failures(population, answers, self.audit(population))


@dataclass(frozen=True)
class TwoPhase(Audited):
    """All samples on the rough grid, an audited few on the refined one: `two_phase`.

    Args:
        refined_runs: budget. None for a fifth of the samples, at least 20, or with a target for all.
        target_cov: coefficient of variation at which to stop before the budget is spent, None for none.
        seed: of the draws.
        k_t: of the published rule, whose n/N stands beside the estimate where the runs allow it; None for none.
    """

    name: ClassVar[str] = "two-phase"
    k_t: int | None = None

    def check(self, sampling: Sampling) -> None:
        """ValueError for a budget, target, k_t or number of samples that an audit cannot do with."""
        super().check(sampling)
        check_rule(self.k_t)
        if sampling.samples < 10:
            raise ValueError(f"samples = {sampling.samples}: give 10 or more for the audit, or estimator = 'published'")
        if sampling.rough_samples is not None and not 10 <= sampling.rough_samples <= sampling.samples:
            raise ValueError(
                f"rough_samples = {sampling.rough_samples} of samples = {sampling.samples}: give 10 to "
                f"{sampling.samples}"
            )

    def beside(self, population: Population, answers: Answers) -> list[Estimate]:
        """n/N where its rule is met, plain Monte Carlo where every sample ran; neither of zones."""
        if population.zones is not None:
            return []
        return [*published_where_met(self.k_t, population, answers), *monte_carlo_of_all(population, answers)]


@dataclass(frozen=True)
class Subset(Audited):
    """Subset simulation on the rough grid, for rare failures, and the audit of its samples: `subset_simulation`.

    The scene's `samples` are per level, in all replicates together. No other estimator stands beside it: none applies
    to samples that weigh differently.

    Args:
        refined_runs: budget. None for a fifth of the samples, at least 20, or with a target for all.
        target_cov: coefficient of variation at which to stop before the budget is spent, None for none.
        seed: of all draws.
        levels: as in `SubsetPlan`.
        replicates: as in `SubsetPlan`.
    """

    name: ClassVar[str] = "subset"
    levels: int | None = None
    replicates: int | None = None
    growth: ClassVar[float] = 0.5
    # No affordable number of even draws rules out a rare failure, so the ranks are trusted, as the levels trust them.
    exploration: ClassVar[int] = 0

    def plan(self, sampling: Sampling) -> SubsetPlan:
        """Subset simulation with these settings."""
        replicates = SubsetPlan.replicates if self.replicates is None else self.replicates
        levels = SubsetPlan.levels if self.levels is None else self.levels
        return SubsetPlan(sampling.samples // replicates, levels, replicates, seed=self.seed)

    def check(self, sampling: Sampling) -> None:
        """ValueError for levels that chains do not fill, a budget or target out of range, or a coarse grid."""
        super().check(sampling)
        check_all_run(self, sampling)
        replicates = SubsetPlan.replicates if self.replicates is None else self.replicates
        if replicates < 2 or (self.levels is not None and self.levels < 1):
            raise ValueError(f"replicates = {replicates}, levels = {self.levels}: give 2 or more, 1 or more")
        if sampling.samples % (10 * replicates) or sampling.samples < 20 * replicates:
            raise ValueError(
                f"samples = {sampling.samples} per level with {replicates} replicates: give a multiple of "
                f"{10 * replicates}, at least {20 * replicates}"
            )
        if sampling.screening_stop is not None:
            raise ValueError("screening_stop cuts off what subset simulation ranks by: leave it out")

    def rough_runs(self, sampling: Sampling) -> int:
        """Those of all levels."""
        return self.plan(sampling).rough_runs

    def coefficients(self, sampling: Sampling, screened: Screened) -> np.ndarray:
        """Those of the levels and steps of chains that the results so far lead to (n, modes)."""
        return replayed(self.plan(sampling), sampling.modes(), screened)[0]

    def population(self, sampling: Sampling, screened: Screened) -> Population | None:
        """Samples of all levels, weighted; None while some are to come."""
        samples = replayed(self.plan(sampling), sampling.modes(), screened)[1]
        if samples is None:
            return None
        return Population(
            samples.rough_displacement, weight=samples.weight, replicate=samples.replicate, chains=samples.chains,
            number=samples.number, failure_displacement=sampling.failure_displacement,
        )  # fmt: skip
