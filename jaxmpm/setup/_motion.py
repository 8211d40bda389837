"""Records of earthquakes: read on the host, with every row checked."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import TypeAlias

import jax.numpy as jnp
import numpy as np

from jaxmpm.laws import BaseMotion
from jaxmpm.protocols import PrescribedMotion
from jaxmpm.soil import STANDARD_GRAVITY
from jaxmpm.support import check, files
from jaxmpm.support.table import MOST_BYTES, Table, decoded, number, scale_of, table_of
from jaxmpm.support.text import shown

LARGEST = 1.0
"""Pseudo-static acceleration at most, over gravity."""
EVEN = 0.02
"""Largest difference of a printed time from an even one, as a share of the interval."""
COARSE = 0.02
"""Largest uncertainty of the interval of rounded times, as a share of it."""
ACCELERATIONS = {
    **{"m/s2": 1.0, "cm/s2": 0.01, "g": STANDARD_GRAVITY},
    **{"m/s/s": 1.0, "m/sec2": 1.0, "cm/s/s": 0.01, "cm/sec2": 0.01, "gal": 0.01, "mm/s2": 0.001},
}
"""Units of acceleration in m/s2."""
SECONDS = {**dict.fromkeys(("s", "sec", "second", "seconds"), 1.0), "ms": 0.001}
"""Units of time in seconds."""
HEADINGS = {
    "time": ("time", "t", "zeit", "tijd", "temps"),
    "x": ("x", "acceleration", "acc", "accel", "a", "ax", "a_x", "acc_x", "acceleration_x", "x_acceleration"),
    "y": ("y", "ay", "a_y", "acc_y", "acceleration_y", "y_acceleration"),
    "z": ("z", "az", "a_z", "acc_z", "acceleration_z", "z_acceleration"),
}
"""Headings of a record's columns."""


def read_motion(path: str | Path, *, axes: str = "xz", scale: float = 1.0, unit: str | None = None) -> BaseMotion:
    """Read the acceleration of a base from a table of text, or from a file of PEER (.AT2).

    Headings name the columns: `time` and any of `x`, `y`, `z`; `acceleration` alone is x. Without headings there are
    two columns, time and x. A file of PEER has one component, which is x. Times rise evenly; the record begins with
    the first of them. Units in brackets behind a heading are read.

    Args:
        path: of the file.
        axes: of the scene, "xz" in plane strain, "xyz" in 3D; one without a column does not move.
        scale: factor on the acceleration.
        unit: of the file's acceleration, "m/s2", "cm/s2" or "g"; None for that which the file states, or m/s2.

    Returns:
        Motion of the base (m/s2).

    Raises:
        ValueError: If columns are unknown, missing or named twice, a unit is another than the file states, or a row has
            a value that is not finite or a time that is not even; the message has the line.
    """
    if axes not in ("x", "xz", "xyz"):
        raise ValueError(f"axes = {axes!r}: give 'x', 'xz' or 'xyz'")
    if unit is not None and unit not in ACCELERATIONS:
        raise ValueError(f"unit = {unit!r}: give one of {', '.join(ACCELERATIONS)}, or None")
    check.positive("scale", scale)
    path = Path(path)
    if not path.is_file():
        raise ValueError(f"there is no record {path}: give the path of a table of text, or of a file of PEER (.AT2)")
    text = decoded(path, files.read_given(path, MOST_BYTES))
    read = _peer if path.suffix.lower() == ".at2" or "NPTS" in text[:1000] else _columns
    interval, columns, stated = read(path, text, axes)
    for name, of_file in stated.items():
        if unit is not None and not np.isclose(ACCELERATIONS[unit], of_file):
            stated_unit = next(
                (unit_name for unit_name, factor in ACCELERATIONS.items() if factor == of_file), f"{of_file:g} m/s2"
            )
            raise ValueError(f"{path} has its {name} in {stated_unit}, and {unit} is asked for: give {stated_unit}")
    usual = 1.0 if unit is None else ACCELERATIONS[unit]
    columns = {name: values * (stated.get(name, usual) * scale) for name, values in columns.items()}
    none = np.zeros(len(next(iter(columns.values()))))
    return BaseMotion(jnp.asarray(np.stack([columns.get(axis, none) for axis in axes])), jnp.asarray(interval))


Read: TypeAlias = tuple[float, dict[str, np.ndarray], dict[str, float]]
"""Interval (s), acceleration by axis, and the units (m/s2) that the file states."""


def _peer(path: Path, text: str, axes: str) -> Read:
    """A record of the Pacific Earthquake Engineering Research Center: headings, count and interval, then its values."""
    lines = text.split("\n")
    at = next((k for k, line in enumerate(lines[:10]) if "NPTS" in line.upper()), None)
    numbers = [] if at is None else re.findall(r"(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?", lines[at])
    if at is None or len(numbers) < 2:
        raise ValueError(f"{path} has no line NPTS= ..., DT= ..., as a file of PEER does: give a CSV of time and x")
    head = " ".join(lines[:at]).upper()
    if "ACCELERATION" not in head or "UNITS OF" not in head:
        raise ValueError(f"{path} does not say that it has accelerations, and in which unit: give the file of those")
    stated = scale_of(str(path), head.split("UNITS OF")[1].split()[0], ACCELERATIONS)
    count, interval = int(float(numbers[0])), float(numbers[1])
    words = " ".join(lines[at + 1 :]).split()
    values = np.array([number(word) for word in words])
    if len(values) != count or len(values) < 2 or not interval > 0:
        raise ValueError(f"{path} declares {count} values, each {interval:g} s, and holds {len(values)}: it is damaged")
    if not np.isfinite(values).all():
        raise ValueError(f"{path}: {shown(words[int(np.argmin(np.isfinite(values)))])} is no finite number")
    return interval, {"x": values}, {"x": stated}


