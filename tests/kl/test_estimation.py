"""Estimation of fields from values at points: against closed forms, dense algebra and known truth."""

import numpy as np
import pytest
from scipy import stats

import kl
from kl.estimation import fit_field, predicted
from kl.estimation._fit import _NUGGETS, _anchored
from kl.estimation._likelihood import cells
from kl.estimation._model import Model

DEPTH = np.arange(0.25, 12, 0.6)


def _field(random, points, lengths, correlation=kl.Exponential, count=1):
    matrix = np.ones((points.shape[1],) * 2)
    for row, length in zip(points, lengths, strict=True):
        matrix *= np.asarray(correlation(length)(row[:, None] - row[None, :]))
    return np.linalg.cholesky(matrix + 1e-6 * np.eye(len(matrix))) @ random.standard_normal((len(matrix), count))


def _site(random, positions, lengths=(20.0, 1.0), cov=0.3, mean=20e3, trend=1e3):
    points = np.array([(x, -d) for x in positions for d in DEPTH]).T
    deviation = np.sqrt(np.log1p(cov**2))
    scores = _field(random, points, lengths)[:, 0]
    return points, (mean - trend * points[1]) * np.exp(deviation * scores - deviation**2 / 2)


def test_weights_are_restricted_likelihood_times_prior():
    """Of dense algebra: contrasts K' y of the data with K' X = 0 have the restricted likelihood, whatever K."""
    random = np.random.default_rng(1)
    points, values = np.linspace(0, 6, 15), random.standard_normal(15)
    design = np.stack([np.ones(15), points], axis=1)
    lag = np.abs(points[:, None] - points)
    edges, lengths = np.array([0.0, 0.2, 0.6]), np.array([0.7, 1.4])
    posterior = cells(lambda each: np.exp(-lag / each[0]), [lengths], edges, design, values)
    contrasts = np.linalg.svd(design)[0][:, 2:]

    def covariance(length, nugget):
        return contrasts.T @ ((1 - nugget) * np.exp(-lag / length) + nugget * np.eye(15)) @ contrasts

    expected = []
    for cell in posterior:
        length, nugget = cell.lengths[0], cell.nugget
        matrix = covariance(length, nugget)
        inverse = np.linalg.inv(matrix)
        data = contrasts.T @ values
        step = 1e-5
        ends = [covariance(length * np.exp(sign * step), nugget) for sign in (1, -1)]
        drawn = (ends[0] - ends[1]) / (2 * step) @ inverse
        information = np.trace(drawn @ drawn) - np.trace(drawn) ** 2 / 13
        likelihood = -0.5 * np.linalg.slogdet(matrix)[1] - 6.5 * np.log(data @ inverse @ data)
        width = 0.2 if nugget < 0.2 else 0.4
        expected.append(likelihood + 0.5 * np.log(information) + np.log(width))
    weights = np.array([cell.weight for cell in posterior])
    np.testing.assert_allclose(weights - weights[0], np.array(expected) - expected[0], atol=2e-3)


def test_independent_values_have_the_intervals_of_student_and_chi_squared():
    """A nugget of almost 1 leaves no correlation: the intervals of mean and deviation are those of textbooks."""
    random = np.random.default_rng(2)
    values = 10 + 2 * random.standard_normal(40)
    fit = fit_field(np.arange(40.0)[None], values, marginal=kl.Normal, nugget=0.9999)
    half = stats.t.ppf(0.975, 39) * values.std(ddof=1) / np.sqrt(40)
    np.testing.assert_allclose(fit.mean[:3], values.mean() + half * np.array([0, -1, 1]), atol=0.03)
    scale = np.sqrt(39 * values.var(ddof=1) / stats.chi2.ppf([0.975, 0.025], 39))
    np.testing.assert_allclose(np.quantile(fit.draws.scale, [0.025, 0.975]), scale, rtol=0.02)


