"""The Frank slide of 1903 on its terrain, beside SHALTOP's depth-averaged run with one basal friction.

The raster is taken as published: the pile thins out to nothing on a slope of up to 70 degrees. The pile is dry sand
whose own friction phi has sin(phi) = tan(delta), as in the dam breaks on a bed with friction; nothing is fitted.
"""

from __future__ import annotations

import json
import math
import time
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

import jaxmpm as mpm
from benchmarks.measure import on_cores
from benchmarks.public.rows import Row, row

Made = Callable[[], list[Row]]
STEP = 20.0
"""Of the rasters (m)."""
DENSITY, YOUNG, FASTEST = 2000.0, 5e7, 120.0


def published(data: Path) -> tuple[np.ndarray, np.ndarray]:
    """The bed (m) and the pile's vertical thickness (m), x and y from the south-western corner."""
    with np.load(data / "frank_slide" / "rasters.npz") as file:
        bed, pile = (file[name][::-1].T.astype(float) for name in ("bed_m", "pile_vertical_m"))
    return bed, pile


def built(
    bed: np.ndarray, pile: np.ndarray, delta: float, cell: float, *, at_rest: bool = True
) -> tuple[mpm.Scene, mpm.State]:
    """The pile, at rest or free of stress, on its bed with friction `delta` (degrees), on cells of this size (m)."""
    rasters = [mpm.Raster(heights, (0.0, 0.0), STEP) for heights in (bed + pile, bed)]
    base = math.floor(bed.min() / STEP - 1) * STEP
    shape = mpm.Terrain(rasters[0], base=base, bedrock=rasters[1], interface=mpm.Interface(delta))
    phi = math.degrees(math.asin(math.tan(math.radians(delta))))
    soil = mpm.FrictionalSoil(0.0, phi, unit_weight=DENSITY * 9.81, young=YOUNG, tension_cutoff=0.0, unusual=True)
    numerics = mpm.Discretisation(cell, (cell / 2,) * 3, cfl=0.9, dtype="float32")
    return mpm.terrain(shape, soil, numerics, speed=FASTEST, at_rest=at_rest)


def slide(data: Path, delta: int, cell: float, finest: bool) -> list[Row]:
    """Travel of the centroid against time, area that is 1 and 2 m thick, and overlap of the deposits."""
    start, folder = time.perf_counter(), data / "frank_slide"
    published_run = json.loads((folder / "summary.json").read_text())[f"delta_{delta}"]
    series = np.genfromtxt(folder / f"shaltop_delta{delta}_series.csv", delimiter=",", names=True)[1:]
    bed, pile = published(data)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the soil that starts without equilibrium is a millionth
        scene, state = built(bed, pile, delta, cell)
    ended = mpm.solve(scene, state, t_end=float(series["t_s"][-1]), snapshots=series["t_s"].tolist())
    ended.raise_if_failed()
    volume = np.asarray(scene.particles.volume, float)
    moved = [np.asarray(one.displacement, float) for one in ended.snapshots]
    travel = [float(np.linalg.norm((displacement[:2] * volume).sum(axis=1)) / volume.sum()) for displacement in moved]

    def one(
        quantity: str, ours: float, theirs: float, figure: str | None = None, difference: float | None = None
    ) -> Row:
        name = f"Frank slide, {delta} degrees"
        return row(name, quantity, ours, theirs, start, cell=cell, figure=figure, finest=finest, difference=difference)

    rows = [one("volume (Mm3)", volume.sum() / 1e6, published_run["volume_start_m3"] / 1e6)]
    rows += [
        one(f"travel of the centroid at {t:g} s (m)", ours, theirs)
        for t, ours, theirs in zip(series["t_s"][:-1:2], travel[::2], series["centroid_travel_m"][::2], strict=False)
    ]
    rows.append(
        one("travel of the centroid (m)", travel[-1], published_run["centroid_travel_m"], "frank_travel_error_max")
    )
    # Thickness on squares of a cell, each of some of their squares, whose centres are the points of the raster.
    at, times = (np.asarray(scene.particles.position, float) + moved[-1])[:2], round(cell / STEP)
    counts = [n // times for n in bed.shape]
    edges = [np.arange(n + 1) * cell - STEP / 2 for n in counts]
    ours = np.histogram2d(at[0], at[1], bins=edges, weights=volume)[0] / cell**2
    with np.load(folder / f"shaltop_delta{delta}.npz") as file:
        deposit = file["thickness_vertical_end_m"][::-1].T.astype(float)
    blocks = deposit[: counts[0] * times, : counts[1] * times].reshape(counts[0], times, counts[1], times)
    theirs = blocks.mean(axis=(1, 3))
    for least in (1.0, 2.0):
        here, there = (float((thickness > least).sum()) * cell**2 / 1e6 for thickness in (ours, theirs))
        rows.append(one(f"area above {least:g} m (km2)", here, there))
    both, either = ((ours > 1) & (theirs > 1)).sum(), ((ours > 1) | (theirs > 1)).sum()
    return [*rows, one("overlap over union of the deposits above 1 m", both / either, 1.0)]


def cost(data: Path, cell: float) -> list[Row]:
    """Cost with nodes near the soil alone, beside that with all nodes as theirs; each in a process of its own."""
    start = time.perf_counter()
    near, every = (
        on_cores(1, "benchmarks.public.frank_cost", str(data), str(cell), nodes) for nodes in ("near", "all")
    )
    named = {
        "setup_cpu_s": "CPU time of set-up (s)",
        "step_us": "CPU time of a step (us)",
        "peak_mb": "peak memory (MB)",
    }
    case = "Frank slide, nodes near soil beside all"
    return [row(case, quantity, near[name], every[name], start, cell=cell) for name, quantity in named.items()]


def cases(data: Path, quick: bool) -> dict[str, Made]:
    """The cases by name."""
    cells = (40.0,) if quick else (40.0, 20.0)
    made: dict[str, Made] = {f"frank cost {cell:g}": partial(cost, data, cell) for cell in cells}
    made |= {
        f"frank {delta} {cell:g}": partial(slide, data, delta, cell, cell == cells[-1])
        for cell in cells
        for delta in (25, 10)
    }
    return made
