"""Campaigns on synthetic pairs of grids: a rough response, a refined one linked to it, and an estimator."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.stats import norm
from scipy.stats import t as student

from cooperative.estimate import (
    AuditPlan,
    ControlVariate,
    Estimate,
    MonteCarlo,
    Population,
    SubsetPlan,
    TwoPhase,
    published,
    subset_simulation,
    two_phase,
)

# As on the published section, the rough grid fails at a higher response: half as often.
ROUGH_FAILS = 0.5
NEVER = 1e-7
"""P_f of the rough grid, over `ROUGH_FAILS`, where that of the refined one is 0."""


@dataclass(frozen=True)
class Case:
    """One cell of the study. pf: truth. samples: N of the first phase. runs: of the second.
    contaminated: share of samples whose rough response shows nothing, which no model here foresees. link: how the
    responses of both grids hang together, a name in `LINKS`. target_cov: coefficient of variation at which the audit
    ends before its runs are spent. levels: of subset simulation, with `samples` per level and replicate."""

    method: str
    pf: float
    correlation: float
    samples: int
    runs: int
    contaminated: float = 0.0
    link: str = "normal"
    target_cov: float | None = None
    levels: int = 3


Pair = tuple[np.ndarray, np.ndarray]


def _normal(case: Case, rough: np.ndarray, other: np.ndarray, generator: np.random.Generator) -> Pair:
    refined = case.correlation * rough + np.sqrt(1 - case.correlation**2) * other
    return rough, refined > norm.isf(case.pf)


def _t_copula(
    case: Case, rough: np.ndarray, other: np.ndarray, generator: np.random.Generator, freedom: int = 3
) -> Pair:
    """Both responses over the root of one chi-squared number: they go astray together."""
    refined = case.correlation * rough + np.sqrt(1 - case.correlation**2) * other
    scale = np.sqrt(generator.chisquare(freedom, rough.size) / freedom)
    return norm.ppf(student.cdf(rough / scale, freedom)), refined / scale > student.isf(case.pf, freedom)


def _safest_fifth(case: Case, rough: np.ndarray, other: np.ndarray, generator: np.random.Generator) -> Pair:
    """Of the fifth that ranks lowest so many fail, whatever their response."""
    refined = case.correlation * rough + np.sqrt(1 - case.correlation**2) * other
    lowest = rough < norm.ppf(FIFTH)
    hidden = generator.random(rough.size) < HIDDEN
    # Hardly any of the lowest fails by its response.
    return rough, np.where(lowest, hidden, refined > norm.isf(case.pf - FIFTH * HIDDEN))


def _both_ends(case: Case, rough: np.ndarray, other: np.ndarray, generator: np.random.Generator) -> Pair:
    refined = case.correlation * rough + np.sqrt(1 - case.correlation**2) * other
    return rough, np.abs(refined) > norm.isf(case.pf / 2)


def _clayton(case: Case, rough: np.ndarray, other: np.ndarray, generator: np.random.Generator) -> Pair:
    """By conditional inversion: good ranks of what stands, poor ones of what fails."""
    first, condition = norm.cdf(rough), norm.cdf(other)
    second = ((condition ** (-CLAYTON / (1 + CLAYTON)) - 1) * first**-CLAYTON + 1) ** (-1 / CLAYTON)
    return rough, second > 1 - case.pf


def _gumbel(case: Case, rough: np.ndarray, other: np.ndarray, generator: np.random.Generator) -> Pair:
    """By a positive stable number common to both (Kanter 1975): good ranks of what fails."""
    power, angle = 1 / GUMBEL, np.pi * generator.random(rough.size)
    scale = np.sin(power * angle) / np.sin(angle) ** GUMBEL
    scale *= (np.sin((1 - power) * angle) / generator.exponential(size=rough.size)) ** (GUMBEL - 1)
    first, second = np.exp(-((generator.exponential(size=(2, rough.size)) / scale) ** power))
    return norm.ppf(first), second > 1 - case.pf


LINKS: dict[str, Callable[..., Pair]] = {
    "normal": _normal,
    "t-copula": _t_copula,
    "both ends": _both_ends,
    "Clayton": _clayton,
    "Gumbel": _gumbel,
    "t-copula of 2 degrees": partial(_t_copula, freedom=2),
    "safest fifth": _safest_fifth,
}
FIFTH, HIDDEN = 0.2, 0.03
CLAYTON, GUMBEL = 4.08, 3.01
"""Parameters of the copulas for a rank correlation of 0.85, which stands as the correlation of their cases."""


def draw(case: Case, generator: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Rough displacement (N,), 1 m where the rough grid fails, and refined failure (N,)."""
    rough, other = generator.standard_normal((2, case.samples))
    rough, failed = LINKS[case.link](case, rough, other, generator)
    if case.contaminated:
        lost = generator.random(case.samples) < case.contaminated
        rough = np.where(lost, generator.standard_normal(case.samples), rough)
    # The rough grid ranks soil that never fails, too.
    return np.exp(rough - norm.isf(ROUGH_FAILS * max(case.pf, NEVER))), failed


