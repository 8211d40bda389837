"""A water level that is drawn with each sample: stress, weight and load are those of a scene with that level."""

import numpy as np
import pytest
from scipy.stats import norm

import jaxmpm as mpm
from cooperative import report, run, runs
from cooperative.scene import check_samples, measure, parse, read
from jaxmpm.soil import STANDARD_GRAVITY
from tests.scenes import model_of, tables

DRAWN = "[water.level]\nmean = 3.0\nsd = 0.8\n"
SAND = f"""
[ground]
surface = [[0.0, 6.0], [4.0, 6.0], [8.0, 2.0], [14.0, 2.0]]
[soil]
unit_weight = 18e3
saturated_unit_weight = 20e3
young = 2e7
poisson = 0.3
friction = 30.0
[soil.cohesion]
mean = 5e3
cov = 0.3
length = [10.0, 2.0]
{DRAWN}"""
SCENE = SAND + tables(1.0)


def model_and_coefficients(scene):
    model = model_of(scene, at_rest=True)
    return model, runs.coefficients_of(model.campaign, model.soil)


def test_a_sample_is_that_of_a_scene_with_its_level():
    model, coefficients = model_and_coefficients(SCENE)
    sample = coefficients[np.argmax(np.abs(coefficients[:, -1]))]
    level = model.water_level(sample)
    assert level == pytest.approx(3.0 + 0.8 * sample[-1], abs=1e-4)
    scene, state = model.of_sample(sample)
    fixed, _ = model_and_coefficients(SCENE.replace(DRAWN, f"[water]\nlevel = {level!r}\n"))
    own, start = fixed.of_sample(sample[:-1])
    np.testing.assert_allclose(scene.loads.water.z, own.loads.water.z, rtol=1e-6)
    np.testing.assert_allclose(scene.particles.mass, own.particles.mass, rtol=1e-6)
    np.testing.assert_array_equal(scene.material.cohesion, own.material.cohesion)
    scale = float(np.abs(start.stress).max())
    np.testing.assert_allclose(state.stress, start.stress, atol=1e-4 * scale)
    # The stress of the mean level under this one is out of balance.
    assert np.abs(model.state.stress - start.stress).max() > 0.02 * scale
    weight = np.asarray(scene.particles.mass / scene.particles.volume * STANDARD_GRAVITY)
    np.testing.assert_allclose(weight, np.where(np.asarray(scene.particles.position[1]) < level, 20e3, 18e3), rtol=1e-5)


def test_levels_follow_their_distribution_and_the_number_of_the_sample():
    text = SCENE.replace("samples = 10", "samples = 200")
    model, coefficients = model_and_coefficients(text)
    levels = np.sort([model.water_level(sample) for sample in coefficients])
    spread = 3.0 + 0.8 * norm.ppf((np.arange(200) + 0.5) / 200)
    np.testing.assert_allclose(levels[1:-1], spread[1:-1], atol=0.25)
    fixed, others = model_and_coefficients(text.replace(DRAWN, "[water]\nlevel = 3.0\n"))
    np.testing.assert_array_equal(coefficients[:, :-1], others)
    assert fixed.water_level(others[0]) is None
    assert not fixed.own_start
    for lines, low, high in (
        ('marginal = "uniform"\n', 3 - 0.8 * 3**0.5, 3 + 0.8 * 3**0.5),
        ('marginal = "truncated normal"\nlower = 0.5\nupper = 5.5\n', 0.5, 5.5),
        ('marginal = "beta"\nlower = -1.0\nupper = 4.5\n', -1.0, 4.5),
    ):
        level = parse(SCENE.replace(DRAWN, DRAWN + lines)).site.level
        ends = [level.at(score) for score in (-6.0, 6.0)]
        assert low - 1e-3 <= ends[0] < 3.0 < ends[1] <= high + 1e-3
    assert parse(SCENE.replace("mean = 3.0", "mean = 0.0")).site.level.at(1.0) == pytest.approx(0.8, abs=1e-4)


def test_a_campaign_keeps_the_level_of_each_sample():
    model, coefficients = model_and_coefficients(SCENE.replace("t_end = 4.0", "t_end = 0.2"))
    samples = list(runs.run_samples(model, coefficients, [0, 1, 2]))
    assert [sample.row["water_level"] for sample in samples] == [model.water_level(coefficients[n]) for n in range(3)]
    again = read(model.campaign)  # as a folder keeps a campaign that was written in Python
    assert again.site.level == model.campaign.site.level


LEVEL_ALONE = (
    SCENE.replace("[soil.cohesion]\nmean = 5e3\ncov = 0.3\nlength = [10.0, 2.0]\n", "")
    .replace("friction = 30.0\n", "friction = 30.0\ncohesion = 5e3\n")
    .replace("t_end = 4.0", "t_end = 0.2")
)
"""Nothing of the soil is random."""


def test_soil_of_a_scene_whose_level_alone_is_random_has_its_strength():
    campaign = parse(LEVEL_ALONE)
    assert campaign.varies
    assert not campaign.random
    check_samples(campaign)
    model, coefficients = model_and_coefficients(LEVEL_ALONE)
    assert coefficients.shape == (10, 1)
    assert measure(campaign, None, model.soil.counts, {}) == campaign
    soil = runs.soil_of(model, coefficients[0])
    np.testing.assert_allclose(soil.values["cohesion"], 5e3)
    np.testing.assert_allclose(soil.values["friction"], 30.0, rtol=1e-6)


@pytest.mark.slow
def test_a_level_alone_makes_a_campaign_and_its_report(tmp_path):
    run(LEVEL_ALONE, tmp_path / "c", workers=1)
    report(tmp_path / "c")
    drawn = runs.read_drawn(tmp_path / "c", [("rough", 0), ("refined", 0)])
    for soil in drawn.values():
        np.testing.assert_allclose(soil.values["cohesion"], 5e3)
        np.testing.assert_allclose(soil.values["friction"], 30.0, rtol=1e-6)
    assert list((tmp_path / "c" / "figures").glob("slide-*.png"))


def test_the_solver_takes_a_level_for_water_alone():
    model, _ = model_and_coefficients(SCENE)
    dry = mpm.section(mpm.Section([(0, 4), (4, 4)]), mpm.Soil(), mpm.Discretisation(1.0, (0.5, 0.5)))
    with pytest.raises(ValueError, match="water_level is given, and the scene has no water"):
        mpm.with_soil(*dry, water_level=2.0)
    scene, _ = mpm.with_soil(model.scene, model.state, water_level=9.0)  # above the crest
    assert np.all(mpm.ground.wet(scene))


def test_a_free_field_has_no_random_level():
    ends = SCENE.replace("[soil]", 'ends = "free field"\n[soil]', 1)
    with pytest.raises(ValueError, match="water level varies beside ends = 'free field'"):
        parse(ends)
