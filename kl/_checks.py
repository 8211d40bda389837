"""Checks of input, and frozen dataclasses as pytrees.

The host cannot see values that JAX is tracing; such values pass every check.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from typing import Any, TypeVar

import jax
import numpy as np
from jax.typing import ArrayLike, DTypeLike

from kl._values import by_value

Class = TypeVar("Class", bound=type)


def pytree(cls: Class) -> Class:
    """Register a dataclass as a pytree whose structure includes its class, shown and compared by value.

    jaxlib 0.10 may treat two classes with as many fields, registered by `jax.tree_util.register_dataclass`, as one.

    Args:
        cls: a frozen dataclass; fields with metadata {"static": True} are part of the structure.

    Returns:
        The same class.
    """
    static, leaves = (
        tuple(f.name for f in dataclasses.fields(cls) if bool(f.metadata.get("static")) is kind)
        for kind in (True, False)
    )

    def flatten(value: object) -> tuple[list[tuple[object, object]], tuple[object, ...]]:
        keyed = [(jax.tree_util.GetAttrKey(name), getattr(value, name)) for name in leaves]
        return keyed, (cls, *(getattr(value, name) for name in static))

    def unflatten(structure: tuple[Any, ...], children: Iterable[object]) -> object:
        return cls(**dict(zip((*static, *leaves), (*structure[1:], *children), strict=True)))

    jax.tree_util.register_pytree_with_keys(cls, flatten, unflatten)
    return by_value(cls)


def is_traced(*trees: object) -> bool:
    """Whether any leaf is a tracer, whose value the host cannot see.

    Args:
        *trees: pytrees.

    Returns:
        Whether one is.
    """
    return any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(trees))


def require(condition: ArrayLike, message: str) -> None:
    """Raise ValueError unless a condition is true everywhere.

    Args:
        condition: bool or array of bools.
        message: of the error.

    Raises:
        ValueError: If the condition fails anywhere.
    """
    if not is_traced(condition) and not np.asarray(condition).all():
        raise ValueError(message)


def finite(
    name: str, value: ArrayLike | Sequence[float], unit: str = "", *, remedy: str = "", least: float | None = None,
    above: float | None = None,
) -> None:  # fmt: skip
    """Check that every element of a value is finite, and within its limits.

    Args:
        name: of the value, for the message.
        value: number or array.
        unit: for the message.
        remedy: added to the message.
        least: smallest allowed value.
        above: largest value that is too small.

    Raises:
        ValueError: If an element is not finite or outside the limits.
    """
    if is_traced(value):
        return
    array = np.asarray(value)
    limit = "a finite value" + (f" of {least:g} or more" if least is not None else "")
    limit += f" above {above:g}" if above is not None else ""
    if array.dtype.kind not in "fiub":
        raise ValueError(f"{name} is an array of {array.dtype}: give {limit}")
    good = np.isfinite(array) & (array >= (-np.inf if least is None else least))
    good &= array > (-np.inf if above is None else above)
    if not good.all():
        bad = np.argwhere(~good)
        where = f" at {bad[0].tolist()} (bad at {len(bad)} of {array.size})" if array.ndim else ""
        shown = f"{name} = {array[tuple(bad[0])]:g} {unit}".rstrip()
        raise ValueError(f"{shown}{where}: give {limit}" + (f"; {remedy}" if remedy else ""))


def positive(name: str, value: ArrayLike | Sequence[float], unit: str = "", *, remedy: str = "") -> None:
    """Check that every element of a value is finite and above 0.

    Args:
        name: of the value, for the message.
        value: number or array.
        unit: for the message.
        remedy: added to the message.

    Raises:
        ValueError: If an element is not finite or not above 0.
    """
    finite(name, value, unit, remedy=remedy, above=0.0)


def floating(value: DTypeLike) -> np.dtype:
    """A floating type, checked.

    Args:
        value: float32 or float64, in any form that NumPy understands.

    Returns:
        The NumPy dtype.

    Raises:
        ValueError: If it is another type, or float64 while JAX has it disabled.
    """
    real = np.dtype(value)
    if real not in (np.dtype(np.float32), np.dtype(np.float64)):
        raise ValueError(f"dtype = {real}: give float32 or float64")
    if jax.dtypes.canonicalize_dtype(real) != real:
        raise ValueError(
            "dtype = float64, but JAX runs in float32: call jax.config.update('jax_enable_x64', True) first"
        )
    return real
