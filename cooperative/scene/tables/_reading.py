"""Reading tables: all that is wrong at once, each with its value, what it may be, and the nearest key."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from itertools import chain
from typing import Any, TypeVar, get_args

from pydantic import TypeAdapter, ValidationError
from pydantic.fields import FieldInfo
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core import ErrorDetails
from pydantic_core.core_schema import NullableSchema, WithDefaultSchema

from cooperative.scene.tables._key import Part, keys
from jaxmpm.support.check import Faults, Invalid, Limit, about
from jaxmpm.support.text import shown

Schema = JsonSchemaValue

NAMED = 20
"""Unknown keys for which the nearest one is looked for."""

KNOWS = "; it knows"
"""Begins the keys of a table, which a message lists once."""

RANGE = ("greater_than", "greater_than_equal", "less_than", "less_than_equal")
CHOICE = ("choice", "literal_error")
UNKNOWN = "unexpected_keyword_argument"
NO_TABLE = ("dataclass_type", "dataclass_exact_type")
KINDS = {str: "text", bool: "true or false", int: "a whole number", float: "a number", list: "a list", dict: "a table"}
"""What a value of TOML is, in words."""

T = TypeVar("T")
P = TypeVar("P", bound=Part)


def read(table: type[P], values: object, where: str = "", *, files: object = None) -> P:
    """A table from its values, as TOML or JSON has them.

    Args:
        table: model of the table.
        values: as TOML or JSON has them.
        where: its name for messages; none for a whole scene.
        files: what the files hold that it names, as `Line` and `Raster` ask for it; None leaves their names.

    Raises:
        Faults: every key that is not known, with the nearest one that is, every one that lacks, and every value that a
            key cannot have.
    """
    try:
        return TypeAdapter(table).validate_python(values, context=files)
    except ValidationError as error:
        raise Faults(_faults(table, values, where, error)) from None


def refusal(table: type[Part], values: Mapping[str, object], error: ValidationError) -> ValueError:
    """Why Python cannot make a part of a campaign.

    Args:
        table: class of the part.
        values: by key, as Python gave them.
        error: of pydantic.
    """
    return Faults(_faults(table, values, "", error))


@contextmanager
def naming_keys(table: type[Part], values: object) -> Iterator[None]:
    """Name the key of what is refused inside, and the tables around it.

    Args:
        table: from which paths lead.
        values: as TOML or JSON has them.

    Raises:
        Invalid: with these names.
    """

    def named(error: ValueError) -> ValueError:
        if not isinstance(error, Invalid) or error.subject is not None:
            return error
        return error.named(str(_entry_at(table, values, "", (), error.path)))

    try:
        yield
    except Faults as error:
        raise Faults([named(fault) for fault in error.errors]) from error
    except Invalid as error:
        raise named(error) from error


@dataclass(frozen=True)
class _Entry:
    """Where a fault lies.

    path: tables around, as messages name them. key: in words, the last of them or a key. field: name of the key in its
    `owner`. value: what stands there. inner: the table that it may be. place: keys and positions that lead there.
    """

    path: tuple[str, ...]
    key: str
    value: object
    inner: type[Part] | None
    owner: type[Part] | None = None
    field: str = ""
    place: tuple[str | int, ...] = ()

    @property
    def whole(self) -> str:
        """Its name with those of the tables around."""
        return ".".join((*self.path, self.key))

    @property
    def section(self) -> str:
        """The table that it is, in words; of no name the scene, or what Python calls it."""
        if self.whole:
            return f"[{self.whole}]"
        return "the scene" if self.inner is None or self.inner.__name__ == "SceneTable" else self.inner.__name__

    def __str__(self) -> str:
        if self.inner is not None and (isinstance(self.value, Mapping | Part) or not self.key):
            return self.section
        return f"[{'.'.join(self.path)}] {self.key}" if self.path else self.key


def _entry_at(
    table: type[Part], values: object, where: str, location: Iterable[int | str], inside: Sequence[int | str] = ()
) -> _Entry:
    """Where pydantic's location leads: through tables, and into the list of those of which there are several.

    inside: path of an `Invalid` from there on, whose parts are keys whether declared or not.
    """
    entry = _Entry((), where, values, table)
    for part in (*location, *inside):
        inner, value = entry.inner, entry.value
        if isinstance(part, int):
            if inner is None:
                break  # an element of a list, which a message shows whole
            assert isinstance(value, list | tuple)
            value = value[part]
            name = _content(value, "name")
            label = f"{entry.field} {shown(name) if isinstance(name, str) else part + 1}"
            entry = _Entry(entry.path, label, value, inner, entry.owner, entry.field, (*entry.place, part))
        elif inner is not None and (part in keys(inner) or part in inside):
            tables = (*entry.path, entry.key) if entry.key else ()
            here = _content(value, str(part))
            declared = keys(inner).get(part)
            within = None if declared is None else table_in(declared)
            entry = _Entry(tables, str(part), here, within, inner, part, (*entry.place, part))
        # What is left determines which of the types of a union it is.
    return entry


def _content(value: object, key: str) -> object:
    """What a table, or a part of a campaign, holds under a key; None without."""
    return value.get(key) if isinstance(value, Mapping) else getattr(value, key, None)


def _faults(table: type[Part], values: object, where: str, error: ValidationError) -> list[ValueError]:
    """What is wrong with the values of a table: keys that are not known, keys that lack, and values.

    Each is named, but for what several checks of the whole table refuse: what is around it may have other words for it.
    """
    errors = error.errors(include_url=False)
    if any(fault["loc"][:1] != ("layer",) for fault in errors):
        # What a layer takes from [soil] is reported there.
        errors = [fault for fault in errors if fault["loc"][:1] != ("layer",) or _stands(values, fault["loc"])]
    unknown: list[Invalid] = []
    lacking: dict[str, tuple[_Entry, list[str]]] = {}
    wrong = dict[tuple[str, ...], list[ValueError]]()
    of_scene, listed = False, set[str]()
    for fault in errors:
        kind, location = fault["type"], fault["loc"]
        if kind == UNKNOWN:
            entry = _entry_at(table, values, where, location[:-1])
            of_scene |= not entry.whole
            # What no message names needs no words.
            likely = _suggestion(str(location[-1]), entry.inner, table) if len(unknown) < NAMED else ""
            if likely.startswith(KNOWS):
                likely = likely if entry.section not in listed else ""
                listed.add(entry.section)
            rule = f"has an unknown key {shown(location[-1])}{likely}"
            unknown.append(Invalid((*entry.place, location[-1]), None, rule, "", entry.section))
        elif kind == "missing" and isinstance(location[-1], str):
            entry = _entry_at(table, values, where, location[:-1])
            name = f"[{location[-1]}]" if entry.section == "the scene" else location[-1]
            lacking.setdefault(entry.section, (entry, []))[1].append(name)
        else:
            broken = fault["ctx"]["error"] if kind == "value_error" else None
            path = broken.path if isinstance(broken, Invalid) else ()
            entry = _entry_at(table, values, where, location, path)
            if (*entry.path, entry.key) not in wrong:  # the first of the types that it may have
                several = broken.errors if isinstance(broken, Faults) else ()
                wrong[*entry.path, entry.key] = [
                    about(str(entry), part, *entry.place) if entry.key else part for part in several
                ] or [_wrong(entry, fault)]
    if of_scene:
        lacking.pop("the scene", None)  # a table that lacks may be there under a name that is not known
    lacks = [
        Invalid(entry.place, None, f"lacks {', '.join(names)}", "add it", section)
        for section, (entry, names) in lacking.items()
    ]
    return [*unknown, *lacks, *chain.from_iterable(wrong.values())]


def _stands(values: Any, location: Iterable[int | str]) -> bool:
    """Whether the value at pydantic's location stands in tables, rather than what a layer takes from others."""
    for part in location:
        if isinstance(values, Mapping) and not str(part).startswith("("):  # which of the types of a union it is
            if part not in values:
                return False
            values = values[part]
        elif isinstance(part, int):
            values = values[part]
    return True


