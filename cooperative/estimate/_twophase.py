"""The two-phase estimator: all samples on the rough grid, an audited few on the refined one.

Phase one is the sampling of the N fields, phase two the audit of `cooperative.estimate._audit`; the interval holds
both (two-phase sampling: Sarndal, Swensson and Wretman 1992, Model Assisted Survey Sampling, Chapter 9). It assumes
nothing of the ranking: to the scatter of both phases it adds, upwards only, what failures may hide among samples that
were not refined, which `Estimate.hidden_limit` and `Estimate.sampling_interval` give apart. Where draws far down the
ranking fail, a note states it. Where no run has failed P_f is 0, where all have it is 1, and the limit on the other
side is that of `cooperative.estimate._one_outcome`: what the model expects does not count as a failure. Everything is a
pure function of the rows and the plan, so what to run next and the estimate do not depend on what ran at once, in which
order, or after which interruption.

A target for the coefficient of variation goes by the scatter alone.
Who stops once the spread seen so far is small enough stops when few failures happened to be drawn, or when the estimate
happened to be high: the answer is then biased, and its spread claims too little. So an audit with a target does not
look at its claim. Before a wave is drawn, each of its draws is given the share a in the estimate that it can carry,

    a = (variance allowed) / (variance of one draw),

both from what the earlier waves showed, and the audit ends once the shares add up to 1. Every draw is unbiased given
those before it and its share is fixed before it is drawn, so the errors a (T - truth) are differences of a martingale,
and the mean is unbiased however often was looked. As the shares add up to 1, the variance, the sum of a^2 (variance of
one draw), is the mean of the variances allowed: that which the target asks for. Information that is spent to a limit
fixed beforehand: Lan and DeMets (1983), Biometrika 70, 659-663, DOI 10.1093/biomet/70.3.659; weights fixed before each
stage: Cui, Hung and Wang (1999), Biometrics 55, 853-857, DOI 10.1111/j.0006-341X.1999.00853.x.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from cooperative.estimate._audit import (
    AuditPlan,
    AuditTotal,
    Wave,
    audit_total,
    check_plan,
    check_weights,
    draw_variance,
    draw_wave,
    even_share,
    guarded,
    hidden_limit,
    model_variance,
    surprise,
)
from cooperative.estimate._estimates import LEAST_FREEDOM, LEVEL, Estimate, exact_limit, with_variance
from cooperative.estimate._logistic import fit_logistic, normal_scores, predict_logistic, rough_centre
from cooperative.estimate._nested import first_variance
from cooperative.estimate._one_outcome import limit_of_one_outcome
from cooperative.estimate._protocol import Answers, Failures, Population
from cooperative.estimate._ranking import rank_samples

SPENT = 1e-9
"""What is left of the shares of a mean that are all given."""
PRIOR_DRAWS = 16
"""The model's own variance counts for so many draws beside those that were made."""


@dataclass(frozen=True)
class _Replay:
    """The campaign so far, by rank (N,).

    Order of samples, weights, outcomes (nan for none), whether known, ranks of the certainty stratum, complete waves,
    share of each of their draws (draws,), ranks to run next, results of their wave that are there by now, and the model
    of all results.
    """

    order: np.ndarray
    weight: np.ndarray
    outcome: np.ndarray
    finished: np.ndarray
    certain: np.ndarray
    waves: tuple[Wave, ...]
    draw_weight: np.ndarray
    missing: np.ndarray
    waiting: int
    model: np.ndarray

    @property
    def outcome_of_all(self) -> bool | None:
        """Whether all runs with an answer failed, or all stand; None where some do either, or there is none."""
        answered = self.outcome[~np.isnan(self.outcome)]
        return bool(answered[0]) if answered.size and answered.min() == answered.max() else None


def next_audit(population: Population, refined: Answers, plan: AuditPlan) -> list[int]:
    """Samples to run on the refined grid next, those in most doubt first; all may run at once.

    Empty when finished. First the rough runs that broke off, then wave by wave.

    Args:
        population: samples of the first phase.
        refined: sample -> failed, None for a run that gave no answer.
        plan: of the audit.

    Raises:
        ValueError: a plan or population that makes no sense.
    """
    replay = _gone_through(population, refined, plan)
    return [int(sample) for sample in replay.order[replay.missing]]


