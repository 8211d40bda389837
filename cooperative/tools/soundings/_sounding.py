"""What a cone penetration test measured, in SI units, and its checks."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import numpy as np

from cooperative.laboratory import Values, numbers
from jaxmpm.support import check
from jaxmpm.support.table import number
from jaxmpm.support.text import printable, shown
from jaxmpm.support.values import by_value

STEEPEST = 45.0
"""Inclination (degrees) of a cone that no sounding reaches."""
LARGEST_CONE = 150e6
"""Cone resistance (Pa) that no cone bears: a number above it is in another unit."""
MOST_OF_CONE = {"sleeve": ("sleeve friction", 0.5), "pore": ("pore pressure", 5.0)}
"""Share of the cone resistance above which the median of a column is in another unit."""
LEAST_SLEEVE = 1e-4
"""Share of the cone resistance below which the median sleeve friction is in another unit."""
LONGEST_NAME = 60
"""Characters of a sounding's name, which goes to terminals, figures and comments of a scene."""
LARGEST_DEPTH = 200.0
"""Depth (m) of a sounding above which the number is in another unit."""


@by_value
@dataclass(frozen=True)
class Sounding:
    """A cone penetration test. Gaps are nan: nothing is filled in.

    Args:
        name: of the sounding.
        file: it was read from.
        x: horizontal position (m) in the projection of the file.
        y: likewise; nan where the file has none.
        top: elevation of the ground's surface there (m); nan where the file has none.
        datum: that the elevation counts from, in the file's words; None where it has none.
        depth: (n,) below that surface (m), rising.
        cone: (n,) cone resistance q_c (Pa); q_t where the file has that alone.
        sleeve: (n,) sleeve friction f_s (Pa).
        pore: (n,) pore pressure u_2 behind the cone (Pa).
        area_ratio: of the cone's net area, None where the file has none.
        water: depth of the water table (m), None where the file has none.
        corrected: (n,) corrected resistance q_t (Pa) where the file has it, or an area ratio for each push.
        projection: of the position, such as "EPSG:28992"; None where the file does not name it.
    """

    name: str
    file: str
    x: float
    y: float
    top: float
    datum: str | None
    depth: Values
    cone: Values
    sleeve: Values
    pore: Values
    area_ratio: float | None = None
    water: float | None = None
    corrected: Values | None = None
    projection: str | None = None

    @property
    def z(self) -> Values:
        """Elevation (n,) of the readings (m)."""
        return self.top - self.depth


def one_number(text: str | None) -> float:
    """The number in a header of a file, nan where it has none.

    Args:
        text: of the header, None where it is missing.
    """
    value = number(text or "")
    return float(numbers("", [text or ""])[0]) if math.isfinite(value) else math.nan


@dataclass(frozen=True)
class SoundingRecord:
    """What a file has of one sounding, in SI units with gaps as nan, with nothing worked out of it.

    Args:
        file: it was read from.
        name: as the file has it.
        columns: of `COLUMNS`, each (n,).
        x: m.
        y: m.
        top: elevation of the surface (m).
        datum: of elevations.
        projection: of the position.
        area_ratio: net, of the cone.
        water: depth of the water table (m).
        predrilled: depth (m) above which nothing was measured.
    """

    file: str
    name: str
    columns: Mapping[str, Values]
    x: float = math.nan
    y: float = math.nan
    top: float = math.nan
    datum: str | None = None
    projection: str | None = None
    area_ratio: float = math.nan
    water: float = math.nan
    predrilled: float = math.nan


COLUMNS = (
    "length", "depth", "inclination", "cone", "total", "sleeve", "friction_ratio", "pore", "area_ratio",
)  # fmt: skip
"""What a sounding may have at each reading: penetration length and depth (m), inclination (degrees), q_c, q_t and f_s
(Pa), f_s over q_c, u_2 (Pa), and the net area ratio."""


