"""Earthquakes against closed forms: Newmark's sliding block, the infinite slope, and a layer shaken at its base.

Slopes lie along the grid and gravity is tilted. Sides are tied, so that a layer of two cells stands for an endless one.
Ends without walls, which need no sides alike, stand beside them (`earthquakes_ends`).
Sources: Newmark (1965), 10.1680/geot.1965.15.2.139 (the block); Kramer (1996), Geotechnical Earthquake Engineering,
section 7.2.1 (the layer).
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np

import jaxmpm as mpm
from benchmarks.accuracy import earthquakes_ends
from benchmarks.measure import Report

GRAVITY = 9.81
TILT, FRICTION = math.radians(10.0), 0.27786
YIELD = FRICTION * math.cos(TILT) - math.sin(TILT)
"""Acceleration over gravity at which the block slides down the plane: 0.1. Up it would be 0.447."""
AMPLITUDE = 0.3
PULSE, PERIOD = 0.5, 1.0


def rectangular(t: np.ndarray) -> np.ndarray:
    """Push down the plane over gravity: a pulse."""
    return AMPLITUDE * (t < PULSE)


def harmonic(t: np.ndarray) -> np.ndarray:
    """One full cycle, the half down the plane first."""
    return AMPLITUDE * np.sin(2 * np.pi * t / PERIOD) * (t < PERIOD)


def slid(push: Callable[[np.ndarray], np.ndarray], t_end: float) -> float:
    """Newmark's block: how far it slides (m), by its equation of motion in steps of 1e-5 s."""
    dt = 1e-5
    speed = distance = 0.0
    for a in (push(np.arange(0, t_end, dt) + dt / 2) - YIELD) * GRAVITY:
        speed = max(speed + a * dt, 0.0)
        distance += speed * dt
    return distance


def block(
    cell: float,
    young: float,
    *,
    tilt: float = TILT,
    friction: float = FRICTION,
    length: float = 8.0,
    scheme: mpm.Scheme = mpm.Scheme.MUSL,
) -> tuple[mpm.Scene, mpm.State]:
    """An elastic block 2 m long and 1 m high at rest on a plane of this tilt (rad), before its friction has to hold it.

    The state is that of the block glued to the plane: set down free of stress it would fall on it, and ring undamped.
    length: of the plane (m).
    """
    soil = mpm.Soil(unit_weight=20e3, young=young, poisson=0.0)
    numerics = mpm.Discretisation(cell, (cell / 2,) * 2, scheme=scheme)
    pull = (GRAVITY * math.sin(tilt), -GRAVITY * math.cos(tilt))
    scene, state = mpm.block(
        (2.0, 1.0), soil, numerics, domain=(length, 2.0), corner=(2.0, 0.0), gravity=pull, walls="fixed", speed=10.0
    )
    resting = mpm.at_rest(scene)
    floor = replace(scene.boundary.walls[2], hold="friction")
    coefficient = jnp.asarray(friction, state.stress.dtype)
    boundary = replace(scene.boundary, walls=(floor,), friction=coefficient)
    return replace(scene, boundary=boundary), replace(state, stress=resting.stress)


def newmark_row(name: str, push: Callable[[np.ndarray], np.ndarray], exact: float, *, cell: float, young: float) -> Any:
    """The block's mean displacement after it has come to rest, against the closed form."""
    start, t_end, interval = time.perf_counter(), 2.5, 1e-3
    scene, state = block(cell, young)
    times = np.arange(0, t_end, interval)
    acceleration = np.stack(
        [-push(times) * GRAVITY, np.zeros_like(times)]
    )  # the base moves up, the block is left behind
    dtype = state.stress.dtype
    motion = mpm.BaseMotion(jnp.asarray(acceleration, dtype), jnp.asarray(interval, dtype))
    result = mpm.solve(replace(scene, loads=replace(scene.loads, motion=motion)), state, t_end=t_end).raise_if_failed()
    answer = float(jnp.mean(result.state.displacement[0]))
    return {
        "case": f"Newmark's block, {name}",
        "cell_m": cell,
        "young_Pa": young,
        "reference": round(float(exact), 5),
        "found": round(answer, 5),
        "error": round(float(answer / exact) - 1, 5),
        "seconds": round(time.perf_counter() - start, 1),
    }


def newmark_rows(quick: bool) -> Iterator[dict[str, Any]]:
    """Both pulses."""
    k, cell, young = YIELD, 0.5 if quick else 0.25, 1e8 if quick else 1e9
    exact = AMPLITUDE * (AMPLITUDE - k) * GRAVITY * PULSE**2 / (2 * k)
    yield newmark_row("rectangular pulse", rectangular, exact, cell=cell, young=young)
    yield newmark_row("one cycle of a sine", harmonic, slid(harmonic, 2.5), cell=cell, young=young)


