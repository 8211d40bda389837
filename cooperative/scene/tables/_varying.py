"""The table of a parameter that varies: its distribution, its correlation, what was measured of it."""

from __future__ import annotations

from dataclasses import fields
from typing import Annotated, Literal, Self

from pydantic import model_validator as validates

import kl
from cooperative.scene.tables._key import (
    AboveZero,
    Data,
    Degrees,
    FromZero,
    Metres,
    Number,
    PerAxis,
    Table,
    Within,
    key,
    one_of,
)
from jaxmpm.support.check import Limit, above_zero
from kl.axis import Scaled

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
        ValueError: the end of a message.
    """
    known = {each.name for each in fields(marginal)}
    for end, value in (("lower", lower), ("upper", upper)):
        if value is not None and end not in known:
            raise ValueError(
                f" {end} = {value:g}: {marginal.__name__} has no such bound, leave it out, or give marginal = "
                "'truncated normal' or 'beta'"
            )
    if marginal is kl.Beta and None in (lower, upper):
        raise ValueError(" lacks lower or upper, between which a beta distribution lies: add both")


class Bedding(Table):
    """Inclined strata."""

    dip: Annotated[float, Within(Limit(least=0, most=90, unit="degrees"))] = key("Dip below the horizontal.", 15.0)
    strike: Degrees | None = key(
        "Strike, anticlockwise from x seen from above.", 90.0, None,
        otherwise="90 or, in a section that falls to the left, 270: strata dip towards the toe",
    )  # fmt: skip


class Varying(Table):
    """The random field of undrained shear strength, in short for `[soil.strength]`.

    Every parameter that varies has these keys, in its own unit. Values within 4 standard deviations must be physically
    possible.
    """

    mean: AboveZero = key(
        "Mean; with a trend, the mean at depth 0, see `trend_from`.", 42e3, units="Pa",
        synonyms="su s_u cu undrained_strength shear_strength average",
    )  # fmt: skip
    cov: FromZero = key("Coefficient of variation.", 0.3, synonyms="sd std sigma deviation coefficient_of_variation")
    marginal: Annotated[type, one_of(MARGINALS)] = key(
        "Distribution of the parameter at a point.", "lognormal", "lognormal"
    )
    correlation: Annotated[type, one_of(CORRELATIONS)] = key(
        "Family of correlation functions, see [random fields](random-fields.md).", "exponential", "squared exponential"
    )
    length: PerAxis[Annotated[float, Within(above_zero("m"), infinite=True)]] = key(
        "Correlation length along each axis, as defined by the family; inf: constant along the axis.", [60.0, 2.0],
        synonyms="lx ly lz theta scale_of_fluctuation correlation_length correlation_lengths",
    )  # fmt: skip
    energy: Annotated[float, Within(Limit(above=0, most=1))] = key(
        "Share of the field's variance that its terms hold.", 0.999, 0.999
    )
    sampled_at: Literal["particles", "cells"] = key(
        "Where the field is evaluated: at particles, or once for each cell.", "particles", "particles"
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
    bedding: Bedding | None = key(
        "Inclined strata: `dip` below the horizontal and `strike`, anticlockwise from x seen from above, both in "
        "degrees. With a strike of 90 they dip towards +x, with 270 towards -x. By default they dip to the side to "
        "which a slope or section falls, in a terrain towards +x. Lengths are then down the dip, along strike and "
        "across.",
        {"dip": 15.0, "strike": 90.0},
        None,
        otherwise="level strata",
    )
    nataf: bool = key(
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