def sounding_of(record: SoundingRecord) -> Sounding:
    """The sounding of a record: depth, sleeve friction and corrected resistance of what was measured, and checked.

    Args:
        record: of a file.

    Raises:
        ValueError: numbers in another unit, or nothing measured.
    """
    name = printable(record.name.strip())[:LONGEST_NAME] or printable(Path(record.file).stem)
    where = f"{record.file}: sounding {shown(name)}"
    count = max((len(values) for values in record.columns.values()), default=0)
    gap = np.full(count, math.nan)
    table = {column: record.columns.get(column, gap) for column in COLUMNS}
    order = np.argsort(table["length"], kind="stable")
    table = {column: values[order] for column, values in table.items()}
    depth = _depths(where, table)
    measured = ~(np.where(np.isfinite(table["length"]), table["length"], depth) < record.predrilled)
    if dropped := int((np.isfinite(table["cone"]) & ~measured).sum()):
        check.warn(f"{where}: {dropped} readings above the pre-drilled depth of {record.predrilled:g} m are left out")
    table, depth = {column: values[measured] for column, values in table.items()}, depth[measured]
    sleeve = np.where(table["sleeve"] > 0, table["sleeve"], math.nan)
    cone, total, pore = table["cone"], table["total"], table["pore"]
    ratio = np.where(np.isfinite(table["area_ratio"]), table["area_ratio"], record.area_ratio or math.nan)
    ratios = np.unique(ratio[np.isfinite(ratio)])
    by_pore = (1 - ratio) * pore
    corrected = np.where(np.isfinite(total), total, cone + by_pore)
    _check_total(where, total, cone + by_pore)
    cone = np.where(np.isfinite(cone), cone, np.where(np.isfinite(by_pore), total - by_pore, total))
    sleeve = np.where(np.isfinite(sleeve), sleeve, table["friction_ratio"] * cone)
    has_total = np.isfinite(total).any() or ratios.size > 1
    made = Sounding(
        name=name, file=record.file, x=record.x, y=record.y, top=record.top, datum=record.datum,
        depth=depth, cone=cone, sleeve=sleeve, pore=pore,
        area_ratio=float(ratios[0]) if ratios.size == 1 else None, water=_water(where, record.water),
        corrected=corrected if has_total else None, projection=record.projection,
    )  # fmt: skip
    for area_ratio in ratios:
        if not 0.3 <= area_ratio <= 1:
            raise ValueError(f"{where} has a net area ratio of {area_ratio:g}: cones have 0.3 to 1")
    return checked(made)


def _check_total(where: str, total: Values, computed: Values) -> None:
    """Warn of a q_t that is not that of q_c, u_2 and area ratio."""
    both = np.isfinite(total) & np.isfinite(computed)
    if (
        both.any()
        and (apart := float(np.median(np.abs(computed - total)[both] / np.median(np.abs(total[both]))))) > 0.02
    ):
        check.warn(
            f"{where}: q_t differs from q_c + (1 - a) u_2 by {apart:.0%} in the median, and is used: compare area "
            "ratio and units"
        )


def _depths(where: str, table: Mapping[str, Values]) -> Values:
    """Depth (n,) m, of the penetration length where it is not given, less what inclination takes from it."""
    length, depth, inclination = (table[name] for name in ("length", "depth", "inclination"))
    placed, deep = np.isfinite(length), np.isfinite(depth)
    if not placed.any() or not (placed & ~deep).any():
        return depth
    leaning = placed & np.isfinite(inclination)
    if leaning.any() and (worst := float(np.abs(inclination[leaning]).max())) > STEEPEST:
        raise ValueError(f"{where} leans by {worst:g} degrees, the limit is {STEEPEST:g}: correct the inclination")
    # A gap of the inclination is between its neighbours; without any the sounding is upright.
    angle = np.interp(length, length[leaning], inclination[leaning]) if leaning.any() else np.zeros(length.size)
    upright = np.full(length.size, math.nan)
    upright[placed] = np.cumsum(np.cos(np.deg2rad(angle[placed])) * np.diff(length[placed], prepend=0.0))
    both = placed & deep
    if both.any():
        upright = upright + np.interp(length, length[both], (depth - upright)[both])
        missing = int((placed & ~deep & (np.isfinite(table["cone"]) | np.isfinite(table["total"]))).sum())
        if missing:
            check.warn(f"{where}: {missing} readings have no corrected depth and are placed by their length")
    return np.where(deep, depth, upright)


