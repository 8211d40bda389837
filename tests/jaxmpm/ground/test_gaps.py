"""Undrained soil that slides above rigid ground by a share of a cell: its drag, and what else is left alone."""

from dataclasses import replace

import hypothesis.strategies as st
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import example, given, settings

import jaxmpm as mpm
from benchmarks.stability import stability_gap
from jaxmpm import equations
from jaxmpm.equations import gap_of
from jaxmpm.equations._gaps import NARROW, WIDE
from tests.jaxmpm.step.test_absent import program

FILLED = st.floats(0.1, 4.0)


@given(st.floats(2 * NARROW + 1e-3, WIDE - 1e-3), FILLED)
def test_the_gap_follows_from_two_masses_whatever_part_of_the_ground_is_covered(gap, cover):
    assert float(gap_of(cover * (1 - gap) ** 2 / 2, cover * (1 - gap**2 / 2))) == pytest.approx(gap, abs=1e-3)


@given(st.floats(0.05, 2.0), FILLED)
def test_a_thin_layer_lies_on_the_ground(thickness, cover):
    first, second = (
        np.trapezoid(np.clip(1 - np.abs(z - node), 0, None), z)
        for z, node in ((np.linspace(0, thickness, 2001), node) for node in (0, 1))
    )
    assert float(gap_of(cover * first, cover * second)) == 0


MASS = st.just(0.0) | st.floats(-38, 6).map(lambda power: 10.0**power)


@example(0.0, 0.0)
@example(0.0, 2.4e-35)
@example(4e-25, 1e-30)
@given(MASS, MASS)
def test_a_gap_has_a_finite_derivative_by_any_masses(first, second):
    with jax.enable_x64(False):
        masses = jnp.float32(first), jnp.float32(second)
        gap, slopes = jax.value_and_grad(gap_of, argnums=(0, 1))(*masses)
    assert np.isfinite(slopes).all()
    assert 0 <= gap <= np.float32(WIDE)
    assert float(gap) == 0 or first < second


DRAGS = [
    ("fixed", 0.5, {}),
    ("interface", 0.75, {}),
    ("bedrock", 0.5, {"offset": -0.4}),
    ("stuck bedrock", 0.25, {"offset": 0.4}),
]


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize(("ground", "gap", "choices"), DRAGS, ids=[ground for ground, *_ in DRAGS])
def test_clay_is_held_by_all_of_its_strength_at_every_gap(ground, gap, choices):
    """Without what closes the gap it would be held by 0.5, 0.06, 0.94 and 0.35 of it."""
    row = stability_gap.drag_row(ground, gap, cells=4, **choices)
    assert row["passed"], row
    assert row["drag"] == pytest.approx(1, abs=0.02)


def sliding(soil, **choices):
    scene, state = mpm.section(
        mpm.Section([(0, 4), (4, 4)]),
        soil,
        mpm.Discretisation(1.0, (0.5, 0.5), **choices),
        ends="tied",
    )
    up = scene.particles.position.at[1].add(0.4)
    return replace(scene, particles=replace(scene.particles, position=up)), state


CLAY = mpm.Soil(unit_weight=20e3, young=2e7, poisson=0.49, strength=20e3, tension_cutoff=0.0)
SAND = mpm.FrictionalSoil(0.0, 30.0, unit_weight=20e3, young=2e7)


def test_forces_across_a_gap_are_equal_and_opposite_along_the_ground_alone():
    scene, _ = sliding(CLAY)
    force = jnp.asarray(np.random.default_rng(0).normal(size=(scene.grid.nodes, 2)), jnp.float32)
    mass = equations.Maps(scene, scene.particles.position).to_grid(scene.particles.mass[None], None)[:, 0]
    gap = equations.gaps(scene, mass)
    assert float(gap.max()) == pytest.approx(0.4, abs=0.01)
    change = np.asarray(equations.closed(scene, gap, force) - force)
    assert np.abs(change).max() > 0.1
    np.testing.assert_allclose(change.sum(axis=0), 0, atol=1e-5)
    assert not change[:, 1].any()
    pulls = np.asarray(force)[:, 1] >= 0
    lowest = np.arange(scene.grid.nodes).reshape(scene.grid.shape)[:, scene.boundary.walls[0].index]
    assert not change[lowest[pulls[lowest]]].any()


