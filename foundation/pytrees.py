"""Frozen dataclasses as pytrees whose structure knows their class."""

from __future__ import annotations

import dataclasses
from typing import Any, TypeVar

import jax

Class = TypeVar("Class", bound=type)


def pytree(cls: Class) -> Class:
    """Decorate a dataclass to be a pytree; fields with metadata {"static": True} are part of its structure.

    `jax.tree_util.register_dataclass` of jaxlib 0.10 holds two classes with as many fields for one structure. A jitted
    function then now and then runs what it compiled for the other, depending on how two hashes fall.
    """
    fields = dataclasses.fields(cls)
    static = [f.name for f in fields if f.metadata.get("static")]
    leaves = [f.name for f in fields if f.name not in static]

    def structure(value: Any) -> tuple[Any, ...]:
        return (cls, *(getattr(value, name) for name in static))

    def flatten(value: Any) -> tuple[list[Any], tuple[Any, ...]]:
        return [getattr(value, name) for name in leaves], structure(value)

    def flatten_with_keys(value: Any) -> tuple[list[Any], tuple[Any, ...]]:
        return [(jax.tree_util.GetAttrKey(name), getattr(value, name)) for name in leaves], structure(value)

    def unflatten(known: tuple[Any, ...], children: Any) -> Any:
        return cls(**dict(zip(leaves, children, strict=True)), **dict(zip(static, known[1:], strict=True)))

    jax.tree_util.register_pytree_with_keys(cls, flatten_with_keys, unflatten, flatten)
    return cls
