"""The native engine: locates the compiled library, registers its kernels with XLA, and calls them.

The library is optional. Without it, or on a machine that runs none of its instruction sets, `available()` is False and
transfers run on XLA.
"""

from __future__ import annotations

import ctypes
import functools
import itertools
import math
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmpm.grid import Grid
from jaxmpm.protocols import Kernel
from jaxmpm.transfer._shape import GIMP, Linear, QuadraticBSpline
from jaxmpm.transfer._stencil import Term, rows_of_grid

LIBRARY = "libjaxmpm_transfer.so"
FUNCTIONS = {Linear: 0, GIMP: 1, QuadraticBSpline: 2}
TARGETS = ("jaxmpm_scatter", "jaxmpm_gather", "jaxmpm_contract", "jaxmpm_near", "jaxmpm_cell_sums")
MAX_CHANNELS = 8
MAX_ORDER = 2
T = TypeVar("T")


def library() -> Path | None:
    """Path of the compiled kernels; None if they were not built."""
    return next((path for folder in __path__ if (path := Path(folder) / LIBRARY).exists()), None)


@functools.cache
def available() -> bool:
    """Register the compiled kernels and return whether this machine runs them; warn once if it does not.

    Raises:
        ImportError: The library lacks a kernel, since it was built from other sources.
    """
    path = library()
    if path is not None and instructions() is not None:
        kernels = _loaded(path)
        for name in TARGETS:
            jax.ffi.register_ffi_target(name, jax.ffi.pycapsule(getattr(kernels, name)), platform="cpu")
        return True
    fault, remedy = (
        ("was not built", "Install a C++ compiler and install jaxmpm again.")
        if path is None
        else ("was built for another processor", "Install jaxmpm again on this machine, or from a wheel.")
    )
    warnings.warn(
        f"{LIBRARY} {fault}: particle-grid transfers run on XLA, at some fortieth of the speed on CPU. {remedy}",
        stacklevel=2,
    )
    return False


def instructions() -> str | None:
    """Name of the instruction set that the compiled kernels use: the best that they have and this machine runs.

    Returns:
        The name; None if they were not built, or for other processors alone.

    Raises:
        ImportError: The library lacks a kernel, since it was built from other sources.
    """
    path = library()
    if path is None:
        return None
    function = _loaded(path).jaxmpm_instructions
    function.restype = ctypes.c_char_p
    name: bytes | None = function()
    return None if name is None else name.decode()


def _loaded(path: Path) -> ctypes.CDLL:
    kernels = ctypes.CDLL(str(path))
    if missing := [name for name in (*TARGETS, "jaxmpm_instructions") if not hasattr(kernels, name)]:
        lacking = ", ".join(missing)
        raise ImportError(f"{LIBRARY} lacks {lacking}: it was built from other sources, install jaxmpm again")
    return kernels


def supports(kernel: Kernel, position: Array, terms: Sequence[Term]) -> bool:
    """Whether there is native code for a kernel, a precision and derivatives.

    Args:
        kernel: shape functions.
        position: its dtype is the precision.
        terms: of the transfer.

    Returns:
        Whether there is.
    """
    supported = type(kernel) in FUNCTIONS
    return (
        supported
        and position.dtype in (jnp.float32, jnp.float64)
        and all(len(term.axes) <= MAX_ORDER for term in terms)
    )


def scatter(
    grid: Grid,
    kernel: Kernel,
    position: Array,
    blocks: Sequence[Array],
    *,
    terms: Sequence[Term],
    channels: int,
    first: Array | None = None,
) -> Array:
    """As `jaxmpm.transfer._stencil.scatter`, for blocks of rows and lanes.

    Args:
        grid: of the nodes.
        kernel: shape functions.
        position: (..., d, N) m, leading axes of length 1 if lanes share it.
        blocks: arrays (..., r, N), likewise.
        terms: of the transfer.
        channels: number of channels.
        first: (..., 1, columns) as of `NearNodes`, likewise; None for a grid that stores all nodes.

    Returns:
        (..., nodes, channels).
    """
    arrays = (position, *optional(first), *blocks)
    batch = np.broadcast_shapes(*(a.shape[:-2] for a in arrays))
    parts = []
    for channel in range(0, channels, MAX_CHANNELS):
        count = min(channels - channel, MAX_CHANNELS)
        result = jax.ShapeDtypeStruct((*batch, rows_of_grid(grid), width(count)), position.dtype)
        call = jax.ffi.ffi_call("jaxmpm_scatter", result)
        parts.append(call(*arrays, **attributes(grid, kernel, _shifted(terms, channel, count)))[..., :count])
    return parts[0] if len(parts) == 1 else jnp.concatenate(parts, axis=-1)


def gather(
    grid: Grid,
    kernel: Kernel,
    position: Array,
    nodal: Array,
    *,
    terms: Sequence[Term],
    rows: int,
    first: Array | None = None,
) -> Array:
    """As `jaxmpm.transfer._stencil.gather`, for lanes.

    Args:
        grid: of the nodes.
        kernel: shape functions.
        position: (..., d, N) m, leading axes of length 1 if lanes share it.
        nodal: (..., nodes, channels), likewise.
        terms: of the transfer.
        rows: number of rows.
        first: as of `scatter`.

    Returns:
        (..., rows, N).
    """
    batch = np.broadcast_shapes(*(a.shape[:-2] for a in (position, nodal, *optional(first))))
    result = jax.ShapeDtypeStruct((*batch, rows, position.shape[-1]), position.dtype)
    call = jax.ffi.ffi_call("jaxmpm_gather", result)
    return _by_channels(call, grid, kernel, (position, nodal, *optional(first)), terms)


