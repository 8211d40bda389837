"""Each kernel of the engine once, for compute-sanitizer: two lanes in 2D and 3D, on all nodes and on those near soil.

The calls are no program: each array, scratch too, is an allocation of its own, which no other hides the end of. That
takes `XLA_PYTHON_CLIENT_ALLOCATOR=platform`.
"""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

import jaxmpm as mpm
from jaxmpm.transfer._near import columns_of, near_nodes
from jaxmpm.transfer._primitives import ENGINES
from jaxmpm.transfer._stencil import Term

LANES, PARTICLES = 2, 500


def main() -> None:
    """Call the engine of this device. Raises ImportError where it was not built."""
    engine = ENGINES["cuda" if jax.default_backend() == "gpu" else "cpu"]
    if not engine.available():
        raise ImportError(f"{engine.LIBRARY} was not built, or does not run here")
    for d in (2, 3):
        rng, all_nodes = np.random.default_rng(d), mpm.Grid((14, 9, 20)[-d:], 1.0, (0.0,) * d)
        position, rows = (jnp.asarray(rng.uniform(1, 6, (LANES, k, PARTICLES)), jnp.float32) for k in (d, 1 + d))
        needed = max(int(columns_of(all_nodes, lane)[1].sum()) for lane in position)
        near_soil = replace(all_nodes, stored=needed + 5)
        first = jnp.stack([near_nodes(near_soil, lane, engine=mpm.Engine.XLA).first for lane in position])
        kernel, cell = mpm.GIMP((0.25,) * d), (position[:, -1:] * 3).astype(jnp.int32)
        terms = [Term(0, 0), *(Term(1 + i, 1 + i, (i,), -1) for i in range(d))]
        for grid, stored in ((all_nodes, {}), (near_soil, {"first": first})):
            nodal = engine.scatter(grid, kernel, position, [rows], terms=terms, channels=1 + d, **stored)
            read = engine.gather(grid, kernel, position, nodal, terms=terms, rows=1 + d, **stored)
            both = engine.contract(grid, kernel, position, nodal, [rows], terms=terms, rows=1 + d, **stored)
            sums = engine.cell_sums(cell, rows, cells=20)
            finite = all(bool(jnp.isfinite(a).all()) for a in (nodal, read, *both, sums))
            print(f"{d}D, {'near soil' if stored else 'all nodes'}: {'finite' if finite else 'NOT FINITE'}", flush=True)


if __name__ == "__main__":
    main()
