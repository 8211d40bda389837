"""Frozen dataclasses as pytrees whose structure includes their class."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from typing import Any, TypeVar
from weakref import WeakSet

import jax

from jaxmpm.support.values import by_value

Class = TypeVar("Class", bound=type)

PYTREES: WeakSet[type] = WeakSet()
"""Classes that `pytree` has decorated in this process."""


def pytree(cls: Class) -> Class:
    """Register a dataclass as a pytree; fields with metadata {"static": True} are part of its structure.

    It is shown and compared as `by_value` has it.

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

    by_value(cls)
    jax.tree_util.register_pytree_with_keys(cls, flatten_with_keys, unflatten, flatten)
    PYTREES.add(cls)
    return cls
