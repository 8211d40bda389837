"""Soil at rest under the pressure of a flow: the same as under a water table where water rests, and with suction."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

import jaxmpm as mpm
from jaxmpm import seepage
from jaxmpm.ground import WATER_WEIGHT, wet
from jaxmpm.soil import STANDARD_GRAVITY

SAND = mpm.FrictionalSoil(unit_weight=20e3, young=2e7, poisson=0.3, cohesion=2e3, friction=30.0)
NUMERICS = mpm.Discretisation(1.0, (0.5, 0.5))
LEVEL = mpm.Section([(0, 6), (8, 6)])
SLOPE = mpm.Section([(0, 6), (4, 6), (8, 2), (14, 2)])
TABLES = {"left": SLOPE, "right": mpm.Section([(-x, z) for x, z in reversed(SLOPE.surface)])}


def resting(level: float, ground: mpm.Section) -> seepage.TableHeads:
    """Water at rest in all of a ground."""
    x0, x1 = ground.corner[0], ground.corner[0] + ground.extent[0]
    points = np.array([[x, z] for x in (x0, x1) for z in (0.0, 6.0)])
    return seepage.PressureTable.of_points([0.0], [points], [np.full(4, level)]).heads(0.0)


def built(ground, water=None, soil=SAND):
    return mpm.section(ground, soil, NUMERICS, water=water, at_rest=False)[0]


def effective(scene):
    return np.asarray(mpm.at_rest(scene).stress, float)


def test_water_at_rest_is_that_of_a_water_table(x64):
    """Pressure on the particles under level ground gives the effective stress of a table, which pushes particles."""
    by_table = effective(built(LEVEL, water=4.0))
    by_heads = effective(seepage.with_pressure(built(LEVEL), resting(4.0, LEVEL)))
    scale = np.abs(by_table).max()
    # Within the cell that the table cuts either pressure is resolved to half a particle.
    np.testing.assert_allclose(by_heads, by_table, atol=0.03 * scale)


@pytest.mark.parametrize("side", TABLES)
def test_under_a_pool_at_rest_no_pressure_is_left_over(side, x64):
    ground = TABLES[side]
    pool = built(ground, water=4.0)
    scene = seepage.with_pressure(pool, resting(4.0, ground), level=4.0)
    position = np.asarray(scene.particles.position)
    under = position[-1] < 4.0
    np.testing.assert_allclose(scene.loads.pore_pressure[under], 0.0, atol=1e-6)
    np.testing.assert_allclose(effective(scene), effective(pool), atol=1e-6 * np.abs(effective(pool)).max())


def test_a_pool_drawn_down_at_once_leaves_its_pressure_in_the_slope(x64):
    """The total stress loses the pool, and the pressure stays: what is left over is the head of the lost water."""
    ground = TABLES["left"]
    scene = seepage.with_pressure(built(ground, water=2.0), resting(5.0, ground), level=2.0)
    z = np.asarray(scene.particles.position[-1])
    expected = WATER_WEIGHT * (np.maximum(5.0 - z, 0) - np.maximum(2.0 - z, 0))
    np.testing.assert_allclose(scene.loads.pore_pressure, expected, rtol=1e-6)


def test_suction_presses_grains_together_and_water_weighs(x64):
    retention = seepage.soil_class("silt", air_entry=0.02)
    scene = built(LEVEL)
    count = scene.particles.mass.shape
    dry = np.full(count, 14e3)
    moist = seepage.with_pressure(scene, resting(1.0, LEVEL), retention=retention, dry_weight=dry)
    head = 1.0 - np.asarray(scene.particles.position[-1])
    np.testing.assert_allclose(moist.loads.pore_pressure, seepage.suction_stress(retention, head), rtol=1e-6)
    weight = np.asarray(moist.particles.mass / moist.particles.volume) * STANDARD_GRAVITY
    np.testing.assert_allclose(weight, 14e3 + WATER_WEIGHT * np.asarray(retention.water_content(head)), rtol=1e-6)
    # Of level ground the vertical total stress is the weight above, whatever the water.
    vertical = -np.asarray(mpm.at_rest(moist).stress[2]) + np.asarray(moist.loads.pore_pressure)
    top = np.asarray(moist.particles.position[-1]) > 5.5
    deep = np.asarray(moist.particles.position[-1]) < 1.0
    assert vertical[deep].mean() == pytest.approx(weight.mean() * (6 - 0.5), rel=0.02)
    assert np.all(np.asarray(mpm.at_rest(moist).stress[2])[top] < -10e3)  # pressed together at the surface


def test_what_has_no_pore_pressure_is_refused():
    clay = mpm.Soil(unit_weight=20e3, young=2e7, poisson=0.3, strength=30e3)
    heads = resting(4.0, LEVEL)
    for scene, words in (
        (built(LEVEL, soil=clay), "undrained"),
        (built(LEVEL, water=4.0), "build it with its pool alone"),
    ):
        with pytest.raises(ValueError, match=words):
            seepage.with_pressure(scene, heads)
    with pytest.raises(ValueError, match="without a retention"):
        seepage.with_pressure(built(LEVEL), heads, dry_weight=np.zeros(1))


def test_undrained_layers_keep_total_stress():
    clay = mpm.Soil(unit_weight=20e3, young=2e7, poisson=0.3, strength=30e3)
    layers = [mpm.Layer(SAND, [(0, 3), (8, 3)]), mpm.Layer(clay)]
    scene, _ = mpm.section(LEVEL, layers, NUMERICS, at_rest=False)
    wetted = seepage.with_pressure(scene, resting(6.0, LEVEL))
    z = np.asarray(wetted.particles.position[-1])
    np.testing.assert_allclose(wetted.loads.pore_pressure, np.where(z > 3, WATER_WEIGHT * (6 - z), 0), rtol=1e-5)


def test_contact_with_the_base_bears_the_same_water(x64):
    ground = replace(LEVEL, interface=mpm.Interface(20.0))
    by_heads = seepage.with_pressure(built(ground), resting(4.0, LEVEL))
    contact = mpm.ground.Contact.of(by_heads)
    borne = np.asarray(by_heads.boundary.pressure)[contact.nodes]
    expected = WATER_WEIGHT * (4.0 - contact.points[-1])
    assert np.all(wet(built(ground, water=4.0)) == (np.asarray(by_heads.particles.position[-1]) < 4.0))
    np.testing.assert_allclose(borne[contact.points[-1] < 3], expected[contact.points[-1] < 3], rtol=1e-6)


def test_pressure_goes_along_with_the_soil_that_has_it():
    """A block in free flight whose suction, which differs along it, is in balance with its grains: nothing acts on it.

    Of suction that stayed in its place, 10 kPa more would act on the block after 2 m.
    """
    numerics = mpm.Discretisation(0.5, (0.25, 0.25))
    scene, state = mpm.block((2.0, 1.0), SAND, numerics, domain=(6.0, 2.0), corner=(1.0, 0.5), velocity=(2.0, 0.0))
    pressure = -10e3 - 5e3 * (scene.particles.position[0] - 1.0)
    stress = jnp.zeros_like(state.stress).at[:3].set(pressure)
    under = replace(scene, loads=replace(scene.loads, pore_pressure=pressure))
    end = mpm.solve(under, replace(state, stress=stress), t_end=1.0).raise_if_failed().state
    np.testing.assert_allclose(end.displacement[0], 2.0, atol=2e-2)
    np.testing.assert_allclose(end.displacement[1], 0.0, atol=2e-3)
    np.testing.assert_allclose(end.stress[:3], stress[:3], atol=300.0)


def test_with_soil_gives_a_pressure_to_soil_that_has_one():
    scene, state = mpm.section(LEVEL, SAND, NUMERICS, r_u=0.2, at_rest=False)
    under, _ = mpm.with_soil(scene, state, pore_pressure=-3e3, unit_weight=19e3)
    np.testing.assert_array_equal(under.loads.pore_pressure, -3e3)
    dry, state = mpm.section(LEVEL, SAND, NUMERICS, at_rest=False)
    with pytest.raises(ValueError, match="pore_pressure is given, and the scene has none"):
        mpm.with_soil(dry, state, pore_pressure=1e3)
