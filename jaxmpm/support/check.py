"""Checks of user input: each raises ValueError naming the value, the limit and the remedy.

The host cannot see values that JAX is tracing; such values pass. `admissible` checks them on the device.
"""

from __future__ import annotations

import contextlib
import dataclasses
import math
import sys
import warnings
from collections.abc import Iterator, Sequence
from typing import Self, TypeAlias, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike, DTypeLike

from jaxmpm.support.text import shown

Values: TypeAlias = ArrayLike | Sequence[float]
Elements = TypeVar("Elements", Array, np.ndarray, float)


class Invalid(ValueError):
    """A value that breaks a rule, as data.

    Who reads a table adds the tables around `path`, and names what it leads to. The message is made where it is shown.

    Args:
        path: keys and positions that lead to the value from where the rule stands; none for that place itself.
        value: as a message shows it, None where the rule is of more than one value.
        rule: that it breaks, as the message goes on after the value.
        remedy: what to do, nothing where the rule says it.
        subject: what the path leads to, in words; None for the path itself.
        beside: keys of other values that the rule compares this one with.
    """

    def __init__(
        self, path: Sequence[str | int], value: str | None, rule: str, remedy: str, subject: str | None = None,
        beside: Sequence[str] = (),
    ) -> None:  # fmt: skip
        super().__init__(path, value, rule, remedy, subject, beside)
        self.path, self.value, self.rule, self.remedy = tuple(path), value, rule, remedy
        self.subject, self.beside = subject, tuple(beside)

    def within(self, *path: str | int) -> Self:
        """The same, from a place further out.

        Args:
            *path: keys and positions that lead from there to here.
        """
        return type(self)((*path, *self.path), self.value, self.rule, self.remedy, None, self.beside)

    def named(self, subject: str) -> Self:
        """The same, with words for what the path leads to.

        Args:
            subject: these words.
        """
        return type(self)(self.path, self.value, self.rule, self.remedy, subject, self.beside)

    def __str__(self) -> str:
        subject = ".".join(map(str, self.path)) if self.subject is None else self.subject
        value = f"= {self.value}" if subject and self.value is not None else self.value
        return " ".join(filter(None, (subject, value, self.rule))) + (f": {self.remedy}" if self.remedy else "")


MOST_FAULTS = 8
"""Faults that one message names; it counts the others."""


class Faults(ValueError):
    """All that is wrong with an input, of which each part was checked.

    Args:
        errors: one for each fault.
    """

    def __init__(self, errors: Sequence[ValueError]) -> None:
        super().__init__(tuple(errors))
        self.errors = tuple(errors)

    @property
    def faults(self) -> tuple[str, ...]:
        """Their messages."""
        return tuple(map(str, self.errors))

    def __str__(self) -> str:
        more = len(self.errors) - MOST_FAULTS
        return "; ".join(self.faults[:MOST_FAULTS]) + (f"; and {more} more" if more > 0 else "")


def faults_of(error: ValueError) -> tuple[ValueError, ...]:
    """The faults that an error has.

    Args:
        error: of one fault or of several.
    """
    return error.errors if isinstance(error, Faults) else (error,)


class Gathered:
    """Faults of checks of which none depends on another, to be raised together."""

    def __init__(self) -> None:
        self.faults: list[ValueError] = []

    @contextlib.contextmanager
    def of(self, subject: str = "") -> Iterator[None]:
        """Keep the faults that the block raises, and go on after it.

        Args:
            subject: what they are of, in words.
        """
        try:
            yield
        except ValueError as error:
            self.faults += [about(subject, fault) if subject else fault for fault in faults_of(error)]

    def raise_all(self) -> None:
        """Raise what was kept, if anything was.

        Raises:
            Faults: all of it.
        """
        if self.faults:
            raise Faults(self.faults)


def about(subject: str, error: ValueError, *path: str | int) -> Invalid:
    """An error whose message begins with what it is of.

    Args:
        subject: this, in words.
        error: the error.
        *path: keys and positions that lead to it.
    """
    return Invalid((*path, *getattr(error, "path", ())), None, "", str(error), subject)


@contextlib.contextmanager
def at(*path: str | int) -> Iterator[None]:
    """Let what is refused inside lead from a place further out.

    Args:
        *path: keys and positions that lead from there to here.

    Raises:
        Invalid: what was refused, with the whole path.
        Faults: several of these.
    """

    def further(error: ValueError) -> Invalid:
        if isinstance(error, Invalid) and error.subject is None:
            return error.within(*path)
        return Invalid(path, None, str(error), "")

    try:
        yield
    except Faults as error:
        raise Faults([further(fault) for fault in error.errors]) from error
    except ValueError as error:
        raise further(error) from error


