"""Estimators against closed forms, exact enumeration and simulation."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binom, binomtest

from cooperative.estimate import published, wilson_interval
from cooperative.estimate._estimates import with_variance


@given(st.integers(1, 2000), st.floats(0, 1), st.sampled_from([0.8, 0.95, 0.99]))
def test_wilson_agrees_with_scipy(samples, share, level):
    failures = round(share * samples)
    ours = wilson_interval(failures, samples, level)
    theirs = binomtest(failures, samples).proportion_ci(level, method="wilson")
    assert ours == pytest.approx((theirs.low, theirs.high), abs=1e-12)
    assert 0 <= ours[0] <= failures / samples <= ours[1] <= 1


def test_weights_that_add_up_to_1_but_for_rounding_are_certain():
    assert sum([0.1] * 10) < 1
    assert with_variance("two-phase", sum([0.1] * 10), 0.0, 10).probability == 1


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


def test_published_counts_down_to_the_stopping_rank():
    displacement = np.arange(10.0, 0, -1)
    refined = {0: True, 1: True, 2: False, 3: True, 4: False, 5: False, 8: True}
    answer = published(displacement, refined, k_t=2)
    assert answer.probability == 0.3
    assert answer.refined_runs == 6
    assert answer.interval == wilson_interval(3, 10)
    assert answer.cov == pytest.approx(np.sqrt(0.7 / 3))


def test_published_says_what_is_open():
    answer = published(np.arange(5.0, 0, -1), {0: True, 1: None}, k_t=3)
    assert any("not met yet" in note for note in answer.notes)
    assert any("1 refined runs gave no answer" in note for note in answer.notes)


def test_published_without_failures():
    answer = published(np.ones(20), dict.fromkeys(range(3), False), k_t=3)
    assert answer.probability == 0.0
    assert answer.cov == np.inf
    assert answer.interval[1] > 0.1
