"""A slide over a real terrain model: error against cell and seconds.

The model is the one that matplotlib ships, of steps of some 74 by 93 m: it is in degrees, which the package refuses,
and is projected to metres first. The window is the steepest slope above a level floor in it. What slides is made up:
clay above a slip surface that leaves the slope at its foot and steepens upwards to a scar below the top, 27 m thick in
the mean and 52 m at most. One particle a cell, which locks least.

With rock as a layer no cell tried is fine enough for the mean travel: rock and clay share the nodes at the slip
surface, so that about a cell's thickness of clay stays behind on it. With the slip surface as a contact it converges
(`benchmarks.accuracy.runout_convergence`).
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from matplotlib.cbook import get_sample_data
from scipy.interpolate import RegularGridInterpolator

import jaxmpm as mpm
from cooperative.measure import OpenGround, consequences, walls_reached
from jaxmpm import Layer, Soil, Terrain

METRES_PER_DEGREE = 111_195.0
CORNER, SIZE = (22_674.0, 14_128.0), (576.0, 384.0)
"""South-west corner of the window from that of the model, and its edges, along x and y (m)."""

STEP = 6.0
"""Of the projected heights (m)."""

BASE = -24.0
"""Height of the rigid base above the floor (m)."""

FOOT, REACH, RISE = 268.0, 225.0, 120.0
"""x at which the slip surface leaves the ground, its length from there, and its rise over that length (m)."""

HALF_WIDTH, SIDES = 85.0, 60.0
"""Half the width of the slip surface, and how far it has risen there (m)."""

STRENGTH = 50e3
CLAY = Soil(strength=STRENGTH, young=5e7, tension_cutoff=0.0)
ROCK = Soil(strength=1e8, young=5e7, tension_cutoff=0.0, unusual=True)
T_END = 40.0


def surface() -> mpm.Raster:
    """The window's heights above its floor, in metres."""
    data: Any = get_sample_data("jacksboro_fault_dem.npz")
    with data:
        heights, dx, dy = data["elevation"][::-1].T.astype(float), float(data["dx"]), float(data["dy"])
        # Its ymin and ymax are swapped.
        latitude = (float(data["ymin"]) + float(data["ymax"])) / 2
    scale = METRES_PER_DEGREE * np.array([np.cos(np.radians(latitude)), 1.0])
    x, y = (np.arange(n) * d * s for n, d, s in zip(heights.shape, (dx, dy), scale, strict=True))
    at = (start + np.arange(round(size / STEP) + 1) * STEP for start, size in zip(CORNER, SIZE, strict=True))
    window = RegularGridInterpolator((x, y), heights)(tuple(np.meshgrid(*at, indexing="ij")))
    return mpm.Raster(window - window.min(), (0.0, 0.0), STEP)


def slip(ground: mpm.Raster) -> mpm.Raster:
    """The slip surface; the ground where nothing slides."""
    x, y = (np.arange(n) * STEP for n in ground.heights.shape)
    along, across = np.meshgrid((x - FOOT) / REACH, (y - SIZE[1] / 2) / HALF_WIDTH, indexing="ij")
    scar = 3.0 + RISE * np.maximum(along, 0) ** 4 + SIDES * across**6
    heights = np.where(along < 0, ground.heights, np.minimum(ground.heights, scar))
    return mpm.Raster(heights, ground.corner, STEP)


def slide(cell: float, *, contact: bool = False) -> dict[str, Any]:
    """The slide on cells of this size (m).

    `travel_m` is the displacement of the centre of the clay, `runout_m` from the rear of the mass before to its front.

    Args:
        cell: edge of the cells (m).
        contact: rock is rigid and the slip surface a contact with the clay's strength, instead of a layer of rock.
    """
    start = time.perf_counter()
    ground = surface()
    if contact:
        shape = Terrain(ground, base=BASE, bedrock=slip(ground), interface=mpm.Interface(0.0, cohesion=STRENGTH))
        layers = [Layer(CLAY)]
    else:
        shape = Terrain(ground, base=BASE)
        layers = [Layer(CLAY, slip(ground)), Layer(ROCK)]
    numerics = mpm.Discretisation(cell, (cell,) * 3, cfl=0.9, cell_average=True, dtype="float32")
    scene, state = mpm.terrain(shape, layers, numerics)
    final = mpm.solve(scene, state, t_end=T_END).raise_if_failed().state
    distance, position = np.asarray(final.displacement, float), np.asarray(scene.particles.position, float)
    volume, half, reach = np.asarray(scene.particles.volume, float), np.full(3, cell / 2), 1.5 * cell
    above = OpenGround(shape.heights(*position[:2]))
    result = consequences(position, distance, volume, above, half_size=half, reach=reach)
    clay = shape.layer_of(layers, position, numerics) == 0
    ends = [(axis, side, (0.0, SIZE[axis])[side > 0]) for axis in (0, 1) for side in (-1, 1)]
    reached = walls_reached(
        position, distance, volume, ends, half_size=half, failure_displacement=1.0, within=cell, reach=reach
    )
    return {
        "case": "real terrain",
        "cell_m": cell,
        "particles": volume.size,
        "clay_m3": round(float(volume[clay].sum())),
        "travel_m": round(
            float(np.linalg.norm((distance[:, clay] * volume[clay]).sum(axis=1)) / volume[clay].sum()), 2
        ),
        "runout_m": round(result.runout, 1),
        "runout_foremost_m": round(result.runout_foremost, 1),
        "displacement_m": round(result.displacement, 1),
        "depth_m": round(result.depth, 1),
        "volume_m3": round(result.volume),
        "area_m2": round(result.area),
        "walls_reached": reached or "none",
        "seconds": round(time.perf_counter() - start, 1),
    }
