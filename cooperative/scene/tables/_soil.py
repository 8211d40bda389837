"""Tables of the soil: `[soil]`, what varies in it as `[strength]`, and `[[layer]]`."""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping
from dataclasses import fields
from typing import Annotated, Any, Literal, Self

from pydantic import model_validator as validates

from cooperative.scene.tables._key import (
    Flag,
    Length,
    Line,
    Metres,
    OrTable,
    Part,
    Raster,
    Within,
    key,
    keys,
    one_of,
    plain_name,
    table,
)
from cooperative.scene.tables._varying import RandomField
from cooperative.store import table_of
from jaxmpm import FrictionalSoil, PlasticStrain, Soil
from jaxmpm.laws import Decay, DruckerPrager, Matching, MohrCoulomb
from jaxmpm.soil import soil_limits
from jaxmpm.support.check import Invalid, at
from jaxmpm.support.text import shown

LONGEST_NAME = 200
CRITERIA = {"mohr-coulomb": MohrCoulomb, "drucker-prager": DruckerPrager}
MATCHINGS = {matching.value: matching for matching in Matching}
DECAYS = {decay.name.lower(): decay for decay in Decay}
PLASTIC_STRAINS = {measure.value: measure for measure in PlasticStrain}

STRENGTHS = ("strength", "strength_ratio", "strength_minimum")
OF_CLAY, OF_FRICTION = (
    tuple(part.name for part in fields(kind) if part.name not in {other.name for other in fields(beside)})
    for kind, beside in ((Soil, FrictionalSoil), (FrictionalSoil, Soil))
)
"""Keys of the soil that only undrained clay, or only soil with friction, has a use for."""
OF_ALL_LAYERS = ("boreholes", "borehole_error", "mean_error", "cov_error", "factor_cov")
"""Of a random field: measured values, and errors of estimates, which a layer does not take from another field."""
OF_A_FIELD = ("length", "correlation", "energy", "bedding", "nataf", *OF_ALL_LAYERS)
"""What a layer gives only of a field of its own, which stops at it: its length at least."""


def _of(parameter: str) -> Within:
    return Within(soil_limits()[parameter])


def _default(parameter: str) -> str:
    """The solver's default of what a scene leaves out, in words."""
    value: Any = getattr(Soil, parameter, getattr(FrictionalSoil, parameter, None))
    named = {
        choice: name for choices in (CRITERIA, MATCHINGS, DECAYS, PLASTIC_STRAINS) for name, choice in choices.items()
    }
    return f"`{json.dumps(value if isinstance(value, bool | float) else named[value])}`"


