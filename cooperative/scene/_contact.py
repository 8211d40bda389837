"""The contact of soil with rigid ground: of numbers, of random fields, or with the strength of the soil on it."""

from __future__ import annotations

from dataclasses import replace
from typing import Final, cast

from cooperative.scene import tables
from cooperative.scene._plausible import ask, ask_of_field
from cooperative.scene._site import Site
from jaxmpm import Interface, Section, Terrain
from jaxmpm.soil import AnySoil

OF_SOIL: Final = "soil"
"""Strength of an interface that is that of the soil."""

FIXED = "fixed"
"""Ground to which soil sticks."""

STRENGTHS = {"friction": ("friction",), "cohesion": ("cohesion", "strength")}
"""What an interface has, and which parameters of the soil that is."""


def interface_of(table: tables.Ground | tables.Terrain) -> tables.Interface | None:
    """The interface of a table of the ground, that with the strength of the soil where bedrock has no other.

    Args:
        table: of the ground.

    Returns:
        Its table; None where soil sticks to the ground.
    """
    given = table.interface
    if given == FIXED or (given is None and table.bedrock is None):
        return None
    if isinstance(given, tables.Interface):
        return given
    return tables.Interface(friction=OF_SOIL, cohesion=OF_SOIL)


def fields_of(
    where: str, table: tables.Interface | None, downhill: int, span: tables.Span, *, unusual: bool
) -> dict[str, tables.RandomField]:
    """What varies in an interface, by the names that a campaign has for it.

    Args:
        where: table of the ground, for messages.
        table: of the interface.
        downhill: direction along x in which the ground falls, 1 or -1.
        span: elevations of the ground (m).
        unusual: whether numbers may look like another unit.

    Raises:
        ValueError: numbers that betray another unit, or fields whose values leave their limits.
    """
    random = {}
    for name, value in table or ():
        if isinstance(value, tables.RandomField):
            field, label = value.dipping(downhill), f"[{where}.interface.{name}]"
            if not unusual:
                ask_of_field(label, name, field, "[soil]")
            field.check(label, tables.LIMITS[name], span)
            random[f"interface_{name}"] = field
        elif isinstance(value, float) and not unusual:
            ask(f"[{where}.interface] {name}", name, value)
    return random


def on_ground(site: Site, table: tables.Interface | None, soil: AnySoil) -> Site:
    """The ground with its interface, whose strength may be that of the soil on it.

    Args:
        site: ground with its layers.
        table: of the interface, None for ground to which soil sticks.
        soil: of the campaign, with the means of what varies.

    Raises:
        ValueError: no soil has the strength that is asked for, or the numbers are impossible for a contact.
    """
    if table is None:
        return site
    values = {name: value.mean if isinstance(value, tables.RandomField) else value for name, value in table}
    rock = [each.rock for each in site.layers] or [False]
    soils = [each.soil for each, stands in zip(site.soils(soil), rock, strict=True) if not stands]
    follows = [name for name in STRENGTHS if values[name] == OF_SOIL]
    for name in follows:
        # Where layers differ, that of the lowest one stands for the whole, as in limit equilibrium.
        found = [getattr(each, parameter, None) for each in soils[::-1] for parameter in STRENGTHS[name]]
        values[name] = next((float(each) for each in found if each), 0.0)
    if follows and not any(values[name] for name in STRENGTHS):
        raise ValueError(
            f"the interface has the {' and '.join(follows)} of the soil, which has none: give the interface numbers"
        )
    interface = Interface(**values)
    interface.check()
    shape = replace(cast(Section | Terrain, site.shape), interface=interface)
    of_soil = tuple(name for name in follows if name == "friction" or values[name])
    return replace(site, shape=shape, contact_of_soil=of_soil)
