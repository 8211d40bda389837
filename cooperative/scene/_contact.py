"""The contact of soil with rigid ground, whose friction may be that of the soil on it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import cast

from cooperative.scene import tables
from cooperative.scene._fields import RandomField
from cooperative.scene._site import Site
from jaxmpm import Interface, Section, Terrain
from jaxmpm.soil import AnySoil

OF_SOIL = "soil"
"""Friction of an interface that is that of the soil."""


def interface_of(table: tables.Interface | None) -> Interface | None:
    """The interface that a table gives; none yet where its friction is that of the soil.

    Args:
        table: of the scene, None without one.
    """
    return None if table is None or table.friction == OF_SOIL else Interface(**dict(table))


def on_soil(
    site: Site, table: tables.Ground | tables.Terrain | None, soil: AnySoil, random: Mapping[str, RandomField]
) -> Site:
    """The ground with the interface that has the friction of its soil, where the scene asks for one.

    Args:
        site: ground with its layers.
        table: of the ground, None for a slope.
        soil: of the campaign, with the means of what varies.
        random: what varies, by parameter.

    Raises:
        ValueError: the soil has no friction, layers, or a friction that varies in space.
    """
    if table is None or table.interface is None or table.interface.friction != OF_SOIL:
        return site
    friction, field, why = getattr(soil, "friction", None), random.get("friction"), ""
    if site.layers:
        why = "has layers"
    elif friction is None:
        why = "has no friction"
    elif field is not None and not (field.trend is None and all(map(math.isinf, field.length))):
        why = "has one that varies in space"
    if why:
        raise ValueError(
            f"the interface has friction = 'soil', and the soil {why}: give the interface an angle, or all soil one "
            "friction, with length = inf along each axis where it is random"
        )
    assert friction is not None
    interface = interface_of(table.interface.model_copy(update={"friction": friction}))
    shape = replace(cast(Section | Terrain, site.shape), interface=interface)
    return replace(site, shape=shape, contact_of_soil=field is not None)
