"""Fragility curves: the probability of failure against a level of load, fitted to campaigns of the same samples.

The curve is Phi(a + b x), of x the level (normal) or its logarithm (lognormal), by maximum likelihood: at each level as
many independent samples count as would scatter as much as the campaign's estimate, and P_f of them fail (Baker 2015,
Earthquake Spectra 31, 579-599, DOI 10.1193/021113EQS025M, for counts that are whole). Campaigns of the same samples
are not independent, and the likelihood takes them so; the curve stays what it is, and the intervals are those of the
estimating equations with the covariance of all levels (sandwich: White 1982, Econometrica 50, 1-25,
DOI 10.2307/1912526).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.stats import norm

from cooperative.estimate import LEVEL

POINTS = 41
"""Levels at which a curve is given."""
STEPS = 200
"""Newton steps at most."""
CLEAR = 2.0
"""Slope of a curve, in its standard errors, up to which P_f does not change clearly with the level."""


@dataclass(frozen=True)
class Curve:
    """A fitted fragility curve.

    Args:
        form: of its distribution.
        median: level at which half of the samples fail.
        median_interval: its confidence limits.
        deviation: standard deviation of the level at which a sample fails; lognormal: of its logarithm.
        deviation_interval: likewise.
        rises: whether P_f rises with the level.
        log_likelihood: of the curve.
        level: at which the curve is given (P,).
        probability: P_f there (P,).
        low: its confidence limits (P,).
        high: its confidence limits (P,).
    """

    form: Literal["normal", "lognormal"]
    median: float
    median_interval: tuple[float, float]
    deviation: float
    deviation_interval: tuple[float, float]
    rises: bool
    log_likelihood: float
    level: tuple[float, ...]
    probability: tuple[float, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]


def fit_fragility(
    levels: Sequence[float], probability: Sequence[float], covariance: np.ndarray, samples: int, *,
    level: float = LEVEL, even: bool = False,
) -> tuple[Curve, ...]:  # fmt: skip
    """Fragility curves of campaigns of the same samples, the likelier form first.

    Args:
        levels: of the load (J,), J at least 2.
        probability: of failure at each level (J,).
        covariance: of these (J, J).
        samples: of each campaign.
        level: confidence level of the intervals.
        even: whether each campaign counts alike, as those of several records do, however sharp its estimate is.

    Returns:
        Curves; none where fewer than two levels have a P_f between 0 and 1, or P_f does not change clearly. The
        lognormal form is fitted to the levels above 0, and comes second where others are left out.

    Example:
        >>> import numpy as np
        >>> from cooperative.tools.sweep_fragility import fit_fragility
        >>> chance = [0.05, 0.3, 0.8]
        >>> curve, *_ = fit_fragility([1.0, 2.0, 3.0], chance, np.diag([2e-4, 1e-3, 8e-4]), samples=200)
        >>> curve.rises, bool(2.0 < curve.median < 3.0)
        (True, True)
    """
    x, share = np.asarray(levels, float), np.asarray(probability, float)
    if np.sum((share > 0) & (share < 1)) < 2:
        return ()
    inner = np.clip(share, 0.5 / samples, 1 - 0.5 / samples)
    count = np.minimum(inner * (1 - inner) / np.diag(covariance), samples)
    count = np.full(count.shape, count.mean()) if even else count
    above = np.flatnonzero(x > 0)
    fits = [_fitted("normal", x, share, count, covariance, level)]
    if x.min() >= 0 and np.sum((share[above] > 0) & (share[above] < 1)) >= 2:
        part = covariance[np.ix_(above, above)]
        fits.append(_fitted("lognormal", x[above], share[above], count[above], part, level))
    curves = [curve for curve in fits if curve is not None]
    return tuple(sorted(curves, key=lambda curve: -curve.log_likelihood) if above.size == x.size else curves)


def _fitted(
    form: Literal["normal", "lognormal"],
    x: np.ndarray,
    share: np.ndarray,
    count: np.ndarray,
    covariance: np.ndarray,
    level: float,
) -> Curve | None:
    """A curve of one form by Fisher scoring, None where its slope is not clear of 0."""
    at = np.log(x) if form == "lognormal" else x
    middle, scale = float(at.mean()), float(np.ptp(at)) or 1.0
    features = np.stack([np.ones_like(at), (at - middle) / scale])
    beta = np.array([norm.ppf(np.clip(float(count @ share / count.sum()), 0.01, 0.99)), 0.0])
    for _ in range(STEPS):
        fitted, gain = _parts(beta @ features)
        information = (features * (count * gain**2 * fitted * (1 - fitted))) @ features.T
        step = np.linalg.solve(information, features @ (count * gain * (share - fitted)))
        step *= min(1.0, 1.0 / max(float(np.abs(step).max()), 1e-300))
        beta = beta + step
        if np.abs(step).max() < 1e-10:
            break
    fitted, gain = _parts(beta @ features)
    influence = np.linalg.solve((features * (count * gain**2 * fitted * (1 - fitted))) @ features.T, features)
    influence = influence * (count * gain)
    spread = influence @ covariance @ influence.T
    z = float(norm.ppf(0.5 + level / 2))
    a, b = float(beta[0]), float(beta[1])
    if abs(b) <= CLEAR * float(np.sqrt(spread[1, 1])):
        return None
    points = np.linspace(x.min(), x.max(), POINTS)
    grid = np.stack([np.ones(POINTS), ((np.log(points) if form == "lognormal" else points) - middle) / scale])
    eta, half = beta @ grid, z * np.sqrt(np.einsum("ip,ij,jp->p", grid, spread, grid))
    slope = np.array([-1 / b, a / b**2])
    centre, error = -a / b, z * float(np.sqrt(slope @ spread @ slope))
    relative = z * float(np.sqrt(spread[1, 1])) / abs(b)
    deviation = scale / abs(b)

    def level_of(u: float) -> float:
        return float(np.exp(middle + scale * u)) if form == "lognormal" else middle + scale * u

    likely = count * (share * norm.logcdf(beta @ features) + (1 - share) * norm.logsf(beta @ features))
    return Curve(
        form,
        level_of(centre),
        (level_of(centre - error), level_of(centre + error)),
        deviation,
        (deviation * float(np.exp(-relative)), deviation * float(np.exp(relative))),
        b > 0,
        float(likely.sum()),
        *(tuple(map(float, values)) for values in (points, norm.cdf(eta), norm.cdf(eta - half), norm.cdf(eta + half))),
    )


def _parts(eta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Fitted probabilities, and the derivative of their log odds' argument: phi over Phi (1 - Phi)."""
    fitted = np.clip(norm.cdf(eta), 1e-12, 1 - 1e-12)
    return fitted, norm.pdf(eta) / (fitted * (1 - fitted))