def infinite_slope_row(k: float, quick: bool) -> dict[str, Any]:
    """Dry sand at 20 degrees with 30 degrees of friction: its factor of safety under k, by the limit load.

    The sand dilates as much as it has friction, without which it is weaker on planes along the slope than tan(phi).
    """
    start = time.perf_counter()
    tilt, friction = math.radians(20.0), math.radians(30.0)
    along = math.sin(tilt) + k * math.cos(tilt)
    across = math.cos(tilt) - k * math.sin(tilt)
    exact = across * math.tan(friction) / along
    soil = mpm.FrictionalSoil(0.0, 30.0, dilation=30.0, unit_weight=18e3, young=1e8)
    numerics = mpm.Discretisation(1.0, (0.5, 0.5), flip=0.9)
    layer = mpm.Section([(0, 5), (2, 5)])
    scene, state = mpm.section(
        layer, soil, numerics, gravity=GRAVITY * across, k_h=along / across, ends="tied", speed=3.0
    )
    answer = mpm.factor_of_safety(
        scene,
        state,
        criterion="limit load",
        bracket=(0.85 * exact, 1.15 * exact),
        resolution=0.02 if quick else 0.01,
        t_end=6.0,
    )
    assert answer.kink is not None
    return {
        "case": f"infinite slope, k = {k:g}",
        "reference": round(exact, 4),
        "found": round(answer.kink, 4),
        "error": round(answer.kink / exact - 1, 4),
        "seconds": round(time.perf_counter() - start, 1),
    }


LAYER, DENSITY, SHEAR_WAVE, DAMPING_RATIO = 20.0, 2000.0, 200.0, 0.019


def amplification(frequency: float) -> float:
    """Surface over base acceleration of a uniform layer on rock, its damping small and in proportion to mass."""
    ratio = 2 * math.pi * frequency * LAYER / SHEAR_WAVE
    return 1 / math.sqrt(math.cos(ratio) ** 2 + (DAMPING_RATIO * ratio) ** 2)


def shear_layer_row(share: float, quick: bool, ends: Literal["tied", "free field"] = "tied") -> dict[str, Any]:
    """A layer on rock shaken by a sine of `share` of its own frequency: amplitude of its surface over that of the base.

    The record starts slowly, so that the layer's own oscillation is small; what is left of it is fitted beside.
    """
    start = time.perf_counter()
    resonance = SHEAR_WAVE / (4 * LAYER)
    frequency, amplitude, cell = share * resonance, 1.0, 2.0 if quick else 1.0
    omega = 2 * math.pi * frequency
    young = 2 * DENSITY * SHEAR_WAVE**2 * 1.3
    soil = mpm.Soil(unit_weight=DENSITY * GRAVITY, young=young, poisson=0.3)
    numerics = mpm.Discretisation(cell, (cell / 2,) * 2, damping=2 * omega * DAMPING_RATIO)
    interval, settled, t_end = 0.005, 8.0 / (omega * DAMPING_RATIO), 8.0 / (omega * DAMPING_RATIO) + 6 / frequency
    times = np.arange(0, t_end + 1, interval)
    ramp = np.minimum(times / (settled / 2), 1)
    shaking = amplitude * ramp * np.sin(omega * times)
    motion = mpm.BaseMotion(jnp.asarray(np.stack([shaking, 0 * shaking])), jnp.asarray(interval))
    scene, state = mpm.section(
        mpm.Section([(0, LAYER), (2 * cell, LAYER)]), soil, numerics, ends=ends, motion=motion, speed=1.0
    )
    looks = np.linspace(settled, t_end, 241)
    result = mpm.solve(scene, state, t_end=t_end, snapshots=looks.tolist()).raise_if_failed()
    top = np.asarray(scene.particles.position[1]) > LAYER - cell / 2
    # The uppermost particles stand a quarter of a cell below the surface, where the mode is a little smaller.
    depth = LAYER - float(np.asarray(scene.particles.position[1])[top].mean())
    at = np.array([int(one.step) for one in result.snapshots]) * float(scene.numerics.time_step)
    distance = np.array([np.asarray(one.displacement[0])[top].mean() for one in result.snapshots], float)
    waves = [f(2 * math.pi * rate * at) for rate in {frequency, resonance} for f in (np.sin, np.cos)]
    sine, cosine, *_ = np.linalg.lstsq(np.stack(waves, axis=1), distance, rcond=None)[0]
    base = -amplitude / omega**2
    answer = math.hypot(sine + base, cosine) / abs(base)
    exact = amplification(frequency) * math.cos(omega * depth / SHEAR_WAVE)
    return {
        "case": f"layer on rock shaken at {share:g} of its own frequency, ends: {ends}",
        "cell_m": cell,
        "reference": round(exact, 4),
        "found": round(answer, 4),
        "error": round(answer / exact - 1, 4),
        "seconds": round(time.perf_counter() - start, 1),
    }


def run(quick: bool) -> Report:
    """All cases in float64; each named figure is the largest error of its cases."""
    with jax.enable_x64(True):
        newmark = list(newmark_rows(quick))
        slopes = [infinite_slope_row(k, quick) for k in (0.0, 0.1)]
        layers = [shear_layer_row(share, quick) for share in ((0.5,) if quick else (0.5, 0.8, 1.0))]
        layers.append(shear_layer_row(0.5, quick, "free field"))
        ends = list(earthquakes_ends.rows(quick))
    values = {
        "newmark_rectangular_error": abs(newmark[0]["error"]),
        "newmark_harmonic_error": abs(newmark[1]["error"]),
        "infinite_slope_error": max(abs(row["error"]) for row in slopes),
        "shear_layer_error": max(abs(row["error"]) for row in layers),
        "sent_back_by_ends": max(row["sent_back"] for row in ends if "sent_back" in row),
    }
    return Report(values, [*newmark, *slopes, *layers, *ends])
