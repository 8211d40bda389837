"""Hencky strains with exponential return mapping: closed forms, invariance, energy, and agreement in small strains."""

from dataclasses import replace
from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import jaxmpm as mpm
from jaxmpm import diagnostics, tensors
from jaxmpm._step import lane_status
from jaxmpm.equations import Maps, update_stress
from tests.differences import check_run

K, G, PEAK, SLOPE, RATIO = 8e6, 3e6, 40e3, 85e3, 0.5
ELASTIC = mpm.laws.Elastic(jnp.asarray(K), jnp.asarray(G))
EIGHTS = mpm.Discretisation(1.0, (0.5, 0.5), finite_strain=True)


def point(law, d=3, *, finite_strain=True):
    """A scene and state of a few particles, of which only stress, history and volume matter."""
    soil = mpm.Soil(young=1e7, poisson=0.0)
    numerics = mpm.Discretisation(1.0, (1.0,) * d, finite_strain=finite_strain)
    scene, state = mpm.block((1.0,) * d, soil, numerics, domain=(3.0,) * d, corner=(1.0,) * d, speed=1.0)
    history = law.initial_history(scene.particles)
    return replace(scene, material=law), replace(state, history=history)


@jax.jit
def deformed(scene, state, steps):
    """The state after steps of these deformation gradients (n, d, d), each from where the one before ended."""
    d = scene.grid.dimension
    gradients = jnp.broadcast_to((steps - jnp.eye(d))[..., None], (len(steps), d, d, 1))
    maps = Maps(scene, scene.particles.position)
    return jax.lax.scan(lambda s, g: (update_stress(scene, s, g, jnp.asarray(1.0), maps), None), state, gradients)[0]


def kirchhoff(scene, state):
    """J s of the first particle, 3 x 3."""
    full = tensors.expand((state.volume_ratio * state.stress)[:, :1], scene.grid.dimension)
    return np.array([[float(np.squeeze(full[tensors.VOIGT[i][j]])) for j in range(3)] for i in range(3)])


def hencky(b):
    """The elastic Kirchhoff stress of b, by eigenvectors."""
    values, axes = np.linalg.eigh(b)
    strain = axes @ np.diag(np.log(values) / 2) @ axes.T
    return (K - 2 * G / 3) * np.trace(strain) * np.eye(3) + 2 * G * strain


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize(("stretch", "steps"), [(0.5, 1), (0.5, 20), (1.8, 20)])
def test_uniaxial_strain_is_the_logarithm_of_the_stretch(stretch, steps):
    scene, state = point(ELASTIC, d=1)
    end = deformed(scene, state, np.full((steps, 1, 1), stretch ** (1 / steps)))
    e = np.log(stretch)
    assert np.allclose(np.diag(kirchhoff(scene, end)), [(K + 4 * G / 3) * e, *[(K - 2 * G / 3) * e] * 2], rtol=1e-12)
    assert np.isclose(end.volume_ratio[0], stretch, rtol=1e-12)


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize(("d", "steps"), [(2, 20), (3, 1)])
def test_simple_shear_has_hencky_s_normal_stresses(d, steps):
    shear = 1.5
    scene, state = point(ELASTIC, d)
    one = np.eye(d)
    one[0, -1] = shear / steps
    end = kirchhoff(scene, deformed(scene, state, np.stack([one] * steps)))
    scale = 2 * G * np.arcsinh(shear / 2) / np.sqrt(4 + shear**2)
    assert np.allclose(end, scale * np.array([[shear, 0, 2], [0, 0, 0], [2, 0, -shear]]), atol=1e-9 * G)


@pytest.mark.usefixtures("x64")
@settings(max_examples=20)
@given(st.integers(0, 2**31))
def test_stress_depends_on_the_deformation_alone_and_turns_with_the_body(seed):
    # Any path to F gives Hencky's stress of F F^T; a rotation in one step, however large, turns it.
    rng = np.random.default_rng(seed)
    path = np.eye(3) + 0.15 * rng.normal(size=(6, 3, 3))
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    path[-1] = turn * np.linalg.det(turn)
    scene, state = point(ELASTIC)
    end = deformed(scene, state, path)
    total = np.linalg.multi_dot(path[::-1])
    assert np.allclose(kirchhoff(scene, end), hencky(total @ total.T), atol=1e-9 * G)
    assert np.isclose(end.volume_ratio[0], np.linalg.det(total))


