"""Drucker-Prager and Mohr-Coulomb: paths with a closed form, admissibility, derivatives."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import nnls

import jaxmpm as mpm
from jaxmpm.laws._spectral import principal

K, G, C = 8e6, 3e6, 10e3
PHI = np.radians(30)
PEAK_AND_RESIDUAL = {"cohesion": 2e3, "friction": np.radians(20), "strain": 0.05}
COMPONENTS = st.lists(st.floats(-2e5, 2e5), min_size=6, max_size=6)
NO_STRAIN = (0.0,) * 6


def law(kind=mpm.laws.MohrCoulomb, dilation=0.0, cutoff=None, softening=None, dtype=float, **choices):
    def number(value):
        return None if value is None else jnp.asarray(value, dtype)

    if softening is not None:
        softening = mpm.laws.FrictionalSoftening(**{k: number(v) for k, v in softening.items()})
    parameters = (number(v) for v in (K, G, C, PHI, np.radians(dilation)))
    return kind(*parameters, softening, number(cutoff), **choices)


def tensor(values, dtype=float):
    return tuple(jnp.asarray(v, dtype) for v in values)


axes_of = jax.jit(principal)


@jax.jit
def returned(material, trial, history=None):
    """Stress and history after no strain from a trial stress."""
    return material.update(NO_STRAIN, trial, history)


@partial(jax.jit, static_argnames="steps")
def driven(material, increment, steps, start=0.0, history=None):
    """Stress after `steps` equal increments of strain, from the isotropic stress `start` (Pa)."""
    stress = tensor([start] * 3 + [0.0] * 3)
    advance = lambda carry, _: (material.update(increment, *carry), None)  # noqa: E731
    return jax.lax.scan(advance, (stress, history), None, steps)[0]


@partial(jax.jit, static_argnames="steps")
def triaxial(material, axial, confinement, steps):
    """Stress after `steps` axial strains with the lateral stress held: Newton finds the lateral strain."""

    def lateral_stress(lateral, stress):
        return material.update((lateral, lateral, axial, 0.0, 0.0, 0.0), stress, None)[0]

    def one(carry, _):
        stress, lateral = carry

        def newton(_, lateral):
            ahead = jax.jvp(lambda e: lateral_stress(e, stress)[0], (lateral,), (jnp.ones(()),))
            return lateral - (ahead[0] + confinement) / ahead[1]

        lateral = jax.lax.fori_loop(0, 8, newton, lateral)
        return (lateral_stress(lateral, stress), lateral), None

    start = tensor([-confinement] * 3 + [0.0] * 3), jnp.zeros(())
    return jax.lax.scan(one, start, None, steps)[0][0]


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("dilation", [5.0, 15.0, 30.0])
@pytest.mark.parametrize(
    ("kind", "choices"),
    [(mpm.laws.MohrCoulomb, {}), (mpm.laws.DruckerPrager, {"matching": mpm.laws.Matching.COMPRESSION})],
)
def test_triaxial_compression_fails_at_the_closed_form(kind, choices, dilation):
    confinement, s = 50e3, np.sin(PHI)
    stress = triaxial(law(kind, dilation, **choices), -1e-3, confinement, 100)
    expected = confinement * (1 + s) / (1 - s) + 2 * C * np.cos(PHI) / (1 - s)
    assert np.isclose(stress[0], -confinement, rtol=1e-9)
    assert np.isclose(stress[2], -expected, rtol=1e-9)


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize(
    ("kind", "choices"),
    [(mpm.laws.MohrCoulomb, {}), (mpm.laws.DruckerPrager, {"matching": mpm.laws.Matching.EXTENSION})],
)
def test_triaxial_extension_fails_at_the_closed_form(kind, choices):
    confinement, s = 150e3, np.sin(PHI)
    stress = triaxial(law(kind, 10.0, **choices), 1e-3, confinement, 100)
    expected = (confinement * (1 - s) - 2 * C * np.cos(PHI)) / (1 + s)
    assert np.isclose(stress[2], -expected, rtol=1e-9)


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("dilation", [0.0, 10.0, 30.0])
@pytest.mark.parametrize("kind", [mpm.laws.MohrCoulomb, mpm.laws.DruckerPrager])
def test_plane_strain_fails_at_mohr_coulomb_whatever_the_dilation(kind, dilation):
    # In-plane shear with the dilation angle itself, so that the stress comes to stand at failure.
    opening = np.sin(np.radians(dilation)) * np.hypot(0.5e-3, 0.3e-3)
    increment = (0.5e-3 + opening, 0.0, -0.5e-3 + opening, 0.0, 0.0, 0.3e-3)
    stress, _ = driven(law(kind, dilation), increment, 2000, start=-100e3)
    deviation = np.hypot((stress[0] - stress[2]) / 2, stress[5])
    assert np.isclose(deviation, C * np.cos(PHI) - np.sin(PHI) * (stress[0] + stress[2]) / 2, rtol=1e-9)


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("kind", [mpm.laws.MohrCoulomb, mpm.laws.DruckerPrager])
def test_simple_shear_without_dilation_mobilises_c_cos_phi_and_the_mean_stress(kind):
    stress, _ = driven(law(kind), (0.0, 0.0, 0.0, 0.0, 0.0, 1e-3), 200, start=-100e3)
    assert np.isclose(stress[5], C * np.cos(PHI) + 100e3 * np.sin(PHI), rtol=1e-9)


@pytest.mark.usefixtures("x64")
def test_uniaxial_strain_of_mohr_coulomb_follows_its_two_slopes():
    # From no stress: elastic to yield, then on the edge where both lateral stresses are equal, without dilation.
    material = replace(law(), cohesion=jnp.asarray(1e3), friction=jnp.asarray(np.radians(40)))
    stiff = replace(material, bulk=jnp.asarray(G * 2 / 3))  # lateral stress 0: yields at once
    total = -0.02
    stress, _ = driven(stiff, (0.0, 0.0, total / 10, 0.0, 0.0, 0.0), 10)
    s, k = np.sin(np.radians(40)), 2e3 * np.cos(np.radians(40))
    # f = s_lat (1 + s) - s_ax (1 - s) - k = 0 and the mean stress stays elastic: s_ax + 2 s_lat = 3 K total.
    three_mean = 3 * G * 2 / 3 * total
    lateral = (k + three_mean * (1 - s)) / (3 - s)
    assert np.isclose(stress[0], lateral, rtol=1e-9)
    assert np.isclose(stress[2], three_mean - 2 * lateral, rtol=1e-9)


def planes(s, cutoff):
    """Normals of all planes of the pyramid, unordered, and their limits."""
    rows = [
        [(1 + s) if k == i else -(1 - s) if k == j else 0 for k in range(3)]
        for i in range(3)
        for j in range(3)
        if i != j
    ]
    limits = [2 * C * np.cos(PHI)] * 6
    if cutoff is not None:
        rows, limits = rows + np.eye(3).tolist(), limits + [cutoff] * 3
    return np.array(rows), np.array(limits)


@pytest.mark.usefixtures("x64")
@settings(max_examples=100)
@given(trial=COMPONENTS, dilation=st.sampled_from([-8.0, 0.0, 8.0, 30.0]), cutoff=st.sampled_from([None, 0.0, 6e3]))
def test_mohr_coulomb_returns_to_the_pyramid_by_flow_of_its_active_planes(trial, dilation, cutoff):
    trial = tensor(trial)
    stress, _ = returned(law(dilation=dilation, cutoff=cutoff), trial)
    x, y = (np.array(axes_of(t)[0], float) for t in (trial, stress))
    normals, limits = planes(np.sin(PHI), cutoff)
    flows, _ = planes(np.sin(np.radians(dilation)), cutoff)
    slack = limits - normals @ y
    scale = max(1.0, np.abs(x).max())
    assert np.all(slack > -1e-9 * scale)
    apex = C / np.tan(PHI)
    if np.allclose(y, apex, rtol=1e-9):
        return  # without dilation the flow to the apex is the limit of a small one, and contraction has none
    active = slack < 1e-8 * scale
    strain = np.linalg.solve(np.full((3, 3), K - 2 * G / 3) + 2 * G * np.eye(3), x - y)
    _, residual = nnls(flows[active].T, strain) if active.any() else (None, np.abs(strain).max())
    assert residual <= 1e-9 * scale / G


SHARE = st.floats(0.02, 0.98)
SIDES = {
    "main": lambda t, low, u, v: (u, low(u) + v * (u - low(u)), low(u)),
    "lesser two": lambda t, low, u, v: (u, low(u), low(u)),
    "greater two": lambda t, low, u, v: (u, u, low(u)),
    "tension": lambda t, low, u, v: (t, max(u, low(t) + v * (t - low(t))), low(t) + v * (t - low(t)) / 2),
    "two tensions": lambda t, low, u, v: (t, t, low(t) + v * (t - low(t))),
    "all tensions": lambda t, low, u, v: (t, t, t),
    "tension and main": lambda t, low, u, v: (t, low(t) + v * (t - low(t)), low(t)),
    "tension and lesser two": lambda t, low, u, v: (t, low(t), low(t)),
    "two tensions and greater two": lambda t, low, u, v: (t, t, low(t)),
}


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("side", SIDES)
@settings(max_examples=20)
@given(
    below=SHARE,
    between=SHARE,
    flow=st.lists(SHARE, min_size=9, max_size=9),
    dilation=st.sampled_from([0.0, 8.0, 30.0]),
    cutoff=st.sampled_from([0.0, 6e3]),
)
def test_mohr_coulomb_returns_to_where_flow_of_any_side_has_led_away_from(side, below, between, flow, dilation, cutoff):
    s = np.sin(PHI)
    low = lambda largest: (largest * (1 + s) - 2 * C * np.cos(PHI)) / (1 - s)  # noqa: E731
    y = np.array(SIDES[side](cutoff, low, cutoff - 1e5 * below, between))
    normals, limits = planes(s, cutoff)
    flows, _ = planes(np.sin(np.radians(dilation)), cutoff)
    active = np.isclose(normals @ y, limits, rtol=0, atol=1e-6)
    strain = 0.02 * flows[active].T @ np.array(flow)[active]
    trial = y + (K - 2 * G / 3) * strain.sum() + 2 * G * strain
    stress, _ = returned(law(dilation=dilation, cutoff=cutoff), tensor([*trial, 0.0, 0.0, 0.0]))
    np.testing.assert_allclose(stress[:3], y, rtol=0, atol=1e-9 * np.abs(trial).max())


@pytest.mark.usefixtures("x64")
@settings(max_examples=100)
@given(trial=COMPONENTS, dilation=st.sampled_from([-8.0, 0.0, 15.0]), cutoff=st.sampled_from([None, 4e3]))
def test_drucker_prager_stays_on_its_cone_and_below_the_cutoff(trial, dilation, cutoff):
    material = law(mpm.laws.DruckerPrager, dilation, cutoff, softening=PEAK_AND_RESIDUAL)
    stress, g = returned(material, tensor(trial), jnp.zeros(()))
    slope, intercept, _ = mpm.laws.cone(material.matching, material.cohesion, material.friction, material.dilation)
    p = mpm.tensors.mean(stress)
    q = jnp.sqrt(mpm.tensors.second_invariant(mpm.tensors.deviator(stress)))
    assert q + slope * p <= intercept + 1e-9 * 2e5
    assert cutoff is None or p <= cutoff + 1e-9 * 2e5
    assert g >= 0


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("kind", [mpm.laws.MohrCoulomb, mpm.laws.DruckerPrager])
@pytest.mark.parametrize("cutoff", [None, 2e3])
def test_float32_agrees_with_float64_over_a_cloud_of_stresses(kind, cutoff):
    cloud = np.random.default_rng(1).normal(size=(6, 4000)) * 1e5
    precise, _ = returned(law(kind, 10.0, cutoff), tensor(cloud))
    single, _ = returned(law(kind, 10.0, cutoff, dtype=np.float32), tensor(cloud, np.float32))
    assert single[0].dtype == jnp.float32
    assert max(float(jnp.abs(a - b).max()) for a, b in zip(precise, single, strict=True)) < 1e-5 * 5e5


@jax.jit
def measure(trial, cohesion, material):
    stress, g = replace(material, cohesion=cohesion).update(NO_STRAIN, tuple(trial), jnp.zeros(()))
    return jnp.asarray([1.0, -0.5, 0.3, 0.7, 0.2, -0.4]) @ jnp.stack(stress) + 1e5 * g


slopes = jax.jit(jax.grad(measure, argnums=(0, 1)))
STATES = {
    "no stress": [0.0] * 6,
    "isotropic tension": [9e4, 9e4, 9e4, 0, 0, 0],
    "triaxial compression": [-2e4, -2e4, -3e5, 0, 0, 0],
    "triaxial extension": [-2e5, -2e5, 1e4, 0, 0, 0],
    "general": [3e4, -1e5, -5e4, 2e4, -4e4, 6e4],
}


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("state", STATES)
@pytest.mark.parametrize("kind", [mpm.laws.MohrCoulomb, mpm.laws.DruckerPrager])
@pytest.mark.parametrize("cutoff", [None, 5e3])
def test_derivatives_are_finite_and_those_of_the_stress(kind, cutoff, state):
    material, trial = law(kind, 10.0, cutoff, softening=PEAK_AND_RESIDUAL), jnp.asarray(STATES[state])
    by_stress, by_cohesion = slopes(trial, jnp.asarray(C), material)
    assert np.all(np.isfinite(by_stress))
    assert np.isfinite(by_cohesion)
    if state in ("triaxial compression", "triaxial extension", "general"):  # elsewhere the stress has a corner
        direction = jnp.asarray([0.3, -0.2, 0.5, 0.1, 0.4, -0.3])
        central = (measure(trial + direction, C, material) - measure(trial - direction, C, material)) / 2
        assert np.isclose(by_stress @ direction, central, rtol=1e-5)
        central = (measure(trial, C + 1.0, material) - measure(trial, C - 1.0, material)) / 2
        assert np.isclose(by_cohesion, central, rtol=1e-6)


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("decay", list(mpm.laws.Decay))
@pytest.mark.parametrize("kind", [mpm.laws.MohrCoulomb, mpm.laws.DruckerPrager])
def test_softening_takes_cohesion_and_friction_to_their_residual_values(kind, decay):
    material = law(kind, softening=PEAK_AND_RESIDUAL)
    material = replace(material, softening=replace(material.softening, decay=decay))
    stress, g = driven(material, (0.0, 0.0, 0.0, 0.0, 0.0, 1e-3), 200, start=-100e3, history=jnp.zeros(()))
    residual = 2e3 * np.cos(np.radians(20)) + 100e3 * np.sin(np.radians(20))
    assert np.isclose(stress[5], residual, rtol=1e-8)
    assert np.isclose(g, 0.4 - residual / G, rtol=0.01)


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("kind", [mpm.laws.MohrCoulomb, mpm.laws.DruckerPrager])
def test_without_friction_both_are_j2_in_plane_strain(kind):
    material = replace(law(kind), friction=jnp.asarray(0.0))
    plain = mpm.laws.J2(material.bulk, material.shear, material.cohesion)
    path = (2e-3, 0.0, -2e-3, 0.0, 0.0, 1e-3)
    ours, theirs = (driven(m, path, 20, start=-50e3)[0] for m in (material, plain))
    assert np.allclose([ours[k] for k in (0, 2, 5)], [theirs[k] for k in (0, 2, 5)], rtol=1e-9)


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("kind", [mpm.laws.MohrCoulomb, mpm.laws.DruckerPrager])
def test_strength_reduction_divides_cohesion_and_the_tangent_of_friction(kind):
    reduced = mpm.laws.reduce_strength(law(kind, 25.0, softening=PEAK_AND_RESIDUAL), jnp.asarray(1.5))
    assert np.isclose(reduced.cohesion, C / 1.5)
    assert np.isclose(jnp.tan(reduced.friction), np.tan(PHI) / 1.5)
    assert np.isclose(reduced.dilation, reduced.friction)
    assert np.isclose(jnp.tan(reduced.softening.friction), np.tan(np.radians(20)) / 1.5)
