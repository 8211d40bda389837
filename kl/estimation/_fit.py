"""Mean, trend, coefficient of variation and correlation lengths of a soil property, from values at points.

The model is that of a scene: v = (mean + trend depth) X, with X of mean 1, a constant coefficient of variation and the
given marginal, whose Gaussian field has the given family of correlation functions along each axis. The horizontal axes
share one length. A nugget, a share of the variance that is independent from point to point, takes up what the
instrument and scales below the spacing of the data add.

The trend is made linear in its coefficients around a first estimate; lengths and nugget lie on a grid
(`kl.estimation._likelihood`); intervals are quantiles of draws. The horizontal length has a likelihood of its own, with
a mean for each elevation: what all soundings share is no correlation along the ground.

Sources: DeGroot and Baecher (1993), doi:10.1061/(ASCE)0733-9410(1993)119:1(147), and Fenton (1999),
doi:10.1061/(ASCE)1090-0241(1999)125:6(470) (trend and correlation of soil data); Ching, Wu and Phoon (2016),
doi:10.1061/(ASCE)EM.1943-7889.0000969 (lengths that few data cannot give).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from kl._checks import finite, require
from kl._values import by_value
from kl.axis import Exponential, Scaled
from kl.estimation._likelihood import Cell, cells
from kl.estimation._model import SAME_POSITION, Model
from kl.marginal import Lognormal, Normal
from kl.types import HostArray

DRAWS = 4000
"""From which intervals are taken."""
FEWEST = 8
"""Values from which anything is estimated."""
_NUGGETS = np.array([0.0, 0.01, 0.04, 0.1, 0.2, 0.35, 0.55, 0.8])
_ROUGH = 14, 120
"""Lengths of the first grid along an axis, and values that it is laid over at most: it only finds where to look."""
_FINE = 10
"""Lengths of the second grid along an axis, over all values."""
_PROFILE = 5
"""Vertical lengths of the grid for the horizontal one."""
FEW = {
    1: "all values lie in one sounding, which has no horizontal distances",
    2: "two soundings cannot tell a profile that both share from correlation along the ground",
}
"""Why few soundings give no horizontal length, by their number."""
_SCATTER = 1e-3
"""Deviation over the mean below which values have none: no instrument reads a thousandth."""
_WIDEST = 30.0
"""Ratio of the ends of the interval of a length above which it is unknown."""


class Interval(NamedTuple):
    """An estimate with its 95 % interval.

    Args:
        value: median.
        low: 2.5 % quantile.
        high: 97.5 % quantile.
        error: standard error, that of a normal distribution with this interval: few draws far out do not count.
    """

    value: float
    low: float
    high: float
    error: float


@by_value
@dataclass(frozen=True)
class Draws:
    """Draws of all parameters together, each (K,).

    Args:
        mean: at depth 0.
        trend: of the mean, per metre of depth.
        cov: coefficient of variation of the field.
        nugget: share of the variance that the field does not hold.
        lengths: (L, K) horizontal, if there is one, and vertical (m).
        coefficients: (p, K) of the linear mean.
        scale: deviation of field and nugget, of the linear model.
    """

    mean: HostArray
    trend: HostArray
    cov: HostArray
    nugget: HostArray
    lengths: HostArray
    coefficients: HostArray
    scale: HostArray


@by_value
@dataclass(frozen=True)
class FieldFit:
    """What values at points show of a random field.

    Args:
        mean: at depth 0, in the property's unit.
        trend: of the mean, per metre of depth; None without depths.
        cov: coefficient of variation.
        vertical: correlation length (m).
        horizontal: correlation length (m), by that in which soundings differ at one elevation; None of fewer than three
            soundings.
        nugget: share of the variance that is independent from point to point.
        unknown: why a length is unknown, in words, by "horizontal" or "vertical"; its interval then only bounds it.
        draws: of all of these together.
        model: that was fitted.
    """

    mean: Interval
    trend: Interval | None
    cov: Interval
    vertical: Interval
    horizontal: Interval | None
    nugget: Interval
    unknown: dict[str, str]
    draws: Draws
    model: Model


def fit_field(
    points: HostArray,
    values: HostArray,
    *,
    depth: HostArray | None = None,
    marginal: type = Lognormal,
    correlation: type[Scaled] = Exponential,
    nugget: float | None = None,
    seed: int = 0,
) -> FieldFit:
    """Estimate mean, trend, coefficient of variation, correlation lengths and nugget with 95 % intervals.

    The time grows with the third power of the number of values: 100 take about a second, 400 about 20.

    Args:
        points: (d, n) m, the last axis vertical; values at the same x and y are of one sounding.
        values: (n,) in the property's unit, above 0 where lognormal.
        depth: (n,) m, from which the trend counts; None for a mean that is the same at every depth.
        marginal: `Lognormal` or `Normal`.
        correlation: class such as `Exponential`, the family along every axis.
        nugget: share of the variance if known, from 0 to below 1.
        seed: of the draws from which intervals are taken.

    Returns:
        FieldFit.

    Raises:
        ValueError: fewer than 8 values, values that are not finite, not above 0 or without scatter, or shapes that
            differ.
    """
    points, values = np.asarray(points, np.float64), np.asarray(values, np.float64)
    depth = None if depth is None else np.asarray(depth, np.float64)
    _check(points, values, depth, marginal)
    model = _anchored(Model(points, depth, values, marginal, correlation))
    _check_scatter(model)
    positions = _positions(points)
    grids = []
    if positions.shape[1] > 1:
        from scipy.spatial.distance import pdist  # loads what only several soundings need

        apart = pdist(positions.T)
        grids.append(np.geomspace(apart.min() / 6, 10 * apart.max(), _ROUGH[0]))
    grids.append(np.geomspace(_spacing(points, positions) / 2, 4 * np.ptp(points[-1]), _ROUGH[0]))
    edges = _NUGGETS if nugget is None else np.array([nugget])
    searched, random = grids, np.random.default_rng(seed)
    part = _thinned(model, np.arange(values.size)[:: -(-values.size // _ROUGH[1])])
    lengths_drawn = _lengths_drawn(_posterior(part, grids, edges), grids, random)[0]
    grids = [_narrowed(grid, row) for grid, row in zip(grids, lengths_drawn, strict=True)]
    draws = _parameter_draws(model, _posterior(model, grids, edges), grids, edges, random)
    lengths = [interval_of(row) for row in draws.lengths]
    names = ["horizontal", "vertical"][-len(lengths) :]
    reasons = [_reason(length, grid) for length, grid in zip(lengths, searched, strict=True)]
    horizontal = None
    if positions.shape[1] > 2:
        horizontal, reasons[0] = _along(model, [searched[0], grids[1]], edges, random)
    unknown = {name: reason for name, reason in zip(names, reasons, strict=True) if reason is not None}
    if positions.shape[1] < 3:
        unknown["horizontal"] = FEW[positions.shape[1]]
    return FieldFit(
        mean=interval_of(draws.mean),
        trend=None if depth is None else interval_of(draws.trend),
        cov=interval_of(draws.cov),
        vertical=lengths[-1],
        horizontal=horizontal,
        nugget=interval_of(draws.nugget),
        unknown=unknown,
        draws=draws,
        model=model,
    )


def _posterior(model: Model, grids: list[HostArray], edges: HostArray, design: HostArray | None = None) -> list[Cell]:
    """The cells of a grid of lengths and nuggets; the mean is that of the model, or of another design (n, p)."""
    points = model.points
    upright: dict[float, HostArray] = {}
    along: dict[float | None, HostArray | float] = {}

    def of(lengths: Sequence[float]) -> HostArray:
        *horizontal, vertical = lengths
        other = horizontal[0] if horizontal else None
        if vertical not in upright:
            upright[vertical] = model.upright(points, points, vertical)
        if other not in along:
            along[other] = model.along(points, points, other)
        return upright[vertical] * along[other]

    design = model.design(model.depth, model.values.size) if design is None else design
    return cells(of, grids, edges, design, model.linear(model.values, model.depth))


def _thinned(model: Model, kept: npt.NDArray[np.int64]) -> Model:
    """The model of some of its values, by their numbers."""
    depth = None if model.depth is None else model.depth[kept]
    return replace(model, points=model.points[:, kept], depth=depth, values=model.values[kept])


def _along(
    model: Model, grids: list[HostArray], edges: HostArray, random: np.random.Generator
) -> tuple[Interval, str | None]:
    """The horizontal length, and why it is unknown, by that in which soundings differ at one elevation.

    A profile that all soundings share, which is no line over depth, would pass for correlation along the ground. The
    mean here has one value for each elevation, so that it is taken out whatever its shape.
    """
    low, high = float(grids[0][0]), float(grids[0][-1])
    nothing = Interval(math.sqrt(low * high), low, high, (high - low) / 3.92)
    z = model.points[-1]
    count = min(round(float(np.ptp(z) / _spacing(model.points, _positions(model.points)))) + 1, z.size // 3)
    level = np.minimum(((z.max() - z) / np.ptp(z) * count).astype(int), count - 1)
    shared = np.flatnonzero(np.bincount(level, minlength=count) > 1)
    every = -(-int(np.isin(level, shared).sum()) // _ROUGH[1])
    kept = np.flatnonzero(np.isin(level, shared[:: max(every, 1)]))
    design = (level[kept][:, None] == np.unique(level[kept])[None]).astype(float)
    if design.shape[0] - design.shape[1] < FEWEST:
        return nothing, "too few soundings have values at the same elevation"
    grids = [grids[0], np.geomspace(grids[1][0], grids[1][-1], _PROFILE)]
    posterior = _posterior(_thinned(model, kept), grids, edges, design)
    length = interval_of(_lengths_drawn(posterior, grids, random)[0][0])
    return length, _reason(length, grids[0])


def _lengths_drawn(
    posterior: list[Cell], grids: list[HostArray], random: np.random.Generator
) -> tuple[HostArray, list[Cell]]:
    """Draws (L, K) of the lengths, and the cells from which they are."""
    weights = np.array([cell.weight for cell in posterior])
    weights = np.exp(weights - weights.max())
    chosen = [posterior[k] for k in random.choice(len(posterior), 2 * DRAWS, p=weights / weights.sum())]
    within = random.uniform(-0.5, 0.5, (len(grids), len(chosen)))
    ratios = np.array([np.log(grid[1] / grid[0]) for grid in grids])
    return np.array([cell.lengths for cell in chosen]).T * np.exp(ratios[:, None] * within), chosen


def _check(points: HostArray, values: HostArray, depth: HostArray | None, marginal: type) -> None:
    count = values.size
    require(marginal in (Lognormal, Normal), f"marginal {marginal.__name__}: give Lognormal or Normal")
    require(
        values.ndim == 1
        and points.ndim == 2
        and points.shape[1] == count
        and (depth is None or depth.shape == (count,)),
        f"values of shape {values.shape} at points of {points.shape}: give (n,) and (d, n), and one depth for each",
    )
    require(count >= FEWEST, f"{count} values: give at least {FEWEST}, fewer show nothing of how soil varies")
    for name, array in (("values", values), ("points", points), ("depth", 0.0 if depth is None else depth)):
        finite(name, array, remedy="leave gaps out")
    if marginal is Lognormal:
        require(values > 0, f"a value of {values.min():g}: a lognormal property is above 0, leave it out or use Normal")
    require(
        np.ptp(values) > 1e-9 * np.abs(values).max(), f"all values are {values[0]:g}: a constant is no random field"
    )
    require(np.ptp(points[-1]) > 0, "all values lie at one elevation: the vertical length needs several")
    require(
        depth is None or np.ptp(depth) > 0, "all values lie at one depth, which shows no trend: leave the depths out"
    )


def _anchored(model: Model) -> Model:
    """The model with its first trend, by least squares of the values or, where lognormal, of their logarithms.

    Each step makes the logarithm of the trend linear around the last. Raises ValueError for values without scatter.
    """
    if model.depth is None:
        return model
    low, high = min(0.0, float(model.depth.min())), float(model.depth.max())
    model = replace(model, middle=float(model.depth.mean()))
    # Where the mean comes to a tenth of that at the middle, at either end.
    limits = -0.9 / (high - model.middle), 0.9 / (model.middle - low)
    for _ in range(20):
        design = model.design(model.depth, model.values.size)
        first, second = np.linalg.lstsq(design, model.linear(model.values, model.depth), rcond=None)[0]
        change = second if model.marginal is Lognormal else second / first - model.slope
        model = replace(model, slope=float(np.clip(model.slope + change, *limits)))
    return model


def _check_scatter(model: Model) -> None:
    """Raise ValueError for values that lie on their trend."""
    design, data = model.design(model.depth, model.values.size), model.linear(model.values, model.depth)
    rest = data - design @ np.linalg.lstsq(design, data, rcond=None)[0]
    scatter = float(rest.std()) / (1.0 if model.marginal is Lognormal else abs(float(data.mean())) or 1.0)
    about = "it" if model.depth is None else "a line over depth"
    require(
        scatter > _SCATTER,
        f"the values scatter by {scatter:.1e} of their mean about {about}, the limit is {_SCATTER:g}: that shows "
        "neither variation nor lengths, were they measured?",
    )


def _positions(points: HostArray) -> HostArray:
    """Horizontal positions (d - 1, k) m of the soundings."""
    upright = points[:-1]
    if len(upright) == 0:
        return np.zeros((0, 1))
    apart: list[HostArray] = []
    for position in np.unique(upright, axis=1).T:
        if all(np.linalg.norm(position - other) > SAME_POSITION for other in apart):
            apart.append(position)
    return np.array(apart).T


def _spacing(points: HostArray, positions: HostArray) -> float:
    """Median distance (m) of neighbours (d, n) m in a sounding, of those at positions (d - 1, k) m."""
    steps = []
    for position in positions.T:
        z = np.unique(points[-1, np.linalg.norm(points[:-1] - position[:, None], axis=0) <= SAME_POSITION])
        steps.append(np.diff(z))
    apart = np.concatenate(steps)
    return float(np.median(apart)) if apart.size else float(np.diff(np.unique(points[-1])).min())


def _narrowed(grid: HostArray, draws: HostArray) -> HostArray:
    """The part of a grid of lengths (m) that has the draws (K,)."""
    low, high = np.quantile(draws, [0.0005, 0.9995])
    ratio = grid[1] / grid[0]
    return np.geomspace(max(low / ratio**0.5, grid[0]), min(high * ratio**0.5, grid[-1]), _FINE)


def _parameter_draws(
    model: Model, posterior: list[Cell], grids: list[HostArray], edges: HostArray, random: np.random.Generator
) -> Draws:
    """Draws of all parameters; those whose mean falls to 0 within the data or at depth 0 are left out."""
    lengths, chosen = _lengths_drawn(posterior, grids, random)
    columns = posterior[0].coefficients.size
    free = model.values.size - columns
    squares = np.array([cell.square for cell in chosen])
    scale = np.sqrt(squares / random.chisquare(free, squares.size))
    normal = random.standard_normal((columns, squares.size))
    roots = np.array([cell.root for cell in chosen])
    coefficients = np.array([cell.coefficients for cell in chosen]).T + scale * np.einsum("kij,jk->ik", roots, normal)
    nugget = np.array([cell.nugget for cell in chosen])
    if len(edges) > 1:
        nugget = nugget + np.diff(edges)[np.searchsorted(edges, nugget) - 1] * random.uniform(-0.5, 0.5, nugget.size)
    variance = (1 - nugget) * scale**2
    lognormal = model.marginal is Lognormal
    middle = np.exp(coefficients[0] + variance / 2) if lognormal else coefficients[0]
    trend = np.zeros_like(middle)
    if columns > 1:
        # In logarithms the second coefficient is what the first trend lacks, over the mean.
        trend = middle * (model.slope + coefficients[1]) if lognormal else coefficients[1]
    mean = middle - trend * model.middle
    ends = [mean] if model.depth is None else [mean, mean + trend * model.depth.min(), mean + trend * model.depth.max()]
    valid = np.flatnonzero(np.min(ends, axis=0) > 0 if lognormal else np.isfinite(mean))[:DRAWS]
    require(valid.size >= DRAWS / 20, "the trend is so uncertain that its mean falls to 0: leave the depths out")
    cov = np.sqrt(np.expm1(variance)) if lognormal else np.sqrt(variance) / np.abs(middle)
    return Draws(
        mean[valid], trend[valid], cov[valid], nugget[valid], lengths[:, valid], coefficients[:, valid], scale[valid]
    )


def interval_of(draws: HostArray) -> Interval:
    """The 95 % interval of draws.

    Args:
        draws: (K,) of a parameter.
    """
    low, value, high = np.quantile(draws, [0.025, 0.5, 0.975])
    return Interval(float(value), float(low), float(high), float(high - low) / 3.92)


def _reason(interval: Interval, searched: HostArray) -> str | None:
    """Why a length is unknown, None where it is known."""
    if interval.high / interval.low <= _WIDEST and interval.low > searched[1] and interval.high < searched[-2]:
        return None
    return (
        f"the data allow {interval.low:.2g} to {interval.high:.2g} m of the {searched[0]:.2g} to {searched[-1]:.2g} m "
        "that their distances let one look for: they lie too far apart, too near or are too few"
    )
