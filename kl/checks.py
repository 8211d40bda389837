"""Checks of what the host can see: values that are being traced by JAX pass unchecked."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np


def is_traced(*trees: Any) -> bool:
    """Whether any leaf is a tracer, whose value the host cannot see."""
    return any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(trees))


def require(holds: Any, message: str) -> None:
    """Raise `ValueError(message)` unless `holds` everywhere; conditions under tracing pass."""
    if not is_traced(holds) and not np.all(np.asarray(holds)):
        raise ValueError(message)


def require_positive(name: str, value: Any, remedy: str) -> None:
    """Raise unless `value` is finite and above 0 everywhere."""
    if not is_traced(value):
        number = np.asarray(value)
        require(np.isfinite(number) & (number > 0), f"{name} = {value} must be above 0: {remedy}")


def real_dtype(dtype: Any, *arrays: Any) -> Any:
    """The floating dtype asked for, or else the one that `arrays` have.

    Raises ValueError for float64 while JAX has it disabled.
    """
    if dtype is None:
        found = jnp.result_type(*arrays, float) if arrays else jnp.result_type(float)
        return found
    if np.dtype(dtype) == np.float64 and jnp.result_type(float) != np.float64:
        raise ValueError("dtype = float64, but JAX has 64 bits disabled: set jax_enable_x64 or ask for float32")
    require(np.issubdtype(np.dtype(dtype), np.floating), f"dtype = {dtype} is no floating type: give float32 or 64")
    return np.dtype(dtype)
