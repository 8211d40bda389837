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


def contact(model, scene):
    """Coefficients of friction at the nodes of the contact."""
    return np.asarray(scene.boundary.friction)[model.contact.nodes]


def test_each_sample_slides_on_its_own_friction():
    model, coefficients = model_of(SCENE)
    coefficient = set()
    for sample in coefficients[:3]:
        scene, _ = model.of_sample(sample)
        angle = model.parameters(sample)["friction"]
        np.testing.assert_allclose(angle, angle[0])
        np.testing.assert_allclose(contact(model, scene), math.tan(math.radians(float(angle[0]))), rtol=1e-5)
        coefficient.add(float(angle[0]))
    assert len(coefficient) == 3
    assert read(model.campaign).site == model.campaign.site


def test_the_contact_is_reduced_with_the_soil():
    model, coefficients = model_of(SCENE)
    half, _ = model.with_strength_factor(0.5).of_sample(coefficients[0])
    whole, _ = model.of_sample(coefficients[0])
    np.testing.assert_allclose(contact(model, half), contact(model, whole) / 2, rtol=1e-5)


def test_a_friction_that_does_not_vary_is_that_of_the_contact_too():
    campaign = parse(SCENE.replace(RANDOM, "friction = 25.0\n").replace("cohesion = 1e3\n", COHESION))
    assert campaign.site.shape.interface == mpm.Interface(25.0)


def test_the_friction_of_the_soil_falls_with_slip_where_the_contact_softens():
    softening = ", residual_ratio = 0.4, slip_length = 0.25"
    model, coefficients = model_of(SCENE.replace('"soil" }', f'"soil"{softening} }}'))
    assert model.campaign.site.shape.interface.slip_length == 0.25
    scene, _ = model.of_sample(coefficients[0])
    np.testing.assert_allclose(scene.boundary.softening, [0.4, 0.25])
    assert read(model.campaign).site == model.campaign.site
    with pytest.raises(ValueError, match=r"residual_ratio = 0\.4 and slip_length = None: give both"):
        parse(SCENE.replace('"soil" }', "20.0, residual_ratio = 0.4 }"))
    with pytest.raises(ValueError, match=r"\[ground.interface\] slip_length = 300 m, above 20 m: were mm meant"):
        parse(SCENE.replace('"soil" }', "20.0, residual_ratio = 0.4, slip_length = 300.0 }"))


COHESION = "cohesion = { mean = 1e3, cov = 0.2, length = [inf, inf] }\n"


def test_soil_that_varies_in_space_has_a_contact_that_does():
    model, coefficients = model_of(SCENE.replace("length = [inf, inf]", "length = [4.0, 2.0]"))
    scene, _ = model.of_sample(coefficients[0])
    angle, x = np.asarray(model.parameters(coefficients[0])["friction"]), np.asarray(scene.particles.position)
    for node, friction in zip(model.contact.nodes, contact(model, scene), strict=True):
        point = np.array(scene.grid.origin) + scene.grid.cell * np.array(np.unravel_index(node, scene.grid.shape))
        near = np.abs(x - point[:, None]).max(axis=0) < 0.9 * scene.grid.cell
        if near.any():
            low, high = np.tan(np.radians([angle[near].min(), angle[near].max()]))
            assert low - 0.02 <= friction <= high + 0.02
    assert np.ptp(contact(model, scene)) > 0.01


def test_bedrock_without_an_interface_has_the_strength_of_the_soil_on_it():
    """Else the lowest cell of soil would stick to it, and the slope would be as firm as one glued to its rock."""
    model, coefficients = model_of(SCENE.replace('interface = { friction = "soil" }\n', ""))
    assert model.campaign.site.shape.interface == mpm.Interface(20.0, 1e3)
    scene, _ = model.of_sample(coefficients[0])
    assert scene.boundary.cut is None
    np.testing.assert_allclose(np.asarray(scene.boundary.cohesion)[model.contact.nodes], 1e3)
    stuck, _ = model_of(SCENE.replace('{ friction = "soil" }', '"fixed"'))
    assert stuck.scene.boundary.base is None
    assert stuck.scene.boundary.cut.any()
    level = parse(SCENE.replace(SCENE.splitlines()[3] + "\n", "").replace('interface = { friction = "soil" }\n', ""))
    assert level.site.shape.interface is None


LAYERED = """[[layer]]
name = "sand"
bottom = [[0.0, 4.0], [4.0, 4.0], [8.0, 1.0], [14.0, 1.0]]
[[layer]]
name = "clay"
strength = 12e3
[soil]
"""


def test_layers_of_both_kinds_have_each_its_own_contact():
    """The boundary of the layers meets the bedrock at x = 8 m: sand lies on it from there on."""
    model, coefficients = model_of(
        SCENE.replace('"soil" }', '"soil", cohesion = "soil" }').replace("[soil]\n", LAYERED)
    )
    assert model.campaign.site.shape.interface.softens
    scene, _ = model.of_sample(coefficients[0])
    nodes = model.contact.nodes
    friction, cohesion = np.asarray(scene.boundary.friction)[nodes], np.asarray(scene.boundary.cohesion)[nodes]
    x = scene.grid.origin[0] + scene.grid.cell * np.unravel_index(nodes, scene.grid.shape)[0]
    angle = np.nanmax(model.parameters(coefficients[0])["friction"])
    np.testing.assert_allclose(friction[x > 9.5], math.tan(math.radians(angle)), rtol=1e-5)
    np.testing.assert_allclose(cohesion[x > 9.5], 1e3, rtol=1e-5)
    np.testing.assert_allclose(friction[x < 3.5], 0, atol=1e-6)
    np.testing.assert_allclose(cohesion[x < 3.5], 12e3, rtol=1e-5)


@pytest.mark.parametrize(
    ("old", "new", "why"),
    [
        (
            RANDOM,
            "[strength]\nmean = 2e4\ncov = 0.2\nlength = [inf, inf]\n",
            "the friction of the soil, which has none",
        ),
        ('"soil" }', '"rock" }', "friction"),
        ('"soil" }', '"soil", cohesion = "rock" }', "cohesion"),
    ],
)
def test_a_strength_that_no_soil_has_is_refused(old, new, why):
    scene = SCENE.replace(old, new)
    with pytest.raises(ValueError, match=why):
        parse(scene.replace("cohesion = 1e3\n", "") if "strength" in new else scene)


def test_the_solver_takes_a_friction_for_walls_that_have_one():
    model, _ = model_of(SCENE)
    with pytest.raises(ValueError, match="wall_friction has shape"):
        mpm.with_soil(model.scene, model.state, wall_friction=[0.1, 0.2])
    with pytest.raises(ValueError, match="no wall has cohesion"):
        mpm.with_soil(model.scene, model.state, wall_cohesion=1e3)
    with pytest.raises(ValueError, match="no wall has friction"):
        mpm.with_soil(
            *mpm.section(mpm.Section([(0, 4), (4, 4)]), mpm.Soil(), mpm.Discretisation(1.0, (0.5, 0.5))),
            wall_friction=0.3,
        )
