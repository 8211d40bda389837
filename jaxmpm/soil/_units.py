"""Plausible ranges of numbers of soil: a number outside them is probably in another unit."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from jaxmpm.support.check import Invalid


@dataclass(frozen=True)
class Plausible:
    """Plausible numbers of a parameter: 0, and those from `least` to `most`.

    Args:
        unit: of the parameter.
        least: smallest plausible number above 0.
        below: question about a smaller one.
        most: largest plausible number.
        above: question about a larger one.
    """

    unit: str = ""
    least: float = 0.0
    below: str = ""
    most: float = math.inf
    above: str = ""


_KPA = "were kPa meant?"
_TWICE = "was a factor of 1000 put in twice?"
_WEIGHT = "were kN/m3 (1000 N/m3) or kg/m3 (9.81 N/m3) meant?"
_DEGREES = "it is taken in degrees; are these radians, or a tangent, and were degrees meant?"
_SHARE = "it is a share, 1 for 100 per cent; were per cent meant?"

PLAUSIBLE: Mapping[str, Plausible] = MappingProxyType(
    {
        "strength": Plausible("Pa", 1e3, _KPA, 5e6, _TWICE),
        "strength_minimum": Plausible("Pa", 100.0, _KPA, 5e6, _TWICE),
        "cohesion": Plausible("Pa", 100.0, _KPA, 5e6, _TWICE),
        "friction": Plausible("degrees", 1.6, _DEGREES),
        "young": Plausible("Pa", 2e5, "were kPa or MPa meant?"),
        "unit_weight": Plausible("N/m3", 3e3, _WEIGHT, 40e3, _TWICE),
        "saturated_unit_weight": Plausible("N/m3", 3e3, _WEIGHT, 40e3, _TWICE),
        "softening_modulus": Plausible("Pa", 500.0, _KPA),
        "residual_cohesion": Plausible("Pa", 100.0, _KPA, 5e6, _TWICE),
        "residual_friction": Plausible("degrees", 1.6, _DEGREES),
        "strain_95": Plausible(most=5.0, above=_SHARE),
        "softening_strain": Plausible(most=5.0, above=_SHARE),
        **dict.fromkeys(
            ("active_strength", "simple_strength", "passive_strength"), Plausible("Pa", 1e3, _KPA, 5e6, _TWICE)
        ),
        **dict.fromkeys(("static_friction", "dynamic_friction"), Plausible("degrees", 1.6, _DEGREES)),
        "largest_pressure": Plausible("Pa", 1e4, _KPA),
        "least_pressure": Plausible("Pa", 10.0, _KPA),
        "grain_size": Plausible("m", most=10.0, above="were mm meant?"),
        "grain_density": Plausible("kg/m3", 100.0, "were g/cm3 or t/m3 meant?", 1e4, "was a unit weight (N/m3) meant?"),
        "slip_length": Plausible("m", most=20.0, above="were mm meant?"),
        "gravity": Plausible("m/s2", 0.1, "were multiples of 9.81 m/s2 meant?", 30.0, "were cm/s2 meant?"),
    }
)
"""By parameter of the soil and of its contact, and gravity."""


def unit_slip(name: str, value: float, plausible: Plausible | None = None) -> Invalid | None:
    """What is wrong with a number that looks like another unit.

    Args:
        name: of a parameter of soil, or "gravity".
        value: its number.
        plausible: its plausible range; None for the known one.

    Returns:
        The value with its limit, and a question about the unit; None if it is plausible or the parameter is unknown.
    """
    plausible_range = PLAUSIBLE.get(name) if plausible is None else plausible
    if plausible_range is None or not value > 0:
        return None
    for beyond, limit, question in (
        ("below", plausible_range.least, plausible_range.below),
        ("above", plausible_range.most, plausible_range.above),
    ):
        if (value < limit) if beyond == "below" else (value > limit):
            text, bound = (f"{number:g} {plausible_range.unit}".rstrip() for number in (value, limit))
            return Invalid((), f"{text}, {beyond} {bound}", "", question)
    return None
