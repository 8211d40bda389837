"""Undrained strength as a ratio of the effective vertical stress at rest."""

from dataclasses import replace

import numpy as np
import pytest

import jaxmpm as mpm
import kl
from cooperative import runs
from cooperative.scene import RandomField, Water, parse
from tests.scenes import model_of, tables

WATER = 9810.0
LEVEL = f"""
[ground]
surface = [[0.0, 12.0], [24.0, 12.0]]
ends = "roller"
[water]
WATER
[soil]
unit_weight = 18e3
young = 2e7
poisson = 0.3
strength_ratio = 0.25
strength_minimum = 6e3
SOIL
{tables()}"""
VARIES = "{ mean = 0.25, cov = 0.2, length = [20.0, 3.0] }"
STIFFNESS = "softening_modulus = { mean = 20e3, cov = 0.2, length = [20.0, 3.0] }\nresidual_ratio = 0.5"
CONSTANT = LEVEL.replace("SOIL", STIFFNESS)
RANDOM = LEVEL.replace("strength_ratio = 0.25", f"strength_ratio = {VARIES}").replace("SOIL", "")


def wet_model(text, water="level = 10.0", grid="rough", *, at_rest=False):
    return model_of(text.replace("WATER", water), grid, at_rest=at_rest)


def drawn(model):
    return np.random.default_rng(5).standard_normal(model.soil.modes).astype(np.float32)


@pytest.mark.parametrize(
    ("water", "pressure"),
    [
        ("level = 10.0", lambda z: WATER * np.maximum(10 - z, 0)),
        ("level = 0.0", lambda z: 0 * z),
        ("level = 15.0", lambda z: WATER * (12 - z)),
        ("depth = 3.0", lambda z: WATER * np.maximum(9 - z, 0)),
        ("table = [[0.0, 10.0], [24.0, 10.0]]", lambda z: WATER * np.maximum(10 - z, 0)),
        ("r_u = 0.4", lambda z: 0.4 * 18e3 * (12 - z)),
    ],
)
def test_under_level_ground_strength_is_the_ratio_of_weight_less_water(water, pressure):
    model = wet_model(CONSTANT, water)
    z = np.asarray(model.scene.particles.position, float)[1]
    expected = np.maximum(0.25 * (18e3 * (12 - z) - pressure(z)), 6e3)
    np.testing.assert_allclose(model.strength(), expected, rtol=1e-6)
    assert (expected > 6e3).any()
    assert (expected == 6e3).any()
    np.testing.assert_array_equal(model.of_sample(drawn(model))[0].material.strength, model.strength())


def test_a_random_ratio_multiplies_the_stress_of_the_means():
    model = wet_model(RANDOM, at_rest=True)
    parameters, median = model.parameters(drawn(model)), model.parameters()
    assert np.std(parameters["strength_ratio"]) > 0.02
    np.testing.assert_allclose(median["strength_ratio"], 0.25 / np.sqrt(1 + 0.2**2), rtol=1e-5)
    for each in (parameters, median):
        expected = np.maximum(each["strength_ratio"] * model.stress, 6e3)
        np.testing.assert_allclose(each["strength"], expected, rtol=1e-6)
    np.testing.assert_array_equal(model.median[0].material.strength, median["strength"])
    scene, state = model.of_sample(drawn(model))
    np.testing.assert_array_equal(scene.material.strength, parameters["strength"])
    np.testing.assert_array_equal(state.stress, model.state.stress)


def test_calibration_reduces_a_strength_that_goes_with_the_stress_once():
    for text in (CONSTANT, RANDOM):
        model = wet_model(text)
        before, after = model.strength(drawn(model)), model.with_strength_factor(0.8).strength(drawn(model))
        np.testing.assert_allclose(after, 0.8 * np.asarray(before), rtol=1e-6)


LAYERED = CONSTANT.replace(
    "[soil]",
    """[[layer]]
name = "crust"
bottom = [[0.0, 9.0], [24.0, 9.0]]
strength = 25e3
[[layer]]
name = "clay"
strength_ratio = 0.3
strength_minimum = 2e3
[soil]""",
)


