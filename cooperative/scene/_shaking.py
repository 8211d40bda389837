"""Records of earthquakes in a scene: packed beside its text, and the motion of the base that they give."""

from __future__ import annotations

import base64
import binascii
import zlib
from typing import Any, cast

import jax.numpy as jnp
import numpy as np

from cooperative.scene import tables
from foundation.text import shown
from jaxmpm import BaseMotion
from jaxmpm.soil import STANDARD_GRAVITY

MOST_SAMPLES = 200_000
"""Samples of a record in a scene."""
WEAKEST, STRONGEST = 0.3, 30.0
"""Peak acceleration (m/s2) between which an unscaled record is plausible: 0.03 g, which moves no slope, and 3 g."""
AXES = "xyz"


def packed_motion(name: str, motion: BaseMotion) -> dict[str, object]:
    """A record as a table of a scene: its samples in single precision, compressed.

    Args:
        name: of the file.
        motion: its three axes, in the record's own unit.

    Raises:
        ValueError: too many samples.
    """
    samples = motion.acceleration.shape[1]
    if samples > MOST_SAMPLES:
        raise ValueError(f"{name} has {samples} samples, the limit is {MOST_SAMPLES}: cut it, or sample it less often")
    data = zlib.compress(np.asarray(motion.acceleration, "<f4").tobytes(), 9)
    return {"interval": float(motion.interval), "samples": samples, "acceleration": base64.b64encode(data).decode()}


def unpacked_motion(name: str, table: Any) -> BaseMotion:
    """The record in a table of a scene.

    Args:
        name: of the file.
        table: as `packed_motion` gives it.

    Raises:
        ValueError: one that holds something else, or less than it says.
    """
    try:
        samples, interval = table["samples"], float(table["interval"])
        if not (isinstance(samples, int) and 2 <= samples <= MOST_SAMPLES and 0 < interval < np.inf):
            raise ValueError(f"{shown(samples)} samples, each {interval:g} s")
        size = 4 * len(AXES) * samples
        data = zlib.decompressobj().decompress(base64.b64decode(table["acceleration"], validate=True), size + 1)
        values = np.frombuffer(data, "<f4") if len(data) == size else np.full(1, np.nan)
        if not np.isfinite(values).all():
            raise ValueError(f"{len(data)} bytes for {samples} samples, or numbers that are not finite")
        return BaseMotion(jnp.asarray(values.reshape(len(AXES), samples)), jnp.asarray(interval))
    except (TypeError, KeyError, ValueError, OverflowError, zlib.error, binascii.Error) as error:
        where = f"files {shown(name)}: its table in [files] is damaged"
        raise ValueError(f"{where} ({shown(str(error))}): run the scene's file") from error


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
            f"gravity, and {WEAKEST:g} to {STRONGEST:g} m/s2 are usual: was another unit meant? If it is meant as "
            "it is, say unusual = true in [soil]"
        )
    rows = [AXES.index(axis) for axis in ("xyz" if dimension == 3 else "xz")]
    return BaseMotion(jnp.asarray(acceleration[rows] * scale, jnp.float32), jnp.asarray(record.interval))
