"""Slopes with known factors of safety by limit equilibrium, as a comparator: Spencer's method, by the package `xslope`.

Each slope of `benchmarks.sites.slopes` is given to xslope as it is given to the solver, from the same outline, layers,
loads and water; what it was given stands in benchmarks/data/limit_equilibrium. The critical circle is looked for all
over the section. From it a second search lets the slip surface take other shapes, as a weak band asks for. References
are by strength reduction where published, so that the error is the difference of two methods. Source: Spencer (1967),
10.1680/geot.1967.17.1.11, in the implementation of xslope."""

from __future__ import annotations

import contextlib
import importlib
import io
import json
import time
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import shapely

from benchmarks.measure import ROOT, Report
from benchmarks.sites.slopes import FAMILIES, Case, cases
from cooperative.store import write_aside
from jaxmpm import Layer, Section, Soil

INPUTS = ROOT / "benchmarks" / "data" / "limit_equilibrium"
METHOD = "spencer"
SLICES = 40
POINTS = 12
"""Of a slip surface that is no circle, its ends included."""
STEP, LEAST_STEP = 0.1, 0.002
"""Over the height of the slope: first and last distance by which these points move."""
SKY = 1e3
"""Height above the base that no ground reaches (m)."""
KILO = 1e-3
"""xslope takes kPa and kN/m3."""
WATER_WEIGHT = 9.81
"""Unit weight of water (kN/m3)."""


def search_module() -> Any:
    """xslope's searches. Raises ValueError where the package, or what it needs, is not installed."""
    try:
        return importlib.import_module("xslope.search")
    except ModuleNotFoundError as error:
        raise ValueError(f"limit equilibrium needs {error.name}: pip install xslope") from error


def zones(shape: Section, layers: Sequence[Layer]) -> Iterator[tuple[int, shapely.Polygon]]:
    """The ground as polygons, each with the number of its layer from 0 on."""
    points, (left, right), _ = shape.outline()
    inner = points[(points[:, 0] > left) & (points[:, 0] < right)]
    ends = [(x, float(shape.heights(np.array([x]))[0])) for x in (left, right)]
    # Ground down at the base has no area: buffer(0) leaves it out.
    rest = shapely.Polygon([(left, shape.base), ends[0], *inner.tolist(), ends[1], (right, shape.base)]).buffer(0)
    for number, layer in enumerate(layers):
        part = rest
        if layer.bottom is not None:
            line = np.asarray(layer.bottom, float)
            above = shapely.Polygon([*line.tolist(), *((x, shape.base + SKY) for x in (line[-1, 0], line[0, 0]))])
            part, rest = rest.intersection(above), rest.difference(above)
        for piece in shapely.get_parts(part):
            if piece.area > 0:
                yield number, piece


def material(number: int, layer: Layer, u: str, r_u: float | None) -> dict[str, Any]:
    """A layer as xslope names its numbers; clay in total stress. u: where the pore pressure of others comes from."""
    soil: Any = layer.soil
    if isinstance(soil, Soil):
        assert soil.strength is not None
        cohesion, friction, u = soil.strength, 0.0, "none"
    else:
        cohesion, friction = soil.cohesion, soil.friction
    unused: dict[str, Any] = dict.fromkeys(("gamma_sat", "t_cut", "phi_b", "s_cap"))
    unused |= dict.fromkeys(("cp", "r_elev", "d", "psi"), 0.0)
    return unused | {
        "name": f"layer {number + 1}",
        "option": "mc",
        "gamma": soil.unit_weight * KILO,
        "c": cohesion * KILO,
        "phi": friction,
        "u": u,
        "ru": r_u,
    }


