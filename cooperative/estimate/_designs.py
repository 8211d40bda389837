"""Estimators at work: which refined runs each asks for next, and what it makes of them.

All are pure functions of the rows and the plan, so that the answer does not depend on what ran at once, in which order,
or after which interruption. The estimators themselves are in `cooperative.estimators` and `cooperative.twophase`.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from cooperative.estimate._audit import AuditPlan
from cooperative.estimate._estimates import Estimate, after_more_runs, control_variate, monte_carlo, published
from cooperative.estimate._ranking import next_refined, rank_samples
from cooperative.estimate._subset import SubsetPlan, SubsetSamples, subset_simulation
from cooperative.estimate._twophase import Population, next_audit, path, sample_weights, two_phase
from cooperative.scene import Plan

Answers = Mapping[int, bool | None]
"""Sample -> whether it failed on the refined grid; None where the run broke off before it could tell."""

POINTS = 60
"""At most so many points of a path."""


@dataclass(frozen=True)
class Design:
    """What an estimator does in a campaign. `Population` and answers number the samples by their place in the
    population.

    wanted: (plan, population, answers, places, under way) -> samples to start now, at most as many as places are free;
    empty when nothing is to start, and with nothing under way when the campaign is finished.
    estimate: (plan, population, answers) -> estimate. path: likewise, the estimates on the way, first to last.
    weights: likewise, what each refined run stands for.
    """

    wanted: Callable[[Plan, Population, Answers, int, Collection[int]], list[int]]
    estimate: Callable[[Plan, Population, Answers], Estimate]
    path: Callable[[Plan, Population, Answers], list[Estimate]]
    weights: Callable[[Plan, Population, Answers], dict[int, float]]


def budget(plan: Plan, samples: int) -> int:
    """Refined runs that a plan allows: what it says, or for Monte Carlo and for a target alone all samples, or a fifth
    of them, at least 20."""
    everything = plan.estimator == "monte carlo" or plan.target_cov is not None
    return min(plan.refined_runs or (samples if everything else _usual(samples)), samples)


def _usual(samples: int) -> int:
    return max(20, samples // 5)


def audit_plan(plan: Plan, samples: int | None = None) -> AuditPlan:
    """How the two-phase estimator spends its refined runs; without a ranked prefix, which costs more than it tells."""
    runs = budget(plan, plan.samples if samples is None else samples)
    found = AuditPlan(runs, seed=plan.seed, target_cov=plan.target_cov)
    return replace(found, growth=0.5) if plan.estimator == "subset" else found


def subset_plan(plan: Plan) -> SubsetPlan:
    """Subset simulation with the plan's samples per level, in all replicates together."""
    usual = SubsetPlan()
    replicates = plan.replicates or usual.replicates
    return SubsetPlan(
        per_level=plan.samples // replicates, levels=plan.levels or usual.levels, replicates=replicates, seed=plan.seed
    )


def rough_runs(plan: Plan) -> int:
    """Rough runs that a plan takes."""
    if plan.estimator != "subset":
        return plan.samples
    subset = subset_plan(plan)
    chains = round(subset.per_level * subset.share)
    return subset.replicates * (subset.per_level + subset.levels * (subset.per_level - chains))


def replay_subset(plan: Plan, modes: int, displacement: Mapping[int, float]) -> SubsetSamples:
    """Subset simulation gone through again. displacement: rough run -> displacement (m), nan where it broke off.

    Raises KeyError for a rough run that is not there yet.
    """
    numbers: Iterator[int] = iter(range(rough_runs(plan)))
    return subset_simulation(
        lambda xi: np.array([displacement[next(numbers)] for _ in range(len(xi))]), modes, subset_plan(plan)
    )


def _audit_wanted(
    plan: Plan, population: Population, answers: Answers, places: int, under_way: Collection[int]
) -> list[int]:
    audit = audit_plan(plan, population.rough_displacement.size)
    asked = [sample for sample in next_audit(population, answers, audit) if sample not in under_way]
    if asked and plan.target_cov is not None and plan.refined_runs is None:
        found = two_phase(population, answers, audit)
        if found.refined_runs >= _usual(population.rough_displacement.size) and _out_of_reach(found, plan.target_cov):
            return []
    return asked


def _out_of_reach(found: Estimate, target: float) -> bool:
    """Whether the sampling of the fields alone scatters more than the target, so that no refined run would help."""
    return after_more_runs(found, 10**9) > target


def _published_wanted(
    plan: Plan, population: Population, answers: Answers, places: int, under_way: Collection[int]
) -> list[int]:
    return next_refined(
        population.rough_displacement, answers, plan.k_t, places, failed_lanes=population.failed_lanes,
        under_way=under_way,
    )  # fmt: skip


