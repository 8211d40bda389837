"""Tables of the soil: `[soil]`, what varies in it as `[strength]`, and `[[layer]]`."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import MISSING, fields
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import model_validator as validates
from pydantic.config import JsonDict
from pydantic_core import ArgsKwargs

from cooperative.scene.tables._key import (
    Flag,
    Length,
    Line,
    Metres,
    Name,
    OrTable,
    Part,
    Raster,
    Within,
    key,
    keys,
    one_of,
    table,
)
from cooperative.scene.tables._varying import RandomField
from cooperative.store import table_of
from jaxmpm import AnisotropicSoil, CamClaySoil, FrictionalSoil, GranularSoil, PlasticStrain, Soil
from jaxmpm.laws import J2, AnisotropicUndrained, Decay, DruckerPrager, Matching, ModifiedCamClay, MohrCoulomb, MuI
from jaxmpm.soil import AnySoil, soil_limits
from jaxmpm.support.check import Invalid, at
from jaxmpm.support.text import shown

LAWS: dict[str, type] = {
    "undrained": J2,
    "mohr-coulomb": MohrCoulomb,
    "drucker-prager": DruckerPrager,
    "modified cam clay": ModifiedCamClay,
    "anisotropic undrained": AnisotropicUndrained,
    "mu(I)": MuI,
}
KINDS: dict[type, type[AnySoil]] = {
    J2: Soil,
    MohrCoulomb: FrictionalSoil,
    DruckerPrager: FrictionalSoil,
    ModifiedCamClay: CamClaySoil,
    AnisotropicUndrained: AnisotropicSoil,
    MuI: GranularSoil,
}
"""The solver's soil that has the numbers of a law."""
MATCHINGS = {matching.value: matching for matching in Matching}
DECAYS = {decay.name.lower(): decay for decay in Decay}
PLASTIC_STRAINS = {measure.value: measure for measure in PlasticStrain}

KEYS = {kind: tuple(part.name for part in fields(kind) if part.name != "law") for kind in KINDS.values()}
"""Keys that each kind of soil has a use for, beside `law`."""
REQUIRED = {kind: tuple(part.name for part in fields(kind) if part.default is MISSING) for kind in KINDS.values()} | {
    Soil: ("strength", "strength_ratio")
}
"""Those of its strength, which a kind of soil does not do without: all, of undrained soil one."""
OF_ALL_LAYERS = ("boreholes", "borehole_error", "mean_error", "cov_error", "factor_cov")
"""Of a random field: measured values, and errors of estimates, which a layer does not take from another field."""
OF_A_FIELD = ("length", "correlation", "form", "energy", "bedding", "nataf", *OF_ALL_LAYERS)
"""What a layer gives only of a field of its own, which stops at it: its length at least."""


def _of(parameter: str) -> Within:
    return Within(soil_limits()[parameter])


def _default(parameter: str) -> str:
    """The solver's default of what a scene leaves out, in words."""
    value: Any = next(getattr(kind, parameter) for kind in KINDS.values() if hasattr(kind, parameter))
    named = {choice: name for choices in (MATCHINGS, DECAYS, PLASTIC_STRAINS) for name, choice in choices.items()}
    return f"`{json.dumps(value if isinstance(value, bool | float) else named[value])}`"