def _wrong(entry: _Entry, error: ErrorDetails) -> ValueError:
    """What is wrong with a value, and what it may be."""
    kind, value, subject = error["type"], entry.value, str(entry)
    rule, shown_value = "", shown(value)
    if kind == "value_error":
        broken: ValueError = error["ctx"]["error"]
        if isinstance(broken, Invalid) and broken.subject is None:
            return Invalid(entry.place, broken.value, broken.rule, broken.remedy, subject, broken.beside)
        return about(subject, broken, *entry.place) if entry.key else broken
    if kind in NO_TABLE:
        rule, remedy, subject = f"is {_kind(value)}", f"make it a table, {entry.section}", entry.whole
    elif entry.inner is not None and kind == "list_type":
        remedy = f"write [[{entry.key}]], once for each"
        return Invalid(entry.place, None, f"is {_kind(value)}", remedy, f"[{entry.key}]")
    elif entry.inner is not None and kind == "too_long":
        most, actual = error["ctx"]["max_length"], error["ctx"]["actual_length"]
        rule = f"has {actual} tables [[{entry.key}]], the limit is {most}"
        return Invalid(entry.place, None, rule, "give fewer", "the scene")
    else:
        assert entry.owner is not None
        schema = schema_of(entry.owner)["properties"][entry.field]
        if kind == "single" or (kind in RANGE and not math.isfinite(error["input"])):
            remedy = "give finite values, in single precision (1e-30 to 1e30)"
        elif kind in RANGE:
            number = f"{value:g}" if isinstance(value, int | float) else shown_value
            shown_value = f"{number} {first_entry(schema, 'unit', '')}".rstrip()
            number_alone = schema["oneOf"][0] if "oneOf" in schema else schema  # of a number, or a table
            remedy = f"give {allowed_values(number_alone)}{schema.get('remedy', '')}"
        elif kind in CHOICE:
            meant = [f" (did you mean {word}?)" for word in _meanings(schema.get("named", ""), str(value))]
            nearest = _nearest(value, first_entry(schema, "enum", list[str]()))
            remedy = f"give {allowed_values(schema)}{meant[0] if meant else nearest}"
        else:
            rule = f"is {_kind(value)}" if error["input"] is value and kind.endswith("_type") else ""
            remedy = f"give {allowed_values(schema, ends=False)}"
    return Invalid(entry.place, shown_value, rule, remedy, subject)


