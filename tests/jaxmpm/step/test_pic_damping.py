"""Damping of what the grid does not resolve, at a rate in time."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxmpm as mpm
from jaxmpm import diagnostics

ELASTIC = mpm.Soil(strength=1e6, unit_weight=9810.0, young=1e6, poisson=0.0, tension_cutoff=0.0)
RATE = 4.0


def alternating(cfl=0.5, rate=RATE):
    """A bar whose neighbouring particles move against each other: nothing moves on the grid but at its ends."""
    numerics = mpm.Discretisation(1.0, (0.5,), cfl=cfl, pic_damping=rate)
    scene, state = mpm.block((60.0,), ELASTIC, numerics, domain=(64.0,), corner=(2.0,), speed=1.0)
    velocity = 0.1 * (-1.0) ** jnp.arange(state.velocity.shape[1])
    return scene, replace(state, velocity=velocity[None].astype(state.velocity.dtype))


@pytest.mark.parametrize("cfl", [0.5, 0.125])
def test_what_the_grid_does_not_resolve_decays_at_the_rate_whatever_the_time_step(cfl):
    scene, state = alternating(cfl)
    steps = round(5.0 / cfl)
    final = mpm.advance(scene, state, steps)
    middle = slice(40, 80)
    expected = float(jnp.exp(-RATE * steps * scene.numerics.time_step)) * np.asarray(state.velocity)[0, middle]
    assert 0.2 < expected[0] / 0.1 < 0.8
    np.testing.assert_allclose(np.asarray(final.velocity)[0, middle], expected, rtol=1e-4)


def test_momentum_stays():
    scene, state = alternating()
    state = replace(state, velocity=state.velocity * jnp.linspace(0, 2, state.velocity.shape[1], dtype=jnp.float32))
    scale = float(jnp.sum(scene.particles.mass * jnp.abs(state.velocity)))
    before, after = (diagnostics.momentum(scene, s) for s in (state, mpm.advance(scene, state, 20)))
    np.testing.assert_allclose(np.asarray(after), np.asarray(before), atol=1e-5 * scale)


def test_resolved_motion_loses_with_the_square_of_the_cell():
    """A share of PIC in every step loses with the cell itself."""

    def lost(cells, **choices):
        energy = []
        for given in ({}, choices):
            numerics = mpm.Discretisation(25.0 / cells, (12.5 / cells,), cfl=0.2, **given)
            scene, state = mpm.bar(25.0, ELASTIC, numerics, velocity=0.1)
            final = mpm.advance(scene, state, 32 * cells)
            energy.append(float(diagnostics.kinetic_energy(scene, final) + diagnostics.elastic_energy(scene, final)))
        return 1 - energy[1] / energy[0]

    assert lost(10, pic_damping=RATE) / lost(20, pic_damping=RATE) == pytest.approx(4.0, abs=0.4)
    assert lost(10, flip=0.99) / lost(20, flip=0.99) == pytest.approx(2.0, abs=0.2)


def test_lanes_with_rates_of_their_own_move_as_single_runs():
    scene, state = alternating()
    rates = jnp.asarray([0.0, 1.0, 5.0], jnp.float32)

    @jax.jit
    def after(rate):
        return mpm.step(
            replace(scene, numerics=replace(scene.numerics, pic_damping=rate)), state, scene.numerics.time_step
        ).velocity

    np.testing.assert_array_equal(jax.vmap(after)(rates), jnp.stack([after(rate) for rate in rates]))


def test_two_shares_of_pic_are_refused():
    with pytest.raises(ValueError, match=r"pic_damping = 1 1/s with flip = 0\.9: both set the share of PIC"):
        mpm.block(
            (4.0,), ELASTIC, mpm.Discretisation(1.0, (0.5,), flip=0.9, pic_damping=1.0), domain=(8.0,), corner=(2.0,)
        )
