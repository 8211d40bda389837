"""Each kernel of the engine once, for compute-sanitizer: two lanes in 2D and 3D, on all nodes and on those near soil.

In float32 and float64. Columns are long enough to be summed by several warps, which share memory.

The calls are no program: each array, scratch too, is an allocation of its own, which no other hides the end of. That
takes `XLA_PYTHON_CLIENT_ALLOCATOR=platform`.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxmpm as mpm
from jaxmpm.transfer._near import columns_of, near_nodes
from jaxmpm.transfer._primitives import ENGINES
from jaxmpm.transfer._stencil import Term

LANES, PARTICLES, CHANNELS = 2, 500, 8
PLAIN = [Term(channel, channel) for channel in range(CHANNELS)]


def main() -> None:
    """Call the engine of this device. Raises ImportError where it was not built."""
    engine = ENGINES["cuda" if jax.default_backend() == "gpu" else "cpu"]
    if not engine.available():
        raise ImportError(f"{engine.LIBRARY} was not built, or does not run here")
    for d, dtype in itertools.product((2, 3), ("float32", "float64")):
        with jax.enable_x64(dtype == "float64"):
            for where, finite in calls(engine, d, dtype):
                print(f"{d}D, {dtype}, {where}: {'finite' if finite else 'NOT FINITE'}", flush=True)


def calls(engine: Any, d: int, dtype: str) -> Iterator[tuple[str, bool]]:
    """Where the kernels of a dimension and dtype were called, and whether all that they gave is finite."""
    rng, shape = np.random.default_rng(d), (14, 9, 70)[-d:]
    all_nodes = mpm.Grid(shape, 1.0, (0.0,) * d)
    spread = np.array([5.0] * (d - 1) + [shape[-1] - 4.0])[:, None]
    position = jnp.asarray(1 + spread * rng.uniform(size=(LANES, d, PARTICLES)), dtype)
    rows = jnp.asarray(rng.normal(size=(LANES, CHANNELS, PARTICLES)), dtype)
    needed = max(int(columns_of(all_nodes, lane)[1].sum()) for lane in position)
    near_soil = replace(all_nodes, stored=needed + 5)
    first = jnp.stack([near_nodes(near_soil, lane, engine=mpm.Engine.XLA).first for lane in position])
    kernel, cell = mpm.GIMP((0.25,) * d), (position[:, -1:] / 4).astype(jnp.int32)
    yield "cells", _finite(engine.cell_sums(cell, rows, cells=20))
    derived = [Term(0, 0), *(Term(1 + i, 1 + i, (i,), -1) for i in range(d))]
    for terms, (grid, stored) in itertools.product((PLAIN, derived), ((all_nodes, {}), (near_soil, {"first": first}))):
        count, given = len(terms), rows[:, : len(terms)]
        nodal = engine.scatter(grid, kernel, position, [given], terms=terms, channels=count, **stored)
        read = engine.gather(grid, kernel, position, nodal, terms=terms, rows=count, **stored)
        both = engine.contract(grid, kernel, position, nodal, [given], terms=terms, rows=count, **stored)
        yield f"{count} channels, {'near soil' if stored else 'all nodes'}", _finite(nodal, read, *both)


def _finite(*arrays: jax.Array) -> bool:
    return all(bool(jnp.isfinite(a).all()) for a in arrays)


if __name__ == "__main__":
    main()
