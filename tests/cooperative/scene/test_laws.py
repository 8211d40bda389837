"""The law of a scene's soil: chosen in TOML, it is the solver's soil of that law, with its fields at the particles."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

import cooperative
import jaxmpm as mpm
from cooperative import runs
from cooperative.folder import read_results
from cooperative.scene import campaign_of as stored_campaign
from cooperative.scene import parse, read_scene
from cooperative.scene._words import in_words, of_words
from cooperative.tools.safety import slices_at_rest
from tests.scenes import model_of

SCENE = """
[ground]
surface = [[0, 6], [6, 6], [12, 2], [20, 2]]
base = 0.0
toe = 12.0

[soil]
{soil}
poisson = 0.3

[rough]
cell = 2.0
spacing = [1.0, 1.0]

[refined]
cell = 2.0
spacing = [1.0, 1.0]

[run]
t_end = 0.4
failure_displacement = 0.05

[campaign]
samples = 3
seed = 1
estimator = "published"
k_t = 1
fields = "none"
slides = 0
"""
FIELD = "cov = 0.1, length = [10.0, 2.0]"
SOILS = {
    "modified cam clay": f"""
law = "modified cam clay"
unit_weight = 18e3
compression = 0.1
swelling = 0.02
critical_state = {{ mean = 0.8, {FIELD} }}
ocr = 2.0
""",
    "anisotropic undrained": f"""
law = "anisotropic undrained"
unit_weight = 18e3
young = 5e6
active_strength = {{ mean = 14e3, {FIELD} }}
simple_strength = 10e3
passive_strength = 8e3
""",
    "mu(I)": f"""
law = "mu(I)"
unit_weight = 15e3
young = 5e6
static_friction = {{ mean = 21.0, {FIELD} }}
dynamic_friction = 35.0
grain_size = 0.01
""",
}
PYTHON = {
    "modified cam clay": mpm.CamClaySoil(0.1, 0.02, 0.8, ocr=2.0),
    "anisotropic undrained": mpm.AnisotropicSoil(14e3, 10e3, 8e3, young=5e6, poisson=0.3),
    "mu(I)": mpm.GranularSoil(21.0, 35.0, 0.01, young=5e6),
}
VARIES = {"modified cam clay": "critical_state", "anisotropic undrained": "active_strength", "mu(I)": "static_friction"}
laws = pytest.mark.parametrize("law", SOILS)


def campaign_of(law):
    return parse(SCENE.format(soil=SOILS[law]))


@laws
def test_the_soil_is_the_solvers_with_its_fields_and_moves_as_in_python(law):
    campaign = campaign_of(law)
    assert campaign.soil == PYTHON[law]
    assert list(campaign.random) == [VARIES[law]]
    model = runs.build(campaign, "rough", runs.random_soil(campaign))
    sample = runs.coefficients_of(campaign, model.soil)[1]
    value = np.asarray(model.parameters(sample)[VARIES[law]])
    assert value.std() > 0.01 * value.mean()
    section = mpm.Section(((0, 6), (6, 6), (12, 2), (20, 2)), base=0.0, toe=12.0)
    scene, state = mpm.section(section, PYTHON[law], campaign.grids["rough"])
    number = mpm.laws.declared(scene.material)[VARIES[law]]
    in_law = np.deg2rad(value) if number.parameter.angle else value
    ended, expected = (
        mpm.solve(*start, t_end=0.2).state.displacement
        for start in (model.of_sample(sample), mpm.with_soil(scene, state, **{VARIES[law]: jnp.asarray(in_law)}))
    )
    assert abs(ended).max() > 1e-3
    np.testing.assert_allclose(ended, expected, rtol=0, atol=1e-5 * abs(ended).max())


@laws
def test_a_campaign_of_it_runs_and_is_the_same_from_its_folder_and_in_words(law, tmp_path):
    scene = tmp_path / "scene.toml"
    scene.write_text(SCENE.format(soil=SOILS[law]))
    cooperative.run(read_scene(scene), tmp_path / "out")
    results = read_results(tmp_path / "out")
    rows = results.rough.results
    assert [broke_off for _, broke_off in rows.values()] == [False] * 3
    assert len({moved for moved, _ in rows.values()}) == 3
    again = stored_campaign(results.store)
    assert again.soil == PYTHON[law]
    assert again.random == campaign_of(law).random
    assert of_words(in_words(PYTHON[law]), "soil") == PYTHON[law]


@laws
def test_slices_refuse_it_with_a_reason(law):
    with pytest.raises(ValueError, match=f"not for {type(PYTHON[law]).__name__}, whose strength depends on stress"):
        slices_at_rest(campaign_of(law))


def test_one_key_chooses_the_law_of_soil_with_friction():
    sand = "unit_weight = 18e3\nyoung = 2e7\ncohesion = 5e3\nfriction = { mean = 30.0, cov = 0.1, length = [9.0, 9.0] }"
    plain, cone = (parse(SCENE.format(soil=f"{head}{sand}")).soil for head in ("", "law = 'drucker-prager'\n"))
    assert cone == replace(plain, law=mpm.laws.DruckerPrager)
    assert parse(SCENE.format(soil=f"law = 'mohr-coulomb'\n{sand}")).soil == plain


def test_layers_have_laws_of_their_own():
    soil = SOILS["modified cam clay"] + "poisson = 0.3\n"
    layers = """