def _two_phase(case: Case, displacement: np.ndarray, failed: np.ndarray, seed: int) -> Estimate:
    population = Population(displacement)
    if case.target_cov is None:
        plan = AuditPlan(runs=case.runs, seed=seed, growth=0.25 if case.runs < 200 else 0.5)
    else:
        plan = TwoPhase(refined_runs=case.runs, target_cov=case.target_cov, seed=seed).audit(population)
    return two_phase(population, dict(enumerate(failed.tolist())), plan)


def _in_order(
    kind: type[ControlVariate] | type[MonteCarlo], case: Case, displacement: np.ndarray, failed: np.ndarray
) -> Estimate:
    estimator = kind(refined_runs=case.runs, target_cov=case.target_cov)
    ran = failed if case.target_cov is not None else failed[: case.runs]
    return estimator.estimate(Population(displacement), dict(enumerate(ran.tolist())))


METHODS: dict[str, Callable[[Case, np.ndarray, np.ndarray, int], Estimate]] = {
    "two-phase": _two_phase,
    "published n/N": lambda case, rough, failed, seed: published(
        rough, dict(enumerate(failed.tolist())), max(case.samples // 50, 5)
    ),
    "Monte Carlo": lambda case, rough, failed, seed: _in_order(MonteCarlo, case, rough, failed),
    "control variate": lambda case, rough, failed, seed: _in_order(ControlVariate, case, rough, failed),
}


def _subset(case: Case, seed: int) -> tuple[Estimate, int]:
    """Estimate and rough runs spent; the refined response depends on a coefficient of its own."""
    threshold = float(np.exp(-norm.isf(ROUGH_FAILS * case.pf)))
    samples = subset_simulation(
        lambda xi: threshold * np.exp(xi[:, 0]), 4, SubsetPlan(per_level=case.samples, levels=case.levels, seed=seed)
    )
    xi = samples.coefficients
    refined = case.correlation * xi[:, 0] + np.sqrt(1 - case.correlation**2) * xi[:, 1]
    failed = refined > norm.isf(case.pf)
    population = Population(
        samples.rough_displacement, weight=samples.weight, replicate=samples.replicate, chains=samples.chains
    )
    plan = AuditPlan(runs=case.runs, seed=seed, growth=0.5, exploration=0)
    answer = two_phase(population, dict(enumerate(failed.tolist())), plan)
    return answer, samples.rough_runs


def repeat(case: Case, first: int, count: int) -> np.ndarray:
    """Campaigns number `first` to `first + count`: rows of P_f, limits, the upper one of sampling alone,
    coefficient of variation claimed, refined runs, rough runs, sample P_f."""
    rows = []
    for number in range(first, first + count):
        seeds = [number, int(1e4 * case.pf), int(100 * abs(case.correlation))]
        if case.link != "normal" or case.correlation < 0:
            seeds += [list(LINKS).index(case.link), int(case.correlation < 0)]
        generator = np.random.default_rng(seeds)
        if case.method == "subset simulation, two-phase":
            answer, rough_runs = _subset(case, number)
            share = case.pf
        else:
            displacement, failed = draw(case, generator)
            answer = METHODS[case.method](case, displacement, failed, number)
            share = case.pf if case.method == "Monte Carlo" else float(failed.mean())
            rough_runs = 0 if case.method == "Monte Carlo" else case.samples
        high = (answer.sampling_interval or answer.interval)[1]
        rows.append((answer.probability, *answer.interval, high, answer.cov, answer.refined_runs, rough_runs, share))
    return np.array(rows)
