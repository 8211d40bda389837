"""The transfers as JAX primitives: one trilinear form, its three gradients, and their derivatives.

A transfer's terms define B(x, rows, nodal), the sum over particles of a row times a derivative of the weights times a
channel of the nodes. `scatter` is the gradient of B by the nodal field, `gather` the one by the rows, `contract` the
one by the position x. So reverse mode needs these three and nothing else:

    scatter  is transposed by gather (along the rows) and contract (along the position), both in one kernel,
    gather   is transposed by scatter (along the nodes) and contract (along the position).

Forward mode along the position differentiates the weights once more. Everything differentiates to any order, on either
engine; native kernels, of CPU and of CUDA GPUs, stop at second derivatives of the weights.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from types import ModuleType
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.core import ShapedArray
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir

from jaxmpm.grid import Grid
from jaxmpm.protocols import Kernel
from jaxmpm.transfer import _stencil as stencil
from jaxmpm.transfer import native
from jaxmpm.transfer._stencil import Term
from jaxmpm.transfer.native import cuda

# The primitives. Arrays may have any number of leading batch axes, of length 1 where lanes share the array. Where a
# grid stores nodes near soil alone, the array `first` of its `NearNodes` follows the position.
scatter_p = Primitive("jaxmpm_scatter")  # position (d, N), blocks of rows (r, N) -> (nodes, channels)
gather_p = Primitive("jaxmpm_gather")  # position (d, N), nodal (nodes, channels) -> (rows, N)
contract_p = Primitive("jaxmpm_contract")  # position, nodal, blocks -> (d, N), and what gather gives if rows > 0
contract_p.multiple_results = True
# Tangents: of scatter, linear in `shift` (d, N) and in as many changed blocks as there are blocks; of gather along the
# position, linear in `shift`.
scatter_tangent_p = Primitive("jaxmpm_scatter_tangent")  # position, shift, changed blocks, blocks -> (nodes, channels)
gather_tangent_p = Primitive("jaxmpm_gather_tangent")  # position, shift, nodal -> (rows, N)

# An argument of a differentiation rule: an array, a symbolic zero, or an undefined primal (JAX has no type for it).
Tangent = Any

ENGINES = {"cpu": native, "cuda": cuda}
"""Compiled kernels by platform."""

_STATICS = ("grid", "kernel", "native_only", "terms")


def batch_shape(*arrays: Array | ShapedArray) -> tuple[int, ...]:
    """Leading batch axes of arrays that share lanes by axes of length 1."""
    return np.broadcast_shapes(*(a.shape[:-2] for a in arrays))


def _nodal_shape(position: ShapedArray, *others: ShapedArray, grid: Grid, channels: int, **_: object) -> ShapedArray:
    return ShapedArray((*batch_shape(position, *others), stencil.rows_of_grid(grid), channels), position.dtype)


def _rows_shape(position: ShapedArray, *others: ShapedArray, rows: int, **_: object) -> ShapedArray:
    return ShapedArray((*batch_shape(position, *others), rows, position.shape[-1]), position.dtype)


def _contract_shape(position: ShapedArray, *others: ShapedArray, rows: int, **_: object) -> list[ShapedArray]:
    slope = ShapedArray((*batch_shape(position, *others), *position.shape[-2:]), position.dtype)
    return [slope, _rows_shape(position, *others, rows=rows)]


def rows_of(blocks: Sequence[Array]) -> list[Array]:
    """Rows (N,) of blocks (r, N), one after the other."""
    return [row for block in blocks for row in block]


def placed(arrays: Sequence[Any], grid: Grid) -> tuple[Sequence[Any], Sequence[Any]]:
    """Arrays of a transfer in two: the position, with what tells the rows of the nodes, and the others."""
    count = 1 if grid.stored is None else 2
    return arrays[:count], arrays[count:]


def _rows_by(where: Sequence[Array]) -> dict[str, Array]:
    """The argument `first` of an engine, where there is one."""
    return dict(zip(("first",), where[1:], strict=False))


def over_lanes(function: Callable[..., Array], *arrays: Array) -> Array:
    """Map over the leading batch axes of arrays that share lanes by axes of length 1."""
    if arrays[0].ndim == 2:
        return function(*arrays)
    shared = [a.shape[0] == 1 for a in arrays]
    lanes = [a[0] if s else a for a, s in zip(arrays, shared, strict=True)]
    if all(shared):
        return over_lanes(function, *lanes)[None]
    return jax.vmap(partial(over_lanes, function), in_axes=[None if s else 0 for s in shared])(*lanes)


def _scatter_xla(
    *arrays: Array, native_only: bool, grid: Grid, kernel: Kernel, terms: Sequence[Term], channels: int
) -> Array:
    def one_lane(*arrays: Array) -> Array:
        where, blocks = placed(arrays, grid)
        rows = rows_of(blocks)
        return stencil.scatter(grid, kernel, where[0], rows, terms=terms, channels=channels, **_rows_by(where))

    _refuse(native_only)
    return over_lanes(one_lane, *arrays)


def _gather_xla(
    *arrays: Array, native_only: bool, grid: Grid, kernel: Kernel, terms: Sequence[Term], rows: int
) -> Array:
    def one_lane(*arrays: Array) -> Array:
        where, (nodal,) = placed(arrays, grid)
        return stencil.gather(grid, kernel, where[0], nodal, terms=terms, rows=rows, **_rows_by(where))

    _refuse(native_only)
    return over_lanes(one_lane, *arrays)


def _refuse(native_only: bool) -> None:
    if native_only:
        raise ValueError(
            "Engine.NATIVE has no code for this device, dtype, kernel or order of derivative: take Engine.XLA"
        )


def _runs(engine: ModuleType, kernel: Kernel, position: Array, terms: Sequence[Term]) -> bool:
    """Whether an engine has a kernel for a transfer."""
    return engine.available() and native.supports(kernel, position, terms)


def _scatter_native(
    engine: ModuleType,
    *arrays: Array,
    native_only: bool,
    grid: Grid,
    kernel: Kernel,
    terms: Sequence[Term],
    channels: int,
) -> Array:
    where, blocks = placed(arrays, grid)
    if _runs(engine, kernel, where[0], terms):
        return engine.scatter(grid, kernel, where[0], blocks, terms=terms, channels=channels, **_rows_by(where))
    return _scatter_xla(*arrays, native_only=native_only, grid=grid, kernel=kernel, terms=terms, channels=channels)


def _gather_native(
    engine: ModuleType,
    *arrays: Array,
    native_only: bool,
    grid: Grid,
    kernel: Kernel,
    terms: Sequence[Term],
    rows: int,
) -> Array:
    where, (nodal,) = placed(arrays, grid)
    if _runs(engine, kernel, where[0], terms):
        return engine.gather(grid, kernel, where[0], nodal, terms=terms, rows=rows, **_rows_by(where))
    return _gather_xla(*arrays, native_only=native_only, grid=grid, kernel=kernel, terms=terms, rows=rows)


def _contract_native(
    engine: ModuleType,
    *arrays: Array,
    native_only: bool,
    grid: Grid,
    kernel: Kernel,
    terms: Sequence[Term],
    rows: int,
) -> Sequence[Array]:
    where, (nodal, *blocks) = placed(arrays, grid)
    if _runs(engine, kernel, where[0], _raised(terms, grid.dimension)):
        return engine.contract(grid, kernel, where[0], nodal, blocks, terms=terms, rows=rows, **_rows_by(where))
    return _contract_expanded(*arrays, rows=rows, native_only=native_only, grid=grid, kernel=kernel, terms=terms)


def _raised(terms: Sequence[Term], dimension: int) -> tuple[Term, ...]:
    """The terms differentiated along the position: row r becomes rows r d + a, one for each axis a."""
    return tuple(
        t._replace(row=t.row * dimension + a, axes=tuple(sorted((*t.axes, a)))) for t in terms for a in range(dimension)
    )


def _slopes(where: Sequence[Array], nodal: Array, *, terms: Sequence[Term], rows: int, **statics: object) -> Array:
    """Derivative along the position of the result of `gather`: (.., rows, d, N)."""
    d = where[0].shape[-2]
    derived = gather_p.bind(*where, nodal, terms=_raised(terms, d), rows=rows * d, **statics)
    return derived.reshape(*derived.shape[:-2], rows, d, derived.shape[-1])


def _scatter_tangent_expanded(*arrays: Array, terms: tuple[Term, ...], grid: Grid, **statics: object) -> Array:
    where, (shift, *both) = placed(arrays, grid)
    changed, blocks = both[: len(both) // 2], both[len(both) // 2 :]
    count = sum(block.shape[-2] for block in blocks)
    products = [block[..., :, None, :] * shift[..., None, :, :] for block in blocks]
    products = [p.reshape(*p.shape[:-3], -1, p.shape[-1]) for p in products]
    raised = tuple(t._replace(row=count + t.row) for t in _raised(terms, shift.shape[-2]))
    return scatter_p.bind(*where, *changed, *products, terms=terms + raised, grid=grid, **statics)


def _gather_tangent_expanded(*arrays: Array, terms: Sequence[Term], rows: int, grid: Grid, **statics: object) -> Array:
    where, (shift, nodal) = placed(arrays, grid)
    return (_slopes(where, nodal, terms=terms, rows=rows, grid=grid, **statics) * shift[..., None, :, :]).sum(-2)


def _contract_expanded(*arrays: Array, terms: Sequence[Term], rows: int, grid: Grid, **statics: object) -> list[Array]:
    where, (nodal, *blocks) = placed(arrays, grid)
    stacked = jnp.concatenate([jnp.broadcast_to(b, (*batch_shape(*blocks), *b.shape[-2:])) for b in blocks], axis=-2)
    slopes = _slopes(where, nodal, terms=terms, rows=stacked.shape[-2], grid=grid, **statics)
    slope = (slopes * stacked[..., :, None, :]).sum(-3)
    if rows:
        return [slope, gather_p.bind(*where, nodal, terms=terms, rows=rows, grid=grid, **statics)]
    return [slope, jnp.zeros((*slope.shape[:-2], 0, slope.shape[-1]), slope.dtype)]


def _scatter_jvp(
    primals: Sequence[Array], tangents: Sequence[Tangent], *, grid: Grid, **statics: object
) -> tuple[Array, Array]:
    (where, blocks), (shifts, changed) = placed(primals, grid), placed(tangents, grid)
    changed = [ad.instantiate_zeros(tangent) for tangent in changed]
    if isinstance(shifts[0], ad.Zero):
        tangent = scatter_p.bind(*where, *changed, grid=grid, **statics)
    else:
        tangent = scatter_tangent_p.bind(*where, shifts[0], *changed, *blocks, grid=grid, **statics)
    return scatter_p.bind(*primals, grid=grid, **statics), tangent


def _gather_jvp(
    primals: Sequence[Array], tangents: Sequence[Tangent], *, grid: Grid, **statics: object
) -> tuple[Array, Array]:
    (where, (nodal,)), (shifts, (changed,)) = placed(primals, grid), placed(tangents, grid)
    parts = []
    if not isinstance(changed, ad.Zero):
        parts.append(gather_p.bind(*where, changed, grid=grid, **statics))
    if not isinstance(shifts[0], ad.Zero):
        parts.append(gather_tangent_p.bind(*where, shifts[0], nodal, grid=grid, **statics))
    return gather_p.bind(*where, nodal, grid=grid, **statics), sum(parts[1:], parts[0])


def _expanded_jvp(
    expanded: Callable[..., object],
    primals: Sequence[Array],
    tangents: Sequence[Tangent],
    *,
    grid: Grid,
    **statics: object,
) -> tuple[object, object]:
    (where, others), (shifts, changed) = placed(primals, grid), placed(tangents, grid)

    def moved(position: Array, *others: Array) -> object:
        return expanded(position, *where[1:], *others, grid=grid, **statics)

    return jax.jvp(moved, (where[0], *others), tuple(map(ad.instantiate_zeros, (shifts[0], *changed))))


def summed(cotangent: Array, shape: tuple[int, ...]) -> Array:
    """Cotangent of an array that lanes may have shared."""
    shared = tuple(i for i, n in enumerate(shape) if n == 1 and cotangent.shape[i] != 1)
    return cotangent.sum(shared, keepdims=True) if shared else cotangent


def _split(rows: Array, blocks: Sequence[Tangent]) -> list[Array | None]:
    """Rows as blocks of the shapes of the linear ones; None for those that are not linear."""
    shapes = [b.aval.shape if ad.is_undefined_primal(b) else b.shape for b in blocks]
    ends = np.cumsum([shape[-2] for shape in shapes])
    return [
        summed(part, shape) if ad.is_undefined_primal(block) else None
        for part, block, shape in zip(jnp.split(rows, ends[:-1], axis=-2), blocks, shapes, strict=True)
    ]


def _count(blocks: Sequence[Tangent]) -> int:
    return sum((b.aval if ad.is_undefined_primal(b) else b).shape[-2] for b in blocks)


def _zeros(*arrays: Tangent) -> tuple[Tangent, ...]:
    return tuple(ad.Zero(a.aval) if ad.is_undefined_primal(a) else None for a in arrays)


def _scatter_transpose(
    cotangent: Tangent, *arrays: Tangent, channels: int, grid: Grid, **statics: object
) -> tuple[Tangent, ...]:
    where, blocks = placed(arrays, grid)
    none = [None] * len(where)
    if isinstance(cotangent, ad.Zero):
        return (*none, *_zeros(*blocks))
    gathered = gather_p.bind(*where, cotangent, rows=_count(blocks), grid=grid, **statics)
    return (*none, *_split(gathered, blocks))


def _scatter_tangent_transpose(
    cotangent: Tangent, *arrays: Tangent, channels: int, grid: Grid, **statics: object
) -> tuple[Tangent, ...]:
    where, (shift, *both) = placed(arrays, grid)
    changed, blocks = both[: len(both) // 2], both[len(both) // 2 :]
    before, after = [None] * len(where), [None] * len(blocks)
    if isinstance(cotangent, ad.Zero):
        return (*before, *_zeros(shift, *changed), *after)
    rows = _count(blocks) if any(map(ad.is_undefined_primal, changed)) else 0
    slope, gathered = contract_p.bind(*where, cotangent, *blocks, rows=rows, grid=grid, **statics)
    along = summed(slope, shift.aval.shape) if ad.is_undefined_primal(shift) else None
    return (*before, along, *(_split(gathered, changed) if rows else after), *after)


def _gather_transpose(
    cotangent: Tangent, *arrays: Tangent, rows: int, grid: Grid, **statics: object
) -> tuple[Tangent, ...]:
    where, (nodal,) = placed(arrays, grid)
    none = [None] * len(where)
    if isinstance(cotangent, ad.Zero):
        return (*none, ad.Zero(nodal.aval))
    spread = scatter_p.bind(*where, cotangent, channels=nodal.aval.shape[-1], grid=grid, **statics)
    return (*none, summed(spread, nodal.aval.shape))


def _gather_tangent_transpose(
    cotangent: Tangent, *arrays: Tangent, rows: int, grid: Grid, **statics: object
) -> tuple[Tangent, ...]:
    where, (shift, nodal) = placed(arrays, grid)
    none = [None] * len(where)
    if isinstance(cotangent, ad.Zero):
        return (*none, ad.Zero(shift.aval), None)
    slope, _ = contract_p.bind(*where, nodal, cotangent, rows=0, grid=grid, **statics)
    return (*none, summed(slope, shift.aval.shape), None)


def batched(
    primitive: Primitive, arrays: Sequence[Array], axes: Sequence[int | None], **statics: object
) -> tuple[object, object]:
    """Rule of `jax.vmap`: a leading axis of each array, of length 1 where lanes share it."""
    lanes = [a[None] if axis is None else jnp.moveaxis(a, axis, 0) for a, axis in zip(arrays, axes, strict=True)]
    out = primitive.bind(*lanes, **statics)
    return (out, [0] * len(out)) if primitive.multiple_results else (out, 0)


def register(
    primitive: Primitive,
    shape: Callable[..., object],
    counts: tuple[str, ...],
    *,
    jvp: Callable[..., tuple[object, object]],
    transpose: Callable[..., tuple[Tangent, ...]] | None,
    compiled: Callable[..., object] | None,
    elsewhere: Callable[..., object],
) -> None:
    """Give a primitive its rules.

    Args:
        primitive: without rules yet.
        shape: abstract evaluation.
        counts: names of its parameters beside those of every transfer.
        jvp: rule of forward mode.
        transpose: rule of reverse mode; None if it is never transposed.
        compiled: what it lowers to where there may be native kernels, as a function of the engine that has them.
        elsewhere: what it lowers to on other devices.
    """
    primitive.def_abstract_eval(shape)
    primitive.def_impl(jax.jit(primitive.bind, static_argnames=(*_STATICS, *counts)))
    ad.primitive_jvps[primitive] = jvp
    if transpose is not None:
        ad.primitive_transposes[primitive] = transpose
    batching.primitive_batchers[primitive] = partial(batched, primitive)
    lowered = partial(mlir.lower_fun, multiple_results=primitive.multiple_results)
    mlir.register_lowering(primitive, lowered(elsewhere))
    if compiled is not None:
        for platform, engine in ENGINES.items():
            mlir.register_lowering(primitive, lowered(partial(compiled, engine)), platform=platform)


def _register_expanded(
    primitive: Primitive,
    shape: Callable[..., object],
    counts: tuple[str, ...],
    expanded: Callable[..., object],
    *,
    transpose: Callable[..., tuple[Tangent, ...]] | None,
    compiled: Callable[..., object] | None = None,
) -> None:
    """Register a primitive that is composed of other primitives wherever it has no kernel of its own."""
    jvp = partial(_expanded_jvp, expanded)
    register(primitive, shape, counts, jvp=jvp, transpose=transpose, compiled=compiled, elsewhere=expanded)


register(
    scatter_p, _nodal_shape, ("channels",),
    jvp=_scatter_jvp, transpose=_scatter_transpose, compiled=_scatter_native, elsewhere=_scatter_xla,
)  # fmt: skip
register(
    gather_p, _rows_shape, ("rows",),
    jvp=_gather_jvp, transpose=_gather_transpose, compiled=_gather_native, elsewhere=_gather_xla,
)  # fmt: skip
_register_expanded(
    scatter_tangent_p, _nodal_shape, ("channels",), _scatter_tangent_expanded, transpose=_scatter_tangent_transpose
)
_register_expanded(
    gather_tangent_p, _rows_shape, ("rows",), _gather_tangent_expanded, transpose=_gather_tangent_transpose
)
_register_expanded(
    contract_p, _contract_shape, ("rows",), _contract_expanded, transpose=None, compiled=_contract_native
)
