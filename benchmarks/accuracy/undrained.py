"""Pore pressure that strain makes, against closed forms: an element, a column and a block that slides on loose soil."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxmpm as mpm
from benchmarks.measure import Report
from jaxmpm.laws import excess_pressure
from jaxmpm.tensors import expand

Row = dict[str, Any]

YOUNG, WEIGHT, GRAVITY = 1e7, 20e3, 9.81
LOOSE = mpm.FrictionalSoil(
    0.0, 24.0, dilation=-3.0, young=YOUNG, unit_weight=WEIGHT, b_value=0.9, law=mpm.laws.DruckerPrager, unusual=True
)
BULK = YOUNG / (3 * (1 - 2 * LOOSE.poisson))


def run(quick: bool) -> Report:
    """All cases; the figure is the error of the finest row of each."""
    rows = list(undrained_rows(quick))
    finest = {row["case"]: row["error"] for row in rows}
    names = "element_pressure_error", "column_pressure_error", "sliding_block_error"
    return Report(dict(zip(names, finest.values(), strict=True)), rows)


def undrained_rows(quick: bool) -> Iterator[Row]:
    """Excess pressure of finer and finer runs in float64, with the CPU seconds of a second call."""
    with jax.enable_x64(True):
        for steps in (50, 200) if quick else (50, 200, 800):
            yield _row("undrained triaxial test", {"steps": steps}, partial(element_error, steps))
        for cell in (1.0, 0.5) if quick else (1.0, 0.5, 0.25):
            yield _row("column, weight doubled at once", {"cell": cell}, partial(column_error, cell))
        for cell in (1.0,) if quick else (1.0, 0.5):
            yield _row("block on a loose layer of a cell", {"cell": cell}, partial(block_error, cell))


def _row(case: str, size: Row, error: Callable[[], float]) -> Row:
    error()
    start = time.process_time()
    found = error()
    return {"case": case, **size, "error": float(f"{found:.3g}"), "seconds": round(time.process_time() - start, 3)}


def element_error(steps: int) -> float:
    """Pressure after 3 % of axial strain under a held cell pressure, beyond yield of soil that contracts."""
    soil, start = replace(LOOSE, matching=mpm.laws.Matching.COMPRESSION), 100e3
    law = soil.material(np.dtype(float), 1.0)
    assert isinstance(law, mpm.laws.Saturated)
    run = mpm.laws.element_test(law, "triaxial drained", pressure=start, strain=0.03, steps=steps)
    sine, dilating, b, shear = (
        math.sin(math.radians(LOOSE.friction)), math.sin(math.radians(LOOSE.dilation)), float(law.b_value),
        float(law.shear),
    )  # fmt: skip
    slope, growth = 6 * sine / (3 - sine), 6 * dilating / (3 - dilating)
    share = 1 - slope * (1 - b) / 3
    hardening = slope * b * BULK * growth / share
    strain = float(run.axial_strain[-1] - run.volumetric_strain[-1] / 3)
    peak = slope * start / share
    q = peak + 3 * shear * hardening / (3 * shear + hardening) * (strain - peak / (3 * shear))
    expected = start + q / 3 - q / slope
    return abs(float(law.excess_pressure(run.history)[-1]) / expected - 1)


def column_error(cell: float) -> float:
    """Pressure in the cells of a column of elastic soil whose weight has doubled at once, at rest again."""
    soil = replace(LOOSE, cohesion=1e6, dilation=0.0)
    numerics = mpm.Discretisation(cell, (cell / 2,), damping=20.0, dtype="float64")
    scene, state = mpm.column(4.0, soil, numerics)
    scene = replace(scene, loads=replace(scene.loads, gravity=2 * scene.loads.gravity))
    end = mpm.solve(scene, state, t_end=1.0).raise_if_failed().state
    law = scene.material
    depth = 4.0 - np.asarray(scene.particles.position)[0]
    expected = float(law.water_modulus / law.p_wave_modulus) * WEIGHT * depth
    off = (_excess(scene, end) - expected).reshape(-1, 2).mean(1)  # strain is that of the cell
    return float(np.abs(off).max() / expected.max())


def block_error(cell: float) -> float:
    """Slip after 0.7 s of a block 8 cells thick on a layer of one, from a / w^2 (cosh w t - 1)."""
    theta, end, block = math.radians(26), 0.7 * math.sqrt(cell), 8 * cell
    rock = mpm.Soil(unit_weight=WEIGHT, young=2e8, k0=1.0)
    layers = [mpm.Layer(rock, bottom=[(0, cell), (2 * cell, cell)]), mpm.Layer(replace(LOOSE, k0=1.0))]
    level = mpm.Section([(0, block + cell), (2 * cell, block + cell)], base=0)
    numerics = mpm.Discretisation(cell, (cell / 2, cell / 2), dtype="float64")
    scene, _ = mpm.section(level, layers, numerics, ends="tied")
    down = GRAVITY * jnp.asarray([math.sin(theta), -math.cos(theta)])
    scene = replace(scene, loads=replace(scene.loads, gravity=down))
    state = mpm.solve(scene, mpm.at_rest(scene), t_end=end).raise_if_failed().state
    slip = float(np.asarray(state.displacement)[0][np.asarray(scene.particles.position)[1] > 2 * cell].mean())
    sine, dilating = math.sin(math.radians(LOOSE.friction)), math.sin(math.radians(LOOSE.dilation))
    matched = 1 / math.sqrt(1 + dilating**2 / 3)
    slope = sine / (matched + sine * dilating * matched / 3)
    mass = WEIGHT / GRAVITY * (block + cell / 2)
    rate = math.sqrt(slope * 0.9 * BULK * -dilating * matched / cell / mass)
    start = GRAVITY * (math.sin(theta) - slope * math.cos(theta))
    time_taken = int(state.step) * float(scene.numerics.time_step)
    return abs(slip / (start / rate**2 * (math.cosh(rate * time_taken) - 1)) - 1)


def _excess(scene: mpm.Scene, state: mpm.State) -> np.ndarray:
    return np.asarray(excess_pressure(scene.material, state.history, expand(state.stress, scene.grid.dimension)))
