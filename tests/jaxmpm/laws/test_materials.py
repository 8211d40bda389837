"""Constitutive laws along paths with a closed form."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import jaxmpm as mpm
from jaxmpm.tensors import deviator, mean, rotate, second_invariant

K, G, S0, H, RATIO = 8e6, 3e6, 40e3, 85e3, 0.5


def soil(cutoff=None, softening=True, strength=S0):
    soft = mpm.laws.Softening(jnp.asarray(H), jnp.asarray(RATIO)) if softening else None
    return mpm.laws.J2(jnp.asarray(K), jnp.asarray(G), jnp.asarray(strength), soft, cutoff)


def shear_path(law, gamma, steps):
    """Simple shear: stress after `gamma` in equal steps."""
    stress, history = (jnp.zeros(()),) * 6, jnp.zeros(())
    for _ in range(steps):
        stress, history = law.update((0.0, 0.0, 0.0, 0.0, 0.0, gamma / steps / 2), stress, history)
    return stress, history


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("steps", [1, 7, 200])
def test_simple_shear_softens_as_eq_23_whatever_the_step(steps):
    # The return is implicit in the softening, so a monotonic path does not depend on its steps.
    gamma = 0.15
    stress, g = shear_path(soil(), gamma, steps)
    # tau = G (gamma - g) = S0 - H g
    expected_g = (G * gamma - S0) / (G - H)
    assert np.isclose(g, expected_g, rtol=1e-12)
    assert np.isclose(stress[5], S0 - H * expected_g, rtol=1e-12)


@pytest.mark.usefixtures("x64")
def test_simple_shear_ends_at_the_residual_strength():
    stress, g = shear_path(soil(), 0.5, 3)
    assert np.isclose(stress[5], RATIO * S0, rtol=1e-12)
    assert np.isclose(g, 0.5 - RATIO * S0 / G, rtol=1e-12)


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("steepness", [0.5, 0.7, 0.95])
def test_strength_that_falls_faster_than_its_rate_allows_falls_to_the_residual(steepness):
    effect = mpm.laws.RateEffect(0.1, 3e-6)
    soft = mpm.laws.Softening(jnp.asarray(steepness * G), jnp.asarray(RATIO))
    law = mpm.laws.J2(jnp.asarray(K), jnp.asarray(G), jnp.asarray(S0), soft, None, effect)
    stress, history, dt = (jnp.zeros(()),) * 6, jnp.zeros(()), 1e-3  # at a rate of 1 1/s, which counts 1.55 times
    reached = []
    for _ in range(400):
        stress, history = law.update((0.0, 0.0, 0.0, 0.0, 0.0, dt / 2), stress, history, dt)
        reached.append(float(stress[5]))
    factor = 1 + 0.1 * np.log10(1 / 3e-6)
    assert S0 < max(reached) <= factor * S0 * (1 + 1e-9)
    assert np.isclose(reached[-1], RATIO * factor * S0, rtol=1e-6)


@pytest.mark.usefixtures("x64")
def test_plane_strain_compression_yields_at_tresca():
    # Plane strain at constant volume: half the difference of the in-plane stresses is the undrained strength.
    law = soil(softening=False)
    stress = (jnp.zeros(()),) * 6
    for _ in range(400):
        stress, _ = law.update((1e-4, 0.0, -1e-4, 0.0, 0.0, 0.0), stress, None)
    assert np.isclose((stress[0] - stress[2]) / 2, S0, rtol=1e-12)


@pytest.mark.usefixtures("x64")
@given(
    increments=st.lists(st.floats(-0.02, 0.02), min_size=12, max_size=12),
    start=st.lists(st.floats(-3e4, 3e4), min_size=6, max_size=6),
)
def test_stress_never_leaves_the_yield_surface_and_strain_hardens_never(increments, start):
    law, stress, g = soil(), tuple(jnp.asarray(s) for s in start), jnp.zeros(())
    for part in (increments[:6], increments[6:]):
        trial, before = stress, g
        stress, g = law.update(tuple(jnp.asarray(e) for e in part), trial, g)
        limit = jnp.maximum(S0 - H * g, RATIO * S0)
        assert jnp.sqrt(second_invariant(deviator(stress))) <= limit * (1 + 1e-12)
        assert g >= before


@pytest.mark.usefixtures("x64")
def test_tension_cutoff_limits_the_mean_stress_only():
    stretched = (0.01, 0.01, 0.01, 0.0, 0.0, 1e-3)
    free, _ = soil(softening=False).update(stretched, (jnp.zeros(()),) * 6, None)
    cut, _ = soil(cutoff=jnp.asarray(1e3), softening=False).update(stretched, (jnp.zeros(()),) * 6, None)
    assert np.isclose(mean(free), K * 0.03)
    assert np.isclose(mean(cut), 1e3)
    assert np.isclose(cut[5], free[5])


@pytest.mark.usefixtures("x64")
def test_jaumann_rotation_keeps_invariants_to_second_order_and_matches_a_finite_rotation():
    stress = tuple(jnp.asarray(s) for s in (1.0, -2.0, 0.5, 0.3, -0.7, 1.1))
    angle, errors = 0.3, []
    axis = np.array([1.0, -2.0, 0.5]) / np.linalg.norm([1.0, -2.0, 0.5])
    w = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    q = jax.scipy.linalg.expm(angle * w)
    xx, yy, zz, xy, yz, xz = stress
    full = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    exact = np.asarray(q @ full @ q.T)
    for steps in (50, 100):
        turned = stress
        for _ in range(steps):
            turned = rotate(turned, jnp.asarray(w), angle / steps)
        errors.append(abs(float(turned[5]) - exact[0, 2]))
    assert errors[1] < 0.02
    assert 1.8 < errors[0] / errors[1] < 2.2  # first order in the step


def test_without_softening_there_is_no_history():
    particles = mpm.Particles(jnp.zeros((3, 5)), jnp.ones(5), jnp.ones(5))
    assert soil(softening=False).initial_history(particles) is None
    assert soil().initial_history(particles).shape == (5,)
