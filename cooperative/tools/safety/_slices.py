"""Slip surfaces in slices: many at once, by the methods of Spencer, Bishop and Janbu.

All slices of a set of surfaces are one array (surfaces, slices), so that a set takes as long as a few surfaces.

Sources: Spencer (1967), 10.1680/geot.1967.17.1.11; Bishop (1955), 10.1680/geot.1955.5.1.7; Janbu (1973), Slope
stability computations, in Embankment-dam Engineering.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from itertools import pairwise
from typing import Literal, TypedDict, Unpack

import numpy as np
import shapely

from cooperative.tools.safety._moving import MovingWater
from jaxmpm import Layer, Section, Soil
from jaxmpm.ground import WATER_WEIGHT
from jaxmpm.soil import STANDARD_GRAVITY
from jaxmpm.support.values import by_value

ROUNDING = 1e-6
"""Distance within which points of a line are one (m)."""
DRIVING = 0.01
"""Least driving force over the weight: below it a surface lies under level ground."""
IN_TENSION = 0.25
"""Largest share of a surface whose base is in tension, of a factor that is admissible."""
SHALLOWEST = 0.05
"""Least thickness of a sliding mass, over the height of the ground or the thickness of its soil."""
THIN = 0.25
"""Thickness over the height of the ground up to which a layer is a seam that surfaces follow."""
NARROWED = 0.9
"""Of the widths of slices: from 0, all alike, to 1, on a semicircle of one length."""
ABOVE = 1e-3
"""Largest height of a surface above the ground, by rounding, over the height of the ground."""
MOST_KINKS = 24
"""Kinks of the ground at which slices end; lines of more are simplified."""
IN_ROCK = 0.1
"""Largest share of a base that lies in rock, by rounding."""
LEAST_ARM = 0.1
"""Least factor by which friction turns a force at a base into one along it; below it a method has no answer there."""
ROUNDS = 60
"""Of an iteration that has not converged."""
CONVERGED = 1e-5
"""Share within which a factor of safety is iterated."""
STARTS = (0.6, 0.1, 1.2)
"""Inclinations of the interslice forces from which Spencer's method is solved, over that of the surface's chord."""
STEEPEST_FORCE = math.radians(75.0)
"""Largest inclination of interslice forces to the horizontal."""

Method = Literal["spencer", "bishop", "janbu"]
Strength = Callable[[np.ndarray, np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
"""Cohesion (n,) Pa and friction angle (n,) degrees at x, z (n,) m in layers of these numbers (n,); nan for those of the
layer."""


def zones(shape: Section, layers: Sequence[Layer]) -> Iterator[tuple[int, shapely.Polygon]]:
    """The ground as polygons, each with the number of its layer.

    Args:
        shape: outline of the section.
        layers: from the top down.

    Yields:
        Number of the layer, from 0, and a polygon (m).

    Raises:
        ValueError: a line is invalid or crosses another.
    """
    x, heights = shape.boundaries(layers)
    for number, (top, bottom) in enumerate(pairwise(heights)):
        ring = np.concatenate([np.stack([x, top], axis=1), np.stack([x, bottom], axis=1)[::-1]])
        # Ground down at the base has no area: buffer(0) leaves it out.
        zone = shapely.set_precision(shapely.Polygon(ring).buffer(0), ROUNDING).simplify(ROUNDING)
        for piece in shapely.get_parts(zone):
            if piece.area > ROUNDING:
                yield number, piece


def _strength_of(layer: Layer) -> tuple[float, float]:
    """Cohesion (Pa) and friction angle (degrees) of a layer; ValueError for soil that has neither."""
    soil = layer.soil
    if isinstance(soil, Soil):
        return float(soil.strength or 0.0), 0.0
    if hasattr(soil, "cohesion") and hasattr(soil, "friction"):
        return float(soil.cohesion), float(soil.friction)
    raise ValueError(
        f"limit equilibrium is for soil with a strength, or cohesion and friction, not for {type(soil).__name__}, "
        "whose strength depends on stress history, direction or rate: the solver's limit load stands alone"
    )


class Conditions(TypedDict, total=False):
    """What acts on the layers of a section, and which of them are rock; nothing where it is left out.

    Args:
        water: level or points (x, z) of the water table (m).
        r_u: pore pressure over the weight of the soil above.
        k_h: pseudo-static horizontal acceleration over gravity, as `jaxmpm.section`.
        k_v: vertical one, upwards, by which soil weighs less; the horizontal force does not.
        rock: numbers of the layers that are rock.
        gravity: downwards (m/s2), by default standard gravity.
        moving: pressure and weight of water that moves; `water` is then its pool.
    """

    water: float | Sequence[Sequence[float]] | None
    r_u: float | None
    k_h: float
    k_v: float
    rock: Sequence[int]
    gravity: float
    moving: MovingWater | None


@dataclass(frozen=True)
class Circle:
    """A circular slip surface, which follows rigid ground where it would cut below it.

    Args:
        x: of its centre (m).
        z: of its centre (m).
        radius: of it (m).
    """

    x: float
    z: float
    radius: float


@by_value
@dataclass(frozen=True)
class Slip:
    """A slip surface and its factor of safety.

    Args:
        factor: of safety.
        points: of the surface (n, 2) m, x rising.
        circle: of which it is a part, None for another shape.
        thickness: largest of the mass above it (m).
        area: of that mass (m2).
        method: that gave the factor.
        on_rigid: share of its length that follows rigid ground.
        pulled: whether more of its base with friction than IN_TENSION would have to be in tension.
        tension: share of its length whose base would have to be in tension.
    """

    factor: float
    points: np.ndarray
    circle: Circle | None
    thickness: float
    area: float
    method: Method = "spencer"
    on_rigid: float = 0.0
    pulled: bool = False
    tension: float = 0.0

    def mirrored(self) -> Slip:
        """Its mirror image about x = 0."""
        circle = None if self.circle is None else replace(self.circle, x=-self.circle.x)
        return replace(self, points=(self.points * [-1, 1])[::-1], circle=circle)


@dataclass(frozen=True)
class Surfaces:
    """Slip surfaces between ends on the ground.

    Args:
        x: edges of their slices (surfaces, slices + 1) m, rising.
        z: height of the surface there (m); where it is below rigid ground, the surface follows that.
        centres: of circles (surfaces, 2) m, for Bishop's moments; None for other shapes.
    """

    x: np.ndarray
    z: np.ndarray
    centres: np.ndarray | None = None


@dataclass(frozen=True)
class _Bodies:
    """What acts on slices (surfaces, slices), in a frame in which each surface slides towards +x; per metre of width.

    Args:
        x: of the middles of their bases (m).
        z: of these (m).
        sine: of the angle by which a base falls.
        cosine: of it.
        length: of a base (m).
        down: vertical force (N/m).
        along: horizontal force (N/m).
        overturning: moment of the horizontal force about the middle of the base, towards +x (N m/m).
        cohesion: force (N/m).
        tangent: of the friction angle.
        buoyant: force of the pore pressure on the base (N/m).
        chord: angle by which each surface falls from end to end (surfaces,).
        valid: whether a mass slides on each surface.
        thickness: largest of each (m).
        area: of each (m2).
        on_rigid: share of each surface's length that follows rigid ground.
        tension: largest share of each whose base is in tension where it has friction.
    """

    x: np.ndarray
    z: np.ndarray
    sine: np.ndarray
    cosine: np.ndarray
    length: np.ndarray
    down: np.ndarray
    along: np.ndarray
    overturning: np.ndarray
    cohesion: np.ndarray
    tangent: np.ndarray
    buoyant: np.ndarray
    chord: np.ndarray
    valid: np.ndarray
    thickness: np.ndarray
    area: np.ndarray
    on_rigid: np.ndarray
    tension: np.ndarray

    def of(self, which: np.ndarray) -> _Bodies:
        """Those of some surfaces."""
        return _Bodies(**{part.name: getattr(self, part.name)[which] for part in fields(self)})

    @cached_property
    def pressed(self) -> np.ndarray:
        """Effective force on each base across it, without shear between slices (N/m)."""
        return self.down * self.cosine - self.along * self.sine - self.buoyant

    @cached_property
    def driving(self) -> np.ndarray:
        """Force along each base, downwards (N/m)."""
        return self.down * self.sine + self.along * self.cosine

    @cached_property
    def strength(self) -> np.ndarray:
        """Resistance of each base so pressed (N/m)."""
        return self.cohesion + self.pressed * self.tangent

    def stretched(self, factors: np.ndarray) -> np.ndarray:
        """Share (surfaces,) of each surface whose base is in tension, without shear between slices."""
        shear = self.cohesion * self.sine / factors[:, None]
        pulls = self.down - self.buoyant * self.cosine - shear < 0
        return (self.length * pulls).sum(axis=1) / np.maximum(self.length.sum(axis=1), 1e-12)

    def in_tension(self, normal: np.ndarray) -> np.ndarray:
        """Whether too much of each surface would have to pull at its mass, with such effective forces (N/m)."""
        share = (self.length * (normal < 0) * (self.tangent > 0)).sum(axis=1) / self.length.sum(axis=1)
        return share > self.tension


@by_value
@dataclass(frozen=True)
class Slices:
    """A section, ready for slip surfaces.

    Args:
        x: points of its lines (n,) m.
        heights: of the surface, the lower boundaries of the layers and rigid ground (layers + 1, n) m.
        floor: height below which no surface goes (n,) m: rigid ground, or the top of rock on it.
        weights: unit weight of each layer above and below the water (layers, 2) N/m3.
        strengths: cohesion (Pa) and friction angle (degrees) of each layer (layers, 2).
        rock: whether each layer is rock.
        seams: lines (m, 2) m that surfaces may follow.
        contact: cohesion (Pa) and friction angle (degrees) on rigid ground, None for those of the soil.
        water: points (m, 2) m of the water table, None without.
        water_weight: of the water (N/m3).
        r_u: pore pressure over the weight of the soil above, None without.
        pull: horizontal force towards +x over the weight.
        lift: upward force over the weight.
        strength: at the bases of slices, None for that of the layers.
        slices: that a surface has, about.
        tension: largest share of a surface whose base is in tension where it has friction.
        kinks: x (k,) m at which slices end.
        moving: pressure and weight of water that moves, None where it rests.
    """

    x: np.ndarray
    heights: np.ndarray
    floor: np.ndarray
    weights: np.ndarray
    strengths: np.ndarray
    rock: np.ndarray
    seams: tuple[np.ndarray, ...] = ()
    contact: tuple[float, float] | None = None
    water: np.ndarray | None = None
    water_weight: float = WATER_WEIGHT
    r_u: float | None = None
    pull: float = 0.0
    lift: float = 0.0
    strength: Strength | None = None
    slices: int = 64
    tension: float = IN_TENSION
    kinks: np.ndarray = field(default_factory=lambda: np.zeros(0))
    moving: MovingWater | None = None

    @classmethod
    def of(
        cls,
        shape: Section,
        layers: Sequence[Layer],
        *,
        strength: Strength | None = None,
        **conditions: Unpack[Conditions],
    ) -> Slices:
        """A section in slices.

        Args:
            shape: outline.
            layers: from the top down, of undrained soil or soil with friction.
            strength: at the bases of slices, None for that of the layers.
            **conditions: as in `Conditions`.

        Raises:
            ValueError: soil or lines of the section will not do.
        """
        rock = np.isin(np.arange(len(layers)), list(conditions.get("rock", ())))
        heavier = conditions.get("gravity", STANDARD_GRAVITY) / STANDARD_GRAVITY
        x, heights = shape.boundaries(layers)
        floor = heights[-1]
        for number in reversed(range(len(layers))):
            bare = floor >= heights[number + 1] - ROUNDING
            floor = np.where(bare & (rock[number] | (heights[number] < floor)), heights[number], floor)
        water = conditions.get("water")
        if isinstance(water, int | float):
            water = [(wall, water) for wall in shape.outline().walls]
        weights = [[layer.soil.unit_weight, getattr(layer.soil, "saturated_unit_weight", None)] for layer in layers]
        contact = shape.interface
        lines = [np.stack([x, heights[0]], axis=1), np.stack([x, floor], axis=1)]
        lines += [] if water is None else [np.asarray(water, float)]
        return cls(
            x, heights, floor,
            weights=heavier * np.array([[dry, dry if wet is None else wet] for dry, wet in weights], float),
            strengths=np.array([_strength_of(layer) for layer in layers], float),
            rock=rock,
            seams=tuple(_seams(shape, layers, x, heights, floor, rock)),
            contact=None if contact is None else (float(contact.cohesion), float(contact.friction)),
            water=None if water is None else np.asarray(water, float),
            water_weight=WATER_WEIGHT * heavier,
            r_u=conditions.get("r_u"),
            pull=shape.downhill * conditions.get("k_h", 0.0),
            lift=conditions.get("k_v", 0.0),
            strength=strength,
            kinks=_kinks(lines, float(np.ptp(heights[0]))),
            moving=conditions.get("moving"),
        )  # fmt: skip

    @cached_property
    def along(self) -> np.ndarray:
        """Distance along the ground of the points of the lines (n,) m."""
        steps = np.hypot(np.diff(self.x), np.diff(self.heights[0]))
        return np.concatenate([[0.0], np.cumsum(steps)])

    @property
    def relief(self) -> float:
        """Height of the ground's highest point above its lowest (m)."""
        return float(np.ptp(self.heights[0]))

    @property
    def scale(self) -> float:
        """The height of the ground, or the thickness of its soil where that is less (m)."""
        return min(self.relief, float((self.heights[0] - self.floor).max()))

    @property
    def frictional(self) -> bool:
        """Whether soil has friction somewhere."""
        return bool((self.strengths[~self.rock, 1] > 0).any()) or bool(self.contact and self.contact[1] > 0)

    def mirrored(self) -> Slices:
        """Its mirror image about x = 0."""
        strength = self.strength
        return replace(
            self,
            x=-self.x[::-1],
            heights=self.heights[:, ::-1],
            floor=self.floor[::-1],
            seams=tuple((seam * [-1, 1])[::-1] for seam in self.seams),
            water=None if self.water is None else (self.water * [-1, 1])[::-1],
            pull=-self.pull,
            kinks=-self.kinks,
            moving=None if self.moving is None else self.moving.mirrored(),
            strength=None if strength is None else lambda x, z, layer: strength(-x, z, layer),
        )

    def ground(self, x: np.ndarray) -> np.ndarray:
        """Height (...) m of the ground at x (...) m."""
        return np.interp(x, self.x, self.heights[0])

    def rigid(self, x: np.ndarray) -> np.ndarray:
        """Height (...) m below which no surface goes at x (...) m."""
        return np.interp(x, self.x, self.floor)

    def edges(self, first: np.ndarray, last: np.ndarray, vertices: np.ndarray | None = None) -> np.ndarray:
        """Edges (surfaces, edges) m of slices between such ends (surfaces,) m, some of no width.

        vertices: x of the surfaces' own (surfaces, vertices) m, which are edges, too.

        Slices are narrower towards the ends, where circles are steep. Kinks of the ground, of rigid ground and of the
        water table are edges, so that no slice has two slopes of them.
        """
        share = np.linspace(0, 1, self.slices + 1)
        share = (1 - NARROWED) * share + NARROWED * (1 - np.cos(math.pi * share)) / 2
        even = first[:, None] + (last - first)[:, None] * share
        others = np.broadcast_to(self.kinks, (len(first), self.kinks.size))
        others = others if vertices is None else np.concatenate([others, vertices], axis=1)
        return np.sort(np.concatenate([even, np.clip(others, first[:, None], last[:, None])], axis=1), axis=1)

    def circles(self, ends: np.ndarray, centres: np.ndarray, radii: np.ndarray) -> Surfaces:
        """Surfaces on circles.

        Args:
            ends: x of their ends on the ground (surfaces, 2) m.
            centres: (surfaces, 2) m.
            radii: (surfaces,) m.
        """
        x = self.edges(*ends.T)
        reach = np.maximum(radii[:, None] ** 2 - (x - centres[:, :1]) ** 2, 0)
        return Surfaces(x, centres[:, 1:] - np.sqrt(reach), centres)

    def slip(self, surface: Circle | np.ndarray, method: Method = "spencer") -> Slip | None:
        """The factor of safety of a slip surface.

        Args:
            surface: a circle, or points (n, 2) m with x rising, both ends on the ground.
            method: Spencer's, Bishop's simplified one of circles, or Janbu's with his correction.

        Returns:
            The surface and its factor, None where no mass slides on it or the method has no admissible answer.
        """
        if isinstance(surface, Circle):
            ends = self._ends_of(surface)
            if ends is None:
                return None
            surfaces = self.circles(ends[None], np.array([[surface.x, surface.z]]), np.array([surface.radius]))
        else:
            vertices = surface[None, 1:-1, 0] if len(surface) < MOST_KINKS else None
            x = self.edges(surface[:1, 0], surface[-1:, 0], vertices)
            surfaces = Surfaces(x, np.interp(x, *surface.T))
        [slip] = self.slips(surfaces, method)
        if slip is None or not isinstance(surface, Circle):
            return slip
        return replace(slip, circle=surface)

    def _ends_of(self, circle: Circle) -> np.ndarray | None:
        """Ends (2,) m on the ground of the longest part of a circle's lower half that lies in the ground."""
        left, right = max(circle.x - circle.radius, self.x[0]), min(circle.x + circle.radius, self.x[-1])
        x = np.linspace(left, right, 4001)
        arc = circle.z - np.sqrt(np.maximum(circle.radius**2 - (x - circle.x) ** 2, 0))
        inside = np.r_[False, arc < self.ground(x), False].astype(int)
        begins, stops = np.flatnonzero(np.diff(inside) == 1), np.flatnonzero(np.diff(inside) == -1) - 1
        if not begins.size:
            return None
        longest = int(np.argmax(stops - begins))
        return x[[max(begins[longest] - 1, 0), min(stops[longest] + 1, x.size - 1)]]

    def slips(self, surfaces: Surfaces, method: Method) -> list[Slip | None]:
        """Each surface with its factor of safety, None where it has none."""
        bodies = self._bodies(surfaces)
        factors = _solve(bodies, surfaces, method)
        floored = np.maximum(surfaces.z, self.rigid(surfaces.x))
        tension = bodies.stretched(factors)
        return [
            Slip(
                float(factor), np.stack([x, z], axis=1), None, float(bodies.thickness[k]), float(bodies.area[k]),
                method, float(bodies.on_rigid[k]), tension=float(tension[k]),
            )
            if math.isfinite(factor) else None
            for k, (factor, x, z) in enumerate(zip(factors, surfaces.x, floored, strict=True))
        ]  # fmt: skip

    def factors(self, surfaces: Surfaces, method: Method) -> np.ndarray:
        """Factors of safety (surfaces,); infinite where a surface has none."""
        return _solve(self._bodies(surfaces), surfaces, method)

    def _bodies(self, surfaces: Surfaces) -> _Bodies:
        """The slices of surfaces, and what acts on them."""
        clearance = surfaces.z - self.rigid(surfaces.x)
        line = surfaces.z + np.maximum(-clearance, 0)
        x, z = (surfaces.x[:, 1:] + surfaces.x[:, :-1]) / 2, (line[:, 1:] + line[:, :-1]) / 2
        width, rise = np.diff(surfaces.x), np.diff(line)
        tops = [np.interp(x, self.x, height) for height in self.heights]
        # Where a surface is above the ground, or on it, nothing slides.
        depth = tops[0] - z
        there = (depth > ROUNDING) & (width > 0)
        table = None if self.water is None else np.interp(x, *self.water.T)
        weight, moment = self._weight(z, tops, table)
        if self.moving is not None:
            borne, weight, moment = self.moving.at(x, z)
        weight, moment = weight * width, moment * width
        rows, first = np.arange(len(x)), there.argmax(axis=1)
        last = there.shape[1] - 1 - there[:, ::-1].argmax(axis=1)
        place = np.arange(there.shape[1])
        inside = (place >= first[:, None]) & (place <= last[:, None])
        one = there.any(axis=1) & ~(inside & ~there & (width > 0)).any(axis=1)
        one &= ~((depth < -ABOVE * self.scale) & (width > 0)).any(axis=1)
        falls = np.where(line[rows, first] >= line[rows, last + 1], 1.0, -1.0)[:, None]
        down, along = weight * (1 - self.lift), self.pull * weight
        overturning = self.pull * (moment - weight * z)
        pore = np.zeros_like(z) if self.r_u is None else self.r_u * weight / np.where(width > 0, width, 1)
        if table is not None:
            pore = self.water_weight * np.maximum(table - z, 0)
            # A pool bears on the ground below it.
            pool = self.water_weight * np.maximum(table - tops[0], 0)
            push = pool * np.diff(self.ground(surfaces.x))
            down, along = down + pool * width, along + push
            overturning = overturning + push * depth
        if self.moving is not None:
            pore = borne
        length = np.hypot(width, rise)
        lies = _lies_in(tops, z, np.abs(rise), ROUNDING + 1e-4 * self.relief)
        cohesion, tangent = self._strength_at(x, z, lies, there)
        on_floor = _below(clearance - ROUNDING)
        if self.contact is not None:
            # Rock that does not yield has no contact of its own.
            share = on_floor * (self.rigid(x) <= tops[-1] + ROUNDING)
            cohesion, tangent = (
                share * of_contact + (1 - share) * soil
                for of_contact, soil in zip(
                    (self.contact[0], math.tan(math.radians(self.contact[1]))), (cohesion, tangent), strict=True
                )
            )
        covered = np.where(there, length, 0.0)
        total = covered.sum(axis=1)
        thick = np.where(there, depth, 0)
        thickness = thick.max(axis=1)
        gravity = np.where(there, down, 0)
        driving = np.abs((gravity * rise / np.where(length > 0, length, 1)).sum(axis=1)) / np.maximum(
            gravity.sum(axis=1), 1e-12
        )
        valid = one & (driving + abs(self.pull) > DRIVING) & (thickness > SHALLOWEST * self.scale)
        # No surface cuts through rock.
        valid &= ~((lies[self.rock].sum(axis=0) > IN_ROCK) & there & (on_floor < 1 - IN_ROCK)).any(axis=1)
        arc = np.where(length > 0, length, 1)
        return _Bodies(
            x=falls * x, z=z, sine=-falls * rise / arc, cosine=np.where(length > 0, width / arc, 1.0),
            length=covered, down=gravity, along=np.where(there, falls * along, 0),
            overturning=np.where(there, falls * overturning, 0), cohesion=cohesion * covered,
            tangent=np.where(there, tangent, 0), buoyant=pore * covered,
            chord=np.arctan2(np.abs(surfaces.z[:, 0] - surfaces.z[:, -1]), surfaces.x[:, -1] - surfaces.x[:, 0]),
            valid=valid, thickness=thickness, area=(thick * width).sum(axis=1),
            on_rigid=(covered * on_floor).sum(axis=1) / np.maximum(total, 1e-12),
            tension=np.full(len(x), self.tension),
        )  # fmt: skip

    def _weight(
        self, z: np.ndarray, tops: Sequence[np.ndarray], table: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Weight above heights z (N/m2), and its moment about the height 0 (N/m)."""
        weight, moment = np.zeros_like(z), np.zeros_like(z)
        for (top, bottom), (dry, wet) in zip(pairwise(tops), self.weights, strict=True):
            low = np.maximum(bottom, z)
            high = np.maximum(top, low)
            middle = high if table is None else np.clip(table, low, high)
            # Wet from low to middle, dry from there to high; without a table all of it is dry.
            middle = low if table is None else middle
            weight += dry * (high - middle) + wet * (middle - low)
            moment += (dry * (high**2 - middle**2) + wet * (middle**2 - low**2)) / 2
        return weight, moment

    def _strength_at(
        self, x: np.ndarray, z: np.ndarray, lies: np.ndarray, there: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Cohesion (Pa) and tangent of the friction angle at the bases of slices.

        lies: share of each base that lies in each layer (layers, surfaces, slices).
        """
        strengths = np.stack([self.strengths[:, 0], np.tan(np.radians(self.strengths[:, 1]))])
        cohesion, tangent = np.tensordot(strengths, lies, axes=1)
        if self.strength is not None:
            number, *at = np.nonzero(lies * there)
            where = tuple(at)
            peak = self.strength(x[where], z[where], number)
            for values, of_place, usual in zip(
                (cohesion, tangent), (peak[0], np.tan(np.radians(peak[1]))), strengths, strict=True
            ):
                differs = np.where(np.isfinite(of_place), of_place - usual[number], 0)
                np.add.at(values, where, differs * lies[(number, *at)])
        return cohesion, tangent


def _lies_in(tops: Sequence[np.ndarray], z: np.ndarray, rise: np.ndarray, least: float) -> np.ndarray:
    """Share of each base that lies in each layer (layers, surfaces, slices).

    tops: heights of the layers' boundaries. z: of the middles of the bases. rise: between their ends. least: rise that
    a level base has (m).
    """
    half = np.maximum(rise, least) / 2
    shares = np.stack(
        [np.maximum(np.minimum(top, z + half) - np.maximum(bottom, z - half), 0) for top, bottom in pairwise(tops)]
    )
    total = shares.sum(axis=0)
    return np.where(total > 0, shares / np.where(total > 0, total, 1), 0)


def _below(clearance: np.ndarray) -> np.ndarray:
    """Share of each slice (surfaces, slices) in which clearance at its edges (surfaces, slices + 1) is below 0."""
    low = np.minimum(clearance[:, 1:], clearance[:, :-1])
    high = np.maximum(clearance[:, 1:], clearance[:, :-1])
    return np.where(high <= 0, 1.0, np.clip(-low, 0, None) / np.where(high > low, high - low, 1))


def _kinks(lines: Sequence[np.ndarray], relief: float) -> np.ndarray:
    """X (k,) m of the sharpest kinks of lines (n, 2) m."""
    tolerance = 1e-3 * relief
    while True:
        kept = [np.asarray(shapely.LineString(line).simplify(tolerance).coords)[1:-1, 0] for line in lines]
        kinks = np.unique(np.concatenate(kept))
        if kinks.size <= MOST_KINKS:
            return kinks
        tolerance = 2 * tolerance + ROUNDING


def _seams(
    shape: Section,
    layers: Sequence[Layer],
    x: np.ndarray,
    heights: np.ndarray,
    floor: np.ndarray,
    rock: np.ndarray,
) -> Iterator[np.ndarray]:
    """Lines (n, 2) m along thin, weak layers of soil, and along rigid ground where that may be a plane of sliding."""
    relief = np.ptp(heights[0])
    for number, (top, bottom) in enumerate(pairwise(heights)):
        there = top > bottom + ROUNDING
        thin = there.sum() > 1 and (top - bottom).max() < THIN * relief
        if thin and not rock[number] and shape.thicknesses(layers)[number].weak:
            yield np.stack([x, (top + bottom) / 2], axis=1)[there]
    if shape.interface is not None or shape.bedrock is not None or rock.any():
        yield np.stack([x, floor], axis=1)


def _solve(bodies: _Bodies, surfaces: Surfaces, method: Method) -> np.ndarray:
    """Factors of safety (surfaces,) by a method; infinite where there is none."""
    factors = np.full(len(bodies.valid), math.inf)
    which = np.flatnonzero(bodies.valid)
    if which.size:
        some = bodies.of(which)
        with np.errstate(all="ignore"):
            if method == "bishop":
                assert surfaces.centres is not None
                found = _bishop(some, surfaces.centres[which])
            else:
                found = _spencer(some) if method == "spencer" else _janbu(some)
        factors[which] = np.where(np.isfinite(found) & (found > 0), found, math.inf)
    return factors


def _bishop(bodies: _Bodies, centres: np.ndarray) -> np.ndarray:
    """Bishop's simplified method: moments about the centre, and no shear between slices."""
    # In the frame of the bodies, x may be mirrored: a base that lies on the circle faces its centre.
    side = np.sign(bodies.x[:, -1] - bodies.x[:, 0])[:, None]
    x, z = bodies.x - side * centres[:, :1], bodies.z - centres[:, 1:]
    sine, cosine, tangent = bodies.sine, bodies.cosine, bodies.tangent
    driving = -(bodies.down * x + bodies.along * z + bodies.overturning).sum(axis=1)
    arm, lever = -(x * sine + z * cosine), x * cosine - z * sine
    factor = np.full(len(x), 1.5)
    for _ in range(ROUNDS):
        turn = cosine + sine * tangent / factor[:, None]
        normal = (bodies.down - bodies.buoyant * cosine - bodies.cohesion * sine / factor[:, None]) / turn
        resisting = ((bodies.cohesion + normal * tangent) * arm).sum(axis=1)
        new = resisting / (driving + ((normal + bodies.buoyant) * lever).sum(axis=1))
        change, factor = np.abs(new / factor - 1), np.clip(np.where(new > 0, new, factor / 2), 0.02, 100.0)
        if not (change > CONVERGED).any():
            break
    turned = np.where(bodies.length > 0, turn, 1).min(axis=1) < LEAST_ARM
    bad = turned | ~(change < 10 * CONVERGED) | (new <= 0) | bodies.in_tension(normal)
    return np.where(bad, math.inf, factor)


def _between(
    bodies: _Bodies, inverse: np.ndarray, angle: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The resultants of the interslice forces (N/m), and what else they need.

    inverse: of the factors (surfaces, 1). angle: of the forces, downwards (surfaces, 1). Returns the resultants, their
    derivatives by both, the divisor of each, and the effective normal force at each base (N/m).
    """
    across, along = np.cos(angle), np.sin(angle)
    sine = bodies.sine * across - bodies.cosine * along
    cosine = bodies.cosine * across + bodies.sine * along
    rough = bodies.tangent * inverse
    divisor = cosine + sine * rough
    force = (bodies.strength * inverse - bodies.driving) / divisor
    normal = force * sine
    by_inverse = (bodies.strength - normal * bodies.tangent) / divisor
    by_angle = force * (cosine * rough - sine) / divisor
    return force, by_inverse, by_angle, divisor, bodies.pressed - normal


def _level(bodies: _Bodies) -> tuple[np.ndarray, np.ndarray]:
    """Inverse factors (surfaces, 1) with which level forces between slices balance, and whether that is so."""
    inverse, change = np.full((len(bodies.valid), 1), 0.7), np.full((len(bodies.valid), 1), np.inf)
    friction = bodies.sine * bodies.tangent
    for _ in range(ROUNDS):
        divisor = bodies.cosine + friction * inverse
        force = (bodies.strength * inverse - bodies.driving) / divisor
        by_inverse = (bodies.strength - force * friction) / divisor
        new = inverse - force.sum(axis=1, keepdims=True) / by_inverse.sum(axis=1, keepdims=True)
        new = np.clip(np.where(np.isfinite(new), new, inverse), inverse / 3, inverse * 3)
        change, inverse = np.abs(new / inverse - 1), new
        if not (change > CONVERGED).any():
            break
    divisor, normal = _between(bodies, inverse, np.zeros_like(inverse))[3:]
    turned = np.where(bodies.length > 0, divisor, 1).min(axis=1) < LEAST_ARM
    return inverse, (change[:, 0] < CONVERGED) & ~turned & ~bodies.in_tension(normal)


def _janbu(bodies: _Bodies) -> np.ndarray:
    """Janbu's simplified method with his correction: horizontal forces balance, and those between slices are level."""
    inverse, solved = _level(bodies)
    cohesive, frictional = (bodies.cohesion > 0).any(axis=1), (bodies.tangent > 0).any(axis=1)
    share = np.where(cohesive & frictional, 0.5, np.where(cohesive, 0.69, 0.31))
    span = (bodies.length * bodies.cosine).sum(axis=1)
    # Depth below the chord over its length.
    chord = span / np.cos(bodies.chord)
    first, last = bodies.z[:, :1], bodies.z[:, -1:]
    straight = first + (last - first) * (bodies.x - bodies.x[:, :1]) / (bodies.x[:, -1:] - bodies.x[:, :1])
    depth = ((straight - bodies.z).max(axis=1) * np.cos(bodies.chord)) / chord
    correction = 1 + share * np.maximum(depth - 1.4 * depth**2, 0)
    return np.where(solved, correction / inverse[:, 0], math.inf)


def _spencer(bodies: _Bodies) -> np.ndarray:
    """Spencer's method: forces and moments balance, and the forces between slices have one inclination."""
    level, _ = _level(bodies)
    factors = np.full(len(bodies.valid), math.inf)
    unsolved = np.arange(len(bodies.valid))
    for start in STARTS:
        some = bodies.of(unsolved)
        factors[unsolved] = _inclined(some, level[unsolved], start * some.chord[:, None])
        unsolved = np.flatnonzero(~np.isfinite(factors))
        if not unsolved.size:
            break
    return factors


def _inclined(bodies: _Bodies, inverse: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Factors by Spencer's method, by Newton's from inverse factors and inclinations (surfaces, 1)."""
    weight = bodies.down.sum(axis=1, keepdims=True)
    middle = (bodies.x.mean(axis=1, keepdims=True), bodies.z.mean(axis=1, keepdims=True))
    x, z = bodies.x - middle[0], bodies.z - middle[1]
    moment = bodies.overturning.sum(axis=1, keepdims=True)
    change = np.full_like(inverse, np.inf)
    for _ in range(ROUNDS // 3):
        force, by_inverse, by_angle, *_ = _between(bodies, inverse, angle)
        arm, turned = z * np.cos(angle) + x * np.sin(angle), x * np.cos(angle) - z * np.sin(angle)
        balance = force.sum(axis=1, keepdims=True)
        turning = (force * arm).sum(axis=1, keepdims=True) - moment
        a, b = (part.sum(axis=1, keepdims=True) for part in (by_inverse, by_angle))
        c = (by_inverse * arm).sum(axis=1, keepdims=True)
        d = (by_angle * arm + force * turned).sum(axis=1, keepdims=True)
        determinant = a * d - b * c
        step, tilt = (b * turning - d * balance) / determinant, (c * balance - a * turning) / determinant
        good = np.isfinite(step) & np.isfinite(tilt)
        new = np.clip(np.where(good, inverse + step, np.nan), inverse / 2, inverse * 2)
        change = np.maximum(np.abs(new / inverse - 1), np.abs(tilt))
        inverse, angle = new, angle + np.clip(tilt, -0.3, 0.3)
        if not (change > CONVERGED).any():
            break
    force, _, _, divisor, normal = _between(bodies, inverse, angle)
    turned_back = np.where(bodies.length > 0, divisor, 1).min(axis=1) < LEAST_ARM
    balanced = (np.abs(force.sum(axis=1)) < 1e-4 * weight[:, 0]) & (change[:, 0] < 10 * CONVERGED)
    good = balanced & ~turned_back & ~bodies.in_tension(normal) & (np.abs(angle[:, 0]) < STEEPEST_FORCE)
    return np.where(good, 1 / inverse[:, 0], math.inf)
