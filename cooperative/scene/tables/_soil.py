"""Tables of the soil: `[soil]`, what varies in it as `[strength]`, `[cross_correlation]`, and `[[layer]]`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Annotated, Any, Generic, Literal, Self, cast

from pydantic import Field, create_model
from pydantic import model_validator as validates
from pydantic.fields import FieldInfo

import kl
from cooperative.scene.tables._key import (
    AboveZero,
    Degrees,
    F,
    FromZero,
    Length,
    Line,
    Metres,
    Number,
    OrTable,
    PerAxis,
    Raster,
    Rows,
    Several,
    Table,
    Within,
    key,
    one_of,
)
from foundation.check import above_zero
from jaxmpm import Decay, DruckerPrager, Limit, Matching, MohrCoulomb, PlasticStrain, soil_limits
from jaxmpm import Soil as UndrainedSoil

CORRELATIONS = {
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
CRITERIA = {"mohr-coulomb": MohrCoulomb, "drucker-prager": DruckerPrager}
MATCHINGS = {matching.value: matching for matching in Matching}
DECAYS = {decay.name.lower(): decay for decay in Decay}
PLASTIC_STRAINS = {measure.value: measure for measure in PlasticStrain}


def _of(parameter: str) -> Within:
    return Within(soil_limits()[parameter])


class Bedding(Table):
    """Inclined strata."""

    dip: Annotated[float, Within(Limit(least=0, most=90, unit="degrees"))] = key("Dip below the horizontal.", 15.0)
    strike: Degrees = key("Strike, anticlockwise from x seen from above.", 90.0, 90.0)


class Varying(Table):
    """The random field of undrained shear strength, in short for `[soil.strength]`. Every parameter that varies has
    these keys, in its own unit. Values within 4 deviations have to be such as the soil may have."""

    mean: AboveZero = key(
        "Mean, at the ground where there is a trend.", 42e3, units="Pa",
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
        "Correlation length along each axis, as the family defines it; inf: constant along it.", [60.0, 2.0],
        synonyms="lx ly lz theta scale_of_fluctuation correlation_length correlation_lengths",
    )  # fmt: skip
    energy: Annotated[float, Within(Limit(above=0, most=1))] = key(
        "Share of the field's variance that its modes keep.", 0.999, 0.999
    )
    sampled_at: Literal["particles", "cells"] = key(
        "Where the field is taken: at particles, or one value for each cell.", "particles", "particles"
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
        otherwise="none: alike at every depth",
    )  # fmt: skip
    trend_from: Metres | Literal["surface", "layer"] = key(
        "Where the depth of the trend is counted from: the ground's surface, which follows the face of a cut, the top "
        "of each layer, or an elevation above the base, such as that of the ground before a cut; above it there is no "
        "trend.",
        "surface",
        "surface",
    )
    bedding: Bedding | None = key(
        "Inclined strata: `dip` below the horizontal and `strike`, anticlockwise from x seen from above, both in "
        "degrees. With strike 90, as by default, they dip towards the toe. Lengths are then down the dip, along "
        "strike and across.",
        {"dip": 15.0, "strike": 90.0},
        None,
        otherwise="level strata",
    )
    nataf: bool = key(
        "Whether the parameter itself has the correlation, not the Gaussian field behind it.", True, False
    )
    boreholes: Rows | None = key(
        "Measured values: the position and the value there. x of a simple slope is from its rear, z from its base.",
        [[10.0, 2.5, 45e3]],
        None,
        units="m, Pa",
        otherwise="none measured",
        allowed="rows of a coordinate per axis and the value",
    )
    borehole_error: FromZero = key("Deviation of the measured values, in deviations of the field.", 0.1, 0.0)

    @validates(mode="after")
    def _bounds(self) -> Self:
        """Bounds are of marginals that have some, and a beta distribution has both."""
        known = {each.name for each in fields(self.marginal)}
        for end in ("lower", "upper"):
            value = getattr(self, end)
            if value is not None and end not in known:
                raise ValueError(
                    f" {end} = {value:g}: {self.marginal.__name__} has no such bound, leave it out, or give marginal = "
                    "'truncated normal' or 'beta'"
                )
        if self.marginal is kl.Beta and (self.lower is None or self.upper is None):
            raise ValueError(" lacks lower or upper, between which a beta distribution lies: add both")
        return self


class _Soil(Table, Generic[F]):
    """Keys of the soil. F: the table of a parameter that varies."""

    unit_weight: OrTable[Annotated[float, _of("unit_weight")], F] = key(
        "Weight of the soil with the water in it.", 20e3, synonyms="gamma density rho weight"
    )
    saturated_unit_weight: Annotated[float, _of("saturated_unit_weight")] | None = key(
        "Weight of soil that lies below the water table at the start, where soil above it weighs unit_weight.",
        20e3,
        None,
        otherwise="that of soil above it",
        synonyms="gamma_sat saturated_weight wet_unit_weight",
    )
    young: OrTable[Annotated[float, _of("young")], F] = key(
        "Young's modulus.", 1e8, synonyms="e youngs_modulus young_modulus modulus stiffness"
    )
    poisson: OrTable[Annotated[float, _of("poisson")], F] = key(
        "Poisson's ratio.", 0.3, synonyms="nu poisson_ratio poissons_ratio"
    )
    strength: OrTable[Annotated[float, _of("strength")], F] | None = key(
        "Undrained shear strength; `[strength]` is short for a table of it.", 42e3, None
    )
    strength_ratio: OrTable[Annotated[float, _of("strength_ratio")], F] | None = key(
        "In place of the strength, what it is over the effective vertical stress at rest: the weight of the soil "
        "above, of its mean unit weight, less the pressure of the water, so it needs `[water]`.",
        0.25,
        None,
    )
    strength_minimum: Annotated[float, _of("strength_minimum")] | None = key(
        "Least strength, where it goes with the stress: that of the soil at the surface. It goes with "
        "`strength_ratio`.",
        5e3,
        None,
    )
    softening_modulus: OrTable[Annotated[float, _of("softening_modulus")], F] | None = key(
        "Loss of strength over plastic strain.", 85e3, None, otherwise="none: no softening",
        synonyms="softening=linear linear_softening",
    )  # fmt: skip
    residual_ratio: OrTable[Annotated[float, _of("residual_ratio")], F] = key(
        "Strength left at large strain, over the peak.", 0.5, 1.0, synonyms="residual residual_strength"
    )
    tension_cutoff: Annotated[float, _of("tension_cutoff")] | None = key(
        "Largest mean tension.", 0.0, None, otherwise="no limit"
    )
    gap_memory: bool = key(
        "Whether soil that the tension cutoff has opened closes its gap before it bears pressure; without it it "
        "resists at once, and grains are thrown out.",
        True,
        True,
    )
    plastic_strain: Annotated[PlasticStrain, one_of(PLASTIC_STRAINS)] = key(
        "Measure of plastic strain by which the soil softens.", "engineering", "engineering"
    )
    strain_95: OrTable[Annotated[float, _of("strain_95")], F] | None = key(
        "Plastic strain at which 95 % of an exponential loss is done, instead of softening_modulus.", 10.0, None,
        synonyms="softening=exponential exponential_softening",
    )  # fmt: skip
    softening_length: Annotated[float, _of("softening_length")] | Literal["cell"] | None = key(
        'Thickness of the band that softening refers to; `"cell"`: that of a cell, whichever it is.',
        2.4,
        None,
        otherwise="a fifth of the height of the slope, or of the ground's relief",
    )
    rate_coefficient: OrTable[Annotated[float, _of("rate_coefficient")], F] | None = key(
        "Rise of strength for each tenfold rate of strain.", 0.1, None, otherwise="none: no effect of rate"
    )
    reference_rate: Annotated[float, _of("reference_rate")] = key(
        "Rate of shear strain at which strength is as given.", 1e-5, UndrainedSoil.reference_rate
    )
    cohesion: OrTable[Annotated[float, _of("cohesion")], F] | None = key(
        "Cohesion, with friction in place of strength.", 5e3, None, synonyms="c"
    )
    friction: OrTable[Annotated[float, _of("friction")], F] | None = key(
        "Angle of friction.", 25.0, None, synonyms="phi friction_angle"
    )
    dilation: OrTable[Annotated[float, _of("dilation")], F] = key(
        "Angle of dilation, at most that of friction.", 0.0, 0.0, synonyms="psi dilatancy"
    )
    criterion: Annotated[type, one_of(CRITERIA)] = key("Law of soil with friction.", "mohr-coulomb", "mohr-coulomb")
    matching: Annotated[Matching, one_of(MATCHINGS)] = key(
        "Where the cone of Drucker-Prager meets Mohr-Coulomb's pyramid.", "plane strain", "plane strain"
    )
    residual_cohesion: OrTable[Annotated[float, _of("residual_cohesion")], F] = key(
        "Cohesion left at large strain.", 0.0, 0.0
    )
    residual_friction: OrTable[Annotated[float, _of("residual_friction")], F] = key(
        "Friction left at large strain.", 20.0, 0.0
    )
    softening_strain: OrTable[Annotated[float, _of("softening_strain")], F] | None = key(
        "Plastic shear strain over which cohesion and friction fall to the residual.", 0.2, None,
        otherwise="none: no softening",
    )  # fmt: skip
    decay: Annotated[Decay, one_of(DECAYS)] = key("How they fall.", "linear", "linear")
    unusual: bool = key(
        "Whether numbers of the soil, of gravity and of the water's height that betray another unit are meant as they "
        "are; without it they are refused.",
        False,
        False,
    )


class Soil(_Soil[Varying]):
    """The soil: undrained, with a strength that does not depend on pressure, or with cohesion and friction. A parameter
    that varies is a table in place of a number, such as `[soil.cohesion]`, with the keys of `[strength]`. A number that
    betrays another unit is refused, see `unusual`."""


class CrossCorrelation(Table):
    """Parameters that vary together; those that no such table names vary independently. They need the same `length`,
    `correlation`, `bedding`, `energy` and `nataf`."""

    parameters: Several[str] = key(
        "Names of the parameters.", ["cohesion", "friction"], allowed="names of two or more that vary, each once"
    )
    matrix: Rows = key(
        "Their correlation, a row for each.", [[1.0, -0.5], [-0.5, 1.0]],
        allowed="a list of lists, symmetric, 1 on the diagonal, positive definite",
    )  # fmt: skip
    nataf: bool = key("Whether it is that of the parameters, not that of the Gaussian fields behind them.", True, False)


OF_A_FIELD = ("length", "correlation", "energy", "bedding", "nataf", "boreholes", "borehole_error")
"""What a layer gives only of a field of its own, which stops at it: its length at least."""


def _optional(keys: Mapping[str, FieldInfo], otherwise: str) -> dict[str, Any]:
    """The same keys, none of them required. otherwise: what holds where one is not given."""
    return {
        name: (
            Annotated[field.annotation, "optional", *field.metadata] | None,
            Field(
                None,
                description=field.description,
                examples=field.examples,
                json_schema_extra=cast(dict[str, Any], field.json_schema_extra) | {"otherwise": otherwise},
            ),
        )
        for name, field in keys.items()
    }


_LAYER_KEYS = ("mean", "cov", "marginal", "lower", "upper", "trend", "trend_from", *OF_A_FIELD)
VaryingInLayer: Any = create_model(
    "VaryingInLayer",
    __base__=Table,
    __doc__="What a layer may give of a parameter that varies.",
    **_optional({name: Varying.model_fields[name] for name in _LAYER_KEYS}, "that of [soil]"),
)
_SoilOfLayer: Any = create_model(
    "_SoilOfLayer", __base__=Table, **_optional(_Soil[VaryingInLayer].model_fields, "that of [soil]")
)


class Layer(_SoilOfLayer):
    """Layers of the drawn ground, `[[layer]]` for each, from the top down; the last has no lower boundary. Each may
    have any key of `[soil]`, and of a parameter that varies a table, such as `[layer.strength]`, with its own `mean`,
    `cov`, `marginal`, `lower`, `upper` and `trend`; what it leaves out is that of `[soil]` and `[strength]`. Its random
    field goes through all layers, unless a layer gives a `length` of its own: then its field stops at it, independent
    of all others, with a `correlation`, `energy`, `bedding` and so on that may be its own too. Layers may be of
    different kinds, fill with cohesion and friction over clay with a strength over rock: one of the other kind than
    `[soil]` takes over from it what both kinds have. Where every layer gives all of its soil, no `[soil]` is needed."""

    name: str | None = key("What it is called.", "soft clay", None, otherwise="`layer` and its number")
    bottom: Line | None = key(
        "Its lower boundary; where that meets the one above, the layer ends.", [[0, 2], [92, -2]], None, units="m"
    )
    raster: Raster | None = key(
        "Instead, under a terrain, a file of the boundary's heights.", "rock.asc", None, units="m"
    )
    depth: Length | None = key("Instead, depth of the boundary below the surface.", 3.0, None)
    thickness: Length | None = key("Instead, thickness of the layer.", 2.0, None)
    rock: bool = key("Whether it is rock, which does not yield.", True, False)

    @validates(mode="after")
    def _one_boundary(self) -> Self:
        if self.bottom is not None and self.raster is not None:
            raise ValueError(" has both bottom and raster: give one of them")
        return self
