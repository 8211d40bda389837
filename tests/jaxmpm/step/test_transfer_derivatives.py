"""Transfers differentiated and in batches: the primitives' rules against JAX's own of the XLA engine."""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmpm.transfer import Linear, native
from jaxmpm.types import Engine
from tests.jaxmpm.step.test_transfer import data, g2p, grid_of, kernel_of, p2g


def loss(grid, kernel, engine, position, carried, stress):
    """A number that depends on everything through both transfers."""
    d = grid.dimension
    nodal = jnp.sin(p2g(grid, kernel, position, carried, stress, engine=engine))
    values, gradients = g2p(grid, kernel, position, nodal, values=1 + 2 * d, gradients=d, engine=engine)
    return jnp.sum(values**2) + jnp.sum(jnp.cos(gradients))


def assert_trees_close(a, b, tolerance=1e-12):
    for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True):
        assert x.shape == y.shape
        np.testing.assert_allclose(x, y, rtol=0, atol=tolerance * max(1.0, float(np.abs(y).max())))


HESSIANS = [(1, "linear"), (1, "gimp"), (1, "bspline"), (2, "gimp")]


RARER = [
    pytest.param(*case, marks=pytest.mark.slow) for case in ((2, "gimp"), (2, "linear"), (2, "bspline"), (3, "gimp"))
]


@pytest.mark.parametrize(("d", "name"), [*HESSIANS[:3], *RARER])
def test_derivatives_agree_with_differentiated_xla(x64, d, name):
    """Reverse and forward, and for some forward over reverse: the primitives' rules against JAX's own of jnp."""
    grid, *args = data(d, 12)
    tangents = list(data(d, 12, seed=5)[1:])

    @partial(jax.jit, static_argnums=0)
    def derivatives(engine):
        f = partial(loss, grid, kernel_of(name, d), engine)
        first = jax.grad(f, argnums=(0, 1, 2))(*args), jax.jvp(f, args, tangents)
        return first if (d, name) not in HESSIANS else (first, jax.jvp(jax.grad(f), args, tangents)[1])

    assert_trees_close(derivatives(None), derivatives(Engine.XLA))


@pytest.mark.parametrize("name", ["gimp", "bspline"])
def test_gradient_agrees_with_finite_differences(x64, name):
    grid, *args = data(2, 8)
    direction = data(2, 8, seed=3)[1:]
    f = jax.jit(partial(loss, grid, kernel_of(name, 2), None))
    slope = float(jax.jvp(f, args, list(direction))[1])
    adjoint = sum(float(jnp.vdot(g, t)) for g, t in zip(jax.grad(f, argnums=(0, 1, 2))(*args), direction, strict=True))
    h = 1e-6
    ahead, behind = (float(f(*(a + s * h * t for a, t in zip(args, direction, strict=True)))) for s in (1, -1))
    assert slope == pytest.approx((ahead - behind) / (2 * h), rel=1e-7)
    assert adjoint == pytest.approx(slope, rel=1e-12)


def test_gradient_through_a_scan_with_checkpoints(x64):
    grid, position, carried, stress = data(2, 30)

    def run(engine, stress):
        @jax.checkpoint
        def step(x, _):
            nodal = p2g(grid, kernel_of("gimp", 2), x, carried, stress, engine=engine)
            values, _ = g2p(grid, kernel_of("gimp", 2), x, nodal, values=5, gradients=0, engine=engine)
            return x + 1e-2 * jnp.tanh(values[1:3] + values[3:]), None

        return jnp.sum(jax.lax.scan(step, position, length=4)[0] ** 2)

    native, xla = (jax.jit(jax.grad(partial(run, engine)))(stress) for engine in (None, Engine.XLA))
    assert_trees_close(native, xla)


@partial(jax.jit, static_argnums=0)
def loss_and_gradient(engine, *args):
    return jax.value_and_grad(partial(loss, grid_of(2), kernel_of("gimp", 2), engine), argnums=(0, 1, 2))(*args)


@pytest.mark.parametrize("batched", [(0,), (1,), (2,), (0, 1)])
def test_vmap_over_any_argument(x64, batched):
    grid, *args = data(2, 20)
    in_axes = tuple(0 if i in batched else None for i in range(3))
    lanes = tuple(jnp.stack([a, 0.9 * a + 0.2, 1.01 * a]) if i in batched else a for i, a in enumerate(args))
    one = [loss_and_gradient(Engine.XLA, *(a[k] if i in batched else a for i, a in enumerate(lanes))) for k in range(3)]
    value, gradient = jax.tree.map(lambda *x: jnp.stack(x), *one)
    # Differentiated within the lanes, and across them, where a shared argument sums over lanes.
    assert_trees_close(jax.vmap(partial(loss_and_gradient, None), in_axes)(*lanes), (value, gradient))
    f = jax.vmap(partial(loss, grid, kernel_of("gimp", 2), None), in_axes)
    across = jax.jit(jax.grad(lambda *a: jnp.sum(f(*a)), (0, 1, 2)))(*lanes)
    assert_trees_close(across, tuple(g if i in batched else g.sum(0) for i, g in enumerate(gradient)))


def test_nested_vmap(x64):
    grid, position, carried, stress = data(2, 20)
    positions = jnp.stack([position, position + 0.1, position - 0.05])
    stresses = jnp.stack([stress, 2 * stress])

    def mapped(engine):
        def one(x, s):
            return p2g(grid, kernel_of("gimp", 2), x, carried, s, engine=engine)

        return jax.vmap(jax.vmap(one, (None, 0)), (0, None))(positions, stresses)

    assert mapped(None).shape == (3, 2, grid.nodes, 5)
    assert_trees_close(mapped(None), mapped(Engine.XLA))


@pytest.mark.parametrize("platform", ["cuda", "cpu"])
def test_devices_other_than_the_cpu_get_xla(platform):
    """Lowering needs no such device. In a batch, and differentiated."""
    grid, position, carried, stress = data(2, 5, dtype="float32")
    f = jax.jit(jax.vmap(jax.grad(partial(loss, grid, Linear(), None)), (0, None, None)))
    text = f.trace(position[None], carried, stress).lower(lowering_platforms=(platform,)).as_text()
    assert ("jaxmpm_scatter" in text) == ("jaxmpm_gather" in text) == (platform == "cpu" and native.available())
