"""What counts as a failure: the displacement that a least volume of soil has exceeded."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

import jaxmpm as mpm
from cooperative.measure import OpenGround, consequences, exceeded
from jaxmpm import diagnostics
from jaxmpm.run import _stopping

SHAPE = mpm.Slope(crest=6, height=4, run_per_rise=1.0, toe=8, foundation=2)
SOIL = mpm.Soil(young=5e6, strength=15e3, tension_cutoff=0.0)
COARSE = mpm.Discretisation(1.0, (0.5, 0.5))
LIMIT, LEAST = 0.3, 0.8


@pytest.fixture(scope="module")
def slope():
    return mpm.slope(SHAPE, SOIL, COARSE)


def displaced(state, displacement):
    """The state with this length of displacement (N,) along z."""
    upwards = jnp.zeros_like(state.displacement).at[-1].set(jnp.asarray(displacement, jnp.float32))
    return replace(state, displacement=upwards)


def brute(displacement, volume, least):
    """The largest displacement that at least so much soil has, tried one by one."""
    return max(u for u in displacement if volume[displacement >= u].sum() >= least)


def test_it_is_the_largest_displacement_that_so_much_soil_has(slope):
    scene, state = slope
    rng = np.random.default_rng(0)
    volume = rng.uniform(0.05, 0.25, scene.particles.mass.size).astype(np.float32)
    scene = replace(scene, particles=replace(scene.particles, volume=jnp.asarray(volume)))
    displacement = rng.lognormal(-3, 1, volume.size).astype(np.float32)
    state = displaced(state, displacement)
    for least in (0.3, 2.0, 9.0):
        measured = float(diagnostics.exceeded_displacement(scene, state, least))
        # Half the smallest particle is left to rounding.
        assert measured == brute(displacement, volume.astype(float), least - volume.min() / 2)
        assert measured == exceeded(displacement, volume, least)
    for least in rng.uniform(0.3, 9.0, 300):
        assert exceeded(displacement, volume, least) == brute(
            displacement, volume.astype(float), least - volume.min() / 2
        )
    assert float(diagnostics.exceeded_displacement(scene, state, 1e-3)) == displacement.max()
    assert float(diagnostics.exceeded_displacement(scene, state, 1e6)) == displacement.min()
    with pytest.raises(ValueError, match="volume = 0: give a finite value above 0"):
        diagnostics.exceeded_displacement(scene, state, 0)


def test_soil_that_stands_finer_particles_and_single_grains_leave_it(slope):
    scene, state = slope
    own, count = scene.particles, scene.particles.mass.size
    displacement = np.random.default_rng(1).lognormal(-3, 1, count).astype(np.float32)
    known = float(diagnostics.exceeded_displacement(scene, displaced(state, displacement), 2.0))

    def measured(volume, displacement):
        particles = replace(own, position=jnp.zeros((2, len(volume))), volume=jnp.asarray(volume, jnp.float32))
        still = replace(state, displacement=jnp.zeros((2, len(volume))))
        of = replace(scene, particles=particles)
        return float(diagnostics.exceeded_displacement(of, displaced(still, displacement), 2.0))

    volume = np.asarray(own.volume)
    assert measured(np.tile(volume, 2), np.r_[displacement, np.zeros(count)]) == known
    assert measured(np.repeat(volume / 4, 4), np.repeat(displacement, 4)) == known
    grain = displacement.copy()
    grain[np.argmax(displacement)] = 50.0
    assert measured(volume, grain) == known


def test_a_run_ends_once_so_much_soil_has_passed_the_limit(slope):
    scene, state = slope
    grains = np.zeros(scene.particles.mass.size)
    grains[np.argsort(-np.asarray(scene.particles.position[-1]))[:2]] = LIMIT * 1.5

    def status(rule):
        return mpm.solve(scene, displaced(state, grains), t_end=0.5, rules=[rule]).status

    assert status(mpm.Exceeds(LIMIT)) == mpm.Status.DECIDED
    assert status(mpm.Exceeds(LIMIT, least_volume=LEAST)) == mpm.Status.FINISHED
    with pytest.raises(ValueError, match="least_volume = -1: give a finite value above 0"):
        mpm.Exceeds(LIMIT, least_volume=-1.0)


def test_lanes_and_samples_are_judged_by_it_apart(slope):
    scene, state = slope
    weak, strong = 8e3, 40e3
    choices = {"t_end": 2.0, "rules": [mpm.Settle(least_volume=LEAST), mpm.Exceeds(LIMIT, LEAST)]}
    varied, axes = mpm.run.lanes(scene, strength=jnp.asarray([weak, strong]))
    together = mpm.solve(varied, mpm.run.repeat(state, 2), axes=axes, **choices)
    assert together.status.tolist() == [mpm.Status.DECIDED, mpm.Status.SETTLED]
    samples = {"strength": [jnp.asarray(weak), jnp.asarray(strong)]}
    for number, result in mpm.solve_each(scene, state, samples, width=1, **choices):
        assert int(result.status) == together.status[number]
        reached = float(diagnostics.exceeded_displacement(scene, result.state, LEAST))
        assert (reached > LIMIT) == (number == 0)


def test_without_it_no_run_sorts_its_soil(slope):
    scene, state = slope

    def text(volume):
        return _stopping.measured.lower(scene, state, None, (mpm.Settle(slides=1.0, least_volume=volume),)).as_text()

    assert "sort" not in text(None)
    assert "sort" in text(LEAST)


def slid(scene, state, factor=1.6):
    """Displacement exceeded by a least volume, mean over all soil, and factor of safety of a weak slope."""
    result = mpm.solve(mpm.reduced(scene, factor), state, t_end=1.5)
    least = LEAST if scene.grid.dimension == 2 else 8 * LEAST
    return (
        float(diagnostics.exceeded_displacement(scene, result.state, least)),
        float(diagnostics.mean_displacement(scene, result.state)),
    )


@pytest.fixture(scope="module")
def depths():
    """The same weak slope on 2 and on 8 m of soil twenty times as strong."""
    slopes = {}
    for base in (-2.0, -8.0):
        shape = mpm.Section([(0, 4), (6, 4), (10, 0), (20, 0)], base=base)
        # Stiff, so that the time in which all of it rings is short beside that of a slide.
        soil = replace(SOIL, young=5e7)
        layers = [mpm.Layer(soil, [(0, 0), (20, 0)]), mpm.Layer(replace(soil, strength=400e3))]
        slopes[base] = mpm.section(shape, layers, replace(COARSE, fbar=True))
    return slopes


def test_the_depth_of_the_foundation_changes_no_class(depths):
    (shallow, mean), (deep, mean_deep) = (slid(*depths[base]) for base in (-2.0, -8.0))
    assert min(shallow, deep) > LIMIT
    assert abs(deep / shallow - 1) < 0.03
    assert mean > 1.5 * mean_deep


@pytest.mark.slow
def test_the_depth_of_the_foundation_changes_no_factor_of_safety(depths):
    choices = {"criterion": "limit load", "least_volume": LEAST, "bracket": (1.0, 2.0), "resolution": 0.1, "batch": 2}
    shallow, deep = (mpm.factor_of_safety(*depths[base], t_end=4.0, **choices) for base in (-2.0, -8.0))
    assert abs(deep.kink / shallow.kink - 1) < 0.01


@pytest.mark.slow
def test_the_length_of_the_slope_changes_no_class():
    results = []
    for width in (16.0, 32.0):
        shape = replace(SHAPE, width=width)
        scene, state = mpm.slope(shape, SOIL, mpm.Discretisation(1.0, (0.5, 0.5, 0.5)), y_ends="roller")
        y = scene.particles.position[1]
        weak = jnp.where((y > 4) & (y < 12), 10e3, 400e3)
        results.append(slid(mpm.with_soil(scene, state, strength=weak)[0], state, 1.0))
    (short, mean), (long, mean_long) = results
    assert short > LIMIT
    assert abs(long / short - 1) < 0.03
    assert mean > 1.5 * mean_long


def test_the_displacement_of_a_slide_is_that_of_so_much_soil():
    position = np.stack(np.meshgrid(np.arange(20) + 0.5, np.arange(5) + 0.5), -1).reshape(-1, 2).T
    volume, displacement = np.ones(100), np.zeros((2, 100))
    displacement[0, :6] = 2.0
    displacement[0, 0] = 9.0
    ground = OpenGround(np.full(100, 5.0))
    half = np.array([0.5, 0.5])

    def measured(least):
        return consequences(
            position, displacement, volume, ground, half_size=half, least_volume=least
        ).displacement  # fmt: skip

    assert [measured(least) for least in (None, 1.0, 4.0, 7.0)] == [9.0, 9.0, 2.0, 0.0]
