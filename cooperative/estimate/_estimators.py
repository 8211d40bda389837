"""The estimators that a scene knows by name, each one class as `Estimator` describes it.

The statistics are in the modules beside: two-phase sampling and its audit, subset simulation, n/N, control variate.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import MISSING, dataclass, fields, replace
from typing import Any, ClassVar, Protocol

import numpy as np

from cooperative.estimate._audit import AuditPlan
from cooperative.estimate._estimates import Estimate, after_more_runs, control_variate, monte_carlo, published
from cooperative.estimate._protocol import Answers, Estimator, Population, Sampling, Screened, all_samples
from cooperative.estimate._ranking import next_refined, rank_samples, stopping_rank
from cooperative.estimate._subset import SubsetPlan, SubsetSamples, subset_simulation
from cooperative.estimate._twophase import next_audit, path, sample_weights, two_phase

POINTS = 60
"""At most so many points of a path."""

FOLDS = 5
"""Folds of the control variate; it takes two runs in each."""


class _Budgeted(Estimator, Protocol):
    """Estimators that spend a number of refined runs, or fewer where a target is met before."""

    @property
    def refined_runs(self) -> int | None: ...

    @property
    def target_cov(self) -> float | None: ...


@dataclass(frozen=True)
class TwoPhase:
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
        """ValueError for a budget, target or number of samples that an audit cannot do with."""
        _check_budget(self)
        _check_rule(self.k_t)
        if sampling.samples < 10:
            raise ValueError(
                f"[campaign] samples = {sampling.samples}: give 10 or more for the audit, or estimator = 'published'"
            )

    def rough_runs(self, sampling: Sampling) -> int:
        """One of each sample."""
        return sampling.samples

    def coefficients(self, sampling: Sampling, screened: Screened) -> np.ndarray:
        """Those of the scene's samples, (samples, modes)."""
        return sampling.draw()

    def population(self, sampling: Sampling, screened: Screened) -> Population | None:
        """The scene's samples."""
        return all_samples(sampling, screened)

    def budget(self, samples: int) -> int:
        """What the settings say, or for a target alone all samples, or a fifth of them, at least 20."""
        return _budget(self, samples)

    def audit(self, population: Population) -> AuditPlan:
        """How the refined runs are spent; without a ranked prefix, which costs more than it tells."""
        return AuditPlan(
            self.budget(population.size), seed=self.seed, target_cov=self.target_cov,
            rough_threshold=population.failure_displacement,
        )  # fmt: skip

    def wanted(self, population: Population, answers: Answers, places: int, under_way: Collection[int]) -> list[int]:
        """The rest of the wave; nothing once a target alone is seen to be out of reach."""
        return _audit_wanted(self, self.audit(population), population, answers, under_way)

    def estimate(self, population: Population, answers: Answers) -> Estimate:
        """From the complete waves."""
        return two_phase(population, answers, self.audit(population))

    def path(self, population: Population, answers: Answers) -> list[Estimate]:
        """After every complete wave."""
        return path(population, answers, self.audit(population))

    def weights(self, population: Population, answers: Answers) -> dict[int, float]:
        """Those of the ordered draws."""
        return sample_weights(population, answers, self.audit(population))

    def beside(self, population: Population, answers: Answers) -> list[Estimate]:
        """n/N where its rule is met, plain Monte Carlo where every sample ran."""
        return [*_by_rule(self.k_t, population, answers), *_of_all(population, answers)]

    def why_finished(self, population: Population, answers: Answers) -> str | None:
        """In words."""
        return _why_finished(self, population, answers)


@dataclass(frozen=True)
class Subset:
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
        _check_budget(self)
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

    def budget(self, samples: int) -> int:
        """What the settings say, or for a target alone all samples, or a fifth of them, at least 20."""
        return _budget(self, samples)

    def audit(self, population: Population) -> AuditPlan:
        """How the refined runs are spent. The ranks are trusted, as the levels trust them: no affordable number of even
        draws rules out a rare failure."""
        audit = TwoPhase(self.refined_runs, self.target_cov, seed=self.seed).audit(population)
        return replace(audit, growth=0.5, proving=0)

    def wanted(self, population: Population, answers: Answers, places: int, under_way: Collection[int]) -> list[int]:
        """The rest of the wave; nothing once a target alone is seen to be out of reach."""
        return _audit_wanted(self, self.audit(population), population, answers, under_way)

    def estimate(self, population: Population, answers: Answers) -> Estimate:
        """From the complete waves."""
        return two_phase(population, answers, self.audit(population))

    def path(self, population: Population, answers: Answers) -> list[Estimate]:
        """After every complete wave."""
        return path(population, answers, self.audit(population))

    def weights(self, population: Population, answers: Answers) -> dict[int, float]:
        """Those of the ordered draws."""
        return sample_weights(population, answers, self.audit(population))

    def beside(self, population: Population, answers: Answers) -> list[Estimate]:
        """None: no other estimator knows samples that weigh differently."""
        return []

    def why_finished(self, population: Population, answers: Answers) -> str | None:
        """In words."""
        return _why_finished(self, population, answers)


