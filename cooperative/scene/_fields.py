"""Random fields of the soil: what each parameter may be, how two go together, and numbers that betray another unit."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, NamedTuple, TypeVar

import jax.numpy as jnp
import numpy as np
from jax import Array

import kl
from jaxmpm.soil import soil_limits
from jaxmpm.support.check import Limit
from jaxmpm.support.text import shown
from kl.axis import Covariance
from kl.marginal import Marginal

D = TypeVar("D", float, np.ndarray)

TAIL = 4.0
"""Deviations from the middle of a field up to which its values must be within their limits: beyond lie 3 points in
100,000 on either side."""

CONTACT = {"interface_friction": "wall_friction", "interface_cohesion": "wall_cohesion"}
"""Parameters of an interface that may vary, by what `jaxmpm.with_soil` calls them."""

LIMITS = {**soil_limits(), **{name: soil_limits()[name.removeprefix("interface_")] for name in CONTACT}}
"""Limits of what may vary, by parameter of the soil or of an interface."""

Span = tuple[float, float]
"""Elevations (m) of the base and of the highest point of ground."""


@dataclass(frozen=True)
class RandomField:
    """A parameter of the soil that varies, in the parameter's unit, angles in degrees.

    Args:
        mean: of the parameter, at depth 0 where it has a trend.
        cov: coefficient of variation.
        length: correlation length along each axis (m); inf is constant along it.
        marginal: class of `kl`.
        correlation: class of `kl`.
        energy: share of the variance that the expansion holds.
        sampled_at: "particles", or "cells" for one value per cell of the background grid, that at its centre: the grid
            of the field is then the background grid, and all particles that start in a cell are alike.
        lower: bound of a marginal that has one.
        upper: bound of a marginal that has one.
        trend: what mean and deviation, in proportion, grow by per metre of depth.
        bedding: of inclined strata; lengths are then down the dip, along strike and across.
        nataf: whether the parameter, not the Gaussian field behind it, has the correlation along each axis.
        boreholes: measured values, each a position (m) and the value there.
        borehole_error: deviation of these, in standard deviations of the field.
        trend_from: where depth is 0: at the "surface" of the ground, which follows the face of a cut, at the top of the
            "layer", or at an elevation (m), above which soil has no trend.
        mean_error: standard error of the mean, by which each sample has its own; 0 for a mean that is known.
        cov_error: standard error of cov, likewise.
        factor_cov: coefficient of variation of one factor of mean 1 that multiplies the parameter everywhere, measured
            values included; 0 for none.
    """

    mean: float
    cov: float
    length: tuple[float, ...]
    marginal: type = kl.Lognormal
    correlation: type = kl.SquaredExponential
    energy: float = 0.999
    sampled_at: Literal["particles", "cells"] = "particles"
    lower: float | None = None
    upper: float | None = None
    trend: float | None = None
    bedding: kl.Bedding | None = None
    nataf: bool = False
    boreholes: tuple[tuple[float, ...], ...] | None = None
    borehole_error: float = 0.0
    trend_from: Literal["surface", "layer"] | float = "surface"
    mean_error: float = 0.0
    cov_error: float = 0.0
    factor_cov: float = 0.0

    @property
    def uncertain(self) -> bool:
        """Whether each sample has its own mean and coefficient of variation."""
        return self.mean_error > 0 or self.cov_error > 0

    def drawn(self, scores: Array | np.ndarray) -> Marginal:
        """The marginal of a sample, of lognormal mean and coefficient of variation.

        Args:
            scores: (2,) standard normal, of the mean and of the coefficient of variation.
        """
        pairs = ((self.mean, self.mean_error), (self.cov, self.cov_error))
        # Of no error the number stays what it is, to the last bit.
        mean, cov = (
            kl.Lognormal(value, error / value).transform(jnp.asarray(score)) if error > 0 else value
            for (value, error), score in zip(pairs, scores, strict=True)
        )
        return self.marginal(mean, cov)

    def factor(self, score: Array | np.ndarray | float) -> Array:
        """What a sample's parameter is multiplied by everywhere, lognormal of mean 1.

        Args:
            score: standard normal, of any shape.
        """
        return kl.Lognormal(1.0, self.factor_cov).transform(jnp.asarray(score))

    @property
    def distribution(self) -> Marginal:
        """The marginal, of the parameter at depth 0 where it has a trend."""
        bounds = {"lower": self.lower, "upper": self.upper}
        return self.marginal(self.mean, self.cov, **{end: at for end, at in bounds.items() if at is not None})

    @property
    def covariance(self) -> tuple[Covariance, ...]:
        """The correlation functions of the Gaussian field, one per axis."""
        plain = tuple(kl.Infinite() if length == math.inf else self.correlation(length) for length in self.length)
        if not self.nataf:
            return plain
        return tuple(
            axis if isinstance(axis, kl.Infinite) else kl.marginal.nataf_corrected(axis, self.distribution)
            for axis in plain
        )

    def deepest(self, span: Span) -> float:
        """Largest depth (m) of ground between two elevations, as the trend counts it."""
        base, top = span
        return (top if isinstance(self.trend_from, str) else self.trend_from) - base

    def grown(self, depth: D) -> D | float:
        """Mean at a depth (m) over that at depth 0."""
        return 1.0 if self.trend is None else 1.0 + self.trend / self.mean * depth

    def extremes(self, span: Span) -> tuple[float, float]:
        """Least and largest value within `TAIL` deviations, in ground between two elevations (m)."""
        at = np.asarray(self.distribution.transform(jnp.asarray([-TAIL, 0.0, TAIL])), float)
        ends = np.outer(at[[0, 2]], [1.0, self.grown(self.deepest(span))])
        if self.factor_cov > 0:
            ends = np.multiply.outer(ends, np.asarray(self.factor(np.array([-TAIL, TAIL])), float))
        return float(ends.min()), float(ends.max())

    def check(self, where: str, limit: Limit, span: Span) -> None:
        """Check that values stay within the limits of the parameter.

        Args:
            where: name of the parameter, for messages.
            limit: of the parameter.
            span: of the ground.

        Raises:
            ValueError: values beyond the limit, a trend that the ground does not have, boreholes of other axes, or a
                mean that is uncertain where it cannot be.
        """
        kl.marginal.check_marginal(self.distribution)
        self._check_errors(where)
        depth = self.deepest(span)
        if self.trend is None and self.trend_from != "surface":
            raise ValueError(f"{where} trend_from = {self.trend_from!r} without a trend: add trend, or leave it out")
        if self.trend_from != "surface" and depth <= 0:
            raise ValueError(
                f"{where} trend_from = {self.trend_from:g} m is not above the base of the ground at {span[0]:g} m: "
                "give an elevation within the ground or above it"
            )
        if self.grown(depth) <= 0:
            raise ValueError(
                f"{where} trend = {self.trend:g} per metre brings the mean of {self.mean:g} to "
                f"{self.mean * self.grown(depth):.3g} at a depth of {depth:g} m: give a smaller one"
            )
        for value in self.extremes(span):
            if not limit.holds(value):
                number = f"{value:.3g} {limit.unit}".rstrip()
                raise ValueError(
                    f"{where} has values of {number}, {TAIL:g} deviations from the middle: give {limit} by a smaller "
                    "cov, or marginal = 'truncated normal' with lower and upper"
                )
        for row in self.boreholes or ():
            if len(row) != len(self.length) + 1:
                raise ValueError(
                    f"{where} boreholes hold {list(row)}: give {len(self.length) + 1} numbers, the position and the "
                    "value"
                )
        points = Counter(row[:-1] for row in self.boreholes or ())
        at, most = points.most_common(1)[0] if points else ((), 0)
        if most > 1 and not self.borehole_error:
            raise ValueError(
                f"{where} boreholes hold {most} values at {list(at)} m and no error: give borehole_error, or one value "
                "there"
            )

    def _check_errors(self, where: str) -> None:
        """Raise ValueError for errors of mean and cov that are too large, or of a marginal that cannot have them."""
        if not self.uncertain:
            return
        if self.marginal not in (kl.Lognormal, kl.Normal) or self.nataf:
            raise ValueError(
                f"{where} has mean_error or cov_error, which need marginal = 'lognormal' or 'normal' without nataf: "
                "leave them out"
            )
        for name, error, value in (("mean", self.mean_error, self.mean), ("cov", self.cov_error, self.cov)):
            if error > 2 * value:
                raise ValueError(
                    f"{where} {name}_error = {error:g} exceeds twice the {name} of {value:g}: give the standard error "
                    "in the same unit, or measure more"
                )


class StrengthByStress(NamedTuple):
    """Undrained strength as a ratio of the effective vertical stress at rest, of `minimum` (Pa) at least."""

    ratio: float
    minimum: float


@dataclass(frozen=True)
class CrossCorrelation:
    """Parameters that vary together.

    Args:
        parameters: their names.
        matrix: their correlation, row by row.
        nataf: whether it is that of the parameters themselves, else that of the Gaussian fields behind them.
    """

    parameters: tuple[str, ...]
    matrix: tuple[tuple[float, ...], ...]
    nataf: bool = False

    def gaussian_root(self, random: Mapping[str, RandomField]) -> np.ndarray:
        """What independent Gaussian fields (P,) are multiplied by, to be correlated (P, P).

        Raises:
            ValueError: a matrix that is no correlation, or that the marginals cannot have.
        """
        try:
            if not self.nataf:
                return kl.soil.correlation_root(self.matrix)
            kl.soil.correlation_root(self.matrix)
            marginals = tuple(random[name].distribution for name in self.parameters)
            return kl.soil.correlation_root(kl.soil.nataf_matrix(self.matrix, marginals))
        except ValueError as error:
            raise ValueError(f"cross_correlation: {error}") from error


def check_cross_correlation(correlation: CrossCorrelation, random: Mapping[str, RandomField]) -> None:
    """Raise ValueError for parameters that do not vary, or not alike, and for a matrix that is no correlation."""
    for name in correlation.parameters:
        if name not in random:
            raise ValueError(
                f"cross_correlation: parameters hold {shown(name)}, which is no parameter that varies: give some of "
                f"{', '.join(random)}"
            )
    if len(set(correlation.parameters)) != len(correlation.parameters) or len(correlation.parameters) < 2:
        raise ValueError(f"cross_correlation: parameters = {list(correlation.parameters)}: give two or more, each once")
    if {len(row) for row in correlation.matrix} | {len(correlation.matrix)} != {len(correlation.parameters)}:
        raise ValueError(
            f"cross_correlation: matrix has {len(correlation.matrix)} rows of {len(correlation.matrix[0])} numbers for "
            f"{len(correlation.parameters)} parameters: give a row and a column for each"
        )
    first, *others = (random[name] for name in correlation.parameters)
    for name, other in zip(correlation.parameters[1:], others, strict=True):
        if _shape(other) != _shape(first):
            raise ValueError(
                f"cross_correlation: {name} has not the length, correlation, bedding, energy and nataf of "
                f"{correlation.parameters[0]}: fields that correlate need the same"
            )
    correlation.gaussian_root(random)


def _shape(field: RandomField) -> tuple[object, ...]:
    """What fields that correlate have in common: their expansion."""
    shared = (field.correlation, field.length, field.bedding, field.energy, field.nataf)
    bounds = (None if end is None else end / field.mean for end in (field.lower, field.upper))
    return (*shared, field.marginal, field.cov, *bounds) if field.nataf else shared
