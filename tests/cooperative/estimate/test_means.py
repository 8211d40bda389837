"""Intervals of weighted means: what they hold on made-up campaigns, and where there are none."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from benchmarks.statistics import estimators_means as means
from cooperative.estimate import exceedance, mean_interval, mean_of, monte_carlo
from cooperative.estimate._means import _of_ratio, _share_limits

positive = st.lists(st.tuples(st.floats(0.1, 50.0), st.floats(0.01, 1.0)), min_size=3, max_size=30).map(np.array)


@given(positive, st.floats(0.01, 100.0), st.floats(0.01, 100.0))
def test_units_and_the_sum_of_the_weights_do_not_matter(rows, unit, total):
    values, weight = rows.T
    interval = mean_interval(values, weight)
    assert (interval is None) == (weight.sum() ** 2 / (weight @ weight) < 5 - 1e-8)
    if interval is None:
        return
    low, high = interval
    assert low <= weight @ values / weight.sum() * (1 + 1e-9)
    assert high >= weight @ values / weight.sum() * (1 - 1e-9)
    scaled = mean_interval(unit * values, total * weight)
    assert scaled == pytest.approx((unit * low, unit * high), rel=1e-6)


def test_equal_weights_give_the_jackknifes_variance():
    values = np.random.default_rng(3).gamma(4.0, size=40)
    low, high = mean_interval(values, np.ones(40))
    left_out = (values.sum() - values) / 39
    jackknife = 39 / 40 * np.sum((left_out - left_out.mean()) ** 2)
    # Student's t of some twenty degrees of freedom.
    quantile = np.log(high / low) / 2 * values.mean() / np.sqrt(jackknife * 40 / 39)
    assert 2.02 < quantile < 2.3


@pytest.mark.parametrize(("low", "high"), [(1, 9), (4, 6), (8, 2)])
def test_even_slides_have_students_t_of_their_number_over_the_kurtosis(low, high):
    values = np.array([1.0] * low + [3.0] * high)
    freedom = 10 / stats.kurtosis(values, fisher=False) - 1
    deviation = np.sqrt(10) / 9 * values.std() / values.mean()
    limits = values.mean() * np.exp(np.array([-1, 1]) * stats.t.ppf(0.975, max(freedom, 3.0)) * deviation)
    assert mean_interval(values, np.ones(10)) == pytest.approx(limits)


@pytest.mark.parametrize("does", [1, 3, 9])
def test_a_share_of_even_slides_has_one_degree_of_freedom_less_than_slides(does):
    share = does / 10
    _, low, _ = _share_limits(np.full(10, 0.1), np.arange(10)[:, None] < does, 0.95)
    # Wilson's equation at the lower limit: the variance there, as large for 10 slides as residuals over 1 - 1 / 10 say.
    distance = (share - low[0]) / np.sqrt(low[0] * (1 - low[0]) * 10 / 81)
    assert distance == pytest.approx(stats.t.ppf(0.975, 9))


@pytest.mark.parametrize("slides", [200, 2000])
def test_what_every_slide_did_scatters_as_jeffreys_prior_says(slides):
    _, low, _ = _share_limits(np.full(slides, 1 / slides), np.ones((slides, 1)), 0.95)
    assert 1 - low[0] == pytest.approx(stats.norm.ppf(0.975) * stats.beta(slides + 0.5, 0.5).std(), rel=2 / slides)


@given(st.floats(0.02, 0.98), st.booleans())
def test_two_slides_however_unequal_have_one_degree_of_freedom(heavy, which):
    share = np.array([heavy, 1 - heavy])
    does = np.array([[which], [not which]], float)
    ratio, low, _ = _share_limits(share, does, 0.95)
    variance, _ = _of_ratio(share, does, ratio)
    # Wilson's equation at the lower limit, of as many slides as scatter so.
    distance = (ratio - low) / np.sqrt(low * (1 - low) * variance / (ratio * (1 - ratio)))
    assert distance[0] == pytest.approx(stats.t.ppf(0.975, 1))


@pytest.mark.parametrize("failures", [6, 12])
def test_a_loss_that_every_slide_brings_has_no_narrower_limits_than_p_f(failures):
    estimate = monte_carlo(np.arange(12) < failures)
    loss = mean_of(estimate, np.ones(failures), np.full(failures, 1000.0))
    assert float(loss.value) == pytest.approx(1000 * estimate.probability)
    assert float(loss.low) <= 1000 * estimate.interval[0] + 1e-9


def test_too_few_values_and_equal_ones():
    assert mean_interval(np.array([1.0, 2.0, 1.5, 1.7]), np.ones(4)) is None
    # Ten of which one stands for nearly all are as few.
    assert mean_interval(np.arange(1.0, 11.0), np.array([50.0, *[1.0] * 9])) is None
    assert mean_interval(np.zeros(5), np.ones(5)) is None
    # Equal values show nothing of how those scatter that were not drawn.
    assert mean_interval(np.full(6, 2.5), np.array([0.3, 0.2, 0.3, 0.4, 0.3, 0.3])) is None
    assert mean_interval(np.full(15, 0.1) * 3 / 3, np.ones(15)) is None


def test_one_slide_far_beyond_the_others_does_not_make_an_interval_without_end():
    values = np.array([1.0, 1.1, 0.9, 1.0, 1.05, 20.0])
    low, high = mean_interval(values, np.ones(6))
    # Student's t of at least 3 degrees of freedom; 1 gave 0.0001 to 200,000.
    assert low < 1.0 < values.mean() < 20 < high < 100


def test_intervals_hold_the_truth_of_campaigns_that_draw_their_slides_twice():
    case = means.Means(0.05, 120, 15)
    result = means.summarise(case, means.repeat(case, 0, 60))
    assert result["without_interval"] == 0
    assert abs(result["bias"]) < 0.05
    assert 0.9 <= result["coverage"] <= 1.0


def test_the_truth_of_the_made_up_campaigns_is_that_of_many_samples():
    beyond = np.random.default_rng(0).standard_normal(400_000) - 0.69
    failures = beyond[beyond > 0]
    mean = np.exp(2 + means.GROWTH * failures).mean() * np.exp(means.SCATTER**2 / 2)
    assert means.truth(float(np.mean(beyond > 0))) == pytest.approx(mean, rel=0.01)


def test_a_curve_of_no_slide_starts_at_the_probability_of_failure():
    estimate = monte_carlo(np.array([True, False, False, False]))
    curve = exceedance(estimate, np.zeros(0), np.zeros(0))
    assert curve.probability[0] == estimate.probability == 0.25
    assert (curve.low[0], curve.high[0]) == estimate.interval
    assert set(curve.probability[1:]) == set(curve.low[1:]) == {0.0}


@given(st.lists(st.tuples(st.floats(0.1, 1.0), st.floats(0.0, 50.0)), min_size=8, max_size=20))
def test_the_variance_of_a_weighted_mean_is_that_of_leaving_each_slide_out(slides):
    weight, value = np.array(slides).T
    share = weight / weight.sum()
    mean = share @ value
    without = [np.delete(share, k) @ np.delete(value, k) / (1 - share[k]) for k in range(len(share))]
    variance, _ = _of_ratio(share, value[:, None], np.array([mean]))
    np.testing.assert_allclose(variance, [np.square(np.array(without) - mean).sum()], rtol=1e-9, atol=1e-9)


@given(st.lists(st.tuples(st.floats(0.5, 1.0), st.floats(0.1, 50.0)), min_size=12, max_size=30).map(np.array))
def test_where_p_f_is_known_an_expected_value_has_the_limit_of_the_mean_over_slides(slides):
    weight, value = slides.T
    interval = mean_interval(value, weight)
    found = mean_of(monte_carlo(np.ones(len(slides), bool)), weight, value)
    if interval is None:  # the values are alike
        assert float(found.high) == pytest.approx(float(found.value))
    else:
        np.testing.assert_allclose(found.high, interval[1], rtol=1e-9)
        assert float(found.low) <= interval[0] * (1 + 1e-9)
