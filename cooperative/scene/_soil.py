"""The soil of a scene and of its layers, from their tables: numbers, and the parameters that vary as random fields."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import fields, replace
from typing import Any, TypeGuard, cast

from cooperative.scene import tables
from cooperative.scene._plausible import ON_PURPOSE, ask, ask_of_field
from cooperative.scene._site import SiteLayer
from cooperative.scene.tables import LIMITS, RandomField, Span
from jaxmpm import FrictionalSoil, Layer, Raster, Soil
from jaxmpm.support.check import Gathered
from jaxmpm.support.text import shown

BAND = 1 / 5
"""Thickness of the band to which softening refers, over the slope's height, where a scene gives none."""

SOFTENED_BY = {
    "residual_ratio": ("softening_modulus", "strain_95"),
    "residual_cohesion": ("softening_strain",),
    "residual_friction": ("softening_strain",),
}
"""What is left of strength, and what else soil has that softens."""

OF_CLAY, OF_FRICTION = (
    tuple(each.name for each in fields(kind) if each.name not in {other.name for other in fields(beside)})
    for kind, beside in ((Soil, FrictionalSoil), (FrictionalSoil, Soil))
)
"""Keys of the soil that only undrained clay, or only soil with friction, has a use for."""

Numbers = Mapping[str, float | None]
"""Numbers of the soil by key, the means of what varies; None for what is not given."""

Label = Callable[[str], str]
"""Gives the name of a parameter as messages have it: with the table of the scene in which it stands."""


def _in_scene(soil: tables.Soil, strength: RandomField | None) -> Label:
    """Names of the parameters that stand in `[soil]`, or `[strength]`."""

    def label(name: str) -> str:
        if name == "strength" and strength is not None:
            return "[strength]"
        return f"[soil.{name}]" if isinstance(getattr(soil, name), RandomField) else f"[soil] {name}"

    return label


def soils_of(
    scene: tables.Scene, *, height: float, span: Span, downhill: int
) -> tuple[Soil | FrictionalSoil | None, Mapping[str, RandomField], tuple[SiteLayer, ...]]:
    """The soil of a scene with what varies in it, and the layers that the scene draws.

    The soil is that of `[soil]` and `[strength]`, None where they leave its strength to the layers. What a layer does
    not give of its soil is that of the whole scene.

    Args:
        scene: its tables.
        height: of the slope (m).
        span: elevations of the ground (m).
        downhill: direction along x in which the ground falls, 1 or -1.

    Raises:
        ValueError: soil and layers that will not do.
    """
    if not scene.unusual:
        ask("[run] gravity", "gravity", scene.run.gravity)
    soil, random, gathered = None, cast(Mapping[str, RandomField], {}), Gathered()
    if scene.soil is not None and not (scene.layer and _kind(_of_scene(scene)) is None):
        table = scene.soil if scene.strength is None else scene.soil.model_copy(update={"strength": scene.strength})
        random = {name: value for name, value in table if isinstance(value, RandomField)}
        with gathered.of():
            soil, random = _soil_of(
                table, _in_scene(scene.soil, scene.strength), height=height, span=span, downhill=downhill
            )
    layers, of_soil = [], {_subject(fault) for fault in gathered.faults}
    for number, table in enumerate(scene.layer, 1):
        where = f"layer {number}" if table.name is None else f"layer {shown(table.name)}"
        with gathered.of(f"[{where}]: "):
            own, varies, stops = _soil_of_layer(scene, table, random, height=height, span=span, downhill=downhill)
            bottom = cast(Raster | None, table.raster) if table.bottom is None else table.bottom
            layer = Layer(own, bottom, table.depth, table.thickness)
            layers.append(SiteLayer(table.name or where, layer, varies, table.rock, stops, _top_of(table, scene)))
    # A layer takes over what [soil] has, and with it the faults of that.
    gathered.faults = [each for each in gathered.faults if _subject(each.partition("]: ")[2]) not in of_soil]
    gathered.raise_all()
    return soil, random, tuple(layers)


