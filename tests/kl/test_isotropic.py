"""Isotropic fields, variograms, means over cells, and GSTools' models."""

import math
from dataclasses import replace
from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import kl

FAMILIES = {0.5: kl.Exponential, 1.5: kl.Matern32, 2.5: kl.Matern52, math.inf: kl.SquaredExponential}


def directions(dimension, count=200):
    way = np.random.default_rng(dimension).normal(size=(dimension, count))
    return way / np.linalg.norm(way, axis=0)


@pytest.mark.parametrize("dimension", [1, 2, 3])
@pytest.mark.parametrize("smoothness", FAMILIES)
def test_the_correlation_is_that_of_the_distance_in_every_direction(smoothness, dimension):
    field = kl.field.isotropic(smoothness, (5.0,) * dimension, waves=4096)
    for distance in (0.5, 2.0, 5.0, 12.0):
        error = np.asarray(field.correlation(distance * directions(dimension))) - FAMILIES[smoothness](5.0)(distance)
        assert abs(error).max() < 0.03
        assert abs(error.mean()) < 0.01


def test_on_a_diagonal_a_product_correlates_less():
    lag = np.array([[1.0], [1.0]])
    product = float(kl.Exponential(5.0)(1.0)) ** 2
    isotropic = float(kl.field.isotropic(0.5, (5.0, 5.0), waves=8192).correlation(lag)[0])
    assert product == pytest.approx(math.exp(-0.4))
    assert isotropic == pytest.approx(math.exp(-math.sqrt(2) / 5), abs=0.01)


@given(st.floats(0.3, 4.0), st.integers(0, 100))
@settings(max_examples=20, deadline=None)
def test_terms_have_variance_one_everywhere(smoothness, seed):
    with jax.enable_x64(True):  # the shortest waves have many periods
        field = kl.field.isotropic(smoothness, (3.0, 30.0), waves=16, seed=seed)
        points = np.random.default_rng(seed).uniform(-50, 50, (2, 7))
        matrix = field.matrix(points)
        assert np.asarray((matrix**2).sum(axis=1)) == pytest.approx(1.0, abs=1e-9)
        lag = points[:, :1] - points
        assert np.asarray(matrix[0] @ matrix.T) == pytest.approx(np.asarray(field.correlation(lag)), abs=1e-6)


def test_samples_have_the_correlation_and_do_not_depend_on_the_other_points():
    field = kl.field.isotropic(1.5, (5.0, 5.0), waves=256)
    points = np.array([[0.0, 3.0, 30.0], [0.0, 4.0, -7.0]])
    xi = kl.monte_carlo(jax.random.key(2), 4000, field.modes)
    values = np.asarray(field.at(xi, points))
    assert np.corrcoef(values[:, 0], values[:, 1])[0, 1] == pytest.approx(float(kl.Matern32(5.0)(5.0)), abs=0.08)
    assert values.std() == pytest.approx(1.0, abs=0.02)
    assert np.asarray(field.at(xi[7], points[:, 1:2])) == pytest.approx(values[7, 1:2], abs=1e-5)


