"""Soil that the tension cutoff has opened closes its gap before it bears pressure, and no grain is thrown by it."""

from dataclasses import replace
from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import jaxmpm as mpm
from jaxmpm.laws import update_with_gap
from tests.differences import check_run
from tests.jaxmpm.laws.test_finite_strain import deformed, point

K, G, STRENGTH, AT_REST = 8e6, 3e6, 2e4, -5e4
BULK, SHEAR, NONE = jnp.asarray(K), jnp.asarray(G), jnp.asarray(0.0)
CLAY = mpm.laws.J2(BULK, SHEAR, jnp.asarray(STRENGTH), tension_cutoff=NONE)
ANGLES = jnp.radians(30.0), jnp.radians(0.0)
CONE = mpm.laws.DruckerPrager(BULK, SHEAR, jnp.asarray(1e4), *ANGLES, tension_cutoff=NONE)
PYRAMID = mpm.laws.MohrCoulomb(BULK, SHEAR, jnp.asarray(1e4), *ANGLES, tension_cutoff=NONE)
LAWS = {"clay": CLAY, "cone": CONE, "pyramid": PYRAMID}
COLUMN = mpm.Soil(young=2e6, poisson=0.3, strength=1e4, tension_cutoff=0.0)


def at_rest(law, *, finite_strain=False, memory=True):
    """A point under pressure."""
    scene, state = point(replace(law, gap_memory=memory), finite_strain=finite_strain)
    pressed = jnp.where(jnp.arange(6)[:, None] < 3, AT_REST, 0.0) * jnp.ones_like(state.stress)
    return scene, replace(state, stress=pressed, gap=jnp.zeros_like(state.volume_ratio) if memory else None)


def stretched(ratios, axes=(0, 1, 2), *, finite_strain=False):
    """Deformation gradients of steps from one volume ratio to the next, stretched alike along some axes: rates add
    their strains up, logarithms multiply their stretches."""
    growth, steps = np.asarray(ratios[1:]) / ratios[:-1], np.tile(np.eye(3), (len(ratios) - 1, 1, 1))
    for axis in axes:
        steps[:, axis, axis] = growth ** (1 / len(axes)) if finite_strain else 1 + (growth - 1) / len(axes)
    return steps


def pressure_after(scene, state, ratios, axes=(0, 1, 2)):
    """Mean Kirchhoff stress and volume ratio after each step."""
    means = []
    for step in stretched(ratios, axes, finite_strain=scene.numerics.finite_strain):
        state = deformed(scene, state, step[None])
        scale = state.volume_ratio[0] if scene.numerics.finite_strain else 1.0
        means.append((float(scale * jnp.mean(state.stress[:3, 0])), float(state.volume_ratio[0])))
    return np.array(means).T, state


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize(
    ("kind", "finite_strain"), [("clay", False), ("cone", False), ("pyramid", False), ("clay", True)]
)
def test_no_pressure_before_the_opened_volume_has_closed_and_then_the_elastic_line(kind, finite_strain):
    ratios = np.concatenate([np.geomspace(1.0, 1.5, 60), np.geomspace(1.5, 0.99, 60)[1:]])
    scene, state = at_rest(LAWS[kind], finite_strain=finite_strain)
    (mean, volume), end = pressure_after(scene, state, ratios)
    rebound = np.exp(-AT_REST / K)
    line = K * np.log(volume) + AT_REST
    closing = np.arange(len(volume)) >= 60
    np.testing.assert_allclose(volume, ratios[1:], rtol=1e-12)
    np.testing.assert_allclose(mean[volume > rebound], 0.0, atol=1e-6)
    pressed = volume < rebound
    assert np.count_nonzero(pressed & closing) >= 2
    # The first step closes the gap, and is exact; rates then add up increments of volume for their logarithms.
    np.testing.assert_allclose(mean[pressed], line[pressed], rtol=1e-9 if finite_strain else 5e-3)
    assert float(end.gap[0]) == 0.0
    forgets, _ = pressure_after(*at_rest(LAWS[kind], finite_strain=finite_strain, memory=False), ratios)
    assert forgets[0][60] < -1e4