def test_a_layer_has_a_strength_or_a_ratio_of_its_own():
    model = wet_model(LAYERED, grid="refined")
    z = np.asarray(model.scene.particles.position, float)[1]
    stress = 18e3 * (12 - z) - WATER * np.maximum(10 - z, 0)
    np.testing.assert_allclose(model.strength(), np.where(z > 9, 25e3, 0.3 * stress), rtol=1e-6)


def test_terrain_takes_the_water_of_a_raster():
    heights, water = (mpm.Raster(np.full((7, 7), z), (0.0, 0.0), 2.0) for z in (12.0, 9.0))
    level = parse(CONSTANT.replace("WATER", "level = 0.0"))
    field = RandomField(0.25, 0.0, (10.0, 10.0, 3.0), kl.Lognormal, kl.Exponential, 0.5)
    grids = {"rough": level.rough, "refined": level.refined}
    grids = {name: replace(grid, spacing=(*grid.spacing, grid.spacing[0])) for name, grid in grids.items()}
    campaign = replace(
        level,
        ground=replace(level.site, shape=mpm.Terrain(heights, 0.0), water=Water(raster=water)),
        random={"strength_ratio": field},
        **grids,
    )
    model = runs.build(campaign, "rough", runs.random_soil(campaign), at_rest=False)
    z = np.asarray(model.scene.particles.position, float)[2]
    stress = 18e3 * (12 - z) - WATER * np.maximum(9 - z, 0)
    np.testing.assert_allclose(model.strength(), np.maximum(0.25 * stress, 6e3), rtol=1e-6)


def test_the_cell_has_little_say_in_the_strength_of_a_slope():
    slope = CONSTANT.replace("[24.0, 12.0]", "[10.0, 12.0], [22.0, 6.0], [40.0, 6.0]")
    rough, refined = (wet_model(slope, "level = 6.0", grid) for grid in ("rough", "refined"))
    mean = [float(np.average(model.strength(), weights=model.scene.particles.volume)) for model in (rough, refined)]
    assert mean[0] == pytest.approx(mean[1], rel=0.02)


def test_the_solver_alone_gives_each_particle_its_strength():
    campaign = parse(CONSTANT.replace("WATER", "level = 10.0"))
    with pytest.raises(ValueError, match=r"strength_ratio = 0.25 is of the stress at rest, .*overburden\(scene\)"):
        campaign.soil.material(np.dtype("float32"), 1.0)
    drawn, soil = mpm.Section([(0, 12), (24, 12)]), mpm.Soil(unit_weight=18e3, strength=6e3, tension_cutoff=0.0)
    scene, state = mpm.section(drawn, soil, campaign.grids["rough"], water=10.0)
    scene, _ = mpm.with_soil(scene, state, strength=np.maximum(0.25 * mpm.overburden(scene), 6e3))
    np.testing.assert_allclose(scene.material.strength, wet_model(CONSTANT).strength(), rtol=1e-6)


@pytest.mark.parametrize("top", [8.0, 8.1, 8.4, 8.9])
def test_a_particle_that_the_surface_cuts_weighs_its_part_on_those_below(top):
    level = mpm.Raster(np.full((7, 5), top), (0.0, 0.0), 2.0)
    soil, numerics = (
        mpm.Soil(unit_weight=20e3, strength=40e3, tension_cutoff=0.0),
        mpm.Discretisation(2.0, (1.0, 1.0, 1.0)),
    )
    scene, _ = mpm.terrain(mpm.Terrain(level, 0.0), soil, numerics, at_rest=False)
    z, stress = np.asarray(scene.particles.position[2]), mpm.overburden(scene)
    np.testing.assert_allclose(stress[z < 7], 20e3 * (top - z[z < 7]), rtol=1e-5)


def test_water_on_clay_of_a_ratio_is_a_load():
    model = wet_model(CONSTANT, "level = 15.0")
    assert model.scene.loads.water is not None
    assert wet_model(CONSTANT, "r_u = 0.4").scene.loads.pore_pressure is None