@table
class SoilTable(Part):
    """The soil: undrained, with a strength that does not depend on pressure, or with cohesion and friction.

    A parameter that varies is a table in place of a number, such as `[soil.cohesion]`, with the keys of `[strength]`.
    A number that looks like kPa or kN/m3 is refused, see `unusual`.
    """

    unit_weight: OrTable[Annotated[float, _of("unit_weight")], RandomField] = key(
        "Weight of the soil, including its water.", 20e3, synonyms="gamma density rho weight"
    )
    saturated_unit_weight: OrTable[Annotated[float, _of("saturated_unit_weight")], RandomField] | None = key(
        "Weight of soil that lies below the water table at the start; soil above it has `unit_weight`.",
        20e3,
        None,
        otherwise="that of soil above it",
        synonyms="gamma_sat saturated_weight wet_unit_weight",
    )
    young: OrTable[Annotated[float, _of("young")], RandomField] = key(
        "Young's modulus.", 1e8, synonyms="e youngs_modulus young_modulus modulus stiffness"
    )
    poisson: OrTable[Annotated[float, _of("poisson")], RandomField] = key(
        "Poisson's ratio.", 0.3, synonyms="nu poisson_ratio poissons_ratio"
    )
    strength: OrTable[Annotated[float, _of("strength")], RandomField] | None = key(
        "Undrained shear strength; `[strength]` is short for a table of it.", 42e3, None
    )
    strength_ratio: OrTable[Annotated[float, _of("strength_ratio")], RandomField] | None = key(
        "In place of the strength, s_u / sigma'_v: undrained strength over the effective vertical stress at rest. That "
        "stress is the weight of the soil above, with mean unit weights, less the water pressure. It needs `[water]`.",
        0.25,
        None,
    )
    strength_minimum: Annotated[float, _of("strength_minimum")] | None = key(
        "Smallest strength with `strength_ratio`, which would give 0 at the surface.",
        5e3,
        None,
    )
    softening_modulus: OrTable[Annotated[float, _of("softening_modulus")], RandomField] | None = key(
        "Loss of strength over plastic strain.", 85e3, None, otherwise="none: no softening",
        synonyms="softening=linear linear_softening",
    )  # fmt: skip
    residual_ratio: OrTable[Annotated[float, _of("residual_ratio")], RandomField] | None = key(
        "Strength left at large strain, over the peak.", 0.5, None, otherwise=_default("residual_ratio"),
        synonyms="residual residual_strength",
    )  # fmt: skip
    tension_cutoff: Annotated[float, _of("tension_cutoff")] | None = key(
        "Largest mean tension.", 0.0, None, otherwise="no limit"
    )
    gap_memory: Flag | None = key(
        "Whether soil that the tension cutoff has opened closes its gap before it bears pressure. With `false` it "
        "resists at once, and grains are thrown out.",
        True,
        None,
        otherwise=_default("gap_memory"),
    )
    plastic_strain: Annotated[PlasticStrain, one_of(PLASTIC_STRAINS)] | None = key(
        "Measure of plastic strain by which the soil softens.",
        "engineering",
        None,
        otherwise=_default("plastic_strain"),
    )
    strain_95: OrTable[Annotated[float, _of("strain_95")], RandomField] | None = key(
        "Plastic strain at which 95 % of an exponential loss is done, instead of softening_modulus.", 10.0, None,
        synonyms="softening=exponential exponential_softening",
    )  # fmt: skip
    softening_length: Annotated[float, _of("softening_length")] | Literal["cell"] | None = key(
        'Thickness of the shear band that softening refers to; `"cell"`: the size of a cell, on each grid.',
        2.4,
        None,
        otherwise="a fifth of the height of the slope, or of the ground's relief",
    )
    rate_coefficient: OrTable[Annotated[float, _of("rate_coefficient")], RandomField] | None = key(
        "Rise of strength for each tenfold rate of strain.", 0.1, None, otherwise="none: no effect of rate"
    )
    reference_rate: Annotated[float, _of("reference_rate")] | None = key(
        "Rate of shear strain at which the given strength holds.", 1e-5, None, otherwise=_default("reference_rate")
    )
    viscosity: OrTable[Annotated[float, _of("viscosity")], RandomField] | None = key(
        "Bingham's plastic viscosity. Clay that flows resists with its strength, plus this times the rate of "
        "engineering plastic shear strain.",
        0.2,
        None,
        otherwise="none: no viscosity",
    )
    cohesion: OrTable[Annotated[float, _of("cohesion")], RandomField] | None = key(
        "Cohesion, with friction in place of strength.", 5e3, None, synonyms="c"
    )
    friction: OrTable[Annotated[float, _of("friction")], RandomField] | None = key(
        "Angle of friction.", 25.0, None, synonyms="phi friction_angle"
    )
    dilation: OrTable[Annotated[float, _of("dilation")], RandomField] | None = key(
        "Angle of dilation, at most that of friction.", 0.0, None, otherwise=_default("dilation"),
        synonyms="psi dilatancy",
    )  # fmt: skip
    criterion: Annotated[type, one_of(CRITERIA)] | None = key(
        "Law of soil with friction.", "mohr-coulomb", None, otherwise=_default("criterion")
    )
    matching: Annotated[Matching, one_of(MATCHINGS)] | None = key(
        "Where the cone of Drucker-Prager meets Mohr-Coulomb's pyramid.", "plane strain", None,
        otherwise=_default("matching"),
    )  # fmt: skip
    residual_cohesion: OrTable[Annotated[float, _of("residual_cohesion")], RandomField] | None = key(
        "Cohesion left at large strain.", 0.0, None, otherwise=_default("residual_cohesion")
    )
    residual_friction: OrTable[Annotated[float, _of("residual_friction")], RandomField] | None = key(
        "Friction left at large strain.", 20.0, None, otherwise=_default("residual_friction")
    )
    softening_strain: OrTable[Annotated[float, _of("softening_strain")], RandomField] | None = key(
        "Plastic shear strain over which cohesion and friction fall to the residual.", 0.2, None,
        otherwise="none: no softening",
    )  # fmt: skip
    decay: Annotated[Decay, one_of(DECAYS)] | None = key("How they fall.", "linear", None, otherwise=_default("decay"))
    unusual: Flag = key(
        "Whether to accept numbers that look like another unit. Without it a scene is refused for strength below "
        "1 kPa, cohesion below 0.1 kPa, either above 5 MPa, Young's modulus below 0.2 MPa, or friction below 1.6 "
        "degrees. The same holds for unit weight outside 3 to 40 kN/m3, and gravity outside 0.1 to 30 m/s2. It "
        "also holds for a trend of strength below 50 Pa/m, and for a water level far from the ground.",
        False,
        False,
    )

    @property
    def values(self) -> dict[str, Any]:
        """What is given of the soil, by key."""
        values = {part.name: getattr(self, part.name) for part in fields(SoilTable)}
        return {name: value for name, value in values.items() if value is not None}

    def check_kind(self, home: str) -> None:
        """Check that clay has a strength, other soil cohesion and friction, and neither has what is the other's.

        Args:
            home: where a reader adds what lacks.

        Raises:
            Invalid: it does not.
        """
        values, out = self.values, "leave one of them out"
        frictional = [name for name in ("cohesion", "friction") if name in values]
        undrained = [name for name in ("strength", "strength_ratio") if name in values]
        if frictional and undrained:
            remedy = f"undrained soil has a strength, other soil cohesion and friction; {out}"
            raise Invalid((frictional[0],), None, f"is given beside a {undrained[0]}", remedy)
        if len(undrained) == 2:
            raise Invalid(("strength_ratio",), None, "is given beside a strength, in whose place it is", out)
        if ("strength_ratio" in undrained) != ("strength_minimum" in values):
            lacking, beside = ("minimum", "ratio") if undrained == ["strength_ratio"] else ("ratio", "minimum")
            remedy = "add it; at the surface, where the stress is 0, soil has its strength_minimum (Pa)"
            raise Invalid((), None, f"lacks strength_{lacking}, which goes with strength_{beside}", remedy)
        if not frictional and not undrained:
            remedy = f"add a strength, with mean, cov and length where it varies, or cohesion and friction to {home}"
            raise Invalid((), None, "has neither a strength nor cohesion and friction", remedy)
        if len(frictional) == 1:
            lacking = {"cohesion": "friction", "friction": "cohesion"}[frictional[0]]
            raise Invalid((), None, f"lacks {lacking}, which goes with {frictional[0]}", "add it")
        kind = "soil with cohesion and friction" if frictional else "undrained soil"
        for name in OF_CLAY if frictional else OF_FRICTION:
            if name in values:
                raise Invalid((name,), None, f"has no effect in {kind}", "leave it out")


