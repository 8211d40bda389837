"""The motion of the base that a record of an earthquake gives."""

from __future__ import annotations

from typing import cast

import jax.numpy as jnp
import numpy as np

from cooperative.scene import tables
from cooperative.scene._plausible import ON_PURPOSE
from jaxmpm import BaseMotion
from jaxmpm.soil import STANDARD_GRAVITY

WEAKEST, STRONGEST = 0.3, 30.0
"""Peak acceleration (m/s2) between which an unscaled record is plausible: 0.03 g, which moves no slope, and 3 g."""
AXES = "xyz"


def motion_of(scene: tables.Scene, dimension: int) -> BaseMotion | None:
    """The motion of the base that a scene gives, None without `[motion]`.

    Args:
        scene: its tables.
        dimension: number of the ground's axes.

    Raises:
        ValueError: a record along an axis that the ground does not have, without any motion, or whose peak betrays
            another unit.
    """
    if scene.motion is None:
        return None
    record, unit, scale = cast(BaseMotion, scene.motion.record), scene.motion.record_unit, scene.motion.scale
    acceleration = np.asarray(record.acceleration, float) * unit
    peak = float(np.abs(acceleration).max())
    if dimension == 2 and np.any(acceleration[1]):
        raise ValueError("[motion] record has a column y, along which a section does not move: name x and z alone")
    if not peak > 0:
        raise ValueError("[motion] record has no acceleration but 0: leave [motion] out")
    if not scene.unusual and not WEAKEST <= peak <= STRONGEST:
        name = next(name for name, factor in tables.ACCELERATIONS.items() if factor == unit)
        raise ValueError(
            f"[motion] record reaches {peak:.3g} m/s2 by record_unit = {name!r}, {peak / STANDARD_GRAVITY:.2g} times "
            f"gravity, and {WEAKEST:g} to {STRONGEST:g} m/s2 are usual: was another unit meant? "
            + ON_PURPOSE.format("[soil]")
        )
    rows = [AXES.index(axis) for axis in ("xyz" if dimension == 3 else "xz")]
    return BaseMotion(jnp.asarray(acceleration[rows] * scale, jnp.float32), jnp.asarray(record.interval))
