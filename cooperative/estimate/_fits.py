"""Which distribution a consequence follows: maximum likelihood fits compared by AIC and BIC.

The candidates are those of Jiang, Li, Ma and Rezania (2024), Computers and Geotechnics 172, 106413. AIC: Akaike
(1974), IEEE Transactions on Automatic Control 19, 716-723. BIC: Schwarz (1978), Annals of Statistics 6, 461-464.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cooperative.estimate._estimates import FEWEST, effective_size

if TYPE_CHECKING:
    from scipy.stats import rv_continuous
    from scipy.stats.distributions import rv_frozen

# Fewer samples than this tell six two-parameter distributions apart no better than chance would.
ENOUGH = 30
FITTED = 10
"""Samples from which on a distribution is fitted."""
FREE = 2
"""Free parameters of each candidate."""


@dataclass(frozen=True)
class Candidate:
    """A family of two parameters.

    Args:
        name: in scipy.stats.
        positive: for values above 0, where it is made to start.
    """

    name: str
    positive: bool = False

    @property
    def family(self) -> rv_continuous:
        """The family itself."""
        from scipy import stats  # takes half a second, which nothing needs that fits no slides

        family: rv_continuous = getattr(stats, self.name)
        return family


CANDIDATES = {
    "normal": Candidate("norm"),
    "logistic": Candidate("logistic"),
    "gamma": Candidate("gamma", positive=True),
    "Weibull": Candidate("weibull_min", positive=True),
    "lognormal": Candidate("lognorm", positive=True),
    "Gumbel": Candidate("gumbel_r"),
}


@dataclass(frozen=True)
class Fit:
    """One fitted distribution.

    Args:
        name: of the family.
        parameters: scipy's, in its order.
        log_likelihood: at the maximum.
        aic: Akaike's criterion.
        bic: Schwarz's criterion.
    """

    name: str
    parameters: tuple[float, ...]
    log_likelihood: float
    aic: float
    bic: float

    @property
    def frozen(self) -> rv_frozen:
        """The distribution itself."""
        return CANDIDATES[self.name].family(*self.parameters)


@dataclass(frozen=True)
class Fits:
    """All fits to one set of samples, best AIC first.

    Args:
        fits: best AIC first.
        samples: how many they are.
        best_aic: names of the best fits, None without any.
        best_bic: names of the best fits, None without any.
        notes: what to beware of, in words.
    """

    fits: tuple[Fit, ...]
    samples: int
    best_aic: str | None
    best_bic: str | None
    notes: tuple[str, ...]


def fit_distributions(values: np.ndarray, weight: np.ndarray | None = None) -> Fits:
    """Fit all candidates to `values` (n,) by maximum likelihood.

    Every candidate has two free parameters; gamma, Weibull and lognormal start at 0 and are left out, with a note,
    where a value is not positive. Nothing is fitted to fewer than 10 values, or to values that are all alike; with
    fewer than 30 a note states that the choice means little, as it does when the runner-up is within 2 of the best AIC.

    Args:
        values: one finite number for each sample (n,).
        weight: what each value stands for (n,), above 0; the likelihood is then that of their effective number
            (pseudo-likelihood: Binder 1983, International Statistical Review 51, 279-292). None is all alike.

    Raises:
        ValueError: values that are not finite, or weights that do not fit them.
    """
    values = np.asarray(values, dtype=float)
    if values.ndim != 1 or not np.isfinite(values).all():
        raise ValueError(f"values of shape {values.shape}, some not finite: give one finite number per sample")
    frequency = np.ones(values.shape) if weight is None else np.asarray(weight, dtype=float)
    if frequency.shape != values.shape or not (frequency > 0).all():
        raise ValueError(
            f"weight of shape {frequency.shape}, smallest {frequency.min(initial=np.inf):g}: give one above 0 each"
        )
    size = effective_size(frequency)
    frequency = frequency * size / frequency.sum() if values.size else frequency
    distinct = np.unique(values).size
    if values.size < FITTED or distinct < 2:
        few = f"{values.size} samples, {distinct} of them distinct, are too few for a fit: it takes {FITTED}"
        return Fits((), values.size, None, None, (few,))
    from scipy.stats import FitError

    notes, least = [], values.min()
    if size < ENOUGH:
        worth = "" if np.ptp(frequency) == 0 else f", worth {size:.3g} of equal weight,"
        notes.append(f"{values.size} samples{worth} are too few to tell distributions apart: {ENOUGH} or more would do")
    left_out = [name for name, candidate in CANDIDATES.items() if candidate.positive and least <= 0]
    notes += [f"{name} is for positive values; the smallest is {least:.3g}" for name in left_out]
    fits = []
    for name, candidate in CANDIDATES.items():
        if name in left_out:
            continue
        try:
            fits.append(_fit(name, candidate, values, frequency))
        except (FitError, ValueError, ArithmeticError) as error:
            notes.append(f"{name} does not fit values from {least:.3g} to {values.max():.3g} ({error})")
    if not fits:
        return Fits((), values.size, None, None, tuple(notes))
    fits.sort(key=lambda fit: fit.aic)
    best = fits[0]
    if close := [fit.name for fit in fits[1:] if fit.aic - best.aic < 2]:
        notes.append(f"{best.name} is not clearly better than {', '.join(close)}: their AIC differ by less than 2")
    return Fits(tuple(fits), values.size, best.name, min(fits, key=lambda fit: fit.bic).name, tuple(notes))


@dataclass(frozen=True)
class Severity:
    """One group of failures, for example a mode.

    Args:
        group: its name.
        count: failures.
        middle: of the statistic.
        interval: its bootstrap limits, None for too few failures.
        rank: 1 for the most severe.
        rank_interval: ranks that the bootstrap gives at the same level.
    """

    group: str
    count: int
    middle: float
    interval: tuple[float, float] | None
    rank: int
    rank_interval: tuple[int, int]


def severity_ranking(
    groups: Mapping[str, np.ndarray],
    *,
    weights: Mapping[str, np.ndarray] | None = None,
    statistic: Callable[..., np.ndarray] = np.median,
    level: float = 0.9,
    resamples: int = 2000,
    seed: int = 0,
) -> list[Severity]:
    """Order groups of failures by a consequence, most severe first, with the uncertainty of the order.

    Args:
        groups: name -> values (n,) of one consequence.
        weights: name -> what each value stands for (n,); None is all alike.
        statistic: function of (values, axis=...). Percentile bootstrap of Efron (1979), Annals of Statistics 7, 1-26:
            groups are resampled independently, ranked each time. A group of fewer than `FEWEST` has
            no interval, and any rank.
        level: confidence level of the interval.
        resamples: of the bootstrap.
        seed: of the bootstrap.

    Raises:
        ValueError: an empty group.
    """
    generator = np.random.default_rng(seed)
    resampled, middles = [], []
    for name, group in groups.items():
        values = np.asarray(group, dtype=float)
        if values.size == 0:
            raise ValueError(f"group {name!r} is empty: leave it out")
        normalised = None if weights is None else np.asarray(weights[name]) / np.sum(weights[name])
        resampled.append(statistic(generator.choice(values, (resamples, values.size), p=normalised), axis=1))
        # A weighted statistic is that of a resample large enough not to scatter.
        whole = values if normalised is None else generator.choice(values, 100_000, p=normalised)
        middles.append(float(statistic(whole, axis=0)))
    draws, names, tails = np.stack(resampled), list(groups), (0.5 - level / 2, 0.5 + level / 2)
    ranks = 1 + np.argsort(np.argsort(-draws, axis=0, kind="stable"), axis=0)
    ranking = []
    for rank, at in enumerate(np.argsort(-np.array(middles), kind="stable"), start=1):
        name, count = names[at], int(np.size(groups[names[at]]))
        (low, high), span = np.quantile(draws[at], tails).tolist(), np.quantile(ranks[at], tails, method="nearest")
        if count < FEWEST:
            ranking.append(Severity(name, count, middles[at], None, rank, (1, len(names))))
        else:
            ranking.append(Severity(name, count, middles[at], (low, high), rank, (int(span[0]), int(span[1]))))
    return ranking


@np.errstate(over="ignore", invalid="ignore")  # parameters that the optimiser tries and leaves
def _fit(name: str, candidate: Candidate, values: np.ndarray, weight: np.ndarray) -> Fit:
    # scipy's optimisers stop on absolute tolerances, so the values are brought to the order of 1 first.
    scale = float(np.abs(values).mean())
    parameters = candidate.family.fit(values / scale, **({"floc": 0.0} if candidate.positive else {}))
    if np.ptp(weight) > 0:
        parameters = _weighted(candidate, values / scale, weight, parameters)
    parameters = (*parameters[:-2], parameters[-2] * scale, parameters[-1] * scale)
    log_likelihood = float(weight @ candidate.family.logpdf(values, *parameters))
    if not np.isfinite([*parameters, log_likelihood]).all():
        raise ValueError("its likelihood is not finite")
    aic = 2 * FREE - 2 * log_likelihood
    bic = FREE * float(np.log(weight.sum())) - 2 * log_likelihood
    return Fit(name, tuple(float(parameter) for parameter in parameters), log_likelihood, aic, bic)


def _weighted(
    candidate: Candidate, values: np.ndarray, weight: np.ndarray, start: tuple[float, ...]
) -> tuple[float, ...]:
    """Parameters of largest weighted likelihood, from those of the plain one. Shape and scale go by their logarithm."""

    def parameters(at: np.ndarray) -> tuple[float, ...]:
        scale = float(np.exp(at[1]))
        return (float(np.exp(at[0])), 0.0, scale) if candidate.positive else (float(at[0]), scale)

    def loss(at: np.ndarray) -> float:
        return -float(weight @ candidate.family.logpdf(values, *parameters(at))) / weight.sum()

    from scipy import optimize

    first = np.log(start[0]) if candidate.positive else start[0]
    best = optimize.minimize(loss, np.array([first, np.log(start[-1])]), method="BFGS", options={"gtol": 1e-4})
    return parameters(best.x)