def _kind(value: object) -> str:
    return KINDS.get(type(value), f"a {type(value).__name__}")


def _suggestion(key: str, table: type[Part] | None, whole: type[Part]) -> str:
    """What an unknown key may stand for, in words.

    One that the table knows by another word, one of another table, the nearest one, or else all that are known.

    whole: the table around all.
    """
    assert table is not None
    if here := _synonyms(table, key):
        return f" (did you mean {' or '.join(here)}?)"
    for section, field in keys(whole).items():
        other = table_in(field)
        if other is not None and (there := [repr(key)] if key in keys(other) else _synonyms(other, key)):
            return f" (did you mean {there[0]} of [{section}]?)"
    return _nearest(key, keys(table)) or f"{KNOWS} {', '.join(keys(table))}"


def _synonyms(table: type[Part], key: str) -> list[str]:
    """Keys of a table that are also called so, each in words."""
    named = []
    for name, field in keys(table).items():
        extra = field.json_schema_extra
        meanings = _meanings(str(extra.get("synonyms", "")) if isinstance(extra, dict) else "", key)
        named += [f"{name} ({meaning})" if meaning else repr(name) for meaning in meanings]
    return named


def _meanings(synonyms: str, word: str) -> list[str]:
    """What a word stands for among synonyms as `key` has them; nothing where it is none."""
    pairs = (synonym.partition("=") for synonym in synonyms.split())
    return [meaning.replace("_", " ") for name, _, meaning in pairs if name == word.lower()]


