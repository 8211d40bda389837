"""Where a campaign's samples slide: the shape of the ground, its layers, its water, and the random field of each
layer's strength."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from cooperative.measure import Track
from cooperative.scene._rasters import unpacked
from cooperative.scene._schema import OF_A_FIELD, OF_GROUND, SECTIONS, SITES, in_words, read
from cooperative.scene._soil import RandomField, Span, StrengthByStress, ask, rock_of, soil_of
from foundation.text import shown
from jaxmpm import (
    AnySoil,
    Discretisation,
    FrictionalSoil,
    Ground,
    Interface,
    Layer,
    Raster,
    Scene,
    Section,
    Slope,
    Soil,
    State,
    Terrain,
    Thickness,
    ground,
)

MOST_LAYERS = 100

DEEPEST_POOL = 10.0
"""Depth of water on the ground up to which it is believed, over the height of the ground above its base."""


@dataclass(frozen=True)
class SiteLayer:
    """A layer of a campaign's ground: its name, its soil with the means of what varies and its lower boundary, and what
    varies in it, by parameter. rock: whether it is rock, whose strength no load of a slope reaches. own: parameters
    whose field stops at the layer, independent of all others; those of the rest go through all layers."""

    name: str
    layer: Layer
    random: Mapping[str, RandomField]
    rock: bool
    own: tuple[str, ...] = ()


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
            # Soil in total stress alone: water says how strong it is, and loads nothing.
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
        """What a parameter that varies is in each layer: a field, or the number of one in which it does not vary, 0 in
        soil that has none."""
        return tuple(
            each.random.get(parameter) or float(getattr(each.layer.soil, parameter) or 0.0) for each in self.layers
        ) or (field,)

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


def refuse_dry(site: Site, soil: AnySoil) -> None:
    """Raise ValueError for a strength that goes with the effective stress, in ground of which no water is known."""
    ratios = [each.ratio for each in site.by_stress(soil) or () if each is not None]
    if ratios and site.water is None and site.r_u is None:
        raise ValueError(
            f"[soil] strength_ratio = {ratios[0]:g} without [water], and the effective stress is not known without a "
            f"table: draw the slope as [ground], and add [water] with a level, table, depth or r_u; level = "
            f"{site.span[0]:g}, that of the base, is dry soil"
        )


def refuse_saturated(site: Site, soil: AnySoil) -> None:
    """Raise ValueError for a saturated unit weight in ground without a water table, where no soil would have it."""
    for each in site.soils(soil):
        saturated = getattr(each.soil, "saturated_unit_weight", None)
        if saturated is not None and site.water is None:
            why = (
                "without water in the ground: add [water] with a level, a table, a raster or a depth"
                if site.r_u is None
                else "beside r_u, which knows no water table: let unit_weight be that of soil and its water"
            )
            raise ValueError(f"[soil] saturated_unit_weight = {saturated:g} N/m3 has no say {why}, or leave it out")


def ask_of_seams(site: Site, cell: float) -> None:
    """Raise ValueError for a weak layer too thin for the cells (m) of the refined grid."""
    for each, thickness in zip(site.layers, site.thicknesses, strict=True):
        asked = thickness.too_thin(cell)
        if asked is not None and not getattr(each.layer.soil, "unusual", False):
            raise ValueError(f"[{each.name}] {asked} If it is meant as it is, say unusual = true in [soil]")


def refuse_both(tables: Mapping[str, Any]) -> None:
    """Raise ValueError for a scene without ground, with two, or with tables that its ground does not have."""
    given = [name for name in SITES if name in tables]
    if len(given) != 1:
        said = f"has both {' and '.join(f'[{name}]' for name in given)}" if given else "says no ground"
        raise ValueError(f"the scene {said}: give one of {', '.join(f'[{name}]' for name in SITES)}")
    for name in OF_GROUND:
        if name in tables and "slope" in given:
            raise ValueError(f"[{name}] is for a scene with [ground], not with [slope]: draw the slope as a surface")


def site_of(tables: Mapping[str, Any], random: Callable[[Site], Mapping[str, RandomField]]) -> Site:
    """The ground of a scene's tables.

    random: what varies in the soil of the whole scene, once its ground is known. Raises ValueError for keys, values and
    lines that will not do.
    """
    if "slope" in tables:
        said = read("slope", tables["slope"], SECTIONS["slope"])
        ends = said.pop("y_ends")
        return Site(Slope(**said), ends)
    site = _terrain(tables) if "terrain" in tables else _section(tables)
    return replace(site, layers=_layers(tables, site, random))


def _section(tables: Mapping[str, Any]) -> Site:
    said, line = read("ground", tables["ground"], SECTIONS["ground"]), _drawn(tables)
    if said["walls"] is not None and len(said["walls"]) != 2:
        raise ValueError(f"[ground] walls = {shown(said['walls'])}: give two, left and right")
    contact = None if said["interface"] is None else Interface(**said["interface"])
    if contact is not None and not tables["soil"].get("unusual", False):
        for name in ("friction", "cohesion"):
            ask(f"[ground] interface {name}", name, getattr(contact, name))
    surface = line("[ground] surface", said["surface"])
    shape = Section(surface, **{key: said[key] for key in ("base", "walls", "toe", "crest")}, interface=contact)
    try:
        shape.check()
    except ValueError as error:
        raise ValueError(f"[ground] {error}") from error
    return Site(shape, said["ends"], (), *_water(tables, shape))


def _terrain(tables: Mapping[str, Any]) -> Site:
    said = read("terrain", tables["terrain"], SECTIONS["terrain"])
    surface = _heights(tables, "[terrain] surface", said["surface"])
    walls = {axis: said[axis] for axis in "xy" if said[axis] is not None}
    for axis, ends in walls.items():
        if len(ends) != 2:
            raise ValueError(f"[terrain] {axis} = {shown(ends)}: give two walls, low and high")
    if said["step"] is not None and not said["step"] > 0:
        raise ValueError(f"[terrain] step = {said['step']:g}: give metres above 0")
    if said["cut"] == "free" and said["polygon"] is None:
        raise ValueError("[terrain] cut = 'free' has no say without a polygon, a depth is always fixed: leave it out")
    shape = Terrain(surface, said["base"], **walls, **{key: said[key] for key in ("polygon", "depth", "cut")})
    shape.check()
    origin = (0.0, 0.0) if said["origin"] is None else said["origin"]
    if len(origin) != 2:
        raise ValueError(f"[terrain] origin = {shown(origin)}: give x and y")
    return Site(shape, said["ends"], (), *_water(tables, shape), _track(said["run_out_line"], shape), origin)


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


def _layers(
    tables: Mapping[str, Any], site: Site, random: Callable[[Site], Mapping[str, RandomField]]
) -> tuple[SiteLayer, ...]:
    """The layers that a scene draws. What one does not say of its soil is that of the whole scene."""
    found, line = [], _drawn(tables)
    for number, table in enumerate(listed("layer", tables), 1):
        where = f"layer {number}"
        said = read(where, table, SECTIONS["layer"])
        if said["bottom"] is not None and said["raster"] is not None:
            raise ValueError(f"[{where}] has both bottom and raster: give one of them")
        bottom = line(f"[{where}] bottom", said["bottom"])
        if said["raster"] is not None:
            bottom = _heights(tables, f"[{where}] raster", said["raster"])
        try:
            soil, varies = _soil(tables, table, site, random(site), rock=said["rock"])
        except ValueError as error:
            raise ValueError(f"[{where}]: {error}") from error
        layer = Layer(soil, bottom, said["depth"], said["thickness"])
        stops = tuple(name for name in varies if "length" in _of_its_own(table, name))
        found.append(SiteLayer(said["name"] or where, layer, varies, said["rock"], stops))
    return tuple(found)


def _soil(
    tables: Mapping[str, Any], table: Mapping[str, Any], site: Site, random: Mapping[str, RandomField], *, rock: bool
) -> tuple[Soil | FrictionalSoil, Mapping[str, RandomField]]:
    """A layer's soil and what varies in it: its own table over those of the scene."""
    own = {key: value for key, value in table.items() if key in SECTIONS["soil"]}
    whole = {**tables["soil"], **({"strength": tables["strength"]} if "strength" in tables else {})}
    given = {"strength", "strength_ratio"} & own.keys()
    replaced = {"strength", "strength_ratio", "strength_minimum"} - own.keys() if given else set()
    merged = {key: value for key, value in whole.items() if key not in replaced} | own
    for name, value in own.items():
        if isinstance(value, dict) and isinstance(whole.get(name), dict):
            stops = _of_its_own(table, name)
            # Measured values are of one field.
            left_out = ("boreholes", "borehole_error") if stops else ()
            merged[name] = {key: said for key, said in whole[name].items() if key not in left_out} | value
            if stops and "length" not in stops:
                raise ValueError(f"{name} has {stops[0]}, which is of a field of its own: give its length here too")
    if rock:
        if said := [key for key, value in own.items() if isinstance(value, dict)]:
            raise ValueError(f"it is rock, which has no {said[0]} to vary: leave that table out")
        return rock_of(read("soil", merged, SECTIONS["soil"]), height=site.height), {}
    soil, found = soil_of(
        read("soil", merged, SECTIONS["soil"]), merged, None, height=site.height, span=site.span,
        must_vary=False,
    )  # fmt: skip
    for name, field in found.items():
        if name not in random:
            raise ValueError(f"{name} varies, and in [soil] it does not: make it a table there too")
        alike = (field.mean, field.cov, field.marginal) == tuple(
            getattr(random[name], key) for key in ("mean", "cov", "marginal")
        )
        if not alike and not _of_its_own(table, name) and (field.nataf or field.boreholes is not None):
            raise ValueError(
                f"{name} has nataf or boreholes in [soil], which are of one distribution throughout: leave them out, "
                "or give this layer no distribution of its own, or a field of its own by its length"
            )
    return soil, found


