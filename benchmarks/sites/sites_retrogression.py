"""A retrogressive slide in sensitive clay, in three readings of its published weight and strength.

Del Castillo, Borja and Favero Neto (2026), International Journal for Numerical and Analytical Methods in Geomechanics,
by smoothed particles 0.1 m apart: a face 5 m high, clay of 15.1 kPa that falls to a tenth of it, whose strength is
divided by 1.65 to set it off. The published run is undrained with the water table on the slope's faces, so the clay has
its buoyant weight: the scene retrogression_5m_buoyant, whose convergence is in `runout_convergence`.

READINGS have the full weight. Slip circles then give the slope a factor of 0.87 at 15.1 kPa, so that it cannot stand
before: 15.1 kPa may be what is left after the division. Of 15.1 kPa slides let go 0.8, 3.1, 5.5, 8.0 and 10.3 s after
the start on cells of 0.25 m, and 0.7, 3.4, 6.1, 8.9 and 11.2 s on cells of 0.5 m. The first three take 14 m behind the
crest, as published, but here two more follow, back to the wall. Of 15.1 / 1.65 kPa the ground lets go in two, and on
cells of 0.5 m at once. What has slid runs out 1.7 times as far as published, and leaves the scarp without
support. The clay bears no tension: else grains that come loose carry it along, which throws them about. Then the slide
of 15.1 kPa runs out 46 m, and over the weaker clay a fifth of the campaign's rough runs leave the grid.
"""

from __future__ import annotations

import math
import time

import numpy as np

import jaxmpm as mpm
from benchmarks.measure import ROOT
from cooperative.measure import OpenGround, ReleaseHistory, consequences
from cooperative.scene import Campaign, built, parse, read_scene

SCENES = ROOT / "benchmarks" / "scenes" / "sites"
READINGS = ("retrogression_5m", "retrogression_5m_divided")
"""Scenes whose strength is 15.1 kPa once it slides, and 15.1 kPa over 1.65."""

PUBLISHED = {"runout_m": 21.6, "retrogression_m": 14.0, "slides": 3}
LETS_GO = 0.1
"""Displacement from which on soil has let go, over the height."""

EVERY = 0.1
"""Seconds between looks."""


def slides(onset: np.ndarray, gravity: float = 9.81, height: float = 5.0) -> int:
    """How many slides took the ground behind the crest, from the times (n,) s at which its columns let go, in their
    order from the crest backwards; inf where one stands.

    Neighbours that let go within the time of a fall through the height (m) under this gravity (m/s2) belong to one
    slide.
    """
    gone = onset[np.isfinite(onset)]
    pause = math.sqrt(2 * height / gravity)
    return int(gone.size > 0) + int((np.abs(np.diff(gone)) > pause).sum())


def _where(x: np.ndarray, volume: np.ndarray, share: float) -> float:
    """Where along x (m) this share of a volume lies behind."""
    order = np.argsort(x)
    return float(x[order[np.searchsorted(np.cumsum(volume[order]) / volume.sum(), share)]])


def slide(scene_name: str, cell: float) -> dict[str, float | str]:
    """The slide of a scene's mean soil on cells of this size (m)."""
    campaign = parse(read_scene(SCENES / f"{scene_name}.toml"))
    grid = next((grid for grid, choices in campaign.grids.items() if choices.cell == cell), None)
    if grid is None:
        raise ValueError(f"cell = {cell:g} m: scene {scene_name} has other grids")
    return {"case": scene_name} | slid(campaign, grid)


def slid(campaign: Campaign, grid: str) -> dict[str, float | str]:
    """The slide of a campaign's mean soil on one of its grids."""
    cell = campaign.grids[grid].cell
    assert isinstance(campaign.site.shape, mpm.Section)
    (_, height), (crest, _), (toe, _), *_ = campaign.site.shape.surface
    lets_go = LETS_GO * height
    start = time.perf_counter()
    scene, state = built(campaign, grid)
    looks = (np.arange(1, round(campaign.run.t_end / EVERY)) * EVERY).tolist()
    result = mpm.solve(scene, state, t_end=campaign.run.t_end, snapshots=looks).raise_if_failed()
    position, volume = np.asarray(scene.particles.position, float), np.asarray(scene.particles.volume, float)
    motion = ReleaseHistory.start(volume, lets_go)
    for at, seen in zip((*result.times, campaign.run.t_end), (*result.snapshots, result.state), strict=True):
        motion = motion.after(at, np.linalg.norm(np.asarray(seen.displacement), axis=0))
    distance = np.asarray(result.state.displacement, float)
    level = OpenGround(np.full(volume.size, height))
    answer = consequences(
        position,
        distance,
        volume,
        level,
        half_size=np.full(2, cell / 4),
        reach=1.5 * cell,
        failure_displacement=lets_go,
        runout_thickness=height / 10,
    )
    # The top row of particles behind the crest, from there backwards.
    top = np.flatnonzero((position[0] < crest) & (position[1] > height - cell / 2))
    onset = motion.onset[top[np.argsort(-position[0, top])]]
    gone = np.asarray(motion.moved) >= lets_go
    rear = float(position[0, gone].min()) - cell / 4 if gone.any() else crest
    behind = toe - rear if gone.any() else 0.0  # run-outs are from where the slide ends, of one that stands 0
    x = (position + distance)[0]
    front, front_of_slid = _where(x, volume, 0.99), _where(x[gone], volume[gone], 0.95) if gone.any() else toe
    return {
        "cell_m": cell,
        "particles": volume.size,
        "strength_kpa": campaign.random["strength"].mean / 1e3,
        "runout_m": round(answer.runout - behind, 2),
        "runout_foremost_m": round(answer.runout_foremost - behind, 2),
        "runout_of_99_percent_m": round(front - toe, 2),
        "runout_of_95_percent_m": round(front_of_slid - toe, 2),
        "retrogression_m": round(crest - rear, 2),
        "slides": slides(onset, campaign.run.gravity, height),
        "published": ", ".join(f"{name} {value:g}" for name, value in PUBLISHED.items()),
        "seconds": round(time.perf_counter() - start, 1),
    }
