"""A law's declarations of its numbers, and what follows from them for any law."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import singledispatch
from typing import Any, NamedTuple, TypeVar

import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from jaxmpm.support import check
from jaxmpm.support.check import Limit

Law = TypeVar("Law")

ROUNDING = 1e-5
"""Largest excess of a residual over its peak, as a share, that counts as rounding."""


@dataclass(frozen=True)
class Parameter(Limit):
    """A number of a law: its limit, and further properties that the law declares.

    Args:
        above: lower end, itself excluded; None for none.
        least: lower end, itself included; None for none.
        most: upper end, itself included; None for none.
        below: upper end, itself excluded; None for none.
        unit: in the law; "rad" makes the number an angle, which engineers give in degrees.
        name: the engineer's, by default that of the field.
        per_band: whether the number scales with the thickness of the grid's shear bands.
        reduced: whether strength reduction divides it; of an angle, its tangent.
        at_most: name of another parameter of the law that limits it. If reduction divides that one alone, this one is
            lowered to it.
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
        """The value with its strength divided by a factor, of an angle its tangent."""
        return jnp.arctan(jnp.tan(value) / factor) if self.angle else value / factor


class Declared(NamedTuple):
    """A number that a law has.

    Args:
        path: its name, with a dot if it belongs to a part.
        parameter: its declaration.
        value: a number or one value per particle (N,).
    """

    path: str
    parameter: Parameter
    value: Array


@singledispatch
def declared(law: object) -> dict[str, Declared]:
    """The numbers of a law by the engineer's name; those declared as no `Parameter` by their path.

    Args:
        law: a law.

    Returns:
        Declaration and value by name.
    """
    numbers: dict[str, Declared] = {}
    for path, limit, value in check.parameters(law):
        parameter = limit if isinstance(limit, Parameter) else Parameter(**vars(limit), name=path)
        numbers[parameter.name or path.rpartition(".")[2]] = Declared(path, parameter, value)
    return numbers


@singledispatch
def with_parameters(law: Any, values: Mapping[str, ArrayLike]) -> Any:
    """A law with other values of its numbers.

    Args:
        law: a law.
        values: numbers or one value per particle (N,), by the names of `declared`.

    Returns:
        The varied law.
    """
    numbers = declared(law)
    return _with_values(law, {numbers[name].path if name in numbers else name: v for name, v in values.items()})


def _with_values(part: Any, values: Mapping[str, ArrayLike]) -> Any:
    """A law or a part of one with other values, by path."""
    changed = {path: value for path, value in values.items() if "." not in path}
    for name in dict.fromkeys(path.partition(".")[0] for path in values if "." in path):
        inner = {path.partition(".")[2]: value for path, value in values.items() if path.startswith(f"{name}.")}
        changed[name] = _with_values(getattr(part, name), inner)
    return replace(part, **changed)


def has_strength(law: object) -> bool:
    """Whether strength reduction divides a number of a law.

    Args:
        law: a law.

    Returns:
        Whether it does.
    """
    return any(number.parameter.reduced for number in declared(law).values())


def with_strength_divided(law: Law, factor: Array) -> Law:
    """A law with its strength divided by a factor, as its numbers declare it.

    Args:
        law: a law.
        factor: () above 0.

    Returns:
        The law with reduced strength.

    Raises:
        ValueError: If the law declares no strength.
    """
    numbers = declared(law)
    strength = {name: number.parameter.divided(number.value, factor) for name, number in numbers.items()
                if number.parameter.reduced}  # fmt: skip
    if not strength:
        raise ValueError(
            f"{type(law).__name__} has no strength to divide: declare one in PARAMETERS, as Parameter(reduced=True)"
        )
    lowered = {
        name: jnp.minimum(number.value, strength[number.parameter.at_most])
        for name, number in numbers.items()
        if name not in strength and number.parameter.at_most in strength
    }
    return with_parameters(law, {**strength, **lowered})


def hardens(law: object) -> Array | None:
    """Whether a residual strength of a law exceeds its peak anywhere by more than rounding.

    Args:
        law: a law.

    Returns:
        () bool, None if there is no pair of residual and peak.
    """
    numbers = declared(law)
    pairs = [
        (number.value, numbers[number.parameter.at_most].value)
        for number in numbers.values()
        if number.parameter.reduced and number.parameter.at_most in numbers
    ]
    if not pairs:
        return None
    return jnp.any(jnp.stack([jnp.any(residual > peak * (1 + ROUNDING)) for residual, peak in pairs]))


def excesses(law: object) -> dict[str, Array]:
    """Largest excess of each number over the one that limits it, strengths left out.

    Args:
        law: a law.

    Returns:
        () excess by name.
    """
    numbers = declared(law)
    return {
        name: jnp.max(number.value - numbers[number.parameter.at_most].value)
        for name, number in numbers.items()
        if not number.parameter.reduced and number.parameter.at_most in numbers
    }
