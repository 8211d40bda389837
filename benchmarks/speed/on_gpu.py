"""The engine for CUDA GPUs against XLA's on one card, a part at a time; `benchmarks/speed/on_gpu.sh` runs them all.

Errors are over the largest value. A step is that of a slope that slides, the median of five chunks. Each engine is
asked for by name, so that a library which does not run is an error. `--small` has a CPU run the same on small scenes.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxmpm as mpm
from benchmarks.measure import timed
from benchmarks.robustness.invented import TINY
from benchmarks.speed.campaign import scene_text
from benchmarks.speed.on_gpu_rows import row
from benchmarks.speed.throughput import DEFAULT, REFINED, ROUGH, SECTION
from benchmarks.speed.throughput_case import Case, measure
from cooperative import campaign
from cooperative.doctor import apart, off_kinks, transferred
from jaxmpm import Engine
from jaxmpm.equations import grid_position
from jaxmpm.run import objectives
from jaxmpm.transfer import cell_sums, g2p, p2g
from jaxmpm.transfer.native import cuda

Rows = Iterator[dict[str, Any]]

STEPS: dict[str, dict[str, Any]] = {
    "refined": REFINED,
    "rough, 64 lanes": ROUGH | {"batch": 64},
    "section, 256 lanes": SECTION | {"batch": 256},
    "refined, default settings": REFINED | DEFAULT,
    "rough": ROUGH,
    "section": SECTION,
    "terrain, nodes near soil": {},
    "refined, float64": REFINED | {"dtype": "float64"},
}
GRADIENTS = {"rough": ROUGH, "rough, default settings": ROUGH | DEFAULT}
AT_MOST = {"refined": 0.55, "rough, 64 lanes": 0.6, "section, 256 lanes": 1.0}
"""What is promised of a step over XLA's; the others are shown."""
AGREE = {"float32": 2e-6, "float64": 1e-13}
ENGINES = (Engine.NATIVE, Engine.XLA)


def case_of(name: str, small: bool) -> Case:
    """A case. small: of few lanes of a section, which a CPU runs in seconds."""
    case = Case(**(STEPS | GRADIENTS)[name], seconds=0.02 if small else 0.2, repeats=5)
    section = {"paper": "paper_section", "slope": "section"}.get(case.scene, case.scene)
    return replace(case, scene=section, grid="rough", batch=min(case.batch, 3)) if small else case


def built(name: str, small: bool) -> tuple[mpm.Scene, mpm.State]:
    """The scene of a case, which lanes and engines share, and its state."""
    case = case_of(name, small)
    if "terrain" in name:
        return terrain(24, 12) if small else terrain(120, 60)
    return _scene(case.scene, case.grid, case.dtype)


@cache
def _scene(scene: str, grid: str, dtype: str) -> tuple[mpm.Scene, mpm.State]:
    with jax.enable_x64(dtype == "float64"):
        return Case(scene=scene, grid=grid, dtype=dtype).build()


@cache
def terrain(length: int, width: int) -> tuple[mpm.Scene, mpm.State]:
    """Soil 4 m deep on steep bedrock, in cells of 1 m, whose grid stores the nodes near it alone."""
    slope = np.add.outer(-0.7 * np.arange(0.0, length + 1), np.zeros(width + 1))
    rock = mpm.Raster(slope, (0.0, 0.0), 1.0)
    ground = mpm.Terrain(replace(rock, heights=slope + 4.0), base=float(slope.min() - 4), bedrock=rock)
    soil = mpm.Soil(strength=20e3, softening_modulus=50e3, tension_cutoff=0.0)
    scene, state = mpm.terrain(ground, soil, mpm.Discretisation(1.0, (0.5,) * 3), at_rest=False, speed=20.0)
    return mpm.follow_soil(scene), state


def on(scene: mpm.Scene, engine: Engine) -> mpm.Scene:
    """The scene on an engine."""
    return replace(scene, numerics=replace(scene.numerics, engine=engine))