def contract(
    grid: Grid,
    kernel: Kernel,
    position: Array,
    nodal: Array,
    blocks: Sequence[Array],
    *,
    terms: Sequence[Term],
    rows: int,
    first: Array | None = None,
) -> Sequence[Array]:
    """Derivative along the position of the sum of given rows times the result of `gather` for them.

    Args:
        grid: of the nodes.
        kernel: shape functions.
        position: (..., d, N) m, leading axes of length 1 if lanes share it.
        nodal: (..., nodes, channels), likewise.
        blocks: arrays (..., r, N) of rows, likewise.
        terms: of the transfer.
        rows: number of rows of `gather` to return, or 0.
        first: as of `scatter`.

    Returns:
        Derivative (..., d, N), and the result of `gather` (..., rows, N).
    """
    arrays = (position, nodal, *optional(first), *blocks)
    batch = np.broadcast_shapes(*(a.shape[:-2] for a in arrays))
    results = [
        jax.ShapeDtypeStruct((*batch, count, position.shape[-1]), position.dtype) for count in (grid.dimension, rows)
    ]
    call = jax.ffi.ffi_call("jaxmpm_contract", results)
    return _by_channels(call, grid, kernel, arrays, terms)


def near_nodes(grid: Grid, position: Array) -> Sequence[Array]:
    """As `jaxmpm.transfer._near.near_nodes`, for lanes.

    Args:
        grid: with a number of stored nodes.
        position: (..., d, N) m.

    Returns:
        `first` (..., 1, columns), `node` (..., 1, rows) and `needed` (..., 1, 1) of `NearNodes`.
    """
    columns, batch = math.prod(grid.shape[:-1]), position.shape[:-2]
    results = [jax.ShapeDtypeStruct((*batch, 1, n), jnp.int32) for n in (columns, rows_of_grid(grid), 1)]
    found: Sequence[Array] = jax.ffi.ffi_call("jaxmpm_near", results)(position, **attributes_of(grid))
    return found


def cell_sums(cell: Array, values: Array, *, cells: int) -> Array:
    """As `jaxmpm.transfer._cells.cell_sums`, for lanes.

    Args:
        cell: (..., 1, N) int32 numbers, leading axes of length 1 if lanes share it.
        values: (..., c, N), likewise.
        cells: number of cells.

    Returns:
        (..., c, N).
    """
    batch = np.broadcast_shapes(cell.shape[:-2], values.shape[:-2])
    result = jax.ShapeDtypeStruct((*batch, *values.shape[-2:]), values.dtype)
    return jax.ffi.ffi_call("jaxmpm_cell_sums", result)(cell, values, cells=np.int64(cells))


def _by_channels(
    call: Callable[..., T], grid: Grid, kernel: Kernel, arrays: Sequence[Array], terms: Sequence[Term]
) -> T:
    """Sum of a kernel's results over groups of channels of the nodes, its second array, as large as it takes."""
    position, nodal, *others = arrays
    parts = []
    for first in range(0, nodal.shape[-1], MAX_CHANNELS):
        count = min(nodal.shape[-1] - first, MAX_CHANNELS)
        met = 1 + max((t.channel for t in _shifted(terms, first, count)), default=0)
        # A kernel takes nodes of no more channels than its width.
        count = count if width(met) == width(count) else met
        part = nodal if count == nodal.shape[-1] else nodal[..., first : first + count]
        parts.append(call(position, part, *others, **attributes(grid, kernel, _shifted(terms, first, count))))
    return functools.reduce(functools.partial(jax.tree.map, jnp.add), parts)


def optional(first: Array | None) -> tuple[Array, ...]:
    """The array, where a transfer has it."""
    return () if first is None else (first,)


def width(channels: int) -> int:
    """Channels that the kernel for so many works on at once."""
    return 4 if channels <= 4 else MAX_CHANNELS


def _shifted(terms: Sequence[Term], first: int, count: int) -> list[Term]:
    """The terms of channels first .. first + count - 1, these numbered from 0."""
    return [t._replace(channel=t.channel - first) for t in terms if first <= t.channel < first + count]


def attributes_of(grid: Grid) -> dict[str, np.ndarray | np.generic]:
    """What a kernel is told of a grid."""
    return {
        "shape": np.array(grid.shape, np.int64),
        "origin": np.array(grid.origin, np.float64),
        "cell": np.float64(grid.cell),
    }


def attributes(grid: Grid, kernel: Kernel, terms: Sequence[Term]) -> dict[str, np.ndarray | np.generic]:
    """What a kernel is told of a transfer."""
    d = grid.dimension
    axes = [axes for order in range(MAX_ORDER + 1) for axes in itertools.combinations_with_replacement(range(d), order)]
    half = kernel.half_size if isinstance(kernel, GIMP) else (0.0,) * d
    numbers = [(t.row, t.channel, axes.index(t.axes), t.factor) for t in terms]
    return attributes_of(grid) | {
        "function": np.int64(FUNCTIONS[type(kernel)]),
        "half": np.array([h / grid.cell for h in half], np.float64),
        "terms": np.array(numbers, np.int64).reshape(-1),
        "stored": np.int64(grid.stored or 0),
    }