def _columns(path: Path, text: str, axes: str) -> Read:
    """A record in columns."""
    table = table_of(path, text)
    columns, units = _named(table, axes)
    if len(table.rows) < 2:
        raise ValueError(f"{path} has {len(table.rows)} rows of numbers: give two or more")
    values = np.array([[number(row[column]) for column in columns.values()] for row in table.rows])
    bad = np.argwhere(~np.isfinite(values))
    if len(bad):
        row, k = bad[0]
        name, column = list(columns.items())[k]
        raise ValueError(
            f"{path}, line {table.lines[row]}: {name} = {shown(table.rows[row][column])}: give a finite number"
        )
    read = dict(zip(columns, values.T, strict=True))
    where = f"{path}: time"
    seconds = 1.0 if units["time"] is None else scale_of(where, units["time"], SECONDS)
    decimals = max(len(row[columns["time"]].partition(".")[2]) for row in table.rows)
    plain = all(re.fullmatch(r"[-+]?\d*\.?\d*", row[columns["time"]]) for row in table.rows)
    interval = _interval(path, table.lines, read.pop("time"), 10.0**-decimals if plain else 0.0)
    stated = {
        name: scale_of(f"{path}: {name}", unit, ACCELERATIONS)
        for name, unit in units.items()
        if unit is not None and name != "time"
    }
    return interval * seconds, read, stated


def _named(table: Table, axes: str) -> tuple[dict[str, int], dict[str, str | None]]:
    """Column and unit of the time and of each axis."""
    if not table.header:
        if table.width != 2:
            raise ValueError(
                f"{table.path} has columns of which none is named, {table.width} of them: name them in its first row, "
                f"time and some of {', '.join(axes)}"
            )
        return {"time": 0, "x": 1}, {"time": None, "x": None}
    columns: dict[str, int] = {}
    left_out, twice = [], False
    for k, heading in enumerate(table.names):
        plain = re.sub(r"[\s_]+", "_", heading.strip().lower())
        name = next((name for name, headings in HEADINGS.items() if plain in headings), None)
        twice |= name in columns
        if name is None:
            left_out += [heading] if heading else []
        else:
            columns[name] = k
    beyond = columns.keys() - {"time", *axes}
    if twice or beyond or "time" not in columns or len(columns) < 2:
        raise ValueError(
            f"{table.path} has columns {shown(list(table.header))}: name them in its first row, time and some of "
            f"{', '.join(axes)}, each once"
        )
    if left_out:
        check.warn(
            f"{table.path}: columns beside time and acceleration are not read: {', '.join(map(shown, left_out))}"
        )
    return columns, {name: table.units[k] for name, k in columns.items()}


def _interval(path: Path, lines: Sequence[int], times: np.ndarray, rounding: float) -> float:
    """The even interval of times that may be rounded."""
    times = times - times[0]
    steps = np.arange(len(times))
    interval = float(times[-1]) / steps[-1]
    if interval <= 0:
        raise ValueError(f"{path} goes from {times[0]:g} to {times[-1]:g} s: give times that rise")
    off = abs(times - interval * steps)
    if not (off > EVEN * interval).any():
        return interval
    # Two rounded times are apart by a rounding more or less than the moments are.
    low, high = ((times[1:] + side * rounding) / steps[1:] for side in (-1, 1))
    shortest, longest = float(low.max()), float(high.min())
    if not 0 < shortest <= longest:
        k = int(np.argmax(off))
        raise ValueError(
            f"{path}, line {lines[k]}: time = {times[k]:g} s after the first, {interval * k:g} s with the even "
            f"interval of {interval:g} s: sample the record evenly"
        )
    if longest - shortest > COARSE * shortest:
        raise ValueError(
            f"{path}: its times are rounded to {rounding:g} s, so that its interval may be {shortest:.4g} to "
            f"{longest:.4g} s: write them with more decimals"
        )
    likely = next(value for digits in range(1, 17) if shortest <= (value := float(f"{interval:.{digits}g}")) <= longest)
    check.warn(f"{path}: its times are rounded to {rounding:g} s, and are read as even ones every {likely:g} s")
    return likely


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


def check_motion(motion: PrescribedMotion, dimension: int) -> None:
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
    from scipy.integrate import cumulative_trapezoid  # loads what only a record needs

    acceleration = np.asarray(motion.acceleration, np.float64)
    interval, last = float(motion.interval), acceleration.shape[1] - 1
    if interval >= dt:
        return 0.0
    time = np.arange(acceleration.shape[1]) * interval
    seen = np.append(np.arange(0, last * interval, dt), last * interval)
    sampled = np.stack([np.interp(seen, time, component) for component in acceleration])
    whole, part = (cumulative_trapezoid(a, t, initial=0) for a, t in ((acceleration, time), (sampled, seen)))
    peak = np.abs(whole).max()
    if peak == 0:
        return 0.0
    return float(max(np.abs(np.interp(time, seen, p) - w).max() for w, p in zip(whole, part, strict=True)) / peak)