def test_a_field_is_differentiated_by_points_and_conditioned_on_data():
    field = kl.field.isotropic(2.5, (5.0, 5.0), waves=64)
    known = kl.field.condition_on(field.matrix([[1.0, 8.0], [2.0, 3.0]]), [1.5, -0.5])
    xi = kl.monte_carlo(jax.random.key(0), 5, field.modes)
    values = field.at(kl.conditioned(known, xi), [[1.0, 8.0], [2.0, 3.0]])
    assert np.asarray(values) == pytest.approx(np.tile([1.5, -0.5], (5, 1)), abs=1e-3)
    slope = jax.grad(lambda x: field.at(xi[0], jnp.stack([x, 2.0])[:, None])[0])(1.0)
    near = [float(field.at(xi[0], [[x], [2.0]])[0]) for x in (0.99, 1.01)]
    assert float(slope) == pytest.approx((near[1] - near[0]) / 0.02, rel=0.01)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: kl.field.isotropic(0.0, (5.0,)), "smoothness"),
        (lambda: kl.field.isotropic(0.5, (5.0, 0.0)), "length"),
        (lambda: kl.field.isotropic(0.5, (5.0,), waves=100), "waves = 100: give a power of 2"),
        (lambda: kl.field.isotropic(0.5, (5.0,)).matrix([[1.0], [2.0]]), r"give \(1, N\)"),
        (lambda: kl.field.isotropic(0.5, (5.0,), waves=4).at(np.zeros(7), [[1.0]]), r"give \(8,\)"),
    ],
)
def test_bad_input_of_waves_is_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def drawn(length=4.0, count=900, seed=3):
    """Points and values of an isotropic exponential field with a nugget."""
    field = kl.field.isotropic(0.5, (length, length), waves=4096)
    generator = np.random.default_rng(seed)
    points = generator.uniform(0, 60, (2, count))
    values = np.asarray(field.at(kl.monte_carlo(jax.random.key(seed), 1, field.modes)[0], points))
    return points, 10 + 3 * values + generator.normal(size=count)


def test_a_variogram_gives_back_length_sill_and_nugget():
    points, values = drawn()
    fit = kl.estimation.fit_variogram(kl.estimation.variogram(points, values, np.arange(0, 16, 1.0)), kl.Exponential)
    assert fit.covariance.length == pytest.approx(4.0, rel=0.35)
    assert fit.sill == pytest.approx(9.0, rel=0.35)
    assert fit.nugget < 3.0
    exact = kl.estimation.Variogram(np.arange(1.0, 12), np.zeros(11), np.full(11, 50.0))
    truth = kl.estimation.VariogramFit(kl.Matern32(3.0), 2.0, 0.25)
    again = kl.estimation.fit_variogram(replace(exact, value=truth(exact.lag)), kl.Matern32)
    assert (again.covariance.length, again.sill, again.nugget) == pytest.approx((3.0, 2.0, 0.25), rel=1e-3)


@given(st.integers(2, 30), st.floats(-5, 5), st.floats(0.1, 9))
@settings(max_examples=25, deadline=None)
def test_a_variogram_is_half_the_mean_square_of_differences(count, shift, scale):
    generator = np.random.default_rng(count)
    points, values = generator.uniform(0, 10, (2, count)), generator.normal(size=count)
    edges = np.array([0.0, 5.0, 20.0])
    found = kl.estimation.variogram(points, values, edges)
    classes = 0
    pairs = [(i, j) for i in range(count) for j in range(i)]
    for low, high in pairwise(edges):
        here = [p for p in pairs if low < np.linalg.norm(points[:, p[0]] - points[:, p[1]]) <= high]
        if here:
            known = np.mean([(values[i] - values[j]) ** 2 for i, j in here]) / 2
            assert (found.value[classes], found.pairs[classes]) == (pytest.approx(known), len(here))
            classes += 1
    moved = kl.estimation.variogram(points, shift + scale * values, edges)
    assert moved.value == pytest.approx(scale**2 * found.value)


def test_a_direction_takes_the_pairs_along_it_and_the_robust_estimator_bears_outliers():
    x = np.arange(40.0)
    points = np.concatenate([np.stack([x, 0 * x]), np.stack([0 * x, x + 0.5])], axis=1)
    values = np.r_[np.sin(x), np.zeros(40)]
    upright = kl.estimation.variogram(points, values, [0.0, 1.5], direction=(0, 1), angle=5)
    assert upright.value == pytest.approx([0.0])
    points, values = drawn(count=300)
    values[::50] += 40
    plain, robust = (
        kl.estimation.variogram(points, values, [0.0, 5.0], estimator=each).value[0] for each in ("matheron", "cressie")
    )
    assert robust < 0.5 * plain


