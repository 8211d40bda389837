"""Both phases of a campaign as far as they are known, what its estimator makes of them, and which failures slide on.

An audit looks where it doubts. Slopes that fail for sure it seldom draws, and these slide farthest: means of what
slides do, weighed by the audit's draws, rest on the few of them that it met. Two things put that right.

Slides are drawn along the ranks, among all samples, as densely as failures lie there by the audit's model: a class that
is known counts as 0 or 1. A sample that is drawn and has no class yet runs to its end; if it stands, the next takes its
place. The order is that of a golden section sequence along the modelled failures laid end to end by rank, whose points
lie evenly however many of them there are (Kronecker sequences: Niederreiter 1992, Random Number Generation and
Quasi-Monte Carlo Methods, Section 3.1). It follows from the audit and the seed alone, so that the slides do not depend
on what ran at once. `slides` = "all" draws none: all failures of the audit slide.

Each slide stands for the failures whose ranks are nearest to its own, as the audit counts them there: the totals of its
difference estimator over such zones, which add up to P_f. Neither draw looks at what a slide does, but at ranks and
classes alone, so the failures that slid near a rank are like those near it that did not (Rubin 1976, Biometrika 63,
581-592, DOI 10.1093/biomet/63.3.581). Hence all slides count, whatever draw they slid for. Post-stratification:
Sarndal, Swensson and Wretman (1992), Model Assisted Survey Sampling, Section 7.6; difference estimator: Section 6.3.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property

import numpy as np

from cooperative.estimate._audit import FAR_DOWN
from cooperative.estimate._estimates import Estimate
from cooperative.estimate._protocol import (
    Answers,
    Estimator,
    Failures,
    Modelled,
    Population,
    Sampling,
    Screened,
    Zone,
)
from cooperative.estimate._ranking import rank_samples

NOT_ASKED = "the scene asks for no slides (slides = 0)"
"""Why there are no consequences, in words, where refined runs end with a class alone."""

GOLDEN = (np.sqrt(5) - 1) / 2


@dataclass(frozen=True)
class Phases:
    """What is known of both phases.

    Samples have their numbers in the campaign here, and their positions in the population where the estimator is asked.

    Args:
        estimator: the campaign's.
        failure_displacement: beyond which a sample has failed (m).
        rough: sample -> its largest displacement on the rough grid (m), and whether that run broke off.
        population: samples of the first phase, None while that is not complete.
        answers: sample -> whether it failed on the refined grid, None where the run broke off undecided.
        planned: samples of the first phase in the end.
        zones: what each of these stands for that a coarser grid chose; None without such a grid.
    """

    estimator: Estimator
    failure_displacement: float
    rough: Screened = field(default_factory=dict)
    population: Population | None = None
    answers: Answers = field(default_factory=dict)
    planned: int = 0
    zones: Mapping[int, Zone] | None = None

    @classmethod
    def of(cls, estimator: Estimator, sampling: Sampling, rough: Screened, refined: Screened) -> Phases:
        """From the results of both grids: sample -> its largest displacement (m), and whether the run broke off."""
        # Once there are refined runs, missing rough ones wait to be redone, and the estimate does without them.
        planned = estimator.rough_runs(sampling)
        population = None if len(rough) < planned and not refined else estimator.population(sampling, rough)
        first = cls(estimator, sampling.failure_displacement, rough, population, planned=planned, zones=sampling.zones)
        return first.refined(refined)

    def refined(self, results: Screened) -> Phases:
        """The same first phase with these results of the refined grid, and no others."""
        return replace(self, answers={number: self.answer(*result) for number, result in results.items()})

    def answer(self, displacement: float, broke_off: bool) -> bool | None:
        """Whether a run shows that its sample fails; one that broke off never shows that it stands."""
        fails = bool(displacement > self.failure_displacement)
        return fails if fails or not broke_off else None

    def next_runs(self, lanes: int, under_way: Collection[int]) -> list[int]:
        """Numbers of the samples to start on the refined grid now; empty when there is nothing to start."""
        if self.population is None:
            return []
        started = {position for position, number in enumerate(self._numbers) if number in under_way}
        positions = self.estimator.next_runs(self.population, self._by_position, lanes, started)
        return [self._numbers[position] for position in positions]

    @cached_property
    def estimate(self) -> Estimate:
        """Probability of failure by the campaign's estimator.

        While the first phase is not complete, the share that fails on the rough grid, which leaves P_f open.
        """
        if self.population is None:
            return self._rough_alone
        return self.estimator.estimate(self.population, self._by_position)

    @property
    def beside(self) -> list[Estimate]:
        """What other estimators make of the same runs, where the data allow."""
        return [] if self.population is None else self.estimator.beside(self.population, self._by_position)

    @property
    def path(self) -> list[Estimate]:
        """Estimates on the way, first to last."""
        return [] if self.population is None else self.estimator.path(self.population, self._by_position)

    @cached_property
    def weights(self) -> dict[int, float]:
        """Share of all samples that each refined run stands for, by sample; 0 where it stands for nothing.

        They sum to 1, and those of the failures to the estimated probability of failure. The estimator's own weights,
        of the draws alone, do so on average only: what its model expects of samples that were not drawn is in the
        estimate and not in them. So those of the failures are multiplied by one factor, and those of the runs that
        stand by another (calibration to known totals: Deville and Sarndal 1992, Journal of the American Statistical
        Association 87, 376-382, DOI 10.1080/01621459.1992.10475217). Means and shares over failures stay what they are.
        While no failure, or no run that stands, has been found, its class has no weight to multiply.
        """
        if self.population is None:
            return dict.fromkeys(self.answers, 0.0)
        weights = dict.fromkeys(self.answers, 0.0)
        # A sample at which a chain stood still has several positions in the population.
        for position, weight in self.estimator.weights(self.population, self._by_position).items():
            weights[self._numbers[position]] += weight
        probability = self.estimate.probability
        stands_for = {True: probability, False: 1 - probability}
        sums = {fails: sum(w for n, w in weights.items() if self.answers[n] is fails) for fails in stands_for}
        # A run that broke off undecided belongs to neither class.
        factor = {fails: stands_for[fails] / sums[fails] for fails in stands_for if sums[fails] > 0}
        return {
            n: w * factor.get(self.answers[n] is True, 1.0) * (self.answers[n] is not None) for n, w in weights.items()
        }

    @property
    def failures(self) -> Failures | None:
        """Where the failures lie, by rank; None while the first phase is not complete.

        Those that ran refined alone, each with its weight, where the estimator has no model of the others.
        """
        if self.population is None:
            return None
        if isinstance(self.estimator, Modelled):
            failures = self.estimator.failures(self.population, self._by_position)
        else:
            count = np.zeros(self.population.size)
            for position, weight in self.estimator.weights(self.population, self._by_position).items():
                count[position] = weight * (self._by_position[position] is True)
            count /= max(float(count.sum()), np.finfo(float).tiny)
            failures = Failures(self.population.numbers, count, (count > 0).astype(float), count)
        order = rank_samples(self.population.rough_displacement, self.population.broke_off).order
        return Failures(*(getattr(failures, column.name)[order] for column in fields(failures)))

    @property
    def why_finished(self) -> str | None:
        """Why no further refined run is asked for, in words; None where some still are."""
        return None if self.population is None else self.estimator.why_finished(self.population, self._by_position)

    @property
    def coarse_samples(self) -> int | None:
        """Samples from which a coarser grid chose those of the first phase; None without such a grid."""
        return next(iter(self.zones.values())).samples if self.zones else None

    @property
    def _rough_alone(self) -> Estimate:
        answers = {n: answer for n, result in self.rough.items() if (answer := self.answer(*result)) is not None}
        method, notes = "rough grid alone", []
        if lost := len(self.rough) - len(answers):
            notes.append(f"{lost} rough runs gave no answer and are left out")
        weight = np.array([self.zones[n].weight if self.zones else 1.0 for n in answers])
        fails = np.array(list(answers.values()), bool)
        proportion = float(weight[fails].sum() / weight.sum()) if answers else 0.0
        notes.insert(0, f"screening is not complete: {proportion:.3g} of the samples so far fail on the rough grid")
        # No number of rough runs shows what the refined grid makes of them.
        return Estimate(proportion, (0.0, 1.0), np.inf, 0, method, notes=tuple(notes))

    @cached_property
    def _numbers(self) -> list[int]:
        numbers: list[int] = [] if self.population is None else self.population.numbers.tolist()
        return numbers

    @cached_property
    def _by_position(self) -> dict[int, bool | None]:
        return {position: self.answers[n] for position, n in enumerate(self._numbers) if n in self.answers}


def slide_order(size: np.ndarray, seed: int) -> np.ndarray:
    """Ranks in the order in which they are to slide (n,), those with a size above 0.

    Args:
        size: failures expected of each rank (N,). A part of the order from its start on lies along the ranks as densely
            as the sizes do.
        seed: of the sequence's start.
    """
    reached, points = np.cumsum(size), np.arange(32 * size.size)
    at = (np.random.default_rng([seed, 1]).random() + GOLDEN * points) % 1 * reached[-1]
    hit, first = np.unique(np.searchsorted(reached, at, side="right"), return_index=True)
    met = hit[np.argsort(first)]
    met = met[met < size.size]
    # What 32 points for each rank have not met comes last, the largest first.
    rest = np.setdiff1d(np.flatnonzero(size > 0), met)
    return np.concatenate([met[size[met] > 0], rest[np.argsort(-size[rest], kind="stable")]])


def zone_weights(failures: Failures, slid: np.ndarray) -> np.ndarray:
    """How many failures each slide stands for (n,), as a share of all samples, at least itself.

    Args:
        failures: by rank.
        slid: its rank (n,), ascending.
    """
    reached = np.cumsum(failures.expected) - failures.expected / 2
    borders = (reached[slid][1:] + reached[slid][:-1]) / 2
    counted = np.bincount(np.searchsorted(borders, reached), failures.count, slid.size)
    return np.maximum(counted, failures.weight[slid])


@dataclass(frozen=True)
class Slides:
    """Refined runs as means over failures see them, (runs,) each.

    Args:
        failed: all failures.
        slid: those that slid on to their end.
        weight: what each run stands for, 0 for failures that did not slide.
        missing: samples that are to slide still, as far as the runs show: failures that wait, and samples that have not
            run refined yet.
    """

    failed: np.ndarray = field(repr=False)
    slid: np.ndarray = field(repr=False)
    weight: np.ndarray = field(repr=False)
    missing: tuple[int, ...]

    @classmethod
    def of(cls, phases: Phases, numbers: Sequence[int], ended: np.ndarray, count: int | None, seed: int) -> Slides:
        """Of the refined runs with these numbers.

        Args:
            phases: results so far.
            numbers: samples of the refined runs (runs,).
            ended: whether each ran to its end (runs,).
            count: slides asked for, None for all failures of the audit.
            seed: of the draw of slides.
        """
        stands_for = phases.weights
        weight = np.array([stands_for[number] for number in numbers], float)
        failed = np.array([phases.answers[number] is True for number in numbers], bool)
        slid = failed & ended if count != 0 else np.zeros(failed.size, bool)
        failures = phases.failures
        if failures is None:
            return cls(failed, slid, np.where(failed & ~slid, 0.0, weight), ())
        weight = np.where(failed, 0.0, weight)
        # A sample at which a chain stood still has several ranks.
        position = {number: at for at, number in enumerate(numbers)}
        ranks = np.array([r for r, n in enumerate(failures.number) if n in position and slid[position[n]]], int)
        if ranks.size:
            of_zone = zone_weights(failures, ranks)
            # Without a run that the estimator counts, it is unknown what slides stand for.
            of_zone *= phases.estimate.probability / (of_zone.sum() or 1.0)
            np.add.at(weight, [position[n] for n in failures.number[ranks]], of_zone)
        return cls(failed, slid, weight, _missing(phases, failures, set(np.array(numbers)[slid]), count, seed))

    @property
    def planned(self) -> int:
        """Slides that there are in the end, as far as is known."""
        return int(self.slid.sum()) + len(self.missing)

    @property
    def notes(self) -> list[str]:
        """That not all failures slid on, or that none was asked to, in words."""
        if self.failed.sum() == self.slid.sum():
            return []
        if not self.planned:
            return [
                f"{NOT_ASKED}: the {self.failed.sum()} refined failures ended once they had failed, and there are no "
                "modes, consequences, maps or fits"
            ]
        return [
            f"{self.slid.sum()} of {self.failed.sum()} refined failures slid on to their end. Modes, consequences and "
            "fits come from these, weighted for all; the others ended once they had failed"
        ]


def _missing(phases: Phases, failures: Failures, slid: set[int], count: int | None, seed: int) -> tuple[int, ...]:
    """The next in order that fail, or may, until so many slide; those that stand or gave no answer are passed over.

    While no failure is known there is nothing that slides would stand for, and none are sought beyond the audit.
    """
    size = np.where(failures.chance < FAR_DOWN, 0.0, failures.expected)
    missing: dict[int, None] = {}
    if not count or not size.any() or True not in phases.answers.values():
        return ()
    for number in failures.number[slide_order(size, seed)].tolist():
        if len(slid) + len(missing) >= count:
            break
        if number not in slid and phases.answers.get(number, True):
            missing[number] = None
    return tuple(missing)
