"""Estimators without an audit: the published rule, plain Monte Carlo, the control variate that the rough ranks make.

Their first phase is the scene's own samples (`SceneSamples`). Monte Carlo and the control variate refine the first of
these: their order is independent of their soil, so they are a random subset.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Protocol

import numpy as np

from cooperative.estimate._estimates import Estimate, after_more_runs, count_interval
from cooperative.estimate._formulas import CONTROL_VARIATE, FOLDS, MONTE_CARLO, control_variate, monte_carlo, published
from cooperative.estimate._in_order import Control, Ordered, in_order, ordered_estimate
from cooperative.estimate._logistic import fit_logistic, normal_scores, predict_logistic, rough_centre
from cooperative.estimate._protocol import Answers, Estimator, Population, Sampling, Screened, all_samples
from cooperative.estimate._ranking import next_refined, rank_samples, stopping_rank

LOOK = 10
"""Runs of the first samples to a target are given their shares so many at a time."""
POINTS = 60
"""At most so many points of a path."""


class SceneSamples(Estimator, Protocol):
    """Base of an estimator that refines some of the scene's own samples, each of which runs once on the rough grid.

    A class derives from it, is a frozen dataclass, and writes `name`, `check`, `budget`, `next_runs`, `estimate`,
    `weights` and `why_finished`; what else it has it writes over. See `Estimator` for every member.
    """

    def rough_runs(self, sampling: Sampling) -> int:
        """One of each sample, or of those drawn of them."""
        return sampling.rough_samples or sampling.samples

    def coefficients(self, sampling: Sampling, screened: Screened) -> np.ndarray:
        """Those of the scene's samples, (samples, modes)."""
        return sampling.draw()

    def population(self, sampling: Sampling, screened: Screened) -> Population | None:
        """The scene's samples, or those drawn of them."""
        return all_samples(sampling, screened)

    def path(self, population: Population, answers: Answers) -> list[Estimate]:
        """The estimate alone, without the way to it."""
        return [self.estimate(population, answers)]

    def beside(self, population: Population, answers: Answers) -> list[Estimate]:
        """None."""
        return []


@dataclass(frozen=True)
class Published(SceneSamples):
    """Refined runs in rank order until k_t in a row stand, and n/N: `published`.

    Args:
        k_t: consecutive samples that must stand.
    """

    name: ClassVar[str] = "published"
    k_t: int

    def check(self, sampling: Sampling) -> None:
        """ValueError for a k_t below 1, or a coarse grid."""
        check_rule(self.k_t)
        check_all_run(self, sampling)

    def budget(self, samples: int) -> None:
        """The stopping rule alone decides."""

    def next_runs(self, population: Population, answers: Answers, lanes: int, under_way: Collection[int]) -> list[int]:
        """The next ranks that the rule needs whatever those under way turn out to be."""
        return next_refined(
            population.rough_displacement, answers, self.k_t, lanes, broke_off=population.broke_off,
            under_way=under_way,
        )  # fmt: skip

    def estimate(self, population: Population, answers: Answers) -> Estimate:
        """n/N."""
        return published(population.rough_displacement, answers, self.k_t, broke_off=population.broke_off)

    def path(self, population: Population, answers: Answers) -> list[Estimate]:
        """Down the ranks."""
        ranked = [sample for sample in _order(population).tolist() if sample in answers]
        return _path(ranked, 1, self, population, answers)

    def weights(self, population: Population, answers: Answers) -> dict[int, float]:
        """Each run with an answer counts once."""
        return {sample: 1.0 for sample, failed in answers.items() if failed is not None}

    def beside(self, population: Population, answers: Answers) -> list[Estimate]:
        """Plain Monte Carlo where every sample ran."""
        return monte_carlo_of_all(population, answers)

    def why_finished(self, population: Population, answers: Answers) -> str | None:
        """All ran, or k_t in a row stand."""
        if self.next_runs(population, answers, 1, ()):
            return None
        everything = len(answers) == population.size
        return "all samples ran on the refined grid" if everything else f"{self.k_t} samples in a row stand"


