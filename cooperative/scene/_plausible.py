"""Numbers of the soil that betray another unit, and correlation lengths in another order."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import fields, replace

import numpy as np

from cooperative.scene._site import Site
from cooperative.scene.tables import ACCELERATIONS, LIMITS, Motion, RandomField, Span
from jaxmpm import Raster
from jaxmpm.soil import STANDARD_GRAVITY, Plausible, unit_slip
from jaxmpm.support.check import Gathered, Invalid, at

Path = tuple[str | int, ...]
"""Keys and positions that lead to a value of a scene."""

ON_PURPOSE = "If it is meant as it is, give unusual = true in {}"
"""The remedy of a number that is unusual, with the table in which to declare it."""

HIGHEST = 3000.0
"""Height (m) of a slope from its foot to its top that is plausible."""

DEEPEST_POOL = 10.0
"""Depth of water on the ground up to which it is plausible, over the height of the ground above its base."""

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


class Unusual(Invalid):
    """A number that betrays another unit, unless its author declares that it is meant."""


def fields_of(
    values: Mapping[str, object], path: Callable[[str], Path], *, span: Span, downhill: int, home: str, unusual: bool
) -> dict[str, RandomField]:
    """What varies of the numbers of soil, or of a contact, by parameter.

    Args:
        values: by parameter; those that are neither numbers nor fields are passed over.
        path: of a parameter in the scene.
        span: elevations of the ground (m).
        downhill: direction along x in which the ground falls, 1 or -1.
        home: table in which its author declares that unusual numbers are meant.
        unusual: whether they are.

    Raises:
        Invalid: a number betrays another unit, or values of a field leave the parameter's limits.
    """
    gathered, random = Gathered(), {}
    for name, value in values.items():
        with gathered.of(), at(*path(name)):
            if isinstance(value, RandomField):
                random[name] = value.dipping(downhill)
                if not unusual:
                    _ask_of_field(name, random[name], home)
                random[name].check(LIMITS[name], span)
            elif isinstance(value, float) and not unusual:
                ask(name, value, home=home)
    gathered.raise_all()
    return random


def _ask_of_field(name: str, field: RandomField, home: str) -> None:
    """Raise what betrays another unit of the numbers of a field, or another order of its lengths."""
    meant, gathered = ON_PURPOSE.format(home), Gathered()
    numbers = {"mean": (field.mean, None), "cov": (field.cov, COV), "borehole_error": (field.borehole_error, ERROR)}
    # Angles may well come down to a degree.
    ends = ("upper",) if LIMITS[name].unit == "degrees" else ("lower", "upper")
    numbers |= {end: (getattr(field, end) or 0.0, None) for end in ends}
    for key, (value, plausible) in numbers.items():
        with gathered.of(), at(key):
            ask(name, value, plausible, home)
    if slip := field.trend and name in TRENDS and unit_slip(name, abs(field.trend), TRENDS[name]):
        sign = "-" if field.trend < 0 else ""
        gathered.faults.append(Unusual(("trend",), f"{sign}{slip.value}", "", f"{slip.remedy} {meant}"))
    if 0 < field.mean_error < LEAST_ERROR * abs(field.mean):
        rare = f"{field.mean_error:g}, less than a thousandth of the mean, {field.mean:g}"
        gathered.faults.append(Unusual(("mean_error",), rare, "", f"was another unit meant? {meant}"))
    slips = [slip for row in field.boreholes or () if (slip := unit_slip(name, row[-1]))]
    if slips:
        more = f"as are {len(slips) - 1} more values. " if slips[1:] else ""
        gathered.faults.append(Unusual(("boreholes",), slips[0].value, "", f"{slips[0].remedy} {more}{meant}"))
    *along, upwards = field.length
    if along and field.bedding is None and max(along) < upwards < math.inf:
        remedy = (
            f"it correlates over {upwards:g} m upwards and {max(along):g} m along the ground, while deposits vary "
            f"faster upwards; the order is x, y, z, in a section x, z. {meant}"
        )
        gathered.faults.append(Unusual(("length",), f"{list(field.length)}", "", remedy))
    gathered.raise_all()


def ask(name: str, value: float, plausible: Plausible | None = None, home: str = "[soil]") -> None:
    """Check a number of the soil.

    Args:
        name: of the parameter.
        value: in its unit.
        plausible: range, None for that of the parameter.
        home: table in which its author declares that it is meant.

    Raises:
        Unusual: it betrays another unit, see `jaxmpm.soil.unit_slip`.
    """
    if slip := unit_slip(name, value, plausible):
        raise Unusual((), slip.value, "", f"{slip.remedy} {ON_PURPOSE.format(home)}")


def _odd(path: Path, value: str | None, rule: str, question: str) -> Unusual:
    """What is odd about a number beside others of the scene."""
    return Unusual(path, value, rule, f"{question} {ON_PURPOSE.format('[soil]')}")


def ask_of_ground(where: str, site: Site, displacement: float) -> None:
    """Check the heights of the ground and of its water, and the failure displacement beside its length.

    Args:
        where: table of the scene that gives it.
        site: the ground.
        displacement: of a failure (m).

    Raises:
        Unusual: they betray another unit.
    """
    if displacement > (longest := max(site.shape.extent)):
        beside = f"{displacement:g} m, while the ground is {longest:g} m long"
        raise _odd(("run", "failure_displacement"), beside, "", "were mm or cm meant?")
    base, top = site.span
    if site.height > HIGHEST:
        rule = f"has heights z up to {top:g} m and a slope {site.height:g} m high, above {HIGHEST:g} m"
        raise _odd((where,), None, rule, "were mm or cm meant?")
    if site.water is None or (water := site.water_table) is None:
        return
    path = ("water", next(key.name for key in fields(site.water) if getattr(site.water, key.name) is not None))
    heights = water.heights if isinstance(water, Raster) else np.atleast_2d(water)[:, -1]
    low, high = np.nanmin(heights, initial=math.inf), np.nanmax(heights, initial=-math.inf)
    if math.isfinite(low) and low - top > DEEPEST_POOL * (top - base):
        rule = (
            f"stands {low - top:g} m above the ground's highest point at {top:g} m, more than {DEEPEST_POOL:g} times "
            f"its height of {top - base:g} m"
        )
        raise _odd(path, None, rule, "were cm or mm meant, or heights from another zero?")
    if math.isfinite(high) and high < base:
        rule = f"lies below the base at {base:g} m everywhere, at {high:g} m and lower, and wets nothing"
        raise _odd(path, None, rule, "leave [water] out, or give heights from the same zero as those of the ground.")


WEAKEST, STRONGEST = 0.3, 30.0
"""Peak acceleration (m/s2) between which an unscaled record is plausible: 0.03 g, which moves no slope, and 3 g."""


def ask_of_record(motion: Motion) -> None:
    """Check the peak of a record.

    Args:
        motion: of the base.

    Raises:
        Unusual: it betrays another unit.
    """
    peak = float(np.abs(motion.acceleration).max())
    if 0 < peak < WEAKEST or peak > STRONGEST:
        name = next(name for name, factor in ACCELERATIONS.items() if factor == motion.record_unit)
        rule = (
            f"reaches {peak:.3g} m/s2 by record_unit = {name!r}, {peak / STANDARD_GRAVITY:.2g} times gravity, and "
            f"{WEAKEST:g} to {STRONGEST:g} m/s2 are usual"
        )
        raise _odd(("motion", "record"), None, rule, "was another unit meant?")
