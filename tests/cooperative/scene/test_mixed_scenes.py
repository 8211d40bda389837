"""Scenes whose layers are of different kinds, each complete by itself or on top of [soil]."""

import re
import tomllib

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import cooperative
import jaxmpm as mpm
from benchmarks.robustness.invented import TINY
from cooperative.runs import grid_size
from cooperative.scene import parse, to_toml
from cooperative.tools.research.back_analysis import Parameters, Survey, predict
from tests import ROOT
from tests.scenes import model_of

DOCS = (ROOT / "docs" / "random-fields.md").read_text()
LAYERS = next(block for block in re.findall(r"```toml\n(.*?)```", DOCS, re.DOTALL) if 'name = "fill"' in block)
GROUND = "[ground]\nsurface = [[0.0, 10.0], [8.0, 10.0], [16.0, 4.0], [32.0, 4.0]]\ntoe = 16.0\n"
MIXED = 'name = "mixed"\n' + GROUND + LAYERS + TINY[TINY.index("[rough]") :]
CLAY = """[soil]
unit_weight = 18e3
young = 2e7
poisson = 0.3
softening_modulus = 30e3
residual_ratio = 0.6
[strength]
mean = 14e3
cov = 0.3
length = [20.0, 2.0]
"""
FILL = """[[layer]]
name = "fill"
bottom = [[0.0, 4.5], [16.0, 4.0]]
cohesion = 4e3
friction = { mean = 30.0, cov = 0.1, length = [16.0, 3.0] }
[[layer]]
name = "clay"
"""
OVER = 'name = "mixed"\n' + GROUND + FILL + CLAY + TINY[TINY.index("[rough]") :]


@pytest.mark.parametrize(("text", "laws"), [(MIXED, ("MohrCoulomb", "J2", "Elastic")), (OVER, ("MohrCoulomb", "J2"))])
def test_each_layer_has_its_own_law_and_its_own_fields(text, laws):
    model = model_of(text)
    assert tuple(type(law).__name__ for law in model.scene.material.laws) == laws
    assert set(model.names) == {"strength", "friction"}
    xi = np.random.default_rng(1).standard_normal(model.soil.modes).astype(np.float32)
    before = {name: np.asarray(values) for name, values in model.parameters(xi).items()}
    for name, layer in (("friction", 0), ("strength", 1)):
        assert np.array_equal(np.isfinite(before[name]), model.layer == layer)
        [group] = model.soil.groups_of(name).values()
        other = xi.copy()
        other[group.indices] += 1
        after = model.parameters(other)
        for each, values in after.items():
            changes = np.asarray(values)[np.isfinite(before[each])] != before[each][np.isfinite(before[each])]
            assert changes.mean() > 0.9 if each == name else not changes.any()
    scene, _ = model.of_sample(xi)
    sand, clay = scene.material.laws[:2]
    np.testing.assert_allclose(np.degrees(sand.friction), before["friction"][model.layer == 0], rtol=1e-5)
    np.testing.assert_allclose(clay.strength, before["strength"][model.layer == 1], rtol=1e-6)
    np.testing.assert_array_equal(sand.cohesion, np.float32(4e3))


def test_strength_of_clay_grows_from_the_top_of_its_layer():
    model = model_of(MIXED)
    x, z = np.asarray(model.scene.particles.position)
    clay = model.layer == 1
    top = np.where(x < 16, 4.5 - 0.5 * x / 16, 4.0)
    median = 14e3 / np.sqrt(1 + 0.3**2) * (1 + np.maximum(top - z, 0) / 14)
    np.testing.assert_allclose(model.strength()[clay], median[clay], rtol=2e-4)


def test_a_calibration_divides_the_strength_of_both_kinds():
    model = model_of(MIXED)
    weaker = model.with_strength_factor(0.8)
    xi = np.zeros(model.soil.modes, np.float32)
    (sand, clay, _), (sand_less, clay_less, _) = (each.of_sample(xi)[0].material.laws for each in (model, weaker))
    np.testing.assert_allclose(clay_less.strength, 0.8 * clay.strength, rtol=1e-5)
    np.testing.assert_allclose(sand_less.cohesion, 0.8 * sand.cohesion, rtol=1e-5)
    np.testing.assert_allclose(jnp.tan(sand_less.friction), 0.8 * jnp.tan(sand.friction), rtol=1e-5)


