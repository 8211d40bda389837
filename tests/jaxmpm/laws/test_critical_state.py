"""Modified Cam Clay: closed forms of critical state soil mechanics, an independent integration, derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import jaxmpm as mpm
from jaxmpm.laws import ModifiedCamClay, element_test
from jaxmpm.laws._cam_clay import Consolidation
from tests.differences import check_derivatives
from tests.verification import order

COMPRESSION, SWELLING, M, NU, P0 = 0.1, 0.02, 1.0, 0.3, 1e5
LAMBDA = 1 - SWELLING / COMPRESSION
G_OVER_K = 3 * (1 - 2 * NU) / (2 * (1 + NU))
NUMBERS = {
    "bulk": 5e7,
    "shear": 5e7 * G_OVER_K,
    "compression": COMPRESSION,
    "swelling": SWELLING,
    "critical_state": M,
    "ocr": 1.0,
    "least_pressure": 100.0,
}


def clay(dtype=float, **values):
    return ModifiedCamClay(**{name: jnp.asarray(value, dtype) for name, value in {**NUMBERS, **values}.items()})


@jax.jit
def updated(law, strain, stress, history):
    return law.update(strain, stress, history)


def size_of(ocr):
    """p_c over the isotropic stress P0 at rest: of virgin soil under ocr P0, with Jaky's earth pressure at rest."""
    phi = np.arcsin(3 * M / (6 + M))
    k = 1 - np.sin(phi)
    p, q = (1 + 2 * k) / 3, 1 - k
    return max(ocr * (p + (q / M) ** 2 / p), 1.0)


def ratio_of(eta):
    """p / p0 on the undrained path of normally consolidated clay at q / p = eta: Muir Wood (1990), Eq. 5.27."""
    return (M**2 / (M**2 + eta**2)) ** LAMBDA


def plastic_shear(eta):
    """Plastic triaxial shear strain on that path: dp/p and the flow rule, integrated."""
    return SWELLING * LAMBDA / M * (np.log((M + eta) / (M - eta)) - 2 * np.arctan(eta / M))


def elastic_shear(eta):
    """q / (3 G) integrated along it, with G = r p / swelling."""
    ends = np.linspace(0, eta, 20_001)
    q = ends * ratio_of(ends)
    middle = ratio_of((ends[1:] + ends[:-1]) / 2)
    return SWELLING / (3 * G_OVER_K) * np.sum(np.diff(q) / middle)


@pytest.mark.usefixtures("x64")
def test_undrained_triaxial_of_normally_consolidated_clay_is_the_closed_form():
    test = element_test(clay(), "triaxial undrained", pressure=P0, strain=0.1, steps=4000)
    eta = np.asarray(test.deviatoric / test.pressure)
    some = np.searchsorted(eta, [0.3, 0.6, 0.85, 0.97])
    np.testing.assert_allclose(test.pressure[some], P0 * ratio_of(eta[some]), rtol=2e-4)
    strain = [plastic_shear(e) + elastic_shear(e) for e in eta[some]]
    np.testing.assert_allclose(test.axial_strain[some], strain, rtol=3e-3)


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("ocr", [1.0, 2.0, 4.0, 8.0])
def test_undrained_strength_grows_with_the_overconsolidation_ratio(ocr):
    # s_u = (M / 2) p0 (R / 2)^Lambda with R = p_c / p0: Muir Wood (1990), Eq. 7.30.
    test = element_test(clay(ocr=ocr), "triaxial undrained", pressure=P0, strain=0.5, steps=3000)
    np.testing.assert_allclose(test.deviatoric[-1] / 2, M / 2 * P0 * (size_of(ocr) / 2) ** LAMBDA, rtol=1e-3)


