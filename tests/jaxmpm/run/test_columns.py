"""What passes over each column of cells: against the same taken from every state of the run, and what is refused."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxmpm as mpm

SOIL = mpm.Soil(strength=11e3, young=5e6, softening_modulus=40e3, residual_ratio=0.7)
NUMERICS = mpm.Discretisation(1.0, (0.5, 0.5), cfl=0.8)


@pytest.fixture(scope="module")
def slope():
    shape = mpm.Slope(crest=4.0, height=4.0, run_per_rise=1.0, toe=14.0, foundation=1.0)
    return mpm.slope(shape, SOIL, NUMERICS)


def binned(scene, state, threshold):
    """Thickness, speed and mass of the soil that slid at least so far, by NumPy's histogram."""
    position = np.asarray(scene.particles.position + state.displacement, float)
    mass, volume = (np.asarray(a, float) for a in (scene.particles.mass, scene.particles.volume))
    slides = np.linalg.norm(np.asarray(state.displacement, float), axis=0) >= threshold
    edges = scene.grid.origin[0] + scene.grid.cell * np.arange(scene.grid.shape[0])

    def total(values):
        return np.histogram(position[0, slides], edges, weights=values[slides])[0]

    whole = total(mass)
    momentum = np.hypot(*(total(mass * np.asarray(v, float)) for v in state.velocity))
    return total(volume) / scene.grid.cell, momentum / np.where(whole > 0, whole, 1.0)


def test_it_keeps_what_every_look_shows(slope):
    scene, start = slope
    every, threshold = 10, 0.5
    dt, steps = float(scene.time_step), 400
    looked = mpm.with_columns(scene, start, moved=threshold, every=every)
    columns = mpm.solve(scene, looked, t_end=steps * dt).state.columns
    times = [number * dt for number in range(every, steps + 1, every)]
    states = mpm.solve(scene, start, t_end=steps * dt, snapshots=times).snapshots
    thickness, speed = (np.array(each) for each in zip(*(binned(scene, s, threshold) for s in states), strict=True))
    there = thickness >= columns.least
    assert 5 < there.any(axis=0).sum() < there.shape[1] - 4
    np.testing.assert_allclose(columns.thickness, thickness.max(axis=0), rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(columns.speed, np.where(there, speed, 0).max(axis=0), rtol=1e-4, atol=1e-5)
    first = np.where(there.any(axis=0), np.array(times)[there.argmax(axis=0)], np.inf)
    np.testing.assert_allclose(columns.arrival, first, rtol=1e-5)
    # The layer that a grain makes is below the threshold, that of a layer of particles above.
    assert 0.25 < columns.least < 0.5
    last = mpm.passing(scene, states[-1], threshold)
    slid = np.linalg.norm(np.asarray(states[-1].displacement), axis=0) >= threshold
    volume = float(np.sum(np.asarray(scene.particles.volume)[slid]))
    assert float(jnp.sum(last.thickness)) * scene.grid.cell == pytest.approx(volume, rel=1e-5)


def test_a_run_moves_the_same_and_goes_on_from_a_restart_point(slope, tmp_path):
    scene, start = slope
    looked = mpm.with_columns(scene, start, moved=0.5)
    dt = float(scene.time_step)
    whole = mpm.solve(scene, looked, t_end=400 * dt).state
    assert np.array_equal(whole.displacement, mpm.solve(scene, start, t_end=400 * dt).state.displacement)
    half = mpm.solve(scene, looked, t_end=210 * dt).state
    mpm.save_state(tmp_path / "half.h5", replace(half, status=start.status))
    again, _ = mpm.load_state(tmp_path / "half.h5", looked)
    for one, other in zip(
        jax.tree.leaves(mpm.solve(scene, again, t_end=190 * dt).state), jax.tree.leaves(whole), strict=True
    ):
        assert np.array_equal(one, other)


def test_columns_of_a_solid_lie_in_plan():
    scene, state = mpm.slope(
        mpm.Slope(crest=2.0, height=2.0, run_per_rise=1.0, toe=2.0, foundation=1.0, width=3.0),
        SOIL,
        mpm.Discretisation(1.0, (0.5, 0.5, 0.5)),
        at_rest=False,
    )
    assert mpm.run.column_shape(scene) == tuple(n - 1 for n in scene.grid.shape[:2])
    assert mpm.with_columns(scene, state).columns.arrival.shape == mpm.run.column_shape(scene)
    pushed = replace(state, displacement=state.displacement.at[1, 0].set(1.5))
    thickness = mpm.passing(scene, pushed, 1.0).thickness
    at = np.floor(np.asarray(scene.particles.position[:2, 0] + pushed.displacement[:2, 0]) - scene.grid.origin[:2])
    assert np.argwhere(np.asarray(thickness)).tolist() == [at.astype(int).tolist()]
    assert float(thickness.max()) == pytest.approx(0.125)


@pytest.mark.parametrize(
    ("asked", "message"),
    [({"moved": 0.0}, "moved = 0"), ({"every": 0}, "every = 0"), ({"least": -1.0}, "least = -1")],
)
def test_what_makes_no_sense_is_refused(slope, asked, message):
    with pytest.raises(ValueError, match=message):
        mpm.with_columns(*slope, **asked)
    with pytest.raises(ValueError, match="one dimension has no columns"):
        mpm.with_columns(*mpm.column(4.0, SOIL, mpm.Discretisation(1.0, (0.5,))))
