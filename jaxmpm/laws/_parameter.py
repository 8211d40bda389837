"""What a law declares of its numbers, and what follows from that for any law."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import singledispatch
from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import Array

from foundation import check
from foundation.check import Limit

ROUNDING = 1e-5
"""Share by which a residual may be above its peak."""


@dataclass(frozen=True)
class Parameter(Limit):
    """A number of a law: its limit, and what else the law declares of it.

    above, below: ends of its values that are no such values themselves. least, most: ends that are. unit: that of the
    law; "rad" makes it an angle, which engineers give in degrees. name: the engineer's, by default that of the field.
    per_band: whether its number goes with the thickness of the grid's shear bands. reduced: whether strength reduction
    divides it, of an angle its tangent. at_most: name of another parameter of the law, which it may not exceed; where
    reduction divides that one alone, it brings this one down to it.
    """

    name: str = ""
    per_band: bool = False
    reduced: bool = False
    at_most: str = ""

    @property
    def angle(self) -> bool:
        """Whether it is an angle, in radians in the law and in degrees elsewhere."""
        return self.unit == "rad"

    def divided(self, value: Array, factor: Array) -> Array:
        """The value with its strength divided by a factor."""
        return jnp.arctan(jnp.tan(value) / factor) if self.angle else value / factor


class Declared(NamedTuple):
    """A number that a law has: its path, with a dot where it is one of a part, its declaration and its value."""

    path: str
    parameter: Parameter
    value: Any


@singledispatch
def declared(law: Any) -> dict[str, Declared]:
    """The numbers of a law, by the engineer's name; those that it declares no `Parameter` of by their path."""
    found: dict[str, Declared] = {}
    for path, limit, value in check.parameters(law):
        known = limit if isinstance(limit, Parameter) else Parameter(**vars(limit), name=path)
        found[known.name or path.rpartition(".")[2]] = Declared(path, known, value)
    return found


@singledispatch
def with_parameters(law: Any, values: Mapping[str, Any]) -> Any:
    """A law with other values of its numbers, by path."""
    own = {path: value for path, value in values.items() if "." not in path}
    for part in {path.partition(".")[0] for path in values.keys() - own.keys()}:
        inner = {path.partition(".")[2]: value for path, value in values.items() if path.startswith(f"{part}.")}
        own[part] = with_parameters(getattr(law, part), inner)
    return replace(law, **own)


def has_strength(law: Any) -> bool:
    """Whether a law declares a number that strength reduction divides."""
    return any(each.parameter.reduced for each in declared(law).values())


def with_strength_divided(law: Any, factor: Array) -> Any:
    """A law with its strength divided by a factor, as its numbers declare it.

    Raises ValueError for a law that declares no strength.
    """
    known = declared(law)
    strength = {name: each.parameter.divided(each.value, factor) for name, each in known.items()
                if each.parameter.reduced}  # fmt: skip
    if not strength:
        raise ValueError(
            f"{type(law).__name__} has no strength to divide: declare one in PARAMETERS, as Parameter(reduced=True)"
        )
    lowered = {
        name: jnp.minimum(each.value, strength[each.parameter.at_most])
        for name, each in known.items()
        if name not in strength and each.parameter.at_most in strength
    }
    return with_parameters(law, {known[name].path: value for name, value in {**strength, **lowered}.items()})


def hardens(law: Any) -> Array | None:
    """Whether a strength of a law, its residual, is anywhere above that which it may not exceed, its peak, by more than
    rounding; None where there is no such pair."""
    known = declared(law)
    pairs = [
        (each.value, known[each.parameter.at_most].value)
        for each in known.values()
        if each.parameter.reduced and each.parameter.at_most in known
    ]
    if not pairs:
        return None
    return jnp.any(jnp.stack([jnp.any(residual > peak * (1 + ROUNDING)) for residual, peak in pairs]))


def excesses(law: Any) -> dict[str, Array]:
    """By how much numbers of a law that are no strength are above that which they may not exceed, at most, by name."""
    known = declared(law)
    return {
        name: jnp.max(each.value - known[each.parameter.at_most].value)
        for name, each in known.items()
        if not each.parameter.reduced and each.parameter.at_most in known
    }