def test_a_scene_of_both_kinds_runs_to_a_report(tmp_path):
    text = MIXED.replace("samples = 6", "samples = 2").replace("t_end = 4.0", "t_end = 0.5")
    summary = cooperative.run(text, tmp_path)
    assert 0 <= summary.probability.value <= 1
    cooperative.report(tmp_path)
    assert "fill" in (tmp_path / "report.html").read_text()
    assert grid_size(parse(text), "refined").particles > 100


def test_numerics_suit_every_layer():
    for text in (MIXED, OVER):
        for numerics in parse(text).grids.values():
            assert not numerics.fbar
    assert parse(OVER).grids["rough"].fbar is False
    assert isinstance(parse(OVER).soil, mpm.Soil)


def test_clay_under_fill_and_a_water_table_is_as_strong_as_its_effective_stress_asks():
    text = re.sub(r"strength = \{ mean.*\}", "strength_ratio = 0.25\nstrength_minimum = 5e3", MIXED)
    text = text.replace("[rough]", "[water]\nlevel = 4.0\n[rough]", 1)
    model = model_of(text)
    x, z = np.asarray(model.scene.particles.position)
    behind = (model.layer == 1) & (x < 8)  # under level ground
    top = 4.5 - 0.5 * x / 16
    vertical = 20e3 * (10 - top) + 18e3 * (top - z) - 9810 * np.maximum(4 - z, 0)
    scene, _ = model.of_sample()
    assert not np.isnan(np.asarray(scene.material.laws[1].strength)).any()
    strength = np.asarray(model.strength())
    np.testing.assert_allclose(strength[behind], 0.25 * vertical[behind], rtol=0.03)
    assert np.isnan(strength[model.layer == 0]).all()


def test_a_slide_in_both_kinds_is_predicted_and_its_derivative_finite():
    model = model_of(MIXED, at_rest=True)
    survey = Survey(0.2, 2, np.array([0, 100]), np.array([12.0, 20.0]))

    def height(strength):
        parameters = Parameters({"strength": strength}, np.zeros(3))
        return predict(model.scene, model.state, survey, parameters, model.leading).surface.sum()

    value, slope = jax.value_and_grad(height)(jnp.asarray(-0.5))
    assert np.isfinite(value)
    assert np.isfinite(slope)
    assert slope != 0


BARE = "[soil]\nunit_weight = 20e3\nyoung = 2e7\npoisson = 0.3\n"
SAND = "friction = 30.0\ncohesion = { mean = 4e3, cov = 0.1, length = [16.0, 3.0] }\n"
OF_BOTH_KINDS = {"tension_cutoff": 500.0, "softening_length": 2.5, "young": 3e7, "poisson": 0.25, "unit_weight": 19e3}
OF_SAND = {"dilation": 5.0, "softening_strain": 0.2, "residual_cohesion": 1e3, "residual_friction": 12.0}
NUMBERS = st.dictionaries(st.sampled_from(sorted(OF_BOTH_KINDS | OF_SAND)), st.floats(0.5, 0.9), max_size=5)


@given(NUMBERS, NUMBERS)
def test_a_layer_has_what_it_gives_and_else_what_the_soil_gives(shares, shares_of_layer):
    """Also where the soil of the whole scene has no strength, and so is of neither kind."""
    numbers = OF_BOTH_KINDS | OF_SAND
    whole, own = ({name: share * numbers[name] for name, share in each.items()} for each in (shares, shares_of_layer))
    whole = tomllib.loads(BARE)["soil"] | whole
    layers = [{"depth": 1.0, **tomllib.loads(SAND), **own}, {"friction": 30.0, "cohesion": 9e3}]
    scene = tomllib.loads(GROUND + TINY[TINY.index("[rough]") :])
    soil, below = (layer.layer.soil for layer in parse(to_toml(scene | {"soil": whole, "layer": layers})).site.layers)
    assert {name: getattr(soil, name) for name in whole | own} == whole | own
    assert {name: getattr(below, name) for name in whole} == whole


def test_what_is_wrong_in_the_soil_is_not_said_again_of_each_layer():
    with pytest.raises(
        ValueError, match=r"^\[layer 'clay'\] depth = -1 m: .*; \[soil\] poisson = 0.7: give"
    ) as refused:
        parse(OVER.replace("poisson = 0.3", "poisson = 0.7", 1).replace('name = "clay"', 'name = "clay"\ndepth = -1.0'))
    assert str(refused.value).count("poisson") == 1
