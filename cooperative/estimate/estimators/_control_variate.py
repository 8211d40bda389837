"""The control variate that the rough ranks make."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

from cooperative.estimate._estimates import Estimate, control_variate
from cooperative.estimate._protocol import Answers, Population
from cooperative.estimate.estimators._first_answers import first_answers, monte_carlo_of_first
from cooperative.estimate.estimators._in_order import InOrder
from cooperative.estimate.estimators._published import published_where_met

FOLDS = 5
"""Folds of the control variate; it takes two runs in each."""


@dataclass(frozen=True)
class ControlVariate(InOrder):
    """Refined runs of the first samples, and the control variate that the rough ranks make: `control_variate`.

    refined_runs, target_cov, k_t: as for `TwoPhase`.
    """

    name: ClassVar[str] = "control variate"
    refined_runs: int | None = None
    target_cov: float | None = None
    k_t: int | None = None

    def estimate(self, population: Population, answers: Answers) -> Estimate:
        """With the rough ranks as control; plain Monte Carlo of fewer than 10 runs."""
        known, notes = first_answers(answers)
        if len(known) < 2 * FOLDS:
            few = f"too few runs for a control variate, it takes {2 * FOLDS}"
            return replace(monte_carlo_of_first(population, answers), notes=(*notes, few))
        found = control_variate(
            population.rough_displacement, known, folds=FOLDS, failure_displacement=population.failure_displacement
        )
        return replace(found, notes=notes)

    def beside(self, population: Population, answers: Answers) -> list[Estimate]:
        """n/N where its rule is met, and plain Monte Carlo: nobody chose the first samples."""
        return [*published_where_met(self.k_t, population, answers), monte_carlo_of_first(population, answers)]
