"""Fields of the elliptic distance and means over cells in a scene, and the words of GSTools."""

import math

import jax.numpy as jnp
import numpy as np
import pytest

import cooperative
import kl
from benchmarks.robustness.invented import TINY
from cooperative import runs
from cooperative.folder import read_results
from cooperative.scene import campaign_of, parse, read_scene

ELLIPTIC = TINY.replace("length = [20.0, 4.0]", "length = [20.0, 4.0]\ncorrelation = 'exponential'\nform = 'elliptic'")
AVERAGED = ELLIPTIC.replace("'elliptic'", "'elliptic'\nsampled_at = 'cell averages'")


def model_of(scene, grid="rough"):
    campaign = parse(scene)
    model = runs.build(campaign, grid, runs.random_soil(campaign), at_rest=False)
    return model, runs.coefficients_of(campaign, model.soil)


def correlation(model, lag):
    (group,) = model.soil.groups
    one, two = np.asarray(kl.field.mode_matrix(group.expansion, np.array([[9.0, 9.0 + lag[0]], [5.0, 5.0 + lag[1]]])))
    return float(one @ two)


def test_the_elliptic_form_correlates_by_the_distance_and_the_product_by_the_axes():
    elliptic, _ = model_of(ELLIPTIC)
    product, _ = model_of(ELLIPTIC.replace("'elliptic'", "'product'"))
    for model, expected in ((elliptic, math.exp(-math.sqrt(2) / 4)), (product, math.exp(-2 / 4))):
        assert correlation(model, (5.0, 1.0)) == pytest.approx(expected, abs=0.02)
    smooth, _ = model_of(ELLIPTIC.replace("'exponential'", "'matern 5/2'"))
    assert correlation(smooth, (5.0, 1.0)) == pytest.approx(float(kl.Matern52(4.0)(np.sqrt(2.0))), abs=0.02)


def test_lengths_of_the_elliptic_form_follow_the_strata_and_measured_values_are_met():
    inclined = ELLIPTIC.replace("'elliptic'", "'elliptic'\nbedding = { dip = 30.0 }\nboreholes = [[9.0, 5.0, 55e3]]")
    model, coefficients = model_of(inclined)
    down = 4 * np.array([math.cos(math.radians(30)), -math.sin(math.radians(30))])
    assert correlation(model, down) == pytest.approx(math.exp(-4 / 20), abs=0.02)
    (group,) = model.soil.groups
    at = jnp.asarray([[9.0], [5.0]])
    for sample in coefficients:
        gaussian = kl.field_at(group.expansion, model.soil.coefficients(sample)["strength"], at)
        assert float(kl.Lognormal(30e3, 0.4).transform(gaussian)[0]) == pytest.approx(55e3, rel=1e-3)


@pytest.mark.parametrize("form", ["elliptic", "product"])
def test_averages_are_means_of_the_same_sample_over_the_cells_of_each_grid(form):
    for grid in ("rough", "refined"):
        model, coefficients = model_of(
            AVERAGED.replace("'elliptic'", f"'{form}'").replace("'exponential'", "'matern 5/2'"), grid
        )
        (group,), cell = model.soil.groups, model.scene.grid.cell
        values = np.asarray(model.strength(coefficients[0]))
        middle = np.asarray(model.scene.particles.position)[:, 40]
        corner = cell * np.floor(middle / cell)
        inside = (np.stack(np.meshgrid(*[(np.arange(24) + 0.5) / 24] * 2)).reshape(2, -1) * cell) + corner[:, None]
        gaussian = kl.field_at(group.expansion, coefficients[0], inside)
        assert values[40] == pytest.approx(float(kl.Lognormal(30e3, 0.4).transform(gaussian.mean())), rel=4e-3)
        here = (cell * np.floor(np.asarray(model.scene.particles.position) / cell) == corner[:, None]).all(axis=0)
        assert here.sum() == 4
        assert np.ptp(values[here]) < 1e-4 * values[40]


def test_a_campaign_of_them_runs_and_is_the_same_from_its_folder(tmp_path):
    scene = tmp_path / "scene.toml"
    scene.write_text(AVERAGED.replace("t_end = 4.0", "t_end = 0.3").replace("samples = 6", "samples = 2"))
    cooperative.run(read_scene(scene), tmp_path / "out")
    field = campaign_of(read_results(tmp_path / "out").store).random["strength"]
    assert field == parse(AVERAGED).random["strength"]
    assert (field.form, field.sampled_at, field.correlation) == ("elliptic", "cell averages", kl.Exponential)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "'exponential'",
            "'triangular'",
            r"\[strength\] form = 'elliptic' has no form of the distance for correlation =",
        ),
        ("'elliptic'", "'elliptic'\nnataf = true", "nataf is of a product, and form = 'elliptic'"),
        ("'elliptic'", "'elliptic'\nenergy = 0.9", "energy is of a product, and form = 'elliptic'"),
        ("'elliptic'", "'round'", "form = 'round': give one of 'product', 'elliptic'"),
        ("'exponential'", "'Gaussian'", "correlation = 'Gaussian': give one of .*did you mean 'squared exponential'"),
        ("'exponential'", "'Exponential'", "did you mean 'exponential'"),
        ("'exponential'", "'Matern'", "did you mean 'matern 3/2'"),
        (
            "length =",
            "len_scale =",
            r"unknown key 'len_scale' \(did you mean length \(1.13 times it of a Gaussian model",
        ),
        ("cov =", "var =", r"unknown key 'var' \(did you mean cov \(the root of it over the mean"),
        ("cov =", "nu = 1.5\ncov =", r"unknown key 'nu' \(did you mean correlation \('matern 3/2' of 1.5"),
        ("cov =", "anis = 0.2\ncov =", r"'anis' \(did you mean length \(the first length times each ratio"),
        ("cov =", "angles = 0.2\ncov =", r"'angles' \(did you mean bedding \(dip is minus the angle"),
    ],
)
def test_what_the_form_has_not_and_the_words_of_gstools_are_named(old, new, message):
    with pytest.raises(ValueError, match=message):
        parse(ELLIPTIC.replace(old, new))
