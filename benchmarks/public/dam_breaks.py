"""Reservoirs that are let go, against closed forms of shallow water: Ritter, Stoker, and Mangeney's Coulomb friction.

Depth is averaged in the closed forms. Here a continuum in plane strain flows: on a smooth base clay, with a thousandth
of its weight per area as strength; on a base with friction sand whose own friction phi has sin(phi) = tan(delta). Soil
of less friction shears above the base, which the closed form excludes. With that friction the earth pressure of soil
that stretches over the base is the weight above (Savage and Hutter 1989), as the closed form has it.
Close to the gate and to the front, where lengths are depths, the two differ. The front is where the flow is a tenth of
the reservoir deep; the foremost soil stands beside.

Sources: Savage and Hutter (1989), 10.1017/S0022112089000340; Ritter (1892); Stoker (1957), Water Waves; Mangeney,
Heinrich and Roche (2000), 10.1007/s000240050018.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from scipy.optimize import brentq

import jaxmpm as mpm
from benchmarks.accuracy.runout_slides import thick_front
from benchmarks.public.rows import Row, row

Made = Callable[[], list[Row]]
DENSITY = 1000.0
THICK = 0.1
"""Depth of the flow at its front, over that of the reservoir."""


def released(
    depths: tuple[float, float],
    lengths: tuple[float, float],
    cell: float,
    times: list[float],
    *,
    gravity: float,
    slope: float = 0.0,
    friction: float = 0.0,
) -> tuple[np.ndarray, np.ndarray, list[np.ndarray]]:
    """Let a reservoir go.

    Args:
        depths: of the reservoir and of the water ahead (m), 0 for none.
        lengths: of the reservoir and of the bed ahead of it (m).
        cell: m.
        times: to look at (s).
        gravity: m/s2.
        slope: of the bed (radians).
        friction: of the bed, a coefficient.

    Returns:
        Area of the particles (N,) m2, times looked at (s), and x of the particles from the gate at each of them (N,) m.
    """
    h0, ahead = depths
    normal = gravity * math.cos(slope)
    pressure = DENSITY * normal * h0
    soil = (
        mpm.FrictionalSoil(
            0.0,
            math.degrees(math.asin(friction)),
            unit_weight=DENSITY * 9.81,
            young=50 * pressure,
            tension_cutoff=0.0,
            unusual=True,
        )
        if friction
        else mpm.Soil(
            strength=1e-3 * pressure,
            unit_weight=DENSITY * 9.81,
            young=6 * pressure,
            poisson=0.49,
            tension_cutoff=0.0,
            unusual=True,
        )
    )
    numerics = mpm.Discretisation(
        cell, (cell / 2,) * 2, scheme=mpm.Scheme.USL, pic_damping=math.sqrt(normal / h0), xpic=2, cell_average=True
    )
    pull = gravity * math.sin(slope)
    fastest = 2 * math.sqrt(normal * h0) + max(pull - friction * normal, 0) * times[-1]
    scene, state = mpm.block(
        (sum(lengths), h0),
        soil,
        numerics,
        domain=(sum(lengths), h0 + 2 * cell),
        corner=(0.0, 0.0),
        gravity=(pull, -normal),
        walls="roller",
        speed=1.3 * fastest,
    )
    walls = tuple(replace(w, hold="friction") if (w.axis, w.side) == (1, "low") else w for w in scene.boundary.walls)
    x, z = np.asarray(scene.particles.position, float)
    deep = np.where(x < lengths[0], h0, ahead)
    kept = z < deep
    scene, state = _only(scene, state, kept)
    dtype = state.stress.dtype
    weight = jnp.asarray(-DENSITY * normal * (deep - z)[kept], dtype)
    state = replace(state, stress=state.stress.at[:3].set(weight))
    scene = replace(scene, boundary=replace(scene.boundary, walls=walls, friction=jnp.asarray(friction, dtype)))
    ended = mpm.solve(scene, state, t_end=times[-1], snapshots=times).raise_if_failed()
    at = np.array([float(one.step) for one in ended.snapshots]) * float(scene.numerics.time_step)
    start = np.asarray(scene.particles.position[0], float) - lengths[0]
    volume = np.asarray(scene.particles.volume, float)
    return volume, at, [start + np.asarray(one.displacement[0], float) for one in ended.snapshots]


def _only(scene: mpm.Scene, state: mpm.State, kept: np.ndarray) -> tuple[mpm.Scene, mpm.State]:
    """Some of the particles."""
    particles = scene.particles
    fewer = replace(
        particles,
        position=particles.position[:, kept],
        mass=particles.mass[kept],
        volume=particles.volume[kept],
    )
    scene = replace(scene, particles=fewer)
    return scene, mpm.unstressed(scene)


def depth_of(case: dict[str, Any], gravity: float, x: np.ndarray, t: float) -> np.ndarray:
    """Mangeney's depth (m) at x (m) and t (s); Ritter's without slope."""
    c0, m, h0 = case["c0_m_s"], case["m_m_s2"], case["h0_m"]
    fan = (2 * c0 - x / t + m * t / 2) ** 2 / (9 * gravity * math.cos(math.radians(case["slope_deg"])))
    return np.where(x < m * t**2 / 2 - c0 * t, h0, np.where(x > m * t**2 / 2 + 2 * c0 * t, 0.0, fan))


def compared(
    case: str,
    exact: Callable[[np.ndarray], np.ndarray],
    x: np.ndarray,
    area: np.ndarray,
    t: float,
    start: float,
    *,
    h0: float,
    cell: float,
    finest: bool,
    foremost: float | None,
    station: float,
    figure: str | None = None,
) -> list[Row]:
    """The front where the flow is a tenth of the reservoir deep, the foremost soil, and the mean error of the depth.

    The depth is compared ahead of half a reservoir's depth behind the tail, at stations that are averaged in both.
    """
    origin = float(x.min())
    front = thick_front(x - origin, area, THICK * h0, station) + origin
    line = np.linspace(x.min(), 1.5 * (foremost or x.max()), 200_001)
    wet = exact(line)
    theirs = float(line[np.flatnonzero(wet >= THICK * h0)[-1]])
    shown = partial(row, case, cell=cell, finest=finest)
    rows = [shown(f"front at t = {t:.4g} s, a tenth of the depth (m)", front, theirs, start, figure=figure)]
    if foremost is not None:
        rows.append(shown(f"foremost soil at t = {t:.4g} s (m)", float(x.max()), foremost, start))
    edges = np.arange(origin + 2 * h0, line[-1], station)
    thickness = np.histogram(x, bins=edges, weights=area)[0] / station
    middle = np.interp((edges[1:] + edges[:-1]) / 2, line, wet)
    changed = np.abs(middle - h0) > 0.01 * h0
    error = float(np.abs(thickness - middle)[changed].sum() / np.abs(middle)[changed].sum())
    rows.append(shown(f"depth at t = {t:.4g} s, mean error over mean", error, 0.0, start, difference=error))
    return rows


def fan(data: Path, name: str, kind: str, cells: int, finest: bool, last: int) -> list[Row]:
    """Ritter's or Mangeney's reservoir, so many cells deep, up to the time of number `last`."""
    start, values = time.perf_counter(), json.loads((data / "dam_breaks" / "values.json").read_text())
    case, gravity = values[kind], values["gravity_m_s2"]
    times = sorted(float(t) for t in case["front_m"])[: last + 1]
    h0, t = case["h0_m"], times[-1]
    cell = h0 / cells
    slope, delta = math.radians(case["slope_deg"]), math.radians(case["basal_friction_deg"])
    step = 4 * h0
    lengths = (
        math.ceil((2.2 * case["c0_m_s"] * t + h0) / step) * step,
        math.ceil((case["front_m"][str(t)] * 1.15 + h0) / step) * step,
    )
    area, at, moved = released((h0, 0.0), lengths, cell, times, gravity=gravity, slope=slope, friction=math.tan(delta))
    rows = []
    for seconds, x in zip(at, moved, strict=True):
        rows += compared(
            name,
            partial(depth_of, case, gravity, t=seconds),
            x,
            area,
            seconds,
            start,
            h0=h0,
            cell=cell,
            finest=finest,
            station=h0 / 4,
            foremost=case["m_m_s2"] * seconds**2 / 2 + 2 * case["c0_m_s"] * seconds,
            figure="mangeney_front_error" if "Mangeney" in name else None,
        )
    return rows


def middle_depth(h0: float, ahead: float, gravity: float) -> float:
    """Stoker's depth (m) between the fan and the shock."""

    def excess(h: float) -> float:
        shock = (h - ahead) * math.sqrt(gravity * (h + ahead) / (2 * h * ahead))
        return 2 * (math.sqrt(gravity * h0) - math.sqrt(gravity * h)) - shock

    return float(brentq(excess, ahead * (1 + 1e-9), h0))


