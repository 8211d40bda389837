"""Probability of failure with an interval: published n/N, full Monte Carlo, control variate.

Estimators read rows only: a rough displacement per sample and the refined results known so far. The default,
the two-phase estimator, is in the module beside.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.stats import norm
from scipy.stats import t as student

from cooperative.estimate._audit import fit_logistic, normal_scores, predict_logistic, rough_centre
from cooperative.estimate._ranking import rank_samples, stopping_rank


@dataclass(frozen=True)
class Estimate:
    """A probability of failure.

    probability: P_f. interval: confidence limits (low, high) at `level`. cov: coefficient of variation of the
    estimator, its standard error over P_f (inf at P_f = 0). refined_runs: runs on the refined grid that it
    used. method: name of the estimator. notes: what a reader must know, in words. audit_variance: the part of
    the estimator's variance that more refined runs of the same samples would reduce. unseen: what samples that were
    not looked at may add to P_f, at `level`, which `interval` allows for above and `cov` does not. sampling_interval:
    limits without that allowance, None where there is none. freedom: degrees of freedom of `cov`.
    """

    probability: float
    interval: tuple[float, float]
    cov: float
    refined_runs: int
    method: str
    level: float = 0.95
    notes: tuple[str, ...] = ()
    audit_variance: float = 0.0
    unseen: float = 0.0
    sampling_interval: tuple[float, float] | None = None
    freedom: float = np.inf


def with_variance(
    method: str,
    probability: float,
    variance: float,
    refined_runs: int,
    *,
    freedom: float = np.inf,
    audit_variance: float = 0.0,
    level: float = 0.95,
    notes: tuple[str, ...] = (),
    unseen: float | None = None,
    independent: float = np.inf,
) -> Estimate:
    """An estimate from P_f and its variance: Wilson's interval of as many independent samples as would scatter
    as much, with Student's t for the degrees of freedom of the variance.

    unseen: upper limit of what was not seen, an independent part of P_f that the estimate takes for 0; it widens the
    interval upwards by squares, as `cooperative.estimate._audit` explains. None for no such part.
    independent: samples that there are: however little varies among them, none of 10 failing leaves P_f open to 0.28.
    """
    share = min(max(probability, 0.0), 1.0)
    cov = float(np.sqrt(variance) / share) if share > 0 else float("inf")
    if variance > 0:
        # At 0 or 1 one standard error away stands for P_f in the binomial variance.
        typical = share if 0 < share < 1 else min(float(np.sqrt(variance)), 0.5)
        independent = min(typical * (1 - typical) / variance, independent)
    if np.isfinite(independent):
        interval = wilson_interval(share * independent, independent, level, freedom=freedom)
    else:
        interval = (share, share)
    if unseen is None:
        return Estimate(share, interval, cov, refined_runs, method, level, notes, audit_variance, freedom=freedom)
    low, high = interval
    wider = (low, min(share + float(np.hypot(high - share, unseen)), 1.0))
    return Estimate(share, wider, cov, refined_runs, method, level, notes, audit_variance, unseen, interval, freedom)


def after_more_runs(estimate: Estimate, more: int = 50, *, samples: float = np.inf) -> float:
    """Coefficient of variation to expect after `more` refined runs, or fewer where no more are left: what they would
    buy.

    samples: N that can run. The audit's variance falls as 1/n - 1/N over its n runs (the finite population's
    correction; Cochran 1977, Sampling Techniques, Section 2.6), to nothing where all have run; the sampling variance of
    the N samples stays. Raises ValueError for more below 0.
    """
    if more < 0:
        raise ValueError(f"more = {more} is negative: give the number of further runs")
    if not estimate.probability:
        return float("inf")
    audit, done = estimate.audit_variance / estimate.probability**2, estimate.refined_runs
    then = min(done + more, samples)
    left = (1 / then - 1 / samples) / (1 / done - 1 / samples) if 0 < done < samples else 0.0
    return float(np.sqrt(max(estimate.cov**2 - audit * (1 - left), 0.0)))


def wilson_interval(
    failures: float, samples: float, level: float = 0.95, *, freedom: float = np.inf
) -> tuple[float, float]:
    """Score interval of Wilson (1927), JASA 22, 209-212, for `failures` among `samples`.

    Both may be fractional, for effective sample sizes; `freedom` are the degrees of freedom of a Student's t in
    place of the normal quantile. ValueError unless 0 <= failures <= samples, samples > 0 and 0 < level < 1.
    """
    if not 0 <= failures <= samples or not samples > 0:
        raise ValueError(f"{failures} failures among {samples} samples: give 0 <= failures <= samples and samples > 0")
    if not 0 < level < 1:
        raise ValueError(f"level = {level} is not between 0 and 1: give for example 0.95")
    quantile = 0.5 + level / 2
    z = norm.ppf(quantile) if np.isinf(freedom) else student.ppf(quantile, max(freedom, 1.0))
    share, weight = failures / samples, z**2 / samples
    centre = (share + weight / 2) / (1 + weight)
    half = z / (1 + weight) * np.sqrt(share * (1 - share) / samples + weight / (4 * samples))
    # At the ends the limit is exactly 0 or 1; rounding must not put it beyond.
    low = 0.0 if failures == 0 else max(float(centre - half), 0.0)
    high = 1.0 if failures == samples else min(float(centre + half), 1.0)
    return low, high


def monte_carlo(failed: np.ndarray, *, level: float = 0.95, samples: float = np.inf) -> Estimate:
    """n/N of samples that all ran on the refined grid, with a Wilson interval. failed: (N,) bool. samples: that can run
    in all, these among them."""
    failed = np.asarray(failed, dtype=bool)
    failures, share = int(failed.sum()), float(failed.mean())
    return Estimate(
        probability=share,
        interval=wilson_interval(failures, failed.size, level),
        cov=_binomial_cov(failures, failed.size),
        refined_runs=failed.size,
        method="Monte Carlo",
        level=level,
        audit_variance=share * (1 - share) * (1 / failed.size - 1 / samples),
    )


def control_variate(
    rough_displacement: np.ndarray,
    refined: Mapping[int, bool],
    *,
    folds: int = 5,
    failure_displacement: float = 1.0,
    level: float = 0.95,
) -> Estimate:
    """Multifidelity control variate of Peherstorfer, Willcox and Gunzburger (2016), SIAM Journal on Scientific
    Computing 38, A3163-A3194, for a random subset of the samples run on both grids.

    The control is the failure probability given the rough rank, from a logistic fit to the other folds, so that
    no sample takes part in its own prediction. rough_displacement: (N,) (m). refined: sample -> failed, of at
    least 2 samples per fold drawn without regard to their rough result, for example the first n.
    failure_displacement: beyond which a sample has failed (m).
    """
    count = np.size(rough_displacement)
    if len(refined) < 2 * folds:
        raise ValueError(f"{len(refined)} refined runs in {folds} folds: give at least {2 * folds} runs")
    rank = np.empty(count, dtype=int)
    rank[rank_samples(rough_displacement).order] = np.arange(count)
    score = normal_scores(np.ones(count))[rank]
    centre = rough_centre(rough_displacement, np.ones(count), failure_displacement)
    runs = np.fromiter(sorted(refined), dtype=int)
    failed = np.array([refined[int(run)] for run in runs], dtype=float)
    residual, predicted = np.empty(runs.size), 0.0
    for fold in range(folds):
        mine = np.arange(runs.size) % folds == fold
        model = fit_logistic(score[runs[~mine]], failed[~mine], centre)
        residual[mine] = failed[mine] - predict_logistic(model, score[runs[mine]], centre)
        predicted += mine.mean() * predict_logistic(model, score, centre).mean()
    probability = predicted + float(residual.mean())
    share = min(max(probability, 0.0), 1.0)
    spread = float(residual.var(ddof=1)) * (1 / runs.size - 1 / count)
    return with_variance(
        "multifidelity control variate",
        probability,
        share * (1 - share) / count + spread,
        runs.size,
        freedom=runs.size - 1,
        audit_variance=spread,
        level=level,
    )


def published(
    rough_displacement: np.ndarray,
    refined: Mapping[int, bool | None],
    k_t: int,
    *,
    broke_off: np.ndarray | None = None,
    level: float = 0.95,
) -> Estimate:
    """n/N of Jiang et al. (2024), Computers and Geotechnics 172, 106413, with a Wilson interval.

    n failures are counted down to the stopping rank of k_t; all samples below it are taken to stand, which
    makes the estimate too low when the grids disagree. The interval holds the sampling of the N only.
    rough_displacement: (N,) m. refined: sample -> failed, None for a run without an answer.
    """
    order = rank_samples(rough_displacement, broke_off).order
    rank = stopping_rank(order, refined, k_t)
    ranked = [refined[int(sample)] for sample in order[:rank] if int(sample) in refined]
    failures, unanswered = ranked.count(True), ranked.count(None)
    notes = []
    if rank is None or rank < order.size:
        notes.append("samples below the stopping rank are taken to stand: the estimate tends to be low")
    if rank is None:
        notes.append(f"the stopping rule (k_t = {k_t}) is not met yet")
    if unanswered:
        notes.append(f"{unanswered} refined runs gave no answer: up to {unanswered / order.size:.2g} more")
    share = failures / order.size
    return Estimate(
        probability=share,
        interval=wilson_interval(failures, order.size, level),
        cov=_binomial_cov(failures, order.size),
        refined_runs=len(ranked),
        method="published n/N",
        level=level,
        notes=tuple(notes),
    )


def _binomial_cov(failures: int, samples: int) -> float:
    return float(np.sqrt((1 - failures / samples) / failures)) if failures else float("inf")
