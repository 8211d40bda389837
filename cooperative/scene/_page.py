"""docs/scenes.md and the JSON schema for editors, from the tables that read a scene.

`python -m cooperative.scene` writes both.
"""

from __future__ import annotations

import copy
import json
from collections.abc import Mapping
from pathlib import Path
from typing import get_origin

from cooperative.example_scenes import NAMED, SCHEMA
from cooperative.scene import tables
from cooperative.scene._files import toml_value
from jaxmpm.support.files import write_aside

TABLES: Mapping[str, type[tables.Part]] = {
    name: table
    for name, field in tables.keys(tables.Scene).items()
    if name not in tables.STORED and (table := tables.table_in(field)) is not None
}
"""The tables that a scene may have, by name."""
SEVERAL = tuple(
    name for name in TABLES if any(get_origin(part) is list for part in tables.parts(tables.keys(tables.Scene)[name]))
)
"""Tables of which there may be several: `[[layer]]`."""


def json_schema() -> dict[str, object]:
    """JSON schema (draft 2020-12) of a scene, in which a description gives unit and default in words too."""
    head = {"$schema": "https://json-schema.org/draft/2020-12/schema"}
    schema = copy.deepcopy(tables.schema_of(tables.Scene))
    definitions = schema["$defs"]
    # A layer takes from [soil] what it leaves out.
    layer = json.loads(json.dumps(definitions["Layer"]).replace("/RandomField", "/RandomFieldOfLayer"))
    field = copy.deepcopy(definitions["RandomField"])
    del field["properties"]["sampled_at"], field["required"], layer["required"]
    inherited = [layer["properties"][name] for name in definitions["Soil"]["properties"]]
    for key in (*inherited, *field["properties"].values()):
        key.pop("default", None)
        key["otherwise"] = "that of [soil]"
    definitions |= {"Layer": layer, "RandomFieldOfLayer": field}
    return {**head, **_plain(schema)}


def _plain(schema: tables.Schema) -> dict[str, object]:
    """A schema, or a part of it, in the words of the standard."""
    words = " ".join(str(schema.get("description", "")).split())
    if "examples" in schema:
        unit, default = _unit(schema), schema.get("otherwise")
        words += (f" ({unit})" if unit else "") + (f" Default: {default}." if default else "")
    plain = {name: _plain_value(part) for name, part in schema.items() if name not in tables.EXTRAS}
    return plain | ({"description": words} if words else {})


def _plain_value(value: object) -> object:
    if isinstance(value, list):
        return [_plain_value(item) for item in value]
    return _plain(value) if isinstance(value, dict) else value


def markdown() -> str:
    """docs/scenes.md: every key with unit, default, range and example."""
    parts = [
        "# Scenes: every key\n",
        "A scene is a TOML file. This page is made from the tables that read it (`python -m cooperative.scene`).",
        f"So is [`{SCHEMA.name}`](../cooperative/{SCHEMA.name}), from which an editor completes keys:",
        "`jaxmpm new` and `jaxmpm example` write it beside the scene, whose first line is",
        f"`{NAMED.strip()}`. Lengths are in metres, stresses in Pa. `name`, outside all tables, is a title.",
        "`jaxmpm check` names all that is wrong with a scene at once, by its tables: the first twenty faults, and how",
        "many more there are.\n",
    ]
    explained: set[type[tables.Part]] = set()
    for section, table in TABLES.items():
        brackets = 2 if section in SEVERAL else 1
        description = tables.keys(tables.Scene)[section].description
        words = " ".join((description or tables.schema_of(table)["description"]).split())
        parts += [f"## `{'[' * brackets}{section}{']' * brackets}`\n", words + "\n"]
        if table in explained:
            continue
        explained.add(table)
        schema = tables.schema_of(table)
        parts += ["| key | what | unit | default | range | example |", "|---|---|---|---|---|---|"]
        left_out = tables.keys(tables.Soil) if table is tables.Layer else ()
        parts += [
            _row(name, part, _allowed(table, name, part), required=name in schema.get("required", ()))
            for name, part in schema["properties"].items()
            if name not in left_out
        ]
        parts.append("")
    return "\n".join(parts)


def _unit(schema: tables.Schema) -> str:
    return str(schema.get("units") or tables.first_entry(schema, "unit", ""))


def _allowed(table: type[tables.Part], name: str, schema: tables.Schema) -> str:
    """What a key may hold; of a table of its own, what that one's keys may."""
    inner: type | None = tables.table_in(tables.keys(table)[name])
    words = "a table" if "$ref" in schema else tables.wanted(schema)
    if inner is None or inner is tables.RandomField or not words.endswith("a table"):
        return words
    keys = tables.schema_of(inner)["properties"].items()
    return f"{words}: " + "; ".join(
        f"`{key}` {tables.wanted(annotation)} ({_unit(annotation) or '-'})" for key, annotation in keys
    )


def _row(name: str, schema: tables.Schema, allowed: str, *, required: bool) -> str:
    default = "none, give it" if required else schema.get("otherwise", "not used")
    if "default" in schema:
        default = f"`{json.dumps(schema['default'])}`"
    unit, example = _unit(schema) or "-", toml_value(schema["examples"][0])
    cells = (f"`{name}`", schema["description"], unit, default, allowed, f"`{example}`")
    return f"| {' | '.join(cells)} |"


def write(root: Path) -> None:
    """Write the page and the schema into a checkout."""
    write_aside(root / "docs" / "scenes.md", markdown().encode())
    write_aside(root / "cooperative" / SCHEMA.name, (json.dumps(json_schema(), indent=1) + "\n").encode())
