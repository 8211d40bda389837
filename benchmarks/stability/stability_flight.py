"""Stability cases of free flight, impact and separation."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxmpm as mpm
from benchmarks.stability.stability_case import CLOSED, NUMERICS, Row, energy_row, judged, metered_run
from jaxmpm import diagnostics


def flight_rows(quick: bool) -> Iterator[Row]:
    """Free flight, impact, separation.

    The nodes on the rock stop at once, and the mass they hold, of half a cell, loses its energy: that bounds the loss.
    """
    fall, stiff = (10.0 if quick else 50.0), mpm.Soil(unit_weight=9810.0, young=1e9)
    cell = 0.5 if quick else 0.25

    def drop(soil: mpm.Soil, **choices: Any) -> tuple[mpm.Scene, mpm.State]:
        numerics = mpm.Discretisation(cell, (cell / 2,) * 2, **choices)
        domain, gravity = (8, fall + 4), (0, -9.81)
        return mpm.block(
            (2, 2), soil, numerics, domain=domain, corner=(3, fall), gravity=gravity, walls="fixed", speed=40.0
        )

    scene, state = drop(stiff)
    dt = float(scene.numerics.time_step)
    # The lowest particles feel the floor from two cells above.
    falling = mpm.advance(scene, state, jnp.asarray(int(np.sqrt(2 * (fall - 2) / 9.81) / dt)))
    error = float(jnp.max(jnp.abs(falling.velocity[1] / (-9.81 * int(falling.step) * dt) - 1)))
    yield judged(f"free fall of {fall:g} m: momentum before impact", error, 1e-4, "relative")
    seconds = 1.2 * float(np.sqrt(2 * fall / 9.81))
    stopped = cell / (2 * 2.0)
    yield energy_row(f"free fall of {fall:g} m, impact on rock and rebound, E = 1e9 Pa", scene, state, seconds, stopped)
    soft = replace(stiff, young=1e8)
    clay = replace(soft, strength=50e3, softening_modulus=40e3, tension_cutoff=0.0)
    # At 31 m/s a wave of 370 m/s strains the soil by a tenth. The step's error is of second order, and too large at CFL
    # 0.5; what hypoelastic laws add to it stays however short the step.
    violent: dict[str, Any] = {"finite_strain": True, "cfl": 0.25}
    others: dict[str, dict[str, Any]] = {
        "with_rates": {"cfl": 0.25},
        "with_CFL_0.5": {"finite_strain": True},
        "with_rates_and_CFL_0.5": {},
    }
    for name, soil in (("the same, E = 1e8 Pa: strains of 0.1", soft), (f"clay that falls {fall:g} m onto rock", clay)):
        row = energy_row(f"{name}, Hencky strains, CFL 0.25", *drop(soil, **violent), seconds, stopped)
        yield row | {
            other: energy_row(name, *drop(soil, **choices), seconds, stopped)["figure"]
            for other, choices in others.items()
        }
    for precise in (False,) if quick else (False, True):
        with jax.enable_x64(precise):
            yield from separation_rows(4.0 if quick else 8.0)


def separation_rows(seconds: float) -> Iterator[Row]:
    """A body without tensile strength torn in two, whose halves come back from the walls."""
    soil = mpm.Soil(unit_weight=9810.0, young=1e7, strength=2e3, softening_modulus=1e3, tension_cutoff=0.0)
    scene, state = mpm.block((4, 2), soil, NUMERICS, domain=(16, 4), corner=(6, 1), walls="roller", speed=2.0)
    away = jnp.where(scene.particles.position[0] < 8.0, -2.0, 2.0)
    state = replace(state, velocity=state.velocity.at[0].set(away))
    dtype = scene.numerics.time_step.dtype
    energy = float(diagnostics.kinetic_energy(scene, state))
    case = f"torn apart, back from the walls, in contact again, {dtype}"
    row = energy_row(case, scene, state, seconds, CLOSED, over=energy)
    total = float(jnp.sum(scene.particles.mass)) * 2.0
    final, _ = metered_run(scene, state, round(seconds / float(scene.numerics.time_step)))
    halfway, _ = metered_run(scene, state, round(1.5 / float(scene.numerics.time_step)))
    x = diagnostics.position(scene, halfway)[0]
    gap = float(jnp.min(jnp.where(away > 0, x, jnp.inf)) - jnp.max(jnp.where(away < 0, x, -jnp.inf)))
    yield row | {"gap_m": round(gap, 2)}
    momentum = abs(float(diagnostics.momentum(scene, final)[0])) / total
    yield judged(f"{case}: momentum made", momentum, 1e-3 if dtype == jnp.float32 else 1e-6, "of either half's")
