"""Ends without walls: level ground beyond them moves as the ground between does, and waves go out."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxmpm as mpm
from benchmarks.accuracy import earthquakes_ends
from jaxmpm.equations import beyond_ends, free_field
from tests.differences import check_run

HALVES = mpm.Discretisation(1.0, (0.5, 0.5))
SOIL = mpm.Soil(unit_weight=19620.0, young=2e7, poisson=0.2)
POOL = [(0, 5), (8, 3), (12, 3)]
LAYERS = [mpm.Layer(replace(SOIL, young=8e7), bottom=[(0, 3), (4, 3)]), mpm.Layer(SOIL)]


def shaking(amplitude=1.0, seconds=1.0, interval=0.01):
    times = np.arange(0, seconds + interval, interval)
    base = amplitude * np.stack([np.sin(25 * times), 0.5 * np.cos(9 * times)])
    return mpm.BaseMotion(jnp.asarray(base), jnp.asarray(interval))


def layer(cells=4, ends="free field", soil=SOIL, numerics=HALVES, **loads):
    loads = {"motion": shaking(), "speed": 1.0} | loads
    return mpm.section(mpm.Section([(0, 6), (cells, 6)]), soil, numerics, ends=ends, **loads)


def slope(**choices):
    drawn = mpm.Section([(0, 6), (4, 6), (8, 4), (12, 4)])
    return mpm.section(drawn, SOIL, HALVES, ends="free field", **{"motion": shaking(), "speed": 1.0} | choices)


def by_column(scene, values):
    """Values (c, N) of the particles as (c, columns, rows)."""
    x, z = np.asarray(scene.particles.position)
    return np.asarray(values)[:, np.lexsort((z, x))].reshape(len(values), np.unique(x).size, -1)


@pytest.mark.usefixtures("x64")
def test_level_ground_between_free_fields_moves_as_ground_without_ends_on_both_engines():
    # Small motion: particles do not leave their cells, and the two differ by rounding and the square of the strain.
    loads = {"motion": shaking(1e-4), "gravity": 0.0, "soil": LAYERS}
    (open_, start), (tied, once) = (layer(ends=ends, **loads) for ends in ("free field", "tied"))
    again = jax.tree.map(jnp.copy, start)
    end, endless = (
        mpm.run.advance_lanes(scene, state, jnp.asarray(100), None) for scene, state in ((open_, start), (tied, once))
    )
    computed, wanted = by_column(open_, end.displacement), by_column(tied, endless.displacement)
    assert np.abs(computed - wanted).max() < 1e-4 * np.abs(wanted).max()
    for own in end.free_field:
        assert np.allclose(np.unique(np.round(own.displacement[0], 12)), np.unique(np.round(wanted[0], 12)))
    other = mpm.run.advance_lanes(
        replace(open_, numerics=replace(open_.numerics, engine=mpm.Engine.XLA)), again, jnp.asarray(100), None
    )
    for ours, theirs in zip((end, *end.free_field), (other, *other.free_field), strict=True):
        for name in ("displacement", "velocity", "stress"):
            one, its = (np.asarray(getattr(each, name)) for each in (ours, theirs))
            np.testing.assert_allclose(its, one, rtol=0, atol=1e-11 * np.abs(one).max())


@pytest.mark.usefixtures("x64")
def test_level_ground_at_rest_stays_at_rest():
    scene, state = layer(motion=shaking(0.0), soil=LAYERS)
    end = mpm.run.advance_lanes(scene, jax.tree.map(jnp.copy, state), jnp.asarray(60), None)
    fallen = 9.81 / 2 * (60 * float(scene.numerics.time_step)) ** 2
    assert float(jnp.abs(end.displacement).max()) < 1e-6 * fallen


@pytest.mark.usefixtures("x64")
def test_the_ends_have_the_impedance_of_their_soil_to_both_waves():
    """Lysmer and Kuhlemeyer's rho c per area, over the height of the ground."""
    scene, state = layer(gravity=0.0, numerics=mpm.Discretisation(0.5, (0.25, 0.25)))
    impedance = jax.jit(free_field)(scene, state, scene.numerics.time_step).impedance
    density, ratio = SOIL.unit_weight / 9.81, SOIL.poisson
    shear = SOIL.young / (2 * (1 + ratio))
    moduli = np.array([2 * shear * (1 - ratio) / (1 - 2 * ratio), shear])
    np.testing.assert_allclose(impedance.sum(axis=1), [6 * np.sqrt(density * moduli)] * 2, rtol=1e-3)


@pytest.mark.usefixtures("x64")
@pytest.mark.slow
def test_ends_of_unlike_height_move_each_as_its_own_ground():
    drawn = mpm.Section([(0, 8), (40, 8), (48, 4), (88, 4)])
    soil, numerics = replace(SOIL, young=1e8), replace(HALVES, damping=2.0)
    scene, state = mpm.section(drawn, soil, numerics, ends="free field", motion=shaking(), speed=1.0)
    still = replace(scene.loads.motion, acceleration=0 * scene.loads.motion.acceleration)
    calm = replace(scene, loads=replace(scene.loads, motion=still))
    still = mpm.solve(calm, state, t_end=0.5).raise_if_failed().state
    end = mpm.solve(scene, state, t_end=0.5).raise_if_failed().state
    assert float(jnp.abs(still.displacement).max()) < 1e-3 * float(jnp.abs(end.displacement).max())
    x, z = np.asarray(scene.particles.position)
    for own, at in zip(end.free_field, (0.25, 87.75), strict=True):
        beside = np.asarray(end.velocity[0])[x == at][np.argsort(z[x == at])]
        column = np.unique(np.round(own.velocity[0], 12))
        assert np.abs(np.sort(beside) - column).max() < 0.1 * np.abs(column).max()