@dataclass(frozen=True)
class Published:
    """Refined runs in rank order until k_t in a row stand, and n/N: `published`."""

    name: ClassVar[str] = "published"
    k_t: int

    def check(self, sampling: Sampling) -> None:
        """ValueError for a k_t below 1."""
        _check_rule(self.k_t)

    def rough_runs(self, sampling: Sampling) -> int:
        """One of each sample."""
        return sampling.samples

    def coefficients(self, sampling: Sampling, screened: Screened) -> np.ndarray:
        """Those of the scene's samples, (samples, modes)."""
        return sampling.draw()

    def population(self, sampling: Sampling, screened: Screened) -> Population | None:
        """The scene's samples."""
        return all_samples(sampling, screened)

    def budget(self, samples: int) -> None:
        """The stopping rule alone tells."""

    def wanted(self, population: Population, answers: Answers, places: int, under_way: Collection[int]) -> list[int]:
        """The next ranks that the rule needs whatever those under way turn out to be."""
        return next_refined(
            population.rough_displacement, answers, self.k_t, places, broke_off=population.broke_off,
            under_way=under_way,
        )  # fmt: skip

    def estimate(self, population: Population, answers: Answers) -> Estimate:
        """n/N."""
        return published(population.rough_displacement, answers, self.k_t, broke_off=population.broke_off)

    def path(self, population: Population, answers: Answers) -> list[Estimate]:
        """Down the ranks."""
        ranked = [sample for sample in _order(population).tolist() if sample in answers]
        return [self.estimate(population, {s: answers[s] for s in ranked[:n]}) for n in _points(len(ranked), 1)]

    def weights(self, population: Population, answers: Answers) -> dict[int, float]:
        """Each run with an answer counts once."""
        return {sample: 1.0 for sample, failed in answers.items() if failed is not None}

    def beside(self, population: Population, answers: Answers) -> list[Estimate]:
        """Plain Monte Carlo where every sample ran."""
        return _of_all(population, answers)

    def why_finished(self, population: Population, answers: Answers) -> str | None:
        """In words."""
        if self.wanted(population, answers, 1, ()):
            return None
        everything = len(answers) == population.size
        return "all samples ran on the refined grid" if everything else f"{self.k_t} samples in a row stand"


@dataclass(frozen=True)
class ControlVariate:
    """Refined runs of the first samples, and the control variate that the rough ranks make: `control_variate`.

    refined_runs, target_cov, k_t: as for `TwoPhase`. The samples' order says nothing about them, so the first are as
    good as a random subset.
    """

    name: ClassVar[str] = "control variate"
    refined_runs: int | None = None
    target_cov: float | None = None
    k_t: int | None = None

    def check(self, sampling: Sampling) -> None:
        """ValueError for a budget or target that makes no sense."""
        _check_budget(self)
        _check_rule(self.k_t)

    def rough_runs(self, sampling: Sampling) -> int:
        """One of each sample."""
        return sampling.samples

    def coefficients(self, sampling: Sampling, screened: Screened) -> np.ndarray:
        """Those of the scene's samples, (samples, modes)."""
        return sampling.draw()

    def population(self, sampling: Sampling, screened: Screened) -> Population | None:
        """The scene's samples."""
        return all_samples(sampling, screened)

    def budget(self, samples: int) -> int:
        """What the settings say, or for a target alone all samples, or a fifth of them, at least 20."""
        return _budget(self, samples)

    def wanted(self, population: Population, answers: Answers, places: int, under_way: Collection[int]) -> list[int]:
        """The next of the first samples."""
        return _next_in_order(self, population, answers, places, under_way)

    def estimate(self, population: Population, answers: Answers) -> Estimate:
        """With the rough ranks as control; plain Monte Carlo of fewer than 10 runs."""
        known, notes = _of_first(answers, _first(answers))
        if len(known) < 2 * FOLDS:
            found = MonteCarlo().estimate(population, answers)
            return replace(found, notes=(*notes, f"too few runs for a control variate, it takes {2 * FOLDS}"))
        found = control_variate(
            population.rough_displacement, known, folds=FOLDS, rough_threshold=population.failure_displacement
        )
        return replace(found, notes=notes)

    def path(self, population: Population, answers: Answers) -> list[Estimate]:
        """After every 10 samples, or more."""
        return _path_in_order(self, population, answers)

    def weights(self, population: Population, answers: Answers) -> dict[int, float]:
        """Each run with an answer counts once."""
        return dict.fromkeys(_of_first(answers, _first(answers))[0], 1.0)

    def beside(self, population: Population, answers: Answers) -> list[Estimate]:
        """n/N where its rule is met, and plain Monte Carlo: nobody chose the first samples."""
        return [*_by_rule(self.k_t, population, answers), MonteCarlo().estimate(population, answers)]

    def why_finished(self, population: Population, answers: Answers) -> str | None:
        """In words."""
        return _why_finished(self, population, answers)


