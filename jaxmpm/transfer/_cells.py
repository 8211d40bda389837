"""Sums over the particles in the same cell, as a JAX primitive.

The sum is linear in the values and symmetric: its transpose is the sum itself. It lowers to native kernels on CPU and
CUDA GPUs, and to XLA elsewhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from types import ModuleType

import jax.numpy as jnp
from jax import Array
from jax.core import ShapedArray
from jax.extend.core import Primitive
from jax.interpreters import ad

from jaxmpm.transfer._primitives import Tangent, batch_shape, over_lanes, register, summed
from jaxmpm.types import Engine

cell_sums_p = Primitive("jaxmpm_cell_sums")  # cell (1, N), values (c, N) -> (c, N); leading axes as of the transfers


def cell_sums(cell: Array, values: Array, *, cells: int, engine: Engine | None = None) -> Array:
    """For each particle the sum of values over the particles in its cell, itself included.

    Args:
        cell: numbers (N,) int32 of the particles' cells, from 0.
        values: (c, N).
        cells: number of cells.
        engine: None takes native kernels if they were built, else XLA.

    Returns:
        (c, N).
    """
    if engine is Engine.XLA:
        return _xla(cell[None], values, cells=cells)
    return cell_sums_p.bind(cell[None], values, cells=cells)


def _xla(cell: Array, values: Array, *, cells: int) -> Array:
    def of_row(cell: Array, row: Array) -> Array:
        return jnp.zeros(cells, row.dtype).at[cell].add(row)[cell]

    # One row at a time: XLA on CPU adds two in one scatter three times as slowly.
    return over_lanes(lambda cell, values: jnp.stack([of_row(cell[0], row) for row in values]), cell, values)


def _compiled(engine: ModuleType, cell: Array, values: Array, *, cells: int) -> Array:
    if engine.available() and values.dtype in (jnp.float32, jnp.float64):
        return engine.cell_sums(cell, values, cells=cells)
    return _xla(cell, values, cells=cells)


def _shape(cell: ShapedArray, values: ShapedArray, *, cells: int) -> ShapedArray:
    return ShapedArray((*batch_shape(cell, values), *values.shape[-2:]), values.dtype)


def _jvp(primals: Sequence[Array], tangents: Sequence[Tangent], *, cells: int) -> tuple[Array, Array]:
    bound = partial(cell_sums_p.bind, primals[0], cells=cells)
    return bound(primals[1]), bound(ad.instantiate_zeros(tangents[1]))


def _transpose(cotangent: Tangent, cell: Array, values: Tangent, *, cells: int) -> tuple[Tangent, ...]:
    if isinstance(cotangent, ad.Zero):
        return None, ad.Zero(values.aval)
    return None, summed(cell_sums_p.bind(cell, cotangent, cells=cells), values.aval.shape)


register(cell_sums_p, _shape, ("cells",), jvp=_jvp, transpose=_transpose, compiled=_compiled, elsewhere=_xla)
