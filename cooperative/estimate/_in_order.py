"""Runs of the first samples to a target, one after another, without a bias by the moment at which they end.

Who stops once the scatter seen so far is small enough stops while failures happen to be many: of Monte Carlo to a
coefficient of variation of 25 % the answer is then 10 % too high, and scatters 1.4 times as much as it claims. So no
claim is looked at, as in an audit with a target (`cooperative.estimate._twophase`). Samples come in their own order,
which knows nothing of their soil. Before some of them run, each of these is given the share in the estimate that it
can carry by the target, from what ran before, and the runs end where the shares add up to 1:

    estimate = sum over draws of share (Y - c + mean of c),

with a control c of each sample that rests on earlier runs alone, or none. Each draw is unbiased and its share is fixed
before it, so the sum is unbiased whenever it ends.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from cooperative.estimate._estimates import LEVEL, RARE, Estimate, binomial, count_interval, with_variance
from cooperative.estimate._twophase import PRIOR_DRAWS, SPENT, target_weights

Control = Callable[[np.ndarray], np.ndarray]
"""Outcomes of the first samples (n,), nan without an answer -> probability of failure of each sample (N,)."""


@dataclass(frozen=True)
class Ordered:
    """What ran in order, to the last complete look.

    Args:
        draw_weight: of each run in the estimate (n,), in proportion.
        run_estimates: what each run alone would estimate (n,).
        to_run: samples that are to have run by the next look; as many as there are shares where the target is met or
            the budget spent.
    """

    draw_weight: np.ndarray
    run_estimates: np.ndarray
    to_run: int


def in_order(
    outcome: np.ndarray, samples: int, *, target: float, budget: int, control: Control | None = None, interval: int = 10
) -> Ordered:
    """Go through the runs again, from look to look.

    Args:
        outcome: of the first samples, 0, 1, or nan for a run without an answer, which counts as what is expected of it
            (n,).
        samples: N.
        target: coefficient of variation.
        budget: most runs.
        control: of each sample by earlier outcomes, None for nothing.
        interval: runs between looks.
    """
    draw_weight, answers = np.zeros(0), np.zeros(0)
    while True:
        runs, rest = draw_weight.size, 1.0 - float(draw_weight.sum())
        if rest <= SPENT:
            return Ordered(draw_weight, answers, runs)
        chance = _expected(outcome[:runs], samples, control)
        needed = _needed(draw_weight, answers, outcome[:runs], chance, target, controlled=control is not None)
        size = min(interval, budget - runs)
        fixed = target_weights(needed, rest, before=runs, size=size, budget=budget - runs, even=True)
        now = slice(runs, runs + fixed.size)
        if outcome.size < now.stop:
            return Ordered(draw_weight, answers, now.stop)
        expected = np.zeros(samples) if control is None else chance
        answer = np.where(np.isnan(outcome[now]), chance[now], outcome[now])
        draw_weight, answers = (
            np.append(draw_weight, fixed),
            np.append(answers, answer - expected[now] + expected.mean()),
        )


def ordered_estimate(
    method: str, outcome: np.ndarray, samples: int, ordered: Ordered, *, control: Control | None, level: float = LEVEL
) -> Estimate:
    """The estimate from what ran in order, at least one look of it; see `in_order` for the arguments."""
    runs = ordered.draw_weight.size
    outcome = outcome[:runs]
    failed, stand = float(np.nansum(outcome)), float(np.nansum(1 - outcome))
    if min(failed, stand) == 0 or failed + stand == samples:
        return binomial(method, failed, max(failed + stand, 1.0), runs, level=level)
    chance = _expected(outcome, samples, control)
    probability, variance = _scatter(ordered.draw_weight, ordered.run_estimates, chance)
    proportion = min(max(probability, 0.0), 1.0)
    of_samples = proportion * (1 - proportion) / samples
    # The controlled sum leaves the sampling of the population out, the plain one holds it.
    both = variance * (1 - runs / samples) + of_samples if control is not None else variance
    audit = max(both - of_samples, 0.0)
    estimate = with_variance(method, probability, both, runs, freedom=runs - 1, audit_variance=audit, level=level)
    if min(failed, stand) >= RARE:
        return estimate
    low, high = count_interval(failed, failed + stand, level)
    return replace(estimate, interval=(min(low, estimate.interval[0]), max(high, estimate.interval[1])))


def _expected(outcome: np.ndarray, samples: int, control: Control | None) -> np.ndarray:
    """Probability of failure of each sample (N,).

    By the control, or by two failures and two that stand more than were seen (Agresti and Coull 1998, DOI
    10.1080/00031305.1998.10480550).
    """
    if control is not None:
        return control(outcome)
    answered = outcome[~np.isnan(outcome)]
    return np.full(samples, (answered.sum() + 2) / (answered.size + 4))


def _scatter(draw_weight: np.ndarray, answers: np.ndarray, chance: np.ndarray) -> tuple[float, float]:
    """Mean of runs and its variance, that of few runs combined with what is expected of them."""
    draw_weight = draw_weight / draw_weight.sum()
    mean, squares = float(draw_weight @ answers), float(draw_weight @ draw_weight)
    spread = float(draw_weight**2 @ (answers - mean) ** 2) / (1 - squares)
    expected = squares * float(np.mean(chance * (1 - chance)))
    return mean, (draw_weight.size * spread + PRIOR_DRAWS * expected) / (draw_weight.size + PRIOR_DRAWS)


def _needed(
    draw_weight: np.ndarray,
    answers: np.ndarray,
    outcome: np.ndarray,
    chance: np.ndarray,
    target: float,
    *,
    controlled: bool,
) -> float:
    """Share of a run for a target, by the runs before it; 0 where there are none, or none failed."""
    if not np.nansum(outcome):
        return 0.0
    even = np.ones_like(draw_weight)
    mean, variance = _scatter(even, answers, chance)
    probability = (min(max(mean, 0.0), 1.0) + float(chance.mean())) / 2
    sampling = probability * (1 - probability) / chance.size if controlled else 0.0
    return max((target * probability) ** 2 - sampling, 0.0) / (variance * draw_weight.size)
