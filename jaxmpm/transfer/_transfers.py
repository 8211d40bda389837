"""Particles to grid and grid to particles: one definition, two engines, their derivatives.

Both maps are linear in the values that they transfer. A node's row in a grid array interleaves its channels:
(nodes, channels), nodes numbered fastest along the last axis.

By default a transfer is a JAX primitive (`jaxmpm.transfer._primitives`) that lowers to native kernels on CPU and
CUDA GPUs, and to `jaxmpm.transfer._stencil` elsewhere, as do its derivatives.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from jax import Array

from jaxmpm.grid import Grid
from jaxmpm.protocols import Kernel
from jaxmpm.tensors import ACTING, AXES, VOIGT
from jaxmpm.transfer import _stencil as stencil
from jaxmpm.transfer import native
from jaxmpm.transfer._primitives import gather_p, rows_of, scatter_p
from jaxmpm.transfer._shape import WIDTH
from jaxmpm.transfer._stencil import Term
from jaxmpm.transfer.native import cuda
from jaxmpm.types import Engine


def p2g(
    grid: Grid,
    kernel: Kernel,
    position: Array,
    carried: Array | None,
    stress: Array | None,
    *,
    upright: Array | None = None,
    engine: Engine | None = None,
) -> Array:
    """Map particles to nodes: sum of weight * carried, and of -stress . weight gradient.

    Sources: Bardenhagen and Kober (2004), CMES 5(6), 477-495; Jiang et al. (2024), doi:10.1016/j.compgeo.2024.106413,
    Eqs. 20 to 22.

    Args:
        grid: of the nodes, 3 or more along each axis.
        kernel: shape functions.
        position: (d, N) m.
        carried: (k, N), for example mass and momentum, or None.
        stress: (d (d + 1) / 2, N) volume times the stress components that act on the grid (J), in the order xx, yy, zz,
            xy, yz, xz of those that the dimension has, or None.
        upright: (u, N), mapped by minus the weight's derivative along the last axis, or None.
        engine: None takes native kernels if they were built, else XLA.

    Returns:
        (nodes, channels): the carried ones, the d of the force in N, and those of `upright`, as far as they are given.

    Raises:
        ValueError: If the grid has fewer than 3 nodes along an axis, dtypes differ, or the engine is missing.
    """
    d, blocks, terms = grid.dimension, [], []
    k = 0 if carried is None else len(carried)
    if carried is not None:
        blocks.append(carried)
        terms += [Term(c, c) for c in range(k)]
    if stress is not None:
        blocks.append(stress)
        terms += [Term(k + _acting(i, j, d), k + i, (j,), -1) for i in range(d) for j in range(d)]
    channels = k if stress is None else k + d
    if upright is not None:
        before = sum(map(len, blocks))
        blocks.append(upright)
        terms += [Term(before + c, channels + c, (d - 1,), -1) for c in range(len(upright))]
        channels += len(upright)
    _check(grid, position, *blocks)
    static_grid, first = _storage(grid)
    if engine is Engine.XLA:
        rows = rows_of(blocks)
        return stencil.scatter(static_grid, kernel, position, rows, terms=terms, channels=channels, first=first)
    native_only = _native_only(engine)
    statics = {"grid": static_grid, "kernel": kernel, "terms": tuple(terms), "native_only": native_only}
    return scatter_p.bind(position, *([] if first is None else [first]), *blocks, channels=channels, **statics)


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

    Args:
        grid: of the nodes, 3 or more along each axis.
        kernel: shape functions.
        position: (d, N) m.
        nodal: (nodes, c).
        values: number of channels, the first ones, that are interpolated.
        gradients: number of channels, the first ones, whose gradients are interpolated.
        engine: None takes native kernels if they were built, else XLA.

    Returns:
        Values (values, N) and gradients (gradients, d, N) 1/m; None for a count of 0.

    Raises:
        ValueError: If the grid has fewer than 3 nodes along an axis, dtypes differ, or the engine is missing.
    """
    d = grid.dimension
    _check(grid, position, nodal)
    terms = [Term(c, c) for c in range(values)]
    terms += [Term(values + c * d + j, c, (j,)) for c in range(gradients) for j in range(d)]
    count = values + gradients * d
    static_grid, first = _storage(grid)
    if engine is Engine.XLA:
        rows = stencil.gather(static_grid, kernel, position, nodal, terms=terms, rows=count, first=first)
    else:
        native_only = _native_only(engine)
        statics = {"grid": static_grid, "kernel": kernel, "terms": tuple(terms), "native_only": native_only}
        rows = gather_p.bind(position, *([] if first is None else [first]), nodal, rows=count, **statics)
    gradient = rows[values:].reshape(gradients, d, position.shape[-1])
    return rows[:values] if values else None, gradient if gradients else None


def _storage(grid: Grid) -> tuple[Grid, Array | None]:
    """The grid as what shapes a program, and `first` of the nodes that it stores; None for all."""
    if grid.near is None:
        return replace(grid, stored=None), None
    return replace(grid, stored=grid.rows, near=None), grid.near.first


def _acting(i: int, j: int, dimension: int) -> int:
    """Index of the stress component (i, j) among those that act on a grid of this dimension."""
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
    if engine is Engine.NATIVE and not (cuda.library() or native.available()):
        raise ValueError("Engine.NATIVE was not built: install a C++ compiler and jaxmpm again, or take Engine.XLA")
    return engine is Engine.NATIVE
