"""Particles to grid and grid to particles: one meaning, two engines, their derivatives.

Both maps are linear in what they carry. A node's row in a grid array interleaves its channels: (nodes, channels),
nodes numbered fastest along the last axis.

By default a transfer is a JAX primitive that lowers to native kernels on CPU and to `jaxmpm.stencil` elsewhere.
Its derivatives are transfers again: along what is carried the same one, transposed the opposite one, and along the
position one with weights derived once more. So they run on the same engine, forward and reverse, to any order.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir

from jaxmpm import native, stencil
from jaxmpm.shape import WIDTH
from jaxmpm.stencil import Term
from jaxmpm.tensors import ACTING, AXES, VOIGT
from jaxmpm.types import Engine, Grid, Kernel


def p2g(
    grid: Grid,
    kernel: Kernel,
    position: Array,
    carried: Array | None,
    stress: Array | None,
    *,
    engine: Engine | None = None,
) -> Array:
    """Map particles to nodes: sum of weight * carried, and of -stress . weight gradient.

    position: (d, N) m. carried: (k, N), e.g. mass and momentum, or None. stress: volume times the stress
    components that act on the grid (J), (d (d + 1) / 2, N) in the order xx, yy, zz, xy, yz, xz of those that the
    dimension has, or None.
    engine: None takes native kernels on CPU where they were built, else XLA.
    Returns (nodes, k + d), (nodes, k) or (nodes, d): first the carried channels, then the force (N).
    Raises ValueError where the grid has fewer than 3 nodes along an axis, dtypes differ, or the engine is missing.
    Source: Bardenhagen and Kober (2004); Jiang et al. (2024), 10.1016/j.compgeo.2024.106413, Eqs. 20 to 22.
    """
    d, blocks, terms = grid.dimension, [], []
    k = 0 if carried is None else len(carried)
    if carried is not None:
        blocks.append(carried)
        terms += [Term(c, c) for c in range(k)]
    if stress is not None:
        blocks.append(stress)
        terms += [Term(k + _acting(i, j, d), k + i, (j,), -1) for i in range(d) for j in range(d)]
    _check(grid, position, *blocks)
    channels = k if stress is None else k + d
    if engine is Engine.XLA:
        return stencil.scatter(grid, kernel, position, _rows(blocks), terms=terms, channels=channels)
    native_only = _native_only(engine)
    statics = {"grid": grid, "kernel": kernel, "terms": tuple(terms), "native_only": native_only}
    return scatter_p.bind(position, *blocks, channels=channels, **statics)


def g2p(
    grid: Grid,
    kernel: Kernel,
    position: Array,
    nodal: Array,
    *,
    values: int,
    gradients: int,
    engine: Engine | None = None,
) -> tuple[Any, Any]:
    """Interpolate nodal fields at particles.

    position: (d, N) m. nodal: (nodes, c). The first `values` channels are interpolated to (values, N), the
    gradients (1/m) of the first `gradients` channels to (gradients, d, N); None where the count is 0.
    engine and errors: as for `p2g`.
    """
    d = grid.dimension
    _check(grid, position, nodal)
    terms = [Term(c, c) for c in range(values)]
    terms += [Term(values + c * d + j, c, (j,)) for c in range(gradients) for j in range(d)]
    count = values + gradients * d
    if engine is Engine.XLA:
        rows = stencil.gather(grid, kernel, position, nodal, terms=terms, rows=count)
    else:
        native_only = _native_only(engine)
        statics = {"grid": grid, "kernel": kernel, "terms": tuple(terms), "native_only": native_only}
        rows = gather_p.bind(position, nodal, rows=count, **statics)
    gradient = rows[values:].reshape(gradients, d, position.shape[-1])
    return rows[:values] if values else None, gradient if gradients else None


def _acting(i: int, j: int, dimension: int) -> int:
    """Place of the stress component (i, j) among those that act on a grid of this dimension."""
    axes = AXES[dimension]
    return ACTING[dimension].index(VOIGT[axes[i]][axes[j]])


def _check(grid: Grid, *arrays: Array) -> None:
    if min(grid.shape) < WIDTH:
        raise ValueError(f"grid shape {grid.shape} has an axis of fewer than {WIDTH} nodes: enlarge the grid")
    dtypes = {a.dtype for a in arrays}
    if len(dtypes) > 1:
        names = ", ".join(sorted(str(t) for t in dtypes))
        raise ValueError(f"arrays of a transfer mix {names}: give all of them one dtype")


def _native_only(engine: Engine | None) -> bool:
    if not native.available() and engine is Engine.NATIVE:
        raise ValueError("Engine.NATIVE was not built: install a C++ compiler and jaxmpm again, or take Engine.XLA")
    return engine is Engine.NATIVE


# The primitives. Arrays may have any number of leading batch axes, of length 1 where lanes share the array.
scatter_p = Primitive("jaxmpm_scatter")  # position (d, N), blocks of rows (r, N) -> (nodes, channels)
gather_p = Primitive("jaxmpm_gather")  # position (d, N), nodal (nodes, channels) -> (rows, N)

_STATICS = ("grid", "kernel", "native_only", "terms")
scatter_p.def_impl(jax.jit(scatter_p.bind, static_argnames=(*_STATICS, "channels")))
gather_p.def_impl(jax.jit(gather_p.bind, static_argnames=(*_STATICS, "rows")))


def _batch(*arrays: Array) -> tuple[int, ...]:
    return np.broadcast_shapes(*(a.shape[:-2] for a in arrays))


@scatter_p.def_abstract_eval
def _(position, *blocks, grid, channels, **_):
    return jax.core.ShapedArray((*_batch(position, *blocks), grid.nodes, channels), position.dtype)


@gather_p.def_abstract_eval
def _(position, nodal, *, rows, **_):
    return jax.core.ShapedArray((*_batch(position, nodal), rows, position.shape[-1]), position.dtype)


def _rows(blocks: Sequence[Array]) -> list[Array]:
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
        return stencil.scatter(grid, kernel, position, _rows(blocks), terms=terms, channels=channels)

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


def _raised(terms: Sequence[Term], dimension: int) -> tuple[Term, ...]:
    """The terms derived along the position: row r becomes rows r d + a, one for each axis a."""
    return tuple(
        t._replace(row=t.row * dimension + a, axes=tuple(sorted((*t.axes, a)))) for t in terms for a in range(dimension)
    )


def _scatter_jvp(primals, tangents, *, terms, **statics):
    position, *blocks = primals
    moved, *changed = tangents
    out = scatter_p.bind(*primals, terms=terms, **statics)
    parts = []
    if not all(isinstance(t, ad.Zero) for t in changed):
        parts.append(scatter_p.bind(position, *map(ad.instantiate_zeros, changed), terms=terms, **statics))
    if not isinstance(moved, ad.Zero):
        blocks = [_product(block, moved) for block in blocks]
        parts.append(scatter_p.bind(position, *blocks, terms=_raised(terms, moved.shape[-2]), **statics))
    return out, sum(parts[1:], parts[0])


def _product(rows: Array, moved: Array) -> Array:
    """All products of (.., r, N) and (.., d, N): (.., r d, N)."""
    product = rows[..., :, None, :] * moved[..., None, :, :]
    return product.reshape(*product.shape[:-3], -1, product.shape[-1])


def _gather_jvp(primals, tangents, *, terms, rows, **statics):
    position, nodal = primals
    moved, changed = tangents
    out = gather_p.bind(position, nodal, terms=terms, rows=rows, **statics)
    parts = []
    if not isinstance(changed, ad.Zero):
        parts.append(gather_p.bind(position, changed, terms=terms, rows=rows, **statics))
    if not isinstance(moved, ad.Zero):
        d = moved.shape[-2]
        slope = gather_p.bind(position, nodal, terms=_raised(terms, d), rows=rows * d, **statics)
        slope = slope.reshape(*slope.shape[:-2], rows, d, slope.shape[-1])
        parts.append((slope * moved[..., None, :, :]).sum(-2))
    return out, sum(parts[1:], parts[0])


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


def _batched(primitive: Primitive, arrays: Sequence[Array], axes: Sequence[int | None], **statics):
    lanes = [a[None] if axis is None else jnp.moveaxis(a, axis, 0) for a, axis in zip(arrays, axes, strict=True)]
    return primitive.bind(*lanes, **statics), 0


for primitive, jvp, transpose, on_cpu, elsewhere in (
    (scatter_p, _scatter_jvp, _scatter_transpose, _scatter_cpu, _scatter_xla),
    (gather_p, _gather_jvp, _gather_transpose, _gather_cpu, _gather_xla),
):
    ad.primitive_jvps[primitive] = jvp
    ad.primitive_transposes[primitive] = transpose
    batching.primitive_batchers[primitive] = partial(_batched, primitive)
    mlir.register_lowering(primitive, mlir.lower_fun(elsewhere, multiple_results=False))
    mlir.register_lowering(primitive, mlir.lower_fun(on_cpu, multiple_results=False), platform="cpu")