def test_bad_input_of_variograms_is_refused():
    with pytest.raises(ValueError, match="no pair is"):
        kl.estimation.variogram([[0.0, 9.0]], [1.0, 2.0], [0.0, 1.0])
    with pytest.raises(ValueError, match="give two or more from 0 on"):
        kl.estimation.variogram([[0.0, 9.0]], [1.0, 2.0], [1.0, 0.0])
    with pytest.raises(ValueError, match="not finite"):
        kl.estimation.variogram([[0.0, 9.0]], [1.0, np.nan], [0.0, 10.0])
    with pytest.raises(ValueError, match="all values are equal"):
        kl.estimation.fit_variogram(
            kl.estimation.variogram([[0.0, 1.0, 3.0]], [1.0, 1.0, 1.0], [0, 1.5, 2.5, 4]), kl.Exponential
        )


@pytest.mark.parametrize("solver", [None, "haar"])
def test_means_over_cells_have_the_variance_of_vanmarcke(solver):
    covariance = kl.Exponential(5.0), kl.Exponential(2.0)
    solver, energy = (None, 0.999) if solver is None else ((kl.axis.Haar(8), kl.axis.Haar(8)), 0.98)
    field = kl.expand(covariance, (0.0, 0.0), (20.0, 8.0), energy=energy, solver=solver)
    means = kl.field.averaged(field, (4.0, 1.0))

    def reduction(ratio):
        return 2 * (ratio - 1 + math.exp(-ratio)) / ratio**2

    middle = kl.field.variance_at(means, [[10.0], [4.0]])
    assert float(middle[0]) == pytest.approx(reduction(4 / 5) * reduction(1 / 2), rel=0.02)


def test_means_over_cells_are_averages_of_the_same_sample():
    field = kl.expand((kl.SquaredExponential(5.0), kl.SquaredExponential(2.0)), (0.0, 0.0), (20.0, 8.0))
    xi = kl.monte_carlo(jax.random.key(4), 3, field.modes)
    x, z = np.meshgrid(6 + (np.arange(40) + 0.5) / 10, 3 + (np.arange(40) + 0.5) / 20, indexing="ij")
    known = np.asarray(kl.field_at(field, xi, np.stack([x.ravel(), z.ravel()]))).mean(axis=1)
    means = kl.field.averaged(field, (4.0, 2.0))
    assert np.asarray(kl.field_at(means, xi, [[8.0], [4.0]]))[:, 0] == pytest.approx(known, abs=1e-3)
    lattice = kl.field_on_lattice(means, xi, ([8.0, 12.0], [4.0]))
    assert np.asarray(lattice)[:, 0, 0] == pytest.approx(known, abs=1e-3)
    # Another length leaves the means what they are.
    again = kl.with_covariance(means, field.covariance)
    assert np.asarray(kl.field_at(again, xi, [[8.0], [4.0]]))[:, 0] == pytest.approx(known, abs=1e-3)
    # At an end the part inside counts; without a size nothing is averaged.
    assert np.isfinite(np.asarray(kl.field_at(means, xi, [[0.0, 20.0], [8.0, 0.0]]))).all()
    same = kl.field.averaged(field, (0.0, 0.0))
    assert np.asarray(kl.field_at(same, xi, [[8.0], [4.0]])) == pytest.approx(
        np.asarray(kl.field_at(field, xi, [[8.0], [4.0]]))
    )


@pytest.mark.parametrize(("size", "message"), [((1.0,), "give 2 edges"), ((-1.0, 1.0), "0 m or more")])
def test_bad_sizes_of_cells_are_refused(size, message):
    field = kl.expand((kl.SquaredExponential(5.0),) * 2, (0.0, 0.0), (20.0, 8.0))
    with pytest.raises(ValueError, match=message):
        kl.field.averaged(field, size)
    with pytest.raises(ValueError, match="average the field"):
        kl.field.averaged(kl.field.averaged(field, (1.0, 1.0)), (1.0, 1.0))


def test_modules_of_figures_and_gstools_are_there_when_named():
    assert kl.plots.__name__ == "kl.plots"
    assert "gstools" in dir(kl)
    with pytest.raises(AttributeError, match="no attribute 'figures'"):
        _ = kl.figures


