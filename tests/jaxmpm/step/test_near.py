"""Nodes stored near soil alone: the answers of a grid that stores all, and room for soil that spreads."""

import math
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import jaxmpm as mpm
from jaxmpm.equations import closed, gaps
from jaxmpm.grid import Grid, Wall
from jaxmpm.run import lanes, repeat
from jaxmpm.setup import estimated_nodes, under_sky
from jaxmpm.transfer import GIMP, beside, g2p, near_soil, of_all, of_stored, p2g, with_room, within_cells
from jaxmpm.transfer._near import near_nodes
from jaxmpm.types import Engine

CLAY = mpm.Soil(young=5e6, strength=9e3, softening_modulus=40e3, tension_cutoff=0.0)
SAND = mpm.FrictionalSoil(0.5e3, 30.0, young=5e6, tension_cutoff=0.0)
FLAT = mpm.Discretisation(1.0, (0.5, 0.5))
STEEP = np.add.outer(8.0 - np.arange(6.0), np.zeros(4))


def everywhere(scene):
    return replace(scene, grid=replace(scene.grid, stored=None))


def close(a, b, tolerance=1e-9):
    a, b = np.asarray(a), np.asarray(b)
    assert np.abs(a - b).max() <= tolerance * np.abs(b).max()


def thrown(walls="friction", size=(3.0, 2.0), soil=CLAY, **numerics):
    """A block that flies into a corner of a large domain."""
    chosen = mpm.Discretisation(1.0, (0.5,) * len(size), **numerics)
    across, velocity = [6.0] * (len(size) - 1), [-2.0] * (len(size) - 1)
    return mpm.block(
        size, soil, chosen, domain=(*[40.0] * len(size),), corner=(*[1.0] * len(across), 1.0),
        velocity=(*velocity, -4.0), gravity=(*[0.0] * len(across), -9.81), walls=walls, speed=20.0,
        **({"friction": 0.3, "cohesion": 1e3} if walls == "friction" else {}),
    )  # fmt: skip


def on_bedrock(soil=SAND, numerics=None, **choices):
    """A layer on steep bedrock in three dimensions."""
    rock = mpm.Raster(STEEP, (0.0, 0.0), 2.0)
    surface = replace(rock, heights=STEEP + 0.8 + np.linspace(0, 0.5, 4))
    shape = mpm.Terrain(surface, base=0.0, bedrock=rock, **choices)
    chosen = mpm.Discretisation(1.0, (0.5,) * 3, **(numerics or {}))
    return mpm.terrain(shape, soil, chosen, at_rest=False, speed=20.0)


SCENES = {
    "friction": thrown,
    "rollers": partial(thrown, "roller", cell_average=True),
    "fixed": partial(thrown, "fixed", scheme=mpm.Scheme.USL, flip=0.95, xpic=2, fbar=True),
    "apic": partial(thrown, "fixed", kernel=mpm.QuadraticBSpline, apic=True, flip=0.0, scheme=mpm.Scheme.USF),
    "internal length": partial(thrown, "fixed", internal_length=1.5),
    "bridging": partial(thrown, "fixed", bridging=True, cell_average=True),
    "both on rock": partial(on_bedrock, CLAY, {"bridging": True, "internal_length": 1.5}),
    "contact": partial(on_bedrock, interface=mpm.Interface(20.0, 2e3)),
    "rock": partial(on_bedrock, CLAY),
}


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("name", SCENES)
def test_a_run_is_that_of_a_grid_that_stores_all(name):
    scene, state = SCENES[name]()
    near = mpm.follow_soil(scene)
    assert near.grid.stored < scene.grid.nodes
    steps = jnp.asarray(60)
    ours, theirs = (jax.jit(mpm.advance)(one, state, steps) for one in (near, everywhere(scene)))
    assert ours.status == theirs.status == mpm.Status.RUNNING
    assert ours.step == 60
    for field in ("displacement", "velocity", "stress", "volume_ratio"):
        close(getattr(ours, field), getattr(theirs, field), 1e-8)
    close(mpm.diagnostics.grid_velocity(near, ours), mpm.diagnostics.grid_velocity(everywhere(scene), ours), 1e-8)


