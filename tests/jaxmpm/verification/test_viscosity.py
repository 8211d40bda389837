"""Bingham's viscosity of undrained soil: simple shear, a layer that flows down a plane, and the stiff limit."""

import math
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxmpm as mpm
from tests.verification import order

K, G, PEAK, VISCOSITY = 8e6, 3e6, 4e4, 2e5
SOFTENINGS = {
    "none": None,
    "linear": mpm.laws.Softening(1e6, 0.25),
    "exponential": mpm.laws.ExponentialSoftening(0.25, 0.05),
}


def sheared(law, *, rate, duration, steps):
    """Shear stress (Pa) after simple shear at a constant rate (1/s), in the precision of the law's numbers."""
    dtype = law.viscosity.dtype if law.viscosity is not None else law.shear.dtype
    dt = jnp.asarray(duration / steps, dtype)
    zero = jnp.zeros((), dtype)
    increment = (0.0, 0.0, 0.0, 0.0, 0.0, rate * dt / 2)
    start = (zero,) * 6, None if law.softening is None else zero
    stress, _ = jax.lax.fori_loop(0, steps, lambda _, s: law.update(increment, *s, dt), start)
    return stress[5]


def bingham(softening, viscosity=VISCOSITY, dtype=jnp.float64):
    law = mpm.laws.J2(K, G, PEAK, SOFTENINGS[softening], viscosity=viscosity)
    return jax.tree.map(lambda value: jnp.asarray(value, dtype), law)


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("softening", SOFTENINGS)
@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_steady_simple_shear_has_the_softened_strength_plus_viscosity_times_rate(softening, dtype):
    left = PEAK if softening == "none" else 0.25 * PEAK
    for rate in (0.01, 1.0, 100.0):
        stress = sheared(bingham(softening, dtype=dtype), rate=rate, duration=2 + 2 / rate, steps=400)
        assert stress.dtype == dtype
        assert float(stress) == pytest.approx(left + VISCOSITY * rate, rel=1e-6 if dtype == jnp.float64 else 1e-4)


def test_a_viscosity_needs_the_time_step():
    with pytest.raises(ValueError, match="a viscosity needs the time step"):
        bingham("none", dtype=jnp.float32).update((0.0,) * 6, (jnp.zeros(()),) * 6, None)


@pytest.mark.usefixtures("x64")
def test_the_approach_to_steady_shear_is_exponential_and_of_first_order_in_the_step():
    # After yield the stress beyond the strength s obeys s' = G (rate - s / eta).
    rate, counts = 1.0, np.array([100, 200, 400])
    duration = PEAK / (G * rate) + VISCOSITY / G
    exact = PEAK + VISCOSITY * rate * (1 - math.exp(-1))
    errors = [abs(float(sheared(bingham("none"), rate=rate, duration=duration, steps=n)) - exact) for n in counts]
    assert order(1 / counts, errors) > 0.9
    assert errors[-1] < 1e-3 * exact


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("softening", SOFTENINGS)
def test_a_viscosity_of_0_changes_nothing_and_its_derivative_is_that_of_differences(softening):
    def stress(viscosity):
        return sheared(bingham(softening, viscosity), rate=1.0, duration=0.05, steps=20)

    assert float(stress(0.0)) == pytest.approx(float(stress(None)), rel=1e-12)
    each = jnp.asarray([1e3, 1e4, 1e5])
    derivative = jax.vmap(jax.grad(stress))(each)
    differences = (jax.vmap(stress)(each * (1 + 1e-5)) - jax.vmap(stress)(each * (1 - 1e-5))) / (2e-5 * each)
    np.testing.assert_allclose(derivative, differences, rtol=1e-6)
    assert np.all(np.asarray(derivative) > 0)


THICKNESS, DENSITY, PULL = 1.0, 2000.0, 2000.0
NUMERICS = mpm.Discretisation(0.125, (0.0625,) * 2, dtype="float64")
CLAY = mpm.Soil(unit_weight=DENSITY * 9.81, young=1e6, strength=500.0, viscosity=2e4, tension_cutoff=None, unusual=True)


def down_a_plane(soil, duration, at_rest=True):
    """A layer on a rough plane, PULL (N/m3) along it: scene, heights (m) and velocities (m/s) at the end."""
    drawn = mpm.Section([(0, THICKNESS), (0.5, THICKNESS)])
    scene, state = mpm.section(drawn, soil, NUMERICS, ends="tied", k_h=PULL / soil.unit_weight, at_rest=at_rest)
    ended = mpm.solve(scene, state, t_end=duration).raise_if_failed().state
    return scene, np.asarray(scene.particles.position[1] + ended.displacement[1]), np.asarray(ended.velocity[0])


def test_a_layer_flows_down_a_plane_with_the_profile_and_plug_of_bingham(x64):
    # Shear stress PULL (h - z) exceeds the strength below a plug of thickness strength / PULL.
    _, height, velocity = down_a_plane(CLAY, 0.6)
    height = height - height.min() + NUMERICS.spacing[1] / 2
    base = THICKNESS - CLAY.strength / PULL
    fastest = PULL * base**2 / (2 * CLAY.viscosity)
    exact = fastest * (1 - np.maximum(1 - height / base, 0) ** 2)
    assert np.max(np.abs(velocity - exact)) < 0.01 * fastest
    assert np.ptp(velocity[height > base + NUMERICS.cell]) < 0.01 * fastest


def test_without_bound_on_viscosity_soil_stays_elastic_at_the_same_time_step(x64):
    stiff, elastic = (
        down_a_plane(replace(CLAY, **given), 0.2, at_rest=False) for given in ({"viscosity": 1e15}, {"strength": None})
    )
    assert float(stiff[0].numerics.time_step) == float(elastic[0].numerics.time_step)
    assert np.abs(elastic[2]).max() > 0.05
    np.testing.assert_allclose(stiff[2], elastic[2], atol=1e-6)
