"""What a scene asks of hazard and risk: `[hazard]` and `[[exposed]]`."""

from __future__ import annotations

from dataclasses import dataclass

from cooperative.measure import Place, Vulnerability
from cooperative.scene import tables


@dataclass(frozen=True)
class Hazard:
    """What is kept of each refined slide for maps. thickness, speed: thresholds (m, m/s) whose exceedance is mapped.
    every: steps from one look at the columns of cells to the next. places: that are exposed."""

    thickness: tuple[float, ...]
    speed: tuple[float, ...]
    every: int
    places: tuple[Place, ...]


def hazard_of(scene: tables.Scene) -> Hazard | None:
    """What is kept of slides; None where the scene asks for neither maps nor exposed places.

    Raises ValueError for places whose corners make no shape or whose names are not their own, and vulnerability curves
    that fall or leave [0, 1].
    """
    if scene.hazard is None and scene.exposed is None:
        return None
    asked = scene.hazard or tables.Hazard()
    places = tuple(map(_place, scene.exposed or ()))
    keys = [place.key for place in places]
    for place in places:
        if not place.key or keys.count(place.key) > 1:
            raise ValueError(
                f"[[exposed]] name = {place.name!r} is there {keys.count(place.key)} times as {place.key!r}: give each "
                "its own, with letters or digits"
            )
    thickness, speed = (
        tuple(sorted({level for of, level in asked.thresholds if of == kind})) for kind in ("thickness", "speed")
    )
    return Hazard(thickness, speed, asked.every, places)


def _place(table: tables.Exposed) -> Place:
    where = f"[exposed {table.name!r}]"
    if table.between is not None:
        corners: tuple[tuple[float, ...], ...] = tuple((x,) for x in table.between)
    else:
        corners = (table.at,) if table.at is not None else table.polygon or ()
    return Place(table.name, corners, table.value, _curve(where, table))


def _curve(where: str, table: tables.Exposed) -> Vulnerability | None:
    if table.vulnerability is None:
        return None
    kinds = {of for (of, _), _ in table.vulnerability}
    if len(kinds) != 1:
        raise ValueError(f"{where} vulnerability is of {' and '.join(sorted(kinds)) or 'nothing'}: give one of them")
    levels, lost = (
        tuple(level for (_, level), _ in table.vulnerability),
        tuple(share for _, share in table.vulnerability),
    )
    try:
        return Vulnerability(kinds.pop(), levels, lost)
    except ValueError as error:
        raise ValueError(f"{where} {error}") from error