def _of_its_own(table: Mapping[str, Any], parameter: str) -> list[str]:
    """What a layer's table says of a parameter that only a field of its own has."""
    said = table.get(parameter)
    return [key for key in OF_A_FIELD if key in said] if isinstance(said, dict) else []


def listed(name: str, tables: Mapping[str, Any]) -> Sequence[Any]:
    """The tables [[name]] of a scene. ValueError for what are none, or too many."""
    found = tables.get(name, [])
    if not isinstance(found, list):
        raise ValueError(f"[{name}] is {in_words(found)}: write [[{name}]], once for each")
    if len(found) > MOST_LAYERS:
        raise ValueError(f"the scene has {len(found)} tables [[{name}]], the limit is {MOST_LAYERS}: give fewer")
    return found


def _water(tables: Mapping[str, Any], shape: Section | Terrain) -> tuple[Any, float | None]:
    """Level or table of the water, and r_u."""
    if "water" not in tables:
        return None, None
    said = read("water", tables["water"], SECTIONS["water"])
    other, table = ("table", "terrain") if "terrain" in tables else ("raster", "ground")
    if said[other] is not None:
        raise ValueError(f"[water] {other} is not for a scene with [{table}]: give level, depth, r_u or "
                         f"{'raster' if other == 'table' else 'table'}")  # fmt: skip
    given = {key: value for key, value in said.items() if value is not None}
    if len(given) != 1:
        raise ValueError(f"[water] has {' and '.join(given) or 'nothing'}: give one of level, depth, r_u and "
                         f"{'raster' if other == 'table' else 'table'}")  # fmt: skip
    ((key, value),) = given.items()
    if key == "r_u":
        if not 0 <= value < 1:
            raise ValueError(f"[water] r_u = {value:g}: give a value of 0 or more and below 1")
        return None, value
    water: Any = value
    if key == "table":
        water = _drawn(tables)("[water] table", value)
    elif key == "raster":
        water = _heights(tables, "[water] raster", value)
    elif key == "depth":
        if value < 0:
            raise ValueError(
                f"[water] depth = {value:g} m: give 0 or more, or a level for water that stands on the ground"
            )
        water = shape.lowered(value)
    if not tables["soil"].get("unusual", False):
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


def _heights(tables: Mapping[str, Any], where: str, name: str) -> Raster:
    """The raster in a file that was read with the scene."""
    kept = tables.get("files", {})
    if not isinstance(kept, dict) or name not in kept:
        raise ValueError(f"{where} = {shown(name)} is no file that was read with the scene: run the scene's own file")
    return unpacked(where, kept[name])


def _drawn(tables: Mapping[str, Any]) -> Callable[[str, Any], Any]:
    """Gives a line its points, where it is named after a file that was read with the scene."""

    def line(where: str, value: Any) -> Any:
        if not isinstance(value, str):
            return value
        files = tables.get("files", {})
        if not isinstance(files, dict) or value not in files:
            raise ValueError(
                f"{where} = {shown(value)} is no file that was read with the scene: give points [[x, z], ...]"
            )
        return read("files", {"points": files[value]}, {"points": SECTIONS["ground"]["surface"]})["points"]

    return line
