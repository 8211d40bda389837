"""The stress at rest: its K0, what laws remember of it, and zones whose laws remember different things."""

import re
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import jaxmpm as mpm

CLAY = mpm.CamClaySoil(0.1, 0.02, 1.0, ocr=2.0)
LEVEL = mpm.Section([(0, 4), (6, 4)])
NUMERICS = mpm.Discretisation(1.0, (0.5, 0.5))


@pytest.mark.parametrize("k0", [None, 0.5, 1.3])
def test_level_ground_has_the_k0_that_it_was_given_after_a_change_of_weight_too(k0):
    scene, state = mpm.section(LEVEL, mpm.Soil(poisson=0.3, k0=k0), NUMERICS)
    expected = 3 / 7 if k0 is None else k0
    np.testing.assert_allclose(state.stress[0] / state.stress[2], expected, rtol=2e-3)
    np.testing.assert_allclose(state.stress[2], -mpm.overburden(scene), rtol=2e-3)
    _, heavier = mpm.with_soil(scene, state, unit_weight=25e3)
    np.testing.assert_allclose(heavier.stress, 1.25 * state.stress, rtol=2e-3, atol=20.0)


def test_k0_is_a_field_and_no_argument_of_a_scene_without_it():
    bare, _ = mpm.section(LEVEL, mpm.Soil(), NUMERICS, at_rest=False)
    depth = 4.0 - bare.particles.position[1]
    scene, state = mpm.section(LEVEL, mpm.Soil(k0=1.0 - 0.1 * depth), NUMERICS)
    np.testing.assert_allclose(state.stress[0] / state.stress[2], 1.0 - 0.1 * depth, rtol=2e-3)
    assert bare.loads.k0 is None
    assert len(jax.tree.leaves(scene)) == len(jax.tree.leaves(bare)) + 1
    with pytest.raises(ValueError, match=r"k0 has shape \(3,\): give a number or"):
        mpm.section(LEVEL, mpm.Soil(k0=np.ones(3)), NUMERICS)
    with pytest.raises(ValueError, match=r"k0 = -0\.5: give a finite value of 0 or more"):
        mpm.section(LEVEL, mpm.Soil(k0=-0.5), NUMERICS)
    with pytest.raises(ValueError, match="k0 is given, and the scene has none: build it of soil with a k0"):
        mpm.with_soil(bare, mpm.unstressed(bare), k0=0.5)


def test_layers_have_each_their_own_k0_or_that_of_elastic_loading():
    sand, clay, rock = mpm.FrictionalSoil(0.0, 30.0, k0=0.5), mpm.Soil(strength=40e3, k0=0.9), mpm.Soil(poisson=0.2)
    layers = [
        mpm.Layer(soil, bottom) for soil, bottom in ((sand, [(0, 3), (6, 3)]), (clay, [(0, 1), (6, 1)]), (rock, None))
    ]
    scene, state = mpm.section(LEVEL, layers, NUMERICS)
    z = scene.particles.position[1]
    expected = np.where(z > 3, 0.5, np.where(z > 1, 0.9, 0.25))
    np.testing.assert_allclose(state.stress[0] / state.stress[2], expected, rtol=3e-3)
    _, other = mpm.with_soil(scene, state, k0=0.6)
    np.testing.assert_allclose(other.stress[0] / other.stress[2], 0.6, rtol=3e-3)


@pytest.mark.usefixtures("x64")
@given(friction=st.floats(15.0, 45.0), share=st.floats(-0.3, 1.3))
@settings(max_examples=15, deadline=None)
def test_a_k0_beyond_the_active_and_the_passive_limit_of_sand_is_refused(friction, share):
    active = np.tan(np.radians(45 - friction / 2)) ** 2
    k0 = active ** (1 - 2 * share)  # active at share 0, passive at share 1
    assume(min(abs(share), abs(share - 1)) > 0.01)
    soil = mpm.FrictionalSoil(0.0, friction, k0=k0)
    if 0 < share < 1:
        mpm.column(2.0, soil, NUMERICS, at_rest=False)
        return
    with pytest.raises(ValueError, match="from its active to its passive limit") as refused:
        mpm.column(2.0, soil, NUMERICS, at_rest=False)
    low, high = map(float, re.search(r"where it bears ([\d.]+) to ([\d.]+),", str(refused.value)).groups())
    assert low == pytest.approx(active, rel=0.06)
    assert high == pytest.approx(1 / active, rel=0.06)


def test_clay_bears_a_k0_by_its_depth():
    # |1 - k0| sigma_v <= sqrt(3) S_u of Mises: 1 - k0 at most 0.577 under 20 kN/m3 at 3.75 m.
    for k0, borne in ((0.44, True), (0.41, False), (1.56, True), (1.59, False)):
        soil = mpm.Soil(strength=25e3, k0=k0, poisson=0.5 - 1e-4)
        if borne:
            mpm.section(LEVEL, soil, NUMERICS, at_rest=False)
        else:
            with pytest.raises(ValueError, match=r"yields so at \(.*, 0\.25\) m, under 7.5e\+04 Pa, where it"):
                mpm.section(LEVEL, soil, NUMERICS, at_rest=False)


