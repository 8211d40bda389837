"""Builders: counts, geometry, initial stress, and what they refuse."""

import importlib
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import jaxmpm as mpm
from jaxmpm import diagnostics
from jaxmpm.setup._initial_stress import elastic_equilibrium

PAPER_SOIL = mpm.Soil(strength=42e3, softening_modulus=85e3, tension_cutoff=0.0)
SECTION = mpm.Discretisation(2.0, (1.0, 1.0))
SMALL = mpm.Slope(crest=6, height=4, run_per_rise=1.0, toe=8, foundation=2)


def test_section_of_the_published_slope_has_888_square_metres():
    scene, _ = mpm.slope(mpm.Slope(), PAPER_SOIL, SECTION, at_rest=False)
    assert np.isclose(float(jnp.sum(scene.particles.volume)), 888.0)


def test_rough_published_slope_has_42624_particles():
    numerics = mpm.Discretisation(2.0, (1.0, 2.0, 1.0))
    scene, _ = mpm.slope(mpm.Slope(width=96.0), PAPER_SOIL, numerics, at_rest=False)
    assert scene.particles.mass.size == 42_624
    assert np.isclose(float(jnp.sum(scene.particles.volume)), 85_248.0)


@settings(max_examples=3)
@given(
    crest=st.integers(2, 6),
    height=st.integers(1, 5),
    ratio=st.sampled_from([0.0, 0.5, 1.0, 2.0]),
    toe=st.integers(4, 8),
)
def test_any_slope_fills_its_section_and_stays_below_its_surface(crest, height, ratio, toe):
    # An even length makes whole cells of 1 m; particles of half a metre.
    shape = mpm.Slope(crest=crest, height=2 * height, run_per_rise=ratio, toe=toe, foundation=2)
    scene, _ = mpm.slope(shape, mpm.Soil(), mpm.Discretisation(1.0, (0.5, 0.5)), at_rest=False)
    x, z = np.asarray(scene.particles.position)
    assert np.all(z < shape.heights(x))
    area = shape.length * 2 + 2 * height * crest + ratio * (2 * height) ** 2 / 2
    assert abs(float(jnp.sum(scene.particles.volume)) - area) <= 0.5 * ratio * 2 * height + 1e-4


def test_column_starts_with_its_own_weight_and_k0():
    scene, state = mpm.column(10.0, mpm.Soil(poisson=0.3), mpm.Discretisation(1.0, (0.5, 0.5, 0.5)))
    depth = 10.0 - np.asarray(scene.particles.position[2])
    inner = (depth > 1) & (depth < 9)  # the smoothing of the grid shows in the cells at both ends
    assert np.allclose(state.stress[2][inner], -20e3 * depth[inner], rtol=2e-3)
    assert np.allclose(state.stress[0][inner], 0.3 / 0.7 * np.asarray(state.stress[2])[inner], rtol=1e-3)


def test_initial_stress_is_where_damped_gravity_loading_ends():
    # The same slope loaded slowly enough to stay in small strains, damped near the critical rate.
    stiff = mpm.Soil(young=1e9, poisson=0.3)
    scene, state = mpm.slope(SMALL, stiff, mpm.Discretisation(1.0, (0.5, 0.5)))
    start = jnp.zeros_like(state.stress)
    direct, residual, _ = elastic_equilibrium(scene, start)
    damped = replace(scene, numerics=replace(scene.numerics, damping=jnp.asarray(150.0)))
    dynamic = mpm.solve(damped, replace(mpm.unstressed(scene), stress=start), t_end=1.0)
    assert float(residual) < 2e-5
    assert float(diagnostics.unbalanced_force(scene, dynamic.state)) < 1e-3
    scale = float(jnp.max(jnp.abs(direct)))
    assert float(jnp.max(jnp.abs(dynamic.state.stress - direct))) < 2e-3 * scale


@pytest.mark.parametrize("precise", [False, pytest.param(True, marks=pytest.mark.slow)], ids=["float32", "float64"])
def test_settled_slope_stays_within_a_millimetre_for_twenty_seconds(precise):
    with jax.enable_x64(precise):
        scene, state = mpm.slope(mpm.Slope(), PAPER_SOIL, SECTION)
        scene = mpm.reduced(scene, 0.5)
        # Even at twice its strength the crest yields at depth, where elastic stress exceeds it: let that end first.
        quiet = mpm.solve(
            replace(scene, numerics=replace(scene.numerics, damping=jnp.asarray(10.0, state.stress.dtype))),
            state,
            t_end=4.0,
        ).state
        settled = replace(
            mpm.unstressed(scene), stress=quiet.stress, history=quiet.history, volume_ratio=quiet.volume_ratio
        )
        result = mpm.solve(scene, settled, t_end=20.0).raise_if_failed()
        assert float(diagnostics.largest_displacement(result.state)) < 1e-3


