"""One timing of reverse mode, in a process of its own: `python -m benchmarks.speed.gradients_case '{...}'`; prints
JSON."""

from __future__ import annotations

import json
import sys
import time
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp

import jaxmpm as mpm
from benchmarks.measure import peak_memory_mb, scene_campaign, timed
from jaxmpm.run import objectives

# The slope is made to slide, so that the plastic branches do their work.
REDUCTION = 1.3


def measure(scene: str, engine: str | None, steps: int, memory: float, repeats: int) -> dict[str, Any]:
    """CPU seconds per particle and step of a forward run, of value and gradient by strength; bytes planned and held."""
    campaign = scene_campaign(scene)
    built, state = campaign.site.built(campaign.soil, campaign.grids["rough"], campaign.run.gravity, at_rest=True)
    numerics = replace(built.numerics, engine=None if engine is None else mpm.Engine[engine])
    built = mpm.reduced(replace(built, numerics=numerics), REDUCTION)
    strength = jnp.broadcast_to(built.material.strength, built.particles.mass.shape)
    particles = strength.size

    def reached(strength: jax.Array) -> jax.Array:
        varied = replace(built, material=replace(built.material, strength=strength))
        return objectives.log_displacement(mpm.replay(varied, state, steps, memory=memory)[0])

    forward, both = jax.jit(reached), jax.jit(jax.value_and_grad(reached))
    result: dict[str, Any] = {
        "levels": list(mpm.run.checkpoints(built, state, steps, memory).levels),
        "particles": particles,
    }
    if repeats:
        for name, run in (("forward", forward), ("value_and_gradient", both)):
            timing = timed(lambda run=run: jax.block_until_ready(run(strength)), repeats, time.process_time)  # type: ignore[misc]
            result[f"{name}_us"] = timing.scaled(1e6 / steps / particles)
    else:
        start = time.process_time()
        gradient = jax.block_until_ready(both(strength))[1]
        result |= {"seconds": time.process_time() - start, "finite": bool(jnp.all(jnp.isfinite(gradient)))}
    return result | {"peak_mb": peak_memory_mb()}


if __name__ == "__main__":
    print(json.dumps(measure(**json.loads(sys.argv[1]))))