def two_phase(population: Population, refined: Answers, plan: AuditPlan, *, level: float = LEVEL) -> Estimate:
    """Estimate from the complete waves; see `next_audit` for the arguments.

    Unbiased for any relation between the grids. A run without an answer is replaced by what the model expected of it.
    Before the first wave is complete the interval is (0, 1).

    Args:
        population: samples of the first phase.
        refined: sample -> whether it failed on the refined grid, None for a run that gave no answer.
        plan: of the audit.
        level: confidence level of the interval.

    Example:
        >>> import numpy as np
        >>> from cooperative.estimate import AuditPlan, Population, next_audit, two_phase
        >>> score = np.random.default_rng(1).standard_normal(200)
        >>> population, fails = Population(np.exp(score), failure_displacement=2.5), score > 1.2
        >>> plan, answers = AuditPlan(40), {}
        >>> while numbers := next_audit(population, answers, plan):
        ...     answers |= {number: bool(fails[number]) for number in numbers}
        >>> estimate = two_phase(population, answers, plan)
        >>> low, high = estimate.interval
        >>> len(answers), low <= 0.115 <= high  # of the normal distribution beyond 1.2
        (40, True)
    """
    return _estimate(population, _gone_through(population, refined, plan), plan, level)


def path(population: Population, refined: Answers, plan: AuditPlan) -> list[Estimate]:
    """The estimate after every complete wave, first to last: how it came to where it is."""
    last = {len(replay.waves): replay for replay in _replays(population, refined, plan)}
    return [_estimate(population, replay, plan) for waves, replay in last.items() if waves]


def sample_weights(population: Population, refined: Answers, plan: AuditPlan) -> dict[int, float]:
    """What each refined run stands for: sample -> weight, so that sums of weight times outcome are unbiased totals.

    The weights of the ordered draws without a model; for a share among the failures, or any other mean over samples,
    divide by their sum. Runs that gave no answer, and those of an incomplete wave, have none.

    Args:
        population: samples of the first phase.
        refined: sample -> whether it failed on the refined grid, None for a run that gave no answer.
        plan: of the audit.
    """
    replay = _gone_through(population, refined, plan)
    count, nothing = replay.order.size, np.zeros(replay.order.size)
    waves = [replace(wave, model=nothing) for wave in replay.waves]
    answered = np.where(np.isnan(replay.outcome), 0.0, 1.0)
    total = audit_total(
        waves,
        answered,
        replay.certain,
        weight=replay.weight,
        model=nothing,
        draw_weight=replay.draw_weight,
        group=np.arange(count),
    )
    return {int(replay.order[rank]): float(total.by_group[rank]) for rank in np.flatnonzero(total.by_group > 0)}


def failures(population: Population, refined: Answers, plan: AuditPlan) -> Failures:
    """Where the failures lie, by position in the population.

    The model's expectation for each sample and, where samples were drawn, the correction by the ordered draws.

    Args:
        population: samples of the first phase.
        refined: sample -> whether it failed on the refined grid, None for a run that gave no answer.
        plan: of the audit.
    """
    replay = _gone_through(population, refined, plan)
    position = np.argsort(replay.order)
    chance = np.where(np.isnan(replay.outcome), replay.model, replay.outcome)
    count = _audit(replay, np.arange(position.size)).by_group
    return Failures(population.numbers, replay.weight[position], chance[position], count[position])


_latest: tuple[Population, dict[int, bool | None], AuditPlan, _Replay] | None = None


def _gone_through(population: Population, refined: Answers, plan: AuditPlan) -> _Replay:
    """`_replay`, once for estimate, weights and failures of the same results."""
    global _latest
    latest = _latest
    if latest is None or latest[0] is not population or latest[2] != plan or latest[1] != refined:
        _latest = latest = population, dict(refined), plan, _replay(population, refined, plan)
    return latest[3]


def _replay(population: Population, refined: Answers, plan: AuditPlan) -> _Replay:
    """Go through the campaign again, to its end."""
    *_, last = _replays(population, refined, plan)
    return last


