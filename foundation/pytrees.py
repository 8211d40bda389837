"""Frozen dataclasses as pytrees whose structure knows their class."""

from __future__ import annotations

import dataclasses
from typing import Any, TypeVar
from weakref import WeakSet

import jax

Class = TypeVar("Class", bound=type)

PYTREES: WeakSet[type] = WeakSet()
"""Classes that `pytree` has decorated in this process."""


def pytree(cls: Class) -> Class:
    """Decorate a dataclass to be a pytree; fields with metadata {"static": True} are part of its structure.

    One with {"static": True, "absent": value} leaves no trace in the structure where it has this value, which is so
    that of the class before it had the field: what is checked by the structure's text stays good.
    `jax.tree_util.register_dataclass` of jaxlib 0.10 holds two classes with as many fields for one structure. A jitted
    function then now and then runs what it compiled for the other, depending on how two hashes fall.
    """
    fields = dataclasses.fields(cls)
    absent = {f.name: f.metadata["absent"] for f in fields if "absent" in f.metadata}
    static = [f.name for f in fields if f.metadata.get("static") and f.name not in absent]
    leaves = [f.name for f in fields if not f.metadata.get("static")]

    def structure(value: Any) -> tuple[Any, ...]:
        present = ((name, getattr(value, name)) for name in absent)
        there = ((name, held) for name, held in present if held != absent[name])
        return (cls, *(getattr(value, name) for name in static), *there)

    def flatten(value: Any) -> tuple[list[Any], tuple[Any, ...]]:
        return [getattr(value, name) for name in leaves], structure(value)

    def flatten_with_keys(value: Any) -> tuple[list[Any], tuple[Any, ...]]:
        return [(jax.tree_util.GetAttrKey(name), getattr(value, name)) for name in leaves], structure(value)

    def unflatten(known: tuple[Any, ...], children: Any) -> Any:
        always, there = known[1 : 1 + len(static)], dict(known[1 + len(static) :])
        own = absent | there | dict(zip(static, always, strict=True))
        return cls(**own, **dict(zip(leaves, children, strict=True)))

    jax.tree_util.register_pytree_with_keys(cls, flatten_with_keys, unflatten, flatten)
    PYTREES.add(cls)
    return cls
