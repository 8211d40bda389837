"""A scene with some of its keys changed, each named by its path: `water.level`, `layer.clay.strength.mean`."""

from __future__ import annotations

import copy
import difflib
import itertools
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from pydantic.fields import FieldInfo

from cooperative.scene import tables
from cooperative.store import STORED_TABLES, table_of, tables_of
from jaxmpm.support.check import Gathered, Invalid, at
from jaxmpm.support.text import shown

FIXED = ("campaign", "sweep", "scenario", "name", *STORED_TABLES)
"""Tables that no path leads into: a sweep has one campaign's samples."""
FREQUENCY = "campaign.annual_frequency"
"""The one key of these that campaigns with the same samples may differ in: how often the trigger of each comes."""
SCALES = "motion.scale"
Keys = tuple[str | int, ...]
"""Keys, and positions in lists of tables, that lead to a value."""


@dataclass(frozen=True)
class KeyPath:
    """Where a key of a scene stands.

    Args:
        keys: of its value.
        owner: table that has it.
    """

    keys: Keys
    owner: type[tables.Part]

    @property
    def key(self) -> str:
        """The last of its keys."""
        return str(self.keys[-1])

    @property
    def field(self) -> FieldInfo:
        """Declaration of the key."""
        return tables.keys(self.owner)[self.key]

    def value(self, scene: Mapping[str, object]) -> object:
        """What stands there in a scene's tables, or the key's default; None without one.

        Args:
            scene: its tables.
        """
        node: object = dict(scene)
        for part in self.keys:
            if isinstance(node, dict) and part not in node:
                return self.field.default if part == self.keys[-1] and not self.field.is_required() else None
            node = _within(node, part)
        return node


def path_of(scene: Mapping[str, object], name: str) -> KeyPath:
    """The path of a key.

    Args:
        scene: its tables.
        name: keys with dots between them; a layer by its name, or its number from 1.

    Raises:
        Invalid: no key is there; the rule names the nearest.
    """
    parts = _as_given(scene, name)
    if parts[0] in FIXED and name != FREQUENCY:
        raise Invalid((name,), None, "is no key that samples in common can differ in", "leave it out")
    keys: Keys = ()
    owner: type[tables.Part] = tables.SceneTable
    rest = list(parts)
    while rest:
        key = rest.pop(0)
        field = tables.keys(owner).get(key)
        if field is None:
            break
        keys = (*keys, key)
        if not rest:
            return KeyPath(keys, owner)
        inner = tables.table_in(field)
        if inner is None:
            break
        owner = inner
        if len(keys) == 1 and isinstance(scene.get(key), list):
            number, rest = _entry(scene, name, key, rest)
            keys = (*keys, number)
    raise _unknown(scene, name)


def number_at(scene: Mapping[str, object], name: str) -> KeyPath:
    """The path of a key that is a number.

    Args:
        scene: its tables.
        name: of the key.

    Raises:
        Invalid: as `path_of`; or what is there is no number.
    """
    path = path_of(scene, name)
    now = path.value(scene)
    if isinstance(now, dict | tables.Part):
        raise Invalid((name,), None, "is a table in this scene", f"give a key of it, such as {name}.mean")
    schema = tables.schema_of(path.owner)["properties"][path.key]
    kinds = {part.get("type") for part in (schema, *schema.get("oneOf", ()), *schema.get("anyOf", ()))}
    if not kinds & {"number", "integer"}:
        rule = f"is no number but {tables.allowed_values(schema, ends=False)}"
        raise Invalid((name,), None, rule, "change it in a [[scenario]]")
    return path


def changed(scene: Mapping[str, object], changes: Mapping[str, object]) -> dict[str, object]:
    """A scene's tables with other values.

    Args:
        scene: its tables.
        changes: values by the path of their key, None to leave it out.

    Raises:
        Invalid: as `path_of`, and two paths to one key.
    """
    result = copy.deepcopy(dict(scene))
    seen: dict[Keys, str] = {}
    for name, value in changes.items():
        keys = path_of(scene, name).keys
        if keys in seen:
            raise _twice(seen[keys], name)
        seen[keys] = name
        node: object = result
        for part in keys[:-1]:
            node = node.setdefault(part, {}) if isinstance(node, dict) else _within(node, part)
        assert isinstance(node, dict)
        node[keys[-1]] = value
        if value is None:
            del node[keys[-1]]
    return result


def _within(node: object, part: str | int) -> object:
    """What stands in a table, or a list of tables, at a key or position."""
    if isinstance(part, int):
        assert isinstance(node, list)
        return node[part]
    assert isinstance(node, dict)
    return node[part]


def _as_given(scene: Mapping[str, object], name: str) -> list[str]:
    """The keys of a path; the undrained strength stands in `[strength]` or in `[soil.strength]`."""
    parts = name.split(".")
    if parts[:2] == ["soil", "strength"] and len(parts) > 2 and "strength" in scene:
        return parts[1:]
    if parts[0] == "strength" and "strength" not in scene:
        return ["soil", *parts]
    return parts