def _water(where: str, depth: float) -> float | None:
    """Depth (m) of the water table that a file has, None where it has none."""
    if math.isnan(depth):
        return None
    if depth <= 0:
        what = "which many files have where none was measured" if depth == 0 else "above the surface"
        check.warn(
            f"{where} has a water table at a depth of {depth:g} m, {what}: that of --water is used, give --water 0 for "
            "water at the surface"
        )
        return None
    return depth


def checked(sounding: Sounding) -> Sounding:
    """The sounding, after a check of its numbers; readings that are no measurement become gaps.

    Readings without a depth of 0 or more are left out. A cone resistance and a sleeve friction of 0 or less are gaps.
    Readings of the same depth are averaged, as depths are rounded.

    Raises:
        ValueError: numbers in another unit, or nothing measured.
    """
    where = f"{sounding.file}: sounding {shown(sounding.name)}"
    valid = np.isfinite(sounding.depth) & (sounding.depth >= 0)
    read = np.isfinite(sounding.cone) & (sounding.cone > 0)
    if lost := int((read & ~valid).sum()) if valid.any() else 0:
        check.warn(f"{where}: {lost} readings without a depth of 0 or more are left out")
    names = ("depth", "cone", "sleeve", "pore", *(() if sounding.corrected is None else ("corrected",)))
    columns = {name: getattr(sounding, name)[valid] for name in names}
    depth = columns["depth"]
    if depth.size == 0:
        raise ValueError(f"{where} has no depths of 0 or more: depths count down from the surface, in metres")
    if depth.max() > LARGEST_DEPTH:
        raise ValueError(
            f"{where} reaches a depth of {depth.max():g} m, the limit is {LARGEST_DEPTH:g} m: is it in mm or cm? Give "
            "the unit in the header, such as depth [mm]"
        )
    columns = _averaged(columns)
    for name in ("cone", "sleeve", "corrected"):
        if name in columns:
            columns[name] = np.where(columns[name] > 0, columns[name], np.nan)
    cone = columns["cone"][np.isfinite(columns["cone"])]
    if cone.size == 0:
        raise ValueError(f"{where} has no cone resistance above 0: every reading is a gap or a void code")
    if cone.max() > LARGEST_CONE or np.median(cone) < 5e3:
        raise ValueError(
            f"{where} has cone resistances with a median of {np.median(cone):.3g} Pa and up to {cone.max():.3g} Pa; "
            f"soil has 5e3 Pa to {LARGEST_CONE:g} Pa: give the right unit, such as qc [kPa] in the header"
        )
    _check_shares(where, columns)
    return replace(sounding, **cast(dict[str, Any], columns))


def _check_shares(where: str, columns: Mapping[str, Values]) -> None:
    """Raise ValueError for sleeve frictions or pore pressures that are none beside the cone resistance."""
    for name, (what, most) in MOST_OF_CONE.items():
        shares = np.abs(columns[name] / columns["cone"])
        median = float(np.median(shares[np.isfinite(shares)])) if np.isfinite(shares).any() else math.nan
        if median > most or (name == "sleeve" and median < LEAST_SLEEVE):
            least = f"{LEAST_SLEEVE:g} to " if name == "sleeve" else "up to "
            raise ValueError(
                f"{where} has a {what} of {median:.3g} times its cone resistance in the median; soil has {least}"
                f"{most:g}: give the right units of both, such as [kPa] in the header"
            )


def _averaged(columns: Mapping[str, Values]) -> dict[str, Values]:
    """Columns with rising depths, each once: the mean of what was read there, a gap where nothing was."""
    depth, row = np.unique(columns["depth"], return_inverse=True)

    def mean(values: Values) -> Values:
        finite = np.isfinite(values)
        counts = np.bincount(row[finite], minlength=depth.size)
        sums = np.bincount(row[finite], values[finite], minlength=depth.size)
        return np.where(counts > 0, sums / np.maximum(counts, 1), math.nan)

    return {"depth": depth} | {name: mean(values) for name, values in columns.items() if name != "depth"}
