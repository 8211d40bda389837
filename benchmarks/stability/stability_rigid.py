"""Stability cases of bodies that theory takes as rigid: a block on a plane with friction, and a disc that spins.

The block is two cells high and elastic. It starts at rest, in the stress of a block glued to the plane, and is measured
2 s later by the mean displacement of its particles. An undamped elastic block that is set down free of stress rings,
and its friction, which follows the ringing normal force, holds it less.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxmpm as mpm
from benchmarks.accuracy.earthquakes import GRAVITY, block
from benchmarks.stability.stability_case import Row, judged, status_of
from jaxmpm import diagnostics

FALL, REST = 0.02, 1e-3
"""Largest error of a sliding block, of g t^2 / 2, and largest displacement of one that rests (m)."""

SPIN = {"FLIP": 0.45, "APIC": 0.01}
"""Largest share of a disc's angular momentum lost in five turns. FLIP's is what it loses, a known limit: the grid keeps
none of the rotation within a cell, which APIC's particles carry."""


def sliding_rows(quick: bool) -> Iterator[Row]:
    """Planes of 20 and 30 degrees, whose tangents are 0.364 and 0.577, and friction on either side of them."""
    for degrees in (30,) if quick else (20, 30):
        for friction in (0.5, 0.6) if quick else (0.3, 0.35, 0.4, 0.5, 0.55, 0.6, 0.7):
            yield sliding_row(degrees, friction)


def sliding_row(degrees: float, friction: float, scheme: mpm.Scheme = mpm.Scheme.MUSL) -> Row:
    """A block of E = 1e9 Pa that slides with the acceleration left by friction, or rests."""
    tilt = math.radians(degrees)
    scene, state = block(0.5, 1e9, tilt=tilt, friction=friction, length=16.0, scheme=scheme)
    final = mpm.solve(scene, state, t_end=2.0).state
    fall = GRAVITY * (int(final.step) * float(scene.numerics.time_step)) ** 2 / 2
    expected = fall * max(math.sin(tilt) - friction * math.cos(tilt), 0.0)
    distance = float(jnp.mean(final.displacement[0]))
    case = f"block on a plane of {degrees:g} degrees with friction {friction:g}"
    name, figure, bound, unit = (
        ("error of its displacement", abs(distance - expected) / fall, FALL, "of g t^2 / 2")
        if expected
        else ("displacement at rest", abs(distance), REST, "m")
    )
    more: Row = {"displacement_m": round(distance, 5), "expected_m": round(expected, 5)}
    return judged(f"{case}: {name}", figure, bound, unit, status=status_of(final), **more)


def spinning_rows(quick: bool) -> Iterator[Row]:
    """The disc with FLIP and GIMP, and with APIC, which needs B-splines; B-splines alone for what they change."""
    kinds: dict[str, dict[str, Any]] = {
        "GIMP and FLIP": {},
        "B-splines and FLIP": {"kernel": mpm.QuadraticBSpline},
        "B-splines and APIC": {"kernel": mpm.QuadraticBSpline, "apic": True, "flip": 0.0},
    }
    for name, choices in kinds.items():
        if not quick or choices:
            yield spinning_row(name, **choices)


def spinning_row(name: str, turns: float = 5.0, **choices: Any) -> Row:
    """An elastic disc eight cells wide, E = 1e7 Pa, that spins freely by 1 rad/s."""
    radius, spin, middle = 4.0, 1.0, 8.0
    numerics = mpm.Discretisation(1.0, (0.5, 0.5), **choices)
    box, corner = (2 * radius,) * 2, (middle - radius,) * 2
    scene, state = mpm.block(box, mpm.Soil(young=1e7), numerics, domain=(16, 16), corner=corner, speed=8.0)
    within = np.hypot(*(np.asarray(scene.particles.position) - middle)) <= radius

    def cut(leaf: Any) -> Any:
        return leaf[..., within] if leaf.shape[-1:] == within.shape else leaf

    scene, state = replace(scene, particles=jax.tree.map(cut, scene.particles)), jax.tree.map(cut, state)
    x, z = scene.particles.position - middle
    state = replace(state, velocity=spin * jnp.stack([-z, x]))
    if state.affine is not None:
        state = replace(state, affine=state.affine.at[0, 1].set(-spin).at[1, 0].set(spin))
    final = mpm.solve(scene, state, t_end=2 * math.pi * turns / spin).state
    lost = 1 - angular_momentum(scene, final) / angular_momentum(scene, state)
    bound = SPIN["FLIP" if state.affine is None else "APIC"]
    case = f"spinning disc on 8 cells, {name}: angular momentum lost in {turns:g} turns"
    return judged(case, abs(lost), bound, "of that at the start", status=status_of(final))


def angular_momentum(scene: mpm.Scene, state: mpm.State) -> float:
    """Of a body in plane strain about its centre (kg m2/s), with what APIC's particles carry within themselves: their
    mass times the spread of B-splines, h^2 / 4, times the curl of their velocity."""
    m, position = scene.particles.mass, diagnostics.position(scene, state)
    x, z = position - jnp.sum(m * position, axis=1, keepdims=True) / jnp.sum(m)
    momentum = x * state.velocity[1] - z * state.velocity[0]
    if state.affine is not None:
        momentum = momentum + (state.affine[1, 0] - state.affine[0, 1]) * scene.grid.cell**2 / 4
    return float(jnp.sum(m * momentum))
