"""Numbers of the soil that betray another unit, and correlation lengths in another order."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from cooperative.scene.tables import ACCELERATIONS, LIMITS, Motion, RandomField
from jaxmpm import Ground, ground
from jaxmpm.soil import STANDARD_GRAVITY, Plausible, unit_slip
from jaxmpm.support.check import Gathered

ON_PURPOSE = "If it is meant as it is, give unusual = true in {}"
"""The remedy of a number that is unusual, with the table in which to declare it."""

HIGHEST = 3000.0
"""Height (m) of a slope from its foot to its top that is plausible."""

ERROR = Plausible(most=3.0, above="it is a share of the field's deviation; were the parameter's units meant?")
"""Errors of measured values that are plausible."""

LEAST_ERROR = 1e-3
"""Share of the mean from which on its standard error is plausible."""

COV = Plausible(most=3.0, above="it is a share, 1 for 100 per cent; were per cent meant?")
"""Coefficients of variation that are plausible."""

_STRESS = Plausible("Pa per metre", 50.0, "were kPa or MPa per metre meant?")
TRENDS = {
    **dict.fromkeys(("strength", "cohesion", "softening_modulus", "residual_cohesion"), _STRESS),
    "young": replace(_STRESS, least=1e4),
    "unit_weight": Plausible("N/m3 per metre", 1.0, "were kN/m3 per metre meant?"),
}
"""Trends with depth that are plausible, upwards or downwards."""


def ask_of_field(where: str, name: str, field: RandomField, home: str) -> None:
    """Check the numbers of a field.

    Args:
        where: name of the parameter, for messages.
        name: of the parameter.
        field: that it is.
        home: table in which its author declares that it is meant.

    Raises:
        ValueError: a number betrays another unit, or lengths another order.
    """
    gathered = Gathered()

    def asked(where: str, name: str, value: float, plausible: Plausible | None = None) -> None:
        with gathered.of():
            ask(where, name, value, plausible, home)

    asked(f"{where} mean", name, field.mean)
    asked(f"{where} cov", name, field.cov, COV)
    asked(f"{where} borehole_error", name, field.borehole_error, ERROR)
    if 0 < field.mean_error < LEAST_ERROR * abs(field.mean):
        gathered.faults.append(
            f"{where} mean_error = {field.mean_error:g}, less than a thousandth of the mean, {field.mean:g}: was "
            f"another unit meant? {ON_PURPOSE.format(home)}"
        )
    # Angles may well come down to a degree.
    for end in ("upper",) if LIMITS[name].unit == "degrees" else ("lower", "upper"):
        asked(f"{where} {end}", name, getattr(field, end) or 0.0)
    if field.trend is not None and name in TRENDS:
        asked(f"{where} {'-' if field.trend < 0 else ''}trend", name, abs(field.trend), TRENDS[name])
    slips = [slip for row in field.boreholes or () if (slip := unit_slip(name, row[-1]))]
    if slips:
        more = f"as are {len(slips) - 1} more values. " if slips[1:] else ""
        gathered.faults.append(f"{where} boreholes, value = {slips[0]} {more}{ON_PURPOSE.format(home)}")
    *along, upwards = field.length
    if along and field.bedding is None and max(along) < upwards < math.inf:
        gathered.faults.append(
            f"{where} length = {list(field.length)}: it correlates over {upwards:g} m upwards and {max(along):g} m "
            "along the ground, while deposits vary faster upwards; the order is x, y, z, in a section x, z. "
            + ON_PURPOSE.format(home)
        )
    gathered.raise_all()


def ask(where: str, name: str, value: float, plausible: Plausible | None = None, home: str = "[soil]") -> None:
    """Check a number of the soil.

    Args:
        where: name of the number, for messages.
        name: of the parameter.
        value: in its unit.
        plausible: range, None for that of the parameter.
        home: table in which its author declares that it is meant.

    Raises:
        ValueError: it betrays another unit, see `jaxmpm.soil.unit_slip`.
    """
    if slip := unit_slip(name, value, plausible):
        raise ValueError(f"{where} = {slip} {ON_PURPOSE.format(home)}")


def ask_of_ground(where: str, shape: Ground, displacement: float) -> None:
    """Check the heights of the ground, and the failure displacement beside its length.

    Args:
        where: table of the scene that gives it.
        shape: of the ground.
        displacement: of a failure (m).

    Raises:
        ValueError: they betray another unit.
    """
    if displacement > (longest := max(shape.extent)):
        raise ValueError(
            f"[run] failure_displacement = {displacement:g} m, while the ground is {longest:g} m long: were mm or cm "
            f"meant? {ON_PURPOSE.format('[soil]')}"
        )
    relief, (base, edge) = ground.relief(shape), (shape.corner[-1], shape.extent[-1])
    if relief > HIGHEST:
        raise ValueError(
            f"[{where}] has heights z up to {base + edge:g} m and a slope {relief:g} m high, above {HIGHEST:g} m: were "
            f"mm or cm meant? {ON_PURPOSE.format('[soil]')}"
        )


WEAKEST, STRONGEST = 0.3, 30.0
"""Peak acceleration (m/s2) between which an unscaled record is plausible: 0.03 g, which moves no slope, and 3 g."""


def ask_of_record(motion: Motion) -> None:
    """Check the peak of a record.

    Args:
        motion: of the base.

    Raises:
        ValueError: it betrays another unit.
    """
    peak = float(np.abs(motion.acceleration).max())
    if 0 < peak < WEAKEST or peak > STRONGEST:
        name = next(name for name, factor in ACCELERATIONS.items() if factor == motion.record_unit)
        raise ValueError(
            f"[motion] record reaches {peak:.3g} m/s2 by record_unit = {name!r}, {peak / STANDARD_GRAVITY:.2g} times "
            f"gravity, and {WEAKEST:g} to {STRONGEST:g} m/s2 are usual: was another unit meant? "
            + ON_PURPOSE.format("[soil]")
        )