@pytest.mark.usefixtures("x64")
def test_oedometer_of_normally_consolidated_clay_has_its_slope_and_its_earth_pressure_at_rest():
    test = element_test(clay(bulk=5e9, shear=5e9 * G_OVER_K), "oedometer", pressure=P0, strain=0.25, steps=4000)
    # Muir Wood (1990), Eq. 10.17.
    eta = brentq(
        lambda e: e * (1 + NU) * (1 - LAMBDA) / (3 * (1 - 2 * NU)) + 3 * e * LAMBDA / (M**2 - e**2) - 1, 0.01, M - 1e-6
    )
    np.testing.assert_allclose(test.stress[-1, 0] / test.stress[-1, 2], (3 - eta) / (3 + 2 * eta), rtol=1e-4)
    slope = np.diff(test.volumetric_strain[-200:]) / np.diff(np.log(test.pressure[-200:]))
    np.testing.assert_allclose(slope, COMPRESSION, rtol=1e-3)


@pytest.mark.usefixtures("x64")
def test_swelling_and_reloading_return_to_the_same_state_on_their_own_slope():
    virgin = element_test(clay(), "oedometer", pressure=P0, strain=0.05, steps=1000)
    stiff = element_test(clay(ocr=4.0), "oedometer", pressure=P0, strain=0.005, steps=200)
    slope = np.diff(stiff.volumetric_strain) / np.diff(np.log(stiff.pressure))
    np.testing.assert_allclose(slope, SWELLING, rtol=2e-3)
    assert virgin.pressure[-1] < stiff.pressure[-1] * np.exp((0.05 - 0.005) / SWELLING)


@pytest.mark.usefixtures("x64")
def test_isotropic_swelling_is_an_exponential_and_of_second_order_in_the_step():
    # The bulk modulus p / swelling grows with the strain by which each step changes it.
    compaction, counts = SWELLING / 2, np.array([10, 20, 40])
    exact, errors = P0 * np.exp(compaction / SWELLING), []
    for steps in counts:
        history = Consolidation(*(jnp.asarray(value) for value in (P0, P0, 0.0)))
        stress, strain = (-P0,) * 3 + (0.0,) * 3, (-compaction / (3 * steps),) * 3 + (0.0,) * 3
        law = clay(ocr=8.0)
        for _ in range(steps):
            stress, history = updated(law, *(tuple(map(jnp.asarray, each)) for each in (strain, stress)), history)
        assert history.compaction == 0
        errors.append(abs(float(-stress[0]) / exact - 1))
    assert order(1 / counts, errors) > 1.9


def drained(ocr, end):
    """q after an axial strain of `end` in drained compression: the equations as rates, by another integrator."""

    def rates(strain, y):
        p, size, q = y
        bulk = p / SWELLING
        shear = bulk * G_OVER_K
        yields = q**2 / M**2 + p * (p - size) >= -1e-9 * size**2
        normal, along = 2 * p - size, 2 * q / M**2
        # Unknowns: dv (volumetric), multiplier; axial rate 1, dq = 3 dp.
        theta = COMPRESSION - SWELLING
        # ds (triaxial shear strain) = 1 - dv / 3
        if yields:
            rows = [
                [-3 * bulk - shear, 3 * bulk * normal - 3 * shear * along],
                [
                    normal * bulk - along * shear,
                    -normal * bulk * normal - 3 * along**2 * shear - p * size * normal / theta,
                ],
            ]
            volume, flow = np.linalg.solve(rows, [-3 * shear, -3 * along * shear])
        else:
            volume, flow = 3 * shear / (3 * bulk + shear), 0.0
        dp = bulk * (volume - flow * normal)
        return [dp, size * flow * normal / theta, 3 * dp]

    done = solve_ivp(rates, (0, end), [P0, size_of(ocr) * P0, 0.0], rtol=1e-9, atol=1e-6, max_step=end / 2000)
    return done.y[2, -1]


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("ocr", [1.0, 1.5])
def test_drained_triaxial_is_that_of_an_independent_integration(ocr):
    test = element_test(clay(ocr=ocr), "triaxial drained", pressure=P0, strain=0.15, steps=3000)
    np.testing.assert_allclose(test.deviatoric[-1], drained(ocr, 0.15), rtol=1e-3)
    np.testing.assert_allclose(test.stress[:, 0], -P0, rtol=1e-9)


@pytest.mark.usefixtures("x64")
def test_drained_triaxial_ends_at_the_critical_state():
    test = element_test(clay(), "triaxial drained", pressure=P0, strain=1.5, steps=3000)
    np.testing.assert_allclose(test.deviatoric[-1], 3 * M * P0 / (3 - M), rtol=1e-4)


