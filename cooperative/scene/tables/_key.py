"""What a key of a scene may hold, and how it is declared: its type, unit, range, default, meaning and example, once."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, fields
from functools import wraps
from inspect import cleandoc
from typing import Annotated, Any, Literal, TypeVar, cast, dataclass_transform

import numpy as np
from annotated_types import Ge, GroupedMetadata, Interval, MinLen
from pydantic import (
    AfterValidator,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    InstanceOf,
    PlainValidator,
    Strict,
    Tag,
    ValidationError,
    ValidationInfo,
)
from pydantic import field_validator as validates
from pydantic.config import JsonDict
from pydantic.dataclasses import dataclass as pydantic_dataclass
from pydantic.fields import FieldInfo
from pydantic.json_schema import SkipJsonSchema
from pydantic_core import PydanticCustomError

import jaxmpm as mpm
from jaxmpm.support.check import Invalid, Limit, above_zero, from_zero
from jaxmpm.support.text import shown
from jaxmpm.support.values import by_value

T = TypeVar("T")
F = TypeVar("F")

EXTRAS = ("unit", "units", "otherwise", "allowed", "remedy", "synonyms", "named", "per", "infinite")
"""What a key's JSON schema has beyond the standard, for messages and for the page of keys."""


def key(
    meaning: str, example: object, default: object = ..., *, otherwise: str = "", allowed: str = "", remedy: str = "",
    synonyms: str = "", named: str = "", units: str = "",
) -> Any:  # fmt: skip
    """A key of a table.

    Args:
        meaning: what it is, in words.
        example: a value.
        default: its value where a scene does not give it; without one the key is required.
        otherwise: in words, what holds where a scene does not give it and the default is None.
        allowed: in words, what it may hold where its type does not show that.
        remedy: what else to do about a number that is out of range, for the end of a message.
        synonyms: other words for it, each with what it stands for after "=" where that is not the whole key, "_" for a
            space there.
        named: other words for what it may hold, likewise.
        units: what it is measured in, where its type has no unit.
    """
    extras = {"otherwise": otherwise, "allowed": allowed, "remedy": remedy, "synonyms": synonyms,
              "named": named, "units": units}  # fmt: skip
    extra: JsonDict = {name: words for name, words in extras.items() if words}
    return Field(default, description=meaning, examples=[example], json_schema_extra=extra)


CONFIG = ConfigDict(extra="forbid", validate_default=True, arbitrary_types_allowed=True)


@pydantic_dataclass(frozen=True, config=CONFIG)
class Part:
    """A table that is a part of a campaign, in TOML and in Python: its fields are its keys.

    Numbers and arrays of NumPy become plain ones.
    """

    @validates("*", mode="before")
    @classmethod
    def _plain(cls, value: object) -> object:
        value = plain(value)
        if any(isinstance(leaf, int) and not -(2**63) <= leaf < 2**63 for leaf in leaves(value)):
            raise Invalid((), None, "is a whole number beyond 64 bits", "give a smaller one")
        return value


@dataclass_transform(frozen_default=True)
def table(kind: type[T]) -> type[T]:
    """Make a subclass of `Part` a frozen dataclass, which refuses a value in the words of its keys and explains them.

    Args:
        kind: the class.
    """
    words = cleandoc(kind.__doc__ or "")
    config = ConfigDict(**CONFIG, json_schema_extra={"description": words} | getattr(kind, "SCHEMA", {}))
    made: Any = pydantic_dataclass(frozen=True, config=config)(kind)
    if "\nArgs:" not in words:
        explained = "\n".join(f"    {name}: {field.description}" for name, field in keys(made).items())
        made.__doc__ = f"{words}\n\nArgs:\n{explained}"
    init = made.__init__
    names = [field.name for field in fields(made) if field.init]

    @wraps(init)
    def checked(self: T, *args: object, **kwargs: object) -> None:
        arguments = dict(zip(names, args, strict=False))
        if len(args) > len(names) or arguments.keys() & kwargs.keys():
            raise TypeError(f"{made.__name__} has the fields {', '.join(names)}: give each once")
        try:
            init(self, **arguments, **kwargs)
        except ValidationError as error:
            # Reading needs the tables.
            from cooperative.scene.tables._reading import refusal

            raise refusal(made, arguments | kwargs, error) from error

    made.__init__ = checked
    return cast(type[T], by_value(made))


def keys(kind: type) -> Mapping[str, FieldInfo]:
    """Keys of a table, each with what it declares."""
    declared: Mapping[str, FieldInfo] = kind.__pydantic_fields__  # type: ignore[attr-defined]
    return declared


def made(kind: Callable[..., T], part: Part, **others: object) -> T:
    """An object whose fields are keys of a part.

    Args:
        kind: its class, a dataclass.
        part: of a campaign.
        **others: fields in place of those keys.
    """
    values = {field.name: getattr(part, field.name) for field in fields(cast(Any, kind)) if hasattr(part, field.name)}
    return kind(**{**values, **others})


def plain(value: object) -> object:
    """A value without numbers and arrays of NumPy, which become plain ones."""
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    return [plain(item) for item in value] if isinstance(value, list | tuple) else value


