"""Undrained strength by direction: its three strengths, its hardening, its limits, its derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import jaxmpm as mpm
from jaxmpm.laws import J2, AnisotropicUndrained, element_test
from jaxmpm.laws._anisotropic import Mobilisation
from tests.differences import check_derivatives

ACTIVE, SIMPLE, PASSIVE, G = 20e3, 16e3, 12e3, 5e6
NUMBERS = {"bulk": 5e7, "shear": G, "active": ACTIVE, "simple": SIMPLE, "passive": PASSIVE, "failure_strain": 0.05}


def clay(dtype=float, **values):
    return AnisotropicUndrained(**{name: jnp.asarray(value, dtype) for name, value in {**NUMBERS, **values}.items()})


@jax.jit
def updated(law, strain, stress, history):
    return law.update(strain, stress, history)


def compressed(law, strain, test="plane strain undrained", **choices):
    """Half the difference of vertical and horizontal stress at the end."""
    done = element_test(law, test, pressure=1e5, strain=strain, steps=400, **choices)
    return float(done.stress[-1, 0] - done.stress[-1, 2]) / 2


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("k0", [0.7, 1.0, 1.2])
def test_plane_strain_and_simple_shear_fail_at_their_strengths_whatever_the_stress_at_rest(k0):
    np.testing.assert_allclose(compressed(clay(), 0.2, k0=k0), ACTIVE, rtol=1e-6)
    np.testing.assert_allclose(compressed(clay(), -0.2, k0=k0), -PASSIVE, rtol=1e-6)
    sheared = element_test(clay(), "simple shear undrained", pressure=1e5, strain=0.4, k0=k0, steps=400)
    np.testing.assert_allclose(sheared.shear_stress[-1], SIMPLE, rtol=1e-6)


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("angle", [15.0, 30.0, 60.0, 75.0])
def test_between_them_strength_lies_on_the_ellipse(angle):
    # Shearing in the plane with principal strains turned by half the angle: Grimstad et al. (2012), Eq. 3 at kappa = 1.
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    increment = [1e-3 * c, 0.0, -1e-3 * c, 0.0, 0.0, 1e-3 * s]
    one = jnp.ones(1)
    law, history = clay(), Mobilisation(0 * one, (0 * one,) * 6)
    strain = tuple(one * each for each in increment)
    stress = (0 * one,) * 6
    for _ in range(400):
        stress, history = updated(law, strain, stress, history)
    across = (stress[0] - stress[2])[0] / 2 - (ACTIVE - PASSIVE) / 2
    along = stress[5][0] * (ACTIVE + PASSIVE) / (2 * SIMPLE)
    np.testing.assert_allclose(np.hypot(across, along), (ACTIVE + PASSIVE) / 2, rtol=1e-6)


@pytest.mark.usefixtures("x64")
def test_hardening_in_simple_shear_is_the_published_curve():
    # tau = kappa S at g = gamma - tau / G: Grimstad et al. (2012), Eq. 6.
    # Of equal active and passive strengths: others have to turn the stress first.
    law = clay(active=SIMPLE, passive=SIMPLE)
    test = element_test(law, "simple shear undrained", pressure=1e5, strain=0.06, steps=2000)
    tau = np.asarray(test.shear_stress)
    plastic = np.asarray(test.shear_strain) - tau / G
    root = np.sqrt(np.clip(plastic / 0.05, 0, 1))
    np.testing.assert_allclose(tau[1:], SIMPLE * (2 * root / (1 + root**2))[1:], rtol=1e-6)
    np.testing.assert_allclose(test.history.strain, plastic, atol=1e-6)


@pytest.mark.usefixtures("x64")
@given(st.lists(st.floats(-3e-3, 3e-3), min_size=12, max_size=12))
@settings(max_examples=40)
def test_equal_strengths_mobilised_at_once_are_those_of_j2(strains):
    alike = clay(active=SIMPLE, passive=SIMPLE, failure_strain=1e-9)
    mises = J2(*(jnp.asarray(each) for each in (5e7, G, SIMPLE)))
    one = jnp.ones(1)
    history = Mobilisation(one, (0 * one,) * 6)
    stress = other = (0 * one,) * 6
    for part in (strains[:6], strains[6:]):
        strain = tuple(one * each for each in part)
        stress, history = updated(alike, strain, stress, history)
        other, _ = updated(mises, strain, other, None)
    np.testing.assert_allclose(np.array(stress), np.array(other), atol=1e-3)


@pytest.mark.usefixtures("x64")
def test_derivatives_by_each_number_are_those_of_differences():
    def reached(values):
        law = AnisotropicUndrained(**values)
        sheared = element_test(law, "simple shear undrained", pressure=1e5, strain=0.02, k0=0.7, steps=40)
        return sheared.shear_stress[-1] + sheared.stress[-1, 0]

    check_derivatives(reached, NUMBERS, 2e-5)


def test_a_scene_starts_from_its_stress_at_rest_and_stays_there():
    soil = mpm.AnisotropicSoil(30e3, 24e3, 18e3, k0=0.6)
    drawn = mpm.Section([(0, 4), (4, 4), (8, 2), (12, 2)])
    scene, state = mpm.section(drawn, soil, mpm.Discretisation(1.0, (0.5, 0.5)))
    mean = (state.stress[0] + state.stress[1] + state.stress[2]) / 3
    np.testing.assert_allclose(state.history.rest[2], state.stress[2] - mean, atol=1.0)
    result = mpm.solve(scene, state, t_end=0.5).raise_if_failed()
    assert float(mpm.diagnostics.largest_displacement(result.state)) < 0.005
    assert mpm.reduced(scene, 2.0).material.passive == 9e3


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
@given(share=st.floats(0.05, 1.5), tiny=st.floats(-1e-9, 1e-9), sheared=st.floats(-0.9, 0.9))
@settings(max_examples=30, deadline=None)
def test_a_step_from_rest_is_finite_and_continuous_by_any_strength(dtype, share, tiny, sheared):
    """Stress at rest that the strength bears, or does not, as under strength reduction, and strain of rounding."""
    with jax.enable_x64(dtype == jnp.float64):
        law = clay(dtype, active=share * ACTIVE, simple=share * SIMPLE, passive=share * PASSIVE)
        one = jnp.ones(1, dtype)
        stress = tuple(one * component for component in (-6e4, -7e4, -1e5, 0.0, 0.0, 2e4 * sheared))
        history = law.history_at_rest(Mobilisation(0 * one, (0 * one,) * 6), stress)
        strains = (tuple(one * component for component in (size, 0, 0, 0, 0, size)) for size in (0, tiny))
        still, moved = (np.array(updated(law, strain, stress, history)[0]) for strain in strains)
        assert np.all(np.isfinite(still))
        elastic = abs(tiny) * (5e7 + 2 * G) + 1e5 * float(jnp.finfo(dtype).eps)
        np.testing.assert_allclose(moved, still, atol=3 * elastic)