def test_settled_lanes_end_early_and_sliding_ones_do_not():
    scene, state = mpm.slope(mpm.Slope(), PAPER_SOIL, SECTION)
    varied, axes = mpm.run.lanes(scene, strength=42e3 / jnp.asarray([0.7, 1.5]))
    result = mpm.solve(varied, mpm.run.repeat(state, 2), t_end=6.0, rules=[mpm.Settle()], axes=axes)
    assert list(result.status) == [mpm.Status.SETTLED, mpm.Status.FINISHED]
    assert int(result.state.step[0]) < int(result.state.step[1])


def test_snapshots_are_of_the_times_asked_for():
    scene, state = mpm.slope(SMALL, PAPER_SOIL, mpm.Discretisation(1.0, (0.5, 0.5)))
    result = mpm.solve(scene, state, t_end=0.2, snapshots=(0.0, 0.1, 0.2))
    dt = float(scene.numerics.time_step)
    assert [abs(int(s.step) * dt - t) <= dt for s, t in zip(result.snapshots, result.times, strict=True)] == [True] * 3
    assert np.array_equal(result.snapshots[2].displacement, result.state.displacement)
    # Times within a step have a snapshot each.
    result = mpm.solve(scene, state, t_end=0.2, snapshots=(0.2, 0.1, 0.1 + 1e-6))
    assert result.times == (0.1, 0.1 + 1e-6, 0.2)
    assert len(result.snapshots) == 3


SLOPE = mpm.Slope()
BAD_SLOPES = [
    ("height", replace(SLOPE, height=0.0), {}, {}, "height = 0 m"),
    ("crest", replace(SLOPE, crest=-3.0), {}, {}, "crest = -3 m"),
    ("width", replace(SLOPE, width=-1.0), {}, {"spacing": (1.0, 1.0, 1.0)}, "width = -1 m"),
    ("foundation", replace(SLOPE, foundation=float("nan")), {}, {}, "foundation = nan m"),
    ("run per rise", replace(SLOPE, run_per_rise=-2.0), {}, {}, "run_per_rise = -2"),
    ("no room", replace(SLOPE, toe=2.0), {}, {}, "toe = 2 m leaves no room for a run-out"),
    ("young", SLOPE, {"young": 0.0}, {}, "young = 0 Pa"),
    ("poisson", SLOPE, {"poisson": 0.5}, {}, "poisson = 0.5: give a value above -1 and below 0.5"),
    ("poisson low", SLOPE, {"poisson": -1.0}, {}, "poisson = -1"),
    ("unit weight", SLOPE, {"unit_weight": -1.0}, {}, "unit_weight = -1"),
    ("strength", SLOPE, {"strength": -42e3}, {}, "strength = -42000 Pa"),
    ("residual", SLOPE, {"residual_ratio": 1.5}, {}, "residual_ratio = 1.5"),
    ("snap-back", SLOPE, {"softening_modulus": 5e7}, {}, "snaps back"),
    ("cell", SLOPE, {}, {"cell": 0.0}, "cell = 0 m"),
    ("gaps", SLOPE, {}, {"cell": 1.0, "spacing": (2.0, 2.0)}, "spacing = 2 m leaves gaps in cells of 1 m"),
    ("divides", SLOPE, {}, {"spacing": (0.7, 1.0)}, r"no whole multiple of the spacing along x = 0.7 m"),
    ("walls", SLOPE, {}, {"cell": 1.8}, "length = 96 m is no whole multiple of cell = 1.8 m"),
    ("axes", SLOPE, {}, {"spacing": (1.0, 1.0, 1.0)}, "spacing = .* has 3 values: give 2"),
    ("cfl", SLOPE, {}, {"cfl": 1.5}, "cfl = 1.5"),
    ("cfl of USL", SLOPE, {}, {"cfl": 0.73, "scheme": mpm.Scheme.USL}, "cfl = 0.73 with scheme = USL, .* up to 0.72"),
    ("flip", SLOPE, {}, {"flip": 1.5}, "flip = 1.5"),
    ("damping", SLOPE, {}, {"damping": -1.0}, "damping = -1"),
    (
        "damping of a step",
        SLOPE,
        {},
        {"damping": 500.0},
        r"damping = 500 1/s in time steps of 0\.\d+ s: give less than",
    ),
    ("air", SLOPE, {}, {"air": 0.0}, "air = 0 m"),
    ("kernel", SLOPE, {}, {"kernel": "gimp"}, "kernel = 'gimp'"),
    ("scheme", SLOPE, {}, {"scheme": "MUSL"}, "scheme = 'MUSL'"),
    ("dtype", SLOPE, {}, {"dtype": "float16"}, "dtype = float16"),
    ("x64", SLOPE, {}, {"dtype": "float64"}, "jax_enable_x64"),
]


