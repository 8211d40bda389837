"""Fields conditioned on boreholes against kriging with the exact covariance."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import kl

COVARIANCE = (kl.Matern52(20.0), kl.SquaredExponential(4.0))
BOX = ((0.0, 0.0), (40.0, 12.0))


def boreholes(count, seed=0):
    x = np.linspace(2, 38, count)
    z = np.linspace(0.5, 11.5, 6)
    points = np.stack(np.meshgrid(x, z, indexing="ij")).reshape(2, -1)
    values = np.random.default_rng(seed).normal(size=points.shape[1])
    return jnp.asarray(points), values


def exact_correlation(first, second):
    lags = first[:, :, None] - second[:, None, :]
    return np.asarray(COVARIANCE[0](lags[0]) * COVARIANCE[1](lags[1]))


@pytest.mark.parametrize("error", [0.0, 0.3])
def test_mean_and_variance_are_those_of_simple_kriging(x64, error):
    expansion = kl.expand(COVARIANCE, *BOX, energy=0.999999)
    points, values = boreholes(3)
    conditioning = kl.condition(expansion, points, values, error=error)
    at = jnp.asarray(np.random.default_rng(1).uniform((0, 0), (40, 12), (50, 2)).T)
    kernel = exact_correlation(points, points) + error**2 * np.eye(len(values))
    weights = np.linalg.solve(kernel, exact_correlation(points, at))
    np.testing.assert_allclose(kl.field_at(expansion, conditioning.mean, at), weights.T @ values, atol=5e-3)
    variance = 1 - (weights * exact_correlation(points, at)).sum(axis=0)
    np.testing.assert_allclose(kl.field.kriging_variance(conditioning, expansion, at), variance, atol=3e-3)


def test_every_sample_honours_exact_data(x64):
    expansion = kl.expand(COVARIANCE, *BOX, energy=0.9999)
    points, values = boreholes(4)
    conditioning = kl.condition(expansion, points, values)
    coefficients = kl.conditioned(conditioning, kl.monte_carlo(jax.random.key(0), 50, expansion.modes))
    fields = kl.field_at(expansion, coefficients, points)
    np.testing.assert_allclose(fields, np.broadcast_to(values, fields.shape), atol=1e-6)
    np.testing.assert_allclose(kl.field.kriging_variance(conditioning, expansion, points), 0, atol=1e-6)


def test_conditioned_coefficients_have_the_posterior_covariance(x64):
    expansion = kl.expand(COVARIANCE, *BOX, energy=0.99)
    points, values = boreholes(2)
    noise = np.where(np.arange(len(values)) % 2 == 0, 0.0, 0.5)
    conditioning = kl.condition(expansion, points, values, error=noise)
    modes = np.asarray(kl.field.mode_matrix(expansion, points))
    gain = modes.T @ np.linalg.inv(modes @ modes.T + np.diag(noise**2))
    root = kl.conditioned(conditioning, jnp.eye(expansion.modes)) - conditioning.mean
    np.testing.assert_allclose(root.T @ root, np.eye(expansion.modes) - gain @ modes, atol=1e-9)


def test_measured_strength_comes_back_through_the_marginal():
    marginal = kl.Gamma(42e3, 0.3)
    expansion = kl.expand(COVARIANCE, *BOX)
    points = jnp.array([[5.0, 20.0, 33.0], [2.0, 6.0, 10.0]])
    measured = jnp.array([30e3, 55e3, 41e3])
    conditioning = kl.condition(expansion, points, marginal.standardise(measured))
    coefficients = kl.conditioned(conditioning, kl.monte_carlo(jax.random.key(3), 5, expansion.modes))
    strength = marginal.transform(kl.field_at(expansion, coefficients, points))
    np.testing.assert_allclose(strength, np.broadcast_to(measured, (5, 3)), rtol=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize(("precision", "modes", "error"), [(False, 1500, 0.1), (True, 5000, 0.0)])
def test_a_thousand_data(precision, modes, error):
    with jax.enable_x64(precision):
        real = jnp.result_type(float)
        covariance = (kl.SquaredExponential(8.0), kl.SquaredExponential(8.0), kl.SquaredExponential(0.8))
        expansion = kl.expand(covariance, (0.0, 0.0, 0.0), (48.0, 48.0, 12.0), modes=modes)
        x, y = (each.ravel() for each in np.meshgrid(np.linspace(2, 46, 8), np.linspace(2, 46, 5), indexing="ij"))
        depths = np.linspace(0.5, 11.5, 25)
        points = jnp.asarray(np.stack([np.repeat(x, 25), np.repeat(y, 25), np.tile(depths, 40)]), real)
        truth = kl.field_at(expansion, kl.monte_carlo(jax.random.key(9), 1, expansion.modes)[0], points)
        values = np.asarray(truth, float) + error * np.random.default_rng(0).normal(size=1000)
        conditioning = kl.condition(expansion, points, values, error=error)
        coefficients = kl.conditioned(conditioning, kl.monte_carlo(jax.random.key(0), 3, expansion.modes))
        misfit = kl.field_at(expansion, coefficients, points) - values
        # With an error, the misfit is at most the error of the data and that of the field about them.
        assert float(jnp.abs(misfit).max()) < (6 * error if error else 1e-6)
        variance = kl.field.kriging_variance(conditioning, expansion, points)
        assert float(variance.max()) < 1.1 * error**2 + 1e-6


@pytest.mark.parametrize("count", [5, 60])
def test_many_data_in_single_precision_give_the_kriged_coefficients(count):
    """The kernel of the data has a rank below their number."""
    expansion = kl.expand(COVARIANCE, *BOX, energy=0.93)
    points, values = boreholes(count)
    assert len(values) > expansion.modes
    noise = np.linspace(0.1, 0.4, len(values))
    conditioning = kl.condition(expansion, jnp.asarray(points, jnp.float32), values, error=noise)
    modes = np.asarray(kl.field.mode_matrix(expansion, jnp.asarray(points, jnp.float32)), float)
    gain = np.linalg.solve(modes @ modes.T + np.diag(noise**2), modes).T
    np.testing.assert_allclose(conditioning.mean, gain @ values, atol=2e-4)
    np.testing.assert_allclose(conditioning.gain, gain, atol=2e-4)
    root = kl.conditioned(conditioning, jnp.eye(expansion.modes)) - conditioning.mean
    np.testing.assert_allclose(root.T @ root, np.eye(expansion.modes) - gain @ modes, atol=1e-4)
