"""An interface whose friction and cohesion are random fields: on the nodes of every grid, and in the answer."""

import dataclasses
import math

import jax.numpy as jnp
import numpy as np
import pytest

import jaxmpm as mpm
import kl
from benchmarks.robustness.invented import TERRAIN
from cooperative import runs
from cooperative.scene import parse, read
from tests.cooperative.scene.test_contact_of_soil import SCENE as OF_SOIL
from tests.cooperative.scene.test_contact_of_soil import model_of
from tests.scenes import tables

SCENE = """
[ground]
surface = [[0.0, 6.0], [4.0, 6.0], [8.0, 2.0], [14.0, 2.0]]
bedrock = [[0.0, 3.0], [4.0, 3.0], [8.0, 1.0], [14.0, 1.0]]
[ground.interface]
friction = { mean = 15.0, cov = 0.2, length = [4.0, inf] }
cohesion = { mean = 4e3, cov = 0.4, length = [3.0, inf] }
[soil]
unit_weight = 18e3
young = 2e7
poisson = 0.3
cohesion = 20e3
friction = 30.0
""" + tables(1.0)


def at_nodes(model, sample, name):
    scene, _ = model.of_sample(sample)
    return np.asarray(getattr(scene.boundary, name.removeprefix("wall_")))[model.contact.nodes]


def test_the_field_reaches_the_nodes_of_both_grids_alike():
    rough, coefficients = model_of(SCENE)
    fine, _ = model_of(SCENE, "refined")
    assert rough.names == ()
    assert rough.of_contact == ("wall_friction", "wall_cohesion")
    for name in rough.of_contact:
        values, finer = (at_nodes(model, coefficients[0], name) for model in (rough, fine))
        x, order = fine.contact.points[0], np.argsort(fine.contact.points[0])
        along = np.interp(rough.contact.points[0], x[order], finer[order])
        inside = (rough.contact.points[0] > 0) & (rough.contact.points[0] < 14)
        np.testing.assert_allclose(values[inside], along[inside], rtol=0.03)
        assert np.ptp(values) > 0.1 * values.mean()


def test_over_samples_it_has_the_mean_and_the_deviation_of_the_scene():
    model, coefficients = model_of(SCENE.replace("samples = ", "samples = 150 # "))
    node = model.contact.nodes[int(np.argmin(np.abs(model.contact.points[0] - 6)))]
    varied = [model.varied(sample) for sample in coefficients]
    friction, cohesion = (np.array([float(each[name][node]) for each in varied]) for name in model.of_contact)
    angle = np.degrees(np.arctan(friction))
    assert angle.mean() == pytest.approx(15.0, rel=0.03)
    assert angle.std() == pytest.approx(3.0, rel=0.15)
    assert cohesion.mean() == pytest.approx(4e3, rel=0.06)
    assert cohesion.std() == pytest.approx(1.6e3, rel=0.2)


@pytest.mark.parametrize("scene", [SCENE, OF_SOIL])
def test_lanes_slide_each_on_their_own_contact(scene):
    model, coefficients = model_of(scene.replace("t_end = 4.0", "t_end = 0.5\nleast_volume = 0"))
    together = {sample.number: sample.row for sample in runs.run_samples(model, coefficients, [0, 1, 2])}
    for number, row in together.items():
        scene, state = model.of_sample(coefficients[number])
        alone = mpm.solve(scene, state, t_end=0.5)
        displacement = float(np.linalg.norm(alone.state.displacement, axis=0).max())
        assert row["displacement"] == pytest.approx(displacement, rel=0.02)
    assert len({row["displacement"] for row in together.values()}) == 3


def test_it_is_reduced_read_again_and_drawn_at_particles():
    model, coefficients = model_of(SCENE)
    half = model.with_strength_factor(0.5)
    for name in model.of_contact:
        np.testing.assert_allclose(
            at_nodes(half, coefficients[0], name), at_nodes(model, coefficients[0], name) / 2, rtol=1e-5
        )
    again = read(model.campaign)
    assert (again.site, again.random) == (model.campaign.site, model.campaign.random)
    values = model.parameters(coefficients[0])
    assert list(values) == ["interface_friction", "interface_cohesion"]
    assert all(value.shape == model.scene.particles.mass.shape for value in values.values())


BLOCK = """
surface = [[0.0, 7.0], [2.0, 6.0], [2.0, 8.0], [6.0, 6.0], [6.0, 4.0], [14.0, 0.0]]
bedrock = [[0.0, 7.0], [14.0, 0.0]]
"""


@pytest.mark.parametrize(("cov", "fails"), [(1e-3, False), (1.5, True)])
def test_a_block_whose_contact_may_be_weak_fails_where_that_of_its_mean_stands(cov, fails):
    """Its weight needs a cohesion of 6.6 kPa beside 15 degrees; the probability of failure is that of the contact."""
    ground, contact = SCENE.index("surface"), SCENE.index("[ground.interface]")
    scene = SCENE[:ground] + BLOCK + SCENE[contact:].replace("20e3", "60e3")
    scene = scene.replace("mean = 15.0, cov = 0.2", "mean = 15.0, cov = 0.001")
    model, coefficients = model_of(
        scene.replace("mean = 4e3, cov = 0.4", f"mean = 9e3, cov = {cov}").replace("[3.0", "[30.0")
    )
    names = list(model.of_contact)
    cohesion = [np.asarray(model.varied(sample)[names[1]])[model.contact.nodes].mean() for sample in coefficients]
    start, state = model.of_sample(coefficients[int(np.argmin(cohesion))])
    moved = float(mpm.diagnostics.largest_displacement(mpm.solve(start, state, t_end=0.8).state))
    assert bool(min(cohesion) < 5e3) is fails
    assert (moved > 0.1) is fails


