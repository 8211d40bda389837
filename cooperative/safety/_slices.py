"""Slip surfaces in slices: a section as the package `xslope` takes it, and factors of safety by Spencer's method.

Source: Spencer (1967), 10.1680/geot.1967.17.1.11, in the implementation of xslope.
"""

from __future__ import annotations

import contextlib
import importlib
import io
import math
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from types import ModuleType
from typing import TYPE_CHECKING, Literal, TypedDict, Unpack

import numpy as np
import shapely

from jaxmpm import Layer, Section, Soil
from jaxmpm.ground import WATER_WEIGHT
from jaxmpm.soil import STANDARD_GRAVITY

if TYPE_CHECKING:
    from pandas import DataFrame

KILO = 1e-3
"""xslope takes kPa and kN/m3."""
ROUNDING = 1e-6
"""Distance within which points of a line are one (m)."""
DRIVING = 0.01
"""Least driving force over the weight: below it a surface lies under level ground."""
IN_TENSION = 0.25
"""Largest share of slices whose base is in tension."""
SHALLOWEST = 0.05
"""Least thickness of a sliding mass, over the height of the ground."""
THIN = 0.25
"""Thickness over the height of the ground up to which a layer is a seam that surfaces follow."""

Strength = Callable[[np.ndarray, np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
"""Cohesion (n,) Pa and friction angle (n,) degrees at x, z (n,) m in layers of these numbers (n,); nan for those of the
layer."""


def module(name: str) -> ModuleType:
    """A module of xslope. Raises ValueError where the package, or what it needs, is not installed."""
    try:
        importlib.import_module("xslope")
        return importlib.import_module(f"xslope.{name}")
    except ModuleNotFoundError as error:
        lacking = (error.name or "xslope").partition(".")[0]
        raise ValueError(f"limit equilibrium needs {lacking}: pip install xslope") from error


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


def _covered(shape: Section, layers: Sequence[Layer], last: int) -> bool:
    """Whether the layers up to the last of soil cover all ground below them."""
    _, heights = shape.boundaries(layers)
    return bool((heights[0] > heights[last + 1] + ROUNDING).all())


def _material(number: int, layer: Layer, u: str, r_u: float | None, *, rock: bool, weighs: float) -> dict[str, object]:
    """A layer as xslope names its numbers; clay in total stress.

    u: where the pore pressure of others comes from. weighs: share of its weight.
    """
    soil = layer.soil
    if isinstance(soil, Soil):
        cohesion, friction, u = soil.strength or 0.0, 0.0, "none"
    elif hasattr(soil, "cohesion") and hasattr(soil, "friction"):
        cohesion, friction = soil.cohesion, soil.friction
    else:
        kind = type(soil).__name__
        raise ValueError(f"limit equilibrium is for soil with a strength, or cohesion and friction, not for {kind}")
    saturated = getattr(soil, "saturated_unit_weight", None)
    unused: dict[str, object] = dict.fromkeys(("t_cut", "phi_b", "s_cap"))
    unused |= dict.fromkeys(("cp", "r_elev", "d", "psi"), 0.0)
    return unused | {
        "name": f"layer {number + 1}",
        # No slip surface enters rock; one may follow its top.
        "option": "elastic" if rock else "mc",
        "gamma": soil.unit_weight * weighs * KILO,
        "gamma_sat": None if saturated is None else saturated * weighs * KILO,
        "c": cohesion * KILO,
        "phi": friction,
        "u": u,
        "ru": r_u,
    }


def _seams(shape: Section, layers: Sequence[Layer], rock: Sequence[int]) -> Iterator[np.ndarray]:
    """Lines (n, 2) m along thin layers of soil, and along the base where it is a joint."""
    x, heights = shape.boundaries(layers)
    for number, (top, bottom) in enumerate(pairwise(heights)):
        there = top > bottom + ROUNDING
        if number not in rock and there.sum() > 1 and (top - bottom).max() < THIN * shape.relief:
            yield np.stack([x, (top + bottom) / 2], axis=1)[there]
    if shape.interface is not None:
        yield np.stack([x, np.full_like(x, shape.base)], axis=1)[[0, -1]]


class Conditions(TypedDict, total=False):
    """What acts on the layers of a section, and which of them are rock; nothing where it is left out.

    Args:
        water: level or points (x, z) of the water table (m).
        r_u: pore pressure over the weight of the soil above.
        k_h: pseudo-static horizontal acceleration over gravity, as `jaxmpm.section`.
        k_v: vertical one, upwards, by which soil weighs less; the horizontal force does not.
        rock: numbers of the layers that are rock.
        gravity: downwards (m/s2), by default standard gravity.
    """

    water: float | Sequence[Sequence[float]] | None
    r_u: float | None
    k_h: float
    k_v: float
    rock: Sequence[int]
    gravity: float


def inputs(shape: Section, layers: Sequence[Layer], **conditions: Unpack[Conditions]) -> dict[str, object]:
    """What xslope is given of a section, in m, kPa and kN/m3; of the horizontal acceleration its size alone.

    Args:
        shape: outline.
        layers: from the top down, of undrained soil or soil with friction.
        **conditions: as in `Conditions`.

    Returns:
        Its `slope_data`.

    Raises:
        ValueError: xslope is not installed, or soil or lines of the section will not do.
    """
    water, r_u, rock = conditions.get("water"), conditions.get("r_u"), conditions.get("rock", ())
    lighter, pull = 1 - conditions.get("k_v", 0.0), conditions.get("gravity", STANDARD_GRAVITY) / STANDARD_GRAVITY
    # Without rock that lies below all soil, the ground's floor is its top, which circles then follow.
    covered = max((number for number in range(len(layers)) if number not in rock), default=-1)
    outcrops = not _covered(shape, layers, covered)
    polygons = [
        {"polygon": zone, "mat_id": number} for number, zone in zones(shape, layers) if outcrops or number <= covered
    ]
    ground, domain = module("fileio").build_ground_surface_from_polygons(polygons)
    if isinstance(water, int | float):
        water = [(wall, water) for wall in shape.outline().walls]
    u = "ru" if r_u is not None else "none" if water is None else "piezo"
    return {
        "unit_system": "si",
        "polygons": polygons,
        "ground_surface": ground,
        "domain_polygon": domain,
        "materials": [
            _material(number, layer, u, r_u, rock=number in rock, weighs=lighter * pull)
            for number, layer in enumerate(layers)
        ],
        "piezo_line": [tuple(point) for point in water or ()],
        "gamma_water": WATER_WEIGHT * pull * KILO,
        "water_loads": "auto",
        "k_seismic": abs(conditions.get("k_h", 0.0)) / lighter,
        "tcrack_depth": 0.0,
        "tcrack_water": 0.0,
        "dloads": [],
        "dloads2": [],
        "circular": True,
        "circles": [],
        "non_circ": [],
    }


@dataclass(frozen=True)
class Circle:
    """A circular slip surface, which follows the base of the ground where it would cut below it.

    Args:
        x: of its centre (m).
        z: of its centre (m).
        radius: of it (m).
    """

    x: float
    z: float
    radius: float


@dataclass(frozen=True)
class Slip:
    """A slip surface and its factor of safety.

    Args:
        factor: of safety.
        points: of the surface (n, 2) m, x rising.
        circle: of which it is a part, None for another shape.
        thickness: largest of the mass above it (m).
    """

    factor: float
    points: np.ndarray
    circle: Circle | None
    thickness: float


@dataclass(frozen=True)
class Slices:
    """A section, ready for slip surfaces.

    Args:
        shape: outline.
        given: of `inputs`.
        seams: lines (n, 2) m along thin layers of soil, and along the base where it is a joint.
        k_h: pseudo-static acceleration over gravity, as `jaxmpm.section`.
        strength: at the bases of slices, None for that of the layers.
        slices: that a surface has, about.
    """

    shape: Section
    given: dict[str, object]
    seams: tuple[np.ndarray, ...] = ()
    k_h: float = 0.0
    strength: Strength | None = None
    slices: int = 40

    @classmethod
    def of(
        cls,
        shape: Section,
        layers: Sequence[Layer],
        *,
        strength: Strength | None = None,
        **conditions: Unpack[Conditions],
    ) -> Slices:
        """A section in slices, as `inputs` and these fields have it."""
        # Once, not for every surface.
        given = module("water").with_water_loads(inputs(shape, layers, **conditions))
        seams = tuple(_seams(shape, layers, conditions.get("rock", ())))
        return cls(shape, given, seams, conditions.get("k_h", 0.0), strength)

    @property
    def frictional(self) -> bool:
        """Whether soil has friction somewhere."""
        materials = self.given["materials"]
        assert isinstance(materials, list)
        return any(material["phi"] > 0 for material in materials)

    @property
    def of_circles(self) -> Literal["bishop", "spencer"]:
        """Method for circles: in clay alone the moments give Spencer's factor, also where his forces have no answer."""
        return "spencer" if self.frictional else "bishop"

    def slip(
        self, surface: Circle | np.ndarray, method: Literal["bishop", "janbu", "spencer"] = "spencer"
    ) -> Slip | None:
        """The factor of safety of a slip surface.

        Args:
            surface: a circle, or points (n, 2) m with x rising, both ends on the ground.
            method: Spencer's; Bishop's simplified one of circles and Janbu's of other shapes take less time.

        Returns:
            The surface and its factor, None where no mass slides on it or the method has no admissible answer.
        """
        how: dict[str, object]
        if isinstance(surface, Circle):
            depth = surface.z - surface.radius
            circle = {"Xo": surface.x, "Yo": surface.z, "Depth": depth, "R": surface.radius}
            how = {"circle": circle, "composite": True}
        else:
            how = {"non_circ": [{"X": x, "Y": z, "Movement": "Free"} for x, z in surface.tolist()]}
        with contextlib.redirect_stdout(io.StringIO()), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            made, result = module("slice").generate_slices(
                self.given, num_slices=self.slices, check_inputs=False, debug=False, **how
            )
            if not made or not len(result[0]):
                return None
            frame, line = result
            thickness = float((frame["y_ct"] - frame["y_cb"]).max())
            weight, angle = frame["w"].to_numpy(float), np.radians(frame["alpha"].to_numpy(float))
            driving = abs(float((weight * np.sin(angle)).sum())) + abs(self.k_h) * weight.sum()
            if driving < DRIVING * weight.sum() or thickness < SHALLOWEST * self.shape.relief:
                return None
            self._complete(frame)
            solved, answer = getattr(module("solve"), method)(frame)
        if not solved or not 0 < answer["FS"] < math.inf:
            return None
        if float((frame["n_eff"] < 0).mean()) > IN_TENSION:
            return None
        circle_of = surface if isinstance(surface, Circle) else None
        return Slip(float(answer["FS"]), np.asarray(line.coords, float), circle_of, thickness)

    def _complete(self, frame: DataFrame) -> None:
        """Give slices their strength, and the earthquake its direction, which for xslope always drives them."""
        falls = 1 if frame["y_lt"].iloc[0] >= frame["y_rt"].iloc[-1] else -1
        if self.k_h * falls * self.shape.downhill < 0:
            frame["kw"] = -frame["kw"]
        if self.strength is not None:
            layer = frame["mat"].to_numpy(int) - 1
            cohesion, friction = self.strength(frame["x_c"].to_numpy(float), frame["y_cb"].to_numpy(float), layer)
            known = np.isfinite(cohesion)
            frame["c"] = np.where(known, cohesion * KILO, frame["c"])
            frame["phi"] = np.where(known, friction, frame["phi"])
        if self.shape.interface is not None:
            joint = frame["y_cb"].to_numpy(float) < self.shape.base + ROUNDING
            frame["c"] = np.where(joint, self.shape.interface.cohesion * KILO, frame["c"])
            frame["phi"] = np.where(joint, self.shape.interface.friction, frame["phi"])
