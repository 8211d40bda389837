"""Rain and levels in time: quantities with their units, and tables of them in files."""

from __future__ import annotations

import re
from collections.abc import Mapping
from datetime import datetime
from pathlib import Path

import numpy as np

from jaxmpm.support.check import Invalid
from jaxmpm.support.table import LENGTHS, measured, number, plain_unit, read_table
from jaxmpm.support.text import shown

TIMES = {
    **dict.fromkeys(("s", "sec", "second", "seconds"), 1.0),
    **dict.fromkeys(("min", "minute", "minutes"), 60.0),
    **dict.fromkeys(("h", "hr", "hour", "hours"), 3600.0),
    **dict.fromkeys(("d", "day", "days"), 86400.0),
    **dict.fromkeys(("week", "weeks"), 7 * 86400.0),
    **dict.fromkeys(("a", "year", "years"), 365.25 * 86400.0),
}
"""Seconds of each unit of time, by its name as `plain_unit` writes it."""

RATES = {
    f"{length}/{time}": metres / seconds
    for length, metres in LENGTHS.items()
    if length in ("m", "cm", "mm", "ft", "in", "inch")
    for time, seconds in TIMES.items()
    if seconds < 7 * 86400 or time in ("a", "year")
}
"""Metres a second of each unit of a rate, likewise."""

_QUANTITY = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*([^\d\s].*)", re.ASCII)


def _shown_units(units: Mapping[str, float]) -> str:
    """Some of the units in words, each size once."""
    first = {size: unit for unit, size in reversed(list(units.items()))}
    usual = [unit for unit in ("m/s", "mm/h", "m/day") if unit in units]
    return ", ".join(usual or list(reversed(list(first.values())))[:8])


def in_unit(where: str, unit: str | None, units: Mapping[str, float], usual: str | None = None) -> float:
    """What a number in a unit is multiplied by to be in SI units.

    Args:
        where: file and column, or key, for messages.
        unit: as it is written, None for none.
        units: of the quantity.
        usual: that of a number without one; None asks for it.

    Returns:
        Factor.

    Raises:
        ValueError: If it has no unit and needs one, or one that is not known.
    """
    if unit is None and usual is None:
        raise Invalid((), where, "has no unit", f"give one of {_shown_units(units)}")
    plain = plain_unit(usual if unit is None else unit)  # type: ignore[arg-type]
    if plain not in units:
        raise Invalid(
            (), where, f"is in {shown(unit)}, which is no unit known here", f"give one of {_shown_units(units)}"
        )
    return units[plain]


def quantity(where: str, value: str | float, units: Mapping[str, float]) -> float:
    """A quantity in SI units: a number, or a text of a number and its unit such as "14 mm/h".

    Args:
        where: what it is, for messages.
        value: the number or text.
        units: of the quantity.

    Returns:
        Number.

    Raises:
        ValueError: If the text is none.
    """
    if not isinstance(value, str):
        return float(value)
    match = _QUANTITY.fullmatch(value)
    if match is None:
        raise Invalid((), f"{where} = {shown(value)}", "", f"give a number and its unit, of {_shown_units(units)}")
    return float(match[1]) * in_unit(f"{where} = {shown(value)}", match[2], units)


TIME = ("t", "time", "date", "datetime", "timestamp")
RATE = ("rain", "rate", "intensity", "precipitation", "rainfall")
LEVEL = ("level", "z", "elevation", "water_level", "stage")


def read_hyetograph(path: str | Path) -> tuple[list[float], list[float]]:
    """Read rain in time: columns t and rain, each with its unit in brackets.

    A rate holds until the next time. Times may be dates as "2026-11-01 06:00", which count from the first row.

    Args:
        path: of the file.

    Returns:
        Times (s) and rates (m/s).

    Raises:
        ValueError: If a column or a unit is missing, a row has a gap, or the times do not rise; the message has the
            line.
    """
    return _read(Path(path), "rain", RATE, RATES, "mm/h")


def read_levels(path: str | Path) -> tuple[list[float], list[float]]:
    """Read the level of a river or reservoir in time: columns t and level, each with its unit in brackets.

    Args:
        path: of the file.

    Returns:
        Times (s) and levels (m), linear between.

    Raises:
        ValueError: As for `read_hyetograph`.
    """
    return _read(Path(path), "level", LEVEL, LENGTHS, "m")


def _read(
    path: Path, name: str, words: tuple[str, ...], units: Mapping[str, float], example: str
) -> tuple[list[float], list[float]]:
    """Times and values of a table of two columns."""
    shape = f"a table of text with the columns t [h] and {name} [{example}]"
    if not path.is_file():
        raise ValueError(f"there is no file {path}: give {shape}")
    table = read_table(path)
    if not table.header or not table.rows:
        raise ValueError(f"{path} has no row of {'values' if table.header else 'headings'}: give {shape}")
    columns = []
    for headings, of, read in ((TIME, TIMES, number), (words, units, measured)):
        found = [k for k, word in enumerate(table.names) if word.strip().lower().replace(" ", "_") in headings]
        if len(found) != 1:
            raise ValueError(f"{path} has {len(found)} columns of {'time' if headings is TIME else name}: give {shape}")
        unit = table.units[found[0]]
        if name == "rain" and of is units and unit is not None and plain_unit(unit) in LENGTHS:
            raise ValueError(
                f"{path}: the column {shown(table.names[found[0]])} has depths in {unit}: divide each by the time to "
                "the next row, and name it rain [mm/h]"
            )
        cells = [row[found[0]] for row in table.rows]
        if headings is TIME and unit is None and (since := _since_first(cells)) is not None:
            columns.append(since)
            continue
        scale = in_unit(f"{path}: column {shown(table.names[found[0]])}", unit, of)
        columns.append(np.array([read(cell) for cell in cells]) * scale)
    times, values = columns
    gaps = ~np.isfinite(times + values)
    if gaps.any():
        raise ValueError(
            f"{path}, line {table.lines[int(np.argmax(gaps))]} has a gap: give time and {name} in each row"
        )
    if np.any(back := np.diff(times) <= 0):
        line = table.lines[int(np.argmax(back)) + 1]
        raise ValueError(f"{path}, line {line}: times do not rise there: give them in order, each once")
    return times.tolist(), values.tolist()


def _since_first(cells: list[str]) -> np.ndarray | None:
    """Seconds from the first of some dates (ISO 8601); None where they are none."""
    try:
        moments = [datetime.fromisoformat(cell.strip()) for cell in cells]
        return np.array([(moment - moments[0]).total_seconds() for moment in moments])
    except (ValueError, TypeError):  # dates with and without a time zone have no difference
        return None