@jax.jit
def worked(scene, state, steps):
    """The state after steps, and the work (J/m3) that the mean stress did in each."""

    def one(state, step):
        new = deformed(scene, state, step[None])
        change = new.volume_ratio[0] - state.volume_ratio[0]
        return new, change * jnp.mean(state.stress[:3, 0] + new.stress[:3, 0]) / 2

    return jax.lax.scan(one, state, steps)


@pytest.mark.usefixtures("x64")
@settings(max_examples=10, deadline=None)
@given(st.lists(st.floats(1.01, 4.0), min_size=3, max_size=3))
def test_soil_that_opens_and_closes_again_takes_no_work_and_gives_none(turns):
    # By logarithms: rates add increments of volume up, and have no energy of their own.
    scene, state = at_rest(CLAY, finite_strain=True)
    ends = [1.0, 1.01, *turns, 1.01, 1.0]
    ratios = np.concatenate([[1.0], *(np.geomspace(a, b, 101)[1:] for a, b in pairwise(ends))])
    end, work = worked(scene, state, jnp.asarray(stretched(ratios, finite_strain=True)))
    scale = AT_REST**2 / (2 * K)
    np.testing.assert_allclose(np.sum(work) / scale, 0.0, atol=1e-2)
    np.testing.assert_allclose(end.stress, state.stress, rtol=1e-9)


@pytest.mark.usefixtures("x64")
def test_tension_is_lost_before_the_gap_closes_and_a_part_of_it_may_open_anew():
    law = replace(CLAY, tension_cutoff=jnp.asarray(4e3))
    ratios = np.concatenate([np.geomspace(a, b, 400)[1:] for a, b in [(1.0, 1.2), (1.2, 1.1), (1.1, 1.3)]])
    scene, state = at_rest(law)
    (mean, volume), end = pressure_after(scene, state, np.r_[1.0, ratios])
    assert np.isclose(mean[398], 4e3)
    assert np.isclose(mean[797], 0.0, atol=1e-6)
    assert np.isclose(mean[-1], 4e3)
    # What is not gap is the elastic part.
    np.testing.assert_allclose(float(end.gap[0]), np.log(volume[-1]) - (4e3 - AT_REST) / K, rtol=1e-3)


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("kind", ["cone", "pyramid"])
def test_dilation_under_pressure_is_no_gap(kind):
    law = replace(LAWS[kind], dilation=jnp.radians(15.0))
    sheared = np.tile(np.eye(3) + 2e-3 * np.eye(3, k=2), (60, 1, 1))
    # Sheared under pressure it dilates, and loosened again it has the volume that it has: nothing closes.
    path = np.concatenate([sheared, stretched(np.geomspace(1.0, 0.9, 10))])
    ends = [deformed(*at_rest(law, memory=memory), path) for memory in (True, False)]
    assert float(ends[0].gap[0]) == 0.0
    np.testing.assert_allclose(ends[0].stress, ends[1].stress, rtol=1e-12)
    assert float(ends[0].stress[2, 0]) < AT_REST


@pytest.mark.usefixtures("x64")
def test_a_crack_across_one_axis_under_pressure_is_no_gap():
    scene, state = at_rest(replace(PYRAMID, cohesion=jnp.asarray(1e6)))
    ratios = np.r_[1.0, np.geomspace(1.0, 1.004, 20)[1:], np.geomspace(1.004, 1.0, 20)[1:]]
    (mean, _), end = pressure_after(scene, state, ratios, axes=(0,))
    assert mean.max() < 0
    assert float(end.gap[0]) == 0.0


def test_soil_that_never_opens_moves_as_without_memory():
    ends = []
    for memory in (True, False):
        soil = replace(COLUMN, strength=1e5, gap_memory=memory)
        scene, state = mpm.column(4.0, soil, mpm.Discretisation(1.0, (0.5, 0.5)))
        ends.append(mpm.advance(scene, replace(state, velocity=state.velocity.at[-1].set(-0.01)), 100))
    assert not ends[0].gap.any()
    for name in ("displacement", "stress", "volume_ratio"):
        np.testing.assert_array_equal(getattr(ends[0], name), getattr(ends[1], name))