def test_soil_with_friction_has_nothing_of_it_in_its_program():
    for soil, found in ((SAND, False), (CLAY, True)):
        scene, state = sliding(soil)
        assert equations.sheared(scene) is found
        walls = tuple(replace(wall, hold="roller") for wall in scene.boundary.walls)
        rollers = replace(scene, boundary=replace(scene.boundary, walls=walls))
        assert equations.sheared(rollers) is False
        assert equations.gaps(rollers, jnp.ones(scene.grid.nodes)) is None
        sqrts = [program(each, state).count("stablehlo.sqrt ") for each in (scene, rollers)]
        assert sqrts[0] == sqrts[1] + found


def test_of_layers_of_both_kinds_the_clay_alone_is_held_across_a_gap():
    weak = replace(CLAY, unusual=True)  # beside the sand, in few cells
    layers = [mpm.Layer(SAND, [(0, 1.5), (4, 1.5)]), mpm.Layer(weak)]
    drags = []
    for order in (layers, [replace(layers[0], soil=weak), replace(layers[1], soil=replace(SAND, cohesion=20e3))]):
        scene, state = mpm.section(
            mpm.Section([(0, 4), (4, 4)]), order, mpm.Discretisation(1.0, (0.5, 0.5)), ends="tied"
        )
        up = scene.particles.position.at[1].add(0.4)
        scene = replace(scene, particles=replace(scene.particles, position=up))
        shear = state.stress.at[3].set(10e3)
        nodal = equations.particles_to_grid(
            scene, replace(state, stress=shear), scene.numerics.time_step, equations.Maps(scene, up)
        )
        force = np.asarray(nodal.force).reshape(*scene.grid.shape, 2)[1:5, scene.boundary.walls[0].index, 0]
        drags.append(-force.sum() / (4 * 10e3))
    assert np.abs(drags) == pytest.approx([1.0, 0.6], abs=0.01)


@pytest.mark.parametrize("scheme", [mpm.Scheme.USF, mpm.Scheme.USL])
def test_other_schemes_close_gaps_too(scheme):
    scene, state = sliding(CLAY, scheme=scheme, cell_average=True)
    state = replace(state, velocity=state.velocity.at[0].set(3.0))
    start = mpm.advance(scene, state, jnp.asarray(30))
    steps = 60
    end = mpm.advance(scene, start, jnp.asarray(steps))
    lost = float(jnp.sum(scene.particles.mass * (start.velocity[0] - end.velocity[0])))
    assert lost / (steps * float(scene.numerics.time_step) * 20e3 * 4) == pytest.approx(1, abs=0.05)


def two_bodies(bed, gap, soil=CLAY, dimension=2, bridging=True, cell=1.0):
    """Soil four cells high with tied ends, of which the part above `bed` (cells) is lifted by a gap (cells)."""
    numerics = mpm.Discretisation(cell, (cell / 2,) * dimension, bridging=bridging)
    if dimension == 2:
        level = mpm.Section([(0, 4 * cell), (3 * cell, 4 * cell)])
        scene, state = mpm.section(level, soil, numerics, ends="tied", at_rest=False)
    else:
        flat = mpm.Raster(np.full((4, 4), 4 * cell), (0, 0), cell)
        scene, state = mpm.terrain(mpm.Terrain(flat, 0.0), soil, numerics, at_rest=False)
    position = scene.particles.position
    up = jnp.where(position[-1] > bed * cell, gap * cell, 0.0)
    return replace(scene, particles=replace(scene.particles, position=position.at[-1].add(up))), state