def test_a_trend_grows_with_depth_and_correlation_goes_with_the_soil():
    scene = SCENE.replace("cov = 0.4,", "cov = 0.01, trend = 500.0,")
    model, coefficients = model_of(scene)
    values, (x, z) = at_nodes(model, coefficients[0], "wall_cohesion"), model.contact.points
    depth = np.maximum(np.interp(x, [0, 4, 8, 14], [6, 6, 2, 2]) - z, 0)
    np.testing.assert_allclose(values, 4e3 + 500 * depth, rtol=0.05)
    together = SCENE.replace("length = [3.0", "length = [4.0") + (
        '[cross_correlation]\nparameters = ["interface_friction", "interface_cohesion"]\n'
        "matrix = [[1.0, 0.99], [0.99, 1.0]]\n"
    )
    model, coefficients = model_of(together)
    friction, cohesion = (at_nodes(model, coefficients[0], name) for name in model.of_contact)
    assert np.corrcoef(friction, np.log(cohesion))[0, 1] > 0.9


@pytest.mark.parametrize(
    ("old", "new", "why"),
    [
        ("mean = 4e3", "mean = 4.0", r"\[ground.interface.cohesion\] mean = 4 .* kPa"),
        ("cov = 0.2", "cov = 0.8", r"\[ground.interface.friction\] has values of"),
        ("length = [3.0, inf]", "length = [3.0]", "interface_cohesion has a length of 1 values: give 2"),
        (
            "cov = 0.4",
            "cov = 0.4, sampled_at = 'cells'",
            r"cohesion\]? sampled_at = 'cells' is of particles; the field of a",
        ),
    ],
)
def test_fields_that_no_contact_has_are_refused(old, new, why):
    with pytest.raises(ValueError, match=why):
        parse(SCENE.replace(old, new))


def test_a_campaign_in_python_needs_an_interface_with_what_varies():
    campaign = parse(SCENE)
    for interface in (None, mpm.Interface(15.0)):
        shape = dataclasses.replace(campaign.site.shape, interface=interface)
        bare = dataclasses.replace(campaign, ground=dataclasses.replace(campaign.site, shape=shape))
        with pytest.raises(ValueError, match=r"random holds .*interface_cohesion, which is no parameter"):
            runs.build(bare, "rough", runs.random_soil(bare))
    assert math.isclose(campaign.site.shape.interface.cohesion, 4e3)


LEVEL = SCENE.replace("bedrock = [[0.0, 3.0], [4.0, 3.0], [8.0, 1.0], [14.0, 1.0]]\n", "base = 0.0\n")
TERRAIN_INTERFACE = """
[terrain.interface]
friction = { mean = 15.0, cov = 0.2, length = [6.0, 3.0, inf], form = "elliptic", correlation = "exponential" }
cohesion = { mean = 4e3, cov = 0.4, length = [6.0, 3.0, inf] }
"""
SOLID = TERRAIN.replace("\n[soil]", f"\n{TERRAIN_INTERFACE}[soil]", 1)


@pytest.mark.parametrize("scene", [LEVEL, SOLID], ids=["section", "terrain"])
def test_the_field_of_a_level_base_reaches_its_nodes_in_2d_and_3d(scene):
    model, coefficients = model_of(scene)
    assert set(model.of_contact) == {"wall_friction", "wall_cohesion"}
    sample, points = coefficients[0], jnp.asarray(model.contact.points, jnp.float32)
    (group,) = model.soil.groups_of("interface_friction").values()
    field = model.campaign.random["interface_friction"]
    drawn = kl.field_at(group.expansion, model.soil.coefficients(sample)["interface_friction"], group.inside(points))
    angle = np.degrees(np.arctan(at_nodes(model, sample, "wall_friction")))
    np.testing.assert_allclose(angle, field.distribution.transform(drawn), rtol=1e-4)
    assert np.ptp(angle) > 1
    weak, strong = (
        mpm.with_soil(*model.of_sample(sample), wall_friction=friction, wall_cohesion=0.0) for friction in (0.02, 0.8)
    )
    low, high = (float(mpm.diagnostics.largest_displacement(mpm.solve(*s, t_end=0.3).state)) for s in (weak, strong))
    assert low > 1.05 * high


def test_a_factor_of_the_sample_multiplies_the_contact():
    model, coefficients = model_of(SCENE.replace("mean = 4e3, cov = 0.4,", "mean = 4e3, cov = 0.4, factor_cov = 0.3,"))
    field, rest = model.campaign.random["interface_cohesion"], coefficients[0][1:]
    low, high = (at_nodes(model, np.append(score, rest), "wall_cohesion") for score in (0.0, 1.5))
    np.testing.assert_allclose(high, float(field.factor(1.5) / field.factor(0.0)) * low, rtol=1e-4)