[[layer]]
name = "grains"
depth = 1.0
law = "mu(I)"
young = 5e6
static_friction = 21.0
dynamic_friction = 35.0
grain_size = 0.01

[[layer]]
name = "sand"
depth = 2.0
young = 5e6
cohesion = 1e3
friction = 30.0

[[layer]]
name = "clay"
depth = 3.0

[[layer]]
name = "rock"
rock = true
young = 1e8
"""
    campaign = parse(SCENE.format(soil=soil).replace("poisson = 0.3\n\n[rough]", f"{layers}\n[rough]"))
    kinds = [type(layer.soil) for layer in campaign.site.soils(campaign.soil)]
    assert kinds == [mpm.GranularSoil, mpm.FrictionalSoil, mpm.CamClaySoil, mpm.Soil]
    model = runs.build(campaign, "rough", runs.random_soil(campaign))
    assert {type(part) for part in mpm.laws.laws_of(model.scene.material)} == {
        mpm.laws.MuI, mpm.laws.MohrCoulomb, mpm.laws.ModifiedCamClay, mpm.laws.Elastic
    }  # fmt: skip


CAM, MU = SOILS["modified cam clay"], SOILS["mu(I)"]
REFUSED = [
    (CAM + "strength = 30e3", r"strength has no effect in soil of law = 'modified cam clay': leave it out"),
    (CAM + "young = 1e7", "young has no effect in soil of law = 'modified cam clay'"),
    (CAM.replace("compression = 0.1\n", ""), r"\[soil\] lacks compression: add it"),
    (
        CAM.replace("swelling = 0.02", "swelling = 0.2"),
        "swelling reaches 0.2, compression comes down to 0.1: give a sw",
    ),
    (
        CAM.replace('law = "modified cam clay"', ""),
        "neither a strength .* is of law = 'modified cam clay', which .soil. does",
    ),
    (
        CAM.replace("modified cam", "modified camm"),
        "law = 'modified camm clay': give one of .*did you mean 'modified cam c",
    ),
    (
        MU.replace("dynamic_friction = 35.0", "dynamic_friction = 22.0"),
        r"static_friction\] reaches 31.1 degrees, dynamic_friction comes down to 22",
    ),
    (MU.replace("grain_size = 0.01", "grain_size = 20.0"), "grain_size = 20 m, above 10 m: were mm meant"),
    (MU.replace("young = 5e6\n", ""), r"\[soil\] lacks young: add it"),
    (SOILS["anisotropic undrained"].replace("8e3", "8.0"), "passive_strength = 8 Pa, below 1000 Pa: were kPa meant"),
]


@pytest.mark.parametrize(("soil", "message"), REFUSED)
def test_numbers_that_are_not_of_the_law_are_refused(soil, message):
    with pytest.raises(ValueError, match=message):
        parse(SCENE.format(soil=soil))


SAND = """
unit_weight = 18e3
young = 5e6
cohesion = 0.0
friction = {{ mean = 32.0, {field} }}
k0 = {k0}
""".replace("{field}", FIELD)


def sand(k0):
    return SCENE.format(soil=SAND.format(k0=k0))


def test_k0_of_a_scene_is_that_of_its_ground_at_rest_and_may_vary():
    model = model_of(sand(0.5), at_rest=True)
    section = mpm.Section(((0, 6), (6, 6), (12, 2), (20, 2)), base=0.0, toe=12.0)
    soil = mpm.FrictionalSoil(0.0, 32.0, unit_weight=18e3, young=5e6, k0=0.5)
    _, expected = mpm.section(section, soil, model.campaign.grids["rough"])
    np.testing.assert_array_equal(model.state.stress, expected.stress)
    varied = model_of(sand("{ mean = 0.6, cov = 0.1, length = [10.0, 2.0] }"), at_rest=True)
    sample = runs.coefficients_of(varied.campaign, varied.soil)[1]
    value = np.asarray(varied.parameters(sample)["k0"])
    assert value.std() > 0.01
    scene, state = varied.of_sample(sample)
    np.testing.assert_array_equal(scene.loads.k0, value)
    _, expected = mpm.with_soil(varied.scene, varied.state, **varied.varied(sample))
    np.testing.assert_array_equal(state.stress, expected.stress)
    assert abs(state.stress[0] - varied.state.stress[0]).max() > 500.0


def test_k0_that_varies_in_one_layer_leaves_the_other_that_of_its_loading():
    text = sand("{ mean = 0.6, cov = 0.1, length = [10.0, 2.0] }")
    soil = text[text.index("[soil]") : text.index("[rough]")]
    layers = soil.replace("[soil]", '[[layer]]\nname = "sand"\nbottom = [[0, 1], [20, 1]]') + (
        '[[layer]]\nname = "clay"\nstrength = 30e3\nunit_weight = 18e3\nyoung = 5e6\npoisson = 0.25\n'
    )
    model = model_of(text.replace(soil, layers))
    value = np.asarray(model.parameters(runs.coefficients_of(model.campaign, model.soil)[1])["k0"])
    np.testing.assert_allclose(value[model.layer == 1], 1 / 3, rtol=1e-6)
    assert value[model.layer == 0].std() > 0.01


def test_k0_beyond_what_sand_bears_is_refused_before_anything_runs():
    with pytest.raises(ValueError, match=r"k0 = 0\.2: level soil yields so at .* bears 0\.31 to 3\.2, from its active"):
        model_of(sand(0.2))


@pytest.mark.parametrize("law", ["mohr-coulomb", None])
def test_matching_is_of_the_cone_alone(law):
    given = sand(0.5).replace("k0 = 0.5", 'matching = "extension"' + (f'\nlaw = "{law}"' if law else ""))
    with pytest.raises(ValueError, match="matching is of Drucker-Prager's cone, and has no effect with mohr-coulomb"):
        parse(given)
    assert parse(given.replace("mohr-coulomb", "drucker-prager") if law else sand(0.5)).soil.cohesion == 0.0
    with pytest.raises(ValueError, match=r"matching = .* has no effect with MohrCoulomb: leave it out"):
        mpm.FrictionalSoil(1e3, 30.0, matching=mpm.laws.Matching.EXTENSION).material(np.float32, 1.0)
