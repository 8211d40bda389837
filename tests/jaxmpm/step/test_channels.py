"""Blocks of channels that are mapped together come back by their names, whatever stands beside them."""

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import jaxmpm as mpm
from jaxmpm.equations import Maps

NAMES = ("mass", "momentum", "history", "external", "unsoftened", "volume", "undrained")
WIDTHS = {"momentum": 2, "external": 2, "history": 3}


@pytest.fixture(scope="module")
def maps():
    scene, _ = mpm.block((2, 2), mpm.Soil(), mpm.Discretisation(1.0, (0.5, 0.5)), domain=(4, 4), corner=(1, 1))
    return Maps(scene, scene.particles.position)


@settings(max_examples=8, deadline=None)
@given(names=st.lists(st.sampled_from(NAMES), min_size=1, unique=True), stressed=st.booleans(), d=st.integers(0, 2))
def test_blocks_keep_their_names_in_any_order_and_company(maps, names, stressed, d):
    def values(name, length):
        random = np.random.default_rng(NAMES.index(name))
        return jnp.asarray(random.normal(size=(WIDTHS.get(name, 1), length)), jnp.float32)

    count, nodes = maps.position.shape[1], maps.scene.grid.nodes
    stress = jnp.ones((3, count), jnp.float32) if stressed else None
    sums = maps.sums({name: values(name, count) for name in names}, stress)
    assert list(sums) == names + ["force"] * stressed
    for name in names:
        np.testing.assert_allclose(sums[name], maps.to_all_nodes(values(name, count), None), atol=1e-5)
    if stressed:
        np.testing.assert_allclose(sums["force"], maps.to_all_nodes(None, stress), atol=1e-5)

    fields = {name: values(name, nodes).T for name in names}
    first = fields[names[0]].shape[1]
    back, gradient = maps.values(fields, gradients=min(d, first))
    assert list(back) == names
    for name in names:
        alone, _ = maps.to_particles(fields[name], values=fields[name].shape[1], gradients=0)
        np.testing.assert_allclose(back[name], alone, atol=1e-5)
    assert (gradient is None) == (min(d, first) == 0)
    if gradient is not None:
        _, slope = maps.to_particles(fields[names[0]], values=0, gradients=min(d, first))
        np.testing.assert_allclose(gradient, slope, atol=1e-5)
