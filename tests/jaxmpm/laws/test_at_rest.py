"""The stress at rest: its K0, what laws remember of it, and zones whose laws remember different things."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxmpm as mpm

CLAY = mpm.CamClaySoil(0.1, 0.02, 1.0, ocr=2.0)
LEVEL = mpm.Section([(0, 4), (6, 4)])
NUMERICS = mpm.Discretisation(1.0, (0.5, 0.5))


@pytest.mark.parametrize("k0", [None, 0.5, 1.3])
def test_level_ground_has_the_k0_that_it_was_given_after_a_change_of_weight_too(k0):
    soil = mpm.Soil(poisson=0.3)
    scene, state = mpm.section(LEVEL, soil, NUMERICS, k0=k0)
    expected = 3 / 7 if k0 is None else k0
    np.testing.assert_allclose(state.stress[0] / state.stress[2], expected, rtol=2e-3)
    np.testing.assert_allclose(state.stress[2], -mpm.overburden(scene), rtol=2e-3)
    _, heavier = mpm.with_soil(scene, state, unit_weight=25e3)
    np.testing.assert_allclose(heavier.stress, 1.25 * state.stress, rtol=2e-3, atol=20.0)


def test_k0_is_a_field_and_no_argument_of_a_scene_without_it():
    bare, _ = mpm.section(LEVEL, mpm.Soil(), NUMERICS, at_rest=False)
    depth = 4.0 - bare.particles.position[1]
    scene, state = mpm.section(LEVEL, mpm.Soil(), NUMERICS, k0=1.0 - 0.1 * depth)
    np.testing.assert_allclose(state.stress[0] / state.stress[2], 1.0 - 0.1 * depth, rtol=2e-3)
    assert bare.loads.k0 is None
    assert len(jax.tree.leaves(scene)) == len(jax.tree.leaves(bare)) + 1
    with pytest.raises(ValueError, match=r"k0 has shape \(3,\): give a number or"):
        mpm.section(LEVEL, mpm.Soil(), NUMERICS, k0=np.ones(3))
    with pytest.raises(ValueError, match=r"k0 = -0\.5: give a finite value of 0 or more"):
        mpm.section(LEVEL, mpm.Soil(), NUMERICS, k0=-0.5)


def test_a_law_with_memory_of_the_stress_at_rest_follows_a_change_of_weight():
    scene, state = mpm.section(LEVEL, CLAY, NUMERICS, k0=0.7)
    heavier, other = mpm.with_soil(scene, state, unit_weight=36e3)
    np.testing.assert_allclose(other.history.mean, 2 * state.history.mean, rtol=5e-3)
    looser, same = mpm.with_soil(scene, state, ocr=1.0)
    assert same is state
    halves = looser.material.preconsolidation(state.history) / scene.material.preconsolidation(state.history)
    np.testing.assert_allclose(halves[state.history.mean > 2e3], 0.5, rtol=1e-5)
    assert heavier.material.ocr == 2.0


def test_zones_remember_each_its_own_history():
    soils = [mpm.Soil(strength=2e3, softening_modulus=10e3, unusual=True), CLAY, mpm.AnisotropicSoil(9e3, 8e3, 7e3)]
    layers = [mpm.Layer(s, b) for s, b in zip(soils, [[(0, 3), (6, 3)], [(0, 2), (6, 2)], None], strict=True)]
    scene, state = mpm.section(LEVEL, layers, NUMERICS, k0=0.8)
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
        scene, state = mpm.column(3.0, soil, mpm.Discretisation(1.0, (0.5,) * d, cell_average=False), k0=0.6)
        fallen = replace(state, velocity=state.velocity.at[d - 1].set(-0.3 * scene.particles.position[d - 1]))
        end = mpm.advance(scene, fallen, jnp.asarray(20))
        order = np.argsort(np.asarray(scene.particles.position[-1]), kind="stable")[:: 2 if d == 2 else 1]
        upright = 0 if d == 1 else 2
        rest = np.asarray(state.history.vertical if soil is CLAY else -state.history.rest[upright])
        after[d] = [np.asarray(each)[order] for each in (end.displacement[-1], end.stress[upright], rest)]
    for one, two in zip(after[1], after[2], strict=True):
        np.testing.assert_allclose(one, two, rtol=1e-3, atol=1e-3 * abs(two).max())
