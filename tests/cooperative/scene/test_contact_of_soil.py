"""An interface with the friction of the soil: each sample slides on a contact as strong as its own soil."""

import math

import numpy as np
import pytest

import jaxmpm as mpm
from cooperative import runs
from cooperative.scene import parse, read
from tests.scenes import tables

GROUND = """
[ground]
surface = [[0.0, 6.0], [4.0, 6.0], [8.0, 2.0], [14.0, 2.0]]
bedrock = [[0.0, 3.0], [4.0, 3.0], [8.0, 1.0], [14.0, 1.0]]
interface = { friction = "soil" }
[soil]
unit_weight = 18e3
young = 2e7
poisson = 0.3
cohesion = 1e3
"""
RANDOM = '[soil.friction]\nmean = 20.0\ncov = 0.2\nmarginal = "uniform"\nlength = [inf, inf]\n'
SCENE = GROUND + RANDOM + tables(1.0)


def model_of(scene, grid="rough"):
    campaign = parse(scene)
    model = runs.build(campaign, grid, runs.random_soil(campaign))
    return model, runs.coefficients_of(campaign, model.soil)


def test_each_sample_slides_on_its_own_friction():
    model, coefficients = model_of(SCENE)
    coefficient = set()
    for sample in coefficients[:3]:
        scene, _ = model.of_sample(sample)
        angle = model.parameters(sample)["friction"]
        assert float(scene.wall_friction) == pytest.approx(math.tan(math.radians(float(angle[0]))), rel=1e-5)
        np.testing.assert_allclose(angle, angle[0])
        coefficient.add(float(scene.wall_friction))
    assert len(coefficient) == 3
    assert read(model.campaign).site == model.campaign.site


def test_the_contact_is_reduced_with_the_soil():
    model, coefficients = model_of(SCENE)
    half, _ = model.with_strength_factor(0.5).of_sample(coefficients[0])
    whole, _ = model.of_sample(coefficients[0])
    assert float(half.wall_friction) == pytest.approx(float(whole.wall_friction) / 2, rel=1e-5)


def test_a_batch_has_a_contact_for_each_lane():
    model, coefficients = model_of(SCENE.replace("t_end = 4.0", "t_end = 0.5"))
    together = {sample.number: sample.row for sample in runs.run_samples(model, coefficients, [0, 1, 2])}
    for number, row in together.items():
        scene, state = model.of_sample(coefficients[number])
        alone = mpm.solve(scene, state, t_end=0.5)
        displacement = float(np.linalg.norm(alone.state.displacement, axis=0).max())
        assert row["displacement"] == pytest.approx(displacement, rel=0.02)
    assert len({row["displacement"] for row in together.values()}) == 3


def test_a_friction_that_does_not_vary_is_that_of_the_contact_too():
    campaign = parse(SCENE.replace(RANDOM, "friction = 25.0\n").replace("cohesion = 1e3\n", COHESION))
    assert campaign.site.shape.interface == mpm.Interface(25.0)
    assert not campaign.site.contact_of_soil


def test_the_friction_of_the_soil_falls_with_slip_where_the_contact_softens():
    softening = ", residual_ratio = 0.4, slip_length = 0.25"
    model, coefficients = model_of(SCENE.replace('"soil" }', f'"soil"{softening} }}'))
    assert model.campaign.site.shape.interface.slip_length == 0.25
    scene, _ = model.of_sample(coefficients[0])
    np.testing.assert_allclose(scene.wall_softening, [0.4, 0.25])
    assert read(model.campaign).site == model.campaign.site
    with pytest.raises(ValueError, match=r"residual_ratio = 0\.4 and slip_length = None: give both"):
        parse(SCENE.replace('"soil" }', "20.0, residual_ratio = 0.4 }"))
    with pytest.raises(ValueError, match=r"\[ground.interface\] slip_length = 300 m, above 20 m: were mm meant"):
        parse(SCENE.replace('"soil" }', "20.0, residual_ratio = 0.4, slip_length = 300.0 }"))


COHESION = "cohesion = { mean = 1e3, cov = 0.2, length = [inf, inf] }\n"


@pytest.mark.parametrize(
    ("old", "new", "why"),
    [
        ("length = [inf, inf]", "length = [9.0, 2.0]", "has one that varies in space"),
        (RANDOM, "[strength]\nmean = 2e4\ncov = 0.2\nlength = [inf, inf]\n", "has no friction"),
        ("[soil]\n", '[[layer]]\nname = "sand"\n[soil]\n', "has layers"),
        ('"soil" }', '"rock" }', "friction"),
    ],
)
def test_soil_without_one_friction_is_refused(old, new, why):
    scene = SCENE.replace(old, new)
    with pytest.raises(ValueError, match=why):
        parse(scene.replace("cohesion = 1e3\n", "") if "strength" in new else scene)


def test_the_solver_takes_a_friction_for_walls_that_have_one():
    model, _ = model_of(SCENE)
    with pytest.raises(ValueError, match="wall_friction has shape"):
        mpm.with_soil(model.scene, model.state, wall_friction=[0.1, 0.2])
    with pytest.raises(ValueError, match="no wall has friction"):
        mpm.with_soil(
            *mpm.section(mpm.Section([(0, 4), (4, 4)]), mpm.Soil(), mpm.Discretisation(1.0, (0.5, 0.5))),
            wall_friction=0.3,
        )