def leaves(value: object) -> Iterator[object]:
    """What lists hold that are no lists."""
    if isinstance(value, list):
        for item in value:
            yield from leaves(item)
    else:
        yield value


def fits(value: object) -> bool:
    """Whether single precision holds a number, with some room for products of it."""
    return not isinstance(value, float) or value == 0 or 1e-30 <= abs(value) <= 1e30


def _single(value: float) -> float:
    if not fits(value):
        raise PydanticCustomError("single", "beyond single precision")
    return value


def _single_or_infinite(value: float) -> float:
    return value if value == float("inf") else _single(value)


@dataclass(frozen=True)
class Within(GroupedMetadata):
    """Of a type: a number in single precision within a limit, in the limit's unit.

    Args:
        limit: of the number.
        infinite: whether inf is one.
    """

    limit: Limit = Limit()
    infinite: bool = False

    def __iter__(self) -> Iterator[object]:
        limit = self.limit
        yield Strict()
        yield Interval(gt=limit.above, ge=limit.least, lt=limit.below, le=limit.most)
        yield AfterValidator(_single_or_infinite if self.infinite else _single)
        extra: JsonDict = {"unit": limit.unit} if limit.unit else {}
        yield Field(json_schema_extra=extra | ({"infinite": True} if self.infinite else {}))


@dataclass(frozen=True)
class FromScript:
    """Stands for an object that a script gave, of which its folder knows only the words.

    Args:
        what: part of the campaign.
        words: of the object.
    """

    what: str
    words: str


def one_of(choices: Mapping[str, object], others: type | None = None) -> PlainValidator:
    """Of a type: a text that names one of the choices, for which the value then stands; or what it stands for.

    Args:
        choices: by name.
        others: what Python may give besides, or a folder for it.
    """
    allowed = () if others is None else (others, FromScript)

    def chosen(value: object) -> object:
        if isinstance(value, list):
            value = tuple(value)
        if any(value is choice or value == choice for choice in choices.values()) or isinstance(value, allowed):
            return value
        if not isinstance(value, str) or value not in choices:
            raise PydanticCustomError("choice", "no choice")
        return choices[value]

    return PlainValidator(chosen, json_schema_input_type=Literal[tuple(choices)])


Flag = Annotated[bool, Strict()]
Text = Annotated[str, Strict()]
Count = Annotated[int, Strict(), Ge(1)]
FromNone = Annotated[int, Strict(), Ge(0)]
Number = Annotated[float, Within()]
AboveZero = Annotated[float, Within(above_zero())]
FromZero = Annotated[float, Within(from_zero())]
Share = Annotated[float, Within(Limit(least=0, most=1))]
Metres = Annotated[float, Within(Limit(unit="m"))]
Length = Annotated[float, Within(above_zero("m"))]
Depth = Annotated[float, Within(from_zero("m"))]
Seconds = Annotated[float, Within(above_zero("s"))]
Degrees = Annotated[float, Within(Limit(unit="degrees"))]

MOST_POINTS = 10_000
"""Points of a line that a scene holds itself."""
FORMULA = "=+-@"
"""Characters by which a spreadsheet knows a formula."""


def check_name(name: str, most: int) -> str:
    """A name that tables, figures and terminals show as it is.

    Args:
        name: to be checked.
        most: characters of it.

    Raises:
        ValueError: it has control characters, or is a formula to a spreadsheet.
    """
    if not name.isprintable() or not 0 < len(name) <= most:
        raise Invalid((), shown(name), "", f"give one line of at most {most} characters without control characters")
    if name[0] in FORMULA:
        raise Invalid((), shown(name), "", "a spreadsheet takes it for a formula, begin it otherwise")
    return name


def plain_name(most: int) -> AfterValidator:
    """Of a text: `check_name`."""
    return AfterValidator(lambda name: check_name(name, most))


Name = Annotated[str, plain_name(200)]
"""Of a campaign or a layer."""
LONGEST_LABEL = 60
"""Characters of the name of an element at risk or a scenario, by which columns and figures are labelled."""
Label = Annotated[str, plain_name(LONGEST_LABEL)]
MOST_TABLES = 100
"""Tables that one key may have: layers, elements at risk, scenarios."""

Pair = Annotated[tuple[T, T], Strict(False)]
Several = Annotated[tuple[T, ...], Strict(False), MinLen(1)]
PerAxis = Annotated[tuple[T, ...], Strict(False), MinLen(1), Field(json_schema_extra={"per": "axis"})]
Rows = Annotated[tuple[Several[Number], ...], Strict(False), MinLen(1)]


def _opened(corners: tuple[tuple[float, float], ...]) -> tuple[tuple[float, float], ...]:
    """Corners of a polygon without the first one again at its end, with which other programs close a ring."""
    if corners[0] != corners[-1]:
        return corners
    if len(corners) < 4:
        raise Invalid((), shown(corners), "", "give three or more different corners")
    return corners[:-1]


Polygon = Annotated[tuple[Pair[Metres], ...], Strict(False), MinLen(3), AfterValidator(_opened)]
"""Corners in plan (m), the first one again at the end or not."""

