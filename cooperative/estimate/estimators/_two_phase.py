"""The default: all samples on the rough grid, an audited few on the refined one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from cooperative.estimate._audit import AuditPlan
from cooperative.estimate._estimates import Estimate
from cooperative.estimate._protocol import Answers, Population, Sampling
from cooperative.estimate.estimators._audited import Audited
from cooperative.estimate.estimators._first_answers import monte_carlo_of_all
from cooperative.estimate.estimators._published import check_rule, published_where_met
from cooperative.estimate.estimators._scene_samples import SceneSamples


@dataclass(frozen=True)
class TwoPhase(Audited, SceneSamples):
    """All samples on the rough grid, an audited few on the refined one: `two_phase`.

    refined_runs, target_cov: budget, and the coefficient of variation at which to stop before it is spent. Without
    either the budget is a fifth of the samples, at least 20. k_t: n/N by the published rule is told beside, where the
    runs allow it. seed: of the draws.
    """

    name: ClassVar[str] = "two-phase"
    refined_runs: int | None = None
    target_cov: float | None = None
    k_t: int | None = None
    seed: int = 0

    def check(self, sampling: Sampling) -> None:
        """ValueError for a budget, target, k_t or number of samples that an audit cannot do with."""
        super().check(sampling)
        check_rule(self.k_t)
        if sampling.samples < 10:
            raise ValueError(
                f"[campaign] samples = {sampling.samples}: give 10 or more for the audit, or estimator = 'published'"
            )

    def audit(self, population: Population) -> AuditPlan:
        """How the refined runs are spent; without a ranked prefix, which costs more than it tells."""
        return AuditPlan(self.budget(population.size), seed=self.seed, target_cov=self.target_cov)

    def beside(self, population: Population, answers: Answers) -> list[Estimate]:
        """n/N where its rule is met, plain Monte Carlo where every sample ran."""
        return [*published_where_met(self.k_t, population, answers), *monte_carlo_of_all(population, answers)]
