"""Estimators that spend a number of refined runs, or fewer where a target is met before."""

from __future__ import annotations

from typing import Protocol

from cooperative.estimate._estimates import Estimate, after_more_runs
from cooperative.estimate._protocol import Answers, Estimator, Population, Sampling


class Budgeted(Estimator, Protocol):
    """Base of an estimator with a budget: refined_runs, or what is usual, and target_cov, the coefficient of variation
    at which to stop before it is spent."""

    @property
    def refined_runs(self) -> int | None:
        """Refined runs allowed, None for what is usual."""

    @property
    def target_cov(self) -> float | None:
        """None without a target."""

    def check(self, sampling: Sampling) -> None:
        """ValueError for a budget or target that makes no sense."""
        if self.refined_runs is not None and self.refined_runs < 10:
            raise ValueError(f"[campaign] refined_runs = {self.refined_runs}: give 10 or more, the audit needs some")
        if self.target_cov is not None and not 0 < self.target_cov < 1:
            raise ValueError(f"[campaign] target_cov = {self.target_cov:g}: give a value above 0 and below 1")

    def budget(self, samples: int) -> int:
        """What the settings say, or for a target alone all samples, or a fifth of them, at least 20."""
        usual = usual_budget(samples) if self.target_cov is None else samples
        return min(self.refined_runs or usual, samples)

    def why_finished(self, population: Population, answers: Answers) -> str | None:
        """All ran, the target is met or out of reach, or the budget is spent."""
        if self.wanted(population, answers, 1, ()):
            return None
        if len(answers) == population.size:
            return "all samples ran on the refined grid"
        target, found = self.target_cov, self.estimate(population, answers)
        if target is not None and found.cov <= target:
            return f"the coefficient of variation is at most {target:g}"
        if target is not None and found.refined_runs < self.budget(population.size):
            if not out_of_reach(found, target):
                return (
                    f"the runs that a coefficient of variation of {target:g} takes are made, as fixed before the last"
                )
            return (
                f"a coefficient of variation of {target:g} is out of reach with {population.size} samples, "
                "however many run refined: give more samples"
            )
        return "the refined runs allowed are spent"


def out_of_reach(found: Estimate, target: float) -> bool:
    """Whether the sampling of the fields alone scatters more than the target, so that no refined run would help."""
    return after_more_runs(found, 10**9) > target


def usual_budget(samples: int) -> int:
    """Refined runs where neither a number nor a target is given."""
    return max(20, samples // 5)
