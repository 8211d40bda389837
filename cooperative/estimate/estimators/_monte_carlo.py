"""Plain Monte Carlo on the refined grid."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from cooperative.estimate._estimates import Estimate
from cooperative.estimate._protocol import Answers, Population
from cooperative.estimate.estimators._control_variate import ControlVariate
from cooperative.estimate.estimators._first_answers import monte_carlo_of_all, monte_carlo_of_first
from cooperative.estimate.estimators._in_order import InOrder
from cooperative.estimate.estimators._published import published_where_met


@dataclass(frozen=True)
class MonteCarlo(InOrder):
    """Refined runs of the first samples, all unless the settings say fewer, and the share that fails: `monte_carlo`.

    refined_runs, target_cov, k_t: as for `TwoPhase`.
    """

    name: ClassVar[str] = "monte carlo"
    refined_runs: int | None = None
    target_cov: float | None = None
    k_t: int | None = None

    def budget(self, samples: int) -> int:
        """What the settings say, or all samples."""
        return min(self.refined_runs or samples, samples)

    def estimate(self, population: Population, answers: Answers) -> Estimate:
        """The share of the first samples that fails."""
        return monte_carlo_of_first(population, answers)

    def beside(self, population: Population, answers: Answers) -> list[Estimate]:
        """n/N where its rule is met, and the control variate where there are samples that it can add."""
        more = [] if monte_carlo_of_all(population, answers) else [ControlVariate().estimate(population, answers)]
        return [*published_where_met(self.k_t, population, answers), *more]
