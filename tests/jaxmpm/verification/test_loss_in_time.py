"""Undrained strength that is lost over time: the law, its zones, and a layer on a plane that begins to flow."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxmpm as mpm
from jaxmpm.laws import LossInTime, at_time, weakens_until

THICKNESS, DENSITY, PULL, LEFT, LOSS = 1.0, 2000.0, 2000.0, 0.25, 0.4
NUMERICS = mpm.Discretisation(0.25, (0.125,) * 2, dtype="float64")
CLAY = mpm.Soil(
    unit_weight=DENSITY * 9.81, young=1e6, strength=4000.0, residual_ratio=LEFT, loss_time=LOSS, tension_cutoff=None,
    unusual=True,
)  # fmt: skip


def layer(soil):
    """A layer on a rough plane that pulls with PULL (N/m3): its base bears a shear stress of 2 kPa."""
    drawn = mpm.Section([(0, THICKNESS), (1, THICKNESS)])
    return mpm.section(drawn, soil, NUMERICS, ends="tied", k_h=PULL / soil.unit_weight)


@pytest.mark.parametrize("time", [0.0, 0.1, 0.4, 3.0])
def test_the_strength_falls_in_proportion_to_time_and_then_stays(time):
    law = mpm.laws.J2(8e6, 3e6, 4e4, loss=LossInTime(LEFT, LOSS))
    of_then = at_time(law, jnp.asarray(time))
    assert of_then.loss is None
    assert float(of_then.strength) == pytest.approx(4e4 * np.interp(time, [0, LOSS], [1, LEFT]))


def test_zones_lose_their_own_and_the_rest_of_the_ground_stays_as_it_is():
    lost, kept = mpm.laws.J2(8e6, 3e6, 4e4, loss=LossInTime(LEFT, LOSS)), mpm.laws.J2(8e6, 3e6, 3e4)
    ground = mpm.laws.Zoned((lost, kept), (2, 3))
    after = at_time(ground, jnp.asarray(10.0))
    np.testing.assert_allclose(after.per_particle([law.strength for law in after.laws]), [1e4] * 2 + [3e4] * 3)
    assert float(weakens_until(ground)) == pytest.approx(LOSS)
    assert weakens_until(kept) is None
    assert at_time(kept, jnp.asarray(10.0)) is kept


def test_a_layer_moves_as_one_whose_strength_is_given_anew_before_each_step(x64):
    scene, state = layer(CLAY)
    plain, dt = layer(replace(CLAY, loss_time=None))[0], float(scene.numerics.time_step)
    steps = 1.5 * LOSS / dt

    def weakened(number, now):
        left = jnp.interp((number + 1) * dt, jnp.asarray([0, LOSS]), jnp.asarray([1, LEFT]))
        return mpm.step(mpm.with_soil(plain, now, strength=CLAY.strength * left)[0], now, dt)

    exact = jax.lax.fori_loop(0, int(steps), weakened, state)
    after = jax.lax.fori_loop(0, int(steps), lambda _, now: mpm.step(scene, now, dt), state)
    np.testing.assert_allclose(after.velocity, exact.velocity, rtol=0, atol=1e-10)
    assert float(jnp.max(after.velocity[0])) > 0.1
    # It gains no more than what its base does not bear once that bears less than the pull.
    starts, rate = LOSS * (1 - PULL * THICKNESS / CLAY.strength) / (1 - LEFT), CLAY.strength * (1 - LEFT) / LOSS
    gained = rate * (LOSS - starts) ** 2 / 2 + (PULL * THICKNESS - LEFT * CLAY.strength) * LOSS / 2
    assert 0.7 * gained < float(jnp.sum(scene.particles.mass * after.velocity[0])) < gained


def test_soil_that_has_yet_to_lose_its_strength_has_not_settled(x64):
    scene, state = layer(replace(CLAY, loss_time=4.0, strength=2.5e3, residual_ratio=0.5))
    rules = [mpm.Settle(hold=0.3), mpm.Exceeds(0.5)]
    ended = mpm.solve(scene, state, t_end=8.0, rules=rules)
    assert mpm.Status(int(ended.status)) is mpm.Status.DECIDED


def test_its_derivative_is_that_of_differences(x64):
    scene, state = layer(CLAY)
    dt = scene.numerics.time_step

    @jax.jit
    def speed(duration):
        given, _ = mpm.with_soil(scene, state, loss_time=duration)
        after = jax.lax.fori_loop(0, 150, lambda _, now: mpm.step(given, now, dt), state)
        return jnp.mean(after.velocity[0])

    slope, by = jax.jacfwd(speed)(LOSS / 20), 1e-6
    differences = (speed(LOSS / 20 + by) - speed(LOSS / 20 - by)) / (2 * by)
    assert float(slope) == pytest.approx(float(differences), rel=1e-4)
    assert float(slope) < 0


def test_what_does_not_go_with_it_is_refused(x64):
    for name, value in (("softening_modulus", 1e3), ("strain_95", 1.0)):
        with pytest.raises(ValueError, match=f"both loss_time and {name}"):
            layer(replace(CLAY, **{name: value}))
    scene, state = layer(CLAY)
    with pytest.raises(ValueError, match="at_time"):
        scene.material.update((0.0,) * 6, (jnp.zeros(()),) * 6, None)
    with pytest.raises(ValueError, match="has no limit load"):
        mpm.factor_of_safety(scene, state, criterion="limit load")