@pytest.mark.parametrize(
    "correlation",
    [
        kl.Exponential, kl.SquaredExponential, kl.Matern32, kl.Matern52, kl.SecondOrderMarkov, kl.Triangular,
        kl.axis.CosineExponential,
    ],
)  # fmt: skip
def test_intervals_hold_the_truth_of_a_long_sounding(correlation):
    """With 40 m of soil every family's length and variation come out."""
    random = np.random.default_rng(3)
    points = np.arange(0, 40, 0.25)[None]
    scores = _field(random, points, (1.0,), correlation)[:, 0]
    fit = fit_field(points, 30e3 * np.exp(0.3 * scores - 0.045), correlation=correlation, nugget=0.0)
    assert fit.vertical.low < 1 < fit.vertical.high
    assert fit.vertical.high < 4 * fit.vertical.low
    assert fit.cov.low < np.sqrt(np.expm1(0.09)) < fit.cov.high


def test_intervals_cover_and_held_out_soundings_lie_in_their_band():
    """Over 8 sites of three soundings: nominal 95 %, and 5 of 8 or fewer are four in a thousand for each."""
    random = np.random.default_rng(4)
    hits = {"mean": [], "trend": [], "cov": [], "vertical": []}
    inside = []
    for _ in range(8):
        points, values = _site(random, (0.0, 15.0, 28.0))
        held = points[0] == 28.0
        fit = fit_field(points[:, ~held], values[~held], depth=-points[1, ~held], nugget=0.0)
        for name, truth in (("mean", 20e3), ("trend", 1e3), ("cov", 0.3), ("vertical", 1.0)):
            interval = getattr(fit, name)
            hits[name].append(interval.low <= truth <= interval.high)
        band = np.quantile(predicted(fit, points[:, held], -points[1, held]), [0.05, 0.95], axis=0)
        inside.append(np.mean((band[0] <= values[held]) & (values[held] <= band[1])))
    assert {name: np.mean(each) >= 0.75 for name, each in hits.items()} == dict.fromkeys(hits, True)
    assert 0.75 < np.mean(inside) < 0.99


def test_prediction_honours_data_and_forgets_them_far_away():
    """At a datum without nugget it is the datum; far below it has the mean and deviation of the field."""
    random = np.random.default_rng(5)
    points, values = _site(random, (0.0, 15.0), trend=0.0)
    fit = fit_field(points, values, nugget=0.0)
    here = predicted(fit, points[:, :1])
    np.testing.assert_allclose(here, values[0], rtol=5e-3)
    far = predicted(fit, np.array([[1e4], [-1e4]]), draws=2000)
    low, middle, high = np.quantile(far, [0.05, 0.5, 0.95])
    assert fit.mean.low < middle * np.exp(fit.cov.value**2 / 2) < fit.mean.high
    np.testing.assert_allclose(np.log(high / low) / (2 * 1.645), fit.cov.value, rtol=0.25)


def test_few_data_leave_lengths_unknown_with_a_reason():
    """One sounding has no horizontal distances; ten values cannot bound a length."""
    random = np.random.default_rng(6)
    points, values = _site(random, (0.0,))
    fit = fit_field(points, values, depth=-points[1])
    assert fit.horizontal is None
    assert "one sounding" in fit.unknown["horizontal"]
    few = fit_field(points[:, :10], values[:10])
    assert few.vertical.high > 8 * few.vertical.low
    assert "few" in few.unknown["vertical"]
    # A length beyond the sounding is no error, its interval says so.
    slow = np.exp(0.3 * _field(random, points, (20.0, 100.0))[:, 0])
    assert fit_field(points, slow, nugget=0.0).vertical.high > 12


def _common(random, positions, profile):
    """Values whose scatter is independent from sounding to sounding, about a profile that all share."""
    points = np.array([(x, -d) for x in positions for d in DEPTH]).T
    scores = np.concatenate([_field(random, np.stack([DEPTH]), (1.0,))[:, 0] for _ in positions])
    return points, 20e3 * np.exp(0.2 * scores) * profile(-points[1])


