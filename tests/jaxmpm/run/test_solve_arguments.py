"""What `solve` makes of states that have run before, and what it asks of its arguments."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxmpm as mpm
from jaxmpm.run._stopping import Watch

SOIL = mpm.Soil(young=5e6, strength=9e3, softening_modulus=40e3, tension_cutoff=0.0)
NUMERICS = mpm.Discretisation(1.0, (0.5,))


@pytest.fixture(scope="module")
def fallen():
    """A column that gravity was set on at once, and its scene."""
    return mpm.column(4.0, SOIL, NUMERICS, at_rest=False)


def test_a_lane_that_has_finished_runs_on_from_its_state(fallen):
    scene, state = fallen
    first = mpm.solve(scene, state, t_end=0.2)
    second = mpm.solve(scene, first.state, t_end=0.2)
    whole = mpm.advance(scene, state, int(second.state.step))
    assert second.status == mpm.Status.FINISHED
    assert int(second.state.step) == 2 * int(first.state.step)
    assert (second.state.displacement == whole.displacement).all()


@pytest.mark.parametrize("status", [mpm.Status.FINISHED, mpm.Status.SETTLED, mpm.Status.DECIDED])
def test_only_lanes_that_broke_off_stay_as_they_are(fallen, status):
    scene, state = fallen
    varied, axes = mpm.run.lanes(scene, strength=jnp.full(3, 9e3))
    states = mpm.run.repeat(state, 3)
    begun = jnp.asarray([status, mpm.Status.OUTSIDE_GRID, mpm.Status.RUNNING], jnp.int32)
    result = mpm.solve(varied, replace(states, status=begun), t_end=0.1, axes=axes)
    assert result.status.tolist() == [mpm.Status.FINISHED, mpm.Status.OUTSIDE_GRID, mpm.Status.FINISHED]
    displacement = np.abs(np.asarray(result.state.displacement)).max(axis=(1, 2))
    assert displacement[0] == displacement[2] > displacement[1] == 0
    # What ends a run ends the next one too, at its first look.
    settle = mpm.Settle(speed=10.0, drift=10.0, hold=0.0)
    settled = mpm.solve(scene, result_of(scene, state, settle).state, t_end=0.1, rules=[settle], every=0.02)
    assert settled.status == mpm.Status.SETTLED


def test_soil_that_falls_has_not_settled_whatever_the_hold(fallen):
    scene, state = fallen
    settle = mpm.Settle(hold=0.0)
    assert mpm.solve(scene, state, t_end=0.1, rules=[settle], every=0.02).status == mpm.Status.FINISHED


def test_a_rule_may_be_a_function_of_scene_and_state(fallen):
    scene, state = fallen

    def fell(scene, state):
        return jnp.max(-state.velocity[-1]) > 0.5

    rules = [mpm.Exceeds(100.0), fell]
    alone = mpm.solve(scene, state, t_end=1.0, rules=rules, every=0.01)
    assert alone.status == mpm.Status.DECIDED
    assert 0.5 < float(jnp.max(-alone.state.velocity[-1])) < 0.75
    # One lane ends and the other does not, also where each sample is a lane.
    varied, axes = mpm.run.lanes(scene, strength=jnp.asarray([9e3, 9e3]))
    states = mpm.run.repeat(state, 2)
    states = replace(states, velocity=states.velocity.at[0].add(jnp.asarray([[0.0], [-0.6]])[-scene.grid.dimension :]))
    both = mpm.solve(varied, states, t_end=0.02, rules=rules, every=0.01, axes=axes)
    assert both.status.tolist() == [mpm.Status.DECIDED, mpm.Status.FINISHED]
    assert [rule and rule.condition for rule in both.ended_by] == [fell, None]
    ((_, sample),) = mpm.solve_each(scene, state, {"strength": [9e3]}, width=1, t_end=1.0, rules=rules, every=0.01)
    assert int(sample.status) == mpm.Status.DECIDED
    assert sample.ended_by == alone.ended_by == both.ended_by[0]


def test_a_function_may_say_how_a_lane_ends(fallen):
    scene, state = fallen

    def still(scene, state):
        return jnp.where(state.step > 3, mpm.Status.SETTLED, mpm.Status.RUNNING)

    result = mpm.solve(scene, state, t_end=0.1, rules=[still], every=0.02)
    assert result.status == mpm.Status.SETTLED
    assert result.ended_by.foreseen(0.5, 1.0) == 0.5


def test_the_first_rule_that_ends_a_lane_gives_its_status_and_rules_of_a_class_have_their_own_memory(fallen):
    scene, state = fallen
    at_once, never = mpm.Settle(speed=10.0, drift=10.0, hold=0.0), mpm.Settle(speed=10.0, drift=10.0, hold=9.0)
    for rules, status in (([never, at_once], "SETTLED"), ([mpm.Exceeds(1e-12), at_once], "DECIDED")):
        result = mpm.solve(scene, state, t_end=0.1, rules=rules, every=0.02)
        assert mpm.Status(int(result.status)).name == status
        assert result.ended_by == (at_once if status == "SETTLED" else rules[0])
    watch = Watch.start((never, at_once, never), (2,)).restarted(1, {"Settle": np.ones(2), "Settle 3": np.full(2, 3.0)})
    assert [memory[:, 1].tolist() for memory in watch.memory] == [[1.0, 1.0], [0.0, 0.0], [3.0, 3.0]]
    assert watch.of_lane(0).keys() == {"Settle", "Settle 2", "Settle 3"}


def result_of(scene, state, settle):
    """A run that settles."""
    result = mpm.solve(scene, state, t_end=0.1, rules=[settle], every=0.02)
    assert result.status == mpm.Status.SETTLED
    return result


@pytest.mark.parametrize(
    ("t_end", "message"),
    [
        (1e-12, r"t_end = 1e-12 s is below the time step of 0\.0\d+ s"),
        (jnp.asarray([1.0, 2.0]), r"t_end has shape \(2,\): give one number"),
        (np.asarray([0.1]), r"t_end has shape \(1,\): give one number"),
        (1e9, r"t_end = 1e\+09 s takes .* the limit is 2\^31: give less"),
    ],
)
def test_an_end_that_no_run_comes_to_is_refused(fallen, t_end, message):
    with pytest.raises(ValueError, match=message):
        mpm.solve(*fallen, t_end=t_end)


def test_an_array_of_one_number_is_an_end(fallen):
    assert mpm.solve(*fallen, t_end=jnp.asarray(0.1)).status == mpm.Status.FINISHED


def test_no_lanes_are_refused(fallen):
    scene, state = fallen
    with pytest.raises(ValueError, match=r"strength has shape \(0,\): give \(lanes,\)"):
        mpm.run.lanes(scene, strength=jnp.zeros(0))
    varied, axes = mpm.run.lanes(scene, strength=jnp.full(2, 9e3))
    none = replace(varied, material=replace(varied.material, strength=jnp.zeros(0)))
    with pytest.raises(ValueError, match="the state has 0 lanes: give one or more"):
        mpm.solve(none, jax.tree.map(lambda leaf: leaf[:0], mpm.run.repeat(state, 2)), t_end=0.1, axes=axes)


@pytest.mark.usefixtures("x64")
def test_a_state_of_another_precision_is_refused(fallen):
    scene, state = mpm.column(4.0, SOIL, NUMERICS, at_rest=False)
    with pytest.raises(ValueError, match="the state is float32, the scene float64: build both with the same precision"):
        mpm.solve(scene, fallen[1], t_end=0.1)
    with pytest.raises(ValueError, match="the state is float64, the scene float32"):
        mpm.replay(fallen[0], state, 2)


def test_derivatives_through_solve_are_refused_by_the_name_of_what_has_them(fallen):
    scene, state = fallen

    def displacement(velocity):
        return mpm.solve(scene, replace(state, velocity=velocity), t_end=0.1).state.displacement.sum()

    for transformed in (jax.grad(displacement), jax.jit(displacement)):
        with pytest.raises(ValueError, match=r"replay\(scene, state, int\(result\.state\.step\)\)"):
            transformed(state.velocity)


def test_a_law_put_in_without_its_history_is_refused(fallen):
    scene, state = fallen
    elastic = mpm.column(4.0, replace(SOIL, strength=None), NUMERICS, at_rest=False)
    soft, rigid = replace(elastic[0], material=scene.material), replace(scene, material=elastic[0].material)
    for run in (lambda *a: mpm.solve(*a, t_end=0.1), lambda *a: mpm.replay(*a, 2)):
        with pytest.raises(ValueError, match="the state's history is not that of J2"):
            run(soft, elastic[1])
        with pytest.raises(ValueError, match="the state's history is not that of Elastic"):
            run(rigid, state)
    history = soft.material.initial_history(soft.particles)
    built = replace(elastic[1], history=history, gap=jnp.zeros_like(soft.particles.mass))
    assert mpm.solve(soft, built, t_end=0.1).status == mpm.Status.FINISHED
