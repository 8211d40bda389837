"""Columns that collapse: aluminium bars in the plane (Bui et al. 2008), and upright cylinders of sand.

The setting is that which docs/settings.md recommends for sand: USL, and damping by XPIC(2) at sqrt(g / H). Others stand
beside it on two of the four columns, those by which it is chosen; the other two, and the bars, judge it.
"""

from __future__ import annotations

import itertools
import json
import math
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import jaxmpm as mpm
from benchmarks.accuracy.runout_slides import thick_front
from benchmarks.public.rows import Row, row
from jaxmpm.laws import DruckerPrager, Matching

Made = Callable[[], list[Row]]
MOVED = 0.01
"""Displacement from which a bar counts as failed, over the width of the block; the source does not say from which."""
SETTINGS: dict[str, dict[str, Any]] = {
    "USL, XPIC(2)": {"scheme": mpm.Scheme.USL, "pic_damping": 1.0, "xpic": 2},
    "FLIP": {},
    "flip 0.99": {"flip": 0.99},
    "pic_damping 1/3": {"pic_damping": 1 / 3},
}
"""Numerical choices by name, the recommended ones first; `pic_damping` times the height's sqrt(H / g)."""
RECOMMENDED, *OTHERS = SETTINGS
CHOSEN_BY = (0.8, 2.1)
"""Heights over radii of the columns by which the setting is chosen."""
STATION = 0.01
"""Width (m) of the stations at which the surface of the bars is read."""


