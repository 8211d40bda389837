"""The soil of a scene and of its layers, from their tables: numbers, and the parameters that vary as random fields."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields
from typing import Any, cast

from cooperative.scene import tables
from cooperative.scene._plausible import ON_PURPOSE, Path, ask, fields_of
from cooperative.scene._site import Site, SiteLayer
from cooperative.scene.tables import LIMITS, RandomField, Span, has_strength, kind_of
from cooperative.store import table_of
from jaxmpm import FrictionalSoil, Layer, Raster, Soil
from jaxmpm.soil import AnySoil
from jaxmpm.support.check import Gathered, Invalid, at

LOSSES = ("softening_modulus", "strain_95", "loss_time")
"""By which undrained soil loses strength, one of them."""

SOFTENED_BY = {
    "residual_ratio": LOSSES,
    "residual_cohesion": ("softening_strain",),
    "residual_friction": ("softening_strain",),
}
"""What is left of strength, and what else soil has that softens."""

AT_MOST = {"dilation": "friction", "swelling": "compression", "static_friction": "dynamic_friction"}
"""Numbers that another one limits, and which."""

SHAPE = ("mean", "cov", "marginal", "lower", "upper")
"""Of a random field: what makes its distribution."""
TREND = ("trend", "trend_from")

SOIL: Path = ("soil",)
Random = Mapping[str, RandomField]
"""What varies, by parameter."""
PathOf = Callable[[str], Path]
"""Gives the path of a parameter in the scene."""


def soils_of(
    scene: tables.SceneTable, layers: list[Mapping[str, object]], ground: Site
) -> tuple[AnySoil | None, Random, tuple[SiteLayer, ...]]:
    """The soil of a scene with what varies in it, and the layers that the scene draws.

    The soil is that of `[soil]` and `[strength]`, None where they leave its strength to the layers. What a layer does
    not give of its soil is that of the whole scene.

    Args:
        scene: its tables.
        layers: its tables `[[layer]]` as they stand in it.
        ground: of the scene, without its layers.

    Raises:
        Invalid: soil and layers that will not do.
    """
    gathered = Gathered()
    if not scene.unusual:
        with gathered.of(), at("run", "gravity"):
            ask("gravity", scene.run.gravity)
    table, soil, random = scene.whole_soil, None, cast(Random, {})
    if table is not None and not (scene.layer and not has_strength(table.values)):
        with gathered.of():
            strength = ("strength",) if scene.strength is not None else None
            soil, random = _soil_of(table, SOIL, ground, of_strength=strength)
    of_soil, of_layers = {_subject(fault, SOIL) for fault in gathered.faults}, Gathered()
    parts = []
    for number, written in enumerate(layers):
        with of_layers.of():
            parts.append(_layer_of(scene, number, written, random, ground))
    # A layer takes over what [soil] has, and with it the faults of that.
    gathered.faults += [fault for fault in of_layers.faults if _subject(fault, ("layer", 0)) not in of_soil]
    gathered.raise_all()
    return soil, random, tuple(parts)


def _subject(fault: ValueError | str, table: Path) -> object:
    """What a fault is of, without the table in which it stands."""
    if not isinstance(fault, Invalid):
        return str(fault)
    inner = fault.path[len(table) :] if fault.path[:1] == table[:1] else fault.path
    return inner, fault.value, fault.rule


def _soil_of(
    table: tables.SoilTable, where: Path, ground: Site, of_strength: Path | None = None
) -> tuple[AnySoil, dict[str, RandomField]]:
    """The soil with the means of what varies, and the fields by parameter.

    table: of the soil. where: path of the table. of_strength: path of its strength, where that stands in a table of
    its own. Raises Invalid for soil that will not do.
    """
    values, home = table.values, "[soil]" if where == SOIL else "the layer"

    def path(parameter: str) -> Path:
        return of_strength if of_strength and parameter == "strength" else (*where, parameter)

    with at(*where):
        table.check_kind(home)
    random = fields_of(
        {name: value for name, value in values.items() if name in LIMITS}, path, span=ground.span,
        downhill=getattr(ground.shape, "downhill", 1), home=home, unusual=table.unusual,
    )  # fmt: skip
    values = _means(values)
    for name, others in SOFTENED_BY.items():
        if name in random and values.keys().isdisjoint(others):
            remedy = f"add {' or '.join(others)} to {home}, or leave it out"
            raise Invalid(path(name), None, "varies, but the soil does not soften", remedy)
    if (losses := [name for name in LOSSES if name in values])[1:]:
        raise Invalid(path(losses[1]), None, f"is given beside {losses[0]}", "choose one loss of strength")
    _check_saturated(values, random, path, home)
    _check_limited(values, random, ground.span, path)
    return _built(values), {name: random[name] for name in LIMITS if name in random}


def _layer_of(
    scene: tables.SceneTable, number: int, written: Mapping[str, object], random: Random, ground: Site
) -> SiteLayer:
    """A layer of a scene: its soil, the fields of what varies in it, and the parameters whose field stops at it.

    written: its table as it stands in the scene. random: what varies in the soil of the whole scene. Raises Invalid as
    `_soil_of` does, and for what a layer cannot have.
    """
    table, where = scene.layer[number], ("layer", number)
    stops: tuple[str, ...] = ()
    if table.rock:
        with at(*where):
            soil, varying = _rock(table), cast(Random, {})
    else:
        soil, varying = _soil_of(table, where, ground)
        stops = tuple(name for name in varying if "length" in table_of(written, name))
    for name, field in varying.items():
        if name not in stops:
            _check_through(scene, (*where, name), field, random.get(name))
    bottom = cast(Raster | None, table.raster) if table.bottom is None else table.bottom
    layer = Layer(soil, bottom, table.depth, table.thickness)
    return SiteLayer(table.name or f"layer {number + 1}", layer, varying, table.rock, stops, table.top)


def _check_through(scene: tables.SceneTable, path: Path, field: RandomField, whole: RandomField | None) -> None:
    """Raise Invalid for a distribution in a layer that a field through all layers, `whole`, cannot have there."""
    if whole is None:
        raise Invalid(
            path, None, "varies, and in [soil] it does not",
            "give it a length here, for a field of its own, or make it a table there too",
        )  # fmt: skip
    together = scene.cross_correlation
    correlated = together is not None and together.nataf and path[-1] in together.parameters
    other = {key for key in SHAPE + TREND if getattr(field, key) != getattr(whole, key)}
    if (field.boreholes is not None and other) or ((field.nataf or correlated) and other & {*SHAPE}):
        raise Invalid(
            path, None,
            "has nataf or boreholes in [soil], or nataf in [cross_correlation], which are of one distribution "
            "throughout",
            "leave them out, or give this layer no distribution of its own, or a field of its own by its length",
        )  # fmt: skip


def _means(values: Mapping[str, Any]) -> dict[str, Any]:
    """The values with the mean of what varies."""
    return {name: value.mean if isinstance(value, RandomField) else value for name, value in values.items()}


def _rock(table: tables.LayerTable) -> AnySoil:
    """Soil like that of the table at its means that does not yield.

    Undrained soil and soil with cohesion have its Young's modulus for a strength; soil of another law is elastic.
    """
    if table.young is None:
        raise Invalid((), None, "lacks young", "add it")
    values = _means(table.values) | {"unusual": True}
    kind = kind_of(values)
    values = {name: value for name, value in values.items() if name not in ("strength_ratio", "strength_minimum")}
    if kind is FrictionalSoil or kind is Soil:
        return _built(values | {"cohesion" if kind is FrictionalSoil else "strength": values["young"]})
    return _built({name: value for name, value in values.items() if name != "law"})


def _check_saturated(values: Mapping[str, Any], random: Random, path: PathOf, home: str) -> None:
    """Water in its pores does not make soil lighter."""
    if (saturated := values.get("saturated_unit_weight")) is None:
        return
    where, words, weight = path("saturated_unit_weight"), f"{saturated:g} N/m3", values["unit_weight"]
    if "unit_weight" in random and "saturated_unit_weight" not in random:
        raise Invalid(
            where, words, "beside a unit_weight that varies, which is that of all soil, wet or dry",
            "give unit_weight as a number, or leave saturated_unit_weight out",
        )  # fmt: skip
    if saturated < weight and not values["unusual"]:
        raise Invalid(
            where, words, f"is below unit_weight = {weight:g} N/m3, that of soil above the water",
            f"give at least that. {ON_PURPOSE.format(home)}",
        )  # fmt: skip


def _check_limited(values: Mapping[str, Any], random: Random, span: Span, path: PathOf) -> None:
    """Soil that dilates by more than its friction would gain work by sliding; none gains strength by softening."""
    kind = kind_of(values)

    def ends(name: str) -> tuple[float, float]:
        value = values.get(name, getattr(kind, name, None))
        return random[name].extremes(span) if name in random else (value, value)

    for name in ("cohesion", "friction") if "softening_strain" in values else ():
        (least, _), (_, residual) = ends(name), ends(f"residual_{name}")
        if residual > least:
            raise Invalid(
                path(f"residual_{name}"), None,
                f"reaches {residual:.4g} {LIMITS[name].unit}, but {name} comes down to {least:.3g}",
                "give a residual of at most that",
            )  # fmt: skip
    for name, other in AT_MOST.items():
        if other in values and (most := ends(name)[1]) > (least := ends(other)[0]):
            reaches = f"reaches {most:.3g} {LIMITS[name].unit}".rstrip()
            raise Invalid(
                path(name),
                None,
                f"{reaches}, {other} comes down to {least:.3g}",
                f"give a {name} of at most the {other}",
            )


def _built(values: Mapping[str, Any]) -> AnySoil:
    """The soil of these numbers; what is not among them is left to the solver's defaults."""
    kind = kind_of(values) or Soil
    names = {field.name for field in fields(kind)}
    return kind(**{name: value for name, value in values.items() if name in names})