def _replays(population: Population, refined: Answers, plan: AuditPlan) -> Iterator[_Replay]:
    """Go through the campaign again: before its first wave, after every complete one, and in one under way."""
    check_plan(plan)
    ranking = rank_samples(population.rough_displacement, population.broke_off)
    order, count, lost = ranking.order, ranking.order.size, ranking.broke_off.size
    weight = population.weights[order]
    check_weights(population, weight, count)
    if lost > plan.runs - plan.first_wave and plan.runs < count:
        raise ValueError(
            f"{lost} rough runs broke off and want a refined run each, of {plan.runs} runs in all: "
            "give more runs (--refined-runs), or mend the rough grid"
        )
    rare = population.replicate is not None
    score = normal_scores(weight, rare=rare)
    centre = rough_centre(population.rough_displacement[order], weight, population.failure_displacement, rare=rare)
    # The answer of a run that broke off, None, becomes nan.
    samples, results = np.fromiter(refined, int, len(refined)), np.array(list(refined.values()), float)
    there, value = np.zeros(count, bool), np.full(count, np.nan)
    there[samples], value[samples] = True, results
    there, value = there[order], value[order]
    certain = np.arange(lost)
    shared, doubt, common, of_samples = population.shared, None, None, None
    if shared is not None:
        doubt, common = (np.asarray(values)[population.numbers[order]] for values in (shared.doubt, shared.model))
        of_samples = order
        certain = np.union1d(certain, np.flatnonzero(np.isin(population.numbers[order], shared.certain)))
    missing = certain[~there[certain]]
    settled = there & np.isin(np.arange(count), certain)
    waves: list[Wave] = []
    draw_weights, rest, most = [np.zeros(0)], 1.0, min(plan.runs, count) - certain.size
    generator = np.random.default_rng(plan.seed)

    def state() -> _Replay:
        outcome = np.where(settled, value, np.nan)
        # A rough run that broke off has no rank of its own, so it teaches the model nothing.
        usable = np.flatnonzero(~np.isnan(outcome))
        usable = usable[usable >= lost]
        model = common
        if model is None:
            model = predict_logistic(fit_logistic(score[usable], outcome[usable], centre), score, centre)
        waiting = int((there & ~settled).sum()) if missing.size else 0
        draw_weight = np.concatenate(draw_weights)
        return _Replay(
            order, weight, outcome, settled.copy(), certain, tuple(waves), draw_weight, missing, waiting, model
        )

    so_far = state()
    yield so_far
    while not missing.size and so_far.draw_weight.size < most and rest > SPENT:
        remaining = most - so_far.draw_weight.size
        floor = even_share(plan, waves, so_far.outcome, shared=shared is not None)
        size = min(plan.wave(so_far.draw_weight.size), remaining)
        drawn_by = doubt
        if plan.target_cov is not None and plan.exploration and shared is None:
            doubtful = guarded(waves, so_far.outcome, so_far.model)
            drawn_by = weight * np.sqrt(doubtful * (1 - doubtful))
        wave = draw_wave(
            generator, so_far.model, weight=weight, finished=settled, size=size, floor=floor, doubt=drawn_by,
            order=of_samples,
        )  # fmt: skip
        draw_weight = _wave_weights(population, so_far, plan, wave, rest, remaining)
        wave = replace(wave, ranks=wave.ranks[: draw_weight.size], probability=wave.probability[: draw_weight.size])
        missing = wave.ranks[~there[wave.ranks]]
        # Samples in doubt run longest: they begin, so that workers end a wave together.
        missing = missing[np.argsort(np.abs(wave.model[missing] - 0.5), kind="stable")]
        # Results of an incomplete wave wait for the others.
        if not missing.size:
            settled[wave.ranks] = True
            waves.append(wave)
            draw_weights.append(draw_weight)
            rest -= float(draw_weight.sum()) if plan.target_cov is not None else 0.0
        so_far = state()
        yield so_far


def _wave_weights(
    population: Population, so_far: _Replay, plan: AuditPlan, wave: Wave, rest: float, budget: int
) -> np.ndarray:
    """Share of the estimate of each draw of the next wave, from the waves before alone.

    There are fewer than its draws where these are enough for the target.

    Args:
        population: samples of the first phase.
        so_far: waves before.
        plan: of the audit.
        wave: drawn, not yet run.
        rest: what is left of the shares.
        budget: draws that the budget allows.
    """
    size, before = wave.ranks.size, so_far.draw_weight.size
    if plan.target_cov is None:
        return weights_by_order(before, size)
    needed = 0.0
    # Without a failure nothing shows how many draws a target takes.
    if before and size < budget and so_far.outcome_of_all is not False:
        # The estimate with shares by order is steadier while shares are few.
        so_far = replace(so_far, draw_weight=weights_by_order(0, before))
        audit = _audit(so_far, _groups(population, so_far))
        estimate = _scattered(population, so_far, plan, audit)
        expected = float(so_far.weight @ np.where(np.isnan(so_far.outcome), so_far.model, so_far.outcome))
        model = guarded(so_far.waves, so_far.outcome, wave.model) if plan.exploration else wave.model
        variance = draw_variance(wave, model, so_far.weight)
        # Two waves at least.
        needed = min(needed_share(plan.target_cov, estimate, expected, audit.beyond, variance), 0.5 / plan.first_wave)
    return target_weights(needed, rest, before=before, size=size, budget=budget)


