"""Checks of what users hand in: each raises ValueError naming the value, the limit and the remedy."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import jax
import numpy as np


def positive(name: str, value: Any, unit: str = "") -> None:
    """Every element of `value` is finite and above 0."""
    if not np.all(np.isfinite(value)) or not np.all(np.asarray(value) > 0):
        raise ValueError(f"{name} = {_shown(value)}{_unit(unit)}: give a finite value above 0")


def not_negative(name: str, value: Any, unit: str = "") -> None:
    """Every element of `value` is finite and at least 0."""
    if not np.all(np.isfinite(value)) or not np.all(np.asarray(value) >= 0):
        raise ValueError(f"{name} = {_shown(value)}{_unit(unit)}: give a finite value of 0 or more")


def between(name: str, value: Any, low: float, high: float, *, ends: bool = False) -> None:
    """Every element lies between low and high, the ends allowed or not."""
    array = np.asarray(value)
    good = (array >= low) & (array <= high) if ends else (array > low) & (array < high)
    if not np.all(good):
        bracket = f"from {low:g} to {high:g}" if ends else f"above {low:g} and below {high:g}"
        raise ValueError(f"{name} = {_shown(value)}: give a value {bracket}")


def multiple(name: str, length: float, unit_name: str, unit: float) -> int:
    """`length` is a whole multiple of `unit` (m); returns the number."""
    count = round(length / unit)
    if count < 1 or not math.isclose(count * unit, length, rel_tol=1e-9):
        raise ValueError(
            f"{name} = {length:g} m is no whole multiple of {unit_name} = {unit:g} m: "
            f"change {unit_name} to a divisor, e.g. {length / max(1, count):g} m"
        )
    return count


def dtype(value: Any) -> np.dtype:
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


def _shown(value: Any) -> str:
    array = np.asarray(value)
    if array.ndim == 0:
        return f"{array.item():g}" if np.issubdtype(array.dtype, np.number) else repr(value)
    finite = array[np.isfinite(array)]
    return (
        f"array of {array.shape} from {finite.min():g}, {array.size - finite.size} not finite"
        if finite.size
        else "not finite"
    )