@pytest.mark.usefixtures("x64")
def test_a_closed_cycle_does_no_work_but_on_hypoelastic_soil():
    corners = [(0.0, 0.0), (0.6, 0.0), (0.6, 0.4), (0.0, 0.4), (0.0, 0.0)]  # shear and stretch
    deformations = [
        np.array([[1.0, s], [0.0, 1 + e]])
        for a, b in pairwise(corners)
        for s, e in np.linspace(a, b, 40, endpoint=False)
    ] + [np.eye(2)]
    path = np.stack([after @ np.linalg.inv(before) for before, after in pairwise(deformations)])
    left = {}
    for finite_strain in (True, False):
        scene, state = point(ELASTIC, 2, finite_strain=finite_strain)
        end = deformed(scene, state, path)
        left[finite_strain] = np.abs(end.stress).max(), float(diagnostics.elastic_energy(scene, end))
    assert left[True][0] < 1e-9 * G
    assert left[True][1] < 1e-9
    assert left[False][0] > 1e-2 * G


def softened(drive):
    """Shear stress and plastic strain where G (drive - g) = t and t = max(S - H g, r S)."""
    g = max(0.0, (G * drive - PEAK) / (G - SLOPE))
    if PEAK - SLOPE * g < RATIO * PEAK:
        g = drive - RATIO * PEAK / G
    return (G * drive if g == 0 else max(PEAK - SLOPE * g, RATIO * PEAK)), g


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize(("strain", "steps"), [(0.1, 20), (-0.5, 1)])
def test_clay_softens_in_logarithmic_strain_as_in_closed_form(strain, steps):
    law = mpm.laws.J2(*map(jnp.asarray, (K, G, PEAK)), mpm.laws.Softening(jnp.asarray(SLOPE), jnp.asarray(RATIO)))
    scene, state = point(law, d=1)
    end = deformed(scene, state, np.full((steps, 1, 1), np.exp(strain / steps)))
    shear, g = softened(2 / np.sqrt(3) * abs(strain))
    expected = K * strain + np.sign(strain) * 2 / np.sqrt(3) * shear
    assert np.isclose(kirchhoff(scene, end)[0, 0], expected, rtol=1e-9)
    assert np.isclose(end.history[0], g, rtol=1e-9)


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("law", [mpm.laws.DruckerPrager, mpm.laws.MohrCoulomb])
def test_soil_with_friction_flows_at_its_strength_without_change_of_volume(law):
    cohesion, friction = 5e3, np.radians(30.0)
    material = law(*map(jnp.asarray, (K, G, cohesion, friction, 0.0)))
    scene, state = point(material, d=2)
    squeezed, sheared = np.diag([0.98, 0.98]), np.array([[1.0, 0.02], [0.0, 1.0]])
    tau = kirchhoff(scene, deformed(scene, state, np.stack([squeezed] + [sheared] * 60)))
    before = kirchhoff(scene, deformed(scene, state, squeezed[None]))
    high, *_, low = np.sort(np.linalg.eigvalsh(tau))[::-1]
    assert np.isclose(np.trace(tau), np.trace(before), rtol=1e-9)
    criterion = (high - low) / 2 + (high + low) / 2 * np.sin(friction) - cohesion * np.cos(friction)
    assert abs(criterion) < (1e-9 if law is mpm.laws.MohrCoulomb else 0.02) * abs(tau).max()


SHAPE = mpm.Slope(crest=4, height=2, run_per_rise=1.0, toe=4, foundation=2)
CLAY = mpm.Soil(young=5e6, strength=9e3, softening_modulus=40e3, tension_cutoff=0.0)