@dataclasses.dataclass(frozen=True)
class Limit:
    """The values that a parameter may have, all of them finite.

    Args:
        above: lower end, itself excluded; None for none.
        least: lower end, itself included; None for none.
        most: upper end, itself included; None for none.
        below: upper end, itself excluded; None for none.
        unit: for messages.
    """

    above: float | None = None
    least: float | None = None
    most: float | None = None
    below: float | None = None
    unit: str = ""

    def holds(self, value: Elements) -> Elements:
        """Whether each element of an array, of NumPy or JAX, is within the limit; False for NaN."""
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
    """Limit of finite values above 0.

    Args:
        unit: for messages.

    Returns:
        Limit.
    """
    return Limit(above=0.0, unit=unit)


def from_zero(unit: str = "") -> Limit:
    """Limit of finite values of 0 or more.

    Args:
        unit: for messages.

    Returns:
        Limit.
    """
    return Limit(least=0.0, unit=unit)


def warn(message: str) -> None:
    """Warn at the line that called into the package of this function's caller.

    Args:
        message: of the UserWarning.
    """
    frame, level = sys._getframe(1), 2
    package = frame.f_globals["__name__"].partition(".")[0]
    while frame.f_back is not None and frame.f_globals["__name__"].partition(".")[0] == package:
        frame, level = frame.f_back, level + 1
    warnings.warn(message, stacklevel=level)


def is_traced(*trees: object) -> bool:
    """Whether any leaf is a tracer, whose value the host cannot see.

    Args:
        *trees: pytrees.

    Returns:
        Whether one is.
    """
    return any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(trees))


def require(holds: ArrayLike, message: str) -> None:
    """Raise ValueError unless a condition holds everywhere.

    Args:
        holds: bool or array of bools; a traced one passes.
        message: of the error.

    Raises:
        ValueError: If the condition fails anywhere.
    """
    if not is_traced(holds) and not np.all(np.asarray(holds)):
        raise ValueError(message)


def within(name: str, value: object, limit: Limit, *, remedy: str = "") -> None:
    """Check that every element of a value is a number within a limit.

    Args:
        name: of the value, for the message.
        value: number or array; a traced one passes.
        limit: of the values.
        remedy: added to the message.

    Raises:
        ValueError: If an element is outside the limit or no number.
    """
    if is_traced(value, limit.above, limit.least, limit.most, limit.below):
        return
    array, remedy = np.asarray(value), f"; {remedy}" if remedy else ""
    if array.dtype.kind not in "fiub":
        raise ValueError(f"{name} = {shown(value)}: give {limit}{remedy}")
    if not len(bad := np.argwhere(~np.asarray(limit.holds(array)))):
        return
    where = f" at {bad[0].tolist()} (bad at {len(bad)} of {array.size})" if array.ndim else ""
    value_text = f"{name} = {array[tuple(bad[0])]:g} {limit.unit}".rstrip()
    raise ValueError(f"{value_text}{where}: give {limit}{remedy}")


def finite(name: str, value: Values, unit: str = "", *, remedy: str = "") -> None:
    """Check that every element of a value is finite.

    Args:
        name: of the value, for the message.
        value: number or array; a traced one passes.
        unit: for the message.
        remedy: added to the message.

    Raises:
        ValueError: If an element is not finite.
    """
    within(name, value, Limit(unit=unit), remedy=remedy)


def positive(name: str, value: Values, unit: str = "", *, remedy: str = "") -> None:
    """Check that every element of a value is finite and above 0.

    Args:
        name: of the value, for the message.
        value: number or array; a traced one passes.
        unit: for the message.
        remedy: added to the message.

    Raises:
        ValueError: If an element is not finite or not above 0.
    """
    within(name, value, above_zero(unit), remedy=remedy)


def not_negative(name: str, value: Values, unit: str = "", *, remedy: str = "") -> None:
    """Check that every element of a value is finite and at least 0.

    Args:
        name: of the value, for the message.
        value: number or array; a traced one passes.
        unit: for the message.
        remedy: added to the message.

    Raises:
        ValueError: If an element is not finite or below 0.
    """
    within(name, value, from_zero(unit), remedy=remedy)


def between(name: str, value: Values, low: float, high: float, *, ends: bool = False) -> None:
    """Check that every element of a value lies between two ends.

    Args:
        name: of the value, for the message.
        value: number or array; a traced one passes.
        low: lower end.
        high: upper end.
        ends: whether the ends themselves are allowed.

    Raises:
        ValueError: If an element lies outside.
    """
    within(name, value, Limit(least=low, most=high) if ends else Limit(above=low, below=high))