@table
class LayerTable(SoilTable):
    """Layers of the drawn ground, one `[[layer]]` each, from the top down.

    The last has no lower boundary; all others have one, `bottom`, `raster`, `depth` or `thickness`. A `bottom` that
    reaches the face of a cut ends at that point; one that goes on through the air is refused. Each layer may have any
    key of `[soil]`, and takes what it leaves out from `[soil]` and `[strength]`. A parameter that varies is a table,
    such as `[layer.strength]`. With `mean`, `cov`, `marginal`, `lower`, `upper`, `trend` and `trend_from` alone, the
    layer has its own distribution of the field that passes through all layers; the parameter then varies in `[soil]`
    too. With a `length`, its field stops at its boundaries and is independent of all others; `correlation`, `energy`
    and `bedding` may then be its own too. Layers may be of different kinds, such as sand with cohesion and friction
    over clay with a strength over rock. A layer of the other kind than `[soil]` takes only keys of both kinds from it,
    such as `unit_weight`, `young` and `poisson`. Rock needs these three alone.
    [Another example](random-fields.md#in-a-scene) has fill, clay and rock, without `[soil]`.
    """

    name: Annotated[str, plain_name(LONGEST_NAME)] | None = key(
        "What it is called.", "soft clay", None, otherwise="`layer` and its number"
    )
    bottom: Line | None = key(
        "Its lower boundary. The layer ends where this meets the boundary above.", [[0, 2], [92, -2]], None, units="m"
    )
    raster: Raster | None = key(
        "Instead, under a terrain, a file of the boundary's heights.", "rock.asc", None, units="m"
    )
    depth: Length | None = key("Instead, depth of the boundary below the surface.", 3.0, None)
    thickness: Length | None = key("Instead, thickness of the layer.", 2.0, None)
    top: Metres | Line | None = key(
        'Its top before a cut, an elevation or points: where `trend_from = "layer"` counts from. Without it that is '
        "its top as drawn, which in a cut is the face.",
        5.0,
        None,
        otherwise="its top as drawn",
    )
    rock: Flag = key("Whether it is rock, which does not yield.", True, False)

    @validates(mode="after")
    def _one_boundary(self) -> Self:
        if self.bottom is not None and self.raster is not None:
            raise Invalid((), None, "has both bottom and raster", "give one of them")
        return self


