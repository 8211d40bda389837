"""An estimate of a probability of failure, what more runs would bring, and intervals of weighted samples."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

LEVEL = 0.95
"""Confidence level of an interval that is given none."""
FEWEST = 5
"""Effective number of samples from which on a mean has an interval: fewer show too little of their scatter."""
ALIKE = 1e-9
"""Differences of values, over their mean, that are rounding."""
LEAST_FREEDOM = 3.0
"""Least degrees of freedom of a variance of `FEWEST` or more samples. With 1 or 2 the upper limits of made-up campaigns
reached 15,000 and 46 times the truth; with 3 they reach 21 times, and hold it as often to within 1 %."""
RARE = 5
"""Failures, or runs that stand, below which their scatter shows too little of itself."""
MOST_LEVERAGE = 0.05
"""Least of one minus the share of a sample: the residual of one that weighs nearly all is not taken for more."""


@dataclass(frozen=True)
class Estimate:
    """A probability of failure.

    Args:
        probability: P_f.
        interval: confidence limits (low, high) at `level`.
        cov: coefficient of variation of the estimator, its standard error over P_f (inf at P_f = 0).
        refined_runs: runs on the refined grid that it used.
        method: name of the estimator.
        level: confidence level of the intervals.
        notes: what a reader must know, in words.
        audit_variance: the part of the estimator's variance that more refined runs of the same samples would reduce.
        hidden_limit: what samples that were not looked at may add to P_f, at `level`, which `interval` allows for above
            and `cov` does not.
        sampling_interval: limits without that allowance, None where there is none.
        freedom: degrees of freedom of `cov`.
    """

    probability: float
    interval: tuple[float, float]
    cov: float
    refined_runs: int
    method: str
    level: float = LEVEL
    notes: tuple[str, ...] = ()
    audit_variance: float = 0.0
    hidden_limit: float = 0.0
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
    level: float = LEVEL,
    notes: tuple[str, ...] = (),
    hidden_limit: float | None = None,
    independent: float = np.inf,
    failed: float = np.inf,
    stand: float = np.inf,
    skewed: bool = False,
) -> Estimate:
    """An estimate from P_f and its variance.

    The interval is that of `count_interval` for as many independent samples as would scatter as much, with Student's t
    for the degrees of freedom of the variance.

    Args:
        method: name of the estimator.
        probability: P_f.
        variance: of P_f.
        refined_runs: that the estimate uses.
        freedom: degrees of freedom of the variance.
        audit_variance: part of the variance that more refined runs would reduce.
        level: confidence level of the interval.
        notes: what a reader must know, in sentences.
        hidden_limit: upper limit of what was not seen, an independent part of P_f that the estimate takes for 0; it
            widens the interval upwards by squares, as `cooperative.estimate._audit` explains. None for no such part.
        independent: samples that there are: however little varies among them, none of 10 failing leaves P_f open to
            0.26.
        failed: runs seen to fail; fewer than `RARE` show no more than so many independent failures would.
        stand: runs seen to stand, likewise.
        skewed: whether the estimate is a product of several factors, whose logarithm is nearer to normal.
    """
    # Ten weights of 0.1 add up to 1 - 1e-16.
    proportion = 1.0 if probability > 1 - 1e-12 else max(probability, 0.0)
    cov = float(np.sqrt(variance) / proportion) if proportion > 0 else float("inf")
    among = independent
    if variance > 0:
        # At 0 or 1 one standard error away stands for P_f in the binomial variance.
        typical = proportion if 0 < proportion < 1 else min(float(np.sqrt(variance)), 0.5)
        independent = min(typical * (1 - typical) / variance, independent)
    interval, sampling = (proportion, proportion), None
    if np.isfinite(independent):
        interval = count_interval(
            proportion * independent, independent, level, freedom=freedom, failed=failed, stand=stand, among=among
        )
    if skewed and 0 < proportion < 1 and variance > 0:
        low, high = lognormal_limits(proportion, cov, freedom, level)
        # Of few failures the number bounds P_f, too.
        interval = (min(low, interval[0]) if failed < RARE else low, min(high, 1.0))
    if hidden_limit is not None:
        sampling, (low, high) = interval, interval
        interval = (low, min(proportion + float(np.hypot(high - proportion, hidden_limit)), 1.0))
    return Estimate(
        proportion,
        interval,
        cov,
        refined_runs,
        method,
        level,
        notes,
        audit_variance,
        hidden_limit or 0.0,
        sampling,
        freedom,
    )


def binomial(
    method: str,
    failures: float,
    samples: float,
    refined_runs: int,
    *,
    level: float = LEVEL,
    notes: tuple[str, ...] = (),
    audit_variance: float = 0.0,
) -> Estimate:
    """The share of failures among independent samples, with its `count_interval`; both may be fractional."""
    proportion = failures / samples
    cov = float(np.sqrt((1 - proportion) / failures)) if failures else float("inf")
    interval = count_interval(failures, samples, level)
    return Estimate(proportion, interval, cov, refined_runs, method, level, notes, audit_variance)


def after_more_runs(estimate: Estimate, more: int = 50, *, samples: float = np.inf) -> float:
    """Coefficient of variation to expect after more refined runs, or fewer where no more are left.

    Args:
        estimate: so far.
        more: number of further refined runs.
        samples: N that can run. The audit's variance falls as 1/n - 1/N over its n runs (the finite population's
            correction; Cochran 1977, Sampling Techniques, Section 2.6), to nothing where all have run; the sampling
            variance of the N samples stays.

    Raises:
        ValueError: `more` is below 0.
    """
    if more < 0:
        raise ValueError(f"more = {more} is negative: give the number of further runs")
    if not estimate.probability:
        return float("inf")
    audit, done = estimate.audit_variance / estimate.probability**2, estimate.refined_runs
    then = min(done + more, samples)
    remaining = (1 / then - 1 / samples) / (1 / done - 1 / samples) if 0 < done < samples else 0.0
    return float(np.sqrt(max(estimate.cov**2 - audit * (1 - remaining), 0.0)))


def wilson_interval(
    failures: float, samples: float, level: float = LEVEL, *, freedom: float = np.inf
) -> tuple[float, float]:
    """Score interval of Wilson (1927), JASA 22, 209-212, for `failures` among `samples`.

    Both may be fractional, for effective sample sizes; `freedom` are the degrees of freedom of a Student's t in place
    of the normal quantile.

    Args:
        failures: number of failures.
        samples: number of samples.
        level: confidence level of the interval.
        freedom: degrees of freedom of a Student's t in place of the normal quantile.

    Raises:
        ValueError: unless 0 <= failures <= samples, samples > 0 and 0 < level < 1.

    Example:
        >>> from cooperative.estimate import wilson_interval
        >>> low, high = wilson_interval(10, 100)
        >>> f"{low:.3f} to {high:.3f}"
        '0.055 to 0.174'
    """
    if not 0 <= failures <= samples or not samples > 0:
        raise ValueError(f"{failures} failures among {samples} samples: give 0 <= failures <= samples and samples > 0")
    if not 0 < level < 1:
        raise ValueError(f"level = {level} is not between 0 and 1: give for example 0.95")
    proportion, freedom = np.array(failures / samples), max(freedom, 1.0)
    low, high = wilson_limits(proportion, np.array(samples), np.array(freedom), level)
    return float(low), float(high)


def exact_limit(samples: float, level: float = LEVEL) -> float:
    """Upper limit of the probability of what none of so many independent samples does.

    The one-sided binomial one, about 3 / n: Clopper and Pearson (1934), Biometrika 26, 404-413.

    Args:
        samples: number of samples.
        level: confidence level of the limit.
    """
    return -float(np.expm1(np.log1p(-level) / samples))


def count_interval(
    failures: float,
    samples: float,
    level: float = LEVEL,
    *,
    freedom: float = np.inf,
    failed: float = np.inf,
    stand: float = np.inf,
    among: float = np.inf,
) -> tuple[float, float]:
    """Wilson's interval, with exact limits where few samples, or none, fail or stand.

    Where none fails, P_f is at most `exact_limit`, and where all fail, at least as far from 1. Where fewer than `RARE`
    fail, the lower limit is at most that of Clopper and Pearson (1934), since Wilson's leaves out a probability of 0.16
    there; so is the upper one where few stand. Both counts may be fractional.

    Args:
        failures: number of failures.
        samples: number of samples.
        level: confidence level of the interval.
        freedom: as in `wilson_interval`.
        failed: runs that were seen to fail, where failures and samples are effective numbers.
        stand: runs that were seen to stand.
        among: samples that these runs are of. So many failures among them bound P_f from below, however they were met.
    """
    low, high = wilson_interval(failures, samples, level, freedom=freedom)
    proportion, seen = failures / samples, (failed, stand)
    failed, stand = min(failed, failures), min(stand, samples - failures)
    if proportion == 0:
        return 0.0, exact_limit(samples, level)
    if proportion == 1:
        return 1 - exact_limit(samples, level), 1.0
    tail = 0.5 - level / 2
    if 0 < failed < RARE:
        low = min(low, float(scipy.special.betaincinv(failed, failed / proportion - failed + 1, tail)))
    if 0 < stand < RARE:
        high = max(high, float(scipy.special.betainccinv(stand / (1 - proportion) - stand + 1, stand, tail)))
    # The seen ones are failures for certain, whatever the estimate makes of their weights.
    if 0 < seen[0] < RARE and among < np.inf:
        low = min(max(low, float(scipy.special.betaincinv(seen[0], among - seen[0] + 1, tail))), proportion)
    if 0 < seen[1] < RARE and among < np.inf:
        high = max(min(high, float(scipy.special.betainccinv(among - seen[1] + 1, seen[1], tail))), proportion)
    return low, high


def wilson_limits(
    proportion: np.ndarray, samples: np.ndarray, freedom: np.ndarray, level: float
) -> tuple[np.ndarray, np.ndarray]:
    """Wilson's limits of many shares at once."""
    z = quantile(level, freedom)
    step = z**2 / samples
    centre = (proportion + step / 2) / (1 + step)
    half = z / (1 + step) * np.sqrt(proportion * (1 - proportion) / samples + step / (4 * samples))
    # At the ends the limit is exactly 0 or 1; rounding must not put it beyond.
    low = np.where(proportion == 0, 0.0, np.maximum(centre - half, 0.0))
    return low, np.where(proportion == 1, 1.0, np.minimum(centre + half, 1.0))


