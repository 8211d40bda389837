"""Empirical variograms and the correlation function that fits one.

Sources: Matheron (1963), Economic Geology 58, 1246-1266, doi:10.2113/gsecongeo.58.8.1246 (estimator); Cressie and
Hawkins (1980), Mathematical Geology 12, 115-125, doi:10.1007/BF01035243 (robust one); Cressie (1985), Mathematical
Geology 17, 563-586, doi:10.1007/BF01032109 (weights of the fit).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jax.typing import ArrayLike

from kl._checks import require
from kl._values import by_value
from kl.axis import Covariance
from kl.types import HostArray

FEWEST = 3
"""Classes of lags from which a variogram is fitted."""


@by_value
@dataclass(frozen=True)
class Variogram:
    """Half the mean squared difference of values at a lag.

    Args:
        lag: mean distance of the pairs of each class (n,) m.
        value: semivariance (n,).
        pairs: number of pairs (n,).
    """

    lag: HostArray
    value: HostArray
    pairs: HostArray


@by_value
@dataclass(frozen=True)
class VariogramFit:
    """gamma(h) = nugget + sill (1 - c(h)).

    Args:
        covariance: c, with the length that fits.
        sill: variance of the field.
        nugget: variance that is independent from point to point.
    """

    covariance: Covariance
    sill: float
    nugget: float

    def __call__(self, lag: ArrayLike) -> HostArray:
        """Semivariance at lags (n,) m above 0."""
        return self.nugget + self.sill * (1 - np.asarray(self.covariance(np.asarray(lag, float))))


def variogram(
    points: ArrayLike,
    values: ArrayLike,
    edges: ArrayLike,
    *,
    direction: ArrayLike | None = None,
    angle: float = 22.5,
    estimator: Literal["matheron", "cressie"] = "matheron",
) -> Variogram:
    """The empirical variogram of values at points, without a trend.

    Args:
        points: (d, N) m.
        values: (N,).
        edges: of the classes of lags (n + 1,) m, rising.
        direction: (d,) along which pairs lie; None for all directions.
        angle: between a pair and the direction, at most (degrees).
        estimator: "cressie" is the robust one of Cressie and Hawkins, which bears single values far off.

    Returns:
        Classes that have pairs.

    Raises:
        ValueError: If shapes do not fit, a value is not finite, or no class has a pair.
    """
    at, observed, limits = (np.asarray(array, float) for array in (points, values, edges))
    require(
        at.ndim == 2 and observed.shape == at.shape[1:],
        f"points {at.shape} and values {observed.shape}: give (d, N), (N,)",
    )
    require(np.isfinite(at).all() and np.isfinite(observed).all(), "a point or a value is not finite: leave it out")
    require(
        limits.ndim == 1 and limits.size > 1 and (np.diff(limits) > 0).all() and limits[0] >= 0,
        f"edges = {limits}: give two or more from 0 on, rising",
    )
    require(estimator in ("matheron", "cressie"), f"estimator = {estimator!r}: give 'matheron' or 'cressie'")
    first, second = np.triu_indices(observed.size, 1)
    apart = at[:, second] - at[:, first]
    distance, difference = np.linalg.norm(apart, axis=0), np.abs(observed[second] - observed[first])
    chosen = (distance > limits[0]) & (distance <= limits[-1])
    if direction is not None:
        way = np.asarray(direction, float)
        require(
            way.shape == at.shape[:1] and way.any(), f"direction = {direction}: give {at.shape[0]} numbers, not all 0"
        )
        along = np.abs(way @ apart) / np.linalg.norm(way)
        chosen &= along >= distance * math.cos(math.radians(angle)) * (1 - 1e-12)
    require(chosen.any(), f"no pair is {limits[0]:g} to {limits[-1]:g} m apart: give wider edges, or a wider angle")
    number = np.searchsorted(limits, distance[chosen]) - 1
    pairs = np.bincount(number, minlength=limits.size - 1)
    there = pairs > 0

    def mean(of: HostArray) -> HostArray:
        return np.bincount(number, of, limits.size - 1)[there] / pairs[there]

    count = pairs[there].astype(float)
    if estimator == "matheron":
        half = mean(difference[chosen] ** 2) / 2
    else:
        half = mean(np.sqrt(difference[chosen])) ** 4 / (0.457 + 0.494 / count + 0.045 / count**2) / 2
    return Variogram(mean(distance[chosen]), half, count)


def fit_variogram(empirical: Variogram, family: Callable[[float], Covariance], *, nugget: bool = True) -> VariogramFit:
    """Length, sill and nugget of a family of correlation functions, by weighted least squares.

    A class weighs by its pairs over the square of its fitted semivariance. A variogram whose lags do not reach its
    sill leaves length and sill open. For intervals of both, and with a trend, take `kl.estimation.fit_field`.

    Args:
        empirical: from `variogram`, or a user's own.
        family: of a length, as `kl.Exponential`.
        nugget: whether there may be one.

    Returns:
        The fit.

    Raises:
        ValueError: If there are too few classes, or the values do not differ.
    """
    lag, value, pairs = empirical.lag, empirical.value, empirical.pairs
    require(lag.size >= FEWEST, f"{lag.size} classes of lags: give {FEWEST} or more")
    top = float(np.max(value))
    require(top > 0, "all values are equal, which have no variogram")

    def model(numbers: HostArray) -> VariogramFit:
        length, sill = np.exp(numbers[:2])
        return VariogramFit(family(float(length)), float(sill), float(np.exp(numbers[2])) if nugget else 0.0)

    def misfit(numbers: HostArray) -> HostArray:
        fitted = model(numbers)(lag)
        return np.sqrt(pairs / pairs.sum()) * (value / fitted - 1)

    bounds = np.log([lag[0] / 100, top / 1e3, top * 1e-9]), np.log([lag[-1] * 100, top * 1e3, top * 2])
    size = 3 if nugget else 2
    starts = (np.log([share * lag[-1], top, top / 20])[:size] for share in (0.03, 0.1, 0.3, 1.0))
    from scipy.optimize import least_squares  # takes a third of a second, which only fits need

    found = [least_squares(misfit, start, bounds=[bound[:size] for bound in bounds]) for start in starts]
    return model(min(found, key=lambda fit: fit.cost).x)
