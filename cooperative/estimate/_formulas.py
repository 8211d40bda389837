"""Estimates without an audit, as pure functions: Monte Carlo, the published rule, the control variate."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np

from cooperative.estimate._estimates import LEVEL, RARE, Estimate, binomial, count_interval, with_variance
from cooperative.estimate._logistic import fit_logistic, normal_scores, predict_logistic, rough_centre
from cooperative.estimate._protocol import Answers
from cooperative.estimate._ranking import rank_samples, stopping_rank

MONTE_CARLO, CONTROL_VARIATE = "Monte Carlo", "multifidelity control variate"
FOLDS = 5
"""Folds of the control variate; it takes two runs in each."""


def as_answers(failed: Iterable[object]) -> np.ndarray:
    """Answers (n,) bool; ValueError for none, or for one that is neither true nor false.

    Args:
        failed: whether each sample failed, True or False, 1 or 0.
    """
    answers = np.asarray(failed).ravel().tolist()
    if wrong := [answer for answer in answers if answer not in (0, 1)]:
        raise ValueError(
            f"failed holds {wrong[0]!r}: give True or False of each run, and leave out runs that broke off"
        )
    if not answers:
        raise ValueError("failed is empty: give the answer of one run or more")
    return np.array(answers, dtype=bool)


def monte_carlo(failed: np.ndarray, *, level: float = LEVEL, samples: float = np.inf) -> Estimate:
    """n/N of samples that all ran on the refined grid, with a Wilson interval.

    Args:
        failed: (N,) bool.
        level: confidence level of the interval.
        samples: that can run in all, these among them.

    Raises:
        ValueError: an answer is missing.

    Example:
        >>> import numpy as np
        >>> from cooperative import monte_carlo
        >>> monte_carlo(np.arange(100) < 10).probability
        0.1
    """
    failed = as_answers(failed)
    proportion = float(failed.mean())
    remaining = proportion * (1 - proportion) * (1 / failed.size - 1 / samples)
    return binomial(MONTE_CARLO, int(failed.sum()), failed.size, failed.size, level=level, audit_variance=remaining)


def published(
    rough_displacement: np.ndarray,
    refined: Answers,
    k_t: int,
    *,
    broke_off: np.ndarray | None = None,
    level: float = LEVEL,
) -> Estimate:
    """n/N of Jiang et al.

    (2024), Computers and Geotechnics 172, 106413, with a binomial interval.

    n failures are counted down to the stopping rank of k_t; all samples below it are taken to stand, which makes the
    estimate too low when the grids disagree. The interval holds the sampling of the N only, and while the rule is not
    met that all which did not run may fail.

    Args:
        rough_displacement: (N,) m.
        refined: sample -> failed, None for a run without an answer.
        k_t: consecutive samples that must stand.
        broke_off: (N,) bool, rough runs without a result.
        level: confidence level of the interval.
    """
    order = rank_samples(rough_displacement, broke_off).order
    rank = stopping_rank(order, refined, k_t)
    ranked = [refined[int(sample)] for sample in order[:rank] if int(sample) in refined]
    unanswered, notes = ranked.count(None), []
    if rank is None or rank < order.size:
        notes.append("samples below the stopping rank are taken to stand: the estimate tends to be low")
    if rank is None:
        notes.append(f"the stopping rule (k_t = {k_t}) is not met yet")
    if unanswered:
        notes.append(f"{unanswered} refined runs gave no answer: up to {unanswered / order.size:.2g} more")
    failures, count = ranked.count(True), order.size
    estimate = binomial("published n/N", failures, count, len(ranked), level=level, notes=tuple(notes))
    if rank is not None:
        return estimate
    high = count_interval(failures + count - len(ranked) + unanswered, count, level)[1]
    return replace(estimate, interval=(estimate.interval[0], high))


def control_variate(
    rough_displacement: np.ndarray,
    refined: Mapping[int, bool],
    *,
    failure_displacement: float = 1.0,
    level: float = LEVEL,
) -> Estimate:
    """Multifidelity control variate for a random subset of the samples run on both grids.

    Peherstorfer, Willcox and Gunzburger (2016), SIAM Journal on Scientific Computing 38, A3163-A3194. The control is
    the failure probability given the rough rank, from a logistic fit to the other folds, so that no sample takes part
    in its own prediction.

    Args:
        rough_displacement: (N,) (m).
        refined: sample -> failed, of at least 2 samples per fold drawn without regard to their rough result, for
            example the first n.
        failure_displacement: beyond which a sample has failed (m).
        level: confidence level of the interval. With fewer than `RARE` failures, or runs that stand, it is as wide as
            that of the refined runs alone; where these all end alike, so does the estimate, whatever the ranks expect.

    Raises:
        ValueError: there are fewer runs, or an answer is missing.
    """
    count = np.size(rough_displacement)
    if len(refined) < 2 * FOLDS:
        raise ValueError(f"{len(refined)} refined runs in {FOLDS} folds: give at least {2 * FOLDS} runs")
    rank = np.argsort(rank_samples(rough_displacement).order)
    score = normal_scores(np.ones(count))[rank]
    # Samples of one displacement share a score: in the order of their numbers the first, which ran, would seem worse.
    _, alike = np.unique(np.where(np.isfinite(rough_displacement), rough_displacement, np.inf), return_inverse=True)
    score = (np.bincount(alike, score) / np.bincount(alike))[alike]
    centre = rough_centre(rough_displacement, np.ones(count), failure_displacement)
    runs = np.fromiter(sorted(refined), dtype=int)
    failed = as_answers([refined[int(run)] for run in runs]).astype(float)
    if failed.min() == failed.max():
        return binomial(CONTROL_VARIATE, failed.sum(), runs.size, runs.size, level=level)
    residual, predicted = np.empty(runs.size), 0.0
    for fold in range(FOLDS):
        in_fold = np.arange(runs.size) % FOLDS == fold
        model = fit_logistic(score[runs[~in_fold]], failed[~in_fold], centre)
        residual[in_fold] = failed[in_fold] - predict_logistic(model, score[runs[in_fold]], centre)
        predicted += in_fold.mean() * predict_logistic(model, score, centre).mean()
    probability = predicted + float(residual.mean())
    proportion = min(max(probability, 0.0), 1.0)
    spread = float(residual.var(ddof=1)) * (1 / runs.size - 1 / count)
    estimate = with_variance(
        CONTROL_VARIATE, probability, proportion * (1 - proportion) / count + spread, runs.size,
        freedom=runs.size - 1, audit_variance=spread, level=level,
    )  # fmt: skip
    if min(failed.sum(), (1 - failed).sum()) >= RARE:
        return estimate
    ends = zip(estimate.interval, count_interval(failed.sum(), runs.size, level), strict=True)
    (low, also_low), (high, also_high) = ends
    return replace(estimate, interval=(min(low, also_low), max(high, also_high)))


def annual(chance: float, often: float) -> float:
    """Probability of one event or more in a year, of Poisson's process.

    Args:
        chance: that a trigger leads to the event.
        often: triggers a year.
    """
    return -math.expm1(-often * chance)
