"""Soil with a B-value: closed forms of the laboratory, derivatives, and what it leaves alone."""

import math
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq

from jaxmpm.laws import DruckerPrager, Elastic, Matching, ModifiedCamClay, MohrCoulomb, Saturated, Sealed, element_test
from tests.differences import check_derivatives

pytestmark = pytest.mark.usefixtures("x64")

BULK, SHEAR, P0 = 1e7, 6e6, 1e5
COHESION, FRICTION = 2e3, 0.6
M = 6 * math.sin(FRICTION) / (3 - math.sin(FRICTION))
INTERCEPT = 6 * COHESION * math.cos(FRICTION) / (3 - math.sin(FRICTION))
B_VALUES = np.repeat([0.05, 0.3, 0.7, 0.95, 0.99], 3)
DILATIONS = np.tile([-0.1, 0.0, 0.07], 5)


def sealed(kind, b_value, **numbers):
    law = {name: jnp.asarray(value, float) for name, value in {"bulk": BULK, "shear": SHEAR, **numbers}.items()}
    choices = {"matching": Matching.COMPRESSION} if kind is DruckerPrager else {}
    return Saturated(kind(**law, **choices), jnp.asarray(b_value, float))


def frictional(kind, b_value, *, cohesion=COHESION, dilation=0.0):
    return sealed(kind, b_value, cohesion=cohesion, friction=FRICTION, dilation=dilation)


def held(law, test="triaxial drained", *, strain, steps=400):
    """A test whose cell or vertical pressure is held, with total stress, and its excess pressure."""
    run = element_test(law, test, pressure=P0, strain=strain, steps=steps)
    return run, np.asarray(law.excess_pressure(run.history))


def test_elastic_soil_has_the_b_value_of_skempton():
    run, excess = held(sealed(Elastic, B_VALUES), strain=1e-6, steps=5)
    np.testing.assert_allclose(excess[1:], B_VALUES * (np.asarray(run.pressure)[1:] - P0), rtol=1e-5)


def test_water_in_one_dimension_bears_its_share_of_the_stiffness():
    run, excess = held(sealed(Elastic, B_VALUES), "oedometer", strain=1e-6, steps=5)
    water = BULK * B_VALUES / (1 - B_VALUES)
    share = water / (water + BULK + 4 * SHEAR / 3)
    np.testing.assert_allclose(excess[1:], share * (np.asarray(run.vertical_stress)[1:] - P0), rtol=1e-5)


@pytest.mark.parametrize("kind", [MohrCoulomb, DruckerPrager])
def test_undrained_strength_of_soil_that_contracts_or_dilates(kind):
    """Under a held cell pressure q rises to k + M p' and then along it, by the volume that water denies.

    dp' = (1 - B) dq / 3 + B K beta de, with beta the plastic growth of volume for each plastic shear strain de.
    """
    run, excess = held(frictional(kind, B_VALUES, dilation=DILATIONS), strain=0.03)
    beta = 6 * np.sin(DILATIONS) / (3 - np.sin(DILATIONS))
    share = 1 - M * (1 - B_VALUES) / 3
    hardening = M * B_VALUES * BULK * beta / share
    strain = np.asarray(run.axial_strain - run.volumetric_strain / 3)
    peak = (INTERCEPT + M * P0) / share
    beyond = strain - peak / (3 * SHEAR)
    assert np.all(beyond[-1] > 0.01)
    q = np.where(beyond < 0, 3 * SHEAR * strain, peak + 3 * SHEAR * hardening / (3 * SHEAR + hardening) * beyond)
    np.testing.assert_allclose(np.asarray(run.deviatoric), q, rtol=2e-3, atol=1)
    effective = np.where(beyond < 0, P0 + (1 - B_VALUES) * q / 3, (q - INTERCEPT) / M)
    np.testing.assert_allclose(np.asarray(run.pressure) - excess, effective, rtol=2e-3)


def pressure_in_direct_shear(b_value, dilation):
    """Rise of pressure per shear strain (Pa) of soil without cohesion that flows in direct shear, lateral strain held.

    With the lateral deviator a sqrt(J2), the vertical stress held, and plastic flow L: rates of the mean p' and of u.
    """
    contraction = -dilation / math.sqrt(1 + dilation**2 / 3)  # of the cone matched in plane strain, dilation is a sine
    slope = math.sin(FRICTION) / (1 / math.sqrt(1 + dilation**2 / 3) - math.sin(FRICTION) * contraction / 3)
    water = BULK * b_value / (1 - b_value)

    def mean_of(a):
        return -water * contraction / (1 + 2 * a * slope + water / BULK)

    def lateral(a):
        return mean_of(a) * (a * slope / (2 * SHEAR) - 1 / (3 * BULK)) + a / 2 - contraction / 3

    a = brentq(lateral, -0.3, 0.3)
    sheared = math.sqrt(1 - 3 * a**2) * (1 + slope * mean_of(a) / SHEAR)
    return -(1 + 2 * a * slope) * mean_of(a) / sheared