def inputs(case: Case) -> dict[str, Any]:
    """What xslope is given for a slope, in m, kPa and kN/m3."""
    fileio = importlib.import_module("xslope.fileio")
    layers = list(case.soil) if isinstance(case.soil, Sequence) else [Layer(case.soil)]
    polygons = [{"polygon": zone, "mat_id": number} for number, zone in zones(case.shape, layers)]
    ground, domain = fileio.build_ground_surface_from_polygons(polygons)
    water, r_u = case.loads.get("water"), case.loads.get("r_u")
    if isinstance(water, int | float):
        water = [(wall, water) for wall in case.shape.outline()[1]]
    u = "ru" if r_u is not None else "none" if water is None else "piezo"
    return {
        "unit_system": "si",
        "polygons": polygons,
        "ground_surface": ground,
        "domain_polygon": domain,
        "materials": [material(number, layer, u, r_u) for number, layer in enumerate(layers)],
        "piezo_line": [tuple(point) for point in water or ()],
        "gamma_water": WATER_WEIGHT,
        "water_loads": "auto",
        "k_seismic": case.loads.get("k_h", 0.0),
        "tcrack_depth": 0.0,
        "tcrack_water": 0.0,
        "dloads": [],
        "dloads2": [],
        "circular": True,
        "circles": [_first_circle(case.shape)],
        "non_circ": [],
    }


def _first_circle(shape: Section) -> dict[str, float]:
    """A circle over the middle of the slope, down to the toe; the search begins with others too."""
    x, z = np.asarray(shape.surface, float).T
    crest, toe = z.max(), z.min()
    middle = float(np.interp((crest + toe) / 2, *(line[np.argsort(z, kind="stable")] for line in (z, x))))
    return {"Xo": middle, "Yo": float(2 * crest - toe), "Depth": float(toe), "R": float(2 * (crest - toe))}


def factors(case: Case) -> dict[str, Any]:
    """The slope's factors of safety: of the critical circle, and of the critical slip surface of any shape."""
    search, start = search_module(), time.perf_counter()
    given = inputs(case)
    height = case.shape.relief
    with contextlib.redirect_stdout(io.StringIO()):  # it tells of every circle
        circles, settled, *_ = search.circular_search(given, METHOD, seed="grid", num_slices=SLICES)
        line = circles[0]["failure_surface"]
        points = [line.interpolate(along, normalized=True) for along in np.linspace(0, 1, POINTS)]
        given["non_circ"] = [{"X": point.x, "Y": point.y, "Movement": "Free"} for point in points]
        shapes, done, _ = search.noncircular_search(
            given,
            METHOD,
            num_slices=SLICES,
            diagnostic=False,
            movement_distance=STEP * height,
            move_tol=LEAST_STEP * height,
        )
    # A circle that the second search does not take for a start leaves it without an answer.
    circle = float(circles[0]["FS"])
    shaped = float(shapes[0]["FS"]) if shapes else None
    least = circle if shaped is None else min(circle, shaped)
    return {
        "case": case.name,
        "reference": case.reference,
        "circle": round(circle, 3),
        "any_shape": "none found" if shaped is None else round(shaped, 3),
        "fos": round(least, 3),
        "error": round(least / case.reference - 1, 4),
        "settled": bool(settled and (done or shaped is None)),
        "seconds": round(time.perf_counter() - start, 1),
    }


def write_inputs(known: Sequence[Case]) -> None:
    """Write what xslope is given of each slope into benchmarks/data/limit_equilibrium."""
    INPUTS.mkdir(exist_ok=True)
    for case in known:
        text = json.dumps(inputs(case), default=lambda shape: shape.wkt, indent=1) + "\n"
        write_aside(INPUTS / f"{case.name.replace('/', ' of ')}.json", text.encode())


def run(quick: bool) -> Report:
    """All slopes; `quick` takes the first. Raises ValueError without xslope."""
    search_module()
    known = FAMILIES[0]()[:1] if quick else cases()
    rows = [factors(case) for case in known]
    return Report(
        {
            "lem_cases": len(rows),
            "lem_error_max": max(abs(row["error"]) for row in rows),
            "lem_cases_within_4_percent": sum(abs(row["error"]) <= 0.04 for row in rows),
            "lem_circle_error_max": round(max(abs(row["circle"] / row["reference"] - 1) for row in rows), 4),
        },
        rows,
        lambda _: write_inputs(known),
    )
