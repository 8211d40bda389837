"""The engine for CUDA GPUs against XLA's on one card. `benchmarks/speed/on_gpu.sh` builds it, tests it, and runs this.

Errors are over the largest value, against float64. A step is that of a slope that slides. Its time is the
median of five chunks. `order` is the share of the sort that makes sums independent of the batch and of the run.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np

import jaxmpm as mpm
from benchmarks.speed.throughput import DEFAULT, REFINED, ROUGH, SECTION
from benchmarks.speed.throughput_case import Case, measure
from jaxmpm import Engine
from jaxmpm.equations import grid_position
from jaxmpm.run import objectives
from jaxmpm.transfer import cell_sums, g2p, p2g
from jaxmpm.transfer.native import cuda

STEPS: dict[str, dict[str, Any]] = {
    "refined": REFINED,
    "rough, 64 lanes": ROUGH | {"batch": 64},
    "section, 256 lanes": SECTION | {"batch": 256},
    "refined, default settings": REFINED | DEFAULT,
    "rough": ROUGH,
    "section": SECTION,
    "refined, float64": REFINED | {"dtype": "float64"},
}
# What is promised of a step beside XLA's, by issue; the others are shown.
AT_MOST = {"refined": 0.55, "rough, 64 lanes": 0.6, "section, 256 lanes": 1.0}
ENGINES = {"CUDA": None, "XLA": Engine.XLA}


def microseconds(run: Callable[[jax.Array], jax.Array], position: jax.Array, calls: int = 50) -> float:
    """Time of one call among many in one program, each of which waits for the one before."""

    @jax.jit
    def many(position: jax.Array) -> jax.Array:
        def after(_: jax.Array, x: jax.Array) -> jax.Array:
            return x + 0 * jax.lax.optimization_barrier(run(x)).ravel()[0]

        return jax.lax.fori_loop(0, calls, after, position)

    jax.block_until_ready(many(position))
    spent = []
    for _ in range(5):
        start = time.perf_counter()
        jax.block_until_ready(many(position))
        spent.append(time.perf_counter() - start)
    return 1e6 * sorted(spent)[2] / calls


def transfers() -> Iterator[dict[str, Any]]:
    """Each transfer of a step of the published refined slope alone: time on both engines, error against float64."""
    scene, state = Case(**STEPS["refined"]).build()
    grid, kernel, position = scene.grid, scene.numerics.kernel, grid_position(scene, state)
    rng, n, d = np.random.default_rng(0), state.velocity.shape[1], grid.dimension
    carried, stress = (jnp.asarray(rng.normal(size=(k, n)), jnp.float32) for k in (1 + d, d * (d + 1) // 2))
    nodal = jnp.asarray(rng.normal(size=(grid.nodes, 2 * d)), jnp.float32)
    cell = jnp.ravel_multi_index(tuple((position / grid.cell).astype(jnp.int32)), grid.shape, mode="clip")
    cell = cell.astype(jnp.int32)
    runs: dict[str, Callable[..., Any]] = {
        "p2g, 7 channels": lambda x, q, s, _, **e: p2g(grid, kernel, x, q, s, **e),
        "p2g, 3 channels": lambda x, q, s, _, **e: p2g(grid, kernel, x, q[:d], None, **e),
        "g2p, 6 values": lambda x, q, s, f, **e: g2p(grid, kernel, x, f, values=2 * d, gradients=0, **e)[0],
        "g2p, 3 gradients": lambda x, q, s, f, **e: g2p(grid, kernel, x, f, values=0, gradients=d, **e)[1],
        "cell sums, 2 rows": lambda x, q, s, f, **e: cell_sums(cell, q[:2] + 0 * x[:1], cells=grid.nodes, **e),
    }
    values = (carried, stress, nodal)
    for name, run in runs.items():
        row: dict[str, Any] = {"transfer": name, "particles": n}
        with jax.enable_x64(True):
            exact = [jnp.asarray(a, jnp.float64) for a in (position, *values)]
            expected = np.asarray(jax.jit(partial(run, engine=Engine.XLA))(*exact))
        for label, engine in ENGINES.items():
            on = partial(run, engine=engine)
            error = np.abs(np.asarray(jax.jit(on)(position, *values)) - expected).max() / np.abs(expected).max()

            def alone(x: jax.Array, on: Callable[..., Any] = on) -> Any:
                return on(x, *values)

            row |= {f"{label}_us": round(microseconds(alone, position), 1)}
            row |= {f"{label}_error": float(f"{error:.2e}")}
        yield row | {"ratio": round(row["CUDA_us"] / row["XLA_us"], 3)}
    if cuda.available():
        spent = microseconds(lambda x: cuda._order(grid, x[None])[0].astype(x.dtype), position)
        yield {"transfer": "order", "particles": n, "CUDA_us": round(spent, 1)}


def steps(names: list[str], seconds: float) -> Iterator[dict[str, Any]]:
    """Steps on both engines, in one process."""
    for name in names:
        row: dict[str, Any] = {"step": name}
        for label, engine in ENGINES.items():
            jax.config.update("jax_enable_x64", STEPS[name].get("dtype") == "float64")
            case = Case(**STEPS[name], engine=None if engine is None else engine.name, seconds=seconds, repeats=5)
            try:
                result = measure(case)
            except Exception as fault:  # one case that fails leaves the others
                row |= {f"{label}_failed": str(fault)[:200]}
                continue
            particles = result["particles"] * case.batch
            us = result["us"][len(result["us"]) // 2]
            row |= {"particles": particles, f"{label}_us": round(us * particles, 1), f"{label}_ns": round(1e3 * us, 3)}
            row |= {f"{label}_compile_s": round(result["compile_s"], 1)}
            # Of the process so far, so that only the first case tells what it takes.
            row |= {f"{label}_peak_mb": round(result["peak_mb"])}
            jax.clear_caches()
        jax.config.update("jax_enable_x64", False)
        if "XLA_us" in row and "CUDA_us" in row:
            row |= {"ratio": round(row["CUDA_us"] / row["XLA_us"], 3), "at_most": AT_MOST.get(name)}
        yield row


def gradients() -> Iterator[dict[str, Any]]:
    """Value and gradient by strength of the rough slope's displacement after 100 steps, over the forward run."""
    built, state = Case(**STEPS["rough"]).build()
    strength = jnp.broadcast_to(built.material.strength, built.particles.mass.shape)
    found = {}
    for label, engine in ENGINES.items():
        scene = replace(built, numerics=replace(built.numerics, engine=engine))

        def reached(strength: jax.Array, scene: mpm.Scene = scene) -> jax.Array:
            varied = replace(scene, material=replace(scene.material, strength=strength))
            return objectives.log_displacement(mpm.replay(varied, state, 100, memory=2e9)[0])

        row: dict[str, Any] = {"gradient": "rough, 100 steps", "engine": label}
        for name, run in (("forward", jax.jit(reached)), ("both", jax.jit(jax.value_and_grad(reached)))):
            result = jax.block_until_ready(run(strength))
            spent = []
            for _ in range(5):
                start = time.perf_counter()
                jax.block_until_ready(run(strength))
                spent.append(time.perf_counter() - start)
            row |= {f"{name}_us": round(1e4 * sorted(spent)[2], 1)}
        found[label] = np.asarray(result[1])
        row |= {"over_forward": round(row["both_us"] / row["forward_us"], 2), "at_most": 3.5}
        row |= {"repeats": bool(np.array_equal(found[label], run(strength)[1]))}
        if len(found) == len(ENGINES):
            apart = np.abs(found["CUDA"] - found["XLA"]).max() / np.abs(found["XLA"]).max()
            row |= {"engines_apart": float(f"{apart:.2e}")}
        yield row


