"""Ground as its users draw it: outlines and terrain against closed forms, a cut domain, a run-out over real terrain.

`polyline_difference` is that of a trapezoid drawn as a line to `Slope`. A plane under a terrain model has a known
volume, and between walls on rollers a known mean upright stress at every level: the weight of what lies above it.
`scene_difference` is that of the scenes in `scenes/sites` to the same slopes built in Python.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import jax
import numpy as np
from matplotlib.cbook import get_sample_data
from scipy.interpolate import RegularGridInterpolator

import jaxmpm as mpm
from benchmarks.measure import Report
from benchmarks.slopes import cases
from cooperative.measure import OpenGround, consequences
from cooperative.scene import built, parse, read_scene
from jaxmpm import Layer, Section, Soil, Terrain

SCENES = Path(__file__).parent / "scenes" / "sites"
AS_CASES = {"acads_1c": "ACADS 1c", "acads_3a": "ACADS 3a"}
"""Scenes of slopes that `benchmarks.slopes` builds in Python, from the same coordinates."""

CLAY = Soil(strength=42e3, softening_modulus=85e3)
PLANE = (40.0, -0.32, 0.09)
"""Height (m) at the origin of the tilted plane, and its slopes along x and y."""

METRES_PER_DEGREE = 111_195.0
WINDOW = (960.0, 640.0)
"""Of real terrain, along x and y (m): its steepest place, where a layer of clay slides on rock."""

WHOLE = Section([(0, 16), (90, 16), (114, 4), (204, 4)])
CUT = Section(WHOLE.surface, walls=(60.0, 156.0))
"""The published slope, with much ground around it and with as much as was published."""


def largest_difference(one: Any, other: Any) -> float:
    """Of all that two scenes and their states hold."""
    pairs = zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True)
    return max(float(np.max(np.abs(np.asarray(a, float) - np.asarray(b, float)), initial=0)) for a, b in pairs)


def polyline() -> dict[str, Any]:
    """The published slope, drawn as a line, and the largest difference to it."""
    shape, numerics = mpm.Slope(), mpm.Discretisation(1.0, (0.5, 0.5))
    top = shape.foundation + shape.height
    line = [(0, top), (shape.crest, top), (shape.toe_x, shape.foundation), (shape.length, shape.foundation)]
    one, other = mpm.slope(shape, CLAY, numerics), mpm.section(Section(line), CLAY, numerics)
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


def drawn(name: str) -> dict[str, Any]:
    """A scene of a slope with a known factor of safety: what it differs by from the same built in Python."""
    campaign = parse(read_scene(SCENES / f"{name}.toml"))
    scene, _ = built(campaign, "rough", at_rest=False)
    row = {"case": f"scene {name}", "particles": scene.particles.mass.size}
    if name not in AS_CASES:
        return row
    case = next(case for case in cases() if case.name == AS_CASES[name])
    numerics = campaign.grids["rough"]
    known, _ = case.built(numerics.cell, at_rest=False, cfl=numerics.cfl, dtype=numerics.dtype)
    return row | {"difference": largest_difference(scene, known)}


def run_out(shape: Section) -> dict[str, Any]:
    """The slide of the published slope with three quarters of its strength, to its end."""
    scene, state = mpm.section(shape, CLAY, mpm.Discretisation(1.0, (0.5, 0.5), fbar=True))
    start = time.perf_counter()
    final = mpm.solve(mpm.reduced(scene, 4 / 3), state, t_end=20.0).raise_if_failed().state
    moved = np.asarray(final.displacement)
    seconds = time.perf_counter() - start
    return {"particles": moved.shape[1], "runout_m": _measured(scene, moved, shape).runout, "seconds": seconds}


def _measured(scene: mpm.Scene, moved: np.ndarray, shape: Section | Terrain) -> Any:
    """Consequences of a slide, one that hangs together."""
    position = np.asarray(scene.particles.position, float)
    half = (np.asarray(scene.particles.volume).max() ** (1 / len(position)) / 2,) * len(position)
    return consequences(
        position, moved, np.asarray(scene.particles.volume), OpenGround(shape.heights(*position[:-1])),
        half_size=np.asarray(half), reach=1.5 * scene.grid.cell,
    )  # fmt: skip


def real_terrain(step: float) -> mpm.Raster:
    """The steepest window of the terrain model that matplotlib ships, projected to metres; heights from its lowest."""
    data: Any = get_sample_data("jacksboro_fault_dem.npz")
    with data:
        heights, dx, dy = data["elevation"][::-1].T.astype(float), float(data["dx"]), float(data["dy"])
        south = min(float(data["ymin"]), float(data["ymax"]))
    scale = METRES_PER_DEGREE * np.array([np.cos(np.radians(south + heights.shape[1] * dy / 2)), 1.0])
    x, y = (np.arange(n) * d * s for n, d, s in zip(heights.shape, (dx, dy), scale, strict=True))
    between = RegularGridInterpolator((x, y), heights)
    counts = [int(length / step) for length in (x[-1], y[-1])]
    at = np.meshgrid(*(np.arange(count) * step for count in counts), indexing="ij")
    whole = mpm.Raster(between(tuple(at)), (0.0, 0.0), step)
    span = [round(length / step) for length in WINDOW]
    corners = [
        (i, j) for i in range(0, counts[0] - span[0], span[0] // 2) for j in range(0, counts[1] - span[1], span[1] // 2)
    ]

    def fall(corner: tuple[int, int]) -> float:
        """From the middle of the window's west edge to that of its east edge."""
        i, j = corner
        middle = whole.heights[i : i + span[0] + 1, j + span[1] // 2]
        return float(middle[0] - middle[-1])

    i, j = max(corners, key=fall)
    part = whole.heights[i : i + span[0] + 1, j : j + span[1] + 1]
    return mpm.Raster(part - part.min(), (0.0, 0.0), step)


def over_terrain(raster: mpm.Raster, cell: float) -> dict[str, Any]:
    """A layer of clay 40 m thick that slides over rock, on cells of this size (m)."""
    clay = Soil(strength=150e3, young=2e8, softening_modulus=100e3, softening_length=10.0)
    shape = Terrain(raster, base=-40.0)
    layers = [
        Layer(clay, depth=40.0),
        Layer(Soil(strength=2e8, young=2e8, softening_modulus=100e3, softening_length=10.0)),
    ]
    start = time.perf_counter()
    scene, state = mpm.terrain(shape, layers, mpm.Discretisation(cell, (cell / 2,) * 3, fbar=True))
    final = mpm.solve(scene, state, t_end=20.0).raise_if_failed().state
    found = _measured(scene, np.asarray(final.displacement), shape)
    return {
        "case": "real terrain",
        "cell_m": cell,
        "particles": scene.particles.mass.size,
        "displacement_m": found.displacement,
        "runout_m": found.runout,
        "depth_m": found.depth,
        "volume_m3": found.volume,
        "area_m2": found.area,
        "seconds": time.perf_counter() - start,
    }


def run(quick: bool) -> Report:
    """All of it; `quick` leaves out the finest cells."""
    planes = [plane(cell) for cell in ((4.0, 2.0) if quick else (4.0, 2.0, 1.0))]
    scenes = [drawn(path.stem) for path in sorted(SCENES.glob("*.toml"))]
    whole, cut = ({"case": f"{name} domain", **run_out(shape)} for name, shape in (("whole", WHOLE), ("cut", CUT)))
    raster = real_terrain(20.0)
    slides = [over_terrain(raster, cell) for cell in ((80.0, 40.0) if quick else (80.0, 40.0, 20.0))]
    for coarse in slides[:-1]:
        coarse["displacement_error"] = coarse["displacement_m"] / slides[-1]["displacement_m"] - 1
    line = polyline()
    values = {
        "polyline_difference": line["difference"],
        "plane_volume_error": max(row["volume_error"] for row in planes),
        "plane_stress_error": max(row["stress_error"] for row in planes),
        "scene_difference": max(row["difference"] for row in scenes if "difference" in row),
        "cut_runout_error": abs(cut["runout_m"] / whole["runout_m"] - 1),
        "cut_seconds_over_whole": cut["seconds"] / whole["seconds"],
        "terrain_displacement_error": slides[-2]["displacement_error"],
    }
    return Report(values, [line, *planes, *scenes, whole, cut, *slides])
