"""What the Frank slide costs with nodes near its soil alone, or with all: `python -m benchmarks.public.frank_cost ...`.

Arguments are the folder of the data, the cells (m), and "near" or "all". Prints JSON: CPU seconds of the set-up with
the stress at rest, CPU microseconds of a step, and the largest resident set of the process (MB).
"""

from __future__ import annotations

import json
import sys
import time
import warnings
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp

import jaxmpm as mpm
from benchmarks.measure import peak_memory_mb, timed
from benchmarks.public import frank

DELTA, STEPS = 10, 50


def cost(data: Path, cell: float, nodes: str) -> dict[str, float]:
    """The figures of one process."""
    start = time.process_time()
    scene, state = frank.built(*frank.published(data), DELTA, cell, at_rest=False)
    if nodes == "all":
        scene = replace(scene, grid=replace(scene.grid, stored=None))
    state = mpm.at_rest(scene)
    jax.block_until_ready(state)
    built = time.process_time() - start
    advance = jax.jit(mpm.advance)

    def steps() -> None:
        jax.block_until_ready(advance(scene, state, jnp.asarray(STEPS)))

    spent = timed(steps, clock=time.process_time)
    return {"setup_cpu_s": built, "step_us": spent.median / STEPS * 1e6, "peak_mb": peak_memory_mb()}


if __name__ == "__main__":
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        print(json.dumps(cost(Path(sys.argv[1]), float(sys.argv[2]), sys.argv[3])))
