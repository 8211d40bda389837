"""The transfers as JAX primitives: one trilinear form, its three gradients, and their derivatives.

A transfer's terms define B(x, rows, nodal), the sum over particles of a row times a derivative of the weights times
what a channel of the nodes holds. `scatter` is the gradient of B by the nodal field, `gather` the one by the rows,
`contract` the one by the position x. So reverse mode needs these three and nothing else:

    scatter  is transposed by gather (along the rows) and contract (along the position),
    gather   is transposed by scatter (along the nodes) and contract (along the position).

Forward mode along the position has weights derived once more. Everything differentiates to any order, on either
engine; native kernels stop at second derivatives of the weights.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir

from jaxmpm import native, stencil
from jaxmpm.stencil import Term

# The primitives. Arrays may have any number of leading batch axes, of length 1 where lanes share the array.
scatter_p = Primitive("jaxmpm_scatter")  # position (d, N), blocks of rows (r, N) -> (nodes, channels)
gather_p = Primitive("jaxmpm_gather")  # position (d, N), nodal (nodes, channels) -> (rows, N)
contract_p = Primitive("jaxmpm_contract")  # position, nodal, blocks -> (d, N)
# Tangents along the position, linear in `moved` (d, N).
scatter_moved_p = Primitive("jaxmpm_scatter_moved")  # position, moved, blocks -> (nodes, channels)
gather_moved_p = Primitive("jaxmpm_gather_moved")  # position, moved, nodal -> (rows, N)

_STATICS = ("grid", "kernel", "native_only", "terms")


def _batch(*arrays: Array) -> tuple[int, ...]:
    return np.broadcast_shapes(*(a.shape[:-2] for a in arrays))


def _nodal_shape(position, *others, grid, channels, **_):
    return jax.core.ShapedArray((*_batch(position, *others), grid.nodes, channels), position.dtype)


def _rows_shape(position, *others, rows, **_):
    return jax.core.ShapedArray((*_batch(position, *others), rows, position.shape[-1]), position.dtype)


def _position_shape(position, *others, **_):
    return jax.core.ShapedArray((*_batch(position, *others), *position.shape[-2:]), position.dtype)


def rows_of(blocks: Sequence[Array]) -> list[Array]:
    """The rows (N) of blocks (r, N), one after the other."""
    return [row for block in blocks for row in block]


def _over_lanes(function: Callable[..., Array], *arrays: Array) -> Array:
    """Map over the leading batch axes of arrays that share lanes by axes of length 1."""
    if arrays[0].ndim == 2:
        return function(*arrays)
    shared = [a.shape[0] == 1 for a in arrays]
    lanes = [a[0] if s else a for a, s in zip(arrays, shared, strict=True)]
    if all(shared):
        return _over_lanes(function, *lanes)[None]
    return jax.vmap(partial(_over_lanes, function), in_axes=[None if s else 0 for s in shared])(*lanes)


def _scatter_xla(position, *blocks, native_only, grid, kernel, terms, channels):
    def one_lane(position, *blocks):
        return stencil.scatter(grid, kernel, position, rows_of(blocks), terms=terms, channels=channels)

    _refuse(native_only)
    return _over_lanes(one_lane, position, *blocks)


def _gather_xla(position, nodal, *, native_only, grid, kernel, terms, rows):
    _refuse(native_only)
    return _over_lanes(partial(stencil.gather, grid, kernel, terms=terms, rows=rows), position, nodal)


def _refuse(native_only: bool) -> None:
    if native_only:
        raise ValueError("Engine.NATIVE has no kernels for this device, dtype or order of derivative: take Engine.XLA")


def _scatter_cpu(position, *blocks, native_only, grid, kernel, terms, channels):
    if native.available() and native.supports(position, terms):
        return native.scatter(grid, kernel, position, blocks, terms=terms, channels=channels)
    return _scatter_xla(
        position, *blocks, native_only=native_only, grid=grid, kernel=kernel, terms=terms, channels=channels
    )


def _gather_cpu(position, nodal, *, native_only, grid, kernel, terms, rows):
    if native.available() and native.supports(position, terms):
        return native.gather(grid, kernel, position, nodal, terms=terms, rows=rows)
    return _gather_xla(position, nodal, native_only=native_only, grid=grid, kernel=kernel, terms=terms, rows=rows)


def _contract_cpu(position, nodal, *blocks, native_only, grid, kernel, terms):
    if native.available() and native.supports(position, _raised(terms, position.shape[-2])):
        return native.contract(grid, kernel, position, nodal, blocks, terms=terms)
    statics = {"native_only": native_only, "grid": grid, "kernel": kernel, "terms": terms}
    return _contract_expanded(position, nodal, *blocks, **statics)


def _raised(terms: Sequence[Term], dimension: int) -> tuple[Term, ...]:
    """The terms derived along the position: row r becomes rows r d + a, one for each axis a."""
    return tuple(
        t._replace(row=t.row * dimension + a, axes=tuple(sorted((*t.axes, a)))) for t in terms for a in range(dimension)
    )


def _slopes(position, nodal, *, terms, rows, **statics):
    """What `gather` gives, derived along the position: (.., rows, d, N)."""
    d = position.shape[-2]
    found = gather_p.bind(position, nodal, terms=_raised(terms, d), rows=rows * d, **statics)
    return found.reshape(*found.shape[:-2], rows, d, found.shape[-1])


def _scatter_moved_expanded(position, moved, *blocks, terms, **statics):
    products = [(block[..., :, None, :] * moved[..., None, :, :]) for block in blocks]
    products = [p.reshape(*p.shape[:-3], -1, p.shape[-1]) for p in products]
    return scatter_p.bind(position, *products, terms=_raised(terms, moved.shape[-2]), **statics)


def _gather_moved_expanded(position, moved, nodal, **statics):
    return (_slopes(position, nodal, **statics) * moved[..., None, :, :]).sum(-2)


def _contract_expanded(position, nodal, *blocks, **statics):
    rows = jnp.concatenate([jnp.broadcast_to(b, (*_batch(*blocks), *b.shape[-2:])) for b in blocks], axis=-2)
    return (_slopes(position, nodal, rows=rows.shape[-2], **statics) * rows[..., :, None, :]).sum(-3)


def _scatter_jvp(primals, tangents, **statics):
    position, *blocks = primals
    moved, *changed = tangents
    parts = []
    if not all(isinstance(t, ad.Zero) for t in changed):
        parts.append(scatter_p.bind(position, *map(ad.instantiate_zeros, changed), **statics))
    if not isinstance(moved, ad.Zero):
        parts.append(scatter_moved_p.bind(position, moved, *blocks, **statics))
    return scatter_p.bind(*primals, **statics), sum(parts[1:], parts[0])


def _gather_jvp(primals, tangents, **statics):
    position, nodal = primals
    moved, changed = tangents
    parts = []
    if not isinstance(changed, ad.Zero):
        parts.append(gather_p.bind(position, changed, **statics))
    if not isinstance(moved, ad.Zero):
        parts.append(gather_moved_p.bind(position, moved, nodal, **statics))
    return gather_p.bind(position, nodal, **statics), sum(parts[1:], parts[0])


def _expanded_jvp(expanded, primals, tangents, **statics):
    return jax.jvp(partial(expanded, **statics), primals, tuple(map(ad.instantiate_zeros, tangents)))


def _summed(cotangent: Array, shape: tuple[int, ...]) -> Array:
    """Cotangent of an array that lanes may have shared."""
    shared = tuple(i for i, n in enumerate(shape) if n == 1 and cotangent.shape[i] != 1)
    return cotangent.sum(shared, keepdims=True) if shared else cotangent


def _scatter_transpose(cotangent, position, *blocks, channels, **statics):
    shapes = [b.aval.shape if ad.is_undefined_primal(b) else b.shape for b in blocks]
    if isinstance(cotangent, ad.Zero):
        return (None, *(ad.Zero(b.aval) if ad.is_undefined_primal(b) else None for b in blocks))
    ends = np.cumsum([shape[-2] for shape in shapes])
    rows = gather_p.bind(position, cotangent, rows=int(ends[-1]), **statics)
    parts = jnp.split(rows, ends[:-1], axis=-2)
    return (
        None,
        *(
            _summed(part, shape) if ad.is_undefined_primal(block) else None
            for part, block, shape in zip(parts, blocks, shapes, strict=True)
        ),
    )


def _gather_transpose(cotangent, position, nodal, *, rows, **statics):
    if isinstance(cotangent, ad.Zero):
        return None, ad.Zero(nodal.aval)
    spread = scatter_p.bind(position, cotangent, channels=nodal.aval.shape[-1], **statics)
    return None, _summed(spread, nodal.aval.shape)


def _scatter_moved_transpose(cotangent, position, moved, *blocks, channels, **statics):
    if isinstance(cotangent, ad.Zero):
        return (None, ad.Zero(moved.aval), *[None] * len(blocks))
    slope = contract_p.bind(position, cotangent, *blocks, **statics)
    return (None, _summed(slope, moved.aval.shape), *[None] * len(blocks))


def _gather_moved_transpose(cotangent, position, moved, nodal, *, rows, **statics):
    if isinstance(cotangent, ad.Zero):
        return None, ad.Zero(moved.aval), None
    slope = contract_p.bind(position, nodal, cotangent, **statics)
    return None, _summed(slope, moved.aval.shape), None


def _batched(primitive: Primitive, arrays: Sequence[Array], axes: Sequence[int | None], **statics):
    lanes = [a[None] if axis is None else jnp.moveaxis(a, axis, 0) for a, axis in zip(arrays, axes, strict=True)]
    return primitive.bind(*lanes, **statics), 0


def _register(primitive, shape, counts, *, jvp, transpose, on_cpu, elsewhere):
    primitive.def_abstract_eval(shape)
    primitive.def_impl(jax.jit(primitive.bind, static_argnames=(*_STATICS, *counts)))
    ad.primitive_jvps[primitive] = jvp
    if transpose is not None:
        ad.primitive_transposes[primitive] = transpose
    batching.primitive_batchers[primitive] = partial(_batched, primitive)
    mlir.register_lowering(primitive, mlir.lower_fun(elsewhere, multiple_results=False))
    mlir.register_lowering(primitive, mlir.lower_fun(on_cpu, multiple_results=False), platform="cpu")


def _register_expanded(primitive, shape, counts, expanded, *, transpose, on_cpu=None):
    """A primitive that is other primitives put together, where it is not a kernel of its own."""
    jvp = partial(_expanded_jvp, expanded)
    _register(primitive, shape, counts, jvp=jvp, transpose=transpose, on_cpu=on_cpu or expanded, elsewhere=expanded)


_register(
    scatter_p, _nodal_shape, ("channels",),
    jvp=_scatter_jvp, transpose=_scatter_transpose, on_cpu=_scatter_cpu, elsewhere=_scatter_xla,
)  # fmt: skip
_register(
    gather_p, _rows_shape, ("rows",),
    jvp=_gather_jvp, transpose=_gather_transpose, on_cpu=_gather_cpu, elsewhere=_gather_xla,
)  # fmt: skip
_register_expanded(
    scatter_moved_p, _nodal_shape, ("channels",), _scatter_moved_expanded, transpose=_scatter_moved_transpose
)
_register_expanded(gather_moved_p, _rows_shape, ("rows",), _gather_moved_expanded, transpose=_gather_moved_transpose)
_register_expanded(contract_p, _position_shape, (), _contract_expanded, transpose=None, on_cpu=_contract_cpu)