def _nearest(word: object, keys: Iterable[str]) -> str:
    close = difflib.get_close_matches(str(word), list(keys), n=1)
    return f" (did you mean {close[0]!r}?)" if close else ""


class _Toml(GenerateJsonSchema):
    """TOML has no null: what may be None may be left out.

    A key needs no title beside its name.
    """

    def field_title_should_be_set(self, schema: object) -> bool:
        return False

    def nullable_schema(self, schema: NullableSchema) -> JsonSchemaValue:
        return self.generate_inner(schema["schema"])

    def default_schema(self, schema: WithDefaultSchema) -> JsonSchemaValue:
        return (
            super().default_schema(schema)
            if schema.get("default") is not None
            else self.generate_inner(schema["schema"])
        )


def schema_of(table: type) -> Schema:
    """JSON schema (draft 2020-12) of a table."""
    return _schema_of(table)


@cache
def _schema_of(table: type) -> Schema:
    return TypeAdapter(table).json_schema(schema_generator=_Toml)


def parts(field: FieldInfo) -> Iterator[object]:
    """All that the type of a key is made of."""

    def inside(annotation: object) -> Iterator[object]:
        yield annotation
        for part in get_args(annotation):
            yield from inside(part)

    yield from inside(field.annotation)
    yield from field.metadata


def table_in(field: FieldInfo) -> type[Part] | None:
    """The table that a key may hold."""
    return next((part for part in parts(field) if isinstance(part, type) and issubclass(part, Part)), None)


def first_entry(schema: object, name: str, otherwise: T) -> T:
    """The first entry of that name in a key's schema or in one within it."""
    if isinstance(schema, dict):
        if name in schema:
            entry: T = schema[name]
            return entry
        schema = list(schema.values())
    within = schema if isinstance(schema, list) else []
    return next(filter(None, (first_entry(part, name, otherwise) for part in within)), otherwise)


def allowed_values(schema: Schema, *, ends: bool = True) -> str:
    """What a key may hold, in words.

    Args:
        schema: of the key.
        ends: with the range of a number.
    """
    if "allowed" in schema:
        return str(schema["allowed"])
    if others := schema.get("oneOf", schema.get("anyOf")):
        return ", or ".join(allowed_values(part, ends=ends) for part in others)
    if "enum" in schema:
        return f"one of {', '.join(map(repr, schema['enum']))}"
    if "const" in schema:
        return repr(schema["const"])
    if "$ref" in schema:
        return "a table" if ends else "a table of how it varies"
    kind = schema["type"]
    if kind == "array":
        return _list(schema, ends)
    if kind in ("number", "integer"):
        limit = _limit(schema)
        whole = "a whole number" if kind == "integer" else "a number"
        if not ends or limit == Limit():
            return whole
        if kind == "integer":
            return f"a whole number of {limit.least} or more"
        return f"{limit}, or inf".replace("a finite", "a") if schema.get("infinite") else str(limit)
    return {"boolean": "true or false", "string": "text"}.get(kind, "a table")


def _limit(schema: Schema) -> Limit:
    return Limit(
        above=schema.get("exclusiveMinimum"),
        least=schema.get("minimum"),
        below=schema.get("exclusiveMaximum"),
        most=schema.get("maximum"),
    )


def _list(schema: Schema, ends: bool) -> str:
    if "prefixItems" in schema:
        return "two numbers"
    item = schema["items"]
    kinds = {"array": "lists of numbers", "string": "texts", "integer": "whole numbers"}
    words = f"a list of {'different ' if schema.get('uniqueItems') else ''}{kinds.get(item['type'], 'numbers')}"
    words += ", one per axis" if schema.get("per") == "axis" else ""
    return (
        f"{words}, each {allowed_values(item).removeprefix('a whole number of ')}"
        if ends and _limit(item) != Limit()
        else words
    )
