"""Estimators against closed forms, exact enumeration and simulation."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binom, binomtest, lognorm

from cooperative.estimate import exact_limit, published, wilson_interval
from cooperative.estimate._estimates import RARE, count_interval, lognormal_limits, with_variance


@given(st.integers(1, 2000), st.floats(0, 1), st.sampled_from([0.8, 0.95, 0.99]))
def test_wilson_agrees_with_scipy(samples, share, level):
    failures = round(share * samples)
    ours = wilson_interval(failures, samples, level)
    theirs = binomtest(failures, samples).proportion_ci(level, method="wilson")
    assert ours == pytest.approx((theirs.low, theirs.high), abs=1e-12)
    assert 0 <= ours[0] <= failures / samples <= ours[1] <= 1


def test_weights_that_add_up_to_1_but_for_rounding_are_certain():
    assert with_variance("two-phase", math.nextafter(1.0, 0.0), 0.0, 10).probability == 1


def test_wilson_covers_on_average():
    samples = 100
    limits = np.array([wilson_interval(n, samples) for n in range(samples + 1)])
    coverage = [
        binom.pmf(np.arange(samples + 1), samples, p)[(limits[:, 0] <= p) & (p <= limits[:, 1])].sum()
        for p in np.linspace(0.02, 0.98, 500)
    ]
    assert np.mean(coverage) == pytest.approx(0.95, abs=0.005)


@pytest.mark.parametrize("arguments", [(-1, 10), (11, 10), (0, 0), (1, 10, 1.0)])
def test_wilson_refuses_nonsense(arguments):
    with pytest.raises(ValueError, match="give"):
        wilson_interval(*arguments)


@given(st.integers(1, 2000), st.floats(0, 1))
def test_limits_of_few_counts_are_exact(samples, share):
    failures = round(share * samples)
    low, high = count_interval(failures, samples)
    mirrored = count_interval(samples - failures, samples)
    assert (low, high) == pytest.approx((1 - mirrored[1], 1 - mirrored[0]), abs=1e-12)
    theirs = binomtest(failures, samples).proportion_ci(0.95, method="exact")
    if failures == 0:
        one_sided = binomtest(0, samples, alternative="less").proportion_ci(0.95, method="exact")
        assert (low, high) == (0.0, pytest.approx(one_sided.high))
        assert exact_limit(samples) == high
    elif failures < RARE and samples - failures >= RARE:
        assert low == pytest.approx(min(theirs.low, wilson_interval(failures, samples)[0]))
        assert high == wilson_interval(failures, samples)[1]
    elif failures >= RARE <= samples - failures:
        assert (low, high) == wilson_interval(failures, samples)


@pytest.mark.parametrize("cov", [0.1, 0.5, 2.0])
def test_limits_of_a_lognormal_estimate_miss_its_mean_equally_often_on_both_sides(cov):
    spread = np.sqrt(np.log1p(cov**2))
    estimate = lognorm(spread, scale=3.0 * np.exp(-(spread**2) / 2))
    (lowest, _), (_, highest) = (lognormal_limits(estimate.ppf(p), cov, np.inf, 0.9) for p in (0.95, 0.05))
    assert (lowest, highest) == pytest.approx((estimate.mean(), 3.0))


@given(st.floats(1e-6, 0.9), st.floats(0.01, 1.0), st.sampled_from([2.0, 7.0, np.inf]))
def test_a_product_of_factors_has_lognormal_limits(probability, cov, freedom):
    product = with_variance("subset", probability, (cov * probability) ** 2, 60, freedom=freedom, skewed=True)
    low, high = lognormal_limits(probability, cov, freedom, 0.95)
    assert product.interval == pytest.approx((low, min(high, 1.0)))
    # What is certain is no product.
    certain = {skewed: with_variance("subset", 1.0, cov**2, 60, freedom=freedom, skewed=skewed) for skewed in (0, 1)}
    assert certain[0].interval == certain[1].interval


def test_few_failures_seen_leave_as_much_open_as_so_many_counted():
    # A steady estimate from two failures: its scatter claims 250 of them.
    steady = with_variance("two-phase", 0.2, 0.2 * 0.8 / 1250, 60, failed=2, stand=58)
    assert steady.interval[0] == pytest.approx(binomtest(2, 10).proportion_ci(method="exact").low)
    assert with_variance("two-phase", 0.2, 0.2 * 0.8 / 1250, 60).interval[0] == wilson_interval(250, 1250)[0]
    # A failure that weighs next to nothing is one of so many samples all the same.
    light = with_variance("two-phase", 0.03, 0.01, 60, failed=1, stand=59, independent=100)
    assert light.interval[0] == pytest.approx(binomtest(1, 100).proportion_ci(method="exact").low)


def test_published_counts_down_to_the_stopping_rank():
    displacement = np.arange(10.0, 0, -1)
    refined = {0: True, 1: True, 2: False, 3: True, 4: False, 5: False, 8: True}
    answer = published(displacement, refined, k_t=2)
    assert answer.probability == 0.3
    assert answer.refined_runs == 6
    assert answer.interval == count_interval(3, 10)
    assert answer.cov == pytest.approx(np.sqrt(0.7 / 3))


def test_published_says_what_is_open():
    answer = published(np.arange(5.0, 0, -1), {0: True, 1: None}, k_t=3)
    assert any("not met yet" in note for note in answer.notes)
    # All that did not run may fail.
    assert answer.interval[1] == 1.0
    assert published(np.arange(5.0, 0, -1), {}, k_t=3).interval == (0.0, 1.0)
    some = published(np.arange(40.0, 0, -1), {0: True, **dict.fromkeys(range(1, 36), False)}, k_t=39)
    assert some.interval[1] == pytest.approx(count_interval(5, 40)[1])
    assert any("1 refined runs gave no answer" in note for note in answer.notes)


def test_published_without_failures():
    answer = published(np.ones(20), dict.fromkeys(range(3), False), k_t=3)
    assert answer.probability == 0.0
    assert answer.cov == np.inf
    assert answer.interval[1] > 0.1
