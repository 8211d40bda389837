"""A draw depends on its seed and number alone, not on the precision of JAX."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import kl
from cooperative import runs
from cooperative.scene import parse
from tests.cooperative.campaign.test_campaign import TINY


def in_both_precisions(draw):
    drawn = []
    for precise in (False, True):
        with jax.enable_x64(precise):
            drawn.append(np.asarray(draw()))
    assert (drawn[0].dtype, drawn[1].dtype) == (np.float32, np.float64)
    return drawn


@pytest.mark.parametrize("design", [kl.monte_carlo, kl.latin_hypercube, kl.sobol])
@pytest.mark.parametrize("rows", [None, [3, 0, 6]])
def test_samples_are_the_same_in_both_precisions(design, rows):
    single, double = in_both_precisions(lambda: design(jax.random.key(5), 7, 9, rows=rows))
    np.testing.assert_array_equal(single, double)
    assert np.unique(single).size == single.size


def test_the_missing_variance_is_the_same_noise_in_both_precisions():
    single, double = in_both_precisions(
        lambda: kl.field.with_residual(jnp.zeros((4, 50)), jnp.full(50, 0.5), jax.random.key(2))
    )
    np.testing.assert_allclose(single, double, rtol=1e-6)


@pytest.mark.parametrize("coefficients", ["latin hypercube", "monte carlo", "sobol"])
def test_a_campaign_draws_the_same_samples_in_both_precisions(coefficients):
    def draw():
        campaign = parse(TINY + f'coefficients = "{coefficients}"\n')
        return runs.coefficients_of(campaign, runs.random_soil(campaign))

    single, double = in_both_precisions(draw)
    np.testing.assert_array_equal(single, double)
