"""Tables of a sweep: `[sweep]` and `[[scenario]]`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Self

from annotated_types import Ge
from pydantic import AfterValidator, Field
from pydantic import model_validator as validates
from pydantic.config import JsonDict
from pydantic.json_schema import SkipJsonSchema

from cooperative.scene.tables._key import FromZero, Label, Length, Part, Several, T, check_name, key, keys, table
from jaxmpm.support.check import Invalid
from jaxmpm.support.text import shown

RECORDS = "motion.record"
"""Path of the only texts that are swept."""
MOST_PATH = 400
"""Characters of the name of a file."""


def _flat(tables: Mapping[str, object], prefix: str = "") -> dict[str, object]:
    """Values by path, of paths in quotes and of tables within tables; prefix: path of that table, with its last dot."""
    paths: dict[str, object] = {}
    for name, value in tables.items():
        paths |= _flat(value, f"{prefix}{name}.") if isinstance(value, dict) else {f"{prefix}{name}": value}
    return paths


def _different(values: tuple[T, ...]) -> tuple[T, ...]:
    if len(set(values)) < len(values):
        raise Invalid((), str(list(values)), "", "give a list of different numbers")
    return values


Different = Annotated[Several[T], AfterValidator(_different), Field(json_schema_extra={"uniqueItems": True})]


class _WithPaths(Part):
    """A table of a scene with paths beside its keys, whose values Python has in `paths`."""

    SCHEMA: ClassVar[JsonDict] = {"additionalProperties": True}

    @validates(mode="before")
    @classmethod
    def _by_path(cls, values: object) -> object:
        if not isinstance(values, dict):
            return values
        named = {name: value for name, value in values.items() if name in keys(cls) and name != "paths"}
        return named | {"paths": _flat({name: value for name, value in values.items() if name not in named})}


@table
class Sweep(_WithPaths):
    """Values of parameters.

    Each is changed alone, with the others as the scene has them. The scene is then many campaigns, and `jaxmpm sweep`
    runs them. It needs `coefficients = "latin hypercube"` and an estimator other than `"subset"`. One key at least.
    The keys below are of a table `[strength]`. Any other number of the scene is swept by its path in quotes:
    `"water.level" = [2, 3, 4]`, `"run.k_h" = [0, 0.1]`, `"run.strength_factor" = [0.9, 1.0]`, `"slope.height"`. A
    layer goes by its name: `"layer.clay.strength.mean"`. `"motion.record" = ["a.csv", "b.csv"]` goes through records,
    each with all values of `"motion.scale"`.
    """

    lx: Different[Length] | None = key(
        "Correlation lengths of the strength along x.", [10, 30, 60, 120], None, otherwise="not varied"
    )
    ly: Different[Length] | None = key(
        "Correlation lengths along y, of a scene in 3D.", [6, 12, 24], None, otherwise="not varied"
    )
    lz: Different[Length] | None = key("Correlation lengths along z.", [1, 2, 4], None, otherwise="not varied")
    cov: Different[FromZero] | None = key(
        "Coefficients of variation of the strength.", [0.2, 0.3, 0.4], None, otherwise="not varied"
    )
    k_t: Different[Annotated[int, Ge(1)]] | None = key(
        'Stopping rules of `"published"`, all evaluated from one campaign with the largest.', [2, 5, 10], None,
        otherwise="not varied",
    )  # fmt: skip
    paths: SkipJsonSchema[Mapping[str, Any]] = key("Values of other keys, by path.", {"water.level": [2, 3]}, {})

    @validates(mode="after")
    def _values(self) -> Self:
        """Values of paths are lists of different numbers, of records names of files."""
        for path, values in self.paths.items():
            kinds = str if path == RECORDS else int | float
            alike = isinstance(values, list) and all(isinstance(v, kinds) and not isinstance(v, bool) for v in values)
            if not alike or not values or len(set(values)) < len(values):
                what = "names of files" if path == RECORDS else "numbers"
                raise Invalid((path,), shown(values), "", f"give a list of different {what}")
            for name in values if kinds is str else ():
                check_name(name, MOST_PATH)
        return self

    @property
    def of_strength(self) -> dict[str, tuple[float, ...]]:
        """Values of what varies in `[strength]`, by key."""
        swept = {name: getattr(self, name) for name in ("lx", "ly", "lz", "cov")}
        return {name: values for name, values in swept.items() if values is not None}


@table
class Scenario(_WithPaths):
    """A campaign of a sweep that differs from the scene in any keys, such as the surface of ground with a berm.

    Beside `name`, the keys that change, by their paths: `ground.surface = [[0, 12], [30, 12], [42, 6], [50, 6]]`,
    `water.level = 2.0`, `"layer.clay.strength.mean" = 30e3`. One `[[scenario]]` for each, run by `jaxmpm sweep` with
    the samples of the scene.
    """

    name: Label = key("What it is called.", "berm")
    paths: SkipJsonSchema[Mapping[str, Any]] = key("New values of keys, by path.", {"water.level": 2.0}, {})
