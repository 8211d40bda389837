"""Ground as its users draw it: outlines and terrain against closed forms, known slopes as scenes, a cut domain, slides
over real terrain and in sensitive clay.

`polyline_difference` is that of a trapezoid drawn as a line to `Slope`. A plane under a terrain model has a known
volume, and between walls on rollers a known mean upright stress at every level: the weight of what lies above it.
`scene_difference` is that of the scenes in `scenes/sites` to the same slopes built in Python; `..._fos` their factors
of safety by the limit load, on the finest grid, beside the known ones. A row that is done is stored in `out/sites`, so
that the command goes on where it was stopped; rows are made again when the code has changed.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any

import jax
import numpy as np

import jaxmpm as mpm
from benchmarks.measure import ROOT, Report, code_digest, stored_row
from benchmarks.sites import sites_retrogression, sites_terrain
from benchmarks.sites.sites_retrogression import PUBLISHED, READINGS, SCENES
from benchmarks.sites.slopes import cases
from cooperative.measure import OpenGround, consequences
from cooperative.scene import built, parse, read_scene
from jaxmpm import Section, Soil, Terrain
from jaxmpm.ground import as_section

HERE = Path(__file__).parent
AS_CASES = {"acads_1c": "ACADS 1c", "acads_3a": "ACADS 3a"}
"""Scenes of slopes that `benchmarks.sites.slopes` builds in Python, from the same coordinates."""

FACTORS = {"acads_1c": 1.35, "acads_3a": 1.26, "griffiths_lane_3": 1.40}
"""Known factors of safety: the first two by strength reduction, the third read off a figure, good to a tenth."""

CLAY = Soil(strength=42e3, softening_modulus=85e3, tension_cutoff=0.0)
PLANE = (40.0, -0.32, 0.09)
"""Height (m) at the origin of the tilted plane, and its slopes along x and y."""

WHOLE = Section([(0, 16), (90, 16), (114, 4), (204, 4)])
DOMAINS = {"whole": WHOLE, "cut": Section(WHOLE.surface, walls=(60.0, 156.0))}
"""The published slope, with much ground around it and with as much as was published."""


def largest_difference(one: Any, other: Any) -> float:
    """Of all that two scenes and their states hold."""
    pairs = zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True)
    return max(float(np.max(np.abs(np.asarray(a, float) - np.asarray(b, float)), initial=0)) for a, b in pairs)


def polyline() -> dict[str, Any]:
    """The published slope, drawn as a line, and the largest difference to it."""
    shape, numerics = mpm.Slope(), mpm.Discretisation(1.0, (0.5, 0.5))
    as_line = as_section(shape)
    assert as_line is not None
    one, other = mpm.slope(shape, CLAY, numerics), mpm.section(as_line, CLAY, numerics)
    return {"case": "polyline", "difference": largest_difference(one, other)}


def plane(cell: float) -> dict[str, Any]:
    """A tilted plane of 48 x 24 m on cells of this size (m): its volume, and the stress of its levels."""
    top, along, across = PLANE
    x, y = np.meshgrid(np.arange(0, 49, 4.0), np.arange(0, 25, 4.0), indexing="ij")
    shape = Terrain(mpm.Raster(top + along * x + across * y, (0.0, 0.0), 4.0), base=0.0)
    scene, state = mpm.terrain(shape, CLAY, mpm.Discretisation(cell, (cell / 2,) * 3))
    height = top + along * 24 + across * 12
    volume = float(np.sum(np.asarray(scene.particles.volume, float)))
    z, stress = np.asarray(scene.particles.position[2], float), np.asarray(state.stress[2], float)
    errors = [
        abs(stress[np.abs(z - level) < cell / 8].mean() / (-CLAY.unit_weight * (height - level)) - 1)
        for level in (np.floor(depth / cell + 1e-9) * cell + 0.25 * cell for depth in (0.0, 8.0, 16.0))
    ]
    return {
        "case": "plane",
        "cell_m": cell,
        "particles": z.size,
        "volume_error": abs(volume / (height * 48 * 24) - 1),
        "stress_error": max(errors),
    }


def compare_scene(name: str) -> dict[str, Any]:
    """A scene of a slope with a known factor of safety: what it differs by from the same built in Python."""
    campaign = parse(read_scene(SCENES / f"{name}.toml"))
    scene, _ = built(campaign, "rough", at_rest=False)
    row = {"case": f"scene {name}", "particles": scene.particles.mass.size}
    if name not in AS_CASES:
        return row
    case = next(case for case in cases() if case.name == AS_CASES[name])
    numerics = campaign.grids["rough"]
    reference, _ = case.built(numerics.cell, at_rest=False, cfl=numerics.cfl, dtype=numerics.dtype)
    return row | {"difference": largest_difference(scene, reference)}


def run_out(name: str) -> dict[str, Any]:
    """The slide of the published slope with three quarters of its strength, to its end, in one of the domains.

    It goes back 31 m, to a metre behind the wall of the cut one, which makes it 2 % shorter there.
    """
    shape = DOMAINS[name]
    scene, state = mpm.section(shape, CLAY, mpm.Discretisation(1.0, (0.5, 0.5), cell_average=True))
    scene = mpm.reduced(scene, 4 / 3)
    mpm.solve(scene, state, t_end=float(scene.numerics.time_step))  # compiles
    start = time.perf_counter()
    distance = np.asarray(mpm.solve(scene, state, t_end=20.0).raise_if_failed().state.displacement)
    seconds = time.perf_counter() - start
    position = np.asarray(scene.particles.position, float)
    result = consequences(
        position, distance, np.asarray(scene.particles.volume), OpenGround(shape.heights(position[0])),
        half_size=np.full(2, 0.25), reach=1.5,
    )  # fmt: skip
    return {"case": f"{name} domain", "particles": position.shape[1], "runout_m": result.runout, "seconds": seconds}


def factor(name: str, grid: str) -> dict[str, Any]:
    """The factor of safety of a scene's mean soil, by the limit load, beside the known one."""
    campaign, reference = parse(read_scene(SCENES / f"{name}.toml")), FACTORS[name]
    start = time.perf_counter()
    scene, state = built(campaign, grid)
    result = mpm.factor_of_safety(
        scene, state, criterion="limit load", bracket=(0.8 * reference, 1.25 * reference), resolution=0.02, batch=6
    )
    assert result.kink is not None
    return {
        "case": f"factor of {name}",
        "cell_m": campaign.grids[grid].cell,
        "particles": scene.particles.mass.size,
        "fos": round(result.kink, 3),
        "known": reference,
        "error": round(result.kink / reference - 1, 4),
        "sharpness": result.sharpness,
        "seconds": round(time.perf_counter() - start, 1),
    }