@pytest.mark.parametrize("name", SCENES)
def test_a_run_does_not_depend_on_the_room_for_nodes(name):
    """Room grows while samples run, so that a run has other room after another sample than alone."""
    scene, state = SCENES[name]()

    def after(room):
        stored = replace(scene, grid=replace(scene.grid, stored=room))
        return jax.jit(mpm.advance)(stored, state, jnp.asarray(40))

    # XLA compiles sums over an axis to other instructions in arrays of 16 KiB or more.
    ours, *others = (after(room) for room in (mpm.follow_soil(scene).grid.stored, 1_500, 20_000))
    assert ours.status == mpm.Status.RUNNING
    for theirs in others:
        assert jax.tree.all(jax.tree.map(np.array_equal, ours, theirs))


@pytest.mark.usefixtures("x64")
def test_the_stress_at_rest_is_that_of_a_grid_that_stores_all():
    scene, state = on_bedrock(interface=mpm.Interface(40.0))
    near = mpm.follow_soil(scene)
    ours, theirs = (mpm.at_rest(one).stress for one in (near, everywhere(scene)))
    close(ours, theirs, 1e-6)
    assert np.any(ours != state.stress)


SHAPE, COUNT = (7, 6, 9), 40
KERNEL = GIMP((0.25, 0.25, 0.25))
WALLS = (Wall(0, "low", 1, "fixed"), Wall(1, "high", 4, "fixed"), Wall(2, "low", 1, "fixed"))


@jax.jit
def on_both(scene, position, carried, stress):
    """Sums at the nodes, gaps, forces, cell averages and what goes back to particles: near soil twice, and of all."""

    def on(one, engine=None):
        nodal = p2g(one.grid, KERNEL, position, carried, stress, engine=engine)
        values, gradient = g2p(one.grid, KERNEL, position, nodal, values=2, gradients=2, engine=engine)
        gap = gaps(one, nodal[:, 0])
        forces = closed(one, gap, nodal[:, -3:])
        averaged = within_cells(one.grid, position, carried[1], carried[0], carried[1] > 0, engine=engine)
        return [of_all(one.grid, a) for a in (nodal, gap, forces, mpm.boundary.hold(one, nodal[:, -3:]))], (
            values,
            gradient,
            averaged,
        )

    near = near_soil(replace(scene, grid=replace(scene.grid, stored=SHAPE[0] * SHAPE[1] * SHAPE[2])), position)
    return [on(near), on(near, Engine.XLA)], on(scene), near.grid.near


@pytest.mark.usefixtures("x64")
@given(st.integers(0, 2**32 - 1), st.floats(0.05, 1.0))
@settings(deadline=None, max_examples=25)
def test_transfers_and_nodes_agree_with_a_grid_that_stores_all(seed, spread):
    rng = np.random.default_rng(seed)
    middle = rng.uniform(1, np.array(SHAPE) - 2.5, (COUNT, 3)).T
    position = np.clip(
        middle.mean(axis=1, keepdims=True) * (1 - spread) + spread * middle, 0.51, np.array(SHAPE)[:, None] - 1.51
    )
    scene, _ = thrown(size=(2.0, 2.0, 2.0))
    cut = np.arange(SHAPE[-1]) < rng.integers(0, SHAPE[-1], SHAPE[:-1])[..., None]
    boundary = replace(scene.boundary, walls=WALLS, cut=jnp.asarray(cut.ravel()))
    scene = replace(everywhere(scene), grid=Grid(SHAPE, 1.0, (0.0,) * 3), boundary=boundary)
    carried = rng.uniform(0.5, 1.5, (2, COUNT)) * [[1.0], [1.0]] - [[0.0], [1.0]]
    stored, (nodal_of_all, back_of_all), near = on_both(
        scene, jnp.asarray(position), jnp.asarray(carried), jnp.asarray(rng.normal(size=(6, COUNT)))
    )
    # At a node that soil does not reach, gaps and forces act on nothing.
    reached = np.asarray(nodal_of_all[0][:, 0]) > 0
    theirs = [*(np.asarray(values)[reached] for values in nodal_of_all), *back_of_all]
    for nodal, back in stored:
        assert not np.asarray(nodal[0])[~reached].any()
        ours = [*(np.asarray(values)[reached] for values in nodal), *back]
        for a, b in zip(ours, theirs, strict=True):
            np.testing.assert_allclose(a, b, rtol=0, atol=1e-12 * max(1, np.abs(b).max()))
    assert set(np.flatnonzero(reached)) <= set(np.asarray(near.node)) - {-1}
    assert near.needed == (np.asarray(near.node) >= 0).sum()