@pytest.mark.parametrize(
    ("shape", "soil", "numerics", "message"), [b[1:] for b in BAD_SLOPES], ids=[b[0] for b in BAD_SLOPES]
)
def test_bad_slopes_are_refused(shape, soil, numerics, message):
    with pytest.raises(ValueError, match=message):
        mpm.slope(shape, replace(PAPER_SOIL, **soil), replace(SECTION, **numerics))


HALVES = mpm.Discretisation(1.0, (0.5, 0.5))
HIGHER = replace(HALVES, air=2.5)


@pytest.mark.parametrize(
    "build",
    [
        lambda numerics: mpm.slope(SMALL, mpm.Soil(), numerics),
        lambda numerics: mpm.section(mpm.Section([(0, 6), (6, 6), (10, 2), (18, 2)]), mpm.Soil(), numerics),
        lambda numerics: mpm.column(3.0, mpm.Soil(), numerics),
    ],
    ids=["slope", "section", "column"],
)
def test_more_air_is_more_cells_above_and_nothing_else(build):
    (scene, state), (higher, same) = build(HALVES), build(HIGHER)
    assert [b - a for a, b in zip(scene.grid.shape, higher.grid.shape, strict=True)] == [0, 2]
    np.testing.assert_array_equal(scene.particles.position, higher.particles.position)
    np.testing.assert_allclose(state.stress, same.stress, rtol=1e-3, atol=5.0)


def test_soil_thrown_up_stays_where_there_is_air():
    """Thrown up at 6 m/s the column rises 1.8 m: out of one cell of air, not out of three."""
    ended = []
    for numerics in (HALVES, HIGHER):
        scene, state = mpm.column(2.0, mpm.Soil(young=1e6), replace(numerics, cfl=0.2), at_rest=False)
        state = replace(state, velocity=state.velocity.at[-1].set(6.0))
        open_above = replace(scene.boundary, walls=scene.boundary.walls[:-1])
        ended.append(mpm.solve(replace(scene, boundary=open_above), state, t_end=0.5).status)
    assert ended == [mpm.Status.OUTSIDE_GRID, mpm.Status.FINISHED]


def test_grid_too_small_for_the_block_is_refused():
    with pytest.raises(ValueError, match="beyond the domain of 2 m: enlarge the domain"):
        mpm.block((1, 1), mpm.Soil(), mpm.Discretisation(1.0, (0.5, 0.5)), domain=(2, 2), corner=(1.5, 0))


@pytest.mark.slow
def test_factor_of_safety_brackets_the_jump_and_refuses_a_wrong_bracket():
    shape = mpm.Slope(crest=10, height=6, run_per_rise=1.0, toe=14, foundation=2)
    scene, state = mpm.slope(shape, replace(PAPER_SOIL, strength=30e3), SECTION)
    result = mpm.factor_of_safety(scene, state, bracket=(0.8, 2.4), resolution=0.05, batch=4, t_end=8.0)
    tried = dict(result.tried)
    assert np.isclose(result.fails - result.stable, 0.05)
    assert tried[result.stable] <= 1.0 < tried[result.fails]
    with pytest.raises(ValueError, match=r"stands even at R = 0.9: widen the bracket"):
        mpm.factor_of_safety(scene, state, bracket=(0.8, 0.9), resolution=0.05, batch=2, t_end=8.0)
    with pytest.raises(ValueError, match=r"resolution = 2 exceeds the lower end of bracket"):
        mpm.factor_of_safety(scene, state, bracket=(0.5, 3.0), resolution=2.0)


