"""Where a campaign's samples slide: the ground, its layers, its water, and the random fields of layers."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from cooperative.measure import Track
from cooperative.scene.tables import CONTACT, LIMITS, RandomField, RandomLevel, Span, Surface, Water
from jaxmpm import Discretisation, Ground, Layer, Scene, State, ground
from jaxmpm.ground import Thickness
from jaxmpm.soil import AnySoil
from jaxmpm.support.check import Invalid
from jaxmpm.support.text import shown
from jaxmpm.support.values import by_value

if TYPE_CHECKING:
    from cooperative.scene._flow import Resting


class StrengthByStress(NamedTuple):
    """Undrained strength as a ratio of the effective vertical stress at rest, of `minimum` (Pa) at least."""

    ratio: float
    minimum: float


@by_value
@dataclass(frozen=True)
class SiteLayer:
    """A layer of a campaign's ground: its name, its soil with the means of what varies and its lower boundary.

    Args:
        name: of the layer.
        layer: its soil with the means of what varies, and its lower boundary.
        random: what varies in it, by parameter.
        rock: whether it is rock, whose strength no load of a slope reaches.
        stopping: parameters whose field stops at the layer, independent of all others; those of the rest go through all
            layers.
        top: elevation (m), or points (x, z) m, of its top before a cut, None for its top as drawn.
    """

    name: str
    layer: Layer
    random: Mapping[str, RandomField]
    rock: bool
    stopping: tuple[str, ...] = ()
    top: float | tuple[tuple[float, float], ...] | None = None

    def before(self, x: np.ndarray) -> np.ndarray | None:
        """Height (n,) m of its top before a cut at x (n,) m; None where that is its top as drawn."""
        if self.top is None:
            return None
        return (
            np.full(np.shape(x), self.top) if isinstance(self.top, int | float) else np.interp(x, *np.array(self.top).T)
        )

    @property
    def label(self) -> str:
        """Its name in messages."""
        return self.name if self.unnamed else f"layer {shown(self.name)}"

    @property
    def unnamed(self) -> bool:
        """Whether its name is its number."""
        return self.name.startswith("layer ")


@by_value
@dataclass(frozen=True)
class Site:
    """The ground of a campaign.

    Args:
        shape: of the ground.
        ends: what holds its ends, None as its shape has it.
        layers: from the top down; none where all is of the campaign's own soil.
        water: in the ground and above it, None for none.
        track: along which run-out is measured, None for along the slide.
        origin: where x = 0 and y = 0 lie in the projection of a terrain's surface (m).
        contact_of_soil: which of friction and cohesion its interface has from the soil that lies on it.
        pressure: pore pressure at the time at which the ground rests, None where water does not move.
    """

    shape: Ground
    ends: str | None = None
    layers: tuple[SiteLayer, ...] = ()
    water: Water | None = None
    track: Track | None = None
    origin: tuple[float, ...] = (0.0, 0.0)
    contact_of_soil: tuple[str, ...] = ()
    pressure: Resting | None = None

    @cached_property
    def water_table(self) -> Surface | None:
        """Its level (m), points (x, z) m or heights (m), at the mean of a random level; None without."""
        return None if self.water is None else self.water.surface(self.shape)

    @property
    def r_u(self) -> float | None:
        """Ratio of the pore pressure to the overburden, in place of a water table."""
        return None if self.water is None else self.water.r_u

    @property
    def level(self) -> RandomLevel | None:
        """Distribution of the water's level; None where samples do not differ in it."""
        return None if self.water is None else self.water.random

    @property
    def projection(self) -> str | None:
        """That of the file of its surface (WKT), None where it has none."""
        return getattr(self.shape, "projection", None)

    def built(
        self, soil: AnySoil, numerics: Discretisation, gravity: float, *, at_rest: bool, **loads: object
    ) -> tuple[Scene, State]:
        """Scene and initial state on a grid.

        Args:
            soil: of the campaign.
            numerics: of the grid.
            gravity: downwards (m/s2).
            at_rest: whether the stress at rest is solved for.
            **loads: k_h, k_v and motion, None for what is absent.

        Raises:
            ValueError: ground, soil and grid do not fit together.
        """
        # What is unusual was asked about when the scene was read.
        layers = [replace(layer, soil=_without_warnings(layer.soil)) for layer in self.soils(soil)]
        frictional = any(has_friction(layer.soil) for layer in layers)
        # Without friction it determines the strength, and is no load on soil in total stress.
        r_u = self.r_u if frictional or not self.by_stress(soil) else None
        moving = self.pressure
        scene, state = ground.build_ground(
            self.shape, layers, numerics, gravity=gravity, at_rest=at_rest, ends=self.ends, r_u=r_u,
            water=self.water_table if moving is None else moving.level, **loads,
        )  # fmt: skip
        return (scene if moving is None else moving.on(scene, self, numerics)), state

    @property
    def _bare(self) -> list[Layer]:
        """Its layers as the solver has them."""
        return [replace(layer.layer, name=None if layer.unnamed else layer.name) for layer in self.layers]

    @property
    def height(self) -> float:
        """From the foot of the ground to its top (m)."""
        return ground.relief(self.shape)

    @property
    def fixed_edge(self) -> tuple[tuple[float, float], ...] | None:
        """Corners in plan (m) of the ground, where a polygon is cut out that is fixed along its edge."""
        return getattr(self.shape, "fixed_edge", None)

    def soils(self, soil: AnySoil) -> list[Layer]:
        """Its layers for the solver; one of the campaign's own soil where it has none.

        Soil whose strength goes with the stress at rest has its least strength there.
        """
        return [replace(layer, soil=_at_least_strength(layer.soil)) for layer in self._bare or [Layer(soil)]]

    def softens_linearly(self, soil: AnySoil) -> bool:
        """Whether all soil loses strength in proportion to plastic strain, that of layers or the campaign's own."""
        soils = [layer.soil for layer in self._bare or [Layer(soil)]]
        return all(getattr(part, "softening_modulus", None) is not None for part in soils)

    def by_stress(self, soil: AnySoil | None) -> list[StrengthByStress | None] | None:
        """How the strength of each layer, or of the campaign's own soil, goes with the stress at rest.

        None stands for a layer where it does not; the whole is None where it does in none.
        """
        soils: list[AnySoil | None] = [part.layer.soil for part in self.layers] or [soil]
        numbers = [(getattr(part, "strength_ratio", None), getattr(part, "strength_minimum", 0.0)) for part in soils]
        ratios = [None if ratio is None else StrengthByStress(ratio, minimum) for ratio, minimum in numbers]
        return ratios if any(ratios) else None

    def layer_of(self, position: np.ndarray, numerics: Discretisation) -> np.ndarray | None:
        """Number of the layer (N,) in which each point (d, N) m lies, None where there are none."""
        return ground.layer_of(self.shape, self._bare, position, numerics) if self.layers else None

    @property
    def thicknesses(self) -> list[Thickness]:
        """That of each layer; none where there are none."""
        return ground.thicknesses(self.shape, self._bare) if self.layers else []

    def values_of(self, parameter: str, field: RandomField) -> tuple[RandomField | float, ...]:
        """What a parameter that varies is in each layer.

        A field, also that of an interface, or the number of a layer in which it does not vary; the mean of the field in
        a layer whose kind of soil has no such parameter, and nan in one without a k0, which elastic loading gives it.
        """
        if parameter in CONTACT:
            return (field,) * max(len(self.layers), 1)

        def number(soil: AnySoil) -> float:
            value = getattr(soil, parameter, None)
            return (math.nan if parameter == "k0" else field.mean) if value is None else float(value)

        return tuple(layer.random.get(parameter) or number(layer.layer.soil) for layer in self.layers) or (field,)

    def representative(self, soil: AnySoil | None) -> AnySoil:
        """The soil of the whole scene; where it gives none, that of the first layer that softens, or is no rock."""
        if soil is not None:
            return soil
        first = sorted(self.layers, key=lambda layer: (layer.rock, not getattr(layer.layer.soil, "softens", False)))
        return first[0].layer.soil

    def all_random(self, random: Mapping[str, RandomField]) -> Mapping[str, RandomField]:
        """What varies, by parameter in the order of `LIMITS`: of the whole scene, then of the first layer."""
        stopped = {name: layer.random[name] for layer in reversed(self.layers) for name in layer.stopping}
        every = {**stopped, **random}
        return {name: every[name] for name in LIMITS if name in every}

    def spans(self, parameter: str) -> bool:
        """Whether a parameter that varies has a field that goes through layers.

        It has none where every layer in which it varies has its own.
        """
        stops = [parameter in layer.stopping for layer in self.layers if parameter in layer.random]
        return not stops or not all(stops)

    def box_of(self, number: int) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Lowest corner and edges (d,) m of a box that holds a layer, the same for every grid."""
        return ground.box_of(self.shape, self._bare, number)

    @property
    def span(self) -> Span:
        """Elevations of its base and its highest point (m)."""
        base = self.shape.corner[-1]
        return base, base + self.shape.extent[-1]

    def depth(
        self, points: np.ndarray, field: RandomField, layer: int, numerics: Discretisation | None = None
    ) -> np.ndarray:
        """Depth (N,) m of points (d, N) m as the trend of a field counts it, in a layer of this number; 0 above.

        Args:
            points: (d, N) m.
            field: whose trend counts.
            layer: its number.
            numerics: of the grid on which the layers lie.
        """
        at, top = np.asarray(points, float), np.asarray(field.trend_from)
        before = self.layers[layer].before(at[0]) if self.layers and field.trend_from == "layer" else None
        if before is not None:
            top = before
        elif field.trend_from == "layer" and numerics is not None:
            top = ground.top_of(self.shape, self._bare, layer, at, numerics)
        elif isinstance(field.trend_from, str):
            top = self.shape.heights(*at[:-1])
        return np.maximum(top - at[-1], 0.0)


def has_friction(soil: AnySoil) -> bool:
    """Whether strength grows with the effective stress: by friction, or by that of a critical state or of grains."""
    return any(getattr(soil, name, None) is not None for name in ("friction", "critical_state", "static_friction"))


def _without_warnings(soil: AnySoil) -> AnySoil:
    """The soil, of whose numbers builders need not warn."""
    return replace(soil, unusual=True) if hasattr(soil, "unusual") else soil


def _at_least_strength(soil: AnySoil) -> AnySoil:
    """The soil with its least strength in place of one that goes with the stress at rest."""
    if getattr(soil, "strength_ratio", None) is None or not hasattr(soil, "strength_minimum"):
        return soil
    return replace(soil, strength=soil.strength_minimum, strength_ratio=None, strength_minimum=None)


def check_site(site: Site, soil: AnySoil, *, moves: bool = False) -> None:
    """Raise ValueError for ground and soil that do not go together.

    moves: whether water does.

    A saturated unit weight in ground without a water table, where no soil would have it; a B-value or a strength that
    goes with the effective stress, in ground of which no water is known.
    """
    for layer in site.soils(soil):
        saturated = getattr(layer.soil, "saturated_unit_weight", None)
        if saturated is not None and site.water_table is None and not moves:
            why, remedy = (
                ("without water in the ground", "give the water's level, table, raster or depth")
                if site.r_u is None
                else ("beside r_u, which has no water table", "let unit_weight be that of soil and its water")
            )
            rule, remedy = f"has no effect {why}", f"{remedy}, or leave it out"
            raise Invalid(("saturated_unit_weight",), f"{saturated:g} N/m3", rule, remedy)
        b_value = getattr(layer.soil, "b_value", None)
        if b_value is not None and site.water is None and not moves:
            raise Invalid(
                ("b_value",), f"{b_value:g}", "has no effect without water in the ground",
                "give the water's level, table, raster, depth or r_u, or leave it out",
            )  # fmt: skip
    ratios = [part.ratio for part in site.by_stress(soil) or () if part is not None]
    if ratios and site.water is None:
        raise Invalid(
            ("strength_ratio",), f"{ratios[0]:g}",
            "without water in the ground, whose table the effective stress depends on",
            "draw the slope as a section, and give water a level, table or depth, or r_u; level = "
            f"{site.span[0]:g}, that of the base, is dry soil",
        )  # fmt: skip