def _subject(fault: str) -> str:
    """Key, with its table, that a message is about."""
    return fault.partition(" = ")[0]


def _top_of(table: tables.Layer, scene: tables.Scene) -> float | tuple[tuple[float, float], ...] | None:
    """A layer's top before a cut; ValueError for points of it in 3D."""
    if table.top is None or isinstance(table.top, int | float):
        return table.top
    if scene.ground is None:
        raise ValueError("top is a line, which is for a scene with [ground]: give its elevation (m)")
    return tuple((float(x), float(z)) for x, z in table.top)


def _soil_of(
    table: tables.Soil, label: Label, *, height: float, span: Span, downhill: int, home: str = "[soil]"
) -> tuple[Soil | FrictionalSoil, Mapping[str, RandomField]]:
    """The soil with the means of what varies, and the fields by parameter.

    table: `[soil]`, with the strength of `[strength]`. label: names its parameters. height: of the slope (m). span: of
    the ground. home: where a reader adds what lacks. Raises ValueError for parameters that no soil has, that do not go
    together or whose numbers betray
    another unit, and for fields whose values leave their limits.
    """
    values, random, unusual, gathered = dict(table), {}, table.unusual, Gathered()
    with gathered.of():
        _check_kind(values, table.model_fields_set, label, home)
    for name, value in table:
        with gathered.of():
            if isinstance(value, RandomField):
                random[name], values[name] = value.dipping(downhill), value.mean
                if not unusual:
                    ask_of_field(label(name), name, random[name], home)
                random[name].check(label(name), LIMITS[name], span)
            elif name in LIMITS and isinstance(value, float) and not unusual:
                ask(label(name), name, value, home=home)
    gathered.raise_all()
    for name, others in SOFTENED_BY.items():
        if name in random and all(values[other] is None for other in others):
            raise ValueError(
                f"{label(name)} varies, but the soil does not soften: add {' or '.join(others)} to {home}, or "
                "leave it out"
            )
    _check_saturated(values, random, label, home)
    _check_friction(values, random, span, label)
    return _built(values, height), {name: random[name] for name in LIMITS if name in random}


def _soil_of_layer(
    scene: tables.Scene,
    layer: tables.Layer,
    random: Mapping[str, RandomField],
    *,
    height: float,
    span: Span,
    downhill: int,
) -> tuple[Soil | FrictionalSoil, Mapping[str, RandomField], tuple[str, ...]]:
    """A layer's soil, the fields of what varies in it, and the parameters whose field stops at it.

    Its own table stands over those of the scene. random: what varies in the soil of the whole scene. height, span: as
    for `_soil_of`. Raises ValueError as it does, and for what a layer cannot have.
    """
    own = {key: value for key, value in _given(layer).items() if key in tables.Soil.model_fields}
    whole = _of_scene(scene)
    if _kind(own) not in (None, _kind(whole)):
        # A layer of the other kind takes over what both kinds have.
        others = OF_CLAY if _kind(whole) == UNDRAINED else OF_FRICTION
        whole = {key: value for key, value in whole.items() if key not in others}
    given = {"strength", "strength_ratio"} & own.keys()
    replaced = {"strength", "strength_ratio", "strength_minimum"} - own.keys() if given else set()
    merged = {key: value for key, value in whole.items() if key not in replaced} | own
    if lacking := [key for key in ("unit_weight", "young", "poisson") if key not in merged]:
        raise ValueError(f"neither it nor [soil] gives {', '.join(lacking)}: add it")
    for name, value in own.items():
        if _varies(value):
            stops = _of_its_own(layer, name)
            # Measured values, and errors of estimates, are of one field.
            left_out = ("boreholes", "borehole_error", "mean_error", "cov_error", "factor_cov") if stops else ()
            below = whole.get(name)
            inherited = _given(below) if _varies(below) else {}
            merged[name] = {key: each for key, each in inherited.items() if key not in left_out} | _given(value)
            if stops and "length" not in stops:
                raise ValueError(f"{name} has {stops[0]}, which is of a field of its own: give its length here too")
    if layer.rock and (varies := [key for key, value in own.items() if _varies(value)]):
        raise ValueError(f"it is rock, which has no {varies[0]} to vary: leave that table out")
    soil = tables.read(tables.Soil, merged, "layer")
    if layer.rock:
        return _rock(soil, height), {}, ()
    above = _in_scene(soil if scene.soil is None else scene.soil, scene.strength)
    own_soil, varying = _soil_of(
        soil,
        lambda name: name if name in own else above(name),
        height=height,
        span=span,
        downhill=downhill,
        home="the layer",
    )
    for name, field in varying.items():
        if name not in random:
            if "length" not in _of_its_own(layer, name):
                raise ValueError(
                    f"{name} varies, and in [soil] it does not: give it a length here, for a field of its own, or make "
                    "it a table there too"
                )
            continue
        together = scene.cross_correlation
        correlated = together is not None and together.nataf and name in together.parameters
        other = {key for key in SHAPE + TREND if getattr(field, key) != getattr(random[name], key)}
        measured = field.boreholes is not None and other
        if not _of_its_own(layer, name) and (measured or ((field.nataf or correlated) and other & {*SHAPE})):
            raise ValueError(
                f"{name} has nataf or boreholes in [soil], or nataf in [cross_correlation], which are of one "
                "distribution throughout: leave them out, or give this layer no distribution of its own, or a field of "
                "its own by its length"
            )
    return own_soil, varying, tuple(name for name in varying if "length" in _of_its_own(layer, name))