def test_displacements_that_fall_with_the_factor_are_no_bracket(monkeypatch):
    scene, state = mpm.slope(mpm.Slope(), PAPER_SOIL, SECTION)
    module = importlib.import_module("jaxmpm.run._strength_reduction")
    monkeypatch.setattr(module, "_by_displacement", lambda limit, s, t, factors, *_: [(0.0, r < 1.5) for r in factors])
    with pytest.raises(ValueError, match=r"fails at R = 1 and stands at 2: its displacement does not grow with R"):
        mpm.factor_of_safety(scene, state, bracket=(1.0, 2.0), resolution=0.5, batch=2)


@pytest.mark.parametrize("batch", [2, 3, 5])
@pytest.mark.parametrize("turn", [1.03, 1.57, 2.99])
def test_each_round_has_at_most_a_batch_and_the_bracket_closes_on_the_factor(turn, batch, monkeypatch):
    scene, state = mpm.slope(mpm.Slope(), PAPER_SOIL, SECTION, at_rest=False)
    module, rounds = importlib.import_module("jaxmpm.run._strength_reduction"), []
    monkeypatch.setattr(module, "_by_displacement", lambda limit, s, t, factors, *_: [(0.0, r > turn) for r in factors])
    found = mpm.factor_of_safety(
        scene, state, bracket=(1.0, 3.0), resolution=0.02, batch=batch, progress=lambda r, _: rounds.append(len(r))
    )
    assert found.stable < turn < found.fails
    assert found.fails - found.stable == pytest.approx(0.02)
    assert max(rounds) <= batch


@pytest.mark.parametrize("settle", [mpm.Settle(least_volume=3.0), None])
def test_a_rule_by_which_lanes_stand_is_taken_as_it_is(settle, monkeypatch):
    scene, state = mpm.slope(mpm.Slope(), PAPER_SOIL, SECTION)
    taken = []

    def judged(exceeds, scene, state, factors, t_end, settle):
        taken.append(settle)
        return [(0.0, r > 1.5) for r in factors]

    monkeypatch.setattr(importlib.import_module("jaxmpm.run._strength_reduction"), "_by_displacement", judged)
    mpm.factor_of_safety(scene, state, bracket=(1.0, 2.0), resolution=0.5, batch=2, settle=settle, least_volume=5.0)
    assert taken[0] == (settle or mpm.Settle(least_volume=5.0))


@pytest.mark.slow
def test_a_slide_ends_when_its_deposit_rests_though_it_rings():
    scene, state = mpm.slope(mpm.Slope(), PAPER_SOIL, SECTION)
    varied, axes = mpm.run.lanes(scene, strength=42e3 / jnp.asarray([1.3, 1.5]))
    result = {
        slides: mpm.solve(
            varied, mpm.run.repeat(state, 2), t_end=20.0, rules=[mpm.Settle(slides=slides)], axes=axes
        ).raise_if_failed()
        for slides in (None, 1.0)
    }
    assert list(result[None].status) == [mpm.Status.FINISHED] * 2
    assert list(result[1.0].status) == [mpm.Status.SETTLED] * 2
    assert np.all(np.asarray(result[1.0].state.step) < 0.85 * np.asarray(result[None].state.step))
    ended, whole = (np.linalg.norm(result[slides].state.displacement, axis=1) for slides in (1.0, None))
    assert np.abs(ended - whole).max() < 0.5 * scene.grid.cell
    assert (ended > 1.0).sum() == pytest.approx((whole > 1.0).sum(), rel=0.02)


def test_a_slide_is_measured_by_its_own_mass():
    scene, state = mpm.slope(SMALL, PAPER_SOIL, mpm.Discretisation(1.0, (0.5, 0.5)))
    still = diagnostics.slide_displacement(scene, state, 1.0)
    share = jnp.arange(state.displacement.shape[1]) < state.displacement.shape[1] // 4
    slid = replace(state, displacement=jnp.where(share, 3.0, 0.2) * jnp.asarray([[1.0], [0.0]]))
    mean = (3.0 * share.sum() + 0.2 * (~share).sum()) / share.sum()
    assert (float(still), float(diagnostics.slide_displacement(scene, slid, 1.0))) == pytest.approx((0.0, float(mean)))