@dataclass(frozen=True)
class MonteCarlo:
    """Refined runs of the first samples, all unless the settings say fewer, and the share that fails: `monte_carlo`.

    refined_runs, target_cov, k_t: as for `TwoPhase`.
    """

    name: ClassVar[str] = "monte carlo"
    refined_runs: int | None = None
    target_cov: float | None = None
    k_t: int | None = None

    def check(self, sampling: Sampling) -> None:
        """ValueError for a budget or target that makes no sense."""
        _check_budget(self)
        _check_rule(self.k_t)

    def rough_runs(self, sampling: Sampling) -> int:
        """One of each sample."""
        return sampling.samples

    def coefficients(self, sampling: Sampling, screened: Screened) -> np.ndarray:
        """Those of the scene's samples, (samples, modes)."""
        return sampling.draw()

    def population(self, sampling: Sampling, screened: Screened) -> Population | None:
        """The scene's samples."""
        return all_samples(sampling, screened)

    def budget(self, samples: int) -> int:
        """What the settings say, or all samples."""
        return min(self.refined_runs or samples, samples)

    def wanted(self, population: Population, answers: Answers, places: int, under_way: Collection[int]) -> list[int]:
        """The next of the first samples."""
        return _next_in_order(self, population, answers, places, under_way)

    def estimate(self, population: Population, answers: Answers) -> Estimate:
        """The share of the first samples that fails."""
        known, notes = _of_first(answers, _first(answers))
        if not known:
            return Estimate(0.0, (0.0, 1.0), np.inf, 0, "Monte Carlo", notes=("no refined run yet",))
        return replace(monte_carlo(np.array(list(known.values()))), notes=notes)

    def path(self, population: Population, answers: Answers) -> list[Estimate]:
        """After every 10 samples, or more."""
        return _path_in_order(self, population, answers)

    def weights(self, population: Population, answers: Answers) -> dict[int, float]:
        """Each run with an answer counts once."""
        return dict.fromkeys(_of_first(answers, _first(answers))[0], 1.0)

    def beside(self, population: Population, answers: Answers) -> list[Estimate]:
        """n/N where its rule is met, and the control variate where there are samples that it can add."""
        more = [] if _of_all(population, answers) else [ControlVariate().estimate(population, answers)]
        return [*_by_rule(self.k_t, population, answers), *more]

    def why_finished(self, population: Population, answers: Answers) -> str | None:
        """In words."""
        return _why_finished(self, population, answers)


ESTIMATORS = {kind.name: kind for kind in (TwoPhase, Published, ControlVariate, MonteCarlo, Subset)}
"""By the name in a scene."""

SETTINGS = ("k_t", "refined_runs", "target_cov", "levels", "replicates")
"""Keys of a scene that are settings of one estimator or another."""


def named_estimator(name: str, said: Mapping[str, Any]) -> Estimator:
    """The estimator of this name with the settings that a scene gives. said: by key, None for what it does not say.

    A k_t that the estimator has no use for is let be, since every scene used to have one. Raises ValueError for other
    settings that are not the estimator's, and for one that it cannot do without.
    """
    kind = ESTIMATORS[name]
    known = {key: value for key, value in said.items() if value is not None}
    takes = {setting.name: setting for setting in fields(kind)}
    for key, value in known.items():
        if key in SETTINGS and key not in takes and key != "k_t":
            others = [repr(n) for n, other in ESTIMATORS.items() if key in {f.name for f in fields(other)}]
            raise ValueError(
                f"[campaign] {key} = {value} is for estimator = {' or '.join(others)}, not {name!r}: leave it out"
            )
    for key, setting in takes.items():
        if setting.default is MISSING and key not in known:
            raise ValueError(f"[campaign] lacks {key}: add it, estimator = {name!r} needs it")
    made: Estimator = kind(**{key: value for key, value in known.items() if key in takes})
    return made