SHAPE = ("mean", "cov", "marginal", "lower", "upper")
"""Of a random field: what makes its distribution."""
TREND = ("trend", "trend_from")

UNDRAINED, FRICTIONAL = "undrained", "frictional"


def _kind(given: Collection[str]) -> str | None:
    """Of which kind soil is that has these keys; None where none is a strength."""
    if not {"cohesion", "friction"}.isdisjoint(given):
        return FRICTIONAL
    return None if {"strength", "strength_ratio"}.isdisjoint(given) else UNDRAINED


def _of_scene(scene: tables.Scene) -> dict[str, object]:
    """What a scene gives of its soil, in `[soil]` and `[strength]`."""
    return ({} if scene.soil is None else _given(scene.soil)) | (
        {} if scene.strength is None else {"strength": scene.strength}
    )


def _given(table: tables.Table | RandomField) -> dict[str, object]:
    """What a scene gives of a table; all of a random field."""
    names = [part.name for part in fields(table)] if isinstance(table, RandomField) else table.model_fields_set
    return {name: getattr(table, name) for name in names}


def _varies(value: object) -> TypeGuard[tables.Table | RandomField]:
    """Whether this is a table of how a parameter varies."""
    return isinstance(value, tables.Table | RandomField)


def _of_its_own(layer: tables.Layer, parameter: str) -> list[str]:
    """What a layer gives of a parameter that only a field of its own has."""
    value = getattr(layer, parameter)
    given = value.model_fields_set if isinstance(value, tables.Table) else ()
    return [key for key in tables.OF_A_FIELD if key in given]


def _rock(table: tables.Soil, height: float) -> Soil | FrictionalSoil:
    """Soil like that of the table at its means that does not yield: its strength is its Young's modulus."""
    values = {name: value.mean if isinstance(value, RandomField) else value for name, value in table}
    kind = _kind([name for name, value in values.items() if value is not None])
    values |= {"unusual": True, "strength_ratio": None, "strength_minimum": None}
    if kind is not None:
        values["strength" if kind == UNDRAINED else "cohesion"] = values["young"]
    return _built(values, height)