@pytest.mark.usefixtures("x64")
def test_in_small_strains_a_slope_moves_as_with_rates():
    def displacement(finite_strain, stiffer):
        soil = replace(CLAY, young=5e6 * stiffer, strength=2e4)
        scene, state = mpm.slope(SHAPE, soil, replace(EIGHTS, finite_strain=finite_strain), at_rest=False)
        return mpm.advance(scene, state, jnp.asarray(60)).displacement

    apart = []
    for stiffer in (1.0, 100.0):
        rates, logarithms = displacement(False, stiffer), displacement(True, stiffer)
        apart.append(float(jnp.abs(logarithms - rates).max() / jnp.abs(rates).max()))
    # Over the displacement the difference is of the order of the strain, here two hundredths and a hundredth of that.
    assert apart[1] < apart[0] / 30
    assert apart[1] < 1e-3


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("choice", [pytest.param({"fbar": True}, marks=pytest.mark.slow), {"cell_average": True}])
def test_averages_leave_a_uniform_change_of_volume(choice):
    scene, state = mpm.slope(SHAPE, CLAY, replace(EIGHTS, **choice), at_rest=False)
    squeezed = jnp.broadcast_to(jnp.diag(jnp.asarray([-0.1, -0.2]))[..., None], (2, 2, scene.particles.mass.size))

    maps = Maps(scene, scene.particles.position)
    ratio = update_stress(scene, state, squeezed, jnp.asarray(1.0), maps).volume_ratio
    assert np.allclose(ratio, 0.72, rtol=1e-12)


def test_float32_stays_where_it_rests():
    # What rounds in a step that strains nothing must not add up; 1 + 1e-4 would drown the strains.
    scene, state = mpm.column(6.0, mpm.Soil(young=1e7, strength=2e5, tension_cutoff=None), EIGHTS)
    still = jnp.zeros((2, 2, scene.particles.mass.size))
    maps = Maps(scene, scene.particles.position)
    strain = jax.jit(lambda _, now: update_stress(scene, now, still, scene.numerics.time_step, maps))
    end = jax.lax.fori_loop(0, 1000, strain, state)
    assert np.abs(end.stress - state.stress).max() < 1e-5 * np.abs(state.stress).max()


SAND = mpm.FrictionalSoil(cohesion=1e3, friction=20.0, young=5e6)
SOILS = {
    "elastic": (replace(CLAY, strength=None), ("bulk", "shear"), 1e-6),
    "clay": (replace(CLAY, strength=6e3), ("bulk", "strength"), 1e-4),
    "cone": (replace(SAND, law=mpm.laws.DruckerPrager), ("cohesion", "friction"), 1e-4),
    "pyramid": (SAND, ("cohesion", "friction"), 1e-4),
}


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize(
    "kind", ["elastic", *(pytest.param(kind, marks=pytest.mark.slow) for kind in ("clay", "cone", "pyramid"))]
)
def test_gradients_are_those_of_differences_and_engines_and_lanes_agree(kind):
    soil, names, tolerance = SOILS[kind]
    scene, state = mpm.slope(SHAPE, soil, EIGHTS, at_rest=False)

    def objective(scene, *factors):
        own = {name: getattr(scene.material, name) * factor for name, factor in zip(names, factors, strict=True)}
        varied = replace(scene, material=replace(scene.material, **own))
        return jnp.sum(mpm.advance(varied, state, 30).displacement[0] ** 2)

    check_run(objective, scene, (1.0, 1.0), (1e-6, 1e-6), tolerance)


@pytest.mark.usefixtures("x64")
def test_the_energy_of_a_block_that_vibrates_by_a_tenth_is_conserved():
    def drift(finite_strain):
        soil = mpm.Soil(unit_weight=9810.0, young=1e6)
        numerics = replace(EIGHTS, finite_strain=finite_strain, cfl=0.1)
        scene, state = mpm.block((2, 2), soil, numerics, domain=(8, 8), corner=(3.0, 3.0), speed=6.0)
        swing = 4.0 * (scene.particles.position - 4.0) * jnp.asarray([[1.0], [-1.0]])
        state = replace(state, velocity=swing)

        def energy(state):
            return float(diagnostics.kinetic_energy(scene, state) + diagnostics.elastic_energy(scene, state))

        end = mpm.advance(scene, state, jnp.asarray(1500))
        return abs(energy(end) / energy(state) - 1)

    assert drift(True) < 0.01
    assert drift(False) > 3 * drift(True)


def test_soil_that_inverts_ends_its_lane():
    scene, state = point(ELASTIC, d=2)
    through = deformed(scene, state, jnp.asarray([[[1.0, 0.0], [0.0, -0.2]]]))
    assert int(lane_status(scene, through, scene.numerics.time_step)) == mpm.Status.INVERTED
