"""Where a campaign's samples slide: the shape of the ground, its layers, its water, and the random field of each
layer's strength."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np

from cooperative.measure import Track
from cooperative.scene import tables
from cooperative.scene._soil import LIMITS, RandomField, Span, StrengthByStress, ask, soil_of_layer
from foundation.text import shown
from jaxmpm import (
    AnySoil,
    Discretisation,
    Ground,
    Interface,
    Layer,
    Raster,
    Scene,
    Section,
    Slope,
    State,
    Terrain,
    Thickness,
    ground,
)

DEEPEST_POOL = 10.0
"""Depth of water on the ground up to which it is believed, over the height of the ground above its base."""


@dataclass(frozen=True)
class SiteLayer:
    """A layer of a campaign's ground: its name, its soil with the means of what varies and its lower boundary. random:
    what varies in it, by parameter. rock: whether it is rock, whose strength no load of a slope reaches. own:
    parameters whose field stops at the layer, independent of all others; those of the rest go through all layers."""

    name: str
    layer: Layer
    random: Mapping[str, RandomField]
    rock: bool
    own: tuple[str, ...] = ()

    @property
    def label(self) -> str:
        """Its table, in messages."""
        return f"[{self.name}]" if self.name.startswith("layer ") else f"[layer {shown(self.name)}]"


@dataclass(frozen=True)
class Site:
    """The ground of a campaign. shape: of the ground. ends: what holds its ends, None as its shape has it. layers: from
    the top down; none where all is of the campaign's own soil. water: its level or table, r_u: pore pressure instead,
    see `jaxmpm.section` and `jaxmpm.terrain`. track: along which run-out is measured, None for along the slide. origin:
    where x = 0 and y = 0 lie in the projection of a terrain's surface (m)."""

    shape: Ground
    ends: str | None = None
    layers: tuple[SiteLayer, ...] = ()
    water: float | tuple[tuple[float, float], ...] | Raster | None = None
    r_u: float | None = None
    track: Track | None = None
    origin: tuple[float, ...] = (0.0, 0.0)

    @property
    def projection(self) -> str | None:
        """That of the file of its surface (WKT), None where it has none."""
        return getattr(self.shape, "projection", None)

    def built(self, soil: AnySoil, numerics: Discretisation, gravity: float, *, at_rest: bool) -> tuple[Scene, State]:
        """Scene and initial state on a grid; ValueError where ground, soil and grid do not fit together."""
        # What is unusual was asked about when the scene was read.
        layers = [replace(each, soil=_as_meant(each.soil)) for each in self.soils(soil)]
        loads = {"gravity": gravity, "at_rest": at_rest, "ends": self.ends, "water": self.water, "r_u": self.r_u}
        if self.by_stress(soil) and all(getattr(each.soil, "friction", None) is None for each in layers):
            # Soil in total stress alone: water determines its strength and is no load.
            del loads["water"], loads["r_u"]
        return ground.build_ground(self.shape, layers, numerics, **loads)

    @property
    def height(self) -> float:
        """From the foot of the ground to its top (m)."""
        return ground.relief(self.shape)

    @property
    def fixed_edge(self) -> tuple[tuple[float, float], ...] | None:
        """Corners in plan (m) of the ground, where a polygon is cut out that is fixed along its edge."""
        return getattr(self.shape, "fixed_edge", None)

    def soils(self, soil: AnySoil) -> list[Layer]:
        """Its layers for the solver; one of the campaign's own soil where it has none. Soil whose strength goes with
        the stress at rest has its least strength there."""
        layers = [each.layer for each in self.layers] or [Layer(soil)]
        return [replace(each, soil=_at_least_strength(each.soil)) for each in layers]

    def by_stress(self, soil: Any) -> list[StrengthByStress | None] | None:
        """How the strength of each layer, or of the campaign's own soil, goes with the stress at rest, None for one
        where it does not; None where it does in none."""
        soils: list[Any] = [each.layer.soil for each in self.layers] or [soil]
        found = [None if getattr(each, "strength_ratio", None) is None
                 else StrengthByStress(each.strength_ratio, each.strength_minimum) for each in soils]  # fmt: skip
        return found if any(found) else None

    def pore_pressure(self, points: np.ndarray, stress: np.ndarray) -> np.ndarray:
        """At rest (N,) Pa at points (d, N) m of soil in total stress: r_u times that stress (N,) Pa, or that of water
        up to the table, and no higher than the ground, whose load the water on it adds to both."""
        if self.r_u is not None:
            return self.r_u * stress
        *plan, z = points
        table: Any = self.water
        if isinstance(self.water, Raster):
            table = self.water.at(*plan)
        elif isinstance(self.water, tuple):
            table = np.interp(plan[0], *np.transpose(self.water))
        return ground.WATER_WEIGHT * np.maximum(np.minimum(table, self.shape.heights(*plan)) - z, 0.0)

    def layer_of(self, position: np.ndarray, numerics: Discretisation) -> np.ndarray | None:
        """Number of the layer (N,) in which each point (d, N) m lies, None where there are none."""
        layers = [each.layer for each in self.layers]
        return ground.layer_of(self.shape, layers, position, numerics) if layers else None

    @property
    def thicknesses(self) -> list[Thickness]:
        """That of each layer; none where there are none."""
        layers = [each.layer for each in self.layers]
        return ground.thicknesses(self.shape, layers) if layers else []

    def values_of(self, parameter: str, field: RandomField) -> tuple[RandomField | float, ...]:
        """What a parameter that varies is in each layer: a field, or the number of one in which it does not vary; the
        mean of the field in a layer whose kind of soil has no such parameter."""

        def number(soil: AnySoil) -> float:
            value = getattr(soil, parameter, None)
            return field.mean if value is None else float(value)

        return tuple(each.random.get(parameter) or number(each.layer.soil) for each in self.layers) or (field,)

    def representative(self, soil: AnySoil | None) -> AnySoil:
        """The soil of the whole scene; where it gives none, that of the first layer that softens, or is no rock."""
        if soil is not None:
            return soil
        first = sorted(self.layers, key=lambda each: (each.rock, not getattr(each.layer.soil, "softens", False)))
        return first[0].layer.soil

    def all_random(self, random: Mapping[str, RandomField]) -> Mapping[str, RandomField]:
        """What varies, by parameter in the order of `LIMITS`: of the whole scene, then of the first layer."""
        own = {name: each.random[name] for each in reversed(self.layers) for name in each.own}
        every = {**own, **random}
        return MappingProxyType({name: every[name] for name in LIMITS if name in every})

    def spans(self, parameter: str) -> bool:
        """Whether a parameter that varies has a field that goes through layers: not where every layer in which it
        varies has its own."""
        stops = [parameter in each.own for each in self.layers if parameter in each.random]
        return not stops or not all(stops)

    def box_of(self, number: int) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Lowest corner and edges (d,) m of a box that holds a layer, the same for every grid."""
        return ground.box_of(self.shape, [each.layer for each in self.layers], number)

    @property
    def span(self) -> Span:
        """Elevations of its base and its highest point (m)."""
        base = self.shape.corner[-1]
        return base, base + self.shape.extent[-1]

    def depth(
        self, points: np.ndarray, field: RandomField, layer: int, numerics: Discretisation | None = None
    ) -> np.ndarray:
        """Depth (N,) m of points (d, N) m as the trend of a field counts it, in a layer of this number; 0 above.

        numerics: of the grid on which the layers lie.
        """
        at, top = np.asarray(points, float), np.asarray(field.trend_from)
        if field.trend_from == "layer" and numerics is not None:
            top = ground.top_of(self.shape, [each.layer for each in self.layers], layer, at, numerics)
        elif isinstance(field.trend_from, str):
            top = self.shape.heights(*at[:-1])
        return np.maximum(top - at[-1], 0.0)


def _as_meant(soil: Any) -> AnySoil:
    """The soil, of whose numbers builders need not warn."""
    return replace(soil, unusual=True) if hasattr(soil, "unusual") else soil


def _at_least_strength(soil: Any) -> AnySoil:
    """The soil with its least strength in place of one that goes with the stress at rest."""
    if getattr(soil, "strength_ratio", None) is None:
        return soil
    return replace(soil, strength=soil.strength_minimum, strength_ratio=None, strength_minimum=None)


def check_site(site: Site, soil: AnySoil, cell: float) -> None:
    """Raise ValueError for ground and soil that do not go together.

    A saturated unit weight in ground without a water table, where no soil would have it; a strength that goes with the
    effective stress, in ground of which no water is known; a weak layer too thin for the cells (m) of the refined grid.
    """
    for each in site.soils(soil):
        saturated = getattr(each.soil, "saturated_unit_weight", None)
        if saturated is not None and site.water is None:
            why = (
                "without water in the ground: add [water] with a level, a table, a raster or a depth"
                if site.r_u is None
                else "beside r_u, which knows no water table: let unit_weight be that of soil and its water"
            )
            raise ValueError(f"[soil] saturated_unit_weight = {saturated:g} N/m3 has no say {why}, or leave it out")
    ratios = [each.ratio for each in site.by_stress(soil) or () if each is not None]
    if ratios and site.water is None and site.r_u is None:
        raise ValueError(
            f"[soil] strength_ratio = {ratios[0]:g} without [water], and the effective stress is not known without a "
            f"table: draw the slope as [ground], and add [water] with a level, table, depth or r_u; level = "
            f"{site.span[0]:g}, that of the base, is dry soil"
        )
    for layer, thickness in zip(site.layers, site.thicknesses, strict=True):
        asked = thickness.too_thin(cell)
        if asked is not None and not getattr(layer.layer.soil, "unusual", False):
            raise ValueError(f"{layer.label} {asked} If it is meant as it is, say unusual = true in [soil]")


def site_of(scene: tables.Scene) -> Site:
    """The ground of a scene, without its layers. Raises ValueError for values and lines that will not do."""
    if scene.slope is not None:
        values = dict(scene.slope)
        ends = values.pop("y_ends")
        return Site(Slope(**values), ends)
    return _section(scene, scene.ground) if scene.ground is not None else _terrain(scene, scene.terrain)


def _section(scene: tables.Scene, table: tables.Ground) -> Site:
    values = dict(table)
    surface, ends = _line(scene, "[ground] surface", values.pop("surface")), values.pop("ends")
    contact = None if table.interface is None else Interface(**dict(table.interface))
    if contact is not None and not scene.unusual:
        for name in ("friction", "cohesion"):
            ask(f"[ground.interface] {name}", name, getattr(contact, name))
    shape = Section(**{**values, "surface": surface, "interface": contact})
    try:
        shape.check()
    except ValueError as error:
        raise ValueError(f"[ground] {error}") from error
    return Site(shape, ends, (), *_water(scene, shape))


def _terrain(scene: tables.Scene, table: tables.Terrain | None) -> Site:
    assert table is not None  # a scene has one ground
    walls = {axis: ends for axis, ends in (("x", table.x), ("y", table.y)) if ends is not None}
    if table.cut == "free" and table.polygon is None:
        raise ValueError("[terrain] cut = 'free' has no say without a polygon, a depth is always fixed: leave it out")
    surface = _heights(scene, "[terrain] surface", table.surface)
    shape = Terrain(surface, table.base, **walls, polygon=table.polygon, depth=table.depth, cut=table.cut)
    shape.check()
    origin = (0.0, 0.0) if table.origin is None else table.origin
    return Site(shape, table.ends, (), *_water(scene, shape), _track(table.run_out_line, shape), origin)


def _track(points: tuple[tuple[float, ...], ...] | None, shape: Terrain) -> Track | None:
    """The run-out line, between the walls."""
    if points is None:
        return None
    where = "[terrain] run_out_line"
    for number, point in enumerate(points, 1):
        if len(point) != 2:
            raise ValueError(f"{where}: point {number} is {list(point)}: give [x, y] in metres")
        for axis, at, (low, high) in zip("xy", point, shape.walls, strict=True):
            if not low <= at <= high:
                raise ValueError(
                    f"{where}: point {number} has {axis} = {at:g} m, outside the ground, which reaches from {low:g} to "
                    f"{high:g} m: move it, it goes on straight beyond its ends"
                )
    try:
        return Track(tuple((x, y) for x, y in points))
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from error


def layers_of(scene: tables.Scene, site: Site, random: Mapping[str, RandomField]) -> tuple[SiteLayer, ...]:
    """The layers that a scene draws. What one does not give of its soil is that of the whole scene.

    random: what varies in the soil of the whole scene. Raises ValueError for layers that will not do.
    """
    found = []
    for number, table in enumerate(scene.layer, 1):
        where = f"layer {number}" if table.name is None else f"layer {shown(table.name)}"
        if table.bottom is not None and table.raster is not None:
            raise ValueError(f"[{where}] has both bottom and raster: give one of them")
        bottom = _line(scene, f"[{where}] bottom", table.bottom)
        if table.raster is not None:
            bottom = _heights(scene, f"[{where}] raster", table.raster)
        try:
            soil, varies, own = soil_of_layer(scene, table, random, height=site.height, span=site.span)
        except ValueError as error:
            raise ValueError(f"[{where}]: {error}") from error
        layer = Layer(soil, bottom, table.depth, table.thickness)
        found.append(SiteLayer(table.name or where, layer, varies, table.rock, own))
    return tuple(found)


def _water(scene: tables.Scene, shape: Section | Terrain) -> tuple[Any, float | None]:
    """Level or table of the water, and r_u."""
    if scene.water is None:
        return None, None
    drawn, other, table = ("table", "raster", "ground") if scene.terrain is None else ("raster", "table", "terrain")
    if getattr(scene.water, other) is not None:
        raise ValueError(f"[water] {other} is not for a scene with [{table}]: give level, depth, r_u or {drawn}")
    given = {key: value for key, value in scene.water if value is not None}
    if len(given) != 1:
        raise ValueError(f"[water] has {' and '.join(given) or 'nothing'}: give one of level, depth, r_u and {drawn}")
    ((key, value),) = given.items()
    if key == "r_u":
        return None, value
    water: Any = value
    if key == "table":
        water = _line(scene, "[water] table", value)
    elif key == "raster":
        water = _heights(scene, "[water] raster", value)
    elif key == "depth":
        water = shape.lowered(value)
    if not scene.unusual:
        _ask_of_water(f"[water] {key}", water, shape)
    return water, None


def _ask_of_water(where: str, water: float | Sequence[Sequence[float]] | Raster, shape: Section | Terrain) -> None:
    """Raise ValueError for water that stands wildly above the ground, or below its base everywhere."""
    heights = water.heights if isinstance(water, Raster) else np.atleast_2d(water)[:, -1]
    heights, base, height = heights[np.isfinite(heights)], shape.corner[-1], shape.extent[-1]
    if not heights.size:
        return
    low, high, top = float(heights.min()), float(heights.max()), base + height
    meant = "If it is meant as it is, say unusual = true in [soil]"
    if low - top > DEEPEST_POOL * height:
        raise ValueError(
            f"{where} stands {low - top:g} m above the ground's highest point at {top:g} m, more than {DEEPEST_POOL:g} "
            f"times its height of {height:g} m: were cm or mm meant, or heights from another zero? {meant}"
        )
    if high < base:
        raise ValueError(
            f"{where} lies below the base at {base:g} m everywhere, at {high:g} m and lower, and wets nothing: leave "
            f"[water] out, or give heights from the same zero as those of the ground. {meant}"
        )


def _heights(scene: tables.Scene, where: str, name: str) -> Raster:
    """The raster in a file that was read with the scene."""
    found = scene.files.get(name)
    if not isinstance(found, Raster):
        raise ValueError(f"{where} = {shown(name)} is no file that was read with the scene: run the scene's own file")
    return found


def _line(scene: tables.Scene, where: str, value: Any) -> Any:
    """The points of a line, also of one that is named after a file that was read with the scene."""
    found = scene.files.get(value) if isinstance(value, str) else value
    if isinstance(found, Raster) or (found is None and value is not None):
        raise ValueError(f"{where} = {shown(value)} is no file that was read with the scene: give points [[x, z], ...]")
    return found
