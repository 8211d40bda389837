"""Back-analysis and design points on a small slope: what made a slide is recovered, as far as the data determine it."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cooperative import runs
from cooperative.scene import parse
from cooperative.tools.research.back_analysis import Observed, Parameters, Survey, predict, recover
from cooperative.tools.research.rare import design_point, slide_limit_state
from tests.cooperative.campaign.test_campaign import TINY, changed
from tests.scenes import model_of

SURVEY = Survey(seconds=1.5, times=5, markers=np.array([40, 90, 140]), stations=np.arange(4.0, 30.0, 3.0))
NOISE = 0.01


@pytest.fixture(scope="module")
def model():
    campaign = parse(TINY)
    return runs.build(campaign, "rough", runs.random_soil(campaign))


def noisy(model, truth, seed=0):
    clean = jax.jit(partial(predict, model, SURVEY))(truth)
    rng = np.random.default_rng(seed)
    return jax.tree.map(lambda a: a + NOISE * rng.standard_normal(a.shape).astype(np.float32), clean)


@pytest.mark.slow
def test_strength_and_field_behind_a_slide_are_recovered(model):
    truth = Parameters(jnp.float32(-0.5), jnp.float32(0.1), jnp.asarray([0.5, -0.4], jnp.float32))
    observed = noisy(model, truth)
    result = recover(model, SURVEY, observed, NOISE, modes=2, iterations=25)
    assert result.losses[-1] < 1e-2 * result.losses[0]
    # Readings are explained to their noise, and parameters lie where the posterior says.
    readings = sum(leaf.size for leaf in jax.tree.leaves(observed))
    assert min(result.losses) < 0.5 * readings * 1.6
    for got, true, spread in zip(*map(jax.tree.leaves, (result.parameters, truth, result.deviation)), strict=True):
        assert np.all(np.abs(np.asarray(got - true)) < 4 * np.asarray(spread) + 0.02)
    # The data tell more than was known before, most of all of the mean strength.
    assert float(result.deviation.strength) < 0.5 * result.prior.strength


@pytest.mark.slow
def test_a_slope_that_stands_tells_little_of_its_softening(model):
    truth = Parameters(jnp.float32(0.5), jnp.float32(0.0), jnp.zeros(1, jnp.float32))
    result = recover(model, SURVEY, noisy(model, truth), NOISE, modes=1, iterations=3)
    assert float(result.deviation.softening) > 0.9 * result.prior.softening


def test_column_height_is_the_surface_before_it_moves(model):
    truth = Parameters(jnp.float32(0.5), jnp.float32(0.0), jnp.zeros(1, jnp.float32))
    flat = predict(model, Survey(0.1, 1, np.array([0]), np.array([4.0, 26.0]), width=2.0), truth).surface
    np.testing.assert_allclose(flat, [10.0, 2.0], atol=0.05)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"noise": 0.0}, "noise = 0.0 m"),
        ({"modes": 10_000}, "modes = 10000"),
        ({"survey": Survey(1.0, 2, np.array([10**6]), np.array([4.0]))}, "markers = \\[1000000\\]"),
    ],
)
def test_bad_surveys_are_refused(model, change, message):
    given = {"survey": SURVEY, "noise": NOISE, "modes": 1} | change
    with pytest.raises(ValueError, match=message):
        recover(
            model, given["survey"], Observed(jnp.zeros(1), jnp.zeros((2, 2, 1))), given["noise"], modes=given["modes"]
        )


def test_a_soil_without_a_modulus_of_softening_is_refused():
    model = model_of(changed("softening_modulus = 85e3", "strain_95 = 0.5"), at_rest=True)
    observed = Observed(jnp.zeros(len(SURVEY.stations)), jnp.zeros((SURVEY.times, 2, len(SURVEY.markers))))
    with pytest.raises(ValueError, match=r"\(strain_95\).*give the soil a softening_modulus"):
        recover(model, SURVEY, observed, NOISE, modes=1)


@pytest.mark.slow
def test_the_design_point_of_a_slope_fails_by_the_campaigns_own_count(model):
    # With half as much strength again the median field stands, and a failing one is some deviations away.
    stronger = runs.GridModel(**{**vars(model), "strength_factor": 1.5})
    result = design_point(slide_limit_state(stronger, seconds=1.5, displacement=0.3), model.soil.modes)
    assert result.converged
    assert 0.5 < result.beta < 6
    point = np.asarray(result.coefficients, np.float32)[None]
    (sample,) = runs.run_samples(stronger, 1.1 * point, [0])
    (median,) = runs.run_samples(stronger, 0 * point, [0])
    assert sample.row["displacement"] > 0.3 > 5 * median.row["displacement"]
