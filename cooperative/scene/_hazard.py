"""What a scene says of hazard and risk: `[hazard]` and `[[exposed]]`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from cooperative.measure import Place, Vulnerability, quantity
from cooperative.scene._schema import Key, in_words, read
from foundation.text import shown

HAZARD = {"thresholds": Key(list, ["0.5 m", "1 m", "1 m/s"]), "every": Key(int, 20)}
EXPOSED = {
    "name": Key(str),
    "at": Key(list, None),
    "between": Key(list, None),
    "polygon": Key(list, None),
    "value": Key(float, None),
    "vulnerability": Key(list, None),
}
LONGEST_NAME = 60


@dataclass(frozen=True)
class Hazard:
    """What is kept of each refined slide for maps. thickness, speed: thresholds (m, m/s) whose exceedance is mapped.
    every: steps from one look at the columns of cells to the next. places: that are exposed."""

    thickness: tuple[float, ...]
    speed: tuple[float, ...]
    every: int
    places: tuple[Place, ...]


def hazard_of(tables: dict[str, Any]) -> Hazard | None:
    """Takes `hazard` and `exposed` out of a scene's tables; None where it has neither.

    Raises ValueError for keys that are not known, thresholds of no unit, places whose corners make no shape or whose
    names are not their own, and vulnerability curves that fall or leave [0, 1].
    """
    asked, exposed = tables.pop("hazard", None), tables.pop("exposed", None)
    if asked is None and exposed is None:
        return None
    said = read("hazard", {} if asked is None else asked, HAZARD)
    if said["every"] < 1:
        raise ValueError(f"[hazard] every = {said['every']}: give 1 step or more")
    levels: dict[str, set[float]] = {"thickness": set(), "speed": set()}
    for threshold in said["thresholds"]:
        of, level = quantity("[hazard] thresholds", threshold)
        if not level > 0:
            raise ValueError(f"[hazard] thresholds = {threshold!r}: give more than 0, what is reached is told anyway")
        levels[of].add(level)
    if not isinstance(exposed if exposed is not None else [], list):
        raise ValueError(f"exposed = {shown(exposed)} is {in_words(exposed)}: give tables, [[exposed]]")
    places = tuple(_place(number, table) for number, table in enumerate(exposed or [], 1))
    keys = [place.key for place in places]
    for place in places:
        if not place.key or keys.count(place.key) > 1:
            raise ValueError(
                f"[[exposed]] name = {place.name!r} is there {keys.count(place.key)} times as {place.key!r}: give each "
                "its own, with letters or digits"
            )
    return Hazard(tuple(sorted(levels["thickness"])), tuple(sorted(levels["speed"])), said["every"], places)


def _place(number: int, table: Any) -> Place:
    where = f"[exposed {number}]"
    said = read(where[1:-1], table, EXPOSED)
    name = said["name"]
    if not name.isprintable() or not 0 < len(name) <= LONGEST_NAME:
        raise ValueError(f"{where} name = {shown(name)}: give one line of 1 to {LONGEST_NAME} characters")
    shapes = [key for key in ("at", "between", "polygon") if said[key] is not None]
    if len(shapes) != 1:
        raise ValueError(
            f"{where} {name!r} has {' and '.join(shapes) or 'no place'}: give one of at = [x] or [x, y], between = "
            "[from, to] in a section, polygon = [[x, y], ...] in 3D, in metres"
        )
    if (said["value"] is None) != (said["vulnerability"] is None):
        raise ValueError(f"{where} {name!r}: give value and vulnerability together, or neither")
    if said["value"] is not None and said["value"] < 0:
        raise ValueError(f"{where} value = {said['value']:g}: give 0 or more")
    return Place(name, _corners(f"{where} {shapes[0]}", shapes[0], said[shapes[0]]), said["value"], _curve(where, said))


def _corners(where: str, shape: str, given: list[Any]) -> tuple[tuple[float, ...], ...]:
    """Corners of a place, in metres."""
    if shape == "polygon":
        if len(given) < 3 or not all(isinstance(c, list) and len(c) == 2 and _numbers(c) for c in given):
            raise ValueError(f"{where} = {shown(given)}: give three or more corners [x, y] in metres")
        return tuple(tuple(map(float, corner)) for corner in given)
    if not (_numbers(given) and len(given) in ((2,) if shape == "between" else (1, 2))):
        wanted = "[from, to]" if shape == "between" else "[x] in a section, [x, y] in 3D"
        raise ValueError(f"{where} = {shown(given)}: give {wanted}, in metres")
    return tuple((float(x),) for x in given) if shape == "between" else (tuple(map(float, given)),)


def _numbers(values: list[Any]) -> bool:
    return all(isinstance(value, int | float) and not isinstance(value, bool) for value in values)


def _curve(where: str, said: Mapping[str, Any]) -> Vulnerability | None:
    if said["vulnerability"] is None:
        return None
    at, lost, kinds = [], [], set()
    for pair in said["vulnerability"]:
        if not (isinstance(pair, list) and len(pair) == 2 and _numbers(pair[1:])):
            raise ValueError(f'{where} vulnerability has {shown(pair)}: give pairs such as ["0.5 m", 0.2]')
        of, level = quantity(f"{where} vulnerability", pair[0])
        kinds.add(of)
        at.append(level)
        lost.append(float(pair[1]))
    if len(kinds) != 1:
        raise ValueError(f"{where} vulnerability is of {' and '.join(sorted(kinds)) or 'nothing'}: give one of them")
    try:
        return Vulnerability(kinds.pop(), tuple(at), tuple(lost))
    except ValueError as error:
        raise ValueError(f"{where} {error}") from error