def terrain(length: int = 120, width: int = 60) -> tuple[mpm.Scene, mpm.State]:
    """Soil 4 m deep on steep bedrock, in cells of 1 m, whose grid stores the nodes near it alone."""
    slope = np.add.outer(-0.7 * np.arange(0.0, length + 1), np.zeros(width + 1))
    rock = mpm.Raster(slope, (0.0, 0.0), 1.0)
    ground = mpm.Terrain(replace(rock, heights=slope + 4.0), base=float(slope.min() - 4), bedrock=rock)
    soil = mpm.Soil(strength=20e3, softening_modulus=50e3, tension_cutoff=0.0)
    scene, state = mpm.terrain(ground, soil, mpm.Discretisation(1.0, (0.5,) * 3), at_rest=False, speed=20.0)
    return mpm.follow_soil(scene), state


def repeats() -> Iterator[dict[str, Any]]:
    """Whether states after 200 steps are equal bit for bit: run again, and among other lanes; time of a step."""
    for name, (built, state) in (("rough", Case(**STEPS["rough"]).build()), ("terrain, nodes near soil", terrain())):
        yield from (_repeats(name, label, built, state) for label in ENGINES)


def _repeats(name: str, label: str, built: mpm.Scene, state: mpm.State, steps: int = 200) -> dict[str, Any]:
    scene = replace(built, numerics=replace(built.numerics, engine=ENGINES[label]))
    advance = jax.jit(lambda scene, state: mpm.advance(scene, state, jnp.asarray(steps)))
    strength = scene.material.strength * jnp.array([1.0, 0.8, 1.2])[:, None] * jnp.ones(state.velocity.shape[1])

    def one(strength: jax.Array) -> mpm.State:
        varied = replace(scene, material=replace(scene.material, strength=strength))
        return cast(mpm.State, advance(varied, state))

    def equal(a: mpm.State, b: mpm.State) -> bool:
        pairs = zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True)
        return all(np.array_equal(np.asarray(x), np.asarray(y)) for x, y in pairs)

    first = jax.block_until_ready(one(strength[0]))
    start = time.perf_counter()
    again = jax.block_until_ready(one(strength[0]))
    spent = time.perf_counter() - start
    lanes = jax.vmap(one)(strength)
    return {
        "repeats": f"{name}, {steps} steps",
        "engine": label,
        "particles": state.velocity.shape[1],
        "step_us": round(1e6 * spent / steps, 1),
        "run_again": equal(first, again),
        "in_a_batch": equal(first, jax.tree.map(lambda a: a[0], lanes)),
        "apart_in_a_batch_m": float(jnp.abs(first.displacement - lanes.displacement[0]).max()),
    }


def main() -> None:
    """Rows as JSON, one a line, as they come."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, help="file that the rows are added to")
    parser.add_argument("--seconds", type=float, default=0.2, help="of a chunk of steps")
    parser.add_argument("--parts", default="transfers,steps,gradients,repeats")
    parser.add_argument("--steps", default=";".join(STEPS), help="names of steps, with semicolons between them")
    arguments = parser.parse_args()
    parts = {
        "transfers": transfers,
        "steps": lambda: steps(arguments.steps.split(";"), arguments.seconds),
        "gradients": gradients,
        "repeats": repeats,
    }
    card = jax.devices()[0].device_kind
    for part in arguments.parts.split(","):
        for row in parts[part]():
            line = json.dumps({"card": card, "jax": jax.__version__, **row})
            print(line, flush=True)
            if arguments.out is not None:
                with arguments.out.open("a") as rows:
                    rows.write(line + "\n")


if __name__ == "__main__":
    main()
