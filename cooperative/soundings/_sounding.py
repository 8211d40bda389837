"""What a cone penetration test or a laboratory measured, in SI units, and the checks of both."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
import numpy.typing as npt

from foundation.text import short, shown

Values = npt.NDArray[np.float64]

UNITS: Mapping[str, Mapping[str, float]] = MappingProxyType(
    {
        "length": {"m": 1.0, "cm": 0.01, "mm": 0.001, "ft": 0.3048},
        "stress": {
            "pa": 1.0, "kpa": 1e3, "mpa": 1e6, "n/m2": 1.0, "kn/m2": 1e3, "mn/m2": 1e6, "bar": 1e5,
            "tsf": 95760.518, "psi": 6894.757, "kgf/cm2": 98066.5,
        },
        "angle": {"deg": 1.0, "degree": 1.0, "degrees": 1.0, "°": 1.0},
        "weight": {"n/m3": 1.0, "kn/m3": 1e3, "mn/m3": 1e6},
    }
)  # fmt: skip
"""What a number in each unit is multiplied by to be in SI units, angles in degrees."""
LARGEST_CONE = 150e6
"""Cone resistance (Pa) that no cone bears: a number above it is in another unit."""
LONGEST_NAME = 60
"""Characters of a sounding's name."""
LARGEST_DEPTH = 200.0
"""Depth (m) of a sounding above which the number is in another unit."""


class SiteError(ValueError):
    """A file of a site that cannot be used; the text names file, value, limit and remedy."""


def in_si(where: str, unit: str, quantity: str) -> float:
    """What a number is multiplied by to be in SI units.

    Args:
        where: file and column, for the message.
        unit: as the file has it, such as "MPa" or "kN/m²".
        quantity: of `UNITS`.

    Raises:
        SiteError: no unit of this quantity.
    """
    plain = unit.strip().lower().replace("²", "2").replace("³", "3").replace("^", "").replace(" ", "")
    if plain not in UNITS[quantity]:
        known = ", ".join(UNITS[quantity])
        raise SiteError(f"{where} is in {shown(unit)}, which is no unit of {quantity} known here: give one of {known}")
    return UNITS[quantity][plain]


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
        cone: (n,) cone resistance q_c (Pa).
        sleeve: (n,) sleeve friction f_s (Pa).
        pore: (n,) pore pressure u_2 behind the cone (Pa).
        area_ratio: of the cone's net area, None where the file has none.
        water: depth of the water table (m), None where the file has none.
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

    @property
    def z(self) -> Values:
        """Elevation (n,) of the readings (m)."""
        return self.top - self.depth


@dataclass(frozen=True)
class Measured:
    """Values of the laboratory, or of vane tests, at points.

    Args:
        file: they were read from.
        parameter: of a scene's soil, such as "strength".
        x: (n,) m.
        y: (n,) m, nan where the file has none.
        z: (n,) elevation (m).
        value: (n,) in SI units and degrees.
    """

    file: str
    parameter: str
    x: Values
    y: Values
    z: Values
    value: Values


def checked(sounding: Sounding) -> Sounding:
    """The sounding, after a check of its numbers; readings that are no measurement become gaps.

    Readings without a depth of 0 or more are left out. A cone resistance of 0 or less is a gap, and so is a sleeve
    friction below 0. Readings of the same depth are averaged, as depths are rounded.

    Raises:
        SiteError: numbers in another unit, or nothing measured.
    """
    where = f"{sounding.file}: sounding {shown(sounding.name)}"
    known = np.isfinite(sounding.depth) & (sounding.depth >= 0)
    columns = {name: getattr(sounding, name)[known] for name in ("depth", "cone", "sleeve", "pore")}
    depth = columns["depth"]
    if depth.size == 0:
        raise SiteError(f"{where} has no depths of 0 or more: depths count down from the surface, in metres")
    if depth.max() > LARGEST_DEPTH:
        raise SiteError(
            f"{where} reaches a depth of {depth.max():g} m, the limit is {LARGEST_DEPTH:g} m: is it in mm or cm? Give "
            "the unit in the header, such as depth [mm]"
        )
    columns = _averaged(columns)
    columns["cone"] = np.where(columns["cone"] > 0, columns["cone"], np.nan)
    columns["sleeve"] = np.where(columns["sleeve"] >= 0, columns["sleeve"], np.nan)
    cone = columns["cone"][np.isfinite(columns["cone"])]
    if cone.size == 0:
        raise SiteError(f"{where} has no cone resistance above 0: every reading is a gap or a void code")
    if cone.max() > LARGEST_CONE or np.median(cone) < 5e3:
        raise SiteError(
            f"{where} has cone resistances with a median of {np.median(cone):.3g} Pa and up to {cone.max():.3g} Pa; "
            f"soil has 5e3 Pa to {LARGEST_CONE:g} Pa: give the right unit, such as qc [kPa] in the header"
        )
    if sounding.area_ratio is not None and not 0.3 <= sounding.area_ratio <= 1:
        raise SiteError(f"{where} has a net area ratio of {sounding.area_ratio:g}: cones have 0.3 to 1")
    # A name goes to terminals, figures and comments of a scene.
    return replace(
        sounding, name=short(sounding.name.strip(), LONGEST_NAME), depth=columns["depth"], cone=columns["cone"],
        sleeve=columns["sleeve"], pore=columns["pore"],
    )  # fmt: skip


def _averaged(columns: Mapping[str, Values]) -> dict[str, Values]:
    """Columns with rising depths, each once: the mean of what was read there, a gap where nothing was."""
    depth, row = np.unique(columns["depth"], return_inverse=True)

    def mean(values: Values) -> Values:
        known = np.isfinite(values)
        counts = np.bincount(row[known], minlength=depth.size)
        sums = np.bincount(row[known], values[known], minlength=depth.size)
        return np.where(counts > 0, sums / np.maximum(counts, 1), math.nan)

    return {"depth": depth} | {name: mean(values) for name, values in columns.items() if name != "depth"}


def finite(value: object) -> float:
    """A number of a file; nan where it is none."""
    try:
        number = float(str(value).strip())
    except ValueError:
        return math.nan
    return number if math.isfinite(number) else math.nan