def lognormal_limits(mean: float, cov: float, freedom: float, level: float) -> tuple[float, float]:
    """Confidence limits of the mean of a lognormal estimate, of which most values lie below it.

    Args:
        mean: the estimate, above 0.
        cov: its coefficient of variation.
        freedom: degrees of freedom of `cov`.
        level: confidence level.
    """
    variance = float(np.log1p(cov**2))
    half = float(quantile(level, np.array(freedom))) * np.sqrt(variance)
    return mean * float(np.exp(variance / 2 - half)), mean * float(np.exp(min(variance / 2 + half, 700.0)))


def quantile(level: float, freedom: np.ndarray) -> np.ndarray:
    """Of Student's t, the normal one for infinite degrees of freedom."""
    endless = np.isinf(freedom)
    return np.where(
        endless,
        scipy.special.ndtri(0.5 + level / 2),
        scipy.special.stdtrit(np.where(endless, 1e9, freedom), 0.5 + level / 2),
    )


def effective_size(weight: np.ndarray) -> float:
    """How many equally weighted samples have as much information.

    Kish (1965), Survey Sampling, Section 11.7.

    Args:
        weight: (n,).
    """
    weight = np.asarray(weight, dtype=float)
    return float(weight.sum() ** 2 / (weight @ weight)) if weight.size else 0.0


def too_few(weight: np.ndarray) -> bool:
    """Whether samples with these weights (n,) are too few for the interval of a mean."""
    return effective_size(weight) < FEWEST * (1 - 1e-9)


@dataclass(frozen=True)
class Share:
    """A part of a whole.

    Args:
        count: samples in it.
        share: weighted.
        interval: confidence limits.
    """

    count: int
    share: float
    interval: tuple[float, float]


def shares(group: np.ndarray, weight: np.ndarray, names: tuple[str, ...], *, level: float = LEVEL) -> dict[str, Share]:
    """Share of each named group among samples (n,), n at least 1, with the Wilson interval of their effective size.

    Args:
        group: of each sample (n,).
        weight: of each sample (n,).
        names: of the groups.
        level: confidence level of the interval.
    """
    size, total = effective_size(weight), float(np.sum(weight))
    parts = {}
    for name in names:
        members = np.asarray(group) == name
        share = min(float(np.sum(weight[members])) / total, 1.0)
        parts[name] = Share(int(members.sum()), share, wilson_interval(share * size, size, level))
    return parts