def test_shear_under_a_held_weight_raises_the_pressure_by_the_contraction():
    law = frictional(DruckerPrager, B_VALUES, cohesion=0.0, dilation=-0.05)
    law = replace(law, law=replace(law.law, matching=Matching.PLANE_STRAIN))
    run, excess = held(law, "simple shear drained", strain=0.08)
    slope = np.diff(excess[-20:], axis=0) / np.diff(np.asarray(run.shear_strain)[-20:], axis=0)
    assert np.all(excess[-1] < 0.8 * P0)
    expected = [pressure_in_direct_shear(b_value, math.sin(-0.05)) for b_value in B_VALUES]
    np.testing.assert_allclose(slope.mean(0), expected, rtol=0.01)


@pytest.mark.parametrize("kind", [MohrCoulomb, DruckerPrager])
def test_loose_soil_liquefies_and_no_further(kind):
    run, excess = held(frictional(kind, B_VALUES, cohesion=0.0, dilation=np.full(15, -0.1)), strain=0.3)
    assert np.all(np.asarray(run.pressure) - excess >= -1e-9 * P0)
    stiff = B_VALUES > 0.6
    assert np.all((np.asarray(run.deviatoric)[-1] < 1e-3 * np.max(np.asarray(run.deviatoric), 0))[stiff])
    np.testing.assert_allclose(excess[-1, stiff], P0, rtol=1e-3)


def test_cam_clay_has_its_undrained_strength():
    numbers = {"compression": 0.1, "swelling": 0.02, "critical_state": 1.0, "ocr": 1.0, "least_pressure": 100.0}
    law = sealed(ModifiedCamClay, 0.999, **numbers)
    run, excess = held(law, strain=0.2, steps=500)
    plain = element_test(law.law, "triaxial undrained", pressure=P0, strain=0.2, steps=500)
    strength = float(plain.deviatoric[-1])
    np.testing.assert_allclose(float(run.deviatoric[-1]), strength, rtol=5e-3)
    np.testing.assert_allclose(excess[-1], P0 + strength / 3 - float(plain.pressure[-1]), rtol=5e-3)


def test_derivatives_by_the_b_value_and_the_contraction_are_those_of_differences():
    def last(at):
        law = frictional(DruckerPrager, at["b_value"], dilation=-at["contraction"])
        run = element_test(law, "triaxial drained", pressure=P0, strain=0.02, steps=50)
        return (law.excess_pressure(run.history)[-1] + 2 * run.deviatoric[-1]) / P0

    check_derivatives(last, {"b_value": 0.7, "contraction": 0.05}, 1e-6)


def test_soil_above_the_water_and_without_a_b_value_is_its_skeleton_alone():
    skeleton = frictional(DruckerPrager, 0.0, dilation=-0.02).law
    above = Saturated(skeleton, jnp.asarray(0.9), jnp.asarray(-1.0))
    plain = element_test(skeleton, "triaxial drained", pressure=P0, strain=0.02, steps=50).stress
    for law in (Saturated(skeleton, jnp.asarray(0.0)), above):
        run = element_test(law, "triaxial drained", pressure=P0, strain=0.02, steps=50)
        np.testing.assert_array_equal(np.asarray(run.stress), np.asarray(plain))
        assert float(law.p_wave_modulus) == float(skeleton.p_wave_modulus)


def test_water_bears_no_tension_and_pressure_returns_once_soil_has_closed():
    law = Saturated(Elastic(jnp.asarray(BULK), jnp.asarray(SHEAR)), jnp.asarray(0.9), jnp.asarray(20e3))
    growth = np.linspace(-0.002, 0.2, 500)
    carried = np.clip((0.1 - growth) / 0.05, 0, 1) * 20e3
    excess = jax.vmap(lambda grown: law.excess_pressure(Sealed(None, grown)))(jnp.asarray(growth))
    np.testing.assert_allclose(excess + carried, np.maximum(carried - 9 * BULK * growth, 0), atol=1e-6)
