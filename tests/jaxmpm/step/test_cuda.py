"""The engine for CUDA GPUs: on a GPU where there is one, else its kernels compiled for a CPU (tests/cuda_on_cpu.h)."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from jax.interpreters import mlir

from jaxmpm import transfer
from jaxmpm.grid import Grid
from jaxmpm.transfer import GIMP, _cells, _primitives, native, of_stored
from jaxmpm.transfer._near import columns_of, near_nodes
from jaxmpm.transfer.native import cuda
from jaxmpm.types import Engine
from tests import ROOT
from tests.jaxmpm.step.test_transfer import KERNELS, data, g2p, kernel_of, p2g
from tests.jaxmpm.step.test_transfer_derivatives import assert_trees_close, loss

COMPILER = shutil.which("c++") or shutil.which("g++") or shutil.which("clang++")
ON_GPU = jax.default_backend() == "gpu"
# Half a minute to compile the kernels for a CPU, and fibers take turns there.
pytestmark = [] if ON_GPU else [pytest.mark.slow]
on_gpu = pytest.mark.skipif(not ON_GPU, reason="there is no GPU")

LOWERED = {
    _primitives.scatter_p: _primitives._scatter_native,
    _primitives.gather_p: _primitives._gather_native,
    _primitives.contract_p: _primitives._contract_native,
    _cells.cell_sums_p: _cells._compiled,
}


def lower_to(engine) -> None:
    """Have the primitives lower to an engine on CPU."""
    for primitive, compiled in LOWERED.items():
        rule = mlir.lower_fun(partial(compiled, engine), multiple_results=primitive.multiple_results)
        mlir.register_lowering(primitive, rule, platform="cpu")
    jax.clear_caches()


def build(folder: Path) -> Path:
    """The library for GPUs, compiled for a CPU."""
    sources, include = ROOT / "jaxmpm" / "transfer" / "native", Path(jax.ffi.include_dir())
    flags = ["-x", "c++", "-std=c++20", "-O1", "-fPIC", "-I", sources, "-I", ROOT / "tests", "-isystem", include]
    flags.append('-DJAXMPM_CUDA_ON_CPU="cuda_on_cpu.h"')
    units = {f"kernels_{scalar}": ("cuda_kernels.cu", f"-DJAXMPM_SCALAR={scalar}") for scalar in ("float", "double")}
    units |= {"order": ("cuda_order.cu",), "ffi": ("cuda_ffi.cc",)}
    commands = [[sources / name, *own, "-o", folder / f"{unit}.o"] for unit, (name, *own) in units.items()]
    commands.append([ROOT / "tests" / "cuda_on_cpu.cc", "-o", folder / "fibers.o"])
    for command in commands:
        subprocess.run([COMPILER, *flags, "-c", *command], check=True)
    library = folder / cuda.LIBRARY
    subprocess.run([COMPILER, "-shared", *sorted(folder.glob("*.o")), "-o", library], check=True)
    return library


@pytest.fixture(scope="module", autouse=True)
def engine(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """The engine, as that of GPUs or in place of that for CPU."""
    if ON_GPU:
        if not cuda.available():
            pytest.skip(f"{cuda.LIBRARY} was not built")
        yield
        return
    if COMPILER is None:
        pytest.skip("there is neither a GPU nor a C++ compiler")
    with pytest.MonkeyPatch.context() as patch:
        path = build(tmp_path_factory.mktemp("cuda"))
        patch.setattr(cuda, "library", lambda: path)
        patch.setattr(cuda, "PLATFORM", "cpu")
        cuda.available.cache_clear()
        assert cuda.available()
        lower_to(cuda)
        yield
    lower_to(native)
    cuda.available.cache_clear()


@pytest.fixture(autouse=True)
def shim(engine) -> Iterator[ctypes.CDLL | None]:
    """What takes the place of a GPU. No launch adds two numbers to one, in an order of chance, or is one that fails."""
    if ON_GPU:
        yield None
        return
    library = ctypes.CDLL(str(cuda.library()))
    yield library
    library.cuda_on_cpu_shuffle(0)
    assert library.cuda_on_cpu_faults() == 0


def assert_close_to_xla(function, *arrays, tolerance: float) -> None:
    """Assert that a function of an engine and arrays gives what it does on XLA, relative to the largest number."""
    results = [jax.jit(partial(function, engine))(*arrays) for engine in (Engine.NATIVE, Engine.XLA)]
    for a, b in zip(*map(jax.tree.leaves, results), strict=True):
        assert a.shape == b.shape
        np.testing.assert_allclose(a, b, rtol=0, atol=tolerance * max(float(np.abs(b).max(initial=0)), 1e-30))


CASES = [(d, name, "float64") for d in (1, 2) for name in KERNELS] + [(2, "gimp", "float32"), (3, "gimp", "float32")]
CASES += [(3, "bspline", "float64")]


@pytest.mark.parametrize(("d", "name", "dtype"), CASES)
def test_agrees_with_xla(x64, d, name, dtype):
    """All counts of channels that a step has, and more than one kernel takes, beyond the grid too, in one program."""
    grid, position, _, stress = data(d, 150, spread=2, dtype=dtype)
    kernel, rng = kernel_of(name, d), np.random.default_rng(1)
    given = [
        (jnp.asarray(rng.normal(size=(k, 150)), dtype) if k else None, stress if stressed else None)
        for k, stressed in ((0, True), (1, True), (d, False), (1 + d, True), (9, True), (13, False))
    ]
    asked = [
        (jnp.asarray(rng.normal(size=(grid.nodes, max(counts))), dtype), *counts)
        for counts in ((d, 0), (0, d), (2 * d, d), (1, 1), (1, 3), (9, 2))
    ]

    def transferred(engine, position):
        mapped = [p2g(grid, kernel, position, *rows, engine=engine) for rows in given]
        read = [g2p(grid, kernel, position, f, values=v, gradients=g, engine=engine) for f, v, g in asked]
        return mapped, read

    assert_close_to_xla(transferred, position, tolerance=2e-6 if dtype == "float32" else 1e-13)


@pytest.mark.parametrize(("d", "name"), [(1, "gimp"), (2, "gimp"), (2, "bspline"), (3, "gimp")])
def test_derivatives_agree_with_those_of_xla(x64, d, name):
    grid, *args = data(d, 12)
    tangents = list(data(d, 12, seed=5)[1:])

    @partial(jax.jit, static_argnums=0)
    def derivatives(engine):
        f = partial(loss, grid, kernel_of(name, d), engine)
        first = jax.grad(f, argnums=(0, 1, 2))(*args), jax.jvp(f, args, tangents)
        return first if d == 3 else (first, jax.jvp(jax.grad(f), args, tangents)[1])

    # None, since the last one takes a third derivative of the weights from XLA.
    assert_trees_close(derivatives(None), derivatives(Engine.XLA))


@settings(max_examples=40 if ON_GPU else 15, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
@given(seed=st.integers(0, 2**32 - 1), d=st.integers(1, 3), last=st.integers(3, 60), crowd=st.sampled_from([1, 200]))
def test_sums_of_any_column(seed, d, last, crowd):
    """Columns of any length, cut into any number of segments, with gaps of any length, and crowds in one cell."""
    rng, n = np.random.default_rng(seed), 300
    grid = Grid((*(4, 3)[: d - 1], last), 0.7, (0.3, -1.0, 2.0)[3 - d :])
    position = rng.uniform(size=(d, n)) * (np.array(grid.shape)[:, None] - 1)
    # Most particles in few places along the last axis.
    places = rng.choice(position[-1], size=3)[rng.integers(0, 3, n)]
    position[-1] = np.where(rng.uniform(size=n) < 0.9, places, position[-1])
    position[:, :crowd] = position[:, :1] + 1e-3 * rng.uniform(size=(d, crowd))
    position = np.array(grid.origin)[:, None] + grid.cell * position
    carried, stress = rng.uniform(size=(1 + d, n)), rng.uniform(size=(d * (d + 1) // 2, n))
    arrays = [jnp.asarray(a, jnp.float32) for a in (position, carried, stress)]
    assert_close_to_xla(lambda engine, *a: p2g(grid, GIMP((0.2,) * d), *a, engine=engine), *arrays, tolerance=4e-6)


def lanes_of_particles(lanes: int, n: int):
    """Grid, and position, carried and stress of particles of each lane, in no order."""
    rng, grid = np.random.default_rng(0), Grid(shape=(14, 9, 20), cell=1.0, origin=(0.0, 0.0, 0.0))
    position = rng.uniform(size=(lanes, 3, n)) * (np.array(grid.shape)[:, None] - 3) + 1
    return grid, [jnp.asarray(a, jnp.float32) for a in (position, *(rng.normal(size=(lanes, k, n)) for k in (4, 6)))]


def test_sums_do_not_depend_on_the_batch_and_repeat_bit_for_bit():
    grid, arrays = lanes_of_particles(3, 20_000 if ON_GPU else 400)
    kernel = GIMP((0.25, 0.25, 0.25))

    @jax.jit
    def both(position, carried, stress):
        nodal = p2g(grid, kernel, position, carried, stress)
        cell = jnp.sum(jnp.floor(position).astype(jnp.int32) * jnp.array([[180], [20], [1]]), axis=0)
        sums = _cells.cell_sums(cell, carried, cells=grid.nodes)
        return nodal, sums, g2p(grid, kernel, position, nodal, values=7, gradients=3)

    batch, again = (jax.jit(jax.vmap(both))(*arrays) for _ in range(2))
    shared = jax.jit(jax.vmap(both, in_axes=(None, 0, None)))(arrays[0][0], arrays[1], arrays[2][0])
    for lane in range(3):
        alone = both(*(a[lane] for a in arrays))
        same = both(arrays[0][0], arrays[1][lane], arrays[2][0])
        for a, b, c, d, e in zip(*map(jax.tree.leaves, (batch, again, alone, shared, same)), strict=True):
            np.testing.assert_array_equal(a[lane], b[lane])
            np.testing.assert_array_equal(a[lane], c)
            np.testing.assert_array_equal(d[lane], e)


@pytest.mark.skipif(ON_GPU, reason="a GPU takes turns as it likes")
@pytest.mark.parametrize("near", [False, True])
def test_sums_do_not_depend_on_who_comes_first(shim, near):
    """Blocks, warps and threads between two meetings take turns by chance."""
    grid, (position, carried, stress) = lanes_of_particles(2, 300)
    grid = replace(grid, stored=grid.nodes) if near else grid
    position = position.at[:, :2, 150:].set(5.2)  # more than a warp in one column

    @jax.jit
    @jax.vmap
    def all_of_them(position, carried, stress):
        stored = replace(grid, near=near_nodes(grid, position)) if near else grid

        def loss(position):
            nodal = transfer.p2g(stored, GIMP((0.25,) * 3), position, carried, stress)
            values, gradients = transfer.g2p(stored, GIMP((0.25,) * 3), position, nodal, values=7, gradients=3)
            return jnp.sum(values**2) + jnp.sum(gradients**2), (nodal, values, gradients)

        cell = jnp.floor(position[0]).astype(jnp.int32)
        return jax.value_and_grad(loss, has_aux=True)(position), _cells.cell_sums(cell, carried, cells=20)

    in_turn = all_of_them(position, carried, stress)
    for seed in (1, 2, 3):
        shim.cuda_on_cpu_shuffle(seed)
        for a, b in zip(*map(jax.tree.leaves, (all_of_them(position, carried, stress), in_turn)), strict=True):
            np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("scale", [1.0, 3e-38])
def test_sums_are_those_of_few_lanes_in_a_batch_of_many(scale):
    """Few nodes have a copy for each column that meets them, many only one for those beside each other.

    Adding to memory a GPU takes floats below 1.2e-38 as 0.
    """
    rng, grid, kernel = np.random.default_rng(0), Grid((8, 7, 26), 1.0, (0.0, 0.0, 0.0)), GIMP((0.25,) * 3)
    lanes = 2 + 2**19 // (grid.nodes * 4)
    position = jnp.asarray(rng.uniform(size=(3, 300)) * (np.array(grid.shape)[:, None] - 3) + 1, jnp.float32)
    carried = jnp.asarray(scale * rng.normal(size=(3, 300)), jnp.float32) * jnp.ones((lanes, 1, 1))
    each = jax.vmap(lambda c: p2g(grid, kernel, position, c, None))
    many, few = jax.jit(each)(carried), jax.jit(each)(carried[:2])
    np.testing.assert_array_equal(many[-2:], few)


def test_nested_batches_share_what_they_share():
    grid, (position, carried, stress) = lanes_of_particles(2, 60)
    kernel = GIMP((0.25, 0.25, 0.25))

    def mapped(engine, position, carried):
        inner = jax.vmap(lambda x, c: p2g(grid, kernel, x, c, stress[0], engine=engine), in_axes=(None, 0))
        return jax.vmap(inner, in_axes=(0, None))(position, carried)

    assert_close_to_xla(mapped, position, carried, tolerance=2e-6)


@pytest.mark.parametrize("d", [2, 3])
def test_nodes_near_soil_have_the_sums_of_a_grid_that_stores_all(d):
    """Bit for bit, in lanes whose nodes differ, and back; derivatives by the position as XLA's."""
    rng, kernel = np.random.default_rng(d), GIMP((0.25,) * d)
    grid = Grid(shape=(14, 9, 40)[-d:], cell=1.0, origin=(0.0,) * d)
    # Two clouds of their own in each lane: most nodes of a column lie between them or beyond.
    middle = rng.uniform(4, np.array(grid.shape)[:, None] - 5, (3, d, 2))
    position = jnp.asarray(middle[:, :, np.arange(200) % 2] + rng.uniform(-1.5, 1.5, (3, d, 200)), jnp.float32)
    carried, stress = (jnp.asarray(rng.normal(size=(3, k, 200)), jnp.float32) for k in (1 + d, d * (d + 1) // 2))
    needed = max(int(columns_of(grid, lane)[1].sum()) for lane in position)
    assert needed < grid.nodes / 2
    near = replace(grid, stored=needed + 5)

    def both(position, carried, stress, grid, engine=None):
        stored = replace(grid, near=near_nodes(grid, position)) if grid.stored else grid
        nodal = transfer.p2g(stored, kernel, position, carried, stress, engine=engine)
        read = transfer.g2p(stored, kernel, position, nodal, values=2 + d, gradients=d, engine=engine)
        return nodal, read, stored

    nodal, read, stored = jax.jit(jax.vmap(partial(both, grid=near)))(position, carried, stress)
    of_all, read_of_all, _ = jax.jit(jax.vmap(partial(both, grid=grid)))(position, carried, stress)
    sharing = jax.vmap(partial(both, grid=near), in_axes=(None, 0, None))
    shared = jax.jit(sharing)(position[0], carried, stress[0])
    np.testing.assert_array_equal(shared[0][0], nodal[0])
    np.testing.assert_array_equal(shared[1][0][0], read[0][0])
    for lane in range(3):
        alone = jax.jit(partial(both, grid=near))(*(a[lane] for a in (position, carried, stress)))
        of_lane = jax.tree.map(lambda a, lane=lane: a[lane], stored)
        kept = np.asarray(of_lane.near.node) >= 0
        np.testing.assert_array_equal(nodal[lane], alone[0])
        np.testing.assert_array_equal(nodal[lane][kept], of_stored(of_lane, of_all[lane])[kept])
        assert not np.asarray(nodal[lane])[~kept].any()
        assert np.abs(nodal[lane]).sum() == pytest.approx(np.abs(of_all[lane]).sum(), rel=1e-5)
    for a, b in zip(jax.tree.leaves(read), jax.tree.leaves(read_of_all), strict=True):
        np.testing.assert_array_equal(a, b)

    def loss(engine, position):
        nodal, (values, gradients), _ = both(position, carried[0], stress[0], near, engine)
        return jnp.sum(nodal**2) + jnp.sum(values**2) + jnp.sum(gradients**2)

    assert_close_to_xla(lambda engine, x: jax.grad(partial(loss, engine))(x), position[0], tolerance=1e-5)


def test_more_nodes_than_are_stored_write_nowhere_else(shim):
    """Rows mean nothing then, and are added to twice, but lie within their array."""
    grid, (position, carried, stress) = lanes_of_particles(1, 300)
    few = replace(grid, stored=40)
    few = replace(few, near=near_nodes(few, position[0]))
    assert few.near.needed > 40
    kernel = GIMP((0.25,) * 3)
    nodal = transfer.p2g(few, kernel, position[0], carried[0], stress[0])
    assert nodal.shape == (40, 7)
    assert np.isfinite(nodal).all()
    assert np.isfinite(transfer.g2p(few, kernel, position[0], nodal, values=7, gradients=3)[1]).all()
    if shim is not None:
        assert shim.cuda_on_cpu_faults() > 0


@pytest.mark.parametrize("name", KERNELS)
def test_particles_beyond_the_grid_vanish(x64, name):
    grid, position, carried, stress = data(3, 9)
    bad = jnp.array([np.nan, np.inf, -np.inf, 1e30, -1e30, 1e9, -50.0, 50.0])
    position = position.at[jnp.arange(8) % 3, jnp.arange(8)].set(bad)
    nodal = p2g(grid, kernel_of(name, 3), position, carried, stress)
    alone = p2g(grid, kernel_of(name, 3), position[:, 8:], carried[:, 8:], stress[:, 8:])
    np.testing.assert_array_equal(nodal, alone)
    values, gradients = g2p(grid, kernel_of(name, 3), position, nodal, values=7, gradients=3)
    assert not np.any(values[:, :8])
    assert not np.any(gradients[:, :, :8])


def test_no_particles_give_no_sums():
    grid, kernel = Grid((5, 4), 1.3, (0.0, 0.0)), kernel_of("gimp", 2)
    nodal = p2g(grid, kernel, jnp.zeros((2, 0)), jnp.zeros((3, 0)), jnp.zeros((3, 0)))
    assert nodal.shape == (20, 5)
    assert not np.any(nodal)
    assert g2p(grid, kernel, jnp.zeros((2, 0)), nodal, values=2, gradients=0)[0].shape == (2, 0)


def test_no_lanes_launch_nothing():
    grid, kernel = Grid((5, 4), 1.3, (0.0, 0.0)), kernel_of("gimp", 2)

    def there_and_back(position, carried, stress):
        nodal = p2g(grid, kernel, position, carried, stress)
        cell = jnp.zeros(position.shape[-1], jnp.int32)
        return g2p(grid, kernel, position, nodal, values=2, gradients=2), _cells.cell_sums(cell, carried, cells=3)

    found, sums = jax.jit(jax.vmap(there_and_back))(*(jnp.zeros((0, k, 6)) for k in (2, 3, 3)))
    assert [a.shape for a in (*found, sums)] == [(0, 2, 6), (0, 2, 2, 6), (0, 3, 6)]


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_cell_sums_agree_with_xla(x64, dtype):
    rng = np.random.default_rng(3)
    cell = jnp.asarray(rng.integers(0, 30, size=(2, 200)), jnp.int32)
    values = jnp.asarray(rng.normal(size=(2, 3, 200)), dtype)
    for axes in ((0, 0), (None, 0), (0, None)):

        def summed(engine, cell, values, axes=axes):
            each = jax.vmap(lambda c, v: _cells.cell_sums(c, v, cells=30, engine=engine), in_axes=axes)
            return each(cell if axes[0] == 0 else cell[0], values if axes[1] == 0 else values[0])

        assert_close_to_xla(summed, cell, values, tolerance=1e-6 if dtype == "float32" else 1e-14)


REFUSED = [
    ({}, None),
    ({"function": 3}, "shape function"),
    ({"shape": (9, 2)}, "fewer than 3 nodes"),
    ({"shape": (9, 8)}, "as many nodes as the grid"),
    ({"terms": (0, 4, 0, 1)}, "does not exist"),
    ({"position": (2, 2, 5)}, "leading axes"),
    ({"position": (2, 5)}, "one axis of lanes"),
    ({"list": (1, 1, 4)}, "so many particles"),
    ({"offsets": (1, 1, 63)}, "another grid"),
    ({"copies": (2, 756)}, "too few copies"),
    ({"rows": (1, 3, 4)}, "number of particles"),
    ({"padded": 8}, "not padded"),
    ({"stored": 63, "first": (1, 1, 8)}, "one row for each column"),
    ({"stored": 63, "first": (1, 1, 9)}, None),
    ({"stored": 2}, "fewer than 3"),
    ({"stored": 62}, "as many nodes as the grid"),
]


@pytest.mark.parametrize(("changed", "message"), REFUSED, ids=[f"{list(c)}: {m}" for c, m in REFUSED])
def test_kernels_refuse_what_they_cannot_do(changed, message):
    """Straight to the library, past the checks in Python: three lanes of five particles on 9 x 7 nodes."""
    given = {"position": (1, 2, 5), "rows": (1, 3, 5), "padded": 4, "shape": (9, 7), "origin": (0.0, 0.0), "cell": 1.0}
    given |= {
        "list": (1, 1, 5),
        "offsets": (1, 1, 64),
        "copies": (3, 756),
        "function": 1,
        "stored": 0,
        "half": (0.25, 0.25),
        "terms": (0, 0, 0, 1),
    }
    given |= changed
    nodal = jax.ShapeDtypeStruct((3, 63, given["padded"]), jnp.float32)
    attributes = {name: np.array(given[name], np.int64) for name in ("shape", "terms")}
    attributes |= {name: np.array(given[name], np.float64) for name in ("origin", "half")}
    attributes |= {"cell": np.float64(given["cell"])} | {name: np.int64(given[name]) for name in ("function", "stored")}
    copies = jax.ShapeDtypeStruct(given["copies"], jnp.float32)
    call = jax.ffi.ffi_call("jaxmpm_cuda_scatter", [nodal, copies])
    arrays = [jnp.ones(given["position"], jnp.float32)]
    arrays += [jnp.zeros(given[name], jnp.int32) for name in ("list", "offsets", "first") if name in given]
    arrays.append(jnp.ones(given["rows"], jnp.float32))
    if message is None:
        assert call(*arrays, **attributes)[0].shape == nodal.shape
        return
    with pytest.raises(Exception, match=f"jaxmpm: .*{message}"):
        jax.block_until_ready(call(*arrays, **attributes))


@on_gpu
def test_a_step_puts_its_particles_in_order_once():
    """The two maps to the nodes of a step are of the same positions: XLA drops the second order."""
    grid, (position, carried, stress) = lanes_of_particles(1, 500)
    kernel = GIMP((0.25, 0.25, 0.25))

    def twice(position, carried, stress):
        first = p2g(grid, kernel, position, carried, stress)
        seen, _ = g2p(grid, kernel, position, first, values=3, gradients=0)
        return p2g(grid, kernel, position, seen, None)

    compiled = jax.jit(twice).lower(position[0], carried[0], stress[0]).compile().as_text()
    assert compiled.count('custom_call_target="jaxmpm_cuda_scatter"') == 2
    assert compiled.count('custom_call_target="jaxmpm_cuda_order"') == 1