def weights_by_order(before: int, size: int) -> np.ndarray:
    """Share of draws (size,), in proportion, that follow `before` others.

    Later draws rest on a better model and on more known outcomes.
    """
    return np.sqrt(np.arange(before + 1.0, before + size + 1.0))


def target_weights(
    needed: float, rest: float, *, before: int, size: int, budget: int, even: bool = False
) -> np.ndarray:
    """Shares of the draws of a wave of `size` (at most size,), of a mean of which `rest` is left to give.

    What the target does not need before the budget ends is shared out as without one. Draws that can carry all that is
    left are the last, and share it evenly; so are the last that the budget allows.

    Args:
        needed: share of one draw by the target.
        rest: share that is left to give.
        before: draws before.
        size: draws of the wave.
        budget: draws that the budget still allows.
        even: whether later draws are worth no more than earlier ones.
    """
    order = np.ones(budget) if even else weights_by_order(before, budget)
    draw_weight = np.maximum(rest * order[:size] / order.sum(), needed)
    enough = int(np.searchsorted(np.cumsum(draw_weight), rest)) + 1
    if enough <= size or size == budget:
        draw_weight = draw_weight[:enough]
        draw_weight *= rest / draw_weight.sum()
    return draw_weight


def needed_share(target: float, estimate: Estimate, expected: float, beyond: float, variance: float) -> float:
    """Share of one draw of the next wave for a target; 0 where sampling alone scatters more.

    Args:
        target: coefficient of variation.
        estimate: from the waves before.
        expected: probability of failure by the model alone, which one heavy draw moves less.
        beyond: scatter of the draws so far over what the model expected.
        variance: of one draw, by the model; it is multiplied by what the draws so far scatter beyond that.
    """
    square = ((estimate.probability + expected) / 2) ** 2
    if not estimate.probability:
        return 0.0
    sampling = estimate.cov**2 - estimate.audit_variance / estimate.probability**2
    factor = (estimate.refined_runs * beyond + PRIOR_DRAWS) / (estimate.refined_runs + PRIOR_DRAWS)
    return max(target**2 - sampling, 0.0) * square / (variance * factor)


def _audit(replay: _Replay, group: np.ndarray | None = None) -> AuditTotal:
    return audit_total(
        replay.waves, replay.outcome, replay.certain,
        weight=replay.weight, model=replay.model, draw_weight=replay.draw_weight, group=group,
    )  # fmt: skip


def _groups(population: Population, replay: _Replay) -> np.ndarray | None:
    """Replicate of each rank, 0 to G - 1; None for independent samples."""
    if population.replicate is None:
        return None
    return np.unique(population.replicate[replay.order], return_inverse=True)[1]


def _estimate(population: Population, replay: _Replay, plan: AuditPlan, level: float = LEVEL) -> Estimate:
    """The estimate by its scatter, or by the limit of runs that all ended alike."""
    audit = _audit(replay, _groups(population, replay))
    estimate, outcome_of_all = _scattered(population, replay, plan, audit, level), replay.outcome_of_all
    if replay.waiting:
        whole = replay.waiting + replay.missing.size
        note = f"{replay.waiting} of {whole} runs of the wave under way are back; they count once all are"
        estimate = replace(estimate, notes=(*estimate.notes, note))
    if np.isnan(estimate.audit_variance) or outcome_of_all is None or (outcome_of_all and not plan.exploration):
        return estimate
    gone = np.flatnonzero(np.isnan(replay.outcome) & replay.finished)
    certain = int(np.isin(gone, replay.certain).sum())
    limit = limit_of_one_outcome(
        population,
        replay.waves,
        finished=replay.finished,
        weight=replay.weight,
        replicate=None if population.replicate is None else population.replicate[replay.order],
        chains=None if population.chains is None else population.chains.moved(np.argsort(replay.order)),
        unanswered=(gone.size - certain, certain),
        exploration=plan.exploration,
        level=level,
    )
    # What all samples leave open where those that did not run are as they rank.
    least = exact_limit(population.independent, level)
    open_ = limit if limit > least * (1 + 1e-9) else 0.0
    if outcome_of_all:
        note = f"every refined run has failed: P_f is 1 so far, and at least {1 - limit:.3g} ({level:.0%} confidence)"
        interval, sampling, open_ = (1 - limit, 1.0), (1 - least, 1.0), 0.0
    else:
        where = (
            ", wherever failures hide in the ranking" if plan.exploration else ", if failures rank above what stands"
        )
        note = f"no refined run has failed: P_f is 0 so far, and at most {limit:.3g} ({level:.0%} confidence){where}"
        interval, sampling = (0.0, limit), (0.0, least)
    return replace(
        estimate,
        probability=float(outcome_of_all),
        interval=interval,
        # The standard deviation of an exponential rest with this limit.
        cov=limit / 3 if outcome_of_all else np.inf,
        audit_variance=max(limit**2 - least**2, 0.0) / 9 if outcome_of_all else 0.0,
        notes=(*estimate.notes, note),
        hidden_limit=open_,
        sampling_interval=sampling if plan.exploration else None,
        freedom=np.inf,
    )