def _check_kind(values: Mapping[str, object], given: Collection[str], label: Label, home: str) -> None:
    """Clay has a strength, other soil cohesion and friction; ValueError for what has no effect."""
    frictional = [name for name in ("cohesion", "friction") if values[name] is not None]
    undrained = [name for name in ("strength", "strength_ratio") if values[name] is not None]
    if frictional and undrained:
        raise ValueError(
            f"{label(frictional[0])} is given beside a {undrained[0]}: undrained soil has a strength, other soil "
            "cohesion and friction; leave one of them out"
        )
    if len(undrained) == 2:
        raise ValueError(
            f"{label('strength_ratio')} is given beside a strength, in whose place it is: leave one of them out"
        )
    if ("strength_ratio" in undrained) != (values["strength_minimum"] is not None):
        lacking, beside = ("minimum", "ratio") if undrained == ["strength_ratio"] else ("ratio", "minimum")
        raise ValueError(
            f"{home} lacks strength_{lacking}, which goes with strength_{beside}: add it; at the surface, where the "
            "stress is 0, soil has its strength_minimum (Pa)"
        )
    if not frictional and not undrained:
        raise ValueError(
            "the soil has neither a strength nor cohesion and friction: add [strength] with "
            "mean, cov and length, or cohesion and friction to [soil]"
            if home == "[soil]"
            else "neither it nor [soil] gives its strength: add strength for undrained soil, or cohesion and friction"
        )
    if len(frictional) == 1:
        lacking = {"cohesion": "friction", "friction": "cohesion"}[frictional[0]]
        subject = home if home == "[soil]" else "it"
        raise ValueError(f"{subject} lacks {lacking}, which goes with {frictional[0]}: add it")
    for name in OF_CLAY if frictional else OF_FRICTION:
        if name in given:
            kind = "soil with cohesion and friction" if frictional else "undrained soil"
            raise ValueError(f"{label(name)} has no effect in {kind}: leave it out")


def _check_saturated(values: Numbers, random: Mapping[str, RandomField], label: Label, home: str) -> None:
    """Water in its pores does not make soil lighter."""
    saturated, weight = values["saturated_unit_weight"], values["unit_weight"]
    if saturated is None or weight is None:
        return
    if "unit_weight" in random and "saturated_unit_weight" not in random:
        raise ValueError(
            f"{label('saturated_unit_weight')} = {saturated:g} N/m3 beside a unit_weight that varies, which is that of "
            "all soil, wet or dry: give unit_weight as a number, or leave saturated_unit_weight out"
        )
    if saturated < weight and not values["unusual"]:
        raise ValueError(
            f"{label('saturated_unit_weight')} = {saturated:g} N/m3 is below unit_weight = {weight:g} N/m3, that of "
            f"soil above the water: give at least that. {ON_PURPOSE.format(home)}"
        )


def _check_friction(values: Numbers, random: Mapping[str, RandomField], span: Span, label: Label) -> None:
    """Soil that dilates by more than its friction would gain work by sliding; none gains strength by softening."""
    if values["friction"] is None:
        return

    def ends(name: str) -> tuple[float, float]:
        if name in random:
            return random[name].extremes(span)
        value = values[name]
        assert value is not None
        return value, value

    for name in ("cohesion", "friction") if values["softening_strain"] is not None else ():
        (least, _), (_, residual) = ends(name), ends(f"residual_{name}")
        if residual > least:
            goes = "reaches" if f"residual_{name}" in random else "="
            raise ValueError(
                f"{label(f'residual_{name}')} {goes} {residual:.4g} {LIMITS[name].unit}, but {name} comes down to "
                f"{least:.3g}: give a residual of at most that"
            )
    friction, dilation = ends("friction"), ends("dilation")
    if dilation[1] > friction[0]:
        raise ValueError(
            f"{label('dilation')} reaches {dilation[1]:.3g} degrees, friction comes down to {friction[0]:.3g}: give a "
            "dilation of at most the friction"
        )


def _built(values: Mapping[str, Any], height: float) -> Soil | FrictionalSoil:
    """Softening refers to a band of known thickness, unless the scene has it follow the cell."""
    frictional = values["cohesion"] is not None
    arguments = {name: value for name, value in values.items() if name not in (OF_CLAY if frictional else OF_FRICTION)}
    length = arguments.pop("softening_length")
    soil: Soil | FrictionalSoil = (FrictionalSoil if frictional else Soil)(**arguments)
    if length is None and height > 0 and soil.softens:
        length = BAND * height
    return replace(soil, softening_length=None if length == "cell" else length)
