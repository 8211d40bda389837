"""Frozen dataclasses as pytrees whose structure includes their class, shown in a few lines and compared by value."""

from __future__ import annotations

import dataclasses
import enum
import textwrap
from collections.abc import Iterable
from typing import Any, TypeVar
from weakref import WeakSet

import jax
import numpy as np

Class = TypeVar("Class", bound=type)

PYTREES: WeakSet[type] = WeakSet()
"""Classes that `pytree` has decorated in this process."""

WIDTH, LINES = 100, 10
"""Characters and lines that a pytree is shown in at most."""

DEEPEST = 4
"""Levels of nested dataclasses that are shown, fewer where they would take more lines."""


def pytree(cls: Class) -> Class:
    """Register a dataclass as a pytree; fields with metadata {"static": True} are part of its structure.

    It is shown in ten lines at most: arrays by type and shape, nothing that is None or has its default. `==` compares
    structure and every value and gives a bool; it refuses traced values. Both stay as a class defines them itself.

    `jax.tree_util.register_dataclass` of jaxlib 0.10 may treat two classes with as many fields as one structure: a
    jitted function then sometimes runs what it compiled for the other, depending on how two hashes fall.

    Args:
        cls: a frozen dataclass.

    Returns:
        The same class.
    """
    fields = dataclasses.fields(cls)
    static = [f.name for f in fields if f.metadata.get("static")]
    leaves = [f.name for f in fields if not f.metadata.get("static")]

    def structure(value: object) -> tuple[object, ...]:
        return (cls, *(getattr(value, name) for name in static))

    def flatten(value: object) -> tuple[list[object], tuple[object, ...]]:
        return [getattr(value, name) for name in leaves], structure(value)

    def flatten_with_keys(value: object) -> tuple[list[tuple[object, object]], tuple[object, ...]]:
        return [(jax.tree_util.GetAttrKey(name), getattr(value, name)) for name in leaves], structure(value)

    def unflatten(aux: tuple[Any, ...], children: Iterable[object]) -> object:
        return cls(**dict(zip(static, aux[1:], strict=True)), **dict(zip(leaves, children, strict=True)))

    for name, better in (("__repr__", shown), ("__eq__", equal)):
        if _generated(vars(cls).get(name)):
            setattr(cls, name, better)
    jax.tree_util.register_pytree_with_keys(cls, flatten_with_keys, unflatten, flatten)
    PYTREES.add(cls)
    return cls


def _generated(method: Any) -> bool:
    """Whether `dataclass` wrote a method, and not the class's author."""
    code = getattr(getattr(method, "__wrapped__", method), "__code__", None)
    return code is not None and code.co_filename == "<string>"


def shown(value: object) -> str:
    """A pytree in ten lines at most.

    Args:
        value: a dataclass.

    Returns:
        Its class and fields, an array as its type and shape.
    """
    lines: list[str] = []
    for depth in range(DEEPEST, -1, -1):
        lines = textwrap.wrap(_text(value, depth), WIDTH, subsequent_indent="    ", break_long_words=False)
        if len(lines) <= LINES:
            break
    return "\n".join(lines if len(lines) <= LINES else [*lines[: LINES - 1], "    ...)"])


def _text(value: Any, depth: int) -> str:
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = [f for f in dataclasses.fields(value) if f.repr and not _is(getattr(value, f.name), f.default)]
        if depth == 0 and fields:
            return f"{type(value).__name__}(...)"
        inner = (f"{f.name}={_text(getattr(value, f.name), depth - 1)}" for f in fields)
        return f"{type(value).__name__}({', '.join(inner)})"
    if isinstance(value, jax.Array | np.ndarray | jax.ShapeDtypeStruct):
        if value.shape == () and not isinstance(value, jax.core.Tracer | jax.ShapeDtypeStruct):
            return f"{np.asarray(value).item():.6g}" if value.dtype.kind in "fiu" else str(value)
        kind = value.dtype.name.replace("float", "f").replace("int", "i")
        return f"{kind}[{','.join(map(str, value.shape))}]"
    if isinstance(value, tuple) and hasattr(value, "_fields"):
        inner = (f"{name}={_text(item, depth - 1)}" for name, item in zip(value._fields, value, strict=True))
        return f"{type(value).__name__}({', '.join(inner)})"
    if isinstance(value, tuple | list):
        return f"({', '.join(_text(item, depth) for item in value)}{',' * (len(value) == 1)})"
    return str(value) if isinstance(value, enum.Enum) else getattr(value, "__name__", None) or repr(value)


def _is(value: object, default: object) -> bool:
    """Whether a value is the default of its field, or None."""
    if value is None or value is default:
        return True
    return isinstance(value, bool | int | float | str | tuple) and value == default


def equal(value: object, other: object) -> bool:
    """Whether two pytrees of one class have the same structure, and in it equal values of equal type and shape.

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
    (leaves, structure), (other_leaves, other_structure) = jax.tree.flatten(value), jax.tree.flatten(other)
    return structure == other_structure and all(map(_same, leaves, other_leaves))  # type: ignore[operator]


def _same(one: Any, other: Any) -> bool:
    if one is other:
        return True
    if isinstance(one, jax.core.Tracer) or isinstance(other, jax.core.Tracer):
        raise TypeError("== of pytrees with traced values, which are not known yet: compare arrays of them by jnp")
    if hasattr(one, "shape") or hasattr(other, "shape"):
        alike = np.shape(one) == np.shape(other) and getattr(one, "dtype", None) == getattr(other, "dtype", None)
        return alike and bool(np.array_equal(one, other))
    return bool(one == other)
