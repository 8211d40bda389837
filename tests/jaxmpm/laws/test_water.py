"""Pore pressure as given: effective stress under tables and pools, r_u, and what is refused."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxmpm as mpm
from jaxmpm.diagnostics import unbalanced_force
from tests.differences import check_run

SAND = mpm.FrictionalSoil(5e3, 30.0, unit_weight=18e3, young=2e7, law=mpm.laws.DruckerPrager)
HALVES = mpm.Discretisation(1.0, (0.5, 0.5))
LEVEL = mpm.Section([(0, 8), (12, 8)])
HILL = mpm.Section([(0, 6), (8, 6), (14, 3), (20, 3)])
WATER = 9810.0


def vertical(shape, soil=SAND, **water):
    """Height and effective vertical pressure (Pa) of the particles, but for those next to a boundary of the grid."""
    scene, state = mpm.section(shape, soil, HALVES, **water)
    assert float(unbalanced_force(scene, state)) < 1e-4
    z = np.asarray(scene.particles.position[1])
    return z, -np.asarray(state.stress[2])


def inner(z, *kinks):
    return (z > 1) & (z < 7) & np.all([abs(z - kink) > 1 for kink in kinks], axis=0)


@pytest.mark.parametrize("pool", [8.0, 30.0])
def test_ground_under_water_bears_its_buoyant_weight_however_deep_the_pool(pool):
    z, pressure = vertical(LEVEL, water=pool)
    assert np.allclose(pressure[inner(z)], (18e3 - WATER) * (8 - z[inner(z)]), rtol=5e-3)


def test_water_without_gravity_is_refused_by_that_name():
    with pytest.raises(ValueError, match="water with gravity = 0, under which it has no pressure"):
        mpm.section(LEVEL, SAND, HALVES, water=2.0, gravity=0.0)


def test_below_a_table_soil_is_saturated_and_buoyant_and_above_it_neither():
    z, pressure = vertical(LEVEL, replace(SAND, saturated_unit_weight=20e3), water=[(0, 4), (12, 4)])
    expected = 18e3 * np.minimum(8 - z, 4) + (20e3 - WATER) * np.maximum(4 - z, 0)
    interior = inner(z, 4)
    assert np.allclose(pressure[interior], expected[interior], rtol=1e-2)


def test_r_u_is_the_share_of_the_weight_that_water_bears():
    z, pressure = vertical(LEVEL, r_u=0.25)
    interior = inner(z)
    assert np.allclose(pressure[interior], 0.75 * 18e3 * (8 - z[interior]), rtol=5e-3)


@pytest.mark.parametrize("water", [{"water": 6.0}, {"r_u": 0.25}])
def test_water_weighs_as_the_soil_does_under_any_gravity(water):
    _, pressure = vertical(LEVEL, **water)
    for share in (0.4, 50.0):
        assert np.allclose(vertical(LEVEL, gravity=share * 9.81, **water)[1], share * pressure, rtol=1e-3)


def test_r_u_goes_with_a_weight_that_varies():
    built = mpm.section(LEVEL, replace(SAND, unit_weight=25e3), HALVES, r_u=0.4)
    scene, state = mpm.with_soil(*mpm.section(LEVEL, SAND, HALVES, r_u=0.4), unit_weight=25e3)
    assert np.allclose(scene.loads.pore_pressure, built[0].loads.pore_pressure, rtol=1e-5)
    assert np.allclose(state.stress, built[1].stress, rtol=1e-3, atol=10)
    on_joint = mpm.Section(LEVEL.surface, interface=mpm.Interface(20.0))
    with pytest.raises(ValueError, match="unit_weight varies where r_u presses on an interface"):
        mpm.with_soil(*mpm.section(on_joint, SAND, HALVES, r_u=0.4), unit_weight=25e3)


def test_the_pressure_of_r_u_does_no_work_without_bound():
    """Sand that its pore pressure has torn apart, without gravity and walls."""
    block = mpm.Section([(0, 4), (4, 4)])
    scene, state = mpm.section(block, replace(SAND, cohesion=1e3), replace(HALVES, air=8.0), r_u=0.5, at_rest=False)
    pressure = jnp.full_like(scene.loads.pore_pressure, 20e3)
    scene = replace(scene, loads=replace(scene.loads, pore_pressure=pressure, gravity=0 * scene.loads.gravity))
    final = mpm.solve(scene, state, t_end=1.0).raise_if_failed().state
    volume = float(jnp.sum(scene.particles.volume))
    assert float(final.volume_ratio.max()) > 1.05
    assert float(mpm.diagnostics.kinetic_energy(scene, final)) < 20e3 * 0.1 * volume


def test_a_pool_loads_the_face_so_that_a_slope_under_it_is_one_of_buoyant_soil():
    # In total stress the pool presses on face and toe; in effective stress nothing but the buoyant weight is left.
    (_, low), (_, high) = (mpm.section(HILL, SAND, HALVES, water=level) for level in (7.0, 40.0))
    _, buoyant = mpm.section(HILL, replace(SAND, unit_weight=18e3 - WATER), HALVES)
    assert np.array_equal(low.stress, high.stress)
    assert np.allclose(low.stress, buoyant.stress, rtol=2e-3, atol=100.0)


CLAY = mpm.Soil(unit_weight=18e3, young=5e6, poisson=0.3, strength=9e3, tension_cutoff=0.0)


def test_water_carries_no_more_of_soil_that_has_opened():
    scene, state = mpm.section(LEVEL, CLAY, HALVES, water=30.0, at_rest=False)
    opened = replace(state, volume_ratio=jnp.full_like(state.volume_ratio, 5.0))
    high = np.asarray(scene.particles.position[1]) > 3  # some cells above the base
    for start in (state, opened):
        velocity = np.asarray(mpm.step(scene, start, scene.numerics.time_step).velocity[1])
        assert np.allclose(velocity[high], -9.81 * (1 - WATER / 18e3) * float(scene.numerics.time_step), rtol=0.01)


FBAR = replace(HALVES, fbar=True)
BUOYANT = 9.81 * (1 - WATER / 18e3)
"""Gravity (m/s2) that gives soil of the same mass its weight under water."""


def slides(soil, **loads):
    """Largest displacement (m) after 2 s of the hill, in soil that yields."""
    result = mpm.solve(*mpm.section(HILL, soil, HALVES, **loads), t_end=2.0).raise_if_failed()
    return float(np.linalg.norm(result.state.displacement, axis=0).max())


def test_clay_under_a_pool_slides_by_its_buoyant_weight_however_deep_it_is():
    weak = replace(CLAY, strength=4e3)
    low, high, buoyant = (slides(weak, **each) for each in ({"water": 7.0}, {"water": 40.0}, {"gravity": BUOYANT}))
    assert low > 0.1
    assert low == pytest.approx(high, rel=1e-6)
    assert low == pytest.approx(buoyant, rel=0.01)


def test_a_pool_at_half_height_bears_some_of_a_slope_of_clay():
    dry, half, full = (slides(CLAY, **water) for water in ({}, {"water": 4.5}, {"water": 6.0}))
    assert full < half < dry


@pytest.mark.slow
def test_a_table_in_the_ground_changes_no_factor_of_undrained_clay():
    # Total stress: its law sees no mean stress.
    factors = [
        mpm.factor_of_safety(*mpm.section(HILL, replace(CLAY, strength=12e3), FBAR, **water), t_end=6.0).stable
        for water in ({}, {"water": [(0, 4), (8, 3.5), (14, 2), (20, 2)]})
    ]
    assert factors[0] == pytest.approx(factors[1], abs=0.011)


def table(*points, height=0.5):
    x, z = jnp.asarray(points, float).T
    return mpm.laws.WaterTable(x, z, jnp.asarray(WATER), jnp.asarray(height))


def test_the_push_is_the_pressures_gradient(x64):
    water = table((0, 5), (4, 5.5), (9, 3), (12, 3))
    position = jnp.asarray(np.random.default_rng(1).uniform([[-2], [0]], [[14], [8]], (2, 300)))

    def pressure(x, z):
        return WATER * jnp.maximum(jnp.interp(x, water.x, water.z) - z, 0)

    near = abs(jnp.interp(position[0], water.x, water.z) - position[1]) < 0.25
    by_x, by_z = jax.vmap(jax.grad(pressure, argnums=(0, 1)))(*position)
    assert np.allclose(water.push(position)[:, ~near], -jnp.stack([by_x, by_z])[:, ~near])
    # In three dimensions the table is as far across, and pushes nothing that way.
    solid = jnp.stack([position[0], jnp.zeros_like(position[0]), position[1]])
    along, across, upwards = water.push(solid)
    assert np.array_equal(jnp.stack([along, upwards]), water.push(position))
    assert not across.any()
    # A particle cut by the table feels its share: in the middle, half.
    assert np.allclose(table((0, 5), (1, 5)).push(jnp.array([[0.5], [5.0]])), [[0.0], [WATER / 2]])


def hill_of_water(step=2.0):
    x, y = np.meshgrid(np.arange(0, 9, step), np.arange(0, 5, step), indexing="ij")
    return mpm.Raster(5 + 0.3 * x - 0.2 * y + 0.05 * x * y + 0.1 * np.sin(x), (0.0, 0.0), step)


def test_the_push_below_a_surface_is_the_pressures_gradient(x64):
    raster = hill_of_water()
    arguments = raster.heights, raster.corner, raster.step, WATER, 0.5
    water = mpm.laws.WaterSurface(*(jnp.asarray(value, float) for value in arguments))
    position = np.random.default_rng(1).uniform([[0.1], [0.1], [0]], [[7.9], [3.9], [9]], (3, 300))
    table, tiny = raster.at(*position[:2]), 1e-6

    def pressure(x, y, z):
        return WATER * np.maximum(raster.at(x, y) - z, 0)

    steps = tiny * np.eye(3)[:, :, None]
    slopes = [(pressure(*(position + step)) - pressure(*(position - step))) / (2 * tiny) for step in steps]
    far = (abs(table - position[2]) > 0.25) & (abs(position[:2] / 2 - np.round(position[:2] / 2)) > 1e-5).all(axis=0)
    beyond = np.array([[-3.0, 20.0], [2.0, 2.0], [1.0, 1.0]])
    everywhere = jnp.asarray(np.concatenate([position, beyond], axis=1))
    push = np.asarray(jax.jit(mpm.laws.WaterSurface.push)(water, everywhere))
    assert np.allclose(push[:, :-2][:, far], -np.stack(slopes)[:, far], atol=1e-3)
    assert np.array_equal(push[0, -2:], [0, 0])
    assert np.all(push[2, -2:] == WATER)


FLAT_TERRAIN = mpm.Terrain(mpm.Raster(np.full((3, 2), 8.0), (0.0, 0.0), 4.0), base=0.0)
ONES = mpm.Discretisation(2.0, (1.0, 1.0, 1.0))


@pytest.mark.parametrize(
    "water",
    [pytest.param(8.0, marks=pytest.mark.slow), 30.0, mpm.Raster(np.full((3, 2), 8.0), (0.0, 0.0), 4.0)],
    ids=["8", "30", "raster"],
)
def test_terrain_under_water_bears_its_buoyant_weight(water):
    scene, state = mpm.terrain(FLAT_TERRAIN, SAND, ONES, water=water)
    assert float(unbalanced_force(scene, state)) < 1e-3
    z = np.asarray(scene.particles.position[2])
    interior = inner(z)
    assert np.allclose(-np.asarray(state.stress[2])[interior], (18e3 - WATER) * (8 - z[interior]), rtol=1e-2)


def test_r_u_and_saturated_weight_under_terrain():
    wet = replace(SAND, saturated_unit_weight=20e3)
    scene, _ = mpm.terrain(FLAT_TERRAIN, wet, ONES, water=4.0, at_rest=False)
    z = np.asarray(scene.particles.position[2])
    assert np.allclose(scene.particles.mass * 9.81, np.where(z < 4, 20e3, 18e3), rtol=1e-3)
    layers = [mpm.Layer(replace(SAND, unit_weight=16e3), depth=3.0), mpm.Layer(SAND)]
    scene, _ = mpm.terrain(FLAT_TERRAIN, layers, ONES, r_u=0.25, at_rest=False)
    above = 16e3 * np.minimum(8 - z, 3) + 18e3 * np.maximum(5 - z, 0)
    assert np.allclose(scene.loads.pore_pressure, 0.25 * above)


@pytest.mark.parametrize(
    ("water", "message"),
    [
        (mpm.Raster(np.full((2, 2), 8.0), (0.0, 0.0), 4.0), "x = 0 to 8 m: give two within the raster, x = 0 to 4 m"),
        (
            mpm.Raster(np.array([[8.0, 8], [8, np.nan], [8, 8]]), (0.0, 0.0), 4.0),
            r"water has 1 holes .* at \(4, 4\) m",
        ),
        (float("nan"), "water = nan m"),
        (mpm.Raster(np.full((30, 20), 8.0), (0.0, 0.0), 8e-4), "water has steps of 0.0008 .* look like degrees"),
    ],
    ids=["short", "hole", "nan", "degrees"],
)
def test_water_under_terrain_that_cannot_be_is_refused(water, message):
    with pytest.raises(ValueError, match=message):
        mpm.terrain(FLAT_TERRAIN, SAND, ONES, water=water, at_rest=False)
    with pytest.raises(ValueError, match="both water and r_u"):
        mpm.terrain(FLAT_TERRAIN, SAND, ONES, water=4.0, r_u=0.1, at_rest=False)


def test_a_slope_stands_lower_with_water_in_it_and_higher_under_a_pool():
    def displacement(**water):
        scene, state = mpm.section(HILL, SAND, HALVES, **water)
        end = mpm.solve(mpm.reduced(scene, 2.2), state, t_end=1.0).raise_if_failed().state
        return float(mpm.diagnostics.mean_displacement(scene, end))

    dry, wet, seeping, drowned = (displacement(**water) for water in ({}, {"r_u": 0.4}, {"water": 3.0}, {"water": 9.0}))
    assert wet > 1.3 * dry
    assert drowned < 0.5 * dry
    assert drowned < seeping < wet


def section_with_a_table(soil):
    return mpm.section(HILL, soil, HALVES, water=[(0, 5), (20, 2.6)])


def terrain_with_a_surface(soil):
    ground, water = (
        mpm.Raster(np.array(heights, float), (0.0, 0.0), 4.0)
        for heights in ([[8, 9], [8, 8], [4, 3], [4, 3]], [[6, 6.4], [5.2, 5], [3, 2.4], [2.9, 2]])
    )
    return mpm.terrain(mpm.Terrain(ground, base=0.0), soil, ONES, water=water)


SOAKED = [
    (section_with_a_table, mpm.laws.DruckerPrager),
    pytest.param(terrain_with_a_surface, mpm.laws.MohrCoulomb, marks=pytest.mark.slow),
]


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize(("built", "criterion"), SOAKED)
def test_gradients_through_water_are_those_of_differences_and_engines_and_lanes_agree(built, criterion):
    scene, state = built(replace(SAND, law=criterion))
    points = "z" if built is section_with_a_table else "heights"
    weight = 18e3 * jnp.maximum(6 - scene.particles.position[-1], 0)

    def slid(scene, level, r_u):
        water = replace(scene.loads.water, **{points: getattr(scene.loads.water, points) + level})
        varied = replace(scene, loads=replace(scene.loads, water=water, pore_pressure=r_u * weight))
        return jnp.sum(mpm.advance(varied, state, 40).displacement[0])

    # Short steps: particles that the table or yield cuts make kinks.
    check_run(slid, mpm.reduced(scene, 1.5), (0.01, 0.1), (1e-7, 1e-7), tolerance=1e-4)


@pytest.mark.parametrize(
    "water",
    [
        7.0,  # a pool over all
        -1.0,  # nowhere, as a script that lowers the level may have it
        [(0, 5), (8, 5), (10, 5), (20, 5)],
        [(0, 2), (9, 5), (10.2, 5), (20, 5)],  # up to a pool, whose shore is drawn by hand
        [(0, 7), (20, 7.2)],  # level to half a particle
        [(0, 6), (8, 6), (14, 3), (20, 3)],  # along the ground
    ],
    ids=str,
)
def test_pools_that_are_level_and_tables_in_the_ground_are_built_as_drawn(water):
    scene, _ = mpm.section(HILL, SAND, HALVES, water=water, at_rest=False)
    drawn = [(0, water), (20, water)] if isinstance(water, float) else water
    assert np.allclose(np.stack([scene.loads.water.x, scene.loads.water.z], axis=1), drawn)


@pytest.mark.usefixtures("x64")
def test_lanes_share_the_water_on_both_engines():
    scene, state = terrain_with_a_surface(SAND)
    varied, axes = mpm.run.lanes(scene, cohesion=jnp.array([1e3, 5e3]))
    together = mpm.solve(varied, mpm.run.repeat(state, 2), t_end=0.2, axes=axes).state.displacement
    for engine in (None, mpm.Engine.XLA):
        alone = mpm.solve(
            replace(scene, numerics=replace(scene.numerics, engine=engine)), state, t_end=0.2
        ).state.displacement
        assert np.allclose(together[1], alone, rtol=1e-12, atol=1e-15)


def test_earthquakes_push_towards_the_lower_end_and_up():
    mirrored = mpm.Section([(20 - x, z) for x, z in reversed(HILL.surface)])
    for shape, sign in ((HILL, 1), (mirrored, -1)):
        scene, _ = mpm.section(shape, SAND, HALVES, k_h=0.15, k_v=0.05, at_rest=False)
        assert np.allclose(scene.loads.gravity, [sign * 0.15 * 9.81, -0.95 * 9.81])


REFUSED = {
    "undrained": (
        {"soil": mpm.Soil(strength=2e4, tension_cutoff=0.0), "r_u": 0.2},
        "r_u in J2, whose strength is undrained .* level or table",
    ),
    "r_u of 1": ({"r_u": 1.0}, "r_u = 1: give a value of 0 or more and below 1"),
    "r_u nan": ({"r_u": float("nan")}, "r_u = nan"),
    "both": ({"r_u": 0.2, "water": 4.0}, "both water and r_u = 0.2"),
    "wall": ({"water": [(0, 4), (15, 4)]}, r"water goes from \(0, 4\) to \(15, 4\) m: draw it to the walls"),
    "back": ({"water": [(0, 4), (12, 4), (11, 3), (20, 3)]}, r"water turns back from \(12, 4\) to \(11, 3\) m"),
    "step": ({"water": [(0, 4), (12, 4), (12, 3), (20, 3)]}, r"water is upright at \(12, 4\) m"),
    "pool": (
        {"water": [(0, 8), (8, 8), (14, 3), (20, 3)]},
        r"above the ground slopes from \(0.25, 8\) to \(12.75, 4.042\) m, .*: draw one level above .* 0.25 to 12.75 m",
    ),
    "film": ({"water": [(0, 7), (20, 7.5)]}, r"slopes from \(0.25, 7.0.*\) to \(19.75, 7.4.*\) m"),
    "infinite": ({"water": float("inf")}, "water = inf m at"),
    "weight": ({"soil": replace(SAND, saturated_unit_weight=-1.0)}, "saturated_unit_weight = -1"),
    "k_h": ({"k_h": 1.5}, "k_h = 1.5"),
}


@pytest.mark.parametrize(("given", "message"), REFUSED.values(), ids=REFUSED)
def test_water_that_cannot_be_is_refused(given, message):
    with pytest.raises(ValueError, match=message):
        mpm.section(HILL, discretisation=HALVES, **({"soil": SAND} | given))


@pytest.mark.parametrize("soil", [mpm.Soil(unit_weight=9e3), mpm.FrictionalSoil(1e3, 20.0, unit_weight=9810.0)])
def test_soil_that_floats_is_refused(soil):
    """Its effective weight would lift it, and a slope of it would never fail."""
    layers = mpm.Section([(0, 4), (4, 4)])
    numerics = mpm.Discretisation(1.0, (0.5, 0.5))
    with pytest.raises(
        ValueError, match=r"lies below the water with a unit weight of 9.* and floats: give unit_weight"
    ):
        mpm.section(layers, soil, numerics, water=2.0, at_rest=False)
    scene, state = mpm.section(layers, soil, numerics, water=0.0, at_rest=False)
    with pytest.raises(ValueError, match="floats"):
        mpm.with_soil(scene, state, water_level=2.0)
    heavy, state = mpm.section(layers, replace(soil, unit_weight=10e3), numerics, water=2.0, at_rest=False)
    with pytest.raises(ValueError, match="floats"):
        mpm.with_soil(heavy, state, unit_weight=9.5e3)
