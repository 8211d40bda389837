"""Collapse of a column of dry sand in the plane, released at once beside a smooth wall."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import TypedDict

import jax.numpy as jnp
import numpy as np

import jaxmpm as mpm
from jaxmpm import diagnostics
from jaxmpm.laws import DruckerPrager, MohrCoulomb
from jaxmpm.protocols import Kernel

WEIGHT, GRAVITY = 16e3, 9.81
SLIDING = 0.6
"""Sand that flows carries 0.6 of the normal stress as shear, its angle being some 31 degrees."""
FRICTION = float(np.arcsin(SLIDING))
"""In plane flow without dilation a slip plane carries the sine of the friction angle, not its tangent (Davis 1968)."""


class Numerics(TypedDict, total=False):
    """Choices of a `jaxmpm.Discretisation`."""

    kernel: type[Kernel]
    scheme: mpm.Scheme
    cfl: float
    flip: float
    pic_damping: float
    xpic: int
    apic: bool
    fbar: bool
    cell_average: bool


DEFAULTS: Numerics = {}
Criterion = type[MohrCoulomb] | type[DruckerPrager]


def collapsed(aspect: float, cells: int) -> dict[str, float]:
    """Run-outs over the initial width of a column, as `collapse`: of its farthest grain, and of 95 % of it; the speed
    left over sqrt(g H); seconds.
    """
    start = time.perf_counter()
    scene, final = collapse(aspect, cells)
    edges = np.asarray(diagnostics.position(scene, final)[0]) + 1 / cells / 4
    return {
        "front": float(edges.max()) - 1,
        "front_of_95_percent": float(np.quantile(edges, 0.95)) - 1,
        "speed_left": float(diagnostics.speed(scene, final)) / np.sqrt(GRAVITY * aspect),
        "seconds": time.perf_counter() - start,
    }


def collapse(
    aspect: float,
    cells: int,
    *,
    criterion: Criterion = MohrCoulomb,
    gap_memory: bool = True,
    numerics: Numerics = DEFAULTS,
    start: int = 0,
) -> tuple[mpm.Scene, mpm.State]:
    """A column `aspect` times as high as wide, and its state at the end of its collapse.

    The width is 1 m in `cells` cells, the base as rough as the sand. APIC, since it leaves no ringing and has no share
    of PIC to choose; the energy that it loses shortens the front on coarse cells. Raises FloatingPointError where the
    run breaks off.

    Args:
        aspect: height over width.
        cells: over the width.
        criterion: class of the law.
        gap_memory: as for `jaxmpm.FrictionalSoil`.
        numerics: choices in place of these.
        start: seed of speeds of 1e-5 sqrt(g 1 m) at the start, which show how rounding grows; 0 for rest.
    """
    cell, height = 1 / cells, float(aspect)
    soil = mpm.FrictionalSoil(
        cohesion=0.0,
        friction=float(np.degrees(FRICTION)),
        unit_weight=WEIGHT,
        young=50 * WEIGHT * height,
        law=criterion,
        tension_cutoff=0.0,
        gap_memory=gap_memory,
    )
    choices = mpm.Discretisation(cell, (cell / 2,) * 2, kernel=mpm.QuadraticBSpline, apic=True, flip=0.0)
    scene, state = mpm.block(
        (1.0, height),
        soil,
        replace(choices, **numerics),
        domain=(float(np.ceil((1 + 2 * height) * cells)) / cells, height + 2 * cell),
        corner=(0.0, 0.0),
        gravity=(0.0, -GRAVITY),
        walls="roller",
        speed=float(np.sqrt(2 * GRAVITY * height)),
    )
    walls = tuple(replace(w, hold="friction") if (w.axis, w.side) == (1, "low") else w for w in scene.boundary.walls)
    vertical = -WEIGHT * (height - scene.particles.position[1])
    lateral = 0.3 / 0.7 * vertical
    stress = state.stress.at[0].set(lateral).at[1].set(lateral).at[2].set(vertical)
    scene = replace(scene, boundary=replace(scene.boundary, walls=walls, friction=jnp.asarray(SLIDING, stress.dtype)))
    if start:
        noise = 1e-5 * np.sqrt(GRAVITY) * np.random.default_rng(start).standard_normal(state.velocity.shape)
        state = replace(state, velocity=state.velocity + jnp.asarray(noise, stress.dtype))
    ended = mpm.solve(scene, replace(state, stress=stress), t_end=5 * float(np.sqrt(height / GRAVITY)))
    return scene, ended.raise_if_failed().state