def _entry(scene: Mapping[str, object], name: str, key: str, rest: list[str]) -> tuple[int, list[str]]:
    """Position in a list of tables that the next keys name, and the keys after these; names may have dots."""
    entries = tables_of(scene, key)
    for count in range(len(rest), 0, -1):
        name_there = ".".join(rest[:count])
        named = [at for at, entry in enumerate(entries) if entry.get("name") == name_there]
        if len(named) > 1:
            numbers = " or ".join(f"{key}.{at + 1}" for at in named)
            raise Invalid(
                (name,), None, f"leads to {len(named)} tables of the name {shown(name_there)}", f"give {numbers}"
            )
        if named:
            return named[0], rest[count:]
    if rest[0].isdigit() and 1 <= int(rest[0]) <= len(entries):
        return int(rest[0]) - 1, rest[1:]
    raise _unknown(scene, name)


def _twice(name: str, again: str) -> Invalid:
    return Invalid((again,), None, f"is the key of {name} too", "give it once")


def _unknown(scene: Mapping[str, object], name: str) -> Invalid:
    paths = [*_all_paths(scene), *tables.keys(tables.Sweep)]
    close = difflib.get_close_matches(name, paths, n=1, cutoff=0.4)
    nearest = f" (did you mean {shown(close[0])}?)" if close else ""
    return Invalid((name,), None, f"is no key of this scene{nearest}", "see docs/scenes.md for all keys")


def _all_paths(scene: Mapping[str, object]) -> Iterator[str]:
    """Paths of all keys that a scene may have, with the names of its layers."""
    for name, field in tables.keys(tables.SceneTable).items():
        table = tables.table_in(field)
        if name in FIXED or table is None:
            continue
        several = isinstance(scene.get(name), list)
        entries = [f"{name}.{entry.get('name', number)}" for number, entry in enumerate(tables_of(scene, name), 1)]
        for prefix in entries if several else [name]:
            yield from _paths(table, prefix)


def _paths(table: type[tables.Part], prefix: str) -> Iterator[str]:
    for key, field in tables.keys(table).items():
        yield f"{prefix}.{key}"
        inner = tables.table_in(field)
        if inner is not None:
            yield from _paths(inner, f"{prefix}.{key}")


@dataclass(frozen=True)
class Varied:
    """A campaign of a sweep that differs from its scene in keys named by paths.

    Args:
        parameter: what is varied, as figures and results name it.
        value: of it; of a scenario its name.
        changes: values by path.
        tables: of its scene.
    """

    parameter: str
    value: float | str
    changes: Mapping[str, object]
    tables: Mapping[str, object]

    @classmethod
    def of(
        cls, base: Mapping[str, object], parameter: str, value: float | str, changes: Mapping[str, object]
    ) -> Varied:
        """The campaign of a scene's tables with these changes."""
        return cls(parameter, value, changes, changed(base, changes))

    @property
    def folder(self) -> str:
        """Name of its folder."""
        value = self.value if isinstance(self.value, str) else f"{self.value:.12g}"
        return re.sub(r"[^\w.+-]+", "_", f"{self.parameter}-{value}")


SCENARIO = "scenario"
"""Parameter of the campaigns of `[[scenario]]`, whose values are names."""


def variants_of(scene: Mapping[str, object]) -> Iterator[Varied]:
    """The campaigns that a scene's paths of `[sweep]` and its scenarios ask for, one parameter at a time.

    Args:
        scene: its tables, with those of the sweep.

    Raises:
        ValueError: a path that leads nowhere, to no number, or to the key of another.
    """
    base = base_of(scene)
    paths: dict[str, Any] = dict(tables.read(tables.Sweep, table_of(scene, "sweep"), "sweep").paths)
    taken: dict[Keys, str] = {}
    gathered = Gathered()
    for name in paths:
        with gathered.of(), at("sweep"):
            keys = (path_of if name == tables.RECORDS else number_at)(base, name).keys
            if keys in taken:
                raise _twice(taken[keys], name)
            taken[keys] = name
    scenarios = [tables.read(tables.Scenario, table, SCENARIO) for table in tables_of(scene, SCENARIO)]
    names = [scenario.name for scenario in scenarios]
    for number, scenario in enumerate(scenarios):
        with gathered.of(), at(SCENARIO, number):
            if not scenario.paths:
                raise Invalid((), None, "changes nothing", "give the keys that it changes")
            if scenario.name in names[:number]:
                raise Invalid((), None, "is there twice", "name it anew")
            changed(base, scenario.paths)
    gathered.raise_all()
    records = paths.pop(tables.RECORDS, None)
    if records is not None:
        of_scene = number_at(base, SCALES).value(base)
        assert isinstance(of_scene, int | float)
        for record, scale in itertools.product(records, paths.pop(SCALES, [of_scene])):
            yield Varied.of(base, f"{SCALES} of {record}", scale, {tables.RECORDS: record, SCALES: scale})
    for name, values in paths.items():
        yield from (Varied.of(base, name, value, {name: value}) for value in values)
    yield from (Varied.of(base, SCENARIO, scenario.name, dict(scenario.paths)) for scenario in scenarios)


def base_of(scene: Mapping[str, object]) -> dict[str, object]:
    """A scene's tables without those of its sweep.

    Args:
        scene: its tables.
    """
    return {name: value for name, value in scene.items() if name not in ("sweep", SCENARIO)}
