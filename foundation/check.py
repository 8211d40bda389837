"""Checks of what users hand in: each raises ValueError naming the value, the limit and the remedy.

Values that are being traced by JAX cannot be seen and pass; what holds of them is said on the device (`admissible`).
"""

from __future__ import annotations

import dataclasses
import math
import sys
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike, DTypeLike

from foundation.text import shown

Values: TypeAlias = ArrayLike | Sequence[float]


@dataclass(frozen=True)
class Limit:
    """The values that a parameter may have, all of them finite.

    above, below: ends that are no such values themselves. least, most: ends that are. unit: for messages.
    """

    above: float | None = None
    least: float | None = None
    most: float | None = None
    below: float | None = None
    unit: str = ""

    def holds(self, value: Any) -> Any:
        """Whether each element of an array, of NumPy or JAX, is such a value; False for NaN."""
        good = abs(value) < math.inf
        good = good if self.above is None else good & (value > self.above)
        good = good if self.least is None else good & (value >= self.least)
        good = good if self.most is None else good & (value <= self.most)
        return good if self.below is None else good & (value < self.below)

    def __str__(self) -> str:
        low = "" if self.least is None else f"from {self.least:g}"
        low = low if self.above is None else f"above {self.above:g}"
        if self.least is not None and self.below is not None:
            return f"a value of {self.least:g} or more and below {self.below:g}"
        if self.below is not None:
            return f"a value {low} and below {self.below:g}"
        if self.most is not None:
            return f"a value {low}{' to' if self.above is None else ', up to'} {self.most:g}"
        return f"a finite value {low}".strip() if self.least is None else f"a finite value of {self.least:g} or more"


def above_zero(unit: str = "") -> Limit:
    """Finite values above 0."""
    return Limit(above=0.0, unit=unit)


def from_zero(unit: str = "") -> Limit:
    """Finite values of 0 or more."""
    return Limit(least=0.0, unit=unit)


def warn(message: str) -> None:
    """Warn at the line that called into the package of whoever calls this."""
    frame, level = sys._getframe(1), 2
    package = frame.f_globals["__name__"].partition(".")[0]
    while frame.f_back is not None and frame.f_globals["__name__"].partition(".")[0] == package:
        frame, level = frame.f_back, level + 1
    warnings.warn(message, stacklevel=level)


def is_traced(*trees: Any) -> bool:
    """Whether any leaf is a tracer, whose value the host cannot see."""
    return any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(trees))


def require(holds: ArrayLike, message: str) -> None:
    """Raise `ValueError(message)` unless `holds` everywhere."""
    if not is_traced(holds) and not np.all(np.asarray(holds)):
        raise ValueError(message)


def within(name: str, value: Any, limit: Limit, *, remedy: str = "") -> None:
    """Every element of `value` is a number within the limit."""
    if is_traced(value):
        return
    array = np.asarray(value)
    if array.dtype.kind not in "fiub":
        raise ValueError(f"{name} = {shown(value)}: give {limit}{_remedy(remedy)}")
    bad = np.argwhere(~np.asarray(limit.holds(array)))
    if not len(bad):
        return
    where = f" at {bad[0].tolist()} (bad at {len(bad)} of {array.size})" if array.ndim else ""
    unit = f" {limit.unit}" if limit.unit else ""
    raise ValueError(f"{name} = {array[tuple(bad[0])]:g}{unit}{where}: give {limit}{_remedy(remedy)}")


def finite(name: str, value: Values, unit: str = "", *, remedy: str = "") -> None:
    """Every element of `value` is finite."""
    within(name, value, Limit(unit=unit), remedy=remedy)


def positive(name: str, value: Values, unit: str = "", *, remedy: str = "") -> None:
    """Every element of `value` is finite and above 0."""
    within(name, value, above_zero(unit), remedy=remedy)


def not_negative(name: str, value: Values, unit: str = "", *, remedy: str = "") -> None:
    """Every element of `value` is finite and at least 0."""
    within(name, value, from_zero(unit), remedy=remedy)


def between(name: str, value: Values, low: float, high: float, *, ends: bool = False) -> None:
    """Every element lies between low and high, the ends allowed or not."""
    within(name, value, Limit(least=low, most=high) if ends else Limit(above=low, below=high))


def whole(name: str, value: Any, least: int = 1) -> None:
    """`value` is a whole number of at least `least`."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < least:
        raise ValueError(f"{name} = {shown(value)}: give a whole number of {least} or more")


def parameters(tree: Any, prefix: str = "") -> Iterator[tuple[str, Limit, Any]]:
    """Name, limit and value of every number in a dataclass and in those that it holds.

    A dataclass says what its fields may be in PARAMETERS; all others may have any finite value. Dataclasses in a tuple
    have no name of their own.
    """
    for field in dataclasses.fields(tree):
        value = getattr(tree, field.name)
        if field.metadata.get("static") or value is None:
            continue
        if dataclasses.is_dataclass(value):
            yield from parameters(value, f"{prefix}{field.name}.")
        elif isinstance(value, tuple) and all(map(dataclasses.is_dataclass, value)):
            for part in value:
                yield from parameters(part, prefix)
        else:
            limit = getattr(type(tree), "PARAMETERS", {}).get(field.name, Limit())
            for leaf in jax.tree.leaves(value):
                yield prefix + field.name, limit, leaf


def within_limits(tree: Any) -> None:
    """Every number in a dataclass, and in those that it holds, is within its limit."""
    for name, limit, value in parameters(tree):
        within(name, value, limit)


def admissible(tree: Any) -> Array:
    """On the device: whether every number in a dataclass, and in those that it holds, is within its limit."""
    good = jnp.asarray(True)
    for _, limit, value in parameters(tree):
        good &= jnp.all(limit.holds(value))
    return good


def multiple(name: str, length: float, unit_name: str, unit: float) -> int:
    """`length` is a whole multiple of `unit` (m); returns the number."""
    positive(name, length, "m")
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
    try:
        asked = np.dtype(value)
    except TypeError as error:
        raise ValueError(f"dtype = {shown(value)}: give float32 or float64") from error
    if asked not in (np.dtype("float32"), np.dtype("float64")):
        raise ValueError(f"dtype = {asked}: give float32 or float64")
    if jax.dtypes.canonicalize_dtype(asked) != asked:
        raise ValueError(
            "dtype = float64, but JAX runs in float32: call jax.config.update('jax_enable_x64', True) first"
        )
    return asked


def axes(name: str, values: Sequence[float], dimension: int) -> None:
    """One value per axis, each a finite number."""
    finite(name, values)
    if np.ndim(values) != 1:
        raise ValueError(f"{name} = {shown(values)}: give {dimension} values, one per axis")
    if len(values) != dimension:
        raise ValueError(f"{name} = {shown(tuple(values))} has {len(values)} values: give {dimension}, one per axis")


def _remedy(remedy: str) -> str:
    return f"; {remedy}" if remedy else ""