def released(
    size: tuple[float, ...],
    length: float,
    soil: mpm.FrictionalSoil,
    cell: float,
    gravity: float,
    t_end: float,
    *,
    inside: Callable[[np.ndarray], np.ndarray] | None = None,
    setting: str = RECOMMENDED,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A block on a rough base between smooth walls, let go from the stress of its weight.

    Args:
        size: of the block (m), which begins at the low walls.
        length: of the domain along each level axis (m).
        soil: of it.
        cell: m.
        gravity: m/s2.
        t_end: s.
        inside: function of positions that keeps some of the particles; None for all.
        setting: of SETTINGS.

    Returns:
        Initial positions (d, N) m, displacements (d, N) m and volumes (N,).
    """
    d, height = len(size), size[-1]
    choices = dict(SETTINGS[setting])
    decay = choices.pop("pic_damping", 0.0) * math.sqrt(gravity / height)
    numerics = mpm.Discretisation(cell, (cell / 2,) * d, pic_damping=decay, **choices)
    scene, state = mpm.block(
        size,
        soil,
        numerics,
        domain=(*(length,) * (d - 1), (math.ceil(height / cell - 1e-9) + 2) * cell),
        corner=(0.0,) * d,
        gravity=(*(0.0,) * (d - 1), -gravity),
        walls="roller",
        speed=math.sqrt(2 * gravity * height),
    )
    if inside is not None:
        kept = inside(np.asarray(scene.particles.position))
        particles = scene.particles
        scene = replace(
            scene,
            particles=replace(
                particles,
                position=particles.position[:, kept],
                mass=particles.mass[kept],
                volume=particles.volume[kept],
            ),
        )
        state = mpm.unstressed(scene)
    walls = tuple(replace(w, hold="fixed") if (w.axis, w.side) == (d - 1, "low") else w for w in scene.boundary.walls)
    scene = replace(scene, boundary=replace(scene.boundary, walls=walls))
    vertical = -soil.unit_weight / 9.81 * gravity * (height - scene.particles.position[-1])
    lateral = soil.poisson / (1 - soil.poisson) * vertical
    stress = state.stress.at[0].set(lateral).at[1].set(lateral).at[2].set(vertical)
    ended = mpm.solve(scene, replace(state, stress=stress), t_end=t_end).raise_if_failed()
    arrays = scene.particles.position, ended.state.displacement, scene.particles.volume
    position, displacement, volume = (np.asarray(array, float) for array in arrays)
    return position, displacement, volume


def bui(data: Path, cell: float, converted: bool, finest: bool) -> list[Row]:
    """The bars' surface, front and failure line.

    Args:
        data: folder.
        cell: m.
        converted: whether the source's friction, phi = 19.8 degrees, is that on slip planes, which soil without
            dilation has with sin(phi') = tan(phi) (Davis 1968); else it is the soil's own.
        finest: whether the row counts for the figures.
    """
    start = time.perf_counter()
    folder = data / "bui_2008"
    setup = json.loads((folder / "setup.json").read_text())
    (source_soil,) = (soil for name, soil in setup["soil_by_source"].items() if name.startswith("MaterialPointSolver"))
    width, height = setup["geometry"]["width_m"], setup["geometry"]["height_m"]
    phi = source_soil["phi_deg"]
    if converted:
        phi = math.degrees(math.asin(math.tan(math.radians(phi))))
    soil = mpm.FrictionalSoil(
        0.0,
        phi,
        unit_weight=9.81 * source_soil["density_kg_m3"],
        young=source_soil["young_modulus_Pa"],
        poisson=source_soil["poisson"],
        tension_cutoff=0.0,
        unusual=True,
    )
    position, displacement, volume = released((width, height), 0.8, soil, cell, source_soil["g_m_s2"], 1.0)
    x = (position + displacement)[0]
    measured_x, measured_z = np.loadtxt(folder / "surface.csv", delimiter=",", skiprows=1).T
    edges = np.arange(0.0, 0.8 + STATION / 2, STATION)
    middle, thickness = (edges[1:] + edges[:-1]) / 2, np.histogram(x, edges, weights=volume)[0] / STATION
    apart = np.interp(measured_x, middle, thickness) - measured_z
    apart = apart[(measured_x > middle[0]) & (measured_x < measured_x[-1])]
    line_x, line_z = np.loadtxt(folder / "failure_line.csv", delimiter=",", skiprows=1).T
    still = np.linalg.norm(displacement, axis=0) < MOVED * width
    found = [position[1][still & (np.abs(position[0] - at) < cell)] for at in line_x]
    tops = np.array([z.max() + cell / 4 if z.size else 0.0 for z in found])
    foot = position[0][still & (position[1] < cell / 2)].max() + cell / 4
    name = f"Bui's bars, friction {'on slip planes' if converted else 'of the soil'}"

    def one(
        quantity: str, ours: float, theirs: float, figure: str | None = None, difference: float | None = None
    ) -> Row:
        counts = finest and converted
        return row(name, quantity, ours, theirs, start, cell=cell, figure=figure, finest=counts, difference=difference)

    def front(least: float) -> tuple[float, float]:
        return thick_front(x, volume, least, STATION), float(np.interp(-least, -measured_z, measured_x))

    rms = float(np.sqrt(np.mean(apart**2))) / height
    depth = float(np.sqrt(np.mean((tops - line_z) ** 2))) / height
    return [
        one("surface, rms over the height", rms, 0.0, "bui_surface_rms", rms),
        one("surface, mean over the height", float(np.mean(apart)) / height, 0.0, None, float(np.mean(apart)) / height),
        one("front, a tenth of the height thick (m)", *front(height / 10), "bui_front_error"),
        one("front, 1.6 mm thick (m)", *front(0.0016)),
        one("foremost soil (m)", float(x.max() + cell / 4), float(measured_x[-1])),
        one("failure line, rms over the height", depth, 0.0, None, depth),
        one("failure line, foot (m)", float(foot), float(line_x[-1])),
    ]


def column(data: Path, aspect: float, cell: float, finest: bool, setting: str = RECOMMENDED) -> list[Row]:
    """A quarter of a cylinder of sand: how far its radius grows, where it is a twentieth of the radius thick.

    The cone is that of the source, through the corners of triaxial extension.

    Args:
        data: folder.
        aspect: height over radius.
        cell: m.
        finest: whether the row counts for the figures.
        setting: of SETTINGS.
    """
    start = time.perf_counter()
    folder = data / "sand_columns"
    setup = json.loads((folder / "setup.json").read_text())
    source_soil, radius = setup["soil"], setup["geometry"]["radius_m"]
    soil = mpm.FrictionalSoil(
        0.0,
        source_soil["phi_deg"],
        unit_weight=9.81 * source_soil["density_kg_m3"],
        young=source_soil["young_modulus_Pa"],
        poisson=source_soil["poisson"],
        law=DruckerPrager,
        matching=Matching.EXTENSION,
        tension_cutoff=0.0,
    )
    height = round(aspect * radius / (cell / 2)) * cell / 2
    length = math.ceil((1.5 + 2.0 * aspect) * radius / cell) * cell
    position, displacement, volume = released(
        (radius, radius, height),
        length,
        soil,
        cell,
        setup["g_m_s2"],
        setup["time_s"],
        inside=lambda at: np.hypot(at[0], at[1]) < radius,
        setting=setting,
    )
    r = np.hypot(*(position + displacement)[:2])
    edges = np.arange(0.0, r.max() + cell, cell)
    thickness = np.histogram(r, edges, weights=volume)[0] / (np.pi / 4 * np.diff(edges**2))
    last = int(np.flatnonzero(thickness >= radius / 20)[-1])
    after = thickness[last + 1] if last + 1 < thickness.size else 0.0
    share = (thickness[last] - radius / 20) / (thickness[last] - after)
    front = (last + 0.5 + share) * cell
    at = height / radius

    def one(quantity: str, ours: float, source: str) -> Row:
        aspects, growths = np.loadtxt(folder / f"{source}.csv", delimiter=",", skiprows=1).T
        theirs = float(np.interp(at, aspects, growths))
        name = f"column of sand, aspect {at:.3g}" + ("" if setting == RECOMMENDED else f", {setting}")
        return row(name, quantity, ours, theirs, start, cell=cell, finest=finest)

    return [
        one("growth of the radius, measured", front / radius - 1, "measured"),
        one("growth of the radius, curve", front / radius - 1, "reference_curve"),
        one("foremost soil, measured", float(r.max()) / radius - 1, "measured"),
    ]


def cases(data: Path, quick: bool) -> dict[str, Made]:
    """The cases by name."""
    made: dict[str, Made] = {}
    cells = (0.005,) if quick else (0.005, 0.0025)
    for cell in cells:
        for converted in (True, False):
            made[f"bui {cell} {converted}"] = partial(bui, data, cell, converted, cell == cells[-1])
    for aspect in CHOSEN_BY[:1] if quick else (*CHOSEN_BY, 1.25, 4.0):
        made[f"column {aspect}"] = partial(column, data, aspect, 0.2 if quick else 0.1, True)
    for aspect, setting in itertools.product(CHOSEN_BY[:1] if quick else CHOSEN_BY, OTHERS):
        made[f"column {aspect} {setting.replace('/', ' over ')}"] = partial(
            column, data, aspect, 0.2 if quick else 0.1, False, setting
        )
    return made
