"""The native engine on CUDA GPUs: locates its library, registers its kernels with XLA, and calls them.

Sums are the same from run to run and for any number of lanes: particles are put in the order of their stencils
(`_order`) and summed in that order. XLA drops all but one of equal orders in a program, so that the transfers of a step
share one.

The library is optional, as that for CPU is. It is built where `nvcc` and a CUDA plugin of JAX are installed.
"""

from __future__ import annotations

import ctypes
import functools
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
from jaxmpm.transfer import native
from jaxmpm.transfer._stencil import Term, rows_of_grid

LIBRARY = "libjaxmpm_cuda.so"
TARGETS = tuple(f"jaxmpm_cuda_{name}" for name in ("order", "scatter", "gather", "contract", "cell_sums"))
PLATFORM = "CUDA"
MAX_BLOCKS = 16
FOUR = 4
"""Channels that a kernel works on together. It takes so many where weights are derived twice, else twice as many."""
T = TypeVar("T")


def library() -> Path | None:
    """Path of the compiled kernels; None if they were not built."""
    return next((path for folder in native.__path__ if (path := Path(folder) / LIBRARY).exists()), None)


@functools.cache
def available() -> bool:
    """Register the compiled kernels and return whether the GPU runs them; warn once if it does not.

    Raises:
        ImportError: The library lacks a kernel, since it was built from other sources.
    """
    path = library()
    if path is None:
        return False
    if (reason := fault()) is not None:
        warnings.warn(
            f"{LIBRARY} does not run on this GPU ({reason}): particle-grid transfers run on XLA, at a third of the "
            "speed. Install jaxmpm again on this machine.",
            stacklevel=2,
        )
        return False
    for name in TARGETS:
        jax.ffi.register_ffi_target(name, jax.ffi.pycapsule(getattr(_loaded(path), name)), platform=PLATFORM)
    return True


def fault() -> str | None:
    """Why the GPU of this process does not run the compiled kernels; None if it does, or if they were not built."""
    path = library()
    if path is None:
        return None
    reason: bytes | None = _loaded(path).jaxmpm_cuda_fault(jax.local_devices()[0].local_hardware_id)
    return None if reason is None else reason.decode()


def _loaded(path: Path) -> ctypes.CDLL:
    kernels = ctypes.CDLL(str(path))
    helpers = {
        "jaxmpm_cuda_copies": (ctypes.c_int32, [ctypes.c_int32, ctypes.c_int64, ctypes.c_bool]),
        "jaxmpm_cuda_bytes_to_order": (ctypes.c_int64, [ctypes.c_int64, ctypes.c_int64]),
        "jaxmpm_cuda_fault": (ctypes.c_char_p, [ctypes.c_int32]),
    }
    if missing := [name for name in (*TARGETS, *helpers) if not hasattr(kernels, name)]:
        lacking = ", ".join(missing)
        raise ImportError(f"{LIBRARY} lacks {lacking}: it was built from other sources, install jaxmpm again")
    for name, (result, arguments) in helpers.items():
        function = getattr(kernels, name)
        function.restype, function.argtypes = result, arguments
    return kernels


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
    """As `jaxmpm.transfer.native.scatter`."""
    batch, (position, *rest) = _one_batch(position, *native.optional(first), *blocks)
    near, blocks = ([], rest) if first is None else (rest[:1], rest[1:])
    if len(blocks) > MAX_BLOCKS:
        lanes = max(len(block) for block in blocks)
        blocks = [jnp.concatenate([jnp.broadcast_to(b, (lanes, *b.shape[1:])) for b in blocks], axis=1)]
    lanes, rows = math.prod(batch), rows_of_grid(grid)
    order = _order(grid, position)
    columns: dict[int, Array] = {}
    for group in _groups(terms, channels):
        shape = (lanes, rows, native.width(len(group)))
        copies = _loaded(_built()).jaxmpm_cuda_copies(grid.dimension, math.prod(shape), bool(near))
        results = [jax.ShapeDtypeStruct(of, position.dtype) for of in (shape, (copies, math.prod(shape)))]
        call = jax.ffi.ffi_call("jaxmpm_cuda_scatter", results)
        nodal, _ = call(position, *order, *near, *blocks, **native.attributes(grid, kernel, _renumbered(terms, group)))
        if group == list(range(channels)):
            return nodal[..., :channels].reshape(*batch, rows, channels)
        columns |= {channel: nodal[..., i : i + 1] for i, channel in enumerate(group) if channel is not None}
    nodal = jnp.concatenate([columns[channel] for channel in range(channels)], axis=-1)
    return nodal.reshape(*batch, rows, channels)


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
    """As `jaxmpm.transfer.native.gather`."""
    batch, arrays = _one_batch(position, nodal, *native.optional(first))
    result = jax.ShapeDtypeStruct((math.prod(batch), rows, position.shape[-1]), position.dtype)
    parts = _by_channels(jax.ffi.ffi_call("jaxmpm_cuda_gather", result), grid, kernel, arrays, terms, terms)
    return functools.reduce(jnp.add, parts).reshape(*batch, *result.shape[1:])


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
    """As `jaxmpm.transfer.native.contract`."""
    batch, arrays = _one_batch(position, nodal, *native.optional(first), *blocks)
    lanes = math.prod(batch)
    results = [jax.ShapeDtypeStruct((lanes, n, position.shape[-1]), position.dtype) for n in (grid.dimension, rows)]
    call = jax.ffi.ffi_call("jaxmpm_cuda_contract", results)
    derived = [t._replace(axes=(*t.axes, 0)) for t in terms]
    parts = _by_channels(call, grid, kernel, arrays, terms, derived)
    summed = functools.reduce(functools.partial(jax.tree.map, jnp.add), parts)
    return [a.reshape(*batch, *a.shape[1:]) for a in summed]