def _check_budget(estimator: _Budgeted) -> None:
    if estimator.refined_runs is not None and estimator.refined_runs < 10:
        raise ValueError(f"[campaign] refined_runs = {estimator.refined_runs}: give 10 or more, the audit needs some")
    if estimator.target_cov is not None and not 0 < estimator.target_cov < 1:
        raise ValueError(f"[campaign] target_cov = {estimator.target_cov:g}: give a value above 0 and below 1")


def _check_rule(k_t: int | None) -> None:
    if k_t is not None and k_t < 1:
        raise ValueError(f"[campaign] k_t = {k_t}: give 1 or more")


def _budget(estimator: _Budgeted, samples: int) -> int:
    usual = _usual(samples) if estimator.target_cov is None else samples
    return min(estimator.refined_runs or usual, samples)


def _usual(samples: int) -> int:
    return max(20, samples // 5)


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


def _audit_wanted(
    estimator: _Budgeted, audit: AuditPlan, population: Population, answers: Answers, under_way: Collection[int]
) -> list[int]:
    asked = [sample for sample in next_audit(population, answers, audit) if sample not in under_way]
    if asked and estimator.target_cov is not None and estimator.refined_runs is None:
        found = two_phase(population, answers, audit)
        if found.refined_runs >= _usual(population.size) and _out_of_reach(found, estimator.target_cov):
            return []
    return asked


def _out_of_reach(found: Estimate, target: float) -> bool:
    """Whether the sampling of the fields alone scatters more than the target, so that no refined run would help."""
    return after_more_runs(found, 10**9) > target


def _order(population: Population) -> np.ndarray:
    return rank_samples(population.rough_displacement, population.broke_off).order


def _by_rule(k_t: int | None, population: Population, answers: Answers) -> list[Estimate]:
    """n/N, where a k_t is given and the runs meet its rule."""
    if k_t is None or stopping_rank(_order(population), answers, k_t) is None:
        return []
    return [Published(k_t).estimate(population, answers)]


def _of_all(population: Population, answers: Answers) -> list[Estimate]:
    """Plain Monte Carlo, where every sample has an answer."""
    whole = len(answers) == population.size and None not in answers.values()
    return [MonteCarlo().estimate(population, answers)] if whole else []


def _first(answers: Answers) -> int:
    """How many samples have an answer or broke off, from number 0 on without a gap."""
    return next(number for number in range(len(answers) + 1) if number not in answers)


def _of_first(answers: Answers, count: int) -> tuple[dict[int, bool], tuple[str, ...]]:
    """Answers of the first samples, and a note on those without one."""
    known = {number: bool(answers[number]) for number in range(count) if answers[number] is not None}
    lost = count - len(known)
    return known, (f"{lost} refined runs gave no answer and are left out",) if lost else ()


def _next_in_order(
    estimator: _Budgeted, population: Population, answers: Answers, places: int, under_way: Collection[int]
) -> list[int]:
    """The first samples, as many as the budget allows, or until the target is met at a multiple of 10."""
    runs, target = estimator.budget(population.size) or population.size, estimator.target_cov
    if target is not None:
        met = (
            stop
            for stop in range(10, _first(answers) + 1, 10)
            if estimator.estimate(population, {s: answers[s] for s in range(stop)}).cov <= target
        )
        runs = next(met, runs)
        # Not beyond the next look: what is run after it might not be needed.
        runs = min(runs, 10 * (_first(answers) // 10 + 1))
    missing = [number for number in range(runs) if number not in answers and number not in under_way]
    return missing[: max(places - len(under_way), 0)]


def _path_in_order(estimator: Estimator, population: Population, answers: Answers) -> list[Estimate]:
    stops = _points(_first(answers), 10)
    return [estimator.estimate(population, {s: answers[s] for s in range(stop)}) for stop in stops]


def _points(count: int, step: int) -> list[int]:
    """Multiples of `step` up to `count`, and `count`, thinned to some 60."""
    every = step * max(1, -(-count // (step * POINTS)))
    return sorted({*range(every, count, every), count} - {0})


def _why_finished(estimator: _Budgeted, population: Population, answers: Answers) -> str | None:
    """Why an estimator with a budget asks for no further run."""
    if estimator.wanted(population, answers, 1, ()):
        return None
    if len(answers) == population.size:
        return "all samples ran on the refined grid"
    target = estimator.target_cov
    if target is not None and estimator.estimate(population, answers).cov <= target:
        return f"the coefficient of variation is at most {target:g}"
    if target is not None and len(answers) < (estimator.budget(population.size) or 0):
        return (
            f"a coefficient of variation of {target:g} is out of reach with {population.size} samples, "
            "however many run refined: give more samples"
        )
    return "the refined runs allowed are spent"
