"""Probabilities of what slides do: against plain counting, by identities, and over made-up campaigns whose truth is
known."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import trapezoid

from benchmarks.statistics import estimators_means as means
from cooperative.estimate import (
    MonteCarlo,
    Population,
    TwoPhase,
    chance_of,
    exact_limit,
    exceedance,
    mean_of,
    monte_carlo,
    wilson_interval,
)
from tests.cooperative.effects.test_slides import known_population

FAILS = np.arange(40) % 4 == 0
PLAIN = monte_carlo(FAILS)


def test_what_every_slide_did_is_as_likely_as_a_failure_at_most():
    result = chance_of(PLAIN, np.ones(10), np.ones((10, 2), bool))
    assert result.value == pytest.approx([PLAIN.probability] * 2)
    # The next one may not do it: the lower limit lies below that of P_f, by less than ten out of ten leave open.
    seen = wilson_interval(10, 10)[0]
    assert PLAIN.interval[0] * seen < result.low[0] < PLAIN.interval[0]
    assert result.high[0] == pytest.approx(PLAIN.interval[1])
    assert result.count.tolist() == [10, 10]


def test_of_plain_monte_carlo_it_is_the_binomial_interval():
    # 2000 of 8000 samples fail and 500 of these do it: the product of two shares scatters as one count would.
    many = monte_carlo(np.arange(8000) % 4 == 0)
    result = chance_of(many, np.ones(2000), np.arange(2000)[:, None] < 500)
    assert result.value == pytest.approx(500 / 8000)
    assert (result.low[0], result.high[0]) == pytest.approx(wilson_interval(500, 8000), rel=5e-3)


def test_what_no_slide_did_may_still_happen():
    result = chance_of(PLAIN, np.ones(10), np.zeros((10, 1), bool))
    assert (result.value[0], result.low[0]) == (0.0, 0.0)
    assert wilson_interval(0, 40)[1] <= result.high[0] < PLAIN.interval[1]
    nothing = chance_of(monte_carlo(np.zeros(40, bool)), np.zeros(0), np.zeros((0, 3), bool))
    assert nothing.value.tolist() == [0.0] * 3
    assert nothing.high == pytest.approx([exact_limit(40)] * 3)


def test_what_no_slide_did_may_be_done_by_such_as_the_heaviest():
    # Slides that are seldom drawn weigh most; what only such slides do is missed more easily than their number tells.
    weight = np.array([10.0, *[1.0] * 9])
    result = chance_of(PLAIN, weight, np.zeros((10, 1), bool))
    heaviest = PLAIN.probability * 10 / 19
    assert result.high[0] == pytest.approx(min(wilson_interval(0, 1 / heaviest)[1], PLAIN.interval[1]))
    # One light slide that did it may be followed by a heavy one.
    one = chance_of(PLAIN, weight, np.eye(10, dtype=bool))
    light = chance_of(PLAIN, np.ones(10), np.eye(10, dtype=bool))
    assert (one.high[1:] > light.high[1:]).all()


def test_the_allowance_for_what_no_run_has_met_is_that_of_the_failures_alone():
    wide = replace(PLAIN, interval=(PLAIN.interval[0], 0.9), sampling_interval=PLAIN.interval, hidden_limit=0.6)
    values = np.arange(1.0, 11.0)
    plain, allowed = (exceedance(each, np.ones(10), values) for each in (PLAIN, wide))
    np.testing.assert_array_equal(plain.high, allowed.high)
    assert chance_of(wide, np.zeros(0), np.zeros((0, 1), bool)).high[0] == 0.9


def test_a_variance_of_one_freedom_makes_no_mean_without_end():
    thickness = np.linspace(1.0, 3.0, 12)[:, None]
    rough = replace(PLAIN, cov=0.5, freedom=1.0)
    result, plain = (mean_of(each, np.ones(12), thickness) for each in (rough, PLAIN))
    assert plain.low[0] < result.value[0] == plain.value[0] < plain.high[0] < result.high[0]
    # Student's t of one would give 13 / 0.5 deviations, 600 times the mean.
    assert result.high[0] < 10 * result.value[0]
    # Four slides have no interval, and may bring more than they show.
    few = mean_of(PLAIN, np.ones(4), thickness[:4])
    assert (few.low[0], np.isnan(few.high[0])) == (0.0, True)


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_before_the_first_wave_an_expected_value_has_no_upper_limit():
    rough, _, _ = known_population()
    begun = TwoPhase(refined_runs=60).estimate(Population(rough), {0: True, 1: False})
    assert (begun.interval, begun.cov) == ((0.0, 1.0), np.inf)
    assert begun.probability > 0
    result = mean_of(begun, np.ones(12), np.stack([np.linspace(1.0, 3.0, 12), np.zeros(12)], axis=1))
    assert result.value == pytest.approx([2.0 * begun.probability, 0.0])
    assert result.low.tolist() == [0.0, 0.0]
    assert np.isnan(result.high).all()


weights = st.lists(st.floats(0.01, 1.0), min_size=3, max_size=20).map(np.array)


@given(weights, st.integers(0, 2**32), st.floats(0.1, 50.0))
def test_curves_start_at_the_probability_of_failure_fall_and_know_no_scale(weight, seed, scale):
    values = np.random.default_rng(seed).exponential(size=weight.size) * 10
    curve = exceedance(PLAIN, weight, values)
    start = curve.probability[0], curve.low[0], curve.high[0]
    assert start == pytest.approx((PLAIN.probability, *PLAIN.interval))
    assert curve.probability[-1] == 0
    assert (np.diff(curve.probability) <= 1e-12).all()
    low, value, high = map(np.array, (curve.low, curve.probability, curve.high))
    assert (low <= value + 1e-12).all()
    assert (value <= high + 1e-12).all()
    again = exceedance(PLAIN, weight * scale, values)
    assert again.high == pytest.approx(curve.high)
    for unit in (1.0, 1e-3):
        thresholds = exceedance(PLAIN, weight, unit * values).thresholds
        assert thresholds == pytest.approx(unit * np.linspace(0.0, values.max(), len(thresholds)))


@given(weights, st.integers(0, 2**32))
def test_the_area_under_the_curve_is_the_expected_value(weight, seed):
    values = np.random.default_rng(seed).exponential(size=weight.size)
    # The curve is a staircase with steps at the values: between them it is level.
    steps = np.sort(np.concatenate([[0.0], values, values]))
    beyond = chance_of(PLAIN, weight, values[:, None] > (steps[:-1] + steps[1:]) / 2).value
    area = float(np.sum(beyond * np.diff(steps)))
    assert area == pytest.approx(float(mean_of(PLAIN, weight, values[:, None]).value[0]), rel=1e-9)
    fine = exceedance(PLAIN, weight, values, np.linspace(0.0, values.max(), 4001))
    assert trapezoid(fine.probability, fine.thresholds) == pytest.approx(area, rel=0.02)


@pytest.mark.parametrize(
    ("weight", "values", "message"),
    [
        (np.ones(3), np.ones(2), r"\(3,\), values \(2,\)"),
        (np.zeros(3), np.ones(3), "above 0"),
        (np.ones(3), np.array([1.0, np.nan, 2.0]), "brings nan"),
        (np.ones(3), np.array([1.0, -2.0, 2.0]), "brings -2"),
    ],
)
def test_what_cannot_be_weighed_is_refused(weight, values, message):
    with pytest.raises(ValueError, match=message):
        exceedance(PLAIN, weight, values)
    with pytest.raises(ValueError, match=message):
        mean_of(PLAIN, weight, values)


def covered(estimator, slides, repeats):
    """Share of made-up campaigns whose intervals hold the truth: of exceeding nine displacements, and of the mean. The
    campaigns are drawn with replacement from the 400 sections."""
    rough, refined, _ = known_population()
    fails = refined > 1.0
    thresholds = np.quantile(refined[fails], np.arange(0, 9) / 10)
    does = fails[:, None] & (refined[:, None] > thresholds)
    held, mean = np.zeros(thresholds.size), 0
    for seed in range(repeats):
        at = np.random.default_rng([seed, 5]).integers(rough.size, size=400)
        seeded = replace(estimator, **({"seed": seed} if slides else {}))
        audit = means.audited(seeded, rough[at], fails[at])
        phases, numbers, drawn = means.slid(audit, fails[at], slides, seed)
        mine = drawn.slid & (drawn.weight > 0)
        which = at[np.array(numbers)[mine]]
        result = chance_of(phases.estimate, drawn.weight[mine], does[which])
        held += (result.low <= does.mean(axis=0)) & (does.mean(axis=0) <= result.high)
        total = mean_of(phases.estimate, drawn.weight[mine], refined[which])
        mean += total.low <= (fails * refined).mean() <= total.high
    return held / repeats, mean / repeats


def test_intervals_hold_the_truth_of_both_draws():
    held, mean = covered(TwoPhase(refined_runs=60), 20, 40)
    assert held.mean() == pytest.approx(0.96, abs=0.035)
    assert held.min() > 0.85  # of 40 campaigns: 0.95 less three standard errors
    assert mean > 0.85


def test_intervals_of_plain_monte_carlo_hold_the_truth():
    held, mean = covered(MonteCarlo(), None, 60)
    assert held.mean() == pytest.approx(0.95, abs=0.035)
    assert held.min() > 0.85
    assert mean > 0.85