STRAIN = st.lists(st.floats(-5e-3, 5e-3), min_size=6, max_size=6)


@pytest.mark.usefixtures("x64")
@given(STRAIN, st.floats(2e3, 4e5), st.floats(1.0, 20.0))
@settings(max_examples=60)
def test_any_strain_ends_on_or_within_the_ellipse(strain, pressure, ocr):
    law, tensor = clay(ocr=ocr), tuple(jnp.asarray([each]) for each in strain)
    history = Consolidation(jnp.asarray([pressure]), jnp.asarray([pressure]), jnp.zeros(1))
    start = tuple(jnp.asarray([-pressure * (k < 3)]) for k in range(6))
    stress, after = updated(law, tensor, start, history)
    p = -sum(stress[:3]) / 3
    q2 = 3 * (0.5 * sum((s + p) ** 2 for s in stress[:3]) + sum(s**2 for s in stress[3:]))
    size = law.preconsolidation(after)
    assert float((q2 / M**2 + p * (p - size))[0] / size[0] ** 2) < 1e-9


@pytest.mark.usefixtures("x64")
def test_derivatives_by_each_number_are_those_of_differences():
    at = {**NUMBERS, "ocr": 1.3, "bulk": 4e6, "shear": 4e6 * G_OVER_K}

    def strength(values):
        return element_test(
            ModifiedCamClay(**values), "triaxial undrained", pressure=P0, strain=0.02, steps=50
        ).deviatoric[-1]

    check_derivatives(strength, at, 2e-5)


def test_float32_agrees_with_float64():
    def strength(dtype):
        test = element_test(clay(dtype), "triaxial undrained", pressure=P0, strain=0.1, steps=500)
        return float(test.deviatoric[-1])

    single = strength(jnp.float32)
    with jax.enable_x64(True):
        np.testing.assert_allclose(single, strength(jnp.float64), rtol=1e-3)


def test_a_slope_of_cam_clay_knows_its_stress_at_rest_and_stands():
    soil = mpm.CamClaySoil(COMPRESSION, SWELLING, 1.2, ocr=4.0, largest_pressure=100e3, k0=0.8)
    drawn = mpm.Section([(0, 4), (4, 4), (8, 2), (12, 2)])
    scene, state = mpm.section(drawn, soil, mpm.Discretisation(1.0, (0.5, 0.5)))
    at_rest = -(state.stress[0] + state.stress[1] + state.stress[2]) / 3
    np.testing.assert_allclose(state.history.mean, jnp.maximum(at_rest, 0), rtol=1e-5)
    result = mpm.solve(scene, state, t_end=0.5).raise_if_failed()
    assert float(mpm.diagnostics.largest_displacement(result.state)) < 0.02


def test_a_slope_too_steep_for_its_critical_state_slides():
    shape = mpm.Slope(crest=4, height=4, run_per_rise=0.5, toe=6, foundation=1)
    scene, state = mpm.slope(
        shape, mpm.CamClaySoil(0.1, 0.02, 0.6, largest_pressure=100e3), mpm.Discretisation(1.0, (0.5, 0.5))
    )
    result = mpm.solve(scene, state, t_end=1.0).raise_if_failed()
    assert float(mpm.diagnostics.largest_displacement(result.state)) > 0.2


def test_level_ground_that_was_never_loaded_more_yields_where_it_is_loaded_more():
    law = clay(jnp.float32)
    test = element_test(
        law, "oedometer", pressure=P0, k0=1 - np.sin(np.arcsin(3 * M / (6 + M))), strain=0.01, steps=100
    )
    assert float(test.history.compaction[-1]) > 0.005
    stiff = element_test(clay(jnp.float32, ocr=3.0), "oedometer", pressure=P0, k0=0.7, strain=0.01, steps=100)
    assert float(stiff.history.compaction[-1]) == 0


def test_a_soil_that_swells_more_than_it_compresses_is_refused():
    with pytest.raises(ValueError, match=r"swelling = 0.2 with compression = 0.1: give less than the compression"):
        mpm.CamClaySoil(0.1, 0.2, 1.0).material(np.dtype("float32"), 1.0)