def run(quick: bool) -> Report:
    """All of it; `quick` leaves out the finest cells."""
    texts = [path.read_text() for path in (*sorted(SCENES.glob("*.toml")), *sorted(HERE.glob("sites*.py")))]
    folder = ROOT / "out" / "sites" / code_digest(*texts)

    def rows(name: str, make: Callable[[Any], dict[str, Any]], *cases: Any) -> list[dict[str, Any]]:
        return [stored_row(folder, f"{name} {case}", partial(make, case)) for case in cases]

    def either(few: tuple[Any, ...], more: tuple[Any, ...]) -> tuple[Any, ...]:
        return few if quick else (*few, *more)

    line = stored_row(folder, "polyline", polyline)
    planes = rows("plane", plane, *either((4.0, 2.0), (1.0,)))
    scenes = rows("scene", compare_scene, *sorted(path.stem for path in SCENES.glob("*.toml")))
    grids = {name: ("rough",) if quick or name == "acads_3a" else ("rough", "refined") for name in FACTORS}
    factors = {name: rows(f"factor {name}", partial(factor, name), *grids[name]) for name in FACTORS}
    whole, cut = rows("domain", run_out, "whole", "cut")
    slides = rows("terrain", sites_terrain.slide, *either((16.0, 12.0), (8.0, 6.0)))
    for name in ("travel_m", "runout_m"):
        for coarse in slides[:-1]:
            coarse[f"{name}_error"] = round(coarse[name] / slides[-1][name] - 1, 4)
    clay = {name: rows(name, partial(sites_retrogression.slide, name), *either((0.5,), (0.25,))) for name in READINGS}
    values = {
        "polyline_difference": line["difference"],
        "plane_volume_error": max(row["volume_error"] for row in planes),
        "plane_stress_error": max(row["stress_error"] for row in planes),
        "scene_difference": max(row["difference"] for row in scenes if "difference" in row),
        **{f"{name}_fos": result[-1]["fos"] for name, result in factors.items()},
        **{f"{name}_fos_known": FACTORS[name] for name in FACTORS},
        "cut_runout_error": abs(cut["runout_m"] / whole["runout_m"] - 1),
        "cut_seconds_over_whole": cut["seconds"] / whole["seconds"],
        "terrain_travel_error": slides[-2]["travel_m_error"],
        "terrain_runout_error": slides[-2]["runout_m_error"],
        **{f"{name}_{what}": result[-1][what] for name, result in clay.items() for what in PUBLISHED},
    }
    all_factors = chain.from_iterable(factors.values())
    return Report(
        values, [line, *planes, *scenes, *all_factors, whole, cut, *slides, *chain.from_iterable(clay.values())]
    )
