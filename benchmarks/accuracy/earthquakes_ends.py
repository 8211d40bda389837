"""Ends without walls: what they send back of waves that meet them, and how the ground shakes beside a slope.

A pulse of P or S waves runs at an end squarely, in soil that nothing else holds. A slope whose ends are not as high
stands on rock and is shaken by a wavelet; how it moves is held against ground so long that nothing comes back in time.
Sources: Lysmer and Kuhlemeyer (1969), 10.1061/JMCEA3.0001144 (dashpots); Ricker (1953), 10.1190/1.1437843 (wavelet).
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import replace
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np

import jaxmpm as mpm

DENSITY, GRAVITY = 2000.0, 9.81
LENGTH, AWAY, WIDTH = 30.0, 10.0, 3.0
"""Of the soil, of the pulse's middle from the end, and of the pulse (m)."""
SPEED = 1e-3
"""Of the pulse (m/s)."""
HEIGHTS = {"P": 4.0, "S": 64.0}
"""Of the soil (m): an S wave is looked at in the middle before anything comes there from the base or the surface."""


def sent_back(wave: Literal["P", "S"], ends: Literal["free field", "roller"], cell: float) -> float:
    """Largest speed after a pulse has met an end and had the time to come back, over that of the pulse."""
    soil = mpm.Soil(unit_weight=DENSITY * GRAVITY, young=2e7, poisson=0.0)
    numerics = mpm.Discretisation(cell, (cell / 2,) * 2)
    ground = mpm.Section([(0, HEIGHTS[wave]), (LENGTH, HEIGHTS[wave])])
    scene, state = mpm.section(ground, soil, numerics, ends=ends, gravity=0.0, speed=1.0)
    x, z = scene.particles.position
    pulse, none = SPEED * jnp.exp(-(((x - LENGTH + AWAY) / WIDTH) ** 2)), jnp.zeros_like(x)
    modulus = scene.material.p_wave_modulus if wave == "P" else scene.material.shear
    celerity = math.sqrt(float(modulus) / DENSITY)
    stress = -DENSITY * celerity * pulse
    if wave == "P":
        lids = [mpm.Wall(1, "low", 1, "roller"), mpm.Wall(1, "high", 1 + round(HEIGHTS[wave] / cell), "roller")]
        sides = (wall for wall in scene.boundary.walls if wall.axis == 0)
        scene = replace(scene, boundary=replace(scene.boundary, walls=(*sides, *lids)))
        state = replace(state, velocity=jnp.stack([pulse, none]), stress=jnp.stack([stress, none, none, none]))
    else:
        state = replace(state, velocity=jnp.stack([none, pulse]), stress=jnp.stack([none, none, none, stress]))
    end = mpm.solve(scene, state, t_end=2 * AWAY / celerity).raise_if_failed().state
    middle = abs(np.asarray(z) - HEIGHTS[wave] / 2) < cell
    return float(abs(np.asarray(end.velocity)[:, middle]).max()) / SPEED


def pulse_row(wave: Literal["P", "S"], cell: float) -> dict[str, Any]:
    """Share of a pulse that an end without a wall sends back, and a roller."""
    start = time.perf_counter()
    return {
        "case": f"pulse of {wave} waves, {WIDTH / cell:g} cells wide",
        "cell_m": cell,
        "sent_back": round(sent_back(wave, "free field", cell), 4),
        "by_a_roller": round(sent_back(wave, "roller", cell), 4),
        "seconds": round(time.perf_counter() - start, 1),
    }


CREST, TOE, FREQUENCY, DAMPING_RATIO, SECONDS = 12.0, 6.0, 4.0, 0.032, 2.0


def shaken(beside: float, ends: Literal["free field", "roller"], cell: float) -> np.ndarray:
    """Velocity (looks, 2) m/s at the crest of a slope, 12 m high there and 6 m at its toe, with so much level ground
    (m) on both sides."""
    soil = mpm.Soil(unit_weight=DENSITY * GRAVITY, young=1e8, poisson=0.3)
    numerics = mpm.Discretisation(cell, (cell / 2,) * 2, damping=4 * math.pi * FREQUENCY * DAMPING_RATIO)
    times = np.arange(0, SECONDS + 0.1, 0.005)
    phase = (math.pi * FREQUENCY * (times - 1.2 / FREQUENCY)) ** 2
    wavelet = (1 - 2 * phase) * np.exp(-phase)
    motion = mpm.BaseMotion(jnp.asarray(np.stack([wavelet, 0 * wavelet])), jnp.asarray(0.005))
    ground = mpm.Section([(-beside, CREST), (0, CREST), (12, TOE), (12 + beside, TOE)])
    scene, state = mpm.section(ground, soil, numerics, ends=ends, motion=motion, speed=1.0)
    looks = np.linspace(0, SECONDS, 41)[1:].tolist()
    result = mpm.solve(scene, state, t_end=SECONDS, snapshots=looks).raise_if_failed()
    x, z = np.asarray(scene.particles.position)
    crest = int(np.argmin(abs(x) + abs(z - CREST)))
    return np.array([one.velocity[:, crest] for one in result.snapshots])


def slope_row(beside: float, cell: float, endless: np.ndarray) -> dict[str, Any]:
    """How far the crest's motion is from that in ground without end, over its largest velocity."""
    start = time.perf_counter()
    errors = {ends: abs(shaken(beside, ends, cell) - endless).max() / abs(endless).max() for ends in ENDS}
    return {
        "case": f"crest of a slope with {beside:g} m of level ground on both sides",
        "cell_m": cell,
        "free_field": round(float(errors["free field"]), 4),
        "rollers": round(float(errors["roller"]), 4),
        "seconds": round(time.perf_counter() - start, 1),
    }


ENDS: tuple[Literal["free field", "roller"], ...] = ("free field", "roller")


def rows(quick: bool) -> Iterator[dict[str, Any]]:
    """Both pulses, and the slope with its ends near and far."""
    with jax.enable_x64(True):
        for wave in ("P", "S"):
            yield pulse_row(wave, 1.0 if quick else 0.5)
        if not quick:
            endless = shaken(520.0, "roller", 1.0)
            for beside in (40.0, 80.0):
                yield slope_row(beside, 1.0, endless)
