"""XPIC(m): the share of PIC keeps what m transfers to the grid and back resolve."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxmpm as mpm
from jaxmpm import diagnostics

ELASTIC = mpm.Soil(strength=1e6, unit_weight=9810.0, young=1e6, poisson=0.0, tension_cutoff=0.0)


def bar(xpic, velocity, *, flip=0.0, scheme=mpm.Scheme.MUSL):
    """A bar without stress whose particles have a velocity (m/s), a function of the particle's number."""
    numerics = mpm.Discretisation(1.0, (0.5,), flip=flip, xpic=xpic, scheme=scheme)
    scene, state = mpm.block((60.0,), ELASTIC, numerics, domain=(64.0,), corner=(2.0,), speed=1.0)
    given = velocity(np.arange(state.velocity.shape[1]))
    return scene, replace(state, velocity=jnp.asarray(given[None], state.velocity.dtype))


def alternating(number):
    """Neighbours move against each other: nothing moves on the grid but at the ends of the bar."""
    return 0.1 * (-1.0) ** number


def wave(number):
    """Four cells long."""
    return 0.1 * np.sin(2 * np.pi * number / 8)


@pytest.mark.parametrize("scheme", mpm.Scheme)
@pytest.mark.parametrize("xpic", [1, 2, 5])
def test_what_the_grid_does_not_resolve_is_gone_after_a_step(xpic, scheme):
    scene, state = bar(xpic, alternating, scheme=scheme)
    after = np.asarray(mpm.step(scene, state, scene.numerics.time_step).velocity)[0]
    assert abs(after[40:80]).max() < 1e-6


@pytest.mark.parametrize("xpic", [2, 3, 5])
def test_it_takes_away_what_transfers_to_the_grid_and_back_leave_out(xpic):
    """(1 - P)^m of the velocity, P the interpolated velocity of the grid, by a second way."""
    scene, state = bar(xpic, wave)
    left = state
    for _ in range(xpic):
        left = replace(left, velocity=left.velocity - diagnostics.grid_velocity(scene, left))
    after = mpm.step(scene, state, scene.numerics.time_step).velocity
    np.testing.assert_allclose(np.asarray(state.velocity - after), np.asarray(left.velocity), atol=1e-7)


def test_higher_orders_keep_more_of_what_the_grid_resolves_in_part():
    lost = []
    for xpic in (1, 2, 5):
        scene, state = bar(xpic, wave)
        change = mpm.step(scene, state, scene.numerics.time_step).velocity - state.velocity
        lost.append(float(jnp.linalg.norm(change[0, 40:80])))
    assert lost[1] < lost[0] / 2
    assert lost[2] < lost[1]


def test_order_one_is_pic():
    """The interpolated velocity of the grid, a second way to the same number."""
    scene, state = bar(1, wave)
    expected = diagnostics.grid_velocity(scene, state)
    after = mpm.step(scene, state, scene.numerics.time_step).velocity
    np.testing.assert_allclose(np.asarray(after), np.asarray(expected), atol=1e-8)


@pytest.mark.parametrize("xpic", [2, 5])
def test_momentum_stays(xpic):
    scene, state = bar(xpic, lambda number: alternating(number) * number / 60 + wave(number), flip=0.5)
    scale = float(jnp.sum(scene.particles.mass * jnp.abs(state.velocity)))
    before, after = (diagnostics.momentum(scene, s) for s in (state, mpm.advance(scene, state, 20)))
    np.testing.assert_allclose(np.asarray(after), np.asarray(before), atol=1e-5 * scale)


def test_lanes_move_as_single_runs():
    scene, state = bar(2, wave)
    scales = jnp.asarray([0.5, 1.0, 2.0], jnp.float32)

    @jax.jit
    def after(scale):
        return mpm.step(scene, replace(state, velocity=scale * state.velocity), scene.numerics.time_step).velocity

    np.testing.assert_array_equal(jax.vmap(after)(scales), jnp.stack([after(scale) for scale in scales]))


def test_gradients_are_those_of_differences():
    scene, state = bar(3, wave)

    def energy(scale):
        moving = replace(state, velocity=scale * state.velocity)
        for _ in range(4):
            moving = mpm.step(scene, moving, scene.numerics.time_step)
        return diagnostics.kinetic_energy(scene, moving)

    slope = jax.grad(energy)(1.0)
    expected = (energy(1.01) - energy(0.99)) / 0.02
    assert float(slope) == pytest.approx(float(expected), rel=1e-3)


@pytest.mark.parametrize(
    ("choices", "message"),
    [
        ({"xpic": 2}, "xpic = 2 filters the share of PIC: give flip below 1 or pic_damping with it"),
        ({"xpic": 0, "flip": 0.0}, "xpic = 0: give a whole number of 1 or more"),
        ({"xpic": 2, "flip": 0.0, "apic": True, "kernel": mpm.QuadraticBSpline}, "and no apic"),
    ],
)
def test_choices_that_do_not_go_together_are_refused(choices, message):
    with pytest.raises(ValueError, match=message):
        mpm.block((4.0,), ELASTIC, mpm.Discretisation(1.0, (0.5,), **choices), domain=(8.0,), corner=(2.0,))
