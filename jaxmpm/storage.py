"""Arrays that are stored once, before any use.

XLA on CPU computes anew for every use what it can fuse, and all that rows of one array need in one loop, which it does
not vectorise. Rows that are written into an array one after the other are computed once, each in a loop of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import jax
import jax.numpy as jnp
from jax import Array
from jax.core import ShapedArray
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir

stored_p = Primitive("jaxmpm_stored")
"""Arrays of one shape -> the same arrays."""
stored_p.multiple_results = True


def stored(arrays: Sequence[Array]) -> list[Array]:
    """The same arrays, stored before any use, and so are their tangents and cotangents.

    Args:
        arrays: two or more of one shape and dtype; XLA sees through the storing of a single one.

    Returns:
        The same arrays.
    """
    return stored_p.bind(*arrays)


@jax.custom_jvp
def stored_in_reverse(arrays: Sequence[Array]) -> Sequence[Array]:
    """The same arrays; their cotangents are stored before any use.

    Args:
        arrays: as for `stored`.

    Returns:
        The same arrays.
    """
    return arrays


@stored_in_reverse.defjvp
def _(primals: tuple[Sequence[Array]], tangents: tuple[Sequence[Array]]) -> tuple[Sequence[Array], Sequence[Array]]:
    return primals[0], stored(tangents[0])


def _written(*arrays: Array) -> list[Array]:
    array = jnp.zeros((len(arrays), *arrays[0].shape), arrays[0].dtype)
    for i, row in enumerate(arrays):
        array = jax.lax.dynamic_update_index_in_dim(array, row, i, axis=0)
    return [row.reshape(array.shape[1:]) for row in jax.lax.split(array, (1,) * len(arrays))]


def _jvp(primals: Sequence[Array], tangents: Sequence[object]) -> tuple[list[Array], list[Array]]:
    return stored(primals), stored([ad.instantiate_zeros(tangent) for tangent in tangents])


def _transpose(cotangents: Sequence[object], *arrays: object) -> list[object]:
    if all(isinstance(cotangent, ad.Zero) for cotangent in cotangents):
        return list(cotangents)
    return list(stored([ad.instantiate_zeros(cotangent) for cotangent in cotangents]))


def _batched(arrays: Sequence[Array], axes: Sequence[int | None]) -> tuple[list[Array], list[int]]:
    size = next(array.shape[axis] for array, axis in zip(arrays, axes, strict=True) if axis is not None)
    lanes = [batching.bdim_at_front(array, axis, size) for array, axis in zip(arrays, axes, strict=True)]
    return stored(lanes), [0] * len(lanes)


def _shapes(*arrays: ShapedArray) -> list[ShapedArray]:
    return list(arrays)


stored_p.def_abstract_eval(_shapes)
stored_p.def_impl(jax.jit(stored_p.bind))
ad.primitive_jvps[stored_p] = _jvp
ad.primitive_transposes[stored_p] = _transpose
batching.primitive_batchers[stored_p] = _batched
mlir.register_lowering(stored_p, partial(mlir.lower_fun, multiple_results=True)(_written))