def _published(plan: Plan, population: Population, answers: Answers) -> Estimate:
    return published(population.rough_displacement, answers, plan.k_t, failed_lanes=population.failed_lanes)


def _published_path(plan: Plan, population: Population, answers: Answers) -> list[Estimate]:
    order = rank_samples(population.rough_displacement, population.failed_lanes).order.tolist()
    ranked = [sample for sample in order if sample in answers]
    return [_published(plan, population, {s: answers[s] for s in ranked[:n]}) for n in _points(len(ranked), 1)]


def _first(answers: Answers) -> int:
    """How many samples have an answer or broke off, from number 0 on without a gap."""
    return next(number for number in range(len(answers) + 1) if number not in answers)


def _of_first(answers: Answers, count: int) -> tuple[dict[int, bool], tuple[str, ...]]:
    """Answers of the first samples, and a note on those without one."""
    known = {number: bool(answers[number]) for number in range(count) if answers[number] is not None}
    lost = count - len(known)
    return known, (f"{lost} refined runs gave no answer and are left out",) if lost else ()


def _monte_carlo(plan: Plan, population: Population, answers: Answers) -> Estimate:
    known, notes = _of_first(answers, _first(answers))
    if not known:
        return Estimate(0.0, (0.0, 1.0), np.inf, 0, "Monte Carlo", notes=("no refined run yet",))
    return replace(monte_carlo(np.array(list(known.values()))), notes=notes)


FOLDS = 5
"""Folds of the control variate; it takes two runs in each."""


def _control_variate(plan: Plan, population: Population, answers: Answers) -> Estimate:
    known, notes = _of_first(answers, _first(answers))
    if len(known) < 2 * FOLDS:
        found = _monte_carlo(plan, population, answers)
        return replace(found, notes=(*notes, f"too few runs for a control variate, it takes {2 * FOLDS}"))
    return replace(control_variate(population.rough_displacement, known, folds=FOLDS), notes=notes)


def _in_order(estimate: Callable[[Plan, Population, Answers], Estimate]) -> Design:
    """Refined runs of the first samples, as many as the budget allows, or until the target is met at a multiple of 10.

    The samples' order says nothing about them, so the first are as good as a random subset.
    """

    def path_of(plan: Plan, population: Population, answers: Answers) -> list[Estimate]:
        stops = _points(_first(answers), 10)
        return [estimate(plan, population, {s: answers[s] for s in range(stop)}) for stop in stops]

    def wanted(
        plan: Plan, population: Population, answers: Answers, places: int, under_way: Collection[int]
    ) -> list[int]:
        runs, target = budget(plan, population.rough_displacement.size), plan.target_cov
        if target is not None:
            met = (
                stop
                for stop in range(10, _first(answers) + 1, 10)
                if estimate(plan, population, {s: answers[s] for s in range(stop)}).cov <= target
            )
            runs = next(met, runs)
            # Not beyond the next look: what is run after it might not be needed.
            runs = min(runs, 10 * (_first(answers) // 10 + 1))
        missing = [number for number in range(runs) if number not in answers and number not in under_way]
        return missing[: max(places - len(under_way), 0)]

    def weights(plan: Plan, population: Population, answers: Answers) -> dict[int, float]:
        return dict.fromkeys(_of_first(answers, _first(answers))[0], 1.0)

    return Design(wanted, estimate, path_of, weights)


def _points(count: int, step: int) -> list[int]:
    """Multiples of `step` up to `count`, and `count`, thinned to some 60."""
    every = step * max(1, -(-count // (step * POINTS)))
    return sorted({*range(every, count, every), count} - {0})


def _audit(plan: Plan, population: Population) -> AuditPlan:
    return audit_plan(plan, population.rough_displacement.size)


_TWO_PHASE = Design(
    _audit_wanted,
    lambda plan, population, answers: two_phase(population, answers, _audit(plan, population)),
    lambda plan, population, answers: path(population, answers, _audit(plan, population)),
    lambda plan, population, answers: sample_weights(population, answers, _audit(plan, population)),
)

DESIGNS = {
    "two-phase": _TWO_PHASE,
    "subset": _TWO_PHASE,
    "published": Design(
        _published_wanted,
        _published,
        _published_path,
        lambda plan, population, answers: {s: 1.0 for s, failed in answers.items() if failed is not None},
    ),
    "control variate": _in_order(_control_variate),
    "monte carlo": _in_order(_monte_carlo),
}
"""By the name of the estimator in a scene."""
