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
from cooperative.store import STORED_TABLES
from jaxmpm.support.files import write_aside

TABLES: Mapping[str, type[tables.Part]] = {
    name: table
    for name, field in tables.keys(tables.SceneTable).items()
    if name not in STORED_TABLES and (table := tables.table_in(field)) is not None
}
"""The tables that a scene may have, by name."""
SEVERAL = tuple(
    name
    for name, field in tables.keys(tables.SceneTable).items()
    if any(get_origin(part) is list for part in tables.parts(field))
)
"""Tables of which there may be several: `[[layer]]`."""
BEGIN = f"""# Scenes: every key

A scene is a TOML file. Lengths are in metres, stresses in Pa, unit weights in N/m3, angles in degrees. x runs along the
ground, z upwards, from a zero that you choose; z may be negative. `name`, outside all tables, is a title.
`jaxmpm check` lists the first twenty faults of a scene by table, and how many more there are.

| to give | table | needed |
|---|---|---|
| the ground | `[slope]`, `[ground]` (a section that you draw) or `[terrain]` | one of them |
| layers of `[ground]` or `[terrain]`, from the top down | `[[layer]]` | no |
| the soil; in layers, what they leave out | `[soil]` | unless every layer gives all of its own |
| what varies: any parameter as a table with `mean`, `cov` and `length` | `[soil.cohesion]`, `[layer.friction]`; \
`[strength]` for undrained strength | no |
| correlation between parameters | `[cross_correlation]` | no |
| water at rest; rain; a river that falls | `[water]`; `[rain]`; `[drawdown]` | no |
| an earthquake: pseudo-static; a record | `[run]` `k_h`; `[motion]` | no |
| the grids, and how samples run on them | `[rough]`, `[refined]`, `[coarse]`; `[run]` | `[rough]`, `[refined]` |
| how many samples, and the estimate of P_f | `[campaign]` | yes |
| roads and houses; maps | `[[exposed]]`; `[hazard]` | no |
| other values of the same scene | `[sweep]`, `[[scenario]]` | no |

`jaxmpm new --kind section` (or `slope`, `terrain`) writes a scene to fill in, and `{SCHEMA.name}` beside it. By the
first line, `{NAMED.strip()}`, an editor completes keys from it. `python -m cooperative.scene` makes this page
and [the schema](../cooperative/{SCHEMA.name}) from the tables that read a scene.

## An example

A 15 m cut in sand over clay. Water stands 3 m below the crest, 8 mm/h of rain fall for two days, and a road runs 20 m
beyond the toe. Cohesion and friction vary and are correlated by -0.4. The numbers of the soils are made up.

```toml
name = "a cut in sand over clay"

[ground]
surface = [[0, 15], [20, 15], [42.5, 0], [92, 0]]       # [x, z] from wall to wall
base = -6.0
toe = 42.5                                              # run-out counts from here

[[layer]]
name = "sand"
bottom = [[0, 7], [32, 7]]                              # ends where it meets the face
cohesion = {{ mean = 3e3, cov = 0.3 }}                    # length and the rest are those of [soil]
friction = {{ mean = 34.0, cov = 0.1 }}

[[layer]]
name = "clay"                                           # down to the base, with the soil of [soil]

[soil]
unit_weight = 18e3
saturated_unit_weight = 20e3
young = 3e7
poisson = 0.3
cohesion = {{ mean = 10e3, cov = 0.3, length = [40.0, 2.0] }}
friction = {{ mean = 24.0, cov = 0.12, length = [40.0, 2.0] }}

[cross_correlation]
parameters = ["cohesion", "friction"]
matrix = [[1.0, -0.4], [-0.4, 1.0]]                     # of the Gaussian fields, -0.39 of the parameters

[water]                                                 # at rest before the rain
table = [[0, 12], [20, 12], [42.5, 0], [92, 0]]

[rain]
times = ["0 h", "12 h", "24 h", "36 h", "48 h", "72 h"]
at = "48 h"                                             # the time of `jaxmpm run`
rate = [["0 h", "8 mm/h"], ["48 h", 0.0]]
soil = {{ soil_class = "sand" }}
layer = [{{ name = "clay", soil_class = "clay" }}]

[rough]
cell = 2.0
spacing = [1.0, 1.0]

[refined]
cell = 1.0
spacing = [0.5, 0.5]

[[exposed]]
name = "road"
between = [62.5, 70.5]                                  # x of the scene: toe + 20 m and its width

[campaign]
samples = 100
seed = 1
```

`jaxmpm run` answers for the end of the rain; `jaxmpm seepage FILE --probability` for
[all its times](walks.md#from-a-hyetograph-to-p_f-against-time).
"""


def json_schema() -> dict[str, object]:
    """JSON schema (draft 2020-12) of a scene, in which a description gives unit and default in words too."""
    head = {"$schema": "https://json-schema.org/draft/2020-12/schema"}
    schema = copy.deepcopy(tables.schema_of(tables.SceneTable))
    definitions = schema["$defs"]
    # A layer takes from [soil] what it leaves out.
    layer = json.loads(json.dumps(definitions["LayerTable"]).replace("/RandomField", "/RandomFieldOfLayer"))
    field = copy.deepcopy(definitions["RandomField"])
    del field["properties"]["sampled_at"], field["required"], layer["required"]
    inherited = [layer["properties"][name] for name in definitions["SoilTable"]["properties"]]
    for key in (*inherited, *field["properties"].values()):
        key.pop("default", None)
        key["otherwise"] = "that of [soil]"
    definitions |= {"LayerTable": layer, "RandomFieldOfLayer": field}
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
    parts = [BEGIN]
    explained: list[object] = []
    for section, table in TABLES.items():
        brackets = 2 if section in SEVERAL else 1
        description = tables.keys(tables.SceneTable)[section].description
        words = " ".join((description or tables.schema_of(table)["description"]).split())
        parts += [f"## `{'[' * brackets}{section}{']' * brackets}`\n", words + "\n"]
        schema = tables.schema_of(table)
        if schema["properties"] in explained:
            continue
        explained.append(schema["properties"])
        parts += ["| key | what | unit | default | range | example |", "|---|---|---|---|---|---|"]
        left_out = tables.keys(tables.SoilTable) if table is tables.LayerTable else ()
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
    words = "a table" if "$ref" in schema else tables.allowed_values(schema)
    if inner is None or inner is tables.RandomField or not words.endswith("a table"):
        return words
    keys = tables.schema_of(inner)["properties"].items()
    return f"{words}: " + "; ".join(
        f"`{key}` {tables.allowed_values(annotation)} ({_unit(annotation) or '-'})" for key, annotation in keys
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
