"""What holds of every run in float64: its gradient is that of differences, its lanes and both engines give the same."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import jax
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
    other = jax.jit(run)(replace(scene, engine=mpm.Engine.XLA), *at)
    np.testing.assert_allclose(other, value, rtol=1e-11)
