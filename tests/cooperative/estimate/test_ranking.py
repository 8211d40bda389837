"""The published stopping rule: by hand, and whatever the look-ahead and the order of arrival."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cooperative.estimate import next_refined, published, rank_samples, stopping_rank


def test_rank_is_by_displacement_then_number():
    ranking = rank_samples(np.array([0.2, 9.0, 0.2, 3.0]))
    assert ranking.order.tolist() == [1, 3, 0, 2]
    assert ranking.broke_off.tolist() == []


def test_runs_that_broke_off_lead_and_are_reported():
    ranking = rank_samples(np.array([0.2, np.nan, 5.0, 0.1]), np.array([False, False, False, True]))
    assert ranking.order.tolist() == [1, 3, 2, 0]
    assert ranking.broke_off.tolist() == [1, 3]


@pytest.mark.parametrize("bad", [np.zeros((2, 2)), np.zeros(0)])
def test_ranking_wants_one_number_per_sample(bad):
    with pytest.raises(ValueError, match="one number per sample"):
        rank_samples(bad)
    with pytest.raises(ValueError, match=r"shape \(3,\)"):
        rank_samples(np.zeros(2), np.zeros(3, dtype=bool))


def test_the_count_starts_anew_at_each_failure():
    order = np.arange(10)
    fails = {0: True, 1: False, 2: True, 3: False, 4: False}
    assert stopping_rank(order, fails, 3) is None
    assert stopping_rank(order, {**fails, 5: False}, 3) == 6
    assert stopping_rank(order, {**fails, 5: True, 6: False, 7: False}, 3) is None
    assert stopping_rank(order, dict.fromkeys(range(10), True), 3) == 10


def test_a_run_without_answer_neither_counts_nor_resets():
    assert stopping_rank(np.arange(10), {0: False, 1: None, 2: False}, 2) == 3


@pytest.mark.parametrize(("k_t", "look_ahead", "match"), [(0, 1, "k_t = 0"), (1, 0, "look_ahead = 0")])
def test_bad_counts(k_t, look_ahead, match):
    with pytest.raises(ValueError, match=match):
        next_refined(np.ones(3), {}, k_t, look_ahead)


def sequential(order, fails, k_t):
    """The rule as printed, with the reset that the text leaves out."""
    results, standing = {}, 0
    for sample in order:
        results[int(sample)] = bool(fails[sample])
        standing = 0 if fails[sample] else standing + 1
        if standing == k_t:
            break
    return results


@given(
    st.lists(st.tuples(st.sampled_from([0.1, 0.5, 2.0, 7.0]), st.booleans()), min_size=1, max_size=40),
    st.integers(1, 5),
    st.integers(1, 8),
    st.randoms(use_true_random=False),
)
def test_the_answer_depends_on_neither_look_ahead_nor_arrival(pairs, k_t, look_ahead, random):
    displacement = np.array([pair[0] for pair in pairs])
    fails = [pair[1] for pair in pairs]
    under_way, results = [], {}
    while True:
        started = next_refined(displacement, results, k_t, look_ahead, under_way=under_way)
        under_way += started
        assert len(under_way) <= look_ahead
        if not under_way:
            break
        arrived = under_way.pop(random.randrange(len(under_way)))
        results[arrived] = fails[arrived]
    order = rank_samples(displacement).order
    assert results == sequential(order, fails, k_t)
    assert stopping_rank(order, results, k_t) == len(results)


def test_the_published_rule_warns_of_samples_that_it_never_ran_where_there_are_any():
    displacement, fails = np.arange(6.0)[::-1], dict.fromkeys(range(6), False)
    below = published(displacement, fails | {0: True}, 3)
    assert any("taken to stand" in note for note in below.notes)
    # A failure at the end has all of them run.
    assert not published(displacement, fails | {0: True, 3: True, 5: True}, 3).notes
