"""Marginals against SciPy's distributions in both tails, Nataf's correction, and their derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats
from scipy.optimize import brentq
from scipy.special import gamma as gamma_function

import kl

SCORES = np.linspace(-6, 6, 49)


def by_scipy(distribution, scores=SCORES):
    below = distribution.ppf(stats.norm.cdf(scores))
    above = distribution.isf(stats.norm.sf(scores))
    return np.where(scores < 0, below, above)


def weibull(mean, cov):
    power = brentq(lambda k: gamma_function(1 + 2 / k) / gamma_function(1 + 1 / k) ** 2 - 1 - cov**2, 0.3, 80)
    return stats.weibull_min(power, scale=mean / gamma_function(1 + 1 / power))


def gumbel(mean, cov):
    scale = np.sqrt(6) / np.pi * mean * cov
    return stats.gumbel_r(mean - np.euler_gamma * scale, scale)


def beta(mean, cov, lower, upper):
    share, variance = (mean - lower) / (upper - lower), (mean * cov / (upper - lower)) ** 2
    total = share * (1 - share) / variance - 1
    return stats.beta(share * total, (1 - share) * total, lower, upper - lower)


def lognormal(mean, cov):
    deviation = np.sqrt(np.log1p(cov**2))
    return stats.lognorm(deviation, scale=mean * np.exp(-(deviation**2) / 2))


CASES = [
    (kl.Normal(10.0, 0.3), stats.norm(10, 3)),
    (kl.Lognormal(10.0, 0.3), lognormal(10, 0.3)),
    (kl.Lognormal(10.0, 1.5), lognormal(10, 1.5)),
    (kl.Uniform(10.0, 0.3), stats.uniform(10 - 3 * np.sqrt(3), 6 * np.sqrt(3))),
    (kl.Gumbel(10.0, 0.3), gumbel(10, 0.3)),
    (kl.Gamma(10.0, 0.05), stats.gamma(400, scale=0.025)),
    (kl.Gamma(10.0, 0.3), stats.gamma(1 / 0.09, scale=0.9)),
    (kl.Gamma(10.0, 1.2), stats.gamma(1 / 1.44, scale=14.4)),
    (kl.Gamma(10.0, 0.3, lower=4.0), stats.gamma(4, 4, 1.5)),
    (kl.Weibull(10.0, 0.05), weibull(10, 0.05)),
    (kl.Weibull(10.0, 0.3), weibull(10, 0.3)),
    (kl.Weibull(10.0, 1.2), weibull(10, 1.2)),
    (kl.Beta(10.0, 0.3, 0.0, 30.0), beta(10, 0.3, 0, 30)),
    (kl.Beta(10.0, 0.1, 7.0, 12.0), beta(10, 0.1, 7, 12)),
    (kl.Beta(10.0, 0.6, 0.0, 30.0), beta(10, 0.6, 0, 30)),
]


@pytest.mark.parametrize(("marginal", "distribution"), CASES)
def test_quantiles_in_both_tails_in_float32(marginal, distribution):
    values = marginal.transform(jnp.asarray(SCORES, jnp.float32))
    assert values.dtype == jnp.float32
    np.testing.assert_allclose(values, by_scipy(distribution), rtol=2e-5, atol=1e-6)
    middle = jnp.linspace(-3.5, 3.5, 29)
    np.testing.assert_allclose(marginal.standardise(marginal.transform(middle)), middle, atol=2e-3)
    assert distribution.mean() == pytest.approx(float(marginal.mean))
    assert distribution.std() / distribution.mean() == pytest.approx(float(marginal.cov))


@pytest.mark.parametrize(("marginal", "distribution"), CASES)
def test_quantiles_in_float64(x64, marginal, distribution):
    values = marginal.transform(jnp.asarray(SCORES))
    np.testing.assert_allclose(values, by_scipy(distribution), rtol=1e-7)


@pytest.mark.parametrize(
    ("mean", "cov", "lower", "upper"),
    [(10.0, 0.3, 0.0, None), (10.0, 0.7, 0.0, None), (10.0, 0.3, None, 16.0), (10.0, 0.2, 5.0, 14.0)],
)
def test_truncated_normal_keeps_its_moments_and_bounds(x64, mean, cov, lower, upper):
    marginal = kl.TruncatedNormal(mean, cov, lower, upper)
    points, weights = np.polynomial.legendre.leggauss(200)
    probability = (points + 1) / 2
    values = marginal.transform(jnp.asarray(stats.norm.ppf(probability)))
    moments = [float((weights / 2) @ values**k) for k in (1, 2)]
    assert moments[0] == pytest.approx(mean, rel=2e-5)
    assert np.sqrt(moments[1] - moments[0] ** 2) / mean == pytest.approx(cov, rel=5e-4)
    extreme = marginal.transform(jnp.array([-9.0, 9.0]))
    assert lower is None or extreme[0] >= lower
    assert upper is None or extreme[1] <= upper
    scores = jnp.linspace(-3, 3, 13)
    np.testing.assert_allclose(marginal.standardise(marginal.transform(scores)), scores, atol=1e-8)


@pytest.mark.parametrize("power", [0.5, 2.0])
def test_four_parameter_gamma_keeps_its_moments(x64, power):
    for marginal in (kl.Gamma(10.0, 0.3, lower=3.0, power=power), kl.Weibull(10.0, 0.3, lower=3.0, shape=power)):
        points, weights = np.polynomial.hermite_e.hermegauss(120)
        values = marginal.transform(jnp.asarray(points))
        weights = weights / weights.sum()
        mean = float(weights @ values)
        assert mean == pytest.approx(10, rel=1e-5)
        assert np.sqrt(weights @ (values - mean) ** 2) / mean == pytest.approx(0.3, rel=1e-4)
        assert float(values.min()) >= 3


@settings(max_examples=12, deadline=None)
@given(st.floats(0.05, 1.0), st.sampled_from(["Lognormal", "Gamma", "Weibull", "Gumbel"]))
def test_transforms_rise_and_stay_finite(cov, family):
    values = getattr(kl, family)(4e4, cov).transform(jnp.linspace(-9.5, 9.5, 200))
    assert jnp.isfinite(values).all()
    assert (jnp.diff(values) >= 0).all()


@pytest.mark.parametrize(
    "make",
    [
        kl.Lognormal,
        pytest.param(kl.Gamma, marks=pytest.mark.slow),
        pytest.param(kl.Weibull, marks=pytest.mark.slow),
        pytest.param(lambda m, c: kl.Beta(m, c, 0.0, 30.0), id="Beta", marks=pytest.mark.slow),
        pytest.param(kl.TruncatedNormal, marks=pytest.mark.slow),
    ],
)
def test_derivatives_by_mean_and_cov(x64, make):
    scores = jnp.linspace(-4, 4, 9)

    def value(mean, cov):
        return (make(mean, cov).transform(scores) * jnp.arange(1.0, 10.0)).sum()

    step = 1e-5
    means, covs = 10 + step * jnp.array([0, 1, -1, 0, 0]), 0.3 + step * jnp.array([0, 0, 0, 1, -1])
    values, (by_mean, by_cov) = jax.jit(jax.vmap(jax.value_and_grad(value, (0, 1))))(means, covs)
    np.testing.assert_allclose(by_mean[0], (values[1] - values[2]) / (2 * step), rtol=1e-5)
    np.testing.assert_allclose(by_cov[0], (values[3] - values[4]) / (2 * step), rtol=1e-5)
    with jax.enable_x64(False):
        narrow = jax.jit(jax.grad(lambda cov: make(10.0, cov).transform(jnp.linspace(-6, 6, 9)).sum()))(0.3)
        assert jnp.isfinite(narrow)


def test_lognormal_of_no_variation_is_the_mean_and_has_derivatives():
    assert float(kl.Lognormal(5.0, 0.0).transform(jnp.array(2.0))) == 5
    assert jnp.isfinite(jax.grad(lambda cov: kl.Lognormal(5.0, cov).transform(jnp.array(2.0)))(0.0))


def test_marginals_are_equal_where_all_their_numbers_are():
    assert kl.Beta(10.0, 0.3, 0.0, 30.0) == kl.Beta(10.0, 0.3, 0.0, 30.0)
    for other in ((11.0, 0.3, 0.0, 30.0), (10.0, 0.4, 0.0, 30.0), (10.0, 0.3, 1.0, 30.0), (10.0, 0.3, 0.0, 31.0)):
        assert kl.Beta(10.0, 0.3, 0.0, 30.0) != kl.Beta(*other)
    assert kl.Empirical(jnp.arange(3.0)) == kl.Empirical(jnp.arange(3.0)) != kl.Empirical(jnp.arange(1.0, 4.0))
    bent = ((0.0, 1.0), (1.0, 3.0))
    assert kl.Empirical(bent) == kl.Empirical(bent) != kl.Empirical((bent[0], (1.0, 4.0)))


def test_empirical_marginal_reproduces_its_data():
    data = jnp.asarray(np.random.default_rng(0).lognormal(size=200), jnp.float32)
    marginal = kl.Empirical(data)
    probability = (np.arange(200) + 0.5) / 200
    np.testing.assert_allclose(marginal.transform(jnp.asarray(stats.norm.ppf(probability))), np.sort(data), rtol=1e-4)
    assert float(marginal.transform(jnp.array(9.0))) == pytest.approx(float(data.max()))
    scores = jnp.linspace(-2.5, 2.5, 11)
    np.testing.assert_allclose(marginal.standardise(marginal.transform(scores)), scores, atol=1e-3)


def test_trend_of_the_mean_as_an_array():
    mean = jnp.array([1e4, 2e4, 4e4])
    for family in (kl.Lognormal, kl.Gamma, kl.Weibull, kl.Normal):
        values = family(mean, 0.3).transform(jnp.zeros(3))
        np.testing.assert_allclose(values / mean, values[0] / mean[0], rtol=1e-5)


def test_nataf_of_the_lognormal_in_closed_form(x64):
    for cov, error in ((0.3, 0.011), (0.5, 0.028), (1.0, 0.086)):
        marginal = kl.Lognormal(1.0, cov)
        variance = np.log1p(cov**2)
        target = jnp.linspace(-0.3, 1.0, 14)
        exact = jnp.log1p(target * (np.exp(variance) - 1)) / variance
        np.testing.assert_allclose(kl.marginal.nataf_correlation(marginal, marginal, target), exact, atol=2e-6)
        found = kl.marginal.nataf_error(marginal, axes=2)
        assert found.uncorrected == pytest.approx(error, abs=6e-4)
        # Along an axis the correction is exact; across two the product of corrected correlations is another.
        assert kl.marginal.nataf_error(marginal, axes=1).corrected == pytest.approx(0, abs=1e-5)
        both = np.linspace(0, 1, 201)
        gaussian = np.log1p(both * (np.exp(variance) - 1)) / variance
        product = np.expm1(variance * np.outer(gaussian, gaussian)) / np.expm1(variance)
        assert found.corrected == pytest.approx(np.abs(product - np.outer(both, both)).max(), rel=0.03, abs=1e-5)


def test_nataf_between_two_families_by_simulation():
    first, second = kl.Lognormal(3.0, 0.6), kl.Gumbel(20.0, 0.3)
    gaussian = float(kl.marginal.nataf_correlation(first, second, -0.4))
    draws = jax.random.normal(jax.random.key(0), (2, 400_000))
    other = gaussian * draws[0] + np.sqrt(1 - gaussian**2) * draws[1]
    sample = np.corrcoef(first.transform(draws[0]), second.transform(other))[0, 1]
    assert sample == pytest.approx(-0.4, abs=0.006)


def test_field_with_nataf_correction_has_the_correlation_asked_for(x64):
    marginal = kl.Lognormal(1.0, 0.8)
    target = kl.SquaredExponential(4.0)
    with pytest.warns(UserWarning, match="not quite positive definite"):
        corrected = kl.expand((kl.marginal.nataf_corrected(target, marginal),), (0.0,), (12.0,), energy=0.99999)
    plain = kl.expand((target,), (0.0,), (12.0,), energy=0.99999)
    points = jnp.linspace(1.0, 11.0, 9)[None]
    lag = points[0][:, None] - points[0]
    powers = kl.marginal.hermite_coefficients(marginal) ** 2

    def property_correlation(expansion):
        modes = kl.field.mode_matrix(expansion, points)
        gaussian = modes @ modes.T
        return sum(power * gaussian ** (k + 1) for k, power in enumerate(powers))

    assert float(jnp.abs(property_correlation(corrected) - target(lag)).max()) < 3e-3
    assert float(jnp.abs(property_correlation(plain) - target(lag)).max()) > 0.03


def test_truncated_normal_has_its_slope_in_the_middle_too(x64):
    transform = kl.TruncatedNormal(10.0, 0.3).transform
    at, beside = jax.vmap(jax.grad(transform))(jnp.array([0.0, 1e-7]))
    assert float(at) == pytest.approx(float(beside), rel=1e-6)