@pytest.mark.parametrize("d", [2, 3])
@given(st.integers(0, 2**32 - 1))
@settings(deadline=None, max_examples=15)
def test_compiled_nodes_are_those_of_xla_and_know_their_neighbours(d, seed):
    rng = np.random.default_rng(seed)
    grid = replace(Grid(SHAPE[:d], 0.5, (-1.0,) * d), stored=[60, 200][d - 2])
    position = jnp.asarray(rng.uniform(-1.5, 4.0, (d, 1)) + rng.uniform(-1.2, 1.2, (d, 12)), jnp.float32)
    ours, theirs = (near_nodes(grid, position, engine=engine) for engine in (None, Engine.XLA))
    assert jax.tree.all(jax.tree.map(np.array_equal, ours, theirs))
    if ours.needed > grid.stored:
        return
    grid, rows = replace(grid, near=ours), {int(n): row for row, n in enumerate(np.asarray(ours.node)) if n >= 0}
    for axis in range(d):
        for step in (-1, 1):
            found = np.asarray(beside(grid, axis, step))
            for node, row in rows.items():
                at = np.array(np.unravel_index(node, grid.shape))
                at[axis] += step
                there = 0 <= at[axis] < grid.shape[axis]
                number = int(np.ravel_multi_index(at, grid.shape)) if there else -1
                assert found[row] == rows.get(number, -1)


def test_values_go_to_all_nodes_and_back():
    scene, _ = thrown()
    grid = near_soil(mpm.follow_soil(scene), scene.particles.position).grid
    values = jnp.arange(1.0, grid.nodes + 1)
    kept = np.asarray(of_all(grid, of_stored(grid, values)))
    assert set(np.flatnonzero(kept)) == set(np.asarray(grid.near.node)) - {-1}
    assert np.array_equal(kept[kept > 0], np.asarray(values)[kept > 0])


def burst():
    """Soil that flies apart, from a block over far more nodes than it starts with, with room for its start."""
    scene, state = thrown("roller", soil=mpm.Soil(young=1e5, strength=50.0, tension_cutoff=0.0, unusual=True))
    away = scene.particles.position - scene.particles.position.mean(axis=1, keepdims=True)
    state = replace(state, velocity=state.velocity * 0 + jnp.abs(away) * 8.0)
    tight = with_room(scene.grid, scene.particles.position).stored // 2
    return replace(scene, grid=replace(scene.grid, stored=tight)), state


@pytest.mark.usefixtures("x64")
def test_soil_that_spreads_far_gets_more_nodes_and_ends_as_on_a_grid_that_stores_all():
    scene, state = burst()
    ended = mpm.solve(scene, state, t_end=1.5, snapshots=[0.7]).raise_if_failed()
    theirs = mpm.solve(everywhere(scene), state, t_end=1.5, snapshots=[0.7])
    assert ended.state.step == theirs.state.step
    assert float(mpm.diagnostics.largest_displacement(ended.state)) > 10
    close(ended.state.displacement, theirs.state.displacement)
    close(ended.snapshots[0].velocity, theirs.snapshots[0].velocity)
    # Without more nodes the lane takes no step, and says so.
    full = jax.jit(mpm.advance)(scene, state, jnp.asarray(int(ended.state.step)))
    assert full.status == mpm.Status.GRID_FULL
    assert 0 < full.step < ended.state.step
    again, _ = mpm.replay(scene, state, int(full.step))
    close(full.displacement, again.displacement)
    # A run that is taken again makes room too; within jit it warns, and goes no further.
    steps = int(ended.state.step)
    again, _ = mpm.replay(scene, state, steps)
    close(again.displacement, ended.state.displacement)
    assert np.array_equal(mpm.replay(scene, full, steps)[0].displacement, full.displacement)
    with pytest.warns(UserWarning, match=r"more nodes than the scene stores.*follow_soil\(scene, result.state\)"):
        stopped = jax.block_until_ready(jax.jit(lambda state: mpm.replay(scene, state, steps)[0])(state))
    assert (stopped.status, stopped.step) == (mpm.Status.GRID_FULL, full.step)
    # From there a run goes on, with room for its soil, bit for bit.
    roomy = mpm.follow_soil(scene, ended.state)
    assert roomy.grid.stored > scene.grid.stored
    rest = mpm.solve(roomy, replace(full, status=jnp.int32(0)), t_end=1.5 - float(full.step * scene.numerics.time_step))
    assert np.array_equal(rest.state.displacement, ended.state.displacement)