@pytest.mark.parametrize("profile", [lambda d: 1 + 2 * np.exp(-d), lambda d: np.where(d < 5, 1.0, 2.5)])
def test_a_profile_that_soundings_share_is_no_correlation_along_the_ground(profile):
    """Of two soundings it cannot be told; of four, 6 m apart, the length is short, and no trend is needed for it."""
    random = np.random.default_rng(8)
    points, values = _common(random, (0.0, 32.0), profile)
    two = fit_field(points, values)
    assert two.horizontal is None
    assert "two soundings cannot tell" in two.unknown["horizontal"]
    points, values = _common(random, (0.0, 6.0, 12.0, 18.0), profile)
    assert fit_field(points, values).horizontal.high < 20


def test_correlation_along_the_ground_is_found_beside_a_profile():
    random = np.random.default_rng(9)
    lows, highs = [], []
    for _ in range(4):
        points, values = _site(random, (0.0, 6.0, 15.0, 28.0, 40.0), trend=0.0)
        fit = fit_field(points, values * (1 + 2 * np.exp(points[1])), nugget=0.0)
        lows.append(fit.horizontal.low)
        highs.append(fit.horizontal.high)
    assert sum(low < 20 < high for low, high in zip(lows, highs, strict=True)) >= 3
    assert np.median(lows) > 4


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda points, values: (points[:, :7], values[:7]), "give at least 8"),
        (lambda points, values: (points, np.full(values.size, 5.0)), "no random field"),
        (lambda points, values: (points, 5 + 1e-5 * values / values.max()), "neither variation nor lengths"),
        (lambda points, values: (points, np.where(values > values.mean(), np.nan, values)), "leave gaps out"),
        (lambda points, values: (points, -values), "above 0"),
        (lambda points, values: (points[:, :9], values), "shape"),
        (lambda points, values: (0 * points, values), "one elevation"),
    ],
)
def test_data_that_tell_nothing_are_refused(change, message):
    points, values = _site(np.random.default_rng(7), (0.0, 9.0))
    with pytest.raises(ValueError, match=message):
        fit_field(*change(points, values))


def test_values_on_a_line_over_depth_have_no_scatter():
    points = np.stack([np.zeros(20), -np.linspace(0, 6, 20)])
    for marginal in (kl.Lognormal, kl.Normal):
        with pytest.raises(ValueError, match="about a line over depth"):
            fit_field(points, 35e3 + 1286 * points[1], depth=-points[1], marginal=marginal)


def test_depths_that_are_all_alike_are_refused():
    points, values = _site(np.random.default_rng(7), (0.0, 9.0))
    with pytest.raises(ValueError, match="one depth, which shows no trend"):
        fit_field(points, values, depth=np.full(values.size, 3.0))


def test_a_drawn_nugget_lies_evenly_within_its_cell_and_a_known_one_is_itself():
    random = np.random.default_rng(10)
    scores = _field(random, DEPTH[None], (2.0,))[:, 0] + 0.5 * random.standard_normal(DEPTH.size)
    values = 30e3 * np.exp(0.3 * scores)
    nugget = fit_field(DEPTH[None], values).draws.nugget
    cell = np.searchsorted(_NUGGETS, nugget) - 1
    assert np.bincount(cell).min() > 20
    within = (nugget - _NUGGETS[cell]) / np.diff(_NUGGETS)[cell]
    assert stats.kstest(within, "uniform").pvalue > 0.05
    assert set(fit_field(DEPTH[None], values, nugget=0.2).draws.nugget) == {0.2}


@pytest.mark.parametrize("rate", [-1.0, 1.0])
def test_a_trend_takes_the_mean_to_a_tenth_of_that_in_the_middle_at_least(rate):
    depth = np.linspace(1, 7, 20)
    values = np.exp(rate * depth + 0.1 * np.random.default_rng(5).standard_normal(20))
    model = _anchored(Model(np.stack([np.zeros(20), -depth]), depth, values, kl.Lognormal, kl.Exponential))
    assert model.grown(np.array([0.0, 7.0])).min() == pytest.approx(0.1)