def with_soil(layer: Mapping[str, object], scene: Mapping[str, object]) -> dict[str, object]:
    """A layer as a scene gives it, with what it takes from `[soil]` and `[strength]`.

    Args:
        layer: its table.
        scene: all tables.

    Raises:
        Invalid: tables of parameters that a layer cannot have.
    """
    soil = {**table_of(scene, "soil"), **({"strength": scene["strength"]} if "strength" in scene else {})}
    # A layer of the other kind takes over what both kinds have.
    frictional = is_frictional(layer)
    other = () if frictional in (None, is_frictional(soil)) else OF_CLAY if frictional else OF_FRICTION
    replaced = (
        () if {"strength", "strength_ratio"}.isdisjoint(layer) else ("strength", "strength_ratio", "strength_minimum")
    )
    soil = {name: value for name, value in soil.items() if name in keys(SoilTable) and name not in other}
    merged = {name: value for name, value in soil.items() if name not in replaced} | dict(layer)
    for name, value in layer.items():
        if isinstance(value, dict) and name in keys(SoilTable):
            with at(name):
                _check_field(value, rock=layer.get("rock") is True)
            alone = OF_ALL_LAYERS if "length" in value else ()
            merged[name] = {key: part for key, part in table_of(soil, name).items() if key not in alone} | value
    return merged


def is_frictional(soil: Collection[str]) -> bool | None:
    """Whether soil of these keys has friction; None where none of them is a strength."""
    if not {"cohesion", "friction"}.isdisjoint(soil):
        return True
    return None if {"strength", "strength_ratio"}.isdisjoint(soil) else False


def _check_field(field: Mapping[str, object], *, rock: bool) -> None:
    """Raise Invalid for a table of a layer's own that it cannot have."""
    if rock:
        raise Invalid((), None, "is of rock, in which nothing varies", "leave that table out")
    if "sampled_at" in field:
        raise Invalid(("sampled_at",), shown(field["sampled_at"]), "is that of all layers", "give it in [soil]")
    alone = [key for key in OF_A_FIELD if key in field]
    if alone and "length" not in field:
        raise Invalid((), None, f"has {alone[0]}, which is of a field of its own", "give its length here too")