def stoker(data: Path, cells: int, finest: bool) -> list[Row]:
    """Stoker's reservoir on water, the depth ahead of it `cells` deep."""
    start, values = time.perf_counter(), json.loads((data / "dam_breaks" / "values.json").read_text())
    (case, *_), gravity = values["stoker"], values["gravity_m_s2"]
    h0, ahead = case["h0_m"], case["hr_m"]
    h = middle_depth(h0, ahead, gravity)
    c0, um = math.sqrt(gravity * h0), 2 * (math.sqrt(gravity * h0) - math.sqrt(gravity * h))
    shock, cell, t = h * um / (h - ahead), ahead / cells, 6 * h0 / c0
    step = 4 * h0
    lengths = (math.ceil(2.2 * c0 * t / step) * step, math.ceil(1.4 * shock * t / step) * step)
    area, (t,), (x,) = released((h0, ahead), lengths, cell, [t], gravity=gravity)

    def exact(x: np.ndarray) -> np.ndarray:
        fan = (2 * c0 - x / t) ** 2 / (9 * gravity)
        return np.where(x < -c0 * t, h0, np.where(x > shock * t, ahead, np.clip(fan, h, h0)))

    return compared("Stoker", exact, x, area, t, start, h0=h0, cell=cell, finest=finest, foremost=None, station=h0 / 4)


def cases(data: Path, quick: bool) -> dict[str, Made]:
    """The cases by name."""
    made: dict[str, Made] = {}
    all_cells = (5,) if quick else (5, 10, 20, 40)
    for cells in all_cells:
        finest = cells == all_cells[-1]
        made[f"ritter {cells}"] = partial(fan, data, "Ritter", "ritter", cells, finest, 1)
        made[f"mangeney {cells}"] = partial(
            fan, data, "Mangeney, 20 degrees", "mangeney_delta20", cells, finest, 0 if quick else 2
        )
    for cells in (1,) if quick else (2, 4):
        made[f"stoker {cells}"] = partial(stoker, data, cells, quick or cells == 4)
    return made