@table
class SoilTable(Part):
    """The soil: undrained, with a strength that does not depend on pressure, with cohesion and friction, or of a `law`.

    A parameter that varies is a table in place of a number, such as `[soil.cohesion]`, with the keys of `[strength]`.
    A number that looks like kPa or kN/m3 is refused, see `unusual`.
    """

    SCHEMA: ClassVar[JsonDict] = {"required": ["unit_weight", "poisson"]}

    law: Annotated[type, one_of(LAWS)] | None = key(
        'Constitutive law. Undrained soil has a `strength`; `"mohr-coulomb"` and `"drucker-prager"` have `cohesion` '
        "and `friction`; the others have the keys that name them, see [laws](soils.md#laws-of-a-scene).",
        "modified cam clay",
        None,
        otherwise='`"undrained"` with a strength, `"mohr-coulomb"` with cohesion and friction',
        synonyms="criterion model constitutive_law constitutive_model material",
    )
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
    young: OrTable[Annotated[float, _of("young")], RandomField] | None = key(
        "Young's modulus.", 1e8, otherwise="none, give it; modified Cam Clay has none",
        synonyms="e youngs_modulus young_modulus modulus stiffness",
    )  # fmt: skip
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
    loss_time: OrTable[Annotated[float, _of("loss_time")], RandomField] | None = key(
        "Time from the start of a run over which undrained strength falls to `residual_ratio` of itself, whatever the "
        "strain, as that of sand that liquefies.",
        10.0,
        None,
        otherwise="none: no loss over time",
        synonyms="strength_loss_time liquefaction_time",
    )
    cohesion: OrTable[Annotated[float, _of("cohesion")], RandomField] | None = key(
        "Cohesion, with friction in place of strength.", 5e3, None, synonyms="c"
    )
    friction: OrTable[Annotated[float, _of("friction")], RandomField] | None = key(
        "Angle of friction.", 25.0, None, synonyms="phi friction_angle"
    )
    dilation: OrTable[Annotated[float, _of("dilation")], RandomField] | None = key(
        "Angle of dilation, at most that of friction. Below 0 soil contracts in shear, to `softening_strain`.", 0.0,
        None, otherwise=_default("dilation"), synonyms="psi dilatancy contraction",
    )  # fmt: skip
    b_value: OrTable[Annotated[float, _of("b_value")], RandomField] | None = key(
        "Skempton's B of soil below the water, which from rest on neither loses nor takes up water: its pore pressure "
        "follows the mean stress and its contraction under shear, see [seepage](seepage.md#undrained-slides).",
        0.95, None, otherwise="none: drained, soil keeps its pore pressure",
        synonyms="b skempton skempton_b skemptons_b b-value pore_pressure_coefficient undrained_b",
    )  # fmt: skip
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
    compression: OrTable[Annotated[float, _of("compression")], RandomField] | None = key(
        "Of modified Cam Clay, lambda* = lambda / (1 + e): volumetric strain per ln p on the virgin line.", 0.1, None,
        synonyms="lambda lambda* compression_index",
    )  # fmt: skip
    swelling: Annotated[float, _of("swelling")] | None = key(
        "Of modified Cam Clay, kappa* = kappa / (1 + e), below `compression`.", 0.02, None,
        synonyms="kappa kappa* swelling_index",
    )  # fmt: skip
    critical_state: OrTable[Annotated[float, _of("critical_state")], RandomField] | None = key(
        "Of modified Cam Clay, M = q / p at the critical state, 6 sin(phi) / (3 - sin(phi)).", 1.0, None,
        synonyms="m critical_state_ratio",
    )  # fmt: skip
    ocr: OrTable[Annotated[float, _of("ocr")], RandomField] | None = key(
        "Of modified Cam Clay, the largest vertical effective stress so far over that at rest.", 2.0, None,
        otherwise=_default("ocr"), synonyms="overconsolidation_ratio",
    )  # fmt: skip
    largest_pressure: Annotated[float, _of("largest_pressure")] | None = key(
        "Of modified Cam Clay, mean effective stress from which on stiffness grows no more, above all that the slope "
        "reaches; it limits the time step.",
        500e3,
        None,
        otherwise=_default("largest_pressure"),
    )
    least_pressure: Annotated[float, _of("least_pressure")] | None = key(
        "Of modified Cam Clay, mean effective stress below which stiffness and strength shrink no more.", 1e3, None,
        otherwise=_default("least_pressure"),
    )  # fmt: skip
    active_strength: OrTable[Annotated[float, _of("active_strength")], RandomField] | None = key(
        "Of anisotropic undrained clay, strength where the vertical stress grows, as under a crest.", 40e3, None,
        synonyms="su_a s_u_a sua compression_strength",
    )  # fmt: skip
    simple_strength: OrTable[Annotated[float, _of("simple_strength")], RandomField] | None = key(
        "Likewise, in direct simple shear.", 30e3, None, synonyms="su_dss s_u_d dss_strength sudss"
    )
    passive_strength: OrTable[Annotated[float, _of("passive_strength")], RandomField] | None = key(
        "Likewise, where the vertical stress falls, as at a toe.", 20e3, None,
        synonyms="su_p s_u_p sup extension_strength",
    )  # fmt: skip
    failure_strain: OrTable[Annotated[float, _of("failure_strain")], RandomField] | None = key(
        "Likewise, engineering plastic shear strain at which these are mobilised.", 0.05, None,
        otherwise=_default("failure_strain"),
    )  # fmt: skip
    static_friction: OrTable[Annotated[float, _of("static_friction")], RandomField] | None = key(
        "Of grains with mu(I), arctan mu_s: the angle of repose.", 21.0, None, synonyms="mu_s repose angle_of_repose"
    )
    dynamic_friction: OrTable[Annotated[float, _of("dynamic_friction")], RandomField] | None = key(
        "Likewise, arctan mu_2 of infinitely fast flow, at least the static one.", 33.0, None, synonyms="mu_2 mu2"
    )
    grain_size: OrTable[Annotated[float, _of("grain_size")], RandomField] | None = key(
        "Likewise, diameter of a grain.", 0.01, None, synonyms="diameter d50 d particle_diameter"
    )
    inertial_number: Annotated[float, _of("inertial_number")] | None = key(
        "Likewise, I_0 at which friction is half way between both.", 0.279, None,
        otherwise=_default("inertial_number"), synonyms="i_0 i0",
    )  # fmt: skip
    grain_density: Annotated[float, _of("grain_density")] | None = key(
        "Likewise, density of the solid.", 2500.0, None, otherwise=_default("grain_density"), synonyms="rho_s"
    )
    k0: OrTable[Annotated[float, _of("k0")], RandomField] | None = key(
        "Horizontal over vertical effective stress at rest of level ground; under a slope equilibrium asks for more "
        "shear. A number that the soil does not bear, beyond its active or passive limit, is refused.",
        0.5, None, otherwise="that of elastic loading, nu / (1 - nu)",
        synonyms="k_0 k_zero at_rest_coefficient earth_pressure_at_rest lateral_earth_pressure lateral_stress_ratio",
    )  # fmt: skip
    unusual: Flag = key(
        "Whether to accept numbers that look like another unit. Without it a scene is refused for strength below "
        "1 kPa, cohesion below 0.1 kPa, either above 5 MPa, Young's modulus below 0.2 MPa, or friction below 1.6 "
        "degrees. The same holds for unit weight outside 3 to 40 kN/m3, and gravity outside 0.1 to 30 m/s2. It "
        "also holds for a trend of strength below 50 Pa/m, and for a water level far from the ground.",
        False,
        False,
    )

    @validates(mode="before")
    @classmethod
    def _without_young(cls, values: object) -> object:
        """Let soil of a law that has no Young's modulus do without its key."""
        arguments = values.kwargs if isinstance(values, ArgsKwargs) else values
        if not isinstance(arguments, dict):
            return values
        kind = kind_of(arguments)
        kinds = [kind] if kind else [kind for kind, names in REQUIRED.items() if not arguments.keys().isdisjoint(names)]
        return arguments if all("young" in KEYS[kind] for kind in kinds) else {"young": None, **arguments}

    @property
    def values(self) -> dict[str, Any]:
        """What is given of the soil, by key."""
        values = {part.name: getattr(self, part.name) for part in fields(SoilTable)}
        return {name: value for name, value in values.items() if value is not None}

    def check_kind(self, home: str) -> None:
        """Check that the soil has the numbers of one law, all of them, and none of another.

        Args:
            home: where a reader adds what lacks.

        Raises:
            Invalid: it does not.
        """
        values, out = self.values, "leave one of them out"
        frictional = [name for name in REQUIRED[FrictionalSoil] if name in values]
        undrained = [name for name in REQUIRED[Soil] if name in values]
        if self.law is None and frictional and undrained:
            remedy = f"undrained soil has a strength, other soil cohesion and friction; {out}"
            raise Invalid((frictional[0],), None, f"is given beside a {undrained[0]}", remedy)
        if len(undrained) == 2:
            raise Invalid(("strength_ratio",), None, "is given beside a strength, in whose place it is", out)
        if ("strength_ratio" in undrained) != ("strength_minimum" in values):
            lacking, beside = ("minimum", "ratio") if undrained == ["strength_ratio"] else ("ratio", "minimum")
            remedy = "add it; at the surface, where the stress is 0, soil has its strength_minimum (Pa)"
            raise Invalid((), None, f"lacks strength_{lacking}, which goes with strength_{beside}", remedy)
        kind = kind_of(values)
        if kind is None:
            remedy = f"add a strength, with mean, cov and length where it varies, or cohesion and friction to {home}"
            laws = [name for name, law in LAWS.items() if not set(REQUIRED[KINDS[law]]).isdisjoint(values)]
            remedy += f"; what it has is of law = {laws[0]!r}, which {home} does not name" if laws else ""
            raise Invalid((), None, "has neither a strength nor cohesion and friction", remedy)
        law = self.law if self.law is not None else J2 if undrained else MohrCoulomb
        name = next(name for name, named in LAWS.items() if named is law)
        words = {Soil: "undrained soil", FrictionalSoil: "soil with cohesion and friction"}
        for idle in values:
            if idle not in ("law", *KEYS[kind]):
                raise Invalid(
                    (idle,), None, f"has no effect in {words.get(kind, f'soil of law = {name!r}')}", "leave it out"
                )
        if self.matching is not None and law is not DruckerPrager:
            remedy = "leave it out, or give law = 'drucker-prager'"
            raise Invalid(("matching",), None, f"is of Drucker-Prager's cone, and has no effect with {name}", remedy)
        of_strength = undrained or REQUIRED[kind][:1] if kind is Soil else REQUIRED[kind]
        missing = [key for key in of_strength if key not in values]
        if missing:
            goes_with = f", which goes with {frictional[0]}" if len(frictional) == 1 and kind is FrictionalSoil else ""
            raise Invalid((), None, f"lacks {', '.join(missing)}{goes_with}", "add it")


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

    name: Name | None = key("What it is called.", "soft clay", None, otherwise="`layer` and its number")
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
    # A layer of another kind takes over what both kinds have.
    kind = kind_of(layer)
    taken = keys(SoilTable) if kind in (None, kind_of(soil)) else KEYS[kind]
    replaced = (
        () if {"strength", "strength_ratio"}.isdisjoint(layer) else ("strength", "strength_ratio", "strength_minimum")
    )
    soil = {name: value for name, value in soil.items() if name in taken}
    merged = {name: value for name, value in soil.items() if name not in replaced} | dict(layer)
    for name, value in layer.items():
        if isinstance(value, dict) and name in keys(SoilTable):
            with at(name):
                _check_field(value, rock=layer.get("rock") is True)
            alone = OF_ALL_LAYERS if "length" in value else ()
            merged[name] = {key: part for key, part in table_of(soil, name).items() if key not in alone} | value
    return merged


def kind_of(soil: Mapping[str, Any]) -> type[AnySoil] | None:
    """The solver's soil that soil of these keys is, by its law or its strength; None where it has neither."""
    law = soil.get("law")
    law = LAWS.get(law) if isinstance(law, str) else law
    if isinstance(law, type) and law in KINDS:
        return KINDS[law]
    for kind in (FrictionalSoil, Soil):
        if not set(REQUIRED[kind]).isdisjoint(soil):
            return kind
    return None


def has_strength(soil: Mapping[str, Any]) -> bool:
    """Whether soil of these keys has any that its strength is of."""
    return any(name in soil for names in REQUIRED.values() for name in names)


def _check_field(field: Mapping[str, object], *, rock: bool) -> None:
    """Raise Invalid for a table of a layer's own that it cannot have."""
    if rock:
        raise Invalid((), None, "is of rock, in which nothing varies", "leave that table out")
    if "sampled_at" in field:
        raise Invalid(("sampled_at",), shown(field["sampled_at"]), "is that of all layers", "give it in [soil]")
    alone = [key for key in OF_A_FIELD if key in field]
    if alone and "length" not in field:
        raise Invalid((), None, f"has {alone[0]}, which is of a field of its own", "give its length here too")