def _scattered(
    population: Population, replay: _Replay, plan: AuditPlan, audit: AuditTotal, level: float = LEVEL
) -> Estimate:
    """The estimate by the scatter of its draws."""
    weight, model, grouped = replay.weight, replay.model, population.replicate is not None
    runs = replay.certain.size + sum(wave.ranks.size for wave in replay.waves)
    notes = []
    if unanswered := int(np.isnan(replay.outcome[replay.finished]).sum()):
        notes.append(f"{unanswered} refined runs gave no answer; the model replaces them")
    silent = bool(np.isnan(replay.outcome).all())
    if silent or np.isnan(audit.variance):
        why = "no refined run gave an answer" if silent and runs else "no wave of the audit is complete yet"
        notes.append(f"{why}: the estimate is the model's")
        return Estimate(audit.total, (0.0, 1.0), np.inf, runs, "two-phase", level, tuple(notes), np.nan)
    variance, total = audit.variance, audit.total
    if (plan.target_cov is not None or grouped) and not replay.finished.all():
        # The scatter of few draws is combined with what the model expects of them.
        draws, expected = (
            replay.draw_weight.size,
            model_variance(replay.waves, replay.draw_weight, model=model, weight=weight),
        )
        variance = (draws * variance + PRIOR_DRAWS * expected) / (draws + PRIOR_DRAWS)
        if plan.target_cov is not None and plan.exploration:
            doubtful = guarded(replay.waves, replay.outcome, model)
            variance += model_variance(replay.waves, replay.draw_weight, model=doubtful, weight=weight) - expected
    hidden = None
    if plan.exploration:
        hidden = hidden_limit(replay.waves, replay.outcome, replay.finished, weight=weight, level=level)
    else:
        notes.append(
            "the interval has no allowance for failures among low-ranked samples that were not refined "
            "(exploration = 0)"
        )
    far = surprise(replay.waves, replay.outcome)
    if far.misled:
        notes.append(
            f"THE RANKS MISLEAD: {far.failed} of {far.drawn} low-ranked samples failed when refined, and the model "
            f"expected {max(far.expected, 0.1):.1f}; more of the runs are now spread evenly over all ranks"
        )
    chance = np.where(np.isnan(replay.outcome), model, replay.outcome)[np.argsort(replay.order)]
    sampling = first_variance(population, min(max(total, 0.0), 1.0), chance)
    both, freedom = _whole_variance(population, replay, audit, variance, sampling)
    return with_variance(
        "two-phase", total, both, runs, freedom=freedom, audit_variance=variance, level=level, notes=tuple(notes),
        hidden_limit=hidden, independent=np.inf if grouped else float(population.independent),
        failed=float(np.nansum(replay.outcome)), stand=float(np.nansum(1 - replay.outcome)), skewed=grouped,
    )  # fmt: skip


def _whole_variance(
    population: Population, replay: _Replay, audit: AuditTotal, variance: float, sampling: float
) -> tuple[float, float]:
    """Variance of all phases and its degrees of freedom; `variance` is that of the audit, `sampling` of those before.

    Independent samples scatter binomially. Replicates of subset simulation show by their own scatter what chains,
    levels and audit do together, whatever depends on what within them (random groups; Wolter 2007, Introduction to
    Variance Estimation, Chapter 2). Where these happen to lie close to each other, chains and audit show more.
    """
    if population.replicate is None:
        both = variance + sampling
        # Welch and Satterthwaite, the part of the sampling being as good as known.
        return both, audit.effective_draws * (both / variance) ** 2 if variance > 0 else np.inf
    scaled, least, freedom = audit.by_group * audit.by_group.size, variance, audit.by_group.size - 1.0
    if population.chains is not None:
        chance = np.where(np.isnan(replay.outcome), replay.model, replay.outcome)[np.argsort(replay.order)]
        least += audit.total**2 * population.chains.relative_variance(chance)
        freedom = max(freedom, LEAST_FREEDOM)
    return max(float(scaled.var(ddof=1)) / scaled.size, least), freedom