@pytest.mark.usefixtures("x64")
@pytest.mark.slow
@pytest.mark.parametrize("wave", ["P", "S"])
def test_a_pulse_goes_out(wave):
    row = earthquakes_ends.pulse_row(wave, 0.5)
    assert row["sent_back"] < 0.04
    assert row["by_a_roller"] > 0.9


@pytest.mark.usefixtures("x64")
@pytest.mark.slow
def test_gradients_pass_and_lanes_are_runs():
    scene, state = slope(gravity=0.0)

    def swung(scene, scale):
        motion = replace(scene.loads.motion, acceleration=scale * scene.loads.motion.acceleration)
        shaken = replace(scene, loads=replace(scene.loads, motion=motion))
        return jnp.sum(mpm.advance(shaken, state, 40).displacement[0] ** 2)

    check_run(swung, scene, (1.0,), (1e-6,), tolerance=1e-6)


def test_columns_are_the_ground_at_the_ends():
    drawn = mpm.Section([(0, 6), (4, 6), (8, 3), (12, 3)])
    sand = mpm.FrictionalSoil(1e3, 30.0, unit_weight=18e3)
    layers = [mpm.Layer(sand, bottom=[(0, 4), (8, 3), (12, 3)]), mpm.Layer(replace(sand, cohesion=5e3))]
    scene, state = mpm.section(drawn, layers, HALVES, ends="free field", water=POOL, at_rest=False)
    low, high = scene.free_field.low, scene.free_field.high
    assert scene.boundary.walls == (mpm.Wall(1, "low", 1, "fixed"),)
    assert [one.particles.mass.size for one in (low, high)] == [2 * 12, 2 * 6]
    assert set(np.asarray(low.material.cohesion).tolist()) == {1e3, 5e3}
    assert set(np.asarray(high.material.cohesion).ravel().tolist()) == {5e3}
    assert [float(one.loads.water.z[0]) for one in (low, high)] == [5, 3]
    assert not np.any(np.asarray(scene.free_field.reaction))
    weaker = mpm.reduced(scene, 2.0).free_field
    assert np.allclose(weaker.low.material.cohesion, low.material.cohesion / 2)
    assert [own.displacement.shape[1] for own in state.free_field] == [24, 12]


def test_columns_take_loads_and_choices_of_the_section_and_keep_their_water():
    sand = mpm.FrictionalSoil(1e3, 30.0, unit_weight=18e3)
    drawn, numerics = mpm.Section([(0, 6), (4, 6), (8, 3), (12, 3)]), replace(HALVES, damping=0.5, flip=0.9)
    pressed = mpm.section(drawn, sand, numerics, ends="free field", r_u=0.3, motion=shaking(), at_rest=False)
    flooded = mpm.section(drawn, sand, numerics, ends="free field", water=POOL, at_rest=False)
    for scene, state in (pressed, flooded):
        loads = replace(scene.loads, gravity=2 * scene.loads.gravity, body_force=lambda x, t: 0 * x)
        choices = replace(scene.numerics, damping=jnp.asarray(0.7), engine=mpm.Engine.XLA, scheme=mpm.Scheme.USL)
        varied = replace(scene, loads=loads, numerics=choices)
        built = (scene.free_field.low, scene.free_field.high)
        for (column, at), there in zip(beyond_ends(varied, replace(state, step=state.step + 7)), built, strict=True):
            assert column.numerics is choices
            for name in ("gravity", "motion", "body_force"):
                assert getattr(column.loads, name) is getattr(loads, name)
            for name in ("water", "pore_pressure"):
                assert getattr(column.loads, name) is getattr(there.loads, name)
            for name in ("grid", "particles", "material", "boundary", "free_field"):
                assert getattr(column, name) is getattr(there, name)
            assert int(at.step) == 7
        after = jax.eval_shape(mpm.step, varied, state, scene.numerics.time_step)
        assert jax.tree.map(jnp.shape, after) == jax.tree.map(jnp.shape, state)


REFUSED = {
    "scheme": ({"scheme": mpm.Scheme.USF}, "scheme = USF"),
    "kernel": ({"kernel": mpm.QuadraticBSpline}, "kernel = QuadraticBSpline"),
    "averages": ({"internal_length": 1.5}, "internal_length = 1.5 m with ends = 'free field'"),
}


@pytest.mark.parametrize(("choice", "message"), REFUSED.values(), ids=REFUSED)
def test_choices_that_a_free_field_cannot_have_are_refused(choice, message):
    with pytest.raises(ValueError, match=message):
        layer(numerics=replace(HALVES, **choice))


def test_ground_that_falls_at_an_end_is_refused():
    with pytest.raises(ValueError, match="top of layer 1 goes from 6 to 5 m within a cell of the wall at x = 8 m"):
        mpm.section(mpm.Section([(0, 8), (5, 8), (8, 5)]), SOIL, HALVES, ends="free field")


def test_what_needs_walls_says_so():
    scene, state = layer(at_rest=False)
    with pytest.raises(ValueError, match="hold nothing at rest"):
        mpm.at_rest(scene)
    with pytest.raises(ValueError, match="a factor of safety with ends = 'free field'"):
        mpm.factor_of_safety(scene, state)
