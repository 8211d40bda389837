"""Both phases of a campaign as far as they are known, and what its estimator makes of them."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field, fields, replace

import numpy as np

from cooperative.estimate._estimates import Estimate, wilson_interval
from cooperative.estimate._protocol import (
    Answers,
    Estimator,
    Failures,
    Modelled,
    Population,
    Sampling,
    Screened,
)
from cooperative.estimate._ranking import rank_samples


@dataclass(frozen=True)
class Phases:
    """What is known of both phases. Samples have their numbers in the campaign here, and their places in the population
    where the estimator is asked.

    estimator: the campaign's. failure_displacement: beyond which a sample has failed (m). rough: sample -> its largest
    displacement on the rough grid (m), and whether that run broke off. population: samples of the first phase, None
    while that is not complete. answers: sample -> whether it failed on the refined grid, None where
    the run broke off before it could tell.
    """

    estimator: Estimator
    failure_displacement: float
    rough: Screened = field(default_factory=dict)
    population: Population | None = None
    answers: Answers = field(default_factory=dict)

    @classmethod
    def known(cls, estimator: Estimator, sampling: Sampling, rough: Screened, refined: Screened) -> Phases:
        """From the results of both grids: sample -> its largest displacement (m), and whether the run broke off."""
        # Once there are refined runs, rough ones that lack wait to be redone: what is known is told without them.
        screening = len(rough) < estimator.rough_runs(sampling) and not refined
        population = None if screening else estimator.population(sampling, rough)
        return cls(estimator, sampling.failure_displacement, rough, population).refined(refined)

    def refined(self, results: Screened) -> Phases:
        """The same first phase with these results of the refined grid, and no others."""
        return replace(self, answers={number: self.answer(*result) for number, result in results.items()})

    def answer(self, displacement: float, broke_off: bool) -> bool | None:
        """Whether a run says that its sample fails; a run that broke off can say yes, but not no."""
        fails = bool(displacement > self.failure_displacement)
        return fails if fails or not broke_off else None

    def next_runs(self, places: int, under_way: Collection[int]) -> list[int]:
        """Numbers of the samples to start on the refined grid now; empty when there is nothing to start."""
        if self.population is None:
            return []
        numbers = self._numbers
        started = {place for place, number in enumerate(numbers) if number in under_way}
        asked = self.estimator.wanted(self.population, self._by_place, places, started)
        return [numbers[place] for place in asked]

    @property
    def estimate(self) -> Estimate:
        """Probability of failure by the campaign's estimator; while the first phase is not complete, the share that
        fails on the rough grid."""
        if self.population is None:
            return self._rough_alone
        return self.estimator.estimate(self.population, self._by_place)

    @property
    def beside(self) -> list[Estimate]:
        """What other estimators make of the same runs, where the data allow."""
        return [] if self.population is None else self.estimator.beside(self.population, self._by_place)

    @property
    def path(self) -> list[Estimate]:
        """Estimates on the way, first to last."""
        return [] if self.population is None else self.estimator.path(self.population, self._by_place)

    @property
    def weights(self) -> dict[int, float]:
        """What share of all samples each refined run stands for, by number of the sample; 0 where it stands for
        nothing.

        They sum to 1, and those of the failures to the estimated probability of failure. The estimator's own weights,
        of the draws alone, do so on average only: what its model expects of samples that were not drawn is in the
        estimate and not in them. So those of the failures are multiplied by one factor, and those of the runs that
        stand by another (calibration to known totals: Deville and Sarndal 1992, Journal of the American Statistical
        Association 87, 376-382, DOI 10.1080/01621459.1992.10475217). Means and shares over failures stay what they
        are. While no failure, or no run that stands, has been found, its class has no weight to multiply.
        """
        if self.population is None:
            return dict.fromkeys(self.answers, 0.0)
        numbers, found = self._numbers, dict.fromkeys(self.answers, 0.0)
        # A sample at which a chain stood still has several places in the population.
        for place, weight in self.estimator.weights(self.population, self._by_place).items():
            found[numbers[place]] += weight
        share = self.estimate.probability
        stands_for = {True: share, False: 1 - share}
        drawn = {fails: sum(w for n, w in found.items() if self.answers[n] is fails) for fails in stands_for}
        # A run that broke off before it could tell belongs to neither class.
        factor = {fails: stands_for[fails] / drawn[fails] for fails in stands_for if drawn[fails] > 0}
        return {
            n: w * factor.get(self.answers[n] is True, 1.0) * (self.answers[n] is not None) for n, w in found.items()
        }

    @property
    def failures(self) -> Failures | None:
        """Where the failures lie, by rank; None while the first phase is not complete. Those that ran refined alone,
        each with its weight, where the estimator has no model of the others."""
        if self.population is None:
            return None
        if isinstance(self.estimator, Modelled):
            found = self.estimator.failures(self.population, self._by_place)
        else:
            count = np.zeros(self.population.size)
            for place, weight in self.estimator.weights(self.population, self._by_place).items():
                count[place] = weight * (self._by_place[place] is True)
            count /= max(float(count.sum()), np.finfo(float).tiny)
            found = Failures(self.population.numbers, count, (count > 0).astype(float), count)
        order = rank_samples(self.population.rough_displacement, self.population.broke_off).order
        return Failures(*(getattr(found, each.name)[order] for each in fields(found)))

    @property
    def why_finished(self) -> str | None:
        """Why no further refined run is asked for, in words; None where some still are."""
        return None if self.population is None else self.estimator.why_finished(self.population, self._by_place)

    @property
    def _rough_alone(self) -> Estimate:
        told = [answer for result in self.rough.values() if (answer := self.answer(*result)) is not None]
        method, notes = "rough grid alone", ["screening is not complete: the share that fails on the rough grid alone"]
        if lost := len(self.rough) - len(told):
            notes.append(f"{lost} rough runs gave no answer and are left out")
        if not told:
            return Estimate(0.0, (0.0, 1.0), np.inf, 0, method, notes=tuple(notes))
        share = sum(told) / len(told)
        cov = float(np.sqrt((1 - share) / sum(told))) if share else np.inf
        return Estimate(share, wilson_interval(sum(told), len(told)), cov, 0, method, notes=tuple(notes))

    @property
    def _numbers(self) -> list[int]:
        numbers: list[int] = [] if self.population is None else self.population.numbers.tolist()
        return numbers

    @property
    def _by_place(self) -> dict[int, bool | None]:
        return {place: self.answers[n] for place, n in enumerate(self._numbers) if n in self.answers}
