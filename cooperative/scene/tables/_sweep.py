"""Tables of a sweep: `[sweep]` and `[[scenario]]`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Self

from annotated_types import Ge
from pydantic import AfterValidator, ConfigDict, Field
from pydantic import model_validator as validates

from cooperative.scene.tables._key import FromZero, Length, Several, T, Table, check_name, key, plain_name
from jaxmpm.support.check import Invalid
from jaxmpm.support.text import shown

LONGEST_NAME = 60
RECORDS = "motion.record"
"""Path of the only texts that are swept."""
MOST_PATH = 400
"""Characters of the name of a file."""


def flat(given: Mapping[str, object], prefix: str = "") -> dict[str, object]:
    """Values by path, of paths in quotes and of tables within tables.

    Args:
        given: a table.
        prefix: path of that table, with its last dot.
    """
    paths: dict[str, object] = {}
    for name, value in given.items():
        paths |= flat(value, f"{prefix}{name}.") if isinstance(value, dict) else {f"{prefix}{name}": value}
    return paths


def _different(values: tuple[T, ...]) -> tuple[T, ...]:
    if len(set(values)) < len(values):
        raise Invalid((), str(list(values)), "", "give a list of different numbers")
    return values


Different = Annotated[Several[T], AfterValidator(_different), Field(json_schema_extra={"uniqueItems": True})]


class Sweep(Table):
    """Values of parameters.

    Each is changed alone, with the others as the scene has them. The scene is then many campaigns, and `jaxmpm sweep`
    runs them. It needs `coefficients = "latin hypercube"` and an estimator other than `"subset"`. One key at least.
    The keys below are of a table `[strength]`. Any other number of the scene is swept by its path in quotes:
    `"water.level" = [2, 3, 4]`, `"run.k_h" = [0, 0.1]`, `"run.strength_factor" = [0.9, 1.0]`, `"slope.height"`. A
    layer goes by its name: `"layer.clay.strength.mean"`. `"motion.record" = ["a.csv", "b.csv"]` goes through records,
    each with all values of `"motion.scale"`.
    """

    model_config = ConfigDict(extra="allow")

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

    @validates(mode="before")
    @classmethod
    def _paths(cls, given: object) -> object:
        """A path without quotes is tables within tables."""
        return flat(given) if isinstance(given, dict) else given

    @validates(mode="after")
    def _values(self) -> Self:
        """Values of paths are lists of different numbers, of records names of files."""
        for path, values in (self.model_extra or {}).items():
            kinds = str if path == RECORDS else int | float
            alike = isinstance(values, list) and all(isinstance(v, kinds) and not isinstance(v, bool) for v in values)
            if not alike or not values or len(set(values)) < len(values):
                what = "names of files" if path == RECORDS else "numbers"
                raise Invalid((path,), shown(values), "", f"give a list of different {what}")
            for name in values if kinds is str else ():
                check_name(name, MOST_PATH)
        return self


class Scenario(Table):
    """A campaign of a sweep that differs from the scene in any keys, such as the surface of ground with a berm.

    Beside `name`, the keys that change, by their paths: `ground.surface = [[0, 12], [30, 12], [42, 6], [50, 6]]`,
    `water.level = 2.0`, `"layer.clay.strength.mean" = 30e3`. One `[[scenario]]` for each, run by `jaxmpm sweep` with
    the samples of the scene.
    """

    model_config = ConfigDict(extra="allow")

    name: Annotated[str, plain_name(LONGEST_NAME)] = key("What it is called.", "berm")