def test_models_of_gstools_are_converted_and_back():
    gstools = pytest.importorskip("gstools")
    lag = np.array([0.5, 2.0, 7.0])
    models = [
        gstools.Gaussian(dim=2, var=2.0, len_scale=[5, 2], nugget=0.1),
        gstools.Exponential(dim=3, len_scale=[5, 4, 2]),
        *(gstools.Matern(dim=2, len_scale=[5, 2], nu=nu) for nu in (0.5, 1.5, 2.5, 30)),
    ]
    for model in models:
        covariance, variance, nugget = kl.gstools.from_gstools(model)
        assert (variance, nugget) == (model.var, model.nugget)
        back = kl.gstools.to_gstools(covariance, variance=variance, nugget=nugget)
        waves, *_ = kl.gstools.waves_of(model, waves=4096)
        for axis, each in enumerate(covariance):
            assert each(lag) == pytest.approx(model.cor_axis(lag, axis=axis), rel=1e-5)
            assert back.cor_axis(lag, axis=axis) == pytest.approx(model.cor_axis(lag, axis=axis), rel=1e-5)
            along = np.zeros((model.dim, 3))
            along[axis] = lag
            assert np.asarray(waves.correlation(along)) == pytest.approx(model.cor_axis(lag, axis=axis), abs=0.04)
    with pytest.raises(ValueError, match=r"nu = 1\.2"):
        kl.gstools.from_gstools(gstools.Matern(dim=2, nu=1.2))
    with pytest.raises(ValueError, match="turned model"):
        kl.gstools.lengths_of(gstools.Gaussian(dim=2, angles=0.5))
    with pytest.raises(ValueError, match="kind Spherical"):
        kl.gstools.lengths_of(gstools.Spherical(dim=2))
    with pytest.raises(ValueError, match="several families"):
        kl.gstools.to_gstools((kl.Exponential(1.0), kl.Matern32(1.0)))


def test_means_of_waves_over_cells_are_averages_of_the_same_sample():
    field = kl.field.isotropic(1.5, (5.0, 2.0), waves=64)
    xi = kl.monte_carlo(jax.random.key(4), 3, field.modes)
    x, z = np.meshgrid(6 + (np.arange(80) + 0.5) / 20, 3 + (np.arange(80) + 0.5) / 40, indexing="ij")
    known = np.asarray(kl.field_at(field, xi, np.stack([x.ravel(), z.ravel()]))).mean(axis=1)
    means = kl.field.averaged(field, (4.0, 2.0))
    assert np.asarray(kl.field_at(means, xi, [[8.0], [4.0]]))[:, 0] == pytest.approx(known, abs=2e-3)
    variance = np.asarray(kl.field.mode_matrix(means, [[8.0], [4.0]]) ** 2).sum()
    assert float(means.fractions.sum()) == pytest.approx(variance, rel=1e-4)
    first, second = np.random.default_rng(0).uniform(-0.5, 0.5, (2, 2, 20_000)) * np.array([[4.0], [2.0]])
    assert variance == pytest.approx(float(field.correlation(first - second).mean()), abs=0.01)
    with pytest.raises(ValueError, match="average the field"):
        kl.field.averaged(means, (1.0, 1.0))


@given(st.floats(0, 90), st.floats(0, 360))
@settings(max_examples=15, deadline=None)
def test_in_inclined_strata_the_lengths_are_along_and_across_them(dip, strike):
    level = kl.field.isotropic(1.5, (9.0, 5.0, 1.0), waves=64)
    inclined = kl.field.isotropic(1.5, (9.0, 5.0, 1.0), waves=64, bedding=kl.Bedding(dip, strike))
    lag = np.random.default_rng(1).normal(size=(3, 7))
    along = kl.field.rotate(kl.Bedding(dip, strike), jnp.asarray(lag))
    assert np.asarray(inclined.correlation(lag)) == pytest.approx(np.asarray(level.correlation(along)), abs=1e-3)
