"""Differentiable runs: against `solve`, central differences, budgets of bytes; smooth objectives; sensitivities."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxmpm as mpm
from jaxmpm.run import objectives
from jaxmpm.types import Engine

SLOPE = mpm.Slope(crest=8.0, height=4.0, run_per_rise=1.0, toe=10.0, foundation=2.0)
CLAY = mpm.Soil(young=1e7, strength=14e3, softening_modulus=60e3, tension_cutoff=None)


def slide(reduction=1.3, engine=None, **choices):
    scene, state = mpm.slope(SLOPE, CLAY, mpm.Discretisation(1.0, (0.5, 0.5), **choices))
    return mpm.reduced(replace(scene, numerics=replace(scene.numerics, engine=engine)), reduction), state


def scaled(scene, state, steps, objective, memory=1e9):
    """Objective after `steps` as a function of a factor on the strength of every particle."""
    strength = jnp.broadcast_to(scene.material.strength, scene.particles.mass.shape)

    def reached(factor):
        varied = replace(scene, material=replace(scene.material, strength=strength * factor))
        return objective(mpm.replay(varied, state, steps, memory=memory)[0])

    return reached


def central(function, x, h):
    return (float(function(x + h)) - float(function(x - h))) / (2 * h)


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("memory_in_states", [10_000, 24])
def test_replay_is_the_run_that_was_whatever_the_checkpoints(memory_in_states):
    scene, state = slide()
    result = mpm.solve(scene, state, t_end=0.4)
    steps = int(result.state.step)
    size = sum(leaf.nbytes for leaf in jax.tree.leaves(state))
    final, seen = jax.jit(partial(mpm.replay, steps=steps, memory=memory_in_states * size))(scene, state)
    assert seen is None
    assert int(final.step) == steps
    np.testing.assert_allclose(final.displacement, result.state.displacement, rtol=1e-9, atol=1e-13)


@pytest.mark.usefixtures("x64")
def test_observations_are_the_snapshots_of_the_run():
    scene, state = slide()
    dt = float(scene.numerics.time_step)
    result = mpm.solve(scene, state, t_end=60 * dt, snapshots=[20 * dt, 40 * dt, 60 * dt])
    _, seen = mpm.replay(scene, state, 60, observe=mpm.diagnostics.largest_displacement, every=20)
    expected = [float(mpm.diagnostics.largest_displacement(s)) for s in result.snapshots]
    np.testing.assert_allclose(seen, expected, rtol=1e-9)


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("engine", [None, pytest.param(Engine.XLA, marks=pytest.mark.slow)])
def test_reverse_over_a_thousand_elastic_steps_against_central_differences(engine):
    scene, state = mpm.bar(
        20.0, mpm.Soil(unit_weight=9.81e3, young=1e6, poisson=0.0), mpm.Discretisation(1.0, (0.5,)), velocity=0.1
    )
    scene = replace(scene, numerics=replace(scene.numerics, engine=engine))

    def tip(stiffer):
        material = replace(scene.material, bulk=scene.material.bulk * stiffer, shear=scene.material.shear * stiffer)
        final, _ = mpm.replay(replace(scene, material=material), state, 1000)
        return final.displacement[0, -1]

    reverse = float(jax.jit(jax.grad(tip))(1.0))
    assert reverse == pytest.approx(central(jax.jit(tip), 1.0, 1e-6), rel=1e-6)
    _, forward = jax.jit(lambda x: jax.jvp(tip, (x,), (1.0,)))(1.0)
    assert float(forward) == pytest.approx(reverse, rel=1e-9)


@pytest.mark.usefixtures("x64")
def test_reverse_over_softening_steps_against_central_differences():
    scene, state = slide()
    reached = scaled(scene, state, 300, objectives.log_displacement)
    assert float(jax.jit(jax.grad(reached))(1.0)) == pytest.approx(central(jax.jit(reached), 1.0, 1e-7), rel=1e-4)


@pytest.mark.usefixtures("x64")
def test_derivatives_by_gravity_softening_and_starting_velocity():
    scene, state = slide()
    uneven = 1 + 0.3 * jnp.sin(jnp.arange(scene.particles.mass.size))

    def reached(angle, modulus, push):
        turned = jnp.stack([jnp.sin(angle), -jnp.cos(angle)]) * 9.81
        material = replace(scene.material, softening=replace(scene.material.softening, modulus=modulus * uneven))
        start = replace(state, velocity=state.velocity.at[0].add(push))
        final, _ = mpm.replay(replace(scene, loads=replace(scene.loads, gravity=turned), material=material), start, 120)
        return objectives.log_displacement(final)

    at = (0.02, float(scene.material.softening.modulus), 1e-3)
    gradient = jax.jit(jax.grad(reached, argnums=(0, 1, 2)))(*at)
    function = jax.jit(reached)
    for k, h in enumerate((1e-7, 1e-2, 1e-8)):
        one = partial(lambda k, x: function(*at[:k], x, *at[k + 1 :]), k)
        assert float(gradient[k]) == pytest.approx(central(one, at[k], h), rel=2e-5)


# Tight limits take many levels of nested loops, and their programs ten seconds and more to compile.
@pytest.mark.parametrize("memory", [*(pytest.param(bytes, marks=pytest.mark.slow) for bytes in (4.5e5, 8e5)), 6e6])
def test_reverse_mode_stays_within_its_bytes(memory):
    reached = scaled(*slide(), 400, objectives.log_displacement, memory=memory)
    compiled = jax.jit(jax.grad(reached)).lower(1.0).compile()
    assert compiled.memory_analysis().temp_size_in_bytes <= memory


ELASTIC, SAND = mpm.Soil(young=1e7), mpm.FrictionalSoil(5e3, 25.0, young=1e7)


@pytest.mark.parametrize(
    ("soil", "finite_strain"),
    [
        (ELASTIC, True),
        *(pytest.param(*each, marks=pytest.mark.slow) for each in ((ELASTIC, False), (SAND, False), (SAND, True))),
    ],
)
def test_the_bytes_of_a_step_are_those_of_its_law_and_its_strains(soil, finite_strain):
    scene, state = mpm.slope(
        SLOPE, soil, mpm.Discretisation(1.0, (0.5, 0.5), finite_strain=finite_strain), at_rest=False
    )

    def reached(stiffer):
        varied = replace(scene, material=replace(scene.material, bulk=scene.material.bulk * stiffer))
        return objectives.log_displacement(mpm.replay(varied, state, 8)[0])

    predicted = mpm.run.checkpoints(scene, state, 8, 1e9).bytes
    taken = jax.jit(jax.grad(reached)).lower(1.0).compile().memory_analysis().temp_size_in_bytes
    assert 0.6 * predicted < taken <= predicted


def test_bytes_too_few_for_any_checkpoints_are_refused():
    with pytest.raises(ValueError, match="is too small for 400 steps"):
        mpm.run.checkpoints(*slide(), 400, 1e4)


def test_a_lane_that_broke_off_leaves_the_derivatives_of_its_neighbours_as_they_are():
    scene, state = slide()

    def reached(push):
        start = replace(state, velocity=state.velocity + push)
        final, _ = mpm.replay(scene, start, 30)
        return objectives.log_displacement(final), final.status

    gradients = jax.jit(jax.vmap(jax.grad(reached, has_aux=True)))
    pushes = jnp.asarray([0.01, 0.02, 0.03])
    whole, status = gradients(pushes)
    broken, statuses = gradients(pushes.at[1].set(jnp.nan))
    assert np.isfinite(np.asarray(whole)).all()
    np.testing.assert_array_equal(np.asarray(whole)[[0, 2]], np.asarray(broken)[[0, 2]])
    assert status.tolist() == [mpm.Status.RUNNING] * 3
    assert statuses.tolist() == [mpm.Status.RUNNING, mpm.Status.NOT_FINITE, mpm.Status.RUNNING]


def test_soil_that_leaves_the_grid_and_comes_back_has_broken_off():
    numerics = mpm.Discretisation(1.0, (0.5, 0.5))
    thrown = {"domain": (4.0, 6.0), "corner": (1.5, 4.0), "velocity": (0.0, 7.0), "speed": 40.0}
    scene, state = mpm.block(
        (1.0, 1.0), mpm.Soil(strength=1e4, young=1e6, tension_cutoff=0.0), numerics, gravity=(0.0, -9.81), **thrown
    )
    result = mpm.solve(scene, state, t_end=1.5)
    assert result.status == mpm.Status.OUTSIDE_GRID
    back = round(1.45 / float(scene.numerics.time_step))
    final, _ = mpm.replay(scene, state, back)
    assert final.status == mpm.Status.OUTSIDE_GRID
    assert mpm.replay(scene, state, int(result.state.step) - 1)[0].status == mpm.Status.RUNNING
    with pytest.raises(FloatingPointError, match="OUTSIDE_GRID"):
        mpm.sensitivity(scene, state, mpm.diagnostics.largest_displacement, ["strength"], steps=back)


@pytest.mark.parametrize("steepest", [0.5, 0.7])
def test_derivatives_of_soil_that_softens_steeply_and_does_not_yield_are_finite(steepest):
    shear = 2e7 / 2.6
    soil = mpm.Soil(
        strength=25e3, young=2e7, residual_ratio=0.2, strain_95=3 * 25e3 * 0.8 / (steepest * shear), unusual=True,
        rate_coefficient=None if steepest == 0.5 else 0.1,
        tension_cutoff=0.0)  # fmt: skip
    shape = mpm.Section([(0, 8), (8, 8), (16, 4), (24, 4)])
    scene, state = mpm.section(shape, soil, mpm.Discretisation(1.0, (0.5, 0.5)))
    _, by = mpm.sensitivity(scene, state, objectives.soft_largest_displacement, steps=60)
    assert all(np.isfinite(np.asarray(derivative)).all() for derivative in by.values())
    assert np.count_nonzero(np.asarray(by["strength"])) > 50


def test_a_lane_stays_where_its_recorded_number_of_steps_ends():
    scene, state = slide()
    lanes = jax.jit(jax.vmap(lambda limit: mpm.replay(scene, state, 40, limit=limit)[0]))(jnp.asarray([15, 40]))
    short, _ = jax.jit(partial(mpm.replay, steps=15))(scene, state)
    np.testing.assert_allclose(lanes.displacement[0], short.displacement, rtol=1e-5, atol=1e-9)
    assert lanes.step.tolist() == [15, 40]
    # Steps count from the given state, whatever led to it.
    on, _ = mpm.replay(scene, short, 25, limit=jnp.asarray(10))
    whole, _ = mpm.replay(scene, state, 25)
    assert int(on.step) == 25
    np.testing.assert_allclose(on.displacement, whole.displacement, rtol=1e-5, atol=1e-9)


@pytest.mark.usefixtures("x64")
def test_where_strength_matters_against_central_differences():
    scene, state = slide()
    value, by = mpm.sensitivity(scene, state, objectives.soft_largest_displacement, ["strength"], steps=200)
    map_ = by["strength"]
    strength = jnp.broadcast_to(scene.material.strength, scene.particles.mass.shape)

    @jax.jit
    def reached(strength):
        varied = replace(scene, material=replace(scene.material, strength=strength))
        return objectives.soft_largest_displacement(mpm.replay(varied, state, 200)[0])

    assert float(value) == pytest.approx(float(reached(strength)), rel=1e-9)
    # Twenty of all particles, many of which never yield, and the five that matter most.
    largest = np.argsort(-np.abs(np.asarray(map_)))[:5]
    for p in [*np.random.default_rng(0).choice(strength.size, 20, replace=False), *largest]:
        h = 1e-3
        difference = float(reached(strength.at[p].add(h)) - reached(strength.at[p].add(-h))) / (2 * h)
        assert float(map_[p]) == pytest.approx(difference, rel=1e-4, abs=1e-6 * float(abs(map_[largest[0]])))
    # Strength holds: on the whole more of it means less displacement.
    assert float(jnp.sum(map_)) < 0


@pytest.mark.filterwarnings("ignore:the front at")
@pytest.mark.usefixtures("x64")
def test_smooth_objectives_are_as_far_from_the_hard_ones_as_they_say():
    scene, state = slide()
    final = mpm.solve(scene, state, t_end=1.5).state
    hard = float(mpm.diagnostics.largest_displacement(final))
    count = scene.particles.mass.size
    for width in (0.2, 0.02):
        soft = float(objectives.soft_largest_displacement(final, width))
        assert hard <= soft <= hard + width * np.log(count)
    x = np.sort(np.asarray(mpm.diagnostics.position(scene, final))[0])
    quantile = x[int(0.95 * count)]
    assert abs(float(objectives.front(scene, final, share=0.05, width=0.2)) - quantile) < 0.3
    rms = float(jnp.sqrt(jnp.mean(jnp.sum(final.displacement**2, axis=0))))
    assert float(objectives.log_displacement(final)) == pytest.approx(np.log(rms / 1e-3), rel=1e-3)


@pytest.mark.filterwarnings("ignore:the front at")
@pytest.mark.usefixtures("x64")
def test_the_front_moves_with_the_mass():
    scene, state = slide()
    final = mpm.solve(scene, state, t_end=1.5).state

    def front(shift):
        return objectives.front(scene, replace(final, displacement=final.displacement.at[0].add(shift)))

    assert float(jax.grad(front)(0.0)) == pytest.approx(1.0, rel=1e-6)
    assert float(front(0.7) - front(0.0)) == pytest.approx(0.7, rel=1e-6)


@pytest.mark.usefixtures("x64")
def test_run_out_is_of_soil_that_slid():
    scene, state = slide(1.6)
    final = mpm.solve(scene, state, t_end=2.5).state
    displacement = np.asarray(mpm.diagnostics.displacement(final))
    x = np.asarray(mpm.diagnostics.position(scene, final))[0]
    toe = SLOPE.toe_x
    hard = x[displacement > 0.5].max() - toe
    soft = float(objectives.runout(scene, final, toe, moved=0.5, share=0.01, width=0.1))
    assert 0.5 < hard < 9
    assert hard - 1.0 < soft < hard
    assert abs(float(objectives.runout(scene, state, toe))) < 1e-9
    # A slope that falls the other way.
    mirror = jnp.array([[-1.0], [1.0]])
    there = replace(scene, particles=replace(scene.particles, position=mirror * scene.particles.position))
    slid = replace(final, displacement=mirror * final.displacement)
    other = objectives.runout(there, slid, -toe, moved=0.5, share=0.01, width=0.1, downhill=-1)
    assert float(other) == pytest.approx(soft, rel=1e-9)
    with pytest.raises(ValueError, match=r"downhill = 0: give 1 for a slope that falls along x, -1"):
        objectives.runout(there, slid, -toe, downhill=0)
    # The front of all mass is the end of the ground, which never moves.
    with pytest.warns(UserWarning, match="it is the ground ahead of the slide, use objectives.runout"):
        assert float(objectives.front(scene, final)) > SLOPE.length - 2


@pytest.mark.usefixtures("x64")
def test_gradients_of_run_out_agree_with_differences():
    scene, state = slide(1.6)
    measured = partial(objectives.runout, scene, toe=SLOPE.toe_x, moved=0.2)
    reached = jax.jit(scaled(scene, state, 250, measured))
    assert float(reached(1.0)) > 0.0
    gradient = float(jax.jit(jax.grad(reached))(1.0))
    assert gradient < -0.1  # stronger soil runs out less
    assert gradient == pytest.approx(central(reached, 1.0, 1e-6), rel=1e-4)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"steps": 2.5}, "give a Python integer"),
        ({"steps": 0}, "give a Python integer of 1 or more"),
        ({"steps": 10, "every": 5}, "observe and every go together"),
        ({"steps": 10, "every": 3, "observe": mpm.diagnostics.displacement}, "does not divide"),
        ({"steps": 10, "memory": 10.0}, "too small for 10 steps"),
    ],
)
def test_bad_replays_are_refused(options, message):
    scene, state = slide()
    with pytest.raises(ValueError, match=message):
        mpm.replay(scene, state, **options)


def test_a_record_of_columns_is_not_replayed():
    scene, state = slide()
    with pytest.raises(ValueError, match="replay records no columns"):
        mpm.replay(scene, mpm.with_columns(scene, state, moved=0.5), 5)


def test_bad_objectives_are_refused():
    scene, state = slide()
    with pytest.raises(ValueError, match="share = 0\\.7: give a value above 0 and below"):
        objectives.front(scene, state, share=0.7)
    with pytest.raises(ValueError, match="moved = 0 m"):
        objectives.runout(scene, state, 10.0, moved=0.0)
    elastic, rest = mpm.column(4.0, mpm.Soil(), mpm.Discretisation(1.0, (0.5, 0.5)))
    with pytest.raises(ValueError, match=r"\['strength'\] is no parameter of Elastic: give some of \['bulk'"):
        mpm.sensitivity(elastic, rest, mpm.diagnostics.largest_displacement, ["strength"], steps=10)
