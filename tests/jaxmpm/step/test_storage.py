"""Stored arrays: the identity, in values, tangents, cotangents and batches, and present in the compiled program."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmpm.storage import stored, stored_in_reverse


def product(store, a, b):
    first, second = store([jnp.sin(a), a * b])
    return jnp.sum(first * second**2)


@pytest.mark.parametrize("store", [stored, stored_in_reverse])
def test_storing_is_the_identity_for_derivatives_and_batches(x64, store):
    a, b = np.random.default_rng(3).normal(size=(2, 4, 5))

    def derivatives(store):
        f = jax.grad(lambda a, b: product(store, a, b), argnums=(0, 1))
        return f(a[0], b[0]), jax.vmap(f, in_axes=(0, None))(a, b[1]), jax.jvp(f, (a, b), (b, a))

    for x, y in zip(jax.tree.leaves(derivatives(store)), jax.tree.leaves(derivatives(list)), strict=True):
        np.testing.assert_allclose(x, y, rtol=1e-13, atol=1e-13)


def test_only_the_cotangents_of_arrays_stored_in_reverse_are_written():
    a, b = jnp.ones((2, 8))

    def writes(function):
        return "dynamic_update_slice" in jax.jit(function).lower(a, b).as_text()

    assert not writes(lambda a, b: product(stored_in_reverse, a, b))
    assert writes(jax.grad(lambda a, b: product(stored_in_reverse, a, b)))
    assert writes(lambda a, b: product(stored, a, b))


def test_a_cotangent_that_is_not_there_is_zero():
    used = jax.grad(lambda a: jnp.sum(stored_in_reverse([a, a * a])[0]))(jnp.arange(3.0))
    np.testing.assert_array_equal(used, np.ones(3))
