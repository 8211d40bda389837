"""What holds in float64: gradients are those of differences, and a run's lanes and both engines give the same."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

import jaxmpm as mpm


def check_run(run: Callable[..., jax.Array], scene: mpm.Scene, at: Sequence, steps: Sequence, tolerance: float) -> None:
    """Assert it of `run(scene, *at)`, a number: gradients by each of `at` against central differences over `steps`
    either way to the relative `tolerance`, lanes and engines to rounding."""
    at, numbers = np.asarray(at, float), tuple(range(1, len(at) + 1))
    value, slopes = jax.jit(jax.value_and_grad(run, argnums=numbers))(scene, *at)
    changes = np.diag(np.asarray(steps, float))
    lanes = (at + np.concatenate([np.zeros((1, len(at))), changes, -changes])).T
    here, *varied = np.asarray(jax.jit(jax.vmap(run, in_axes=(None, *[0] * len(at))))(scene, *lanes))
    ahead, behind = np.split(np.asarray(varied), 2)
    assert np.all(ahead != behind)
    np.testing.assert_allclose(slopes, (ahead - behind) / (2 * np.asarray(steps)), rtol=tolerance)
    np.testing.assert_allclose(here, value, rtol=1e-12)
    other = jax.jit(run)(replace(scene, numerics=replace(scene.numerics, engine=mpm.Engine.XLA)), *at)
    np.testing.assert_allclose(other, value, rtol=1e-11)


def check_derivatives(function: Callable[..., jax.Array], at: Mapping[str, float], tolerance: float) -> None:
    """Assert that the gradient of `function` by each named number, times the number, is that of central differences, to
    a share of the largest of them."""
    names, values = list(at), jnp.asarray(list(at.values()))

    def of_shares(shares: jax.Array) -> jax.Array:
        return function(dict(zip(names, values * shares, strict=True)))

    ones, step = jnp.ones(len(names)), 1e-5
    lanes = jnp.concatenate([ones + step * jnp.eye(len(names)), ones - step * jnp.eye(len(names))])
    ahead, behind = jnp.split(jax.vmap(of_shares)(lanes), 2)
    differences = np.asarray((ahead - behind) / (2 * step))
    np.testing.assert_allclose(jax.grad(of_shares)(ones), differences, atol=tolerance * abs(differences).max(), rtol=0)