@pytest.mark.parametrize("d", [1, 2])
def test_a_column_thrown_up_falls_back_to_where_it_lay(d):
    # Its upper half leaves the lower one at 4 m/s. Soil that forgets its gap holds it up for ever.
    ends = {}
    for memory in (True, False):
        scene, state = mpm.column(8.0, replace(COLUMN, gap_memory=memory), mpm.Discretisation(1.0, (0.5,) * d, air=6.0))
        upper = scene.particles.position[-1] > 4
        state = replace(state, velocity=state.velocity.at[-1].set(jnp.where(upper, 4.0, 0.0)))
        result = mpm.solve(scene, state, t_end=4.0, snapshots=[0.5]).raise_if_failed()
        assert float(jnp.max(result.snapshots[0].volume_ratio)) > 1.4
        ends[memory] = float(jnp.mean(result.state.displacement[-1], where=upper))
    assert abs(ends[True]) < 0.25
    assert ends[False] > 0.4


def test_a_grain_that_has_opened_is_not_thrown_by_its_own_volume():
    # Fifty times its volume, as grains of the published slope had, a little above level ground.
    thrown = {}
    for memory in (True, False):
        scene, state = mpm.slope(
            mpm.Slope(crest=4.0, height=1.0, run_per_rise=1.0, toe=5.0, foundation=2.0),
            mpm.Soil(young=5e6, strength=2e4, gap_memory=memory, tension_cutoff=0.0),
            mpm.Discretisation(1.0, (0.5, 0.5), air=6.0),
        )
        x, z = scene.particles.position
        grain = int(jnp.argmax(100 * z - jnp.abs(x - 2)))
        volume = state.volume_ratio.at[grain].set(50.0)
        opened = replace(
            state,
            displacement=state.displacement.at[1, grain].set(0.3),
            stress=state.stress.at[:, grain].set(0.0),
            volume_ratio=volume,
            gap=jnp.log(volume) if memory else None,
        )
        result = mpm.solve(scene, opened, t_end=3.0, snapshots=np.arange(0.1, 3.0, 0.1).tolist())
        thrown[memory] = max(float(each.displacement[1, grain]) for each in result.snapshots)
    assert thrown[True] < 0.35
    assert thrown[False] > 1.0


@pytest.mark.usefixtures("x64")
def test_gradients_are_those_of_differences_and_engines_and_lanes_agree():
    scene, start = mpm.column(4.0, replace(COLUMN, poisson=0.2), mpm.Discretisation(1.0, (0.5, 0.5), air=4.0))

    def height(scene, speed, stiffness):
        law = replace(scene.material, bulk=scene.material.bulk * stiffness)
        up = jnp.where(scene.particles.position[-1] > 2, speed, 0.0)
        state = replace(start, velocity=start.velocity.at[-1].set(up))
        end = mpm.advance(replace(scene, material=law), state, 150)
        return jnp.sum(end.displacement[-1] ** 2) + jnp.sum(end.gap)

    assert float(mpm.advance(scene, start, 1).gap.max()) == 0.0
    check_run(height, scene, (2.0, 1.0), (1e-6, 1e-6), 1e-4)


def test_single_precision_keeps_a_gap_as_double_does():
    path = np.concatenate([np.geomspace(1.0, 1.5, 400), np.geomspace(1.5, 1.02, 400)[1:]])
    growth, ends = path[1:] / path[:-1], []
    for x64 in (False, True):
        with jax.enable_x64(x64):
            law = jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf), float), CLAY)
            start = (jnp.asarray(AT_REST),) * 3 + (jnp.zeros(()),) * 3, jnp.zeros(())

            def one(carry, ratio, law=law):
                stress, gap = carry
                strain = ((ratio - 1) / 3,) * 3 + (0.0,) * 3
                stress, _, gap = update_with_gap(law, strain, stress, None, jnp.ones(()), gap=gap)
                return (stress, gap), None

            ends.append(float(jax.lax.scan(one, start, jnp.asarray(growth))[0][1]))
    np.testing.assert_allclose(ends[0], ends[1], atol=2e-5)


def test_a_state_without_a_gap_is_refused_where_the_soil_remembers_it():
    scene, state = mpm.column(2.0, COLUMN, mpm.Discretisation(1.0, (0.5, 0.5)))
    with pytest.raises(ValueError, match=r"gap_memory"):
        mpm.solve(scene, replace(state, gap=None), t_end=0.1)
    with pytest.raises(ValueError, match=r"gap_memory = 1"):
        mpm.column(2.0, replace(COLUMN, gap_memory=1), mpm.Discretisation(1.0, (0.5, 0.5)))
