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


def by_shares(function: Callable[..., jax.Array], at: Mapping[str, float], step: float = 1e-5) -> np.ndarray:
    """Central differences of a function of named numbers by a factor on each, over `step` either way."""
    names, n = list(at), len(at)

    def varied(factors: jax.Array) -> jax.Array:
        return function({name: at[name] * factor for name, factor in zip(names, factors, strict=True)})

    lanes = jnp.concatenate([jnp.ones((n, n)) + step * jnp.eye(n), jnp.ones((n, n)) - step * jnp.eye(n)])
    ahead, behind = jnp.split(jax.jit(jax.vmap(varied))(lanes), 2)
    return np.asarray((ahead - behind) / (2 * step))


def check_derivatives(function: Callable[..., jax.Array], at: Mapping[str, float], tolerance: float) -> None:
    """Assert that gradients by named numbers, times the number, are differences, to a share of the largest of them."""
    differences, gradients = by_shares(function, at), jax.jit(jax.grad(function))(dict(at))
    slopes = [float(gradients[name]) * at[name] for name in at]
    np.testing.assert_allclose(slopes, differences, atol=tolerance * abs(differences).max(), rtol=0)
