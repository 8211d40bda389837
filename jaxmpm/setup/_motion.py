"""Records of earthquakes: read on the host, with every row checked."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from scipy.integrate import cumulative_trapezoid

from foundation import check, files
from foundation.text import shown
from jaxmpm.laws import BaseMotion

MOST_BYTES = 2**26
"""Largest size (bytes) of a record."""
LARGEST = 1.0
"""Pseudo-static acceleration at most, over gravity."""
EVEN = 0.02
"""Largest difference of a printed time from an even one, as a share of the interval."""


def read_motion(path: str | Path, *, axes: str = "xz", scale: float = 1.0) -> BaseMotion:
    """Read the acceleration of a base from a CSV file.

    The first row names the columns: `time` (s) and any of `x`, `y`, `z` (m/s2 after `scale`, 9.81 for a record in g).
    Times rise evenly from 0. Empty lines and lines that begin with # are skipped.

    Args:
        path: of the file.
        axes: of the scene, "xz" in plane strain, "xyz" in 3D; one without a column does not move.
        scale: factor to m/s2.

    Returns:
        Motion of the base.

    Raises:
        ValueError: If columns are unknown, missing or named twice, or a row has another length, a value that is not
            finite or a time that is not even; the message has the line.
    """
    if axes not in ("x", "xz", "xyz"):
        raise ValueError(f"axes = {axes!r}: give 'x', 'xz' or 'xyz'")
    check.positive("scale", scale)
    if not Path(path).is_file():
        raise ValueError(f"there is no record {path}: give the path of a CSV file")
    files.check_given(path, MOST_BYTES)
    with Path(path).open(newline="", encoding="utf-8-sig") as file:
        numbered = [(n, line) for n, line in enumerate(file, 1) if line.strip() and not line.lstrip().startswith("#")]
    try:
        rows = list(csv.reader(line for _, line in numbered))
    except csv.Error as error:
        raise ValueError(f"{path} is no table ({error}): is a quotation mark left open?") from error
    lines = [n for n, _ in numbered]
    names = [name.strip() for name in rows[0]] if rows else []
    if "time" not in names or len(set(names)) < len(names) or not set(names) - {"time"} <= set(axes) or len(names) < 2:
        raise ValueError(
            f"{path} has columns {shown(names)}: name them in its first row, time and some of {', '.join(axes)}, each "
            "once"
        )
    values = np.array([_row(path, n, row, names) for n, row in zip(lines[1:], rows[1:], strict=True)])
    if len(values) < 2:
        raise ValueError(f"{path} has {len(values)} rows of numbers: give two or more")
    interval = _interval(path, lines[1:], values[:, names.index("time")])
    column = {name: values[:, k] * scale for k, name in enumerate(names)}
    acceleration = np.stack([column.get(axis, np.zeros(len(values))) for axis in axes])
    return BaseMotion(jnp.asarray(acceleration), jnp.asarray(interval))


def _row(path: str | Path, line: int, row: Sequence[str], names: Sequence[str]) -> list[float]:
    if len(row) != len(names):
        raise ValueError(f"{path}, line {line} has {len(row)} values, the first row names {len(names)} columns")
    numbers = []
    for name, text in zip(names, row, strict=True):
        try:
            number = float(text)
        except ValueError:
            number = np.nan
        if not np.isfinite(number):
            raise ValueError(f"{path}, line {line}: {name} = {shown(text.strip())}: give a finite number")
        numbers.append(number)
    return numbers


def _interval(path: str | Path, lines: Sequence[int], times: np.ndarray) -> float:
    interval = float(times[-1] - times[0]) / (len(times) - 1)
    if times[0] != 0 or interval <= 0:
        raise ValueError(f"{path} goes from {times[0]:g} to {times[-1]:g} s: give times that rise from 0")
    off = abs(times - interval * np.arange(len(times))) > EVEN * interval
    if off.any():
        k = int(np.argmax(off))
        raise ValueError(
            f"{path}, line {lines[k]}: time = {times[k]:g} s, {interval * k:g} s with the even interval of "
            f"{interval:g} s: sample the record evenly"
        )
    return interval


def pseudo_static(gravity: float, k_h: float, k_v: float, dimension: int) -> tuple[float, ...]:
    """Gravity with the constant acceleration that stands for an earthquake.

    Source: Kramer (1996), Geotechnical Earthquake Engineering, Section 10.6.1.1.

    Args:
        gravity: downwards (m/s2).
        k_h: horizontal acceleration over gravity, along the first axis.
        k_v: vertical acceleration over gravity, upwards.
        dimension: number of axes.

    Returns:
        Vector (m/s2).

    Raises:
        ValueError: If gravity is below 0, or a coefficient is beyond -1 to 1.
    """
    check.not_negative("gravity", gravity, "m/s2")
    check.between("k_h", k_h, -LARGEST, LARGEST)
    check.between("k_v", k_v, -LARGEST, LARGEST)
    return (k_h * gravity, *(0.0,) * (dimension - 2), -(1 - k_v) * gravity)


def check_motion(motion: BaseMotion, dimension: int) -> None:
    """Raise ValueError for an invalid motion of the base of a scene with this many axes."""
    if not isinstance(motion, BaseMotion):
        raise ValueError(f"motion = {shown(motion)}: give a BaseMotion, or None")
    shape = np.shape(motion.acceleration)
    if len(shape) != 2 or shape[0] != dimension or shape[1] < 2 or np.shape(motion.interval) != ():
        raise ValueError(
            f"motion has acceleration {shape} and interval {np.shape(motion.interval)}: give ({dimension}, m), m > 1, "
            "and one number"
        )


SKIPPED = 0.02
"""Share of a record's peak velocity from which on a loss by time steps is worth a warning."""


def skipped(motion: BaseMotion, dt: float) -> float:
    """What time steps (s) leave out of a record, by the velocity that it makes, over its peak."""
    given = np.asarray(motion.acceleration, np.float64)
    interval, last = float(motion.interval), given.shape[1] - 1
    if interval >= dt:
        return 0.0
    time = np.arange(given.shape[1]) * interval
    seen = np.append(np.arange(0, last * interval, dt), last * interval)
    sampled = np.stack([np.interp(seen, time, each) for each in given])
    whole, part = (cumulative_trapezoid(a, t, initial=0) for a, t in ((given, time), (sampled, seen)))
    peak = np.abs(whole).max()
    if peak == 0:
        return 0.0
    return float(max(np.abs(np.interp(time, seen, p) - w).max() for w, p in zip(whole, part, strict=True)) / peak)
