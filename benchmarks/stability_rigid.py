"""Stability cases of bodies that theory takes as rigid: a block on a plane with friction.

The block is two cells high and elastic. It starts at rest, in the stress of a block glued to the plane, and is measured
2 s later by the mean displacement of its particles. An undamped elastic block that is set down free of stress rings,
and its friction, which follows the ringing normal force, holds it less.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import jax.numpy as jnp

import jaxmpm as mpm
from benchmarks.earthquakes import GRAVITY, block
from benchmarks.stability_case import Row, judged, status_of

FALL, REST = 0.02, 1e-3
"""Largest error of a sliding block, of g t^2 / 2, and largest displacement of one that rests (m)."""


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
    fall = GRAVITY * (int(final.step) * float(scene.time_step)) ** 2 / 2
    expected = fall * max(math.sin(tilt) - friction * math.cos(tilt), 0.0)
    moved = float(jnp.mean(final.displacement[0]))
    case = f"block on a plane of {degrees:g} degrees with friction {friction:g}"
    name, figure, bound, unit = (
        ("error of its displacement", abs(moved - expected) / fall, FALL, "of g t^2 / 2")
        if expected
        else ("displacement at rest", abs(moved), REST, "m")
    )
    more: Row = {"displacement_m": round(moved, 5), "expected_m": round(expected, 5)}
    return judged(f"{case}: {name}", figure, bound, unit, status=status_of(final), **more)
