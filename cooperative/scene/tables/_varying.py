"""The table of a parameter that varies: its distribution, its correlation, what was measured of it."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Annotated, Any, Literal, Self, TypeVar

import jax.numpy as jnp
import numpy as np
from jax import Array
from pydantic import model_validator as validates

import kl
from cooperative.scene.tables._key import (
    AboveZero,
    Data,
    Degrees,
    Flag,
    FromZero,
    Metres,
    Number,
    Part,
    PerAxis,
    Rows,
    Several,
    Text,
    Within,
    key,
    keys,
    one_of,
    table,
)
from jaxmpm.soil import soil_limits
from jaxmpm.support.check import Invalid, Limit, above_zero, at
from jaxmpm.support.text import shown
from kl.axis import Covariance, Scaled
from kl.field import Waves
from kl.marginal import Marginal

D = TypeVar("D", float, np.ndarray)

TAIL = 4.0
"""Deviations from the middle of a field up to which its values must be within their limits: beyond lie 3 points in
100,000 on either side."""

CONTACT = {"interface_friction": "wall_friction", "interface_cohesion": "wall_cohesion"}
"""Parameters of an interface that may vary, by what `jaxmpm.with_soil` calls them."""

CONDUCTIVITY = "conductivity"
"""Of saturated soil, which varies where water moves; `cross_correlation` calls it so."""

LIMITS = {
    **soil_limits(),
    **{name: soil_limits()[name.removeprefix("interface_")] for name in CONTACT},
    CONDUCTIVITY: above_zero("m/s"),
}
"""Limits of what may vary, by parameter of the soil, of an interface or of the flow of water."""

Span = tuple[float, float]
"""Elevations (m) of the base and of the highest point of ground."""

CORRELATIONS: dict[str, type[Scaled]] = {
    "squared exponential": kl.SquaredExponential,
    "exponential": kl.Exponential,
    "matern 3/2": kl.Matern32,
    "matern 5/2": kl.Matern52,
    "second-order markov": kl.SecondOrderMarkov,
    "cosine exponential": kl.CosineExponential,
    "triangular": kl.Triangular,
}
MARGINALS = {
    "lognormal": kl.Lognormal,
    "truncated normal": kl.TruncatedNormal,
    "normal": kl.Normal,
    "uniform": kl.Uniform,
    "beta": kl.Beta,
    "gamma": kl.Gamma,
    "weibull": kl.Weibull,
    "gumbel": kl.Gumbel,
}


def check_bounds(marginal: type, lower: float | None, upper: float | None) -> None:
    """Refuse bounds of a family that has none, and a beta distribution without both.

    Args:
        marginal: class of `kl`.
        lower: bound.
        upper: bound.

    Raises:
        Invalid: a bound too many, or one too few.
    """
    names = {part.name for part in fields(marginal)}
    for end, value in (("lower", lower), ("upper", upper)):
        if value is not None and end not in names:
            raise Invalid(
                (end,), f"{value:g}", "",
                f"{marginal.__name__} has no such bound, leave it out, or give marginal = 'truncated normal' or 'beta'",
            )  # fmt: skip
    if marginal is kl.Beta and None in (lower, upper):
        raise Invalid((), None, "lacks lower or upper, between which a beta distribution lies", "add both")


@table
class InclinedStrata(Part):
    """Inclined strata."""

    dip: Annotated[float, Within(Limit(least=0, most=90, unit="degrees"))] = key("Dip below the horizontal.", 15.0)
    strike: Degrees | None = key(
        "Strike, anticlockwise from x seen from above.", 90.0, None,
        otherwise="90 or, in a section that falls to the left, 270: strata dip towards the toe",
    )  # fmt: skip


@table
class RandomField(Part):
    """The random field of undrained shear strength, in short for `[soil.strength]`.

    Every parameter that varies has these keys, in its own unit. Values of the field within 4 standard deviations of its
    middle must be physically possible.
    """

    mean: AboveZero = key(
        "Mean; with a trend, the mean at depth 0, see `trend_from`.", 42e3, units="Pa",
        synonyms="su s_u cu undrained_strength shear_strength average",
    )  # fmt: skip
    cov: FromZero = key(
        "Coefficient of variation.",
        0.3,
        synonyms="sd std sigma deviation coefficient_of_variation var=the_root_of_it_over_the_mean",
    )
    length: PerAxis[Annotated[float, Within(above_zero("m"), infinite=True)]] = key(
        "Correlation length along each axis, as defined by the family; inf: constant along the axis.", [60.0, 2.0],
        synonyms="lx ly lz theta scale_of_fluctuation correlation_length correlation_lengths "
        "len_scale=1.13_times_it_of_a_Gaussian_model,_it_of_an_Exponential_one,_1.41_times_it_of_a_Matern_one "
        "integral_scale=the_same_of_an_Exponential_model anis=the_first_length_times_each_ratio",
    )  # fmt: skip
    marginal: Annotated[type, one_of(MARGINALS, type)] = key(
        "Distribution of the parameter at a point.", "lognormal", "lognormal"
    )
    correlation: Annotated[type, one_of(CORRELATIONS, type)] = key(
        "Family of correlation functions, see [random fields](random-fields.md).", "exponential", "squared exponential",
        synonyms="model cov_model covmodel variogram nu='matern_3/2'_of_1.5,_'matern_5/2'_of_2.5,_'exponential'_of_0.5",
        named="gaussian='squared_exponential' matern='matern_3/2'",
    )  # fmt: skip
    energy: Annotated[float, Within(Limit(above=0, most=1))] = key(
        "Share of the variance of a product that its terms hold.", 0.999, 0.999
    )
    form: Literal["product", "elliptic"] = key(
        "Correlation between the axes: the product of those along each axis, or that of the distance in units of the "
        "lengths, which is isotropic where these are equal; for the exponential, Matern and squared exponential "
        "families.",
        "elliptic",
        "product",
        synonyms="isotropic anisotropy separable",
    )
    sampled_at: Literal["particles", "cells", "cell averages"] = key(
        "Where the field is evaluated: at particles, at the centre of each cell, or as its mean over each cell, which "
        "varies less (local averaging).",
        "cell averages",
        "particles",
        synonyms="local_averaging averaging upscaling coarse_graining",
    )
    lower: Number | None = key(
        "Lower bound of the distribution, where its family has one.", 10e3, None, units="Pa",
        otherwise="0; none, give it, of a beta distribution",
    )  # fmt: skip
    upper: Number | None = key(
        "Upper bound, likewise.", 90e3, None, units="Pa", otherwise="no bound; none, give it, of a beta distribution"
    )
    trend: Number | None = key(
        "Growth of the mean, and of the deviation with it, per metre of depth.", 1.2e3, None, units="Pa/m",
        otherwise="none: the same at every depth",
    )  # fmt: skip
    trend_from: Metres | Literal["surface", "layer"] = key(
        "Where the depth of the trend is 0: at the ground's surface, at the top of each layer, or at an elevation (m). "
        "The surface includes the face of a cut; for a cut give the elevation of the ground before. Above an "
        "elevation there is no trend.",
        "surface",
        "surface",
    )
    bedding: InclinedStrata | None = key(
        "Inclined strata: `dip` below the horizontal and `strike`, anticlockwise from x seen from above, both in "
        "degrees. With a strike of 90 they dip towards +x, with 270 towards -x. By default they dip to the side to "
        "which a slope or section falls, in a terrain towards +x. Lengths are then down the dip, along strike and "
        "across.",
        {"dip": 15.0, "strike": 90.0},
        None,
        otherwise="level strata",
        synonyms="angles=dip_is_minus_the_angle_in_degrees rotation",
    )
    nataf: Flag = key(
        "Whether the parameter itself has the correlation, not the Gaussian field behind it.", True, False
    )
    boreholes: Data | None = key(
        "Measured values: rows `[x, z, value]`, in 3D `[x, y, z, value]`, or the name of a CSV file beside the scene. "
        "Its columns are `x [m]`, `y [m]` in 3D, `z [m]` and the parameter with its unit, such as `strength [kPa]`. "
        "In a simple slope x is counted from its rear, z from its base.",
        [[10.0, 2.5, 45e3]],
        None,
        units="m, Pa",
        otherwise="none measured",
    )
    borehole_error: FromZero = key("Standard deviation of the measured values over that of the field.", 0.1, 0.0)
    mean_error: FromZero = key(
        "Standard error of the mean, of few soundings: each sample draws its own mean, lognormal, with the trend in "
        "proportion. Where values are measured the field still honours them.",
        4e3,
        0.0,
        units="Pa",
    )
    cov_error: FromZero = key("Standard error of `cov`, likewise.", 0.05, 0.0)
    factor_cov: Annotated[float, Within(Limit(least=0, most=1))] = key(
        "Coefficient of variation of one factor of mean 1 that multiplies the parameter everywhere, measured values "
        "included: that of the cone factor N_kt by which they were measured. Each sample draws it once, lognormal, for "
        "all fields that have it.",
        0.15,
        0.0,
    )

    @validates(mode="after")
    def _bounds(self) -> Self:
        check_bounds(self.marginal, self.lower, self.upper)
        return self

    @validates(mode="after")
    def _elliptic(self) -> Self:
        if self.form == "product":
            return self
        if not hasattr(self.correlation, "smoothness"):
            smooth = [name for name, family in CORRELATIONS.items() if hasattr(family, "smoothness")]
            rule = f"has no form of the distance for correlation = {self.correlation.__name__}"
            raise Invalid(("form",), repr(self.form), rule, f"give {', '.join(smooth)}, or leave it out")
        for name, idle in (("nataf", self.nataf), ("energy", self.energy != keys(RandomField)["energy"].default)):
            if idle:
                raise Invalid((name,), None, "is of a product, and form = 'elliptic'", "leave one of them out")
        return self

    @property
    def uncertain(self) -> bool:
        """Whether each sample has its own mean and coefficient of variation."""
        return self.mean_error > 0 or self.cov_error > 0

    def marginal_of(self, scores: Array | np.ndarray) -> Marginal:
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

    def expansion(self, corner: tuple[float, ...], extent: tuple[float, ...], **exact: Any) -> kl.Expansion | Waves:
        """Of the Gaussian field.

        Args:
            corner: lowest, of the box that holds the ground (d,) m.
            extent: edges of that box (d,) m.
            **exact: `modes` and `solver` of `kl.expand` in place of the energy.

        Raises:
            ValueError: a field that cannot be expanded.
        """
        if self.form == "elliptic":
            return kl.field.isotropic(self.correlation.smoothness, self.length, bedding=self.strata)  # type: ignore[attr-defined]
        return kl.expand(self.covariance, corner, extent, bedding=self.strata, **(exact or {"energy": self.energy}))

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

    def check(self, limit: Limit, span: Span) -> None:
        """Check that values stay within the limits of the parameter.

        Args:
            limit: of the parameter.
            span: of the ground.

        Raises:
            ValueError: values beyond the limit, a trend that the ground does not have, boreholes of other axes, or a
                mean that is uncertain where it cannot be.
        """
        kl.marginal.check_marginal(self.distribution)
        self._check_errors()
        depth = self.deepest(span)
        if self.trend is None and self.trend_from != "surface":
            raise Invalid(("trend_from",), repr(self.trend_from), "without a trend", "add trend, or leave it out")
        if self.trend_from != "surface" and depth <= 0:
            raise Invalid(
                ("trend_from",), f"{self.trend_from:g} m", f"is not above the base of the ground at {span[0]:g} m",
                "give an elevation within the ground or above it",
            )  # fmt: skip
        if self.grown(depth) <= 0:
            raise Invalid(
                ("trend",), f"{self.trend:g}",
                f"per metre brings the mean of {self.mean:g} to {self.mean * self.grown(depth):.3g} at a depth of "
                f"{depth:g} m",
                "give a smaller one", beside=("mean",),
            )  # fmt: skip
        for value in self.extremes(span):
            if not limit.holds(value):
                number = f"{value:.3g} {limit.unit}".rstrip()
                raise Invalid(
                    (), None, f"has values of {number}, {TAIL:g} deviations from the middle",
                    f"give {limit} by a smaller cov, or marginal = 'truncated normal' with lower and upper",
                )  # fmt: skip
        self._check_boreholes()

    def _check_boreholes(self) -> None:
        """Raise Invalid for rows of other axes, and for several values at one point that are to be met exactly."""
        axes = len(self.length)
        for row in self.boreholes or ():
            if len(row) != axes + 1:
                remedy = f"give {axes + 1} numbers, the position and the value"
                raise Invalid(("boreholes",), None, f"hold {list(row)}", remedy)
        points = Counter(row[:-1] for row in self.boreholes or ())
        at, most = points.most_common(1)[0] if points else ((), 0)
        if most > 1 and not self.borehole_error:
            raise Invalid(
                ("boreholes",), None, f"hold {most} values at {list(at)} m and no error",
                "give borehole_error, or one value there",
            )  # fmt: skip

    def _check_errors(self) -> None:
        """Raise Invalid for errors of mean and cov that are too large, or of a marginal that cannot have them."""
        if not self.uncertain:
            return
        if self.marginal not in (kl.Lognormal, kl.Normal) or self.nataf:
            raise Invalid(
                (), None,
                "has mean_error or cov_error, which need marginal = 'lognormal' or 'normal' without nataf",
                "leave them out",
            )  # fmt: skip
        for name, error, value in (("mean", self.mean_error, self.mean), ("cov", self.cov_error, self.cov)):
            if error > 2 * value:
                raise Invalid(
                    (f"{name}_error",), f"{error:g}", f"exceeds twice the {name} of {value:g}",
                    "give the standard error in the same unit, or measure more", beside=(name,),
                )  # fmt: skip

    @property
    def strata(self) -> kl.Bedding | None:
        """Inclined strata, which dip towards +x unless they have a strike; None for level ones."""
        if self.bedding is None:
            return None
        return kl.Bedding(self.bedding.dip, 90.0 if self.bedding.strike is None else self.bedding.strike)

    def dipping(self, downhill: int) -> RandomField:
        """The field in ground that falls along x (1) or against x (-1): strata dip so unless they have a strike."""
        if self.bedding is None or self.bedding.strike is not None:
            return self
        return replace(self, bedding=replace(self.bedding, strike={1: 90.0, -1: 270.0}[downhill]))


@table
class CrossCorrelation(Part):
    """Parameters that vary together; those that no such table names vary independently.

    They need the same `length`, `correlation`, `form`, `bedding`, `energy` and `nataf`. The matrix is
    that of the Gaussian fields; with `nataf`, that of the parameters themselves, for which a layer with a distribution
    of its own gives a `length` too. A layer gives a `length` to all of the parameters or to none.
    """

    parameters: Several[Text] = key(
        "Names of the parameters.", ["cohesion", "friction"], allowed="names of two or more that vary, each once"
    )
    matrix: Rows = key(
        "Their correlation, a row for each.", [[1.0, -0.5], [-0.5, 1.0]],
        allowed="a list of lists, symmetric, 1 on the diagonal, positive definite",
    )  # fmt: skip
    nataf: Flag = key("Whether it is that of the parameters, not that of the Gaussian fields behind them.", True, False)

    def gaussian_root(self, random: Mapping[str, RandomField]) -> np.ndarray:
        """What independent Gaussian fields (P,) are multiplied by, to be correlated (P, P).

        Raises:
            ValueError: a matrix that is no correlation, or that the marginals cannot have.
        """
        of_parameters = kl.soil.correlation_root(self.matrix)
        if not self.nataf:
            return of_parameters
        marginals = tuple(random[name].distribution for name in self.parameters)
        return kl.soil.correlation_root(kl.soil.nataf_matrix(self.matrix, marginals))


def check_cross_correlation(correlation: CrossCorrelation, random: Mapping[str, RandomField]) -> None:
    """Raise Invalid for parameters that do not vary, or not alike, and for a matrix that is no correlation."""
    names, rows = correlation.parameters, correlation.matrix
    with at("cross_correlation"):
        for name in names:
            if name not in random:
                remedy = f"give some of {', '.join(random)}"
                raise Invalid(("parameters",), None, f"hold {shown(name)}, which is no parameter that varies", remedy)
        if len(set(names)) != len(names) or len(names) < 2:
            raise Invalid(("parameters",), shown(list(names)), "", "give two or more, each once")
        if {len(row) for row in rows} | {len(rows)} != {len(names)}:
            rule = f"has {len(rows)} rows of {len(rows[0])} numbers for {len(names)} parameters"
            raise Invalid(("matrix",), None, rule, "give a row and a column for each")
        for name in names[1:]:
            if _shape(random[name]) != _shape(random[names[0]]):
                rule = f"has not the length, correlation, form, bedding, energy and nataf of {names[0]}"
                raise Invalid((name,), None, rule, "give fields that correlate the same")
        correlation.gaussian_root(random)


def _shape(field: RandomField) -> tuple[object, ...]:
    """What fields that correlate have in common: their expansion."""
    shared = (field.correlation, field.form, field.length, field.strata, field.energy, field.nataf)
    bounds = (None if end is None else end / field.mean for end in (field.lower, field.upper))
    return (*shared, field.marginal, field.cov, *bounds) if field.nataf else shared