def along_planes(scene, stress):
    """Forces (nodes, d - 1) N along level planes, without and with what crosses gaps, by planes from the base up."""
    d, maps = scene.grid.dimension, equations.Maps(scene, scene.particles.position)
    volume = scene.particles.volume
    sums = maps.to_grid(None, stress * volume, equations.by_levels(scene, volume, stress * volume))
    force = sums[:, :d]
    gap = equations.gaps(scene, maps.to_grid(scene.particles.mass[None], None)[:, 0])
    change = np.asarray(equations.bridged(scene, sums[:, d:], force, gap) - force)
    assert not change[:, -1].any()
    size = float(jnp.abs(force).max())
    np.testing.assert_allclose(change.sum(axis=0), 0, atol=1e-5 * size)
    return (np.asarray(each).reshape(-1, scene.grid.shape[-1], d)[..., :-1] for each in (force, force + change))


@pytest.mark.usefixtures("x64")
@settings(max_examples=10)
@given(
    bed=st.sampled_from([0.5, 1.0, 1.5, 2.0]),
    gap=st.sampled_from([0.12, 0.3, 0.45, 0.65, 0.8]),
    cell=st.sampled_from([0.5, 2.0]),
)
def test_shear_stress_crosses_a_gap_between_soils_undiminished(bed, gap, cell):
    scene, _ = two_bodies(bed, gap, cell=cell)
    plain, bridged = along_planes(scene, jnp.zeros((3, scene.particles.mass.size)).at[2].set(10e3))
    inside = slice(scene.boundary.walls[-1].index + 1, scene.boundary.walls[-1].index + 4)
    assert np.abs(plain[:, inside]).max() > 0.08 * 10e3 * cell
    assert np.abs(bridged[:, inside]).max() < 1e-6 * 10e3 * cell


def test_shear_stress_across_a_gap_in_3d_acts_along_both_axes():
    scene, _ = two_bodies(1.0, 0.4, dimension=3)
    stress = jnp.zeros((6, scene.particles.mass.size)).at[4].set(5e3).at[5].set(10e3)
    plain, bridged = along_planes(scene, stress)
    # Nodes whose cells are all within the walls.
    inner = np.ones((*scene.grid.shape[:-1], 2), bool)
    inner[2:-2, 2:-2] = False
    level = scene.boundary.walls[-1].index + 1
    left = np.where(inner.reshape(-1, 2), 0, bridged[:, level])
    assert np.abs(plain[:, level]).max() > 3e3
    assert np.abs(left).max() < 1e-2


@settings(max_examples=8)
@given(st.floats(0.0, 0.95), st.integers(0, 99))
def test_one_body_has_no_gap_however_high_its_surface(height, seed):
    scene, _ = two_bodies(3.0, 0.0)
    keep = scene.particles.position[1] < 4 - height
    volume = jnp.where(keep, scene.particles.volume, 0)
    scene = replace(scene, particles=replace(scene.particles, volume=volume))
    stress = jnp.asarray(np.random.default_rng(seed).normal(size=(3, volume.size)), jnp.float32)
    plain, bridged = along_planes(scene, stress)
    np.testing.assert_array_equal(plain, bridged)


@pytest.mark.parametrize(
    ("soil", "bridging"), [(SAND, True), (replace(CLAY, strength=None, tension_cutoff=None), True), (CLAY, False)]
)
def test_other_soil_and_scenes_that_bridge_no_gaps_map_nothing_for_them(soil, bridging):
    scene, _ = two_bodies(1.0, 0.4, soil, bridging=bridging)
    assert equations.by_levels(scene, scene.particles.volume, jnp.zeros((3, scene.particles.mass.size))) is None


@pytest.mark.usefixtures("x64")
def test_clay_that_slides_on_stronger_clay_is_held_by_all_of_its_strength():
    """Without what crosses the gap it would be held by a half of it."""
    row = stability_gap.drag_row("clay", 0.5, cells=4, bridging=True)
    assert row["passed"], row
