"""Set-up that JAX traces: what JAX is not tracing stays known to the host.

Within `jax.jit` every operation of JAX makes a traced value, even one of known numbers. Builders look at numbers, such
as the places of particles, so they work those out at once, while the program is traced.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import is_dataclass
from types import ModuleType
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike, DTypeLike

from jaxmpm.support import check

T = TypeVar("T")


def host(*trees: object) -> ModuleType:
    """NumPy, or `jax.numpy` where a value is traced.

    Args:
        *trees: values that a calculation needs.

    Returns:
        The module.
    """
    return jnp if check.is_traced(*trees) else np


def at_once(function: Callable[..., T], *arguments: Any) -> T:
    """What a function gives, worked out now unless an argument is traced.

    Args:
        function: of JAX's arrays.
        *arguments: pytrees.

    Returns:
        Its result.
    """
    if check.is_traced(*arguments):
        return function(*arguments)
    with jax.ensure_compile_time_eval():
        return function(*arguments)


def array(value: ArrayLike, dtype: DTypeLike) -> Array:
    """An array of a precision, known unless the value is traced.

    Args:
        value: number or array.
        dtype: of the array.

    Returns:
        The array.
    """
    if check.is_traced(value):
        return jnp.asarray(value, dtype)
    if isinstance(value, Array) and value.dtype == dtype:
        return value
    with jax.ensure_compile_time_eval():
        return jax.device_put(np.array(value, dtype))  # unlike jnp.asarray, it compiles no program for the shape


def zeros_like(tree: T) -> T:
    """A pytree of known zeros.

    Args:
        tree: of arrays, traced or not.

    Returns:
        The pytree, of their shapes and precisions.
    """
    return jax.tree.map(lambda leaf: array(np.zeros(leaf.shape), leaf.dtype), tree)


def on_host(tree: T) -> T:
    """A pytree of NumPy's arrays, with which no operation compiles a program; itself where a value is traced.

    Args:
        tree: of arrays.

    Returns:
        The pytree.
    """
    return tree if check.is_traced(tree) else jax.device_get(tree)


def product(values: Array, factor: Array | np.ndarray) -> Array:
    """The product of two arrays, known unless one is traced.

    Args:
        values: array.
        factor: array of a shape that goes with it.

    Returns:
        The array, of the precision of `values`.
    """
    return array(on_host(values) * on_host(factor), values.dtype)


def taken(tree: T, order: np.ndarray | slice) -> T:
    """A pytree of arrays (..., N) with other places along the last axis, each known unless it is traced.

    Args:
        tree: of arrays.
        order: places (M,) to take, or a span of them.

    Returns:
        The pytree.
    """

    def at(leaf: Array) -> Array:
        return leaf[..., order] if check.is_traced(leaf) else array(np.asarray(leaf)[..., order], leaf.dtype)

    return jax.tree.map(at, tree)


def require_known(values: Mapping[str, object], remedy: str) -> None:
    """Check that values that shape a program are known.

    Args:
        values: by name; of dataclasses, all fields.
        remedy: how to differentiate by them, or to batch them, otherwise.

    Raises:
        ValueError: One is traced.
    """
    for name, value in values.items():
        parts = vars(value) if is_dataclass(value) and not isinstance(value, type) else {"": value}
        for part, leaf in parts.items():
            if check.is_traced(leaf):
                raise ValueError(
                    f"{f'{part} of ' if part else ''}{name} is traced by jit, grad or vmap, and it shapes the program: "
                    f"give a number; {remedy}"
                )