def cell_sums(cell: Array, values: Array, *, cells: int) -> Array:
    """As `jaxmpm.transfer.native.cell_sums`."""
    batch, (cell, values) = _one_batch(cell, values)
    results = [jax.ShapeDtypeStruct((math.prod(batch), *values.shape[1:]), values.dtype), _scratch(cell, cells)]
    sums, _ = jax.ffi.ffi_call("jaxmpm_cuda_cell_sums", results)(cell, values, cells=np.int64(cells))
    return sums.reshape(*batch, *sums.shape[1:])


def _order(grid: Grid, position: Array) -> tuple[Array, Array]:
    """Particles (lanes, 1, N) in the order of their stencils, and the place of each node's first one in it."""
    lanes, _, particles = position.shape
    results = [
        jax.ShapeDtypeStruct((lanes, 1, particles), jnp.int32),
        jax.ShapeDtypeStruct((1, 1, lanes * grid.nodes + 1), jnp.int32),
        _scratch(position, grid.nodes),
    ]
    ordered, offsets, _ = jax.ffi.ffi_call("jaxmpm_cuda_order", results)(position, **native.attributes_of(grid))
    return ordered, offsets


def _scratch(array: Array, places: int) -> jax.ShapeDtypeStruct:
    """Memory to put the particles of an array (lanes, rows, N) in the order of so many nodes or cells."""
    lanes, _, particles = array.shape
    size = _loaded(_built()).jaxmpm_cuda_bytes_to_order(lanes * particles, lanes * places)
    return jax.ShapeDtypeStruct((size,), jnp.uint8)


def _built() -> Path:
    path = library()
    if path is None:
        raise ImportError(
            f"{LIBRARY} was not built: install jaxmpm again where nvcc and JAX's CUDA plugin are installed"
        )
    return path


def _one_batch(*arrays: Array) -> tuple[tuple[int, ...], list[Array]]:
    """The batch's axes, and the arrays with one axis in their place, of length 1 where lanes share the array."""
    batch = np.broadcast_shapes(*(a.shape[:-2] for a in arrays))
    flat = [a if all(n == 1 for n in a.shape[:-2]) else jnp.broadcast_to(a, (*batch, *a.shape[-2:])) for a in arrays]
    return batch, [a.reshape(math.prod(a.shape[:-2]), *a.shape[-2:]) for a in flat]


def _groups(terms: Sequence[Term], channels: int) -> list[list[int | None]]:
    """The channels of a scatter by kernel, in the places in which it has them; None for an empty place.

    A kernel works on four channels by all the derivatives that one of them meets. So those that meet weights alone, and
    those that meet derivatives, are in fours of their own where they need two.
    """
    order = _orders(terms)
    plain: list[int | None] = [c for c in range(channels) if order.get(c, 0) == 0]
    derived: list[int | None] = [c for c in range(channels) if order.get(c, 0) > 0]
    if channels <= FOUR:
        return [list(range(channels))]
    groups = []
    while len(plain) > FOUR or (plain and not derived):
        groups.append(plain[: native.MAX_CHANNELS])
        plain = plain[native.MAX_CHANNELS :]
    if max(order.values(), default=0) > 1:
        rest = plain + derived
        return groups + [rest[i : i + FOUR] for i in range(0, len(rest), FOUR)]
    if plain:
        groups.append(plain + [None] * (FOUR - len(plain)) + derived[:FOUR])
        derived = derived[FOUR:]
    return groups + [derived[i : i + native.MAX_CHANNELS] for i in range(0, len(derived), native.MAX_CHANNELS)]


def _by_channels(
    call: Callable[..., T],
    grid: Grid,
    kernel: Kernel,
    arrays: Sequence[Array],
    terms: Sequence[Term],
    derived: Sequence[Term],
) -> list[T]:
    """A kernel's results, to be summed, for groups of channels of the nodes, its second array.

    A kernel takes four channels where their weights, those of the terms `derived`, have second derivatives.
    """
    position, nodal, *rest = arrays
    met = sorted({t.channel for t in terms})
    most = FOUR if max(_orders(derived).values()) > 1 else native.MAX_CHANNELS
    results = []
    for group in (met[i : i + most] for i in range(0, len(met), most)):
        follow = group == list(range(group[0], group[0] + len(group)))
        part = nodal[..., group[0] : group[0] + len(group)] if follow else nodal[..., np.array(group)]
        width = 1 if len(group) == 1 else native.width(len(group))
        part = jnp.pad(part, [(0, 0)] * (part.ndim - 1) + [(0, width - len(group))])
        results.append(call(position, part, *rest, **native.attributes(grid, kernel, _renumbered(terms, group))))
    return results


def _orders(terms: Sequence[Term]) -> dict[int, int]:
    """Highest derivative of the weights that each channel meets."""
    orders: dict[int, int] = {}
    for term in terms:
        orders[term.channel] = max(orders.get(term.channel, 0), len(term.axes))
    return orders


def _renumbered(terms: Sequence[Term], group: Sequence[int | None]) -> list[Term]:
    """The terms of a group of channels, numbered by their places in it."""
    return [t._replace(channel=group.index(t.channel)) for t in terms if t.channel in group]
