"""Dataclasses that are shown in a few lines and compared by value, whatever arrays they hold."""

from __future__ import annotations

import dataclasses
import textwrap
from typing import Any, TypeVar

import jax
import numpy as np

Class = TypeVar("Class", bound=type)


def by_value(cls: Class) -> Class:
    """Show a dataclass with its arrays by type and shape and without what is None, and let `==` give a bool.

    Args:
        cls: a dataclass that has neither `__repr__` nor `__eq__` of its own.

    Returns:
        The same class.
    """
    cls.__repr__, cls.__eq__ = _shown, _equal  # type: ignore[method-assign, assignment]
    return cls


def _shown(value: object) -> str:
    return textwrap.fill(_text(value), 100, subsequent_indent="    ", break_long_words=False)


def _text(value: Any) -> str:
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        values = {field.name: getattr(value, field.name) for field in dataclasses.fields(value) if field.repr}
        inner = (f"{name}={_text(item)}" for name, item in values.items() if item is not None)
        return f"{type(value).__name__}({', '.join(inner)})"
    if isinstance(value, jax.Array | np.ndarray):
        if value.ndim == 0 and not isinstance(value, jax.core.Tracer):
            return f"{value.item():.6g}"
        return f"{value.dtype.name}[{','.join(map(str, value.shape))}]"
    if isinstance(value, tuple):
        return f"({', '.join(map(_text, value))}{',' * (len(value) == 1)})"
    return getattr(value, "__name__", None) or repr(value)


def _equal(value: object, other: object) -> bool:
    if other.__class__ is not value.__class__:
        return NotImplemented
    names = [field.name for field in dataclasses.fields(value) if field.compare]  # type: ignore[arg-type]
    return all(_same(getattr(value, name), getattr(other, name)) for name in names)


def _same(one: Any, other: Any) -> bool:
    if isinstance(one, tuple) and isinstance(other, tuple):
        return len(one) == len(other) and all(map(_same, one, other))
    if isinstance(one, jax.Array | np.ndarray) and isinstance(other, jax.Array | np.ndarray):
        return one.dtype == other.dtype and np.array_equal(one, other)
    return bool(np.all(one == other))