@dataclass(frozen=True)
class Budgeted(SceneSamples):
    """Base of an estimator with a budget.

    Args:
        refined_runs: budget, None for the usual one.
        target_cov: coefficient of variation at which to stop before the budget is spent, None for none.
    """

    refined_runs: int | None = None
    target_cov: float | None = None

    def check(self, sampling: Sampling) -> None:
        """ValueError for a budget or target that makes no sense."""
        if self.refined_runs is not None and self.refined_runs < 10:
            raise ValueError(f"refined_runs = {self.refined_runs}: give 10 or more")
        if self.target_cov is not None and not 0 < self.target_cov < 1:
            raise ValueError(f"target_cov = {self.target_cov:g}: give a value above 0 and below 1")

    def budget(self, samples: int) -> int:
        """That of the settings, or for a target alone all samples, or a fifth of them, at least 20."""
        usual = usual_budget(samples) if self.target_cov is None else samples
        return min(self.refined_runs or usual, samples)

    def why_finished(self, population: Population, answers: Answers) -> str | None:
        """All ran, the target is met or out of reach, or the budget is spent."""
        if self.next_runs(population, answers, 1, ()):
            return None
        if len(answers) == population.size:
            return "all samples ran on the refined grid"
        target, estimate = self.target_cov, self.estimate(population, answers)
        if target is not None and estimate.cov <= target:
            return f"the coefficient of variation is at most {target:g}"
        if target is not None and not estimate.probability:
            return f"no refined run has failed, and a coefficient of variation of {target:g} takes failures"
        if target is not None and estimate.refined_runs < self.budget(population.size):
            if not out_of_reach(estimate, target):
                return f"the runs that were fixed for a coefficient of variation of {target:g} are made"
            return (
                f"a coefficient of variation of {target:g} is out of reach with {population.size} samples, "
                "however many run refined: give more samples"
            )
        return "the refined runs allowed are spent"


@dataclass(frozen=True)
class InOrder(Budgeted):
    """Base of an estimator that refines the scene's first samples, as many as its budget or target asks for.

    Args:
        k_t: of the published rule, whose n/N stands beside the estimate where the runs allow it.
    """

    method: ClassVar[str]
    k_t: int | None = None

    def check(self, sampling: Sampling) -> None:
        """ValueError for a budget, target or k_t that makes no sense, or a coarse grid."""
        super().check(sampling)
        check_rule(self.k_t)
        check_all_run(self, sampling)

    def next_runs(self, population: Population, answers: Answers, lanes: int, under_way: Collection[int]) -> list[int]:
        """The first samples, as many as the budget allows, or as a target asks for by the next look."""
        runs = self.budget(population.size)
        if self.target_cov is not None:
            # Not beyond the next look: what is run after it might not be needed.
            runs = self._ordered(self.target_cov, population, answers).to_run
        missing = [number for number in range(runs) if number not in answers and number not in under_way]
        return missing[: max(lanes - len(under_way), 0)]

    def control(self, population: Population) -> Control | None:
        """What each sample is expected to do, by the runs so far; None for nothing."""
        return None

    @abstractmethod
    def untargeted(self, population: Population, answers: Answers) -> Estimate:
        """The estimate from the first answers, where nothing but their number ended them."""

    def estimate(self, population: Population, answers: Answers) -> Estimate:
        """From the first answers; with a target those up to the last look, by the shares that these were given."""
        if self.target_cov is None:
            return self.untargeted(population, answers)
        ordered = self._ordered(self.target_cov, population, answers)
        if not ordered.draw_weight.size:
            return self.untargeted(population, answers)
        outcomes, lost = _first_answers({number: answers[number] for number in range(ordered.draw_weight.size)})
        estimate = ordered_estimate(
            self.method, _outcomes(answers), population.size, ordered, control=self.control(population)
        )
        return _open_to(lost, outcomes, estimate)

    def _ordered(self, target: float, population: Population, answers: Answers) -> Ordered:
        return in_order(
            _outcomes(answers), population.size, target=target, budget=self.budget(population.size),
            control=self.control(population), interval=LOOK,
        )  # fmt: skip

    def path(self, population: Population, answers: Answers) -> list[Estimate]:
        """After every 10 samples, or more."""
        return _path(range(_without_gap(answers)), LOOK, self, population, answers)

    def weights(self, population: Population, answers: Answers) -> dict[int, float]:
        """Each run with an answer counts once, or with a target by its share."""
        outcomes = _first_answers(answers)[0]
        if self.target_cov is None:
            return dict.fromkeys(outcomes, 1.0)
        draw_weight = self._ordered(self.target_cov, population, answers).draw_weight.tolist()
        return {number: weight for number, weight in enumerate(draw_weight) if number in outcomes}


