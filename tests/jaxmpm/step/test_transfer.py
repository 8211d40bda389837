"""Transfers: against the definition, against each other, their derivatives, and what they do with bad input."""

from __future__ import annotations

import hashlib
import itertools
import math
import os
import shutil
import subprocess
import sys
import warnings
from dataclasses import replace
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from jaxmpm.grid import Grid
from jaxmpm.transfer import GIMP, Linear, QuadraticBSpline, native
from jaxmpm.transfer import _transfers as transfer
from jaxmpm.transfer._shape import WIDTH, inside
from jaxmpm.transfer._stencil import Term
from jaxmpm.transfer.native import cuda
from jaxmpm.types import Engine

CELL = 1.3
KERNELS = ("linear", "gimp", "bspline")
FULL = {1: [[0]], 2: [[0, 2], [2, 1]], 3: [[0, 3, 5], [3, 1, 4], [5, 4, 2]]}  # positions of stress components

# As a whole: op by op the XLA engine compiles hundreds of small programs.
p2g = jax.jit(transfer.p2g, static_argnames=("grid", "kernel", "engine"))
g2p = jax.jit(transfer.g2p, static_argnames=("grid", "kernel", "values", "gradients", "engine"))

COMPILER = shutil.which("c++") or shutil.which("g++") or shutil.which("clang++")
engine_here = cuda if jax.default_backend() == "gpu" else native
needs_cpu_kernels = pytest.mark.skipif(
    engine_here is not native or not native.available(), reason="native kernels for CPU were not built, or do not run"
)
needs_native = pytest.mark.skipif(not engine_here.available(), reason="native kernels were not built")


def kernel_of(name: str, d: int):
    return {"linear": Linear(), "gimp": GIMP((0.3, 0.55, 0.65)[:d]), "bspline": QuadraticBSpline()}[name]


def grid_of(d: int) -> Grid:
    return Grid(shape=(9, 7, 8)[:d], cell=CELL, origin=(-2.0, 1.0, 0.5)[:d])