OrTable = Annotated[
    Annotated[T, Tag("(number)")] | Annotated[F, Tag("(table)")],
    Discriminator(lambda value: "(table)" if isinstance(value, dict | Part) else "(number)"),
]
"""A number, or a table of how it varies."""


def as_points(value: object) -> tuple[tuple[float, float], ...]:
    """The points of a line as tuples.

    Raises:
        Invalid: the value is no line.
    """
    if not isinstance(value, list) or len(value) < 2:
        raise Invalid((), shown(value), "", "give points [[x, z], ...], two or more, or the name of a file")
    if len(value) > MOST_POINTS:
        raise Invalid((), None, f"has {len(value)} points, the limit is {MOST_POINTS}", "give fewer")
    for number, point in enumerate(value, 1):
        if not (isinstance(point, list) and len(point) == 2 and all(map(_is_finite, point))):
            raise Invalid(
                (), None, f"has a point {number} = {shown(point)}", "give [x, z] in metres, two finite numbers"
            )
    return tuple((float(x), float(z)) for x, z in value)


def _is_finite(value: object) -> bool:
    return (
        isinstance(value, int | float) and not isinstance(value, bool) and (value == 0 or 1e-30 <= abs(value) <= 1e30)
    )


def _points(value: object, info: ValidationInfo) -> object:
    if not isinstance(value, str):
        return as_points(value)
    # The outline of the ground has a surface; of any other closed line it is not clear which edge is meant.
    return (
        value if info.context is None else as_points(info.context.points(value, outline=info.field_name == "surface"))
    )


Line = Annotated[
    tuple[tuple[float, float], ...],
    PlainValidator(_points, json_schema_input_type=Annotated[list[tuple[float, float]], MinLen(2)] | str),
    Field(json_schema_extra={"allowed": "points [[x, z], ...], or the name of a file"}),
]
"""Points [x, z] (m), also by the name of a file: the context, `scene._files.Files`, has them."""


def of_file(read: Callable[[Any, str], object]) -> BeforeValidator:
    """Of a type of rows: these, or what the file of a name has; the name where there is no context."""

    def rows(value: object, info: ValidationInfo) -> object:
        return read(info.context, value) if isinstance(value, str) and info.context is not None else value

    return BeforeValidator(rows, json_schema_input_type=Rows | str)


Data = Annotated[
    Rows,
    of_file(lambda files, name: files.data(name)),
    Field(json_schema_extra={"allowed": "rows of a coordinate per axis and the value, or the name of a file"}),
]
"""Rows of numbers, also by the name of a file, likewise."""


def _content(read: Callable[[ValidationInfo, str], object]) -> AfterValidator:
    """Of a type: the content of the file of this name, or the name where there is no context."""
    return AfterValidator(lambda name, info: name if info.context is None else read(info, name))


_FILE = Field(json_schema_extra={"allowed": "the name of a file"})
Raster = Annotated[
    Annotated[str, _content(lambda info, name: info.context.raster(name))] | SkipJsonSchema[InstanceOf[mpm.Raster]],
    _FILE,
]
"""Heights by the name of a file, likewise, or themselves."""
Record = Annotated[
    Annotated[str, _content(lambda info, name: info.context.motion(name, info.data.get("record_unit")))]
    | SkipJsonSchema[InstanceOf[mpm.BaseMotion]],
    _FILE,
]
"""A record of motion by the name of a file, likewise, or itself."""


def of_features(value: Any, name: str | None = None, *, holes: bool = False) -> Any:
    """The points of what may be features of a file: those of this name, or of the only one.

    Args:
        value: points, or features as `scene._files.Files` has them, None for neither.
        name: of the feature, None for the only one.
        holes: whether it may have some.

    Raises:
        Invalid: the file has several features, and none or many of this name; or it has holes.
    """
    if not value or not isinstance(value[0], dict):
        return value
    chosen = [part for part in value if name is not None and part["name"] == name] if len(value) > 1 else value
    if len(chosen) != 1:
        names = ", ".join(shown(part["name"]) for part in value[:8])
        needs = "one feature is needed" if name is None else f"{len(chosen)} are called {shown(name)} in a column name"
        raise Invalid(
            (), None, f"names a layer that has {len(value)} features ({names}), and {needs}", "give the layer of one"
        )
    if chosen[0]["holes"] and not holes:
        feature = shown(chosen[0]["name"])
        raise Invalid((), None, f"names {feature}, which has holes, and this polygon cannot have any", "fill them")
    return tuple(tuple(map(float, point)) for point in chosen[0]["points"])


Features = Annotated[str, _content(lambda info, name: info.context.features(name))]
"""Lines or polygons in plan by the name of a file and its layer, "site.gpkg#houses", likewise."""
OrFile = Annotated[
    Annotated[T, Tag("(points)")] | Annotated[Features, Tag("(file)")],
    Discriminator(lambda value: "(file)" if isinstance(value, str) else "(points)"),
]
"""Points, or features of a file."""
Only = AfterValidator(lambda value: of_features(value))
"""Of a type: the only feature of a file."""
