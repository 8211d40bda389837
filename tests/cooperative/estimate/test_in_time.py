"""First failures by bisection, and the probability of failure against time from common samples."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from cooperative.estimate import Bracket, critical_factor, first_guess, in_time, record_lows, wilson_interval
from cooperative.estimate._in_time import _scores


@given(count=st.integers(1, 15), data=st.data())
def test_bisection_finds_the_first_failure_whatever_is_guessed(count, data):
    truth, guess = data.draw(st.integers(0, count)), data.draw(st.integers(0, count))
    bracket = Bracket.of(count)
    asked = []
    while (at := bracket.next(guess)) is not None:
        assert at in set(range(count)) - set(asked)
        asked.append(at)
        bracket = bracket.told(at, at >= truth)
    assert bracket.fails == truth
    assert len(asked) <= 3 + np.ceil(np.log2(count + 1))
    if guess == truth:
        assert len(asked) <= 2
    if len(asked) > 1:
        assert abs(asked[1] - asked[0]) == 1


def test_a_run_that_broke_off_ends_the_search():
    bracket = Bracket.of(5).told(4, True).told(3, None)
    assert bracket.known
    assert bracket.lost


def test_only_a_new_low_can_be_a_first_failure():
    factors = np.array([1.3, 1.1, 1.2, 1.0999, 0.9, 1.4])
    assert record_lows(factors) == [0, 1, 4]
    assert first_guess(factors, [0, 1, 4]) == 2
    assert first_guess(factors + 1, [0, 1, 4]) == 3
    assert record_lows(np.full(3, np.nan)) == [0, 1, 2]


def test_the_critical_factor_parts_failures_from_what_stands():
    assert critical_factor([], []) == 1.0
    assert 1.1 < critical_factor([0.9, 1.1, 1.2, 1.4], [True, True, False, False]) < 1.2
    assert critical_factor([0.8, 1.3], [True, False]) == 1.0  # any in between: the nearest to 1
    assert critical_factor([0.8, 0.9], [False, False]) <= 0.8
    assert critical_factor([1.2, 1.3], [True, True]) > 1.3


def test_all_samples_are_counted_at_each_time():
    first = np.tile([0, 0, 1, 2, 3, 3, 3, -1], 10)  # three times; 3 is never, -1 broke off
    estimates = in_time(first, None, None, 3)
    assert [each.probability for each in estimates] == [2 / 7, 3 / 7, 4 / 7]
    assert estimates[1].interval == pytest.approx(wilson_interval(30, 70))


def test_refined_runs_correct_the_rough_ones():
    """The rough grid has every fifth failure wrong; over many draws the estimate has the refined share."""
    rng = np.random.default_rng(4)
    found, truth = [], []
    for _ in range(40):
        strength = rng.standard_normal(400)
        refined = np.searchsorted([-1.0, 0.0, 0.5], strength)
        late = np.minimum(refined + (rng.random(400) < 0.2), 3)
        some = {n: int(refined[n]) for n in range(120)}
        factors = 1 + 0.2 * strength[:, None] - 0.05 * np.arange(3)
        found.append([each.probability for each in in_time(late, some, factors, 3)])
        truth.append([(refined <= at).mean() for at in range(3)])
    # The mean of 40 estimates of 120 runs each; without the correction the middle one would be off by 0.07.
    np.testing.assert_allclose(np.mean(found, axis=0), np.mean(truth, axis=0), atol=0.015)
    everything = {n: int(refined[n]) for n in range(400)}
    exact = in_time(late, everything, None, 3)
    assert [each.probability for each in exact] == pytest.approx(truth[-1])


@pytest.mark.parametrize("audited", [10, 40])
def test_where_the_first_runs_agree_samples_of_one_class_count_alike(audited):
    """Laplace's share is left to those that may differ, and no class of equal factors leans on the numbers of its
    samples."""
    differs = stats.beta(1, audited + 1).mean()  # of a share that may be anything, after as many that agree
    error, scatter = [], []
    for seed in range(20):
        first = np.random.default_rng(seed).integers(0, 4, 200)
        agree = {n: int(first[n]) for n in range(audited)}
        for at, each in enumerate(in_time(first, agree, None, 3)):
            error.append(each.probability - (first <= at).mean())
            if 0 < sum(when <= at for when in agree.values()) < audited:
                scatter.append(each.audit_variance)
    assert min(scatter) == pytest.approx(differs * (1 - differs) * (1 / audited - 1 / 200))
    assert abs(np.mean(error)) < 0.02


@pytest.mark.parametrize("seed", range(10))
def test_a_time_before_all_others_at_which_nothing_happens_changes_nothing(seed):
    rng = np.random.default_rng(seed)
    strength = rng.standard_normal(60)
    refined = np.searchsorted([-0.8, 0.0, 0.8], strength)
    first = np.where(rng.random(60) < 0.1, -1, np.minimum(refined + (rng.random(60) < 0.3), 3))
    answers = {n: int(refined[n]) if rng.random() > 0.1 else -1 for n in range(30)}
    factors = 1 + 0.2 * strength[:, None] - 0.05 * np.arange(3) + 0.1 * rng.standard_normal((60, 3))
    estimates = in_time(first, answers, factors, 3)
    one_more = in_time(
        np.where(first < 0, -1, first + 1),
        {n: when + 1 if when >= 0 else -1 for n, when in answers.items()},
        np.column_stack([factors[:, 0], factors]),
        4,
    )
    assert one_more[0].probability == 0
    for field in ("probability", "audit_variance", "cov"):
        after = [getattr(each, field) for each in one_more[1:]]
        assert after == pytest.approx([getattr(each, field) for each in estimates]), field


@given(st.integers(0, 1000), st.integers(0, 2))
def test_samples_rank_by_class_then_by_the_time_of_failure_then_by_their_lowest_factor(seed, at):
    rng = np.random.default_rng(seed)
    first, factors = rng.integers(-1, 4, 12), np.exp(rng.standard_normal((12, 3)))
    score = _scores(first, factors, at, 3)
    np.testing.assert_array_equal(np.isnan(score), first < 0)
    failed = (first >= 0) & (first <= at)
    np.testing.assert_array_equal(score > 1, failed)
    lowest = factors[:, : at + 1].min(axis=1)
    ranked = np.lexsort((lowest, np.where(failed, first, 3), ~failed, first < 0))
    assert np.argsort(-score).tolist()[: (first >= 0).sum()] == ranked.tolist()[: (first >= 0).sum()]
    later = np.where(np.arange(3) > at, 0.01, factors)
    np.testing.assert_array_equal(score, _scores(first, later, at, 3))
