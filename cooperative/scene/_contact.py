"""The contact of soil with rigid ground: of numbers, of random fields, or with the strength of the soil on it."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any, cast

from cooperative.scene import tables
from cooperative.scene._site import Site
from jaxmpm import Interface, Section, Terrain
from jaxmpm.soil import AnySoil
from jaxmpm.support.check import Invalid

STRENGTHS = {"friction": ("friction",), "cohesion": ("cohesion", "strength")}
"""What an interface has, and which parameters of the soil that is."""


def on_ground(site: Site, table: tables.InterfaceTable, soil: AnySoil) -> Site:
    """The ground with its interface, whose strength may be that of the soil on it.

    Args:
        site: ground with its layers.
        table: of the interface.
        soil: of the campaign, with the means of what varies.

    Raises:
        ValueError: no soil has the strength that the interface follows, or the numbers are impossible for a contact.
    """
    values: dict[str, Any] = {key.name: getattr(table, key.name) for key in fields(table)}
    values |= {name: value.mean for name, value in values.items() if isinstance(value, tables.RandomField)}
    rock = [layer.rock for layer in site.layers] or [False]
    soils = [layer.soil for layer, is_rock in zip(site.soils(soil), rock, strict=True) if not is_rock]
    follows = [name for name in STRENGTHS if values[name] == "soil"]
    for name in follows:
        # Where layers differ, that of the lowest one stands for the whole, as in limit equilibrium.
        found = [getattr(layer, parameter, None) for layer in soils[::-1] for parameter in STRENGTHS[name]]
        values[name] = next(filter(None, found), 0.0)
    if follows and not any(values[name] for name in STRENGTHS):
        raise Invalid(
            (), None, f"has the {' and '.join(follows)} of the soil, which has none", "give the interface numbers"
        )
    if "cohesion" in follows and (weakens := [loss for layer in soils if (loss := getattr(layer, "loss_time", None))]):
        raise Invalid(
            ("cohesion",), "'soil'", f"of soil with loss_time = {weakens[0]:g} s, whose loss a contact does not follow",
            "give the interface the strength that is left",
        )  # fmt: skip
    undrained = any(getattr(layer, "strength", None) for layer in soils)
    interface = Interface(**values, softens=undrained and "cohesion" in follows and table.slip_length is None)
    interface.check()
    shape = replace(cast(Section | Terrain, site.shape), interface=interface)
    of_soil = tuple(name for name in follows if name == "friction" or values[name])
    return replace(site, shape=shape, contact_of_soil=of_soil)
