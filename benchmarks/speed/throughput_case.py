"""One case of the throughput benchmark, in a process of its own: `python -m benchmarks.speed.throughput_case '{...}'`.

Prints JSON: microseconds per particle and step of each repeat, seconds to compile, largest resident set.
"""

from __future__ import annotations

import json
import sys
import time
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp

from benchmarks.measure import peak_memory_mb, scene_campaign
from jaxmpm import Engine, Scene, Scheme, State, reduced
from jaxmpm.run import advance_lanes, lanes, repeat

# The slope is made to slide, so that the plastic branches do their work.
REDUCTION = 1.3


@dataclass(frozen=True)
class Case:
    """What to run: a scene and grid of benchmarks/scenes, how many lanes of it, and how."""

    scene: str = "paper"
    grid: str = "rough"
    scheme: str = "MUSL"
    dtype: str = "float32"
    engine: str | None = None
    batch: int = 1
    repeats: int = 7
    seconds: float = 0.7

    def build(self) -> tuple[Scene, State]:
        """Scene and initial state of one lane."""
        campaign = scene_campaign(self.scene)
        numerics, scheme = campaign.grids[self.grid], Scheme[self.scheme]
        # USL is stable up to 0.72.
        cfl = min(numerics.cfl, 0.7) if scheme is Scheme.USL else numerics.cfl
        numerics = replace(numerics, scheme=scheme, cfl=cfl, dtype=self.dtype)
        scene, state = campaign.site.built(campaign.soil, numerics, campaign.run.gravity, at_rest=True)
        engine = None if self.engine is None else Engine[self.engine]
        return reduced(replace(scene, numerics=replace(scene.numerics, engine=engine)), REDUCTION), state


def measure(case: Case, built: tuple[Scene, State] | None = None) -> dict[str, Any]:
    """Time chunks of steps of about `seconds` each, of the case's scene or of one that was built."""
    scene, state = built or case.build()
    particles, axes = scene.particles.mass.size, None
    if case.batch > 1:
        strength = jnp.broadcast_to(scene.material.strength, (case.batch, particles))
        scene, axes = lanes(scene, strength=strength)
        state = repeat(state, case.batch)
    advance = partial(advance_lanes, scene, axes=axes)

    def timed(state: State, steps: int) -> tuple[State, float]:
        start = time.perf_counter()
        state = jax.block_until_ready(advance(state, jnp.asarray(steps)))
        return state, time.perf_counter() - start

    state = jax.tree.map(jnp.copy, state)
    state, first = timed(state, 2)
    state, second = timed(state, 4)
    steps = max(2, round(case.seconds * 4 / second))
    spent = []
    for _ in range(case.repeats):
        state, seconds = timed(state, steps)
        spent.append(seconds / steps / particles / case.batch * 1e6)
    return {
        "us": sorted(spent),
        "particles": particles,
        "steps": steps,
        "compile_s": first - second / 2,
        "peak_mb": peak_memory_mb(),
        "running": bool(jnp.all(state.status == 0)),
        "device": jax.devices()[0].device_kind,
    }


if __name__ == "__main__":
    case = Case(**json.loads(sys.argv[1]))
    jax.config.update("jax_enable_x64", case.dtype == "float64")
    print(json.dumps(measure(case)))