@dataclass(frozen=True)
class MonteCarlo(InOrder):
    """Refined runs of the first samples, all unless the settings have fewer, and the share that fails: `monte_carlo`.

    Args:
        refined_runs: budget, None for all samples.
        target_cov: coefficient of variation at which to stop before the budget is spent, None for none.
        k_t: of the published rule, whose n/N stands beside the estimate where the runs allow it; None for none.
    """

    name: ClassVar[str] = "monte carlo"
    method: ClassVar[str] = MONTE_CARLO

    def budget(self, samples: int) -> int:
        """That of the settings, or all samples."""
        return min(self.refined_runs or samples, samples)

    def untargeted(self, population: Population, answers: Answers) -> Estimate:
        """The share of the first samples that fails."""
        outcomes, lost = _first_answers(answers)
        if not outcomes:
            return Estimate(0.0, (0.0, 1.0), np.inf, 0, MONTE_CARLO, notes=("no refined run yet",))
        return _open_to(lost, outcomes, monte_carlo(np.array(list(outcomes.values())), samples=population.size))

    def beside(self, population: Population, answers: Answers) -> list[Estimate]:
        """n/N where its rule is met, and the control variate where there are samples that it can add."""
        more = [] if monte_carlo_of_all(population, answers) else [ControlVariate().estimate(population, answers)]
        return [*published_where_met(self.k_t, population, answers), *more]


@dataclass(frozen=True)
class ControlVariate(InOrder):
    """Refined runs of the first samples, and the control variate that the rough ranks make: `control_variate`.

    Args:
        refined_runs: budget. None for a fifth of the samples, at least 20, or with a target for all.
        target_cov: coefficient of variation at which to stop before the budget is spent, None for none.
        k_t: of the published rule, whose n/N stands beside the estimate where the runs allow it; None for none.
    """

    name: ClassVar[str] = "control variate"
    method: ClassVar[str] = CONTROL_VARIATE

    def control(self, population: Population) -> Control:
        """The logistic model of failure by the rough rank."""
        rank = np.argsort(_order(population))
        even = np.ones(population.size)
        score = normal_scores(even)[rank]
        centre = rough_centre(population.rough_displacement, even, population.failure_displacement)

        def chance(outcome: np.ndarray) -> np.ndarray:
            answered = np.flatnonzero(~np.isnan(outcome))
            return predict_logistic(fit_logistic(score[answered], outcome[answered], centre), score, centre)

        return chance

    def untargeted(self, population: Population, answers: Answers) -> Estimate:
        """With the rough ranks as control; plain Monte Carlo of fewer than 10 runs."""
        outcomes, lost = _first_answers(answers)
        if len(outcomes) < 2 * FOLDS:
            few = f"too few runs for a control variate, it takes {2 * FOLDS}"
            plain = MonteCarlo().estimate(population, answers)
            return replace(plain, notes=(*plain.notes, few))
        estimate = control_variate(
            population.rough_displacement, outcomes, failure_displacement=population.failure_displacement
        )
        return _open_to(lost, outcomes, estimate)

    def beside(self, population: Population, answers: Answers) -> list[Estimate]:
        """n/N where its rule is met, and plain Monte Carlo: nobody chose the first samples."""
        return [*published_where_met(self.k_t, population, answers), MonteCarlo().estimate(population, answers)]


