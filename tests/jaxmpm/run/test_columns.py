"""What passes over each column of cells: against the same taken from every state of the run, and what is refused."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxmpm as mpm

SOIL = mpm.Soil(strength=11e3, young=5e6, softening_modulus=40e3, residual_ratio=0.7, tension_cutoff=0.0)
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
    dt, steps = float(scene.numerics.time_step), 400
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
    last = mpm.run.passing(scene, states[-1], threshold)
    slid = np.linalg.norm(np.asarray(states[-1].displacement), axis=0) >= threshold
    volume = float(np.sum(np.asarray(scene.particles.volume)[slid]))
    assert float(jnp.sum(last.thickness)) * scene.grid.cell == pytest.approx(volume, rel=1e-5)


def test_a_run_moves_the_same_and_goes_on_from_a_restart_point(slope, tmp_path):
    scene, start = slope
    looked = mpm.with_columns(scene, start, moved=0.5)
    dt = float(scene.numerics.time_step)
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
    thickness = mpm.run.passing(scene, pushed, 1.0).thickness
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


def heights(scene, shape):
    """Of the slope's surface at the grid's nodes in plan (m)."""
    nodes = [o + scene.grid.cell * np.arange(n) for o, n in zip(scene.grid.origin[:-1], scene.grid.shape, strict=False)]
    ends = shape.corner[0], shape.corner[0] + shape.extent[0]
    plan = np.meshgrid(np.clip(nodes[0], *ends), *nodes[1:], indexing="ij")
    return shape.heights(*(each.ravel() for each in plan)).reshape(plan[0].shape)


@pytest.mark.parametrize(("width", "cell"), [(None, 2.0), (3.0, 1.0)])
def test_soil_counts_as_far_as_it_is_above_the_surface_that_was_there(width, cell):
    """On level ground: soil that sinks or slides along counts nothing, lifted soil what sticks out."""
    shape = mpm.Slope(crest=2.0, height=2.0, run_per_rise=1.0, toe=8.0, foundation=4.0, width=width)
    spacing = (cell / 2,) * len(shape.extent)
    scene, state = mpm.slope(shape, SOIL, mpm.Discretisation(cell, spacing), at_rest=False)
    surface = mpm.with_columns(scene, state, surface=heights(scene, shape)).columns.surface
    position = np.asarray(scene.particles.position)
    level = position[0] > 6.0

    def volume(*shift):
        moved = np.where(level, np.array(shift)[[0, *([1] * (len(spacing) - 2)), 2], None], 0.0)
        thickness = mpm.run.passing(scene, replace(state, displacement=jnp.asarray(moved, jnp.float32)), 1.0, surface)
        return float(jnp.sum(thickness.thickness)) * scene.grid.cell ** (len(spacing) - 1)

    area = 6.0 * (width or 1.0)  # of the level ground from x = 6 m on
    assert volume(1.5, 0.0, 0.0) == pytest.approx(0.0, abs=1e-4)
    assert volume(0.5, 0.0, -1.0) == pytest.approx(0.0, abs=1e-4)
    assert volume(0.0, 0.0, 1.25) == pytest.approx(1.25 * area, rel=1e-5)
    assert volume(0.8, 0.0, 1.125) == pytest.approx(1.125 * area, rel=1e-5)


def test_a_slab_that_slides_along_its_slope_comes_over_none_of_it(slope):
    shape = mpm.Slope(crest=12.0, height=8.0, run_per_rise=2.0, toe=12.0, foundation=2.0)
    scene, state = mpm.slope(shape, SOIL, NUMERICS, at_rest=False)
    surface = mpm.with_columns(scene, state, surface=heights(scene, shape)).columns.surface
    x, z = np.asarray(scene.particles.position)
    slab = (x > 16.0) & (x < 22.0) & (shape.heights(x) - z < 1.5)
    moved = np.where(slab, np.array([2.0, -1.0])[:, None], 0.0)
    pushed = replace(state, displacement=jnp.asarray(moved, jnp.float32))
    assert float(mpm.run.passing(scene, pushed, 1.0).thickness.max()) > 1.0
    # Boxes of a lattice stick out of a slope by an eighth of a layer, whether they moved or not.
    assert float(mpm.run.passing(scene, pushed, 1.0, surface).thickness.max()) < 0.26 * 0.5


def test_a_surface_of_another_shape_is_refused(slope):
    scene, _ = slope
    with pytest.raises(ValueError, match=r"surface has shape \(3,\): give \(\d+,\) finite heights"):
        mpm.with_columns(*slope, surface=np.zeros(3))
    with pytest.raises(ValueError, match="finite heights"):
        mpm.with_columns(*slope, surface=np.full(scene.grid.shape[0], np.nan))
