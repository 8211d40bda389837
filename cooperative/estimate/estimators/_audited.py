"""A second phase that is an audit: refined runs drawn at random where the rough result leaves most doubt."""

from __future__ import annotations

from collections.abc import Collection
from typing import Protocol

from cooperative.estimate._audit import AuditPlan
from cooperative.estimate._estimates import Estimate
from cooperative.estimate._protocol import Answers, Failures, Population
from cooperative.estimate._twophase import failures, next_audit, path, sample_weights, two_phase
from cooperative.estimate.estimators._budgeted import Budgeted, out_of_reach, usual_budget


class Audited(Budgeted, Protocol):
    """Base of an estimator whose refined runs are an audit of its first phase, spent as its `audit` says."""

    def audit(self, population: Population) -> AuditPlan:
        """How the refined runs are spent."""

    def wanted(self, population: Population, answers: Answers, places: int, under_way: Collection[int]) -> list[int]:
        """The rest of the wave; nothing once a target alone is seen to be out of reach."""
        audit = self.audit(population)
        asked = [sample for sample in next_audit(population, answers, audit) if sample not in under_way]
        if asked and self.target_cov is not None and self.refined_runs is None:
            found = two_phase(population, answers, audit)
            if found.refined_runs >= usual_budget(population.size) and out_of_reach(found, self.target_cov):
                return []
        return asked

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
