"""Correlated parameters, trends, strata, coefficients, the store and the figures."""

import jax
import jax.numpy as jnp
import matplotlib as mpl
import numpy as np
import pytest
from scipy import stats

import kl
from kl import plots

BOX = ((0.0, 0.0, 0.0), (20.0, 10.0, 6.0))


@pytest.fixture(scope="module")
def expansion():
    return kl.expand((kl.SquaredExponential(10.0), kl.Matern52(10.0), kl.Infinite()), *BOX)


def test_correlated_sets_keep_the_first_and_correlate_the_rest():
    matrix = [[1.0, -0.5, 0.2], [-0.5, 1.0, 0.1], [0.2, 0.1, 1.0]]
    independent = jax.random.normal(jax.random.key(0), (3, 200, 1000))
    mixed = kl.correlate(independent, matrix)
    np.testing.assert_array_equal(mixed[0], independent[0])
    np.testing.assert_allclose(np.corrcoef(mixed.reshape(3, -1)), matrix, atol=0.01)


def test_cohesion_and_friction_have_the_correlation_asked_for():
    marginals = (kl.Lognormal(3e3, 0.5), kl.Beta(20.0, 0.2, 5.0, 35.0))
    matrix = kl.soil.nataf_matrix([[1.0, -0.5], [-0.5, 1.0]], marginals)
    assert matrix[0, 1] < -0.5
    draws = kl.correlate(jax.random.normal(jax.random.key(1), (2, 200_000)), matrix)
    sample = np.corrcoef(*(marginal.transform(g) for marginal, g in zip(marginals, draws, strict=True)))[0, 1]
    assert sample == pytest.approx(-0.5, abs=0.01)


def test_trend_gives_each_depth_its_moments():
    depth = jnp.array([0.0, 5.0, 10.0])
    mean = kl.linear_with_depth(depth, 10e3, 2e3)
    gaussian = jax.random.normal(jax.random.key(2), (200_000, 3))
    for marginal in (kl.Lognormal(1.0, 0.3), kl.Gamma(50.0, 0.2)):
        values = kl.with_trend(marginal, gaussian, mean=mean, deviation=0.25 * mean)
        np.testing.assert_allclose(values.mean(axis=0), mean, rtol=5e-3)
        np.testing.assert_allclose(values.std(axis=0), 0.25 * mean, rtol=2e-2)


def test_strata_take_their_own_field():
    elevation = jnp.array([9.0, 6.0, 5.9, 1.0, -2.0])
    fields = tuple(jnp.full((2, 5), value) for value in (1.0, 2.0, 3.0))
    layered = kl.in_strata(elevation, (6.0, jnp.array([0.0, 0.0, 0.0, 2.0, 0.0])), fields)
    np.testing.assert_array_equal(layered, [[1, 1, 2, 3, 3]] * 2)


@pytest.mark.parametrize("design", [kl.monte_carlo, kl.latin_hypercube, kl.sobol])
def test_a_sample_does_not_depend_on_its_batch(design):
    key = jax.random.key(7)
    whole = design(key, 64, 9)
    assert whole.shape == (64, 9)
    np.testing.assert_array_equal(design(key, 64, 9, rows=[3, 60]), whole[jnp.array([3, 60])])
    assert not np.array_equal(design(jax.random.key(8), 64, 9), whole)


def test_latin_hypercube_fills_every_stratum_and_grows_in_modes():
    sample = kl.latin_hypercube(jax.random.key(0), 500, 20)
    strata = np.floor(stats.norm.cdf(np.asarray(sample, float)) * 500).astype(int)
    assert all(len(set(column)) >= 498 for column in strata.T)
    np.testing.assert_array_equal(kl.latin_hypercube(jax.random.key(0), 500, 5), sample[:, :5])
    # The sample mean of a sum of normals is far below the Monte Carlo error 1 / sqrt(500).
    assert float(jnp.abs(sample.mean(axis=0)).max()) < 0.005


def test_sobol_integrates_better_than_monte_carlo():
    def error(design):
        sample = design(jax.random.key(5), 1024, 6)
        return abs(float(jnp.mean(jnp.exp(sample.sum(axis=1) / 6))) - np.exp(1 / 12))

    assert error(kl.sobol) < 0.1 * 0.42 / np.sqrt(1024)


def test_figures_show_what_they_are_given(expansion, tmp_path):
    mpl.use("Agg")
    axes = (np.arange(0.5, 20), np.arange(0.5, 10), np.arange(0.5, 6))
    field = kl.field_on_lattice(expansion, jnp.ones(expansion.modes), axes)
    slices = plots.slices(field, axes, label="score")
    assert [panel.get_title() for panel in slices.axes[:3]] == ["y = 5.5 m", "x = 10.5 m", "z = 3.5 m"]
    lag = np.linspace(0, 5, 6)
    bands = plots.correlation((lag,), (np.exp(-lag),), (np.exp(-lag),), samples=100)
    assert bands.axes[0].get_xlabel() == "lag along x (m)"
    spectrum = plots.spectrum(expansion)
    assert len(spectrum.axes[0].lines) == 3
    for number, figure in enumerate((slices, bands, spectrum)):
        figure.savefig(tmp_path / f"{number}.png")
        assert (tmp_path / f"{number}.png").stat().st_size > 1000


@pytest.mark.parametrize(
    ("lags", "estimates", "targets", "names"), [(2, 1, 1, 3), (1, 2, 1, 3), (1, 1, 0, 3), (2, 2, 2, 1)]
)
def test_a_figure_of_correlations_has_one_of_each_an_axis(lags, estimates, targets, names):
    with pytest.raises(ValueError, match="lags, estimates and targets: one an axis"):
        plots.correlation(
            *(([0.0, 1.0],) * count for count in (lags, estimates, targets)), samples=9, names=("x", "y", "z")[:names]
        )