@pytest.mark.usefixtures("x64")
@pytest.mark.filterwarnings("ignore:soil reaches more nodes")
def test_sensitivity_asks_for_room():
    scene, state = burst()
    steps = int(mpm.solve(scene, state, t_end=1.5).state.step)
    with pytest.raises(FloatingPointError, match=r"GRID_FULL\): give the scene from follow_soil"):
        mpm.run.sensitivity(scene, state, mpm.run.objectives.log_displacement, steps=steps, parameters=["strength"])


def test_soil_thrown_beyond_the_box_of_a_terrain_flies_on_and_ends_at_the_top_of_the_sky():
    rock = mpm.Raster(np.add.outer(60.0 - 2 * np.arange(31.0), np.zeros(21)), (0.0, 0.0), 2.0)
    crest = rock.points()[0] < 8
    pile = replace(rock, heights=rock.heights + np.where(crest, 3.0, 0.0).reshape(rock.heights.shape))
    shape = mpm.Terrain(pile, base=-4.0, bedrock=rock, interface=mpm.Interface(30.0))

    def thrown_up(speed, **choices):
        numerics = mpm.Discretisation(2.0, (1.0,) * 3, **choices)
        scene, state = mpm.terrain(shape, CLAY, numerics, at_rest=False, speed=20.0)
        return scene, replace(state, velocity=state.velocity.at[2].set(speed))

    (scene, state), (boxed, _), (high, _) = thrown_up(15.0), thrown_up(15.0, air=2.0), thrown_up(15.0, air=24.0)
    assert scene.grid.stored == boxed.grid.stored < boxed.grid.nodes / 8
    # A throw at the speed that the step allows for: 20 m/s.
    assert scene.grid.shape[2] == boxed.grid.shape[2] + math.ceil(20**2 / (2 * 9.81) / 2)
    ended = mpm.solve(scene, state, t_end=2.5, snapshots=[1.5]).raise_if_failed()
    top = boxed.grid.origin[2] + boxed.grid.cell * (boxed.grid.shape[2] - 1)
    assert mpm.solve(boxed, state, t_end=2.5).status == mpm.Status.OUTSIDE_GRID
    assert float(jnp.max((scene.particles.position + ended.snapshots[0].displacement)[2])) > top + 5
    theirs = mpm.solve(everywhere(high), state, t_end=2.5).raise_if_failed()
    close(ended.state.displacement, theirs.state.displacement)
    _, faster = thrown_up(26.0)
    beyond = mpm.solve(scene, faster, t_end=3.5)
    assert beyond.status == mpm.Status.OUTSIDE_GRID
    assert float(jnp.max((scene.particles.position + beyond.state.displacement)[2])) > top + 18


def test_what_constrains_the_sky_is_what_constrains_the_highest_nodes():
    polygon = ((2.0, 0.5), (9.0, 0.5), (9.0, 5.5), (2.0, 5.5))
    scene, _ = on_bedrock(CLAY, polygon=polygon, interface=mpm.Interface(20.0))
    assert under_sky(everywhere(scene), 3.0).grid == everywhere(scene).grid
    scene = mpm.follow_soil(scene)
    levels, higher = scene.grid.shape[-1], under_sky(scene, 3.0)
    assert higher.grid.shape == (*scene.grid.shape[:-1], levels + 3)
    assert under_sky(scene, 1e9).grid.shape[-1] == 2 * levels

    def in_columns(scene):
        held = scene.boundary
        return [np.asarray(values).reshape(scene.grid.shape) for values in (held.cut, held.base.area)]

    (cut, base), (raised_cut, area) = in_columns(scene), in_columns(higher)
    assert cut[..., -1].any()
    assert np.array_equal(raised_cut, np.concatenate([cut, *[cut[..., -1:]] * 3], axis=-1))
    assert np.array_equal(area[..., :levels], base)
    assert not area[..., levels:].any()


