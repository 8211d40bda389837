"""Set-up works on the host where nothing is traced: it compiles no program for a number of particles."""

from collections.abc import Iterator
from contextlib import contextmanager

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxmpm as mpm
from jaxmpm.support.tracing import array, on_host, product, taken, zeros_like


@contextmanager
def programs() -> Iterator[list[str]]:
    """Names of the programs that are compiled, or read from the cache, meanwhile."""
    compiled: list[str] = []

    def listen(event: str, _: float, **words: object) -> None:
        if event.endswith("backend_compile_duration"):
            compiled.append(str(words.get("fun_name")))

    jax.monitoring.register_event_duration_secs_listener(listen)
    try:
        yield compiled
    finally:
        jax.monitoring.unregister_event_duration_listener(listen)


def test_arrays_are_made_without_a_program_for_their_shape():
    values = np.arange(22.0).reshape(2, 11)
    with programs() as compiled:
        single = array(values, np.float32)
        order = np.array([3, 1, 7])
        made = taken(single, order), taken(single, slice(2, 5)), product(single, values[0]), zeros_like(single)
        assert array(single, np.float32) is single
    assert compiled == []
    expected = values[:, order], values[:, 2:5], values * values[0], 0 * values
    for known, own in zip(made, expected, strict=True):
        assert known.dtype == np.float32
        np.testing.assert_array_equal(known, own.astype(np.float32))
    with programs() as compiled:
        (single + 1).block_until_ready()
    assert compiled  # a program of this shape is seen


def test_an_array_is_a_copy():
    values = np.arange(64, dtype=np.float32)
    made = array(values, np.float32)
    values[:] = -1
    np.testing.assert_array_equal(made, np.arange(64))


def test_what_is_traced_stays_traced_and_the_rest_is_known():
    values, order = jnp.arange(5.0), np.array([4, 0])

    def function(traced: jax.Array) -> jax.Array:
        assert isinstance(on_host(values), np.ndarray)
        assert on_host(traced) is traced
        for known in (array(2.0, np.float32), taken(values, order), product(values, values), zeros_like(traced)):
            assert not isinstance(known, jax.core.Tracer)
        return taken(traced, order) + product(traced, values)[order] + array(traced, np.float32)[order]

    np.testing.assert_allclose(jax.jit(function)(values), [4 + 16 + 4, 0])


@pytest.mark.parametrize("soil", [mpm.Soil(strength=42e3, softening_modulus=85e3), mpm.FrictionalSoil(5e3, 30.0)])
def test_a_block_of_another_number_of_particles_compiles_nothing(soil):
    discretisation = mpm.Discretisation(1.0, (0.5, 0.5))

    def block(width: float) -> tuple[mpm.Scene, mpm.State]:
        return mpm.block((width, 2.0), soil, discretisation, domain=(9.0, 4.0), corner=(1.0, 1.0), velocity=(1.0, 0.0))

    block(3.0)
    with programs() as compiled:
        _, state = block(3.5)
    assert state.velocity.shape == (2, 28)
    assert compiled == []