def test_a_law_with_memory_of_the_stress_at_rest_follows_a_change_of_weight():
    scene, state = mpm.section(LEVEL, replace(CLAY, k0=0.7), NUMERICS)
    heavier, other = mpm.with_soil(scene, state, unit_weight=36e3)
    np.testing.assert_allclose(other.history.mean, 2 * state.history.mean, rtol=5e-3)
    looser, same = mpm.with_soil(scene, state, ocr=1.0)
    assert same is state
    halves = looser.material.preconsolidation(state.history) / scene.material.preconsolidation(state.history)
    np.testing.assert_allclose(halves[state.history.mean > 2e3], 0.5, rtol=1e-5)
    assert heavier.material.ocr == 2.0


def test_zones_remember_each_its_own_history():
    soils = [mpm.Soil(strength=2e3, softening_modulus=10e3, unusual=True), CLAY, mpm.AnisotropicSoil(9e3, 8e3, 7e3)]
    soils = [replace(soil, k0=0.8) for soil in soils]
    layers = [mpm.Layer(s, b) for s, b in zip(soils, [[(0, 3), (6, 3)], [(0, 2), (6, 2)], None], strict=True)]
    scene, state = mpm.section(LEVEL, layers, NUMERICS)
    plastic, clay, mobilised = state.history
    soft, cam, undrained = (own for _, own in scene.material.zones)
    assert np.all(np.asarray(clay.mean[cam]) > 0)
    assert not np.any(np.asarray(clay.mean[soft]))
    assert np.any(np.asarray(mobilised.rest[0][undrained]))
    assert not np.any(np.asarray(mobilised.rest[0][cam]))
    pushed = replace(state, velocity=state.velocity.at[0].set(0.5 * scene.particles.position[1]))
    after = mpm.advance(scene, pushed, jnp.asarray(30))
    assert int(after.status) == mpm.Status.RUNNING
    assert np.any(np.asarray(after.history[0][soft] > plastic[soft]))
    assert not np.any(np.asarray(after.history[0][undrained]))
    np.testing.assert_array_equal(after.history[1].mean, clay.mean)
    assert np.any(np.asarray(after.history[1].compaction[cam]))
    assert np.any(np.asarray(after.history[2].strain[undrained]))
    np.testing.assert_array_equal(after.history[2].rest[0], mobilised.rest[0])


@pytest.mark.parametrize("soil", [CLAY, mpm.AnisotropicSoil(9e3, 8e3, 7e3)], ids=["clay", "anisotropic"])
def test_a_column_is_the_same_in_one_and_two_dimensions(soil):
    after = {}
    for d in (1, 2):
        scene, state = mpm.column(3.0, replace(soil, k0=0.75), mpm.Discretisation(1.0, (0.5,) * d, cell_average=False))
        fallen = replace(state, velocity=state.velocity.at[d - 1].set(-0.3 * scene.particles.position[d - 1]))
        end = mpm.advance(scene, fallen, jnp.asarray(20))
        order = np.argsort(np.asarray(scene.particles.position[-1]), kind="stable")[:: 2 if d == 2 else 1]
        upright = 0 if d == 1 else 2
        rest = np.asarray(state.history.vertical if soil is CLAY else -state.history.rest[upright])
        after[d] = [np.asarray(each)[order] for each in (end.displacement[-1], end.stress[upright], rest)]
    for one, two in zip(after[1], after[2], strict=True):
        np.testing.assert_allclose(one, two, rtol=1e-3, atol=1e-3 * abs(two).max())


@mpm.pytree
@dataclass(frozen=True)
class OutOfJax(mpm.laws.Law):
    """A law of one's own that takes the stress at rest to NumPy."""

    bulk: jax.Array
    shear: jax.Array

    def initial_history(self, particles):
        return jnp.zeros_like(particles.mass)

    def history_at_rest(self, history, stress):
        return jnp.asarray(np.maximum(-np.asarray(stress[2]), 0))

    def update(self, strain_increment, stress, history, dt=None):
        return mpm.laws.add(stress, mpm.laws.elastic_increment(self.bulk, self.shear, strain_increment)), history


def test_a_law_that_takes_its_stress_at_rest_out_of_jax_is_told_so():
    scene, state = mpm.column(2.0, mpm.Soil(), NUMERICS)
    own = replace(scene, material=OutOfJax(scene.material.bulk, scene.material.shear))
    start = replace(state, history=own.material.initial_history(own.particles))
    with pytest.raises(
        ValueError, match=r"history_at_rest of OutOfJax hands the stress to NumPy.*write it with jax\.numpy"
    ):
        mpm.with_stress(own, start, state.stress)
