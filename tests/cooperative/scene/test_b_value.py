"""The B-value of a scene: of the soil or a layer, random, below the water alone, and the solver's own."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxmpm as mpm
from cooperative import runs
from cooperative.scene import parse
from jaxmpm import plot
from jaxmpm.laws import Saturated, declared, laws_of
from jaxmpm.run import Early, limit_load_scene

SCENE = """
[ground]
surface = [[0, 6], [6, 6], [12, 2], [20, 2]]
base = 0.0
toe = 12.0
[water]
level = 1.5
[soil]
unit_weight = 18e3
young = 5e6
poisson = 0.3
cohesion = { mean = 2e3, cov = 0.1, length = [10.0, 2.0] }
friction = 25.0
dilation = -3.0
b_value = { mean = 0.7, cov = 0.05, length = [10.0, 2.0] }
[rough]
cell = 1.0
spacing = [0.5, 0.5]
[refined]
cell = 1.0
spacing = [0.5, 0.5]
[run]
t_end = 0.4
failure_displacement = 0.05
[campaign]
samples = 10
seed = 1
"""
LAYERS = """
[[layer]]
name = "fill"
bottom = [[0, 1], [20, 1]]
b_value = 0.5
[[layer]]
name = "sand"
"""
LAYERED = SCENE.replace("{ mean = 0.7, cov = 0.05, length = [10.0, 2.0] }", "0.9") + LAYERS


def model_of(text):
    campaign = parse(text)
    return runs.build(campaign, "rough", runs.random_soil(campaign))


def test_the_b_value_is_random_below_the_water_and_sets_the_time_step_of_a_sample():
    model = model_of(SCENE)
    law = model.scene.material
    assert isinstance(law, Saturated)
    z = np.asarray(model.scene.particles.position)[1]
    sample = runs.coefficients_of(model.campaign, model.soil)[1]
    scene, _ = model.of_sample(sample)
    assert np.ptp(np.asarray(scene.material.b_value)) > 0.01
    assert np.asarray(scene.material.law.cohesion).std() > 0
    assert model.time_step(sample) == float(scene.numerics.time_step)
    assert np.all((np.asarray(scene.material.water_modulus) > 0) == (z < 1.5))
    slowest = jnp.max(law.p_wave_modulus) / jnp.max(scene.material.p_wave_modulus)
    np.testing.assert_allclose(
        scene.numerics.time_step, model.scene.numerics.time_step * min(1.0, float(jnp.sqrt(slowest))), rtol=1e-5
    )


def test_a_layer_with_a_b_value_runs_beside_one_of_drained_soil():
    model = model_of(LAYERED.replace("b_value = 0.9\n", "").replace("samples = 10", 'samples = 10\nfields = "both"'))
    [run] = runs.run_samples(model, np.zeros((1, model.soil.modes)), [0], width=1)
    assert run.fields["displacement"].shape == model.scene.particles.position.shape
    with pytest.raises(ValueError, match="colour = 'plastic_strain': give one of"):
        plot.state(model.scene, model.state, "plastic_strain")
    with pytest.raises(ValueError, match="the rule Early needs plastic strain"):
        Early(1.0, 0.05).check(model.scene, model.state)


def test_layers_have_b_values_of_their_own():
    text = LAYERED
    scene = model_of(text).scene
    b_value = np.asarray(declared(scene.material)["b_value"].value)
    z = np.asarray(scene.particles.position)[1]
    np.testing.assert_allclose(b_value, np.where(z > 1, 0.5, 0.9), rtol=1e-6)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (SCENE.replace("[water]\nlevel = 1.5\n", ""), "b_value = 0.7 has no effect without water in the ground"),
        (SCENE.replace("mean = 0.7", "mean = 1.2"), "b_value.* 0 or more and below 1 by a smaller cov"),
        (SCENE.replace("dilation = -3.0", "dilation = -20.0"), "dilation = -20 degrees: give a value from -15 to 60"),
    ],
)
def test_what_has_no_effect_or_no_step_is_refused(text, words):
    with pytest.raises(ValueError, match=words):
        parse(text)


def test_it_is_the_same_from_python():
    campaign = parse(SCENE)
    soil = replace(campaign.soil, unusual=True)
    assert soil.b_value == 0.7
    assert isinstance(soil.material(np.dtype("float32"), 1.0), Saturated)
    scene, _ = mpm.section(campaign.site.shape, soil, campaign.grids["rough"], water=1.5)
    built = model_of(SCENE).scene
    assert jax.tree.structure(scene.material) == jax.tree.structure(built.material)
    np.testing.assert_allclose(scene.material.pore_pressure, built.material.pore_pressure)


def test_slopes_are_asked_drained_until_they_fail():
    text = SCENE.replace("{ mean = 0.7, cov = 0.05, length = [10.0, 2.0] }", "0.9")
    campaign = parse(text + LAYERS)
    drained = campaign.drained()
    assert [soil.soil.b_value for soil in drained.site.soils(drained.soil)] == [0, 0]
    assert [soil.soil.b_value for soil in campaign.site.soils(campaign.soil)] == [0.5, 0.9]
    assert replace(drained, soil=campaign.soil, ground=campaign.site) == campaign
    dry = parse(text.replace("b_value = 0.9\n", ""))
    assert dry.drained() is dry
    with pytest.raises(ValueError, match=r"b_value is random, and .* drained soil: give it as a number"):
        parse(SCENE).drained()


def test_the_limit_load_is_that_of_drained_soil():
    text = SCENE.replace("{ mean = 0.7, cov = 0.05, length = [10.0, 2.0] }", "0.9")
    sealed, dry = (
        limit_load_scene(model_of(each).scene) for each in (text + LAYERS, (text + LAYERS).replace("b_value = 0", "# "))
    )
    np.testing.assert_array_equal(declared(sealed.material)["b_value"].value, 0)
    for law, skeleton in zip(laws_of(sealed.material), laws_of(dry.material), strict=True):
        jax.tree.map(np.testing.assert_array_equal, law.law, skeleton)
    np.testing.assert_allclose(sealed.numerics.time_step, dry.numerics.time_step, rtol=1e-3)
