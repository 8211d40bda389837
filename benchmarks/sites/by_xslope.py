"""Sections as the package `xslope` takes them, and its factors of safety of slip surfaces: a peer of our own slices."""

from __future__ import annotations

import contextlib
import importlib
import io
import math
import warnings
from collections.abc import Sequence
from types import ModuleType
from typing import Literal, Unpack

import numpy as np

from cooperative.tools.safety import Circle, Conditions, zones
from jaxmpm import Layer, Section, Soil
from jaxmpm.ground import WATER_WEIGHT
from jaxmpm.soil import STANDARD_GRAVITY

KILO = 1e-3
"""xslope takes kPa and kN/m3."""
ROUNDING = 1e-6
"""Distance within which heights are one (m)."""
SLICES = 100
"""Of a surface."""


def module(name: str) -> ModuleType:
    """A module of xslope. Raises ValueError where the package, or what it needs, is not installed."""
    try:
        importlib.import_module("xslope")
        return importlib.import_module(f"xslope.{name}")
    except ModuleNotFoundError as error:
        lacking = (error.name or "xslope").partition(".")[0]
        raise ValueError(f"the comparison with xslope needs {lacking}: pip install xslope") from error


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


def factor(
    data: dict[str, object],
    surface: Circle | np.ndarray,
    method: Literal["bishop", "janbu", "spencer"],
    slices: int = SLICES,
) -> float | None:
    """The factor of safety of a slip surface by xslope.

    Args:
        data: of `inputs`.
        surface: a circle, or points (n, 2) m.
        method: of slices.
        slices: that the surface has, about.

    Returns:
        The factor, None where xslope has none.
    """
    how: dict[str, object]
    if isinstance(surface, Circle):
        depth = surface.z - surface.radius
        how = {"circle": {"Xo": surface.x, "Yo": surface.z, "Depth": depth, "R": surface.radius}, "composite": True}
    else:
        how = {"non_circ": [{"X": x, "Y": z, "Movement": "Free"} for x, z in surface.tolist()]}
    loaded = module("water").with_water_loads(data)
    with contextlib.redirect_stdout(io.StringIO()), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        made, result = module("slice").generate_slices(
            loaded, num_slices=slices, check_inputs=False, debug=False, **how
        )
        if not made or not len(result[0]):
            return None
        solved, answer = getattr(module("solve"), method)(result[0])
    return float(answer["FS"]) if solved and 0 < answer["FS"] < math.inf else None