def data(d: int, n: int, seed: int = 0, spread: float = 0.0, dtype=float):
    """Grid, positions (within, or `spread` cells beyond it), carried (1 + d, n) and stress (d (d + 1) / 2, n)."""
    grid, rng = grid_of(d), np.random.default_rng(seed)
    low, high = np.array(grid.origin) + CELL * (0.5 - spread), np.array(grid.shape) - 1.5 + spread
    position = low[:, None] + rng.uniform(size=(d, n)) * (high - 0.5 + spread)[:, None] * CELL
    carried, stress = rng.normal(size=(1 + d, n)), rng.normal(size=(d * (d + 1) // 2, n))
    return grid, *(jnp.asarray(a, dtype) for a in (position, carried, stress))


def weights(grid: Grid, name: str, d: int, position: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Dense weights (nodes, n) and gradients (d, nodes, n), node by node from the formulas of the 1D functions."""

    def one(axis, r):
        a, sign = abs(r), -np.sign(r)
        if name == "linear":
            return (1 - a, sign) if a < 1 else (0.0, 0.0)
        if name == "bspline":
            return (0.75 - r * r, -2 * r) if a < 0.5 else ((1.5 - a) ** 2 / 2, sign * (1.5 - a)) if a < 1.5 else (0, 0)
        l = kernel_of("gimp", d).half_size[axis] / CELL
        if a < l:
            return 1 - (r * r + l * l) / (2 * l), -r / l
        return (
            (1 - a, sign)
            if a < 1 - l
            else ((1 + l - a) ** 2 / (4 * l), sign * (1 + l - a) / (2 * l))
            if a < 1 + l
            else (0, 0)
        )

    n = position.shape[1]
    value, slope = np.zeros((grid.nodes, n)), np.zeros((d, grid.nodes, n))
    for number, node in enumerate(itertools.product(*map(range, grid.shape))):
        for p in range(n):
            f = [one(a, (position[a, p] - grid.origin[a]) / CELL - node[a]) for a in range(d)]
            value[number, p] = np.prod([v for v, _ in f])
            for a in range(d):
                slope[a, number, p] = np.prod([f[b][1] / CELL if a == b else f[b][0] for b in range(d)])
    return value, slope


DENSE = [(d, name, None) for d in (1, 2, 3) for name in KERNELS]
DENSE += [(1, name, Engine.XLA) for name in KERNELS] + [(2, "gimp", Engine.XLA), (3, "gimp", Engine.XLA)]


@pytest.mark.parametrize(("d", "name", "engine"), DENSE)
def test_against_dense_weights(x64, d, name, engine):
    grid, position, carried, stress = data(d, 17)
    value, slope = weights(grid, name, d, np.asarray(position))
    expected = np.concatenate(
        [value @ carried.T, -np.einsum("ijp,jnp->ni", np.asarray(stress)[np.array(FULL[d])], slope)], 1
    )
    nodal = p2g(grid, kernel_of(name, d), position, carried, stress, engine=engine)
    np.testing.assert_allclose(nodal, expected, rtol=0, atol=1e-12)
    values, gradients = g2p(grid, kernel_of(name, d), position, nodal, values=1 + d, gradients=d, engine=engine)
    np.testing.assert_allclose(values, (expected.T @ value)[: 1 + d], rtol=0, atol=1e-12)
    np.testing.assert_allclose(gradients, np.einsum("nc,jnp->cjp", expected[:, :d], slope), rtol=0, atol=1e-12)


@pytest.mark.parametrize("r", [-1.4, -0.9, -0.4, 0.1, 0.6, 1.05])
def test_shape_functions_are_averages_of_simpler_ones(x64, r):
    """GIMP averages the hat over the particle, the quadratic B-spline averages it over a cell."""

    def mean_of_hat(half):
        knots = [k for k in (-1, 0, 1) if r - half < k < r + half]
        return quad(lambda s: max(1 - abs(s), 0), r - half, r + half, points=knots or None)[0] / (2 * half)

    l = 0.3
    assert GIMP((l * CELL,)).shape(0, CELL, jnp.array(r))[0] == pytest.approx(mean_of_hat(l), abs=1e-12)
    assert QuadraticBSpline().shape(0, CELL, jnp.array(r))[0] == pytest.approx(mean_of_hat(0.5), abs=1e-12)


@pytest.mark.parametrize("name", KERNELS)
def test_the_deviation_is_that_of_a_transfer_to_nodes_and_back_along_the_widest_axis(x64, name):
    kernel, r = kernel_of(name, 3), np.linspace(-1.5, 1.5, 3001)
    weights = [np.asarray(kernel.shape(axis, CELL, jnp.asarray(r))[0]) for axis in range(3)]
    variances = [2 * np.sum(w * (r * CELL) ** 2) / np.sum(w) for w in weights]
    assert kernel.deviation(CELL) ** 2 == pytest.approx(max(variances), rel=1e-5)


@given(
    d=st.integers(1, 3),
    name=st.sampled_from(KERNELS),
    positions=st.lists(st.floats(0.0, 1.0, width=32), min_size=3, max_size=12),
)
def test_conserves_mass_and_reproduces_linear_fields(d, name, positions):
    with jax.enable_x64(True):
        grid = grid_of(d)
        n = 4  # one shape for all examples: nothing compiles twice
        fraction = np.resize(np.array(positions), (d, n))
        extent = np.array(grid.shape)[:, None] - 2 - 1e-9
        position = np.array(grid.origin)[:, None] + CELL * (0.5 + fraction * extent)
        nodal = p2g(
            grid,
            kernel_of(name, d),
            jnp.asarray(position),
            jnp.ones((1, n)),
            jnp.ones((len(FULL[d]) * (d + 1) // 2, n)),
        )
        np.testing.assert_allclose(nodal[:, 0].sum(), n, rtol=1e-12)
        np.testing.assert_allclose(nodal[:, 1:].sum(0), 0, atol=1e-11)  # internal forces balance
        nodes = np.stack(np.meshgrid(*map(np.arange, grid.shape), indexing="ij"), -1).reshape(-1, d)
        nodes = nodes * CELL + np.array(grid.origin)
        field = nodes @ np.arange(1.0, d + 1) - 2
        value, gradient = g2p(
            grid,
            kernel_of(name, d),
            jnp.asarray(position),
            jnp.asarray(field)[:, None],
            values=1,
            gradients=1,
        )
        np.testing.assert_allclose(value[0], np.arange(1.0, d + 1) @ position - 2, atol=1e-11)
        if name != "linear":  # whose gradient jumps at the nodes, where an example may lie
            np.testing.assert_allclose(gradient[0], np.arange(1.0, d + 1)[:, None] * np.ones((1, n)), atol=1e-11)


# Carried channels, whether there is stress; the last needs more channels than one native call has.
MAPPED = [(0, True), (1, False), (1, True), ("d", False), ("1+d", False), ("1+d", True), (9, True)]
READ = [("d", 0), (0, "d"), ("2d", 0), ("2d", "d"), (1, 3), (9, 2)]


def count(of, d: int) -> int:
    return {"d": d, "1+d": 1 + d, "2d": 2 * d}.get(of, of)


# Every channel count once; every dimension, kernel function and dtype with the fullest counts of a step.
CASES = [(2, "gimp", "float64", MAPPED, READ)]
CASES += [(2, name, "float64", MAPPED[-2:-1], READ[3:4]) for name in ("linear", "bspline")]
CASES += [(1, "gimp", "float64", MAPPED[-2:-1], READ[3:4]), (3, "gimp", "float32", MAPPED[-2:-1], READ[3:4])]


@needs_native
@pytest.mark.parametrize(("d", "name", "dtype", "mapped", "read"), CASES)
def test_engines_agree(x64, d, name, dtype, mapped, read):
    """Beyond the grid too, with few particles and with enough for many slabs."""
    kernel, rng = kernel_of(name, d), np.random.default_rng(1)
    close = partial(np.testing.assert_allclose, rtol=0, atol=1e-12 if dtype == "float64" else 2e-5)
    for n in (45, 5000):
        grid, position, _, stress = data(d, n, spread=2, dtype=dtype)
        scale = 45 / n
        for k, stressed in mapped if n == 45 else mapped[-1:]:
            carried = jnp.asarray(scale * rng.normal(size=(count(k, d), n)), dtype) if k else None
            args = (grid, kernel, position, carried, scale * stress if stressed else None)
            close(p2g(*args, engine=Engine.NATIVE), p2g(*args, engine=Engine.XLA))
        for values, gradients in read if n == 45 else read[-1:]:
            counts = {"values": count(values, d), "gradients": count(gradients, d)}
            nodal = jnp.asarray(rng.normal(size=(grid.nodes, max(counts.values()))), dtype)
            computed = g2p(grid, kernel, position, nodal, **counts, engine=Engine.NATIVE)
            expected = g2p(grid, kernel, position, nodal, **counts, engine=Engine.XLA)
            for a, b in zip(computed, expected, strict=True):
                assert (a is None) == (b is None)
                if a is not None:
                    close(a, b)


@needs_native
@pytest.mark.parametrize("d", [1, 2, 3])
def test_engines_agree_on_particles_in_the_order_of_their_stencils(x64, d):
    """Some particles for each stencil, in runs that end within blocks and between them, in one slab and in many."""
    kernel, rng = kernel_of("gimp", d), np.random.default_rng(2)
    for n in (130, 6000):
        grid, position, carried, stress = data(d, n, dtype="float32")
        cells = (np.asarray(position) - np.array(grid.origin)[:, None]) / CELL
        order = np.lexsort(np.floor(cells - 0.5)[::-1])
        order[n // 2 : n // 2 + 20] = rng.permutation(order[n // 2 : n // 2 + 20])
        for k, stressed in [(1 + d, True), (d, False), (2, False), (None, True)]:
            mapped = None if k is None else carried[:k, order], stress[:, order] if stressed else None
            native, xla = (
                p2g(grid, kernel, position[:, order], *mapped, engine=each) for each in (Engine.NATIVE, Engine.XLA)
            )
            np.testing.assert_allclose(native, xla, rtol=0, atol=2e-6 * float(abs(xla).max()))


@pytest.mark.parametrize(("name", "engine"), [*((name, None) for name in KERNELS), ("gimp", Engine.XLA)])
def test_particles_beyond_the_grid_vanish(x64, name, engine):
    grid, position, carried, stress = data(3, 9)
    bad = jnp.array([np.nan, np.inf, -np.inf, 1e30, -1e30, 1e9, -50.0, 50.0])
    position = position.at[jnp.arange(8) % 3, jnp.arange(8)].set(bad)
    nodal = p2g(grid, kernel_of(name, 3), position, carried, stress, engine=engine)
    alone = p2g(grid, kernel_of(name, 3), position[:, 8:], carried[:, 8:], stress[:, 8:], engine=engine)
    np.testing.assert_allclose(nodal, alone, rtol=0, atol=1e-15)
    values, gradients = g2p(grid, kernel_of(name, 3), position, nodal, values=7, gradients=3, engine=engine)
    assert not np.any(values[:, :8])
    assert not np.any(gradients[:, :, :8])


HASH = """
import os, sys
os.sched_setaffinity(0, {int(sys.argv[1])})
import hashlib, jax, numpy as np
from tests.jaxmpm.step.test_transfer import thread_case
print(hashlib.sha256(b"".join(np.asarray(a).tobytes() for a in jax.tree.leaves(thread_case()))).hexdigest())
"""


def thread_case():
    """A lane large enough for many slabs, particles in no order, and a batch of three small ones."""
    rng, kernel = np.random.default_rng(0), GIMP((0.25, 0.25, 0.5))
    grid = Grid(shape=(40, 9, 8), cell=1.0, origin=(0.0, 0.0, 0.0))
    position = jnp.asarray(rng.uniform(size=(3, 20_000)) * [[37], [6], [5]] + 1, jnp.float32)
    carried, stress = (jnp.asarray(rng.normal(size=(k, 20_000)), jnp.float32) for k in (4, 6))

    @jax.jit
    def both(position, carried, stress):
        nodal = p2g(grid, kernel, position, carried, stress)
        return nodal, g2p(grid, kernel, position, nodal, values=7, gradients=3)

    lanes = [a.reshape(len(a), 4, 5_000).swapaxes(0, 1) for a in (position, carried, stress)]
    single = [both(*(a[k] for a in lanes)) for k in range(4)]
    return both(position, carried, stress), jax.vmap(both)(*lanes), single


@needs_cpu_kernels
def test_results_do_not_depend_on_threads_or_on_the_batch():
    cores = sorted(os.sched_getaffinity(0))
    if len(cores) < 2:
        pytest.skip("one core only")
    case = thread_case()
    single = jax.tree.map(lambda *x: np.stack(x), *case[2])
    for a, b in zip(jax.tree.leaves(case[1]), jax.tree.leaves(single), strict=True):
        np.testing.assert_array_equal(a, b)
    here = hashlib.sha256(b"".join(np.asarray(a).tobytes() for a in jax.tree.leaves(case))).hexdigest()
    alone = subprocess.run([sys.executable, "-c", HASH, str(cores[0])], capture_output=True, text=True, check=True)
    assert alone.stdout.split()[-1] == here


def test_runs_on_xla_and_says_so_once_without_the_library(x64, monkeypatch):
    grid, position, carried, stress = data(2, 21)
    args = (grid, kernel_of("gimp", 2), position, carried, stress)
    expected = p2g(*args, engine=Engine.XLA)
    monkeypatch.setattr(native, "__path__", [])
    native.available.cache_clear()
    try:
        with pytest.warns(UserWarning, match="run on XLA") as caught:
            nodal = jax.jit(lambda x: transfer.p2g(*args[:2], x, *args[3:]))(position)
        assert len(caught) == 1
        with pytest.raises(ValueError, match=r"Engine\.NATIVE was not built"):
            transfer.p2g(*args, engine=Engine.NATIVE)
        np.testing.assert_allclose(nodal, expected, rtol=0, atol=1e-12)
    finally:
        monkeypatch.undo()
        native.available.cache_clear()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            native.available()


def test_transfers_for_other_devices_do_not_ask_for_the_library_of_cpus(monkeypatch):
    """Whose lack is warned of where a program is compiled for a CPU, not where one is traced."""

    def asked():
        raise AssertionError("the library was asked for")

    monkeypatch.setattr(native, "available", asked)
    grid, position, carried, stress = data(2, 5)
    kernel = kernel_of("gimp", 2)
    nodal = jax.eval_shape(lambda x: transfer.p2g(grid, kernel, x, carried, stress), position)
    assert nodal.shape == (grid.nodes, 5)


def test_a_library_of_other_sources_is_refused(monkeypatch):
    monkeypatch.setattr(native, "library", lambda: Path(np.random.bit_generator.__file__))
    native.available.cache_clear()
    try:
        with pytest.raises(ImportError, match=r"lacks jaxmpm_scatter.*install jaxmpm again"):
            native.available()
    finally:
        monkeypatch.undo()
        native.available.cache_clear()
        assert native.available() == (native.library() is not None)


@pytest.mark.skipif(COMPILER is None, reason="no C++ compiler")
def test_a_library_for_another_processor_is_not_called(tmp_path, monkeypatch):
    source, library = tmp_path / "other.cc", tmp_path / native.LIBRARY
    handlers = "".join(f"void {name}() {{}} " for name in native.TARGETS)
    source.write_text(f'extern "C" {{ {handlers}const char* jaxmpm_instructions() {{ return nullptr; }} }}')
    subprocess.run([COMPILER, "-shared", "-fPIC", source, "-o", library], check=True)
    monkeypatch.setattr(native, "library", lambda: library)
    native.available.cache_clear()
    try:
        assert native.instructions() is None
        with pytest.warns(UserWarning, match="built for another processor.* run on XLA"):
            assert not native.available()
    finally:
        monkeypatch.undo()
        native.available.cache_clear()
        assert native.available() == (native.instructions() is not None)


@needs_native
@pytest.mark.parametrize("channels", [5, 8, 9, 11])
@pytest.mark.parametrize("values", [1, 2, 4, 5])
def test_channels_that_no_term_names_are_left_out(channels, values):
    grid, position, *_ = data(2, 50)
    nodal = jnp.asarray(np.random.default_rng(1).normal(size=(grid.nodes, channels)))

    def computed(engine):
        def fields(x):
            counts = {"values": values, "gradients": min(values, 2)}
            return g2p(grid, kernel_of("gimp", 2), x, nodal, **counts, engine=engine)

        return fields(position), jax.grad(lambda x: sum(map(jnp.sum, fields(x))))(position)

    for a, b in zip(*map(jax.tree.leaves, map(computed, (Engine.NATIVE, Engine.XLA))), strict=True):
        np.testing.assert_allclose(a, b, rtol=0, atol=2e-6 * np.abs(b).max())


REFUSED = [
    ({}, None),
    ({"function": 3}, "shape function"),
    ({"half": (0.0, 0.25)}, "half size"),
    ({"half": (0.25, 0.6)}, "half size"),
    ({"cell": 0.0}, "cell is not above 0"),
    ({"shape": (9, 2)}, "fewer than 3 nodes"),
    ({"shape": (9, 8)}, "as many nodes as the grid"),
    ({"shape": (9,)}, "differ in dimension"),
    ({"origin": (0.0,)}, "differ in dimension"),
    ({"terms": (0, 0, 0)}, "four numbers"),
    ({"terms": (3, 0, 0, 1)}, "does not exist"),
    ({"terms": (0, 4, 0, 1)}, "does not exist"),
    ({"terms": (0, 0, 6, 1)}, "does not exist"),
    ({"position": (2, 2, 5)}, "leading axes"),
    ({"rows": (1, 3, 4)}, "number of particles"),
    ({"padded": 8}, "not padded"),
    ({"stored": 63, "first": (3, 1, 9)}, None),
    ({"stored": 63}, "does not exist"),  # the block of rows is taken for them
    ({"stored": 63, "first": (3, 1, 7)}, "one row for each column"),
    ({"stored": 63, "first": (2, 1, 9)}, "leading axes"),
    ({"stored": 62, "first": (3, 1, 9)}, "as many nodes as the grid"),
    ({"stored": 2, "first": (3, 1, 9)}, "fewer than 3"),
]


@needs_cpu_kernels
@pytest.mark.parametrize(("changed", "message"), REFUSED, ids=[f"{list(c)}: {m}" for c, m in REFUSED])
def test_kernels_refuse_what_they_cannot_do(changed, message):
    """Straight to the library, past the checks in Python: three lanes of five particles on 9 x 7 nodes."""
    given = {"position": (3, 2, 5), "rows": (1, 3, 5), "padded": 4, "shape": (9, 7), "origin": (0.0, 0.0), "cell": 1.0}
    given |= {"function": 1, "half": (0.25, 0.25), "terms": (0, 0, 0, 1), "stored": 0} | changed
    nodal = jax.ShapeDtypeStruct((3, 63, given["padded"]), jnp.float32)
    attributes = {name: np.array(given[name], np.int64) for name in ("shape", "terms")}
    attributes |= {name: np.array(given[name], np.float64) for name in ("origin", "half")}
    attributes |= {"cell": np.float64(given["cell"])}
    attributes |= {name: np.int64(given[name]) for name in ("function", "stored")}
    call = jax.ffi.ffi_call("jaxmpm_scatter", nodal)
    arrays = [jnp.ones(given[name], jnp.float32) for name in ("position", "rows")]
    arrays[1:1] = [jnp.zeros(given["first"], jnp.int32)] if "first" in given else []
    if message is None:
        assert call(*arrays, **attributes).shape == nodal.shape
        return
    with pytest.raises(Exception, match=f"jaxmpm: .*{message}"):
        call(*arrays, **attributes)


def test_errors_name_the_value_and_the_remedy():
    grid, position, carried, stress = data(2, 5, dtype="float32")
    with pytest.raises(ValueError, match="fewer than 3 nodes"):
        p2g(Grid(shape=(9, 2), cell=1.0, origin=(0.0, 0.0)), Linear(), position, carried, stress)
    with pytest.raises(ValueError, match="mix float16, float32"):
        p2g(grid, Linear(), position, carried.astype(jnp.float16), stress)
    half = position.astype(jnp.float16)
    with pytest.raises(ValueError, match=r"Engine\.NATIVE"):
        p2g(grid, Linear(), half, None, stress.astype(jnp.float16), engine=Engine.NATIVE)


def test_channels_that_meet_weights_alone_are_worked_on_apart():
    """Groups of channels as a kernel has them, four by four; None is an empty place."""
    mapped = [Term(c, c) for c in range(3)] + [Term(3 + c, 3 + c, (0,)) for c in range(2)]
    assert cuda._groups(mapped, 5) == [[0, 1, 2, None, 3, 4]]
    assert cuda._groups([Term(c, c) for c in range(13)], 13) == [list(range(8)), list(range(8, 13))]
    assert cuda._groups([Term(0, c, (0, 0)) for c in range(6)], 6) == [[0, 1, 2, 3], [4, 5]]
    assert cuda._groups([Term(0, 0), Term(0, 1, (0,))], 3) == [[0, 1, 2]]


@given(st.floats(-2, 9))
def test_a_particle_is_inside_where_its_whole_stencil_is(at):
    grid = Grid((7, 20), 1.0, (0.0, 0.0))
    lowest = math.floor(at - 0.5)
    whole = lowest >= 0 and lowest + WIDTH <= 7
    assert inside(grid, np.array([[at], [9.3]])).tolist() == [whole]
    assert inside(replace(grid, shape=(20, 7)), np.array([[9.3], [at]])).tolist() == [whole]