def test_lanes_have_nodes_of_their_own():
    scene, state = burst()
    strengths = jnp.array([50.0, 2e4], jnp.float32)
    varied, axes = lanes(scene, strength=strengths)
    together = mpm.solve(varied, repeat(state, 2), t_end=0.5, axes=axes, rules=[mpm.Exceeds(1e3)]).raise_if_failed()
    for lane, strength in enumerate(strengths):
        alone = replace(scene, material=replace(scene.material, strength=strength))
        ended = mpm.solve(alone, state, t_end=0.5).state
        assert np.array_equal(together.state.displacement[lane], ended.displacement)
    samples = {"strength": [50.0, 2e4, 1e3]}
    one, two = (dict(mpm.solve_each(scene, state, samples, width=width, t_end=0.5)) for width in (1, 2))
    for number, result in one.items():
        assert result.status == mpm.Status.FINISHED
        assert np.array_equal(result.state.displacement, two[number].state.displacement)


@pytest.mark.usefixtures("x64")
def test_derivatives_are_those_of_a_grid_that_stores_all():
    scene, state = thrown()

    def far(scene, strength):
        law = replace(scene.material, strength=strength)
        final, _ = mpm.replay(replace(scene, material=law), state, 40)
        return jnp.sum(final.displacement**2)

    near = mpm.follow_soil(scene)
    ours, theirs = (jax.grad(far, argnums=1)(one, scene.material.strength) for one in (near, everywhere(scene)))
    forward = jax.jvp(partial(far, near), (scene.material.strength,), (jnp.ones(()),))[1]
    assert theirs != 0
    close(ours, theirs, 1e-7)
    close(forward, theirs, 1e-7)


def test_a_box_of_mostly_air_follows_its_soil_and_others_store_all():
    scene, _ = thrown(size=(2.0, 2.0, 2.0))
    assert scene.grid.stored == mpm.follow_soil(scene).grid.stored < scene.grid.nodes / 50
    full, state = mpm.slope(mpm.Slope(crest=6, height=4, run_per_rise=1.0, toe=8, foundation=2), CLAY, FLAT)
    assert full.grid.stored is None

    def program(scene):
        return jax.jit(mpm.step).lower(scene, state, scene.numerics.time_step).as_text()

    assert "jaxmpm_near" in program(mpm.follow_soil(full))
    assert "jaxmpm_near" not in program(full)


def test_the_nodes_of_a_terrain_are_known_before_it_is_built():
    rock = mpm.Raster(np.tile(-0.55 * np.arange(0.0, 41.0, 2.0)[:, None], (1, 9)), (0.0, 0.0), 2.0)
    shape = mpm.Terrain(replace(rock, heights=rock.heights + 1.0), base=-90.0, bedrock=rock)
    scene, _ = mpm.terrain(shape, CLAY, mpm.Discretisation(1.0, (0.5,) * 3), at_rest=False, speed=20.0)
    counts = [count + 3 for count in mpm.ground.cells(shape, mpm.Discretisation(1.0, (0.5,) * 3))]
    asked = math.prod(counts), math.prod(counts[:-1]), mpm.ground.volume(shape)
    assert 1 <= estimated_nodes(scene, *asked) / scene.grid.stored < 1.3
    tied = replace(scene, boundary=replace(scene.boundary, tied=(2, 6)))
    assert estimated_nodes(tied, *asked) == asked[0]
    assert estimated_nodes(scene, 4000, 100, 10) == 4000


def test_planes_of_nodes_that_are_one_are_all_stored():
    scene, _ = thrown()
    tied = replace(everywhere(scene), boundary=replace(scene.boundary, tied=(2, 6)))
    with pytest.raises(ValueError, match="need nodes that soil does not reach: store all nodes"):
        mpm.follow_soil(tied)


@pytest.mark.parametrize("choice", [{"internal_length": 1.5}, {"bridging": True}])
def test_no_sky_is_added_where_a_step_works_on_all_nodes(choice):
    scene, (plain, _) = mpm.follow_soil(thrown(**choice)[0]), thrown()
    assert under_sky(scene, 3.0) is scene
    assert under_sky(mpm.follow_soil(plain), 3.0).grid.shape[-1] == scene.grid.shape[-1] + 3


def test_traced_positions_are_refused():
    scene, _ = thrown()

    def stored(position):
        return mpm.follow_soil(replace(scene, particles=replace(scene.particles, position=position))).grid.stored

    with pytest.raises(ValueError, match="where soil is, is traced: choose the nodes that are stored outside of jit"):
        jax.jit(stored)(scene.particles.position)
