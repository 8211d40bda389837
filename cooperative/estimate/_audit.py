"""The audit: a random sample of refined runs, drawn where the rough result leaves most doubt.

Runs are drawn one after another without replacement, in waves; before each wave a logistic model of refined
failure given the rough rank is fitted to all results so far, and draws are made with probabilities q
proportional to w sqrt(p (1 - p)), in part evenly. Each draw alone gives an unbiased estimate of the sum of
w Y over the population,

    T = sum of w Y over the known + sum of w p over the others + w (Y - p) / q,

and because q and p use earlier results only, the errors of successive T are uncorrelated. Their mean with fixed
weights is therefore unbiased whatever the model, and their spread gives its variance: the ordered estimator of
Des Raj (1956), Journal of the American Statistical Association 51, 269-284, DOI 10.1080/01621459.1956.10501326,
with a difference estimator (Cassel, Sarndal and Wretman 1976, Biometrika 63, 615-620) in each draw.

That spread knows only of failures that were drawn. Where the ranking is bad, most failures lie where the model expects
none, and a few draws down there may well miss them all: the estimate is then low half of the time, and its spread is
small just then. Two things guard against it, and neither relies on the ranks:

- A share of every wave is drawn evenly over all that is unknown. It is `exploration` / (`exploration` + draws so far),
  so the first wave is even and the ranks are followed more closely as they prove themselves. Ranks prove nothing while
  all runs end alike: the share is then two thirds at least. It stays at a half or more where more failures turn up
  among draws to which the model gave less than 5 % than a Poisson count of its own mean would bring once in 20 times
  (`surprise`).
- What may still be hidden below the lowest failure seen has an upper limit (`hidden_limit`). If failures of weight s
  lie there at any ranks whatever, no draw meets them with a probability of at most

      product over draws of (1 - s min(q / w)) <= exp(-s m),   m = sum over draws of min(q / w),

  the least taken over the ranks in question, and with an even share f it is at least f. So s <= -log(1 - level) / m
  with confidence `level`: the rule of three (Hanley and Lippman-Hand 1983, JAMA 249, 1743-1745) for draws with known
  probabilities. It assumes nothing of the ranking. The upper limit of P_f takes it in as one of two independent parts
  of a sum (Zou and Donner 2008, Statistics in Medicine 27, 1693-1702, DOI 10.1002/sim.3095): the distances of the
  parts' limits from their estimates, here 0 for the unseen, add up as squares. The lower limit and the coefficient
  of variation are those of the sampling alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from cooperative.estimate._protocol import Population


@dataclass(frozen=True)
class AuditPlan:
    """How the audit spends its runs.

    The same plan and results always ask for the same runs.

    Args:
        runs: refined runs in all.
        seed: of the draws.
        target_cov: stop earlier, after the runs that the estimator takes for this coefficient of variation, as
            `cooperative.estimate._twophase` fixes them.
        first_wave: a wave has the larger of `first_wave` runs and the share `growth` of those before.
        growth: a wave has the larger of `first_wave` runs and the share `growth` of those before.
        floor: least share of even draws, which keeps the estimate unbiased whatever the model.
        exploration: the ranks prove themselves in so many draws: after them the share of draws spread evenly over all
            that is unknown has come down from 1 to a half. 0 trusts the ranks from the start, and the interval then has
            no allowance for what was not seen.
    """

    runs: int
    seed: int = 0
    target_cov: float | None = None
    first_wave: int = 8
    growth: float = 0.25
    floor: float = 0.05
    exploration: int = 12

    def wave(self, runs: int) -> int:
        """Size of the wave that follows `runs` runs of the audit."""
        return max(self.first_wave, int(self.growth * runs))


FAR_DOWN = 0.05
"""Draws to which the model gave a lower probability of failure lie far down the ranking."""

RARELY = 0.05
"""Where the model brings so many failures far down the ranking more rarely than this, the ranks mislead."""


SUPPOSED = 0.25
"""Failures, and runs that stand, that are supposed far down the ranking beside those seen there: with as many the true
scatter of made-up campaigns with a target is at most what they claim, wherever a few failures hide, and half as many
runs more are needed where none do."""

UNPROVEN = 2 / 3
"""Least share of even draws while all runs end alike, in which ranks prove nothing: the limit of P_f is then at most
1.5 times that of as many even draws."""


@dataclass(frozen=True)
class Surprise:
    """Draws far down the ranking.

    Args:
        drawn: how many.
        failed: of them, below a sample that stands.
        expected: failures among them, by the model.
    """

    drawn: int
    failed: int
    expected: float

    @property
    def misled(self) -> bool:
        """Whether more failed than the ranks allow for."""
        return bool(self.failed and scipy.special.pdtrc(self.failed - 1, self.expected) < RARELY)


@dataclass(frozen=True)
class AuditTotal:
    """Weighted total of failures in the population, from the ordered draws.

    Args:
        total: the estimate.
        variance: of the audit alone; nan without draws.
        effective_draws: how many equal residuals would scatter as much, the degrees of freedom of `variance`.
        beyond: mean square of the draws about the total over what the model of their wave expected.
        by_group: the total of each group (G,).
    """

    total: float
    variance: float
    effective_draws: float
    beyond: float
    by_group: np.ndarray


@dataclass(frozen=True)
class Wave:
    """One wave of draws.

    Args:
        ranks: in the order drawn (b,).
        probability: of each draw, given those before (b,).
        chance: of every rank at the first draw of the wave (N,), 0 for those known by then.
        model: (N,).
        even: share of the draws that is spread evenly.
    """

    ranks: np.ndarray
    probability: np.ndarray
    chance: np.ndarray
    model: np.ndarray
    even: float = 0.0


def check_plan(plan: AuditPlan) -> None:
    """ValueError naming the first setting of the plan that makes no sense."""
    if plan.runs < 2 or plan.first_wave < 2:
        raise ValueError(f"runs = {plan.runs}, first_wave = {plan.first_wave}: an audit needs at least 2 of each")
    if not 0 < plan.floor <= 1:
        raise ValueError(f"floor = {plan.floor} is not in (0, 1]: at 0 some samples could never be drawn")
    if plan.exploration < 0:
        raise ValueError(f"exploration = {plan.exploration} is negative: give 0 to trust the ranks from the start")
    if plan.growth < 0:
        raise ValueError(f"growth = {plan.growth} is negative: give 0 for waves of equal size")
    if plan.target_cov is not None and not plan.target_cov > 0:
        raise ValueError(f"target_cov = {plan.target_cov} is not positive: give for example 0.1")


def check_weights(population: Population, weight: np.ndarray, count: int) -> None:
    """Raise ValueError for weights that do not sum to 1, or have no replicates and stand for no zones."""
    if weight.shape != (count,) or not (weight > 0).all() or not np.isclose(weight.sum(), 1.0):
        raise ValueError(f"weight sums to {weight.sum():.6g}: give {count} positive weights that sum to 1")
    if population.replicate is None and population.zones is None and population.weight is not None:
        raise ValueError("weighted samples are not independent: give the replicate that each came from, or its zone")
    if population.replicate is not None and np.unique(population.replicate).size < 2:
        raise ValueError("replicate names fewer than 2 independent runs: give at least 2, better 8")


def draw_wave(
    generator: np.random.Generator,
    model: np.ndarray,
    *,
    weight: np.ndarray,
    finished: np.ndarray,
    size: int,
    floor: float,
    doubt: np.ndarray | None = None,
    order: np.ndarray | None = None,
) -> Wave:
    """Draw up to `size` unknown ranks one after another, none twice.

    Args:
        generator: of random numbers.
        model: (N,).
        weight: (N,).
        finished: (N,).
        size: most draws.
        floor: share of even draws.
        doubt: of each rank (N,), None for that of the model.
        order: sample of each rank (N,), where the draws are to be those of samples whatever their rank.
    """
    unknown = np.flatnonzero(~finished)
    doubt = weight * np.sqrt(model * (1 - model)) if doubt is None else doubt
    probability = (1 - floor) * doubt[unknown] / doubt[unknown].sum() + floor / unknown.size
    # Exponential arrival times with these rates come in the order of successive draws.
    if order is None:
        arrival = generator.exponential(size=unknown.size) / probability
    else:
        arrival = generator.exponential(size=order.size)[order][unknown] / probability
    size = min(size, unknown.size)
    first = np.argpartition(arrival, size - 1)[:size]
    first = first[np.argsort(arrival[first])]
    never = 1.0 - probability[first].sum() if size < unknown.size else 0.0
    remaining = never + np.cumsum(probability[first][::-1])[::-1]
    chance = np.zeros(finished.size)
    chance[unknown] = probability
    return Wave(unknown[first], probability[first] / remaining, chance, model, floor)


def surprise(waves: Sequence[Wave], outcome: np.ndarray) -> Surprise:
    """How draws far down the ranking came out.

    A failure speaks against the ranks only where a sample that ranks above it stands: soil that fails throughout
    agrees with any ranking.

    Args:
        waves: complete ones.
        outcome: 0, 1 or nan by rank (N,).
    """
    if not waves:
        return Surprise(0, 0, 0.0)
    ranks = np.concatenate([wave.ranks for wave in waves])
    model = np.concatenate([wave.model[wave.ranks] for wave in waves])
    far = (model < FAR_DOWN) & ~np.isnan(outcome[ranks])
    stands = np.flatnonzero(outcome == 0)
    highest = stands[0] if stands.size else outcome.size
    failed = int(outcome[ranks[far & (ranks > highest)]].sum())
    return Surprise(int(far.sum()), failed, float(model[far].sum()))


def guarded(waves: Sequence[Wave], outcome: np.ndarray, model: np.ndarray) -> np.ndarray:
    """The model, where samples far down the ranking fail at least as often as the draws among them leave possible.

    It is the rule of succession (Jeffreys 1961, Theory of Probability, Section 3.23) with `SUPPOSED` of either kind. An
    audit with a target draws by it, and claims its variance: failures that hide below what the model knows are seldom
    met, and a campaign that stops when it has met none would claim too little.

    Args:
        waves: complete ones.
        outcome: 0, 1 or nan by rank (N,).
        model: probability of failure by rank (N,).
    """
    far = surprise(waves, outcome)
    rate = (far.failed + SUPPOSED) / (far.drawn + 2 * SUPPOSED)
    return np.where(model < FAR_DOWN, np.maximum(model, rate), model)


def even_share(plan: AuditPlan, waves: Sequence[Wave], outcome: np.ndarray, *, shared: bool = False) -> float:
    """Share of the next wave's draws that is spread evenly over all that is unknown.

    Args:
        plan: of the audit.
        waves: complete ones.
        outcome: 0, 1 or nan by rank (N,).
        shared: whether other campaigns make the same draws, which do not depend on the outcome of one.
    """
    if plan.exploration == 0:
        return plan.floor
    count = sum(wave.ranks.size for wave in waves)
    even = plan.exploration / (plan.exploration + count)
    if shared:
        return max(even, plan.floor)
    if not ((outcome == 0).any() and (outcome == 1).any()):
        return max(even, UNPROVEN)
    return max(even, 0.5 if surprise(waves, outcome).misled else plan.floor)


def hidden_limit(
    waves: Sequence[Wave], outcome: np.ndarray, finished: np.ndarray, *, weight: np.ndarray, level: float
) -> float:
    """Upper limit, at confidence `level`, of the weight of failures below the lowest one seen.

    Args:
        waves: complete ones.
        outcome: by rank (N,); 1 while there are no draws.
        finished: by rank (N,); 1 while there are no draws.
        weight: by rank (N,); 1 while there are no draws.
        level: confidence level.
    """
    failures = np.flatnonzero(outcome == 1)
    lowest = int(failures[-1]) if failures.size else -1
    below = np.flatnonzero(~finished & (np.arange(finished.size) > lowest))
    if not below.size:
        return 0.0
    least = 0.0
    for wave in waves:
        ratios = wave.chance[wave.ranks] / wave.probability
        least += float((wave.chance[below] / weight[below]).min() * (1 / ratios).sum())
    hidden = float(weight[below].sum())
    return min(float(-np.log(1 - level)) / least, hidden) if least else hidden


def draw_variance(wave: Wave, model: np.ndarray, weight: np.ndarray) -> float:
    """Variance of the first draw of a wave, where samples fail with the probabilities `model` (N,).

    Args:
        wave: of draws.
        model: probability of failure of each sample (N,).
        weight: share of all samples (N,).
    """
    open_ = wave.chance > 0
    p, expected = model[open_], wave.model[open_]
    return float((weight[open_] ** 2 * (p * (1 - p) + (p - expected) ** 2) * (1 / wave.chance[open_] - 1)).sum())


def model_variance(waves: Sequence[Wave], draw_weight: np.ndarray, *, model: np.ndarray, weight: np.ndarray) -> float:
    """Variance that a model expects of the draws, which does not vanish when they happen to meet no failure.

    Args:
        waves: complete ones, in order.
        draw_weight: of each draw in the mean (draws,), in proportion.
        model: probability of failure of each sample (N,).
        weight: share of all samples (N,).
    """
    firsts = np.cumsum([0, *(wave.ranks.size for wave in waves)])[:-1]
    squares = np.add.reduceat(draw_weight**2, firsts) / draw_weight.sum() ** 2
    return float(squares @ [draw_variance(wave, model, weight) for wave in waves])


def audit_total(
    waves: Sequence[Wave],
    outcome: np.ndarray,
    certain: np.ndarray,
    *,
    weight: np.ndarray,
    model: np.ndarray,
    draw_weight: np.ndarray,
    group: np.ndarray | None = None,
) -> AuditTotal:
    """The ordered estimate from complete waves.

    Args:
        waves: complete ones, in order.
        outcome: 0 or 1 for each rank that is known, nan for a run that gave no answer (N,); the model then stands in
            for it.
        certain: ranks known without a draw.
        weight: (N,).
        model: failure probability from all results (N,).
        draw_weight: of each draw in the mean (draws,), in proportion.
        group: of each rank, 0 to G - 1 (N,).
    """
    group = np.zeros(weight.size, dtype=int) if group is None else group
    groups = int(group.max()) + 1
    count = draw_weight.size
    draw_weight = draw_weight / max(float(draw_weight.sum()), np.finfo(float).tiny)
    value, seen = np.zeros(weight.size), np.zeros(weight.size, dtype=bool)
    seen[certain] = True
    value[certain] = np.where(np.isnan(outcome[certain]), model[certain], outcome[certain])
    totals, foreseen = np.empty(count), np.empty(count)
    by_group: np.ndarray = np.zeros(groups)
    at = 0
    for wave in waves:
        ranks = wave.ranks
        section = draw_weight[at : at + ranks.size]
        answers = np.where(np.isnan(outcome[ranks]), wave.model[ranks], outcome[ranks])
        residual = weight[ranks] * (answers - wave.model[ranks])
        before = np.bincount(group, weight * np.where(seen, value, wave.model), groups)
        totals[at : at + ranks.size] = before.sum() + np.cumsum(residual) - residual + residual / wave.probability
        # A residual counts in its own draw, over q, and plainly in the later draws of its wave.
        later = section.sum() - np.cumsum(section)
        by_group = by_group + section.sum() * before
        by_group += np.bincount(group[ranks], residual * (section / wave.probability + later), groups)
        foreseen[at : at + ranks.size] = draw_variance(wave, wave.model, weight)
        seen[ranks] = True
        value[ranks] = answers
        at += ranks.size
    if seen.all() or not count:
        by_group = np.bincount(group, weight * np.where(seen, value, model), groups)
        exact = 0.0 if seen.all() else np.nan
        return AuditTotal(float(by_group.sum()), exact, np.inf if seen.all() else 0.0, 1.0, by_group)
    total = float(draw_weight @ totals)
    squares = (draw_weight * (totals - total)) ** 2
    spread = float(squares.sum())
    return AuditTotal(
        total=total,
        variance=spread / (1 - float(draw_weight @ draw_weight)),
        effective_draws=spread**2 / float(squares @ squares) if spread > 0 else float(count),
        beyond=float(np.mean((totals - total) ** 2 / np.where(foreseen > 0, foreseen, np.inf))),
        by_group=by_group,
    )