def seconds(run: Callable[..., Any], *arrays: jax.Array) -> float:
    """Median time of a compiled function."""
    return timed(lambda: jax.block_until_ready(run(*arrays))).median


def arrays_of(scene: mpm.Scene, state: mpm.State) -> tuple[jax.Array, ...]:
    """Position, carried rows, stress and nodal values for transfers of a scene, and the cells of its particles."""
    grid, rng = scene.grid, np.random.default_rng(0)
    d, n = grid.dimension, state.velocity.shape[1]
    origin = np.array(grid.origin)[:, None]
    places = off_kinks(rng, (np.asarray(grid_position(scene, state), float) - origin) / grid.cell)
    cell = np.ravel_multi_index(tuple(places.astype(np.int32)), grid.shape, mode="clip")
    sizes = ((1 + d, n), (d * (d + 1) // 2, n), (grid.nodes, 1 + 2 * d))
    floats = (origin + grid.cell * places, *(rng.normal(size=size) for size in sizes))
    return *(jnp.asarray(a, state.velocity.dtype) for a in floats), jnp.asarray(cell, jnp.int32)


def accuracy(small: bool) -> Rows:
    """Each transfer and its derivative by engine and dtype, in 2D and 3D by all shape functions."""

    @partial(jax.jit, static_argnums=(0, 1, 2))
    def everything(grid: mpm.Grid, kernel: mpm.Kernel, engine: Engine, *arrays: jax.Array) -> dict[str, Any]:
        position, carried, stress, nodal, cell = arrays
        found = transferred(grid, kernel, position, (carried, stress), nodal, engine=engine)
        return found | {"cell sums": cell_sums(cell, carried, cells=grid.nodes, engine=engine)}

    for name in ("section", "terrain, nodes near soil"):
        scene, state = built(name, small)
        grid, (*floats, cell) = scene.grid, arrays_of(scene, state)
        for kernel in (scene.numerics.kernel, mpm.QuadraticBSpline(), mpm.Linear()):
            found = {}
            for dtype in AGREE:
                with jax.enable_x64(dtype == "float64"):
                    arrays = [*(jnp.asarray(np.asarray(a), dtype) for a in floats), cell]
                    for engine in ENGINES:
                        found[dtype, engine] = jax.device_get(everything(grid, kernel, engine, *arrays))
            of = f"{type(kernel).__name__}, {grid.dimension}D"
            exact = found["float64", Engine.XLA]
            for what in exact:
                for dtype, limit in AGREE.items():
                    ours, xla = (found[dtype, engine][what] for engine in ENGINES)
                    yield row(f"{what}, {of}, {dtype}: apart from XLA's", apart(ours, xla), at_most=limit)
                errors = [apart(found["float32", engine][what], exact[what]) for engine in ENGINES]
                yield row(f"{what}, {of}: error against float64", *errors)


def after(steps: int, scene: mpm.Scene, state: mpm.State, strength: jax.Array) -> mpm.State:
    """The state after some steps with these strengths."""
    return mpm.advance(replace(scene, material=replace(scene.material, strength=strength)), state, jnp.asarray(steps))


def repeats(small: bool, steps: int = 200) -> Rows:
    """How many arrays of the state differ by a bit after some steps: run again, and among other lanes."""
    for name in ("rough", "terrain, nodes near soil"):
        scene, state = built(name, small)
        scene = on(scene, Engine.NATIVE)
        strength = scene.material.strength * jnp.array([1.0, 0.8, 1.2])[:, None] * jnp.ones(state.velocity.shape[1])
        one = jax.jit(partial(after, steps, scene, state))
        first, again, lanes = one(strength[0]), one(strength[0]), jax.vmap(one)(strength)
        for what, other in (("run again", again), ("among other lanes", jax.tree.map(lambda a: a[0], lanes))):
            pairs = zip(jax.tree.leaves(first), jax.tree.leaves(other), strict=True)
            differ = sum(not np.array_equal(np.asarray(a), np.asarray(b)) for a, b in pairs)
            yield row(f"{name}, {steps} steps {what}", differ, unit="arrays differ", at_most=0)


def memory(small: bool) -> Rows:
    """Most memory of a process of its own for each engine, at the same time: of steps, and of a gradient."""
    case = case_of("refined", small)
    given = {"scene": case_of("rough", small).scene, "steps": 100, "memory": 2e9, "repeats": 0}
    asked = {
        "refined": ("throughput_case", asdict(case) | {"repeats": 1}),
        "gradient, rough, 100 steps": ("gradients_case", given),
    }

    def peak(module: str, given: dict[str, Any], engine: Engine) -> float:
        command = [sys.executable, "-m", f"benchmarks.speed.{module}", json.dumps(given | {"engine": engine.name})]
        printed = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True).stdout
        return float(json.loads(printed.splitlines()[-1])["peak_mb"])

    with ThreadPoolExecutor() as pool:
        answers = {name: [pool.submit(peak, *what, engine) for engine in ENGINES] for name, what in asked.items()}
        for name, each in answers.items():
            yield row(f"memory, {name}", *(answer.result() for answer in each), unit="MB")


def reached(steps: int, scene: mpm.Scene, state: mpm.State, strength: jax.Array) -> jax.Array:
    """Logarithm of the displacement after some steps with these strengths."""
    varied = replace(scene, material=replace(scene.material, strength=strength))
    return objectives.log_displacement(mpm.replay(varied, state, steps, memory=2e9)[0])


def gradients(small: bool, steps: int = 100) -> Rows:
    """Value and gradient by strength of the displacement after some steps, over the forward run."""
    for name in GRADIENTS:
        scene, state = built(name, small)
        strength = jnp.broadcast_to(scene.material.strength, scene.particles.mass.shape)
        spent, found = [], []
        for engine in ENGINES:
            forward = partial(reached, steps, on(scene, engine), state)
            runs = jax.jit(forward), jax.jit(jax.value_and_grad(forward))
            spent.append([seconds(run, strength) for run in runs])
            found.append([runs[1](strength)[1] for _ in range(2)])
        what, (alone, both) = f"{name}, {steps} steps", zip(*spent, strict=True)
        yield row(f"gradient over forward, {what}", *np.divide(both, alone).tolist(), at_most=3.5)
        yield row(f"gradient, {what}: apart from XLA's", apart(found[0][0], found[1][0]), at_most=1e-5)
        differ = [int(jnp.sum(a != b)) for a, b in found]
        yield row(f"gradient, {what}, run again", *differ, unit="values differ", at_most=0)
        yield row(f"forward, {what}", *(1e6 * each / steps for each in alone), unit="us/step")


def steps(small: bool, names: tuple[str, ...] = tuple(STEPS), how: str = "") -> Rows:
    """Steps on both engines."""
    for name in names:
        try:
            case, (scene, state) = case_of(name, small), built(name, small)
            with jax.enable_x64(case.dtype == "float64"):
                answers = [measure(case, (on(scene, engine), state)) for engine in ENGINES]
            particles = answers[0]["particles"] * case.batch
            us = [answer["us"][len(answer["us"]) // 2] * particles for answer in answers]
            compared = row(f"step, {how}{name}", *us, unit="us", at_most=AT_MOST.get(name), of="ratio")
            yield compared | {"particles": particles}
        except Exception as fault:  # a case that fails leaves the others
            yield {"what": f"step, {how}{name}: {str(fault)[:200]}", "result": "fail"}
        jax.clear_caches()


def microseconds(run: Callable[..., jax.Array], position: jax.Array, *arrays: jax.Array, calls: int = 50) -> float:
    """Time of one call among many in one program, each of which waits for the one before."""

    @jax.jit
    def many(position: jax.Array, *arrays: jax.Array) -> jax.Array:
        def after(_: jax.Array, x: jax.Array) -> jax.Array:
            return x + 0 * jax.lax.optimization_barrier(run(x, *arrays)).ravel()[0]

        return jax.lax.fori_loop(0, calls, after, position)

    return 1e6 * seconds(many, position, *arrays) / calls


def transfers_of(grid: mpm.Grid, kernel: mpm.Kernel) -> dict[str, Callable[..., Any]]:
    """Transfers of a step by name, of the arrays of `arrays_of` and an engine."""
    d = grid.dimension
    give, read = partial(p2g, grid, kernel), partial(g2p, grid, kernel)
    return {
        f"p2g, {1 + 2 * d} channels": lambda x, q, s, f, c, **e: give(x, q, s, **e),
        f"p2g, {d} channels": lambda x, q, s, f, c, **e: give(x, q[:d], None, **e),
        f"g2p, {2 * d} values": lambda x, q, s, f, c, **e: read(x, f, values=2 * d, gradients=0, **e)[0],
        f"g2p, {d} gradients": lambda x, q, s, f, c, **e: read(x, f, values=0, gradients=d, **e)[1],
        "cell sums, 2 rows": lambda x, q, s, f, c, **e: cell_sums(c, q[:2] + 0 * x[:1], cells=grid.nodes, **e),
    }


def transfers(small: bool) -> Rows:
    """Each transfer of a step alone, of the refined slope in both dtypes and by other shape functions, and in 2D."""
    gimp = built("refined", small)[0].numerics.kernel
    asked = [("refined", gimp), ("refined, float64", gimp)]
    asked += [(name, kernel) for name in ("refined", "section") for kernel in (mpm.QuadraticBSpline(), mpm.Linear())]
    for name, kernel in asked:
        scene, state = built(name, small)
        with jax.enable_x64("float64" in name):
            arrays = arrays_of(scene, state)
            for what, run in transfers_of(scene.grid, kernel).items():
                us = [microseconds(partial(run, engine=engine), *arrays) for engine in ENGINES]
                yield row(f"{what}, {type(kernel).__name__}, {name}", *us, unit="us")
            if cuda.available():
                yield row(f"order, {name}", microseconds(partial(order, scene.grid), arrays[0]), unit="us")


def order(grid: mpm.Grid, position: jax.Array) -> jax.Array:
    """Particles in the order of their stencils, which makes sums independent of the batch and of the run."""
    return cuda._order(grid, position[None])[0].astype(position.dtype)


def small_campaign(small: bool) -> Rows:
    """Seconds of a campaign of sections whose classes alone are asked for, its start too, and programs compiled."""
    compiled: list[float] = []

    def listen(event: str, duration_secs: float, **_: object) -> None:
        if event.endswith("backend_compile_duration"):
            compiled.append(duration_secs)

    jax.monitoring.register_event_duration_secs_listener(listen)
    plan = {"samples": 64, "refined_runs": 10, "screening_stop": 1.0, "fields": "none"}
    with tempfile.TemporaryDirectory() as folder:
        start = time.perf_counter()
        cost = campaign.run(TINY if small else scene_text("paper_section", plan), Path(folder) / "campaign").cost
        what = f"campaign of a section, {cost.samples} rough and {cost.refined_runs} refined runs"
        yield row(what, time.perf_counter() - start, unit="s")
    yield row("programs that it compiled or read", len(compiled))
    yield row("seconds that they took", sum(compiled), unit="s")


PARTS: dict[str, Callable[[bool], Rows]] = {
    "accuracy": accuracy,
    "repeats": repeats,
    "memory": memory,
    "gradients": gradients,
    "steps": steps,
    "transfers": transfers,
    "campaign": small_campaign,
    "graphs": lambda small: steps(small, ("rough", "section"), "as one CUDA graph, "),
}


def main() -> None:
    """Rows of a part as JSON, one a line, as they come."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("part", choices=PARTS)
    parser.add_argument("rows", type=Path, help="file that the rows are added to")
    parser.add_argument("--small", action="store_true", help="scenes that a CPU runs in seconds")
    arguments = parser.parse_args()
    made = {"card": jax.devices()[0].device_kind, "jax": jax.__version__}
    for each in PARTS[arguments.part](arguments.small):
        with arguments.rows.open("a") as rows:
            rows.write(json.dumps(each | made) + "\n")


if __name__ == "__main__":
    main()