def check_rule(k_t: int | None) -> None:
    """ValueError for a k_t below 1."""
    if k_t is not None and k_t < 1:
        raise ValueError(f"k_t = {k_t}: give 1 or more")


def check_all_run(estimator: Estimator, sampling: Sampling) -> None:
    """ValueError for a coarse grid, which an estimator without weights cannot do with."""
    if sampling.rough_samples is not None:
        raise ValueError(
            f"estimator = {estimator.name!r} takes all samples as alike, and a coarse grid draws the rough ones: leave "
            "[coarse] and rough_samples out, or take 'two-phase'"
        )


def published_where_met(k_t: int | None, population: Population, answers: Answers) -> list[Estimate]:
    """n/N, where a k_t is given and the runs meet its rule."""
    if k_t is None or stopping_rank(_order(population), answers, k_t) is None:
        return []
    return [Published(k_t).estimate(population, answers)]


def monte_carlo_of_all(population: Population, answers: Answers) -> list[Estimate]:
    """Plain Monte Carlo, where every sample has an answer."""
    whole = len(answers) == population.size and None not in answers.values()
    return [MonteCarlo().estimate(population, answers)] if whole else []


def out_of_reach(estimate: Estimate, target: float) -> bool:
    """Whether the sampling of the fields alone scatters more than the target, so that no refined run would help."""
    return after_more_runs(estimate, 10**9) > target


def usual_budget(samples: int) -> int:
    """Refined runs where neither a number nor a target is given."""
    return max(20, samples // 5)


def _order(population: Population) -> np.ndarray:
    return rank_samples(population.rough_displacement, population.broke_off).order


def _path(
    order: Sequence[int], step: int, estimator: Estimator, population: Population, answers: Answers
) -> list[Estimate]:
    """Estimates after every `step` of the samples that ran in this order, thinned to some 60, and after all of them."""
    every = step * max(1, -(-len(order) // (step * POINTS)))
    stops = sorted({*range(every, len(order), every), len(order)} - {0})
    return [estimator.estimate(population, {s: answers[s] for s in order[:stop]}) for stop in stops]


def _without_gap(answers: Answers) -> int:
    """How many samples have an answer or broke off, from number 0 on without a gap."""
    return next(number for number in range(len(answers) + 1) if number not in answers)


def _outcomes(answers: Answers) -> np.ndarray:
    """Of the samples from number 0 on without a gap, nan where one broke off (n,)."""
    return np.array([answers[number] for number in range(_without_gap(answers))], float)


def _first_answers(answers: Answers) -> tuple[dict[int, bool], int]:
    """Answers of the samples from number 0 on without a gap, and how many of these broke off."""
    count = _without_gap(answers)
    outcomes = {number: bool(answers[number]) for number in range(count) if answers[number] is not None}
    return outcomes, count - len(outcomes)


def _open_to(lost: int, outcomes: Mapping[int, bool], estimate: Estimate) -> Estimate:
    """The estimate with an interval that holds P_f whatever `lost` runs without an answer would have been."""
    if not lost:
        return estimate
    failures, runs = sum(outcomes.values()), len(outcomes) + lost
    low, _ = count_interval(failures, runs, estimate.level)
    _, high = count_interval(failures + lost, runs, estimate.level)
    note = f"{lost} refined runs gave no answer; the interval holds P_f if none of them fails, and if all do"
    return replace(
        estimate,
        interval=(min(low, estimate.interval[0]), max(high, estimate.interval[1])),
        notes=(*estimate.notes, note),
    )
