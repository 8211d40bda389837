"""What an installation is, and whether it computes what it should: `jaxmpm doctor`."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import math
import os
import platform
import shutil
import time
from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxmpm as mpm
from cooperative.runs import cores_to_use, keep_compiled, memory_mappings, missing_device

# Largest error of the settling column over its largest value; the stress is constant in a cell, of which there are 16.
_SETTLEMENT, _STRESS = 0.01, 0.05
_APART = 2e-6
"""Largest difference of compiled transfers from XLA's, over the largest value."""
_SECONDS = 2.0
_TIMED = ("NVIDIA H100", "NVIDIA H200")
"""Devices beside the CPU that campaigns have been timed on (docs/published-study.md)."""


EXTRAS = {"region": ("geopandas", "pyogrio", "pyproj", "shapefile"), "site": ("python_ags4",)}
"""Modules of each extra that commands ask for."""


def installation() -> Iterator[tuple[str, str]]:
    """Names and values: versions, engine, compiler, cores, devices, precision."""
    yield "jaxmpm", f"{mpm.__version__} in {os.path.dirname(mpm.__file__)}"
    yield "Python", f"{platform.python_version()} on {platform.system()} {platform.machine()}"
    for package in ("jax", "jaxlib", "numpy", "scipy", "h5py"):
        yield package, importlib.metadata.version(package)
    instructions = mpm.transfer.native_instructions()
    fault = "was not built" if mpm.transfer.native_library() is None else "was built for another processor"
    yield (
        "transfers on CPU",
        f"compiled ({instructions})" if instructions else f"on XLA, at some fortieth of the speed: the library {fault}",
    )
    on_gpu = not missing_device() and jax.default_backend() == "gpu"
    if mpm.transfer.cuda_library() is not None:
        reason = mpm.transfer.cuda_fault()
        yield "transfers on GPU", "compiled" if reason is None else f"on XLA, at half the speed: {reason}"
    elif on_gpu:
        built = "that for GPUs was not built, which takes nvcc (docs/get-started.md)"
        yield "transfers on GPU", f"on XLA, at half the speed: {built}"
    compiler = next(filter(None, map(shutil.which, ("c++", "g++", "clang++"))), None)
    yield "C++ compiler", compiler or "none on the path"
    yield "cores", f"{len(cores_to_use())} of {os.cpu_count()}"
    for extra, modules in EXTRAS.items():
        lacking = [name for name in modules if importlib.util.find_spec(name) is None]
        lacks = f"without {', '.join(lacking)}: pip install 'jaxmpm[{extra}]'"
        yield f"extra {extra}", lacks if lacking else "installed"
    missing = missing_device()
    if missing:
        yield "device", f"none. {missing}"
    for device in [] if missing else jax.devices():
        timed = device.platform == "cpu" or device.device_kind.startswith(_TIMED)
        untimed = "" if timed else " (the solver runs here, untimed)"
        yield "device", f"{device.platform}: {device.device_kind}{untimed}"
    yield "compiled programs", f"stored in {folder}" if (folder := keep_compiled()) else "not stored"
    mappings = memory_mappings()
    yield (
        "memory mappings",
        f"{mappings[0]:,} of the {mappings[1]:,} that a process may hold here (vm.max_map_count); "
        "each loaded program holds 8 to 50"
        if mappings
        else "this system gives neither their number nor a limit",
    )
    yield "precision", f"{jnp.result_type(float)} unless a scene has another"


def column_errors() -> tuple[float, float]:
    """Errors of settlement and vertical stress of a damped column under its own weight, over their largest values.

    Closed form: sigma = -w (H - z), u = -w (H z - z^2 / 2) / M with M the constrained modulus.
    """
    height, weight, poisson, cells = 8.0, 20e3, 0.3, 16
    stiffness = 1e9 * (1 - poisson) / ((1 + poisson) * (1 - 2 * poisson))
    omega = math.pi / (2 * height) * math.sqrt(stiffness * 9.81 / weight)
    cell = height / cells
    soil = mpm.Soil(unit_weight=weight, young=1e9, poisson=poisson)
    scene, state = mpm.column(height, soil, mpm.Discretisation(cell, (cell / 2,), damping=2 * omega), at_rest=False)
    final = mpm.solve(scene, state, t_end=20 / omega).raise_if_failed().state
    z = np.asarray(scene.particles.position[-1])
    settlement = -weight / stiffness * (height * z - z**2 / 2)
    stress = -weight * (height - z)
    errors = [
        float(np.abs(np.asarray(computed) - exact).max() / np.abs(exact).max())
        for computed, exact in ((final.displacement[-1], settlement), (final.stress[0], stress))
    ]
    return errors[0], errors[1]


