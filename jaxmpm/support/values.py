"""Frozen dataclasses that are shown in a few lines and compared by value, whatever arrays they hold."""

from __future__ import annotations

import dataclasses
import enum
import itertools
import textwrap
from collections.abc import Mapping
from typing import Any, TypeVar

import jax
import numpy as np

from jaxmpm.support.text import short

Class = TypeVar("Class", bound=type)

WIDTH, LINES = 100, 10
"""Characters and lines that a value is shown in at most."""

ENDS = 2
"""Items at each end of a long sequence that are shown where all of them would take more lines."""

DEEPEST = 4
"""Levels of nested dataclasses that are shown, fewer where they would take more lines."""


def by_value(cls: Class) -> Class:
    """Show a dataclass in ten lines at most, and compare it by value.

    Arrays are shown by type and shape, and nothing that is None or has its default. `==` compares every field and gives
    a bool; it refuses traced values. Both stay as a class defines them itself.

    Args:
        cls: a dataclass.

    Returns:
        The same class.
    """
    for name, better in (("__repr__", shown), ("__eq__", equal)):
        if _generated(vars(cls).get(name)):
            setattr(cls, name, better)
    return cls


def _generated(method: Any) -> bool:
    """Whether `dataclass` wrote a method, and not the class's author."""
    code = getattr(getattr(method, "__wrapped__", method), "__code__", None)
    return code is not None and code.co_filename == "<string>"


def shown(value: object) -> str:
    """A dataclass in ten lines at most.

    Args:
        value: a dataclass.

    Returns:
        Its class and fields, an array as its type and shape.
    """
    lines: list[str] = []
    for depth, ends in itertools.product(range(DEEPEST, -1, -1), (None, ENDS)):
        text = _text(value, depth, ends)
        lines = textwrap.wrap(text, WIDTH, subsequent_indent="    ", break_long_words=False)
        if len(lines) <= LINES:
            break
    return "\n".join(lines if len(lines) <= LINES else [*lines[: LINES - 1], "    ...)"])


def _text(value: Any, depth: int, ends: int | None) -> str:
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = [f for f in dataclasses.fields(value) if f.repr and not _is_default(getattr(value, f.name), f.default)]
        if depth == 0 and fields:
            return f"{type(value).__name__}(...)"
        inner = (f"{f.name}={_text(getattr(value, f.name), depth - 1, ends)}" for f in fields)
        return f"{type(value).__name__}({', '.join(inner)})"
    if _is_array(value):
        if value.shape == () and not isinstance(value, jax.core.Tracer | jax.ShapeDtypeStruct):
            return f"{np.asarray(value).item():.6g}" if value.dtype.kind in "fiu" else str(value)
        kind = value.dtype.name.replace("float", "f").replace("int", "i")
        return f"{kind}[{','.join(map(str, value.shape))}]"
    if isinstance(value, tuple) and hasattr(value, "_fields"):
        inner = (f"{name}={_text(item, depth - 1, ends)}" for name, item in zip(value._fields, value, strict=True))
        return f"{type(value).__name__}({', '.join(inner)})"
    if isinstance(value, tuple | list):
        items = [_text(item, depth, ends) for item in value]
        if ends is not None and len(items) > 2 * ends + 1:
            items[ends:-ends] = ["..."]
        return f"({', '.join(items)}{',' * (len(value) == 1)})"
    if isinstance(value, Mapping):
        return f"{{{', '.join(f'{key!r}: {_text(item, depth, ends)}' for key, item in value.items())}}}"
    return str(value) if isinstance(value, enum.Enum) else getattr(value, "__name__", None) or short(repr(value))


def _is_default(value: object, default: object) -> bool:
    """Whether a value is None or the default of its field, which pydantic wraps."""
    default = getattr(default, "default", default)
    if value is None or value is default:
        return True
    return isinstance(value, bool | int | float | str | tuple) and value == default


def equal(value: object, other: object) -> bool:
    """Whether two dataclasses of one class have equal fields, arrays of equal type, shape and values.

    Args:
        value: a dataclass.
        other: anything.

    Returns:
        Whether they do; NotImplemented for another class.

    Raises:
        TypeError: If a value is traced, so that it is not known yet.
    """
    if other.__class__ is not value.__class__:
        return NotImplemented
    names = [f.name for f in dataclasses.fields(value) if f.compare]  # type: ignore[arg-type]
    return all(_same(getattr(value, name), getattr(other, name)) for name in names)


def _same(one: Any, other: Any) -> bool:
    if one is other:
        return True
    if isinstance(one, jax.core.Tracer) or isinstance(other, jax.core.Tracer):
        raise TypeError("== of values that are traced, which are not known yet: compare arrays of them by jnp")
    if _is_array(one) or _is_array(other):
        alike = np.shape(one) == np.shape(other) and getattr(one, "dtype", None) == getattr(other, "dtype", None)
        return alike and bool(np.array_equal(one, other))
    if isinstance(one, tuple | list) and type(one) is type(other):
        return len(one) == len(other) and all(map(_same, one, other))
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        return one.keys() == other.keys() and all(_same(value, other[key]) for key, value in one.items())
    return bool(one == other)


def _is_array(value: object) -> bool:
    return isinstance(value, jax.Array | np.ndarray | jax.ShapeDtypeStruct)