def whole(name: str, value: object, least: int = 1) -> None:
    """Check that a value is a whole number.

    Args:
        name: of the value, for the message.
        value: of any type.
        least: smallest allowed number.

    Raises:
        ValueError: If it is not, or below `least`.
    """
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < least:
        raise ValueError(f"{name} = {shown(value)}: give a whole number of {least} or more")


def parameters(tree: object, prefix: str = "") -> Iterator[tuple[str, Limit, Array]]:
    """Name, limit and value of every number in a dataclass and in those nested in it.

    A class declares limits of its fields in PARAMETERS; all other fields may have any finite value. Static fields and
    None are skipped. Dataclasses in a tuple have no name of their own.

    Args:
        tree: a dataclass.
        prefix: of the names.

    Yields:
        Name with a dot for each level, limit, and value.
    """
    for field in dataclasses.fields(tree):  # type: ignore[arg-type]
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


def within_limits(tree: object) -> None:
    """Check that every number in a dataclass, and in those nested in it, is within its limit.

    Args:
        tree: a dataclass.

    Raises:
        ValueError: If one is not.
    """
    for name, limit, value in parameters(tree):
        within(getattr(limit, "name", "") or name, value, limit)


def admissible(tree: object) -> Array:
    """Check on the device that every number in a dataclass, and in those nested in it, is within its limit.

    Args:
        tree: a dataclass, whose values may be traced.

    Returns:
        () bool.
    """
    good = jnp.asarray(True)
    for _, limit, value in parameters(tree):
        library = np if isinstance(value, np.ndarray) else jnp
        good &= library.all(limit.holds(value))
    return good


SAME_LENGTH = 1e-7
"""Share by which two lengths may differ and be one: positions of single precision are not told apart by less."""


def multiple(name: str, length: float, unit_name: str, unit: float) -> int:
    """Number of times that one length goes into another, which has to be whole.

    A length may be off by SAME_LENGTH, as one that was converted from feet is.

    Args:
        name: of the length, for the message.
        length: in m, above 0.
        unit_name: name of the unit, for the message.
        unit: in m.

    Returns:
        The number, 1 or more.

    Raises:
        ValueError: If the length is no whole multiple of the unit.
    """
    positive(name, length, "m")
    # Beyond 2^53 every number is whole, and infinity has no rounding.
    count = round(length / unit) if length / unit < 2**53 else 0
    if count < 1 or not math.isclose(count * unit, length, rel_tol=SAME_LENGTH):
        raise ValueError(
            f"{name} = {length:.9g} m is no whole multiple of {unit_name} = {unit:.9g} m: "
            f"change {unit_name} to a divisor, e.g. {_divisor(length, max(1, count))} m"
        )
    return count


NEIGHBOURS = 3
"""Counts on either side, among which a divisor of few digits is looked for."""


def _divisor(length: float, count: int) -> str:
    """A length that goes into another about so many times, in digits that are accepted when they are given."""
    near = sorted(
        range(max(1, count - NEIGHBOURS), count + NEIGHBOURS + 1), key=lambda near_count: abs(near_count - count)
    )
    for near_count in near:
        text = f"{length / near_count:g}"
        if math.isclose(near_count * float(text), length, rel_tol=1e-12):
            return text
    return repr(length / count)


def dtype(value: DTypeLike) -> np.dtype:
    """A floating type, checked.

    Args:
        value: float32 or float64, in any form that NumPy understands.

    Returns:
        The NumPy dtype.

    Raises:
        ValueError: If it is another type, or float64 while JAX has it disabled.
    """
    try:
        number_type = np.dtype(value)
    except TypeError as error:
        raise ValueError(f"dtype = {shown(value)}: give float32 or float64") from error
    if number_type not in (np.dtype("float32"), np.dtype("float64")):
        raise ValueError(f"dtype = {number_type}: give float32 or float64")
    if jax.dtypes.canonicalize_dtype(number_type) != number_type:
        raise ValueError(
            "dtype = float64, but JAX runs in float32: call jax.config.update('jax_enable_x64', True) first"
        )
    return number_type


def axes(name: str, values: Sequence[float], dimension: int) -> None:
    """Check that there is one finite number per axis.

    Args:
        name: of the values, for the message.
        values: one per axis.
        dimension: number of axes.

    Raises:
        ValueError: If their number differs, or one is not finite.
    """
    finite(name, values)
    if np.ndim(values) != 1:
        raise ValueError(f"{name} = {shown(values)}: give {dimension} values, one per axis")
    if len(values) != dimension:
        raise ValueError(f"{name} = {shown(tuple(values))} has {len(values)} values: give {dimension}, one per axis")
