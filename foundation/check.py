"""Checks of what users hand in: each raises ValueError naming the value, the limit and the remedy.

Values that are being traced by JAX cannot be seen and pass.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, TypeAlias

import jax
import numpy as np
from jax.typing import ArrayLike, DTypeLike

Values: TypeAlias = ArrayLike | Sequence[float]


def is_traced(*trees: Any) -> bool:
    """Whether any leaf is a tracer, whose value the host cannot see."""
    return any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(trees))


def require(holds: ArrayLike, message: str) -> None:
    """Raise `ValueError(message)` unless `holds` everywhere."""
    if not is_traced(holds) and not np.all(np.asarray(holds)):
        raise ValueError(message)


def positive(name: str, value: Values, unit: str = "", *, remedy: str = "") -> None:
    """Every element of `value` is finite and above 0."""
    if not is_traced(value) and not (np.all(np.isfinite(value)) and np.all(np.asarray(value) > 0)):
        raise ValueError(f"{name} = {_shown(value)}{_unit(unit)}: give a finite value above 0{_remedy(remedy)}")


def not_negative(name: str, value: Values, unit: str = "", *, remedy: str = "") -> None:
    """Every element of `value` is finite and at least 0."""
    if not is_traced(value) and not (np.all(np.isfinite(value)) and np.all(np.asarray(value) >= 0)):
        raise ValueError(f"{name} = {_shown(value)}{_unit(unit)}: give a finite value of 0 or more{_remedy(remedy)}")


def finite(name: str, value: Values, *, remedy: str = "") -> None:
    """No element of `value` is NaN or infinite."""
    if not is_traced(value) and not np.all(np.isfinite(value)):
        raise ValueError(f"{name} = {_shown(value)}: give finite values{_remedy(remedy)}")


def between(name: str, value: Values, low: float, high: float, *, ends: bool = False) -> None:
    """Every element lies between low and high, the ends allowed or not."""
    if is_traced(value):
        return
    array = np.asarray(value)
    good = (array >= low) & (array <= high) if ends else (array > low) & (array < high)
    if not np.all(good):
        bracket = f"from {low:g} to {high:g}" if ends else f"above {low:g} and below {high:g}"
        raise ValueError(f"{name} = {_shown(value)}: give a value {bracket}")


def multiple(name: str, length: float, unit_name: str, unit: float) -> int:
    """`length` is a whole multiple of `unit` (m); returns the number."""
    # Beyond 2^53 every number is whole, and infinity has no rounding.
    count = round(length / unit) if length / unit < 2**53 else 0
    if count < 1 or not math.isclose(count * unit, length, rel_tol=1e-9):
        raise ValueError(
            f"{name} = {length:g} m is no whole multiple of {unit_name} = {unit:g} m: "
            f"change {unit_name} to a divisor, e.g. {length / max(1, count):g} m"
        )
    return count


def dtype(value: DTypeLike) -> np.dtype:
    """The floating type asked for; float64 must be enabled in JAX."""
    asked = np.dtype(value)
    if asked not in (np.dtype("float32"), np.dtype("float64")):
        raise ValueError(f"dtype = {asked}: give float32 or float64")
    if jax.dtypes.canonicalize_dtype(asked) != asked:
        raise ValueError(
            "dtype = float64, but JAX runs in float32: call jax.config.update('jax_enable_x64', True) first"
        )
    return asked


def axes(name: str, values: Sequence[float], dimension: int) -> None:
    """One value per axis."""
    if len(values) != dimension:
        raise ValueError(f"{name} = {tuple(values)} has {len(values)} values: give {dimension}, one per axis")


def _unit(unit: str) -> str:
    return f" {unit}" if unit else ""


def _remedy(remedy: str) -> str:
    return f"; {remedy}" if remedy else ""


def _shown(value: Values) -> str:
    array = np.asarray(value)
    if array.ndim == 0:
        return f"{array.item():g}" if np.issubdtype(array.dtype, np.number) else repr(value)
    finite_ones = array[np.isfinite(array)]
    return (
        f"array of {array.shape} from {finite_ones.min():g}, {array.size - finite_ones.size} not finite"
        if finite_ones.size
        else "not finite"
    )