def transferred(
    grid: mpm.Grid,
    kernel: mpm.Kernel,
    position: jax.Array,
    rows: Sequence[jax.Array],
    nodal: jax.Array,
    *,
    engine: mpm.Engine,
) -> dict[str, Any]:
    """What particles give to nodes, the values and gradients that they read there, and both derived by the position.

    Args:
        grid: of the nodes.
        kernel: shape functions.
        position: (d, N) m.
        rows: carried (1 + d, N) and stress (d (d + 1) / 2, N), as `jaxmpm.transfer.p2g` takes them.
        nodal: (nodes, 1 + 2 d), which particles read, and by which sums are weighted where they are derived.
        engine: of the transfers.

    Returns:
        Arrays by name: sums, gathers, derivatives.
    """

    def both(position: jax.Array) -> Any:
        read = {"values": nodal.shape[-1], "gradients": grid.dimension}
        sums = mpm.transfer.p2g(grid, kernel, position, rows[0], rows[1], engine=engine)
        return sums, mpm.transfer.g2p(grid, kernel, position, nodal, engine=engine, **read)

    (sums, read), derivative = jax.vjp(both, position)
    return {"sums": sums, "gathers": read, "derivatives": derivative((nodal, read))}


def apart(computed: Any, expected: Any) -> float:
    """Largest difference of arrays over the largest value of the same array.

    Args:
        computed: arrays, in any structure.
        expected: likewise.

    Returns:
        The largest of all arrays.
    """
    pairs = zip(jax.tree.leaves(computed), jax.tree.leaves(expected), strict=True)
    return max(float(np.abs(np.asarray(a) - np.asarray(b)).max() / np.abs(b).max()) for a, b in pairs)


def off_kinks(rng: np.random.Generator, places: np.ndarray) -> np.ndarray:
    """Coordinates moved within quarters of a cell to where no shape function has a kink within rounding.

    Args:
        rng: draws the places in their quarters.
        places: coordinates, in cells.

    Returns:
        Likewise.
    """
    return (np.floor(4 * places) + rng.uniform(0.1, 0.9, places.shape)) / 4


def engines_apart() -> float | None:
    """Largest difference of compiled transfers from XLA's, over the largest value; None where there are none."""
    engine = mpm.transfer.cuda_available if jax.default_backend() == "gpu" else mpm.transfer.native_available
    if not engine():
        return None
    rng, grid, d = np.random.default_rng(0), mpm.Grid((9, 8, 30), 1.0, (0.0, 0.0, 0.0)), 3
    position = off_kinks(rng, rng.uniform(size=(d, 5000)) * (np.array(grid.shape)[:, None] - 2) + 0.5)
    sizes = ((4, 5000), (6, 5000), (grid.nodes, 7))
    moved, *rows, nodal = (jnp.asarray(a, jnp.float32) for a in (position, *map(rng.normal, [0] * 3, [1] * 3, sizes)))
    on = partial(transferred, grid, mpm.GIMP((0.25,) * d), moved, rows, nodal)
    return apart(*(jax.jit(partial(on, engine=which))() for which in (mpm.Engine.NATIVE, mpm.Engine.XLA)))


def step_speed() -> tuple[int, int, float]:
    """Particles of a small slope in 3D, steps taken, and microseconds per particle and step."""
    shape = mpm.Slope(crest=12.0, height=8.0, run_per_rise=2.0, toe=12.0, foundation=4.0, width=16.0)
    soil = mpm.Soil(unit_weight=20e3, young=1e8, poisson=0.3, strength=42e3, tension_cutoff=0.0)
    scene, state = mpm.slope(shape, soil, mpm.Discretisation(2.0, (1.0, 1.0, 1.0)))
    advance = jax.jit(mpm.advance)
    state = jax.block_until_ready(advance(scene, state, jnp.asarray(2)))
    start, steps = time.perf_counter(), 0
    while (spent := time.perf_counter() - start) < _SECONDS:
        state, steps = jax.block_until_ready(advance(scene, state, jnp.asarray(10))), steps + 10
    particles = scene.particles.mass.size
    return particles, steps, 1e6 * spent / (steps * particles)


def examine() -> bool:
    """Print what the installation is and the result of its self-check; whether it passed."""
    for name, value in installation():
        print(f"{name + ':':18} {value}", flush=True)
    if missing_device():
        print(f"{'self-check:':18} NOT RUN: there is no device")
        return False
    settlement, stress = column_errors()
    engines = engines_apart()
    well = settlement < _SETTLEMENT and stress < _STRESS and (engines is None or engines < _APART)
    print(
        f"{'column at rest:':18} settlement within {settlement:.2%} of the closed form (limit {_SETTLEMENT:.0%}), "
        f"stress within {stress:.2%} (limit {_STRESS:.0%})"
    )
    if engines is not None:
        print(f"{'transfers:':18} compiled within {engines:.1e} of XLA's, derivatives too (limit {_APART:.0e})")
    particles, steps, cost = step_speed()
    print(
        f"{'a step:':18} {cost:.3f} microseconds a particle ({particles:,} particles, {steps} steps, this machine now)"
    )
    print(f"{'self-check:':18} {'well' if well else 'NOT WELL: its answers are wrong, do not use it'}")
    return well
