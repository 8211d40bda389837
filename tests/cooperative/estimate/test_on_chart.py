"""Chains of loads, and the probability of failure on a chart against its closed form."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from benchmarks.accuracy import seepage_in_time as made_up
from cooperative.estimate import fails_under, falling_chain, monte_carlo, on_chart
from cooperative.tools.in_time import rate_at

FACTORS = arrays(float, 9, elements=st.floats(0.5, 2.0))


@given(factors=FACTORS, critical=st.floats(0.4, 2.1))
def test_who_fails_first_says_where_a_sample_fails(factors, critical):
    chain = falling_chain(factors).tolist()
    assert np.all(np.diff(factors[chain]) <= 0)
    first = next((at for at in chain if factors[at] < critical), len(chain))
    np.testing.assert_array_equal(fails_under(first, chain, np.arange(9)), factors < critical)
    assert np.isnan(fails_under(-1, chain, np.arange(9))).all()


def test_a_chart_whose_samples_all_ran_is_monte_carlo():
    factors = np.random.default_rng(0).normal(1.1, 0.2, (60, 1, 1)) - np.array([[0.0, 0.1, 0.2], [0.1, 0.2, 0.3]])
    found = on_chart(factors < 1, None, factors)
    for each, fails in zip(found, (factors < 1).reshape(60, -1).T, strict=True):
        assert each.probability == pytest.approx(fails.mean())
        assert each.interval == pytest.approx(monte_carlo(fails).interval)


def test_samples_that_broke_off_are_left_out():
    fails = np.tile([1.0, 0.0, np.nan, 0.0], 5)[:, None, None]
    assert on_chart(fails, None, np.ones_like(fails))[0].probability == pytest.approx(1 / 3)


def test_estimates_rise_along_both_axes():
    rng = np.random.default_rng(2)
    factors = rng.normal(1.1, 0.2, (80, 1, 1)) - np.array([[0.0, 0.1], [0.05, 0.2]])
    rough = factors * rng.lognormal(0.0, 0.1, (80, 2, 2)) < 1
    found = on_chart(rough, {n: factors[n] < 1 for n in range(20)}, factors)
    values = np.array([(each.interval[0], each.probability, each.interval[1]) for each in found]).reshape(2, 2, 3)
    assert np.all(np.diff(values, axis=0) >= 0)
    assert np.all(np.diff(values, axis=1) >= 0)
    assert np.all(np.diff(values, axis=2) >= 0)


def test_lines_of_the_exact_chart_have_its_slope():
    """Failure at one intensity^0.7 duration: a line falls by -1 / 0.7 on logarithmic axes, whatever its P_f."""
    fine = np.geomspace(0.1, 1000.0, 4001)
    for chance in made_up.LINES[:2]:
        rates = [
            rate_at(chance, fine, made_up.exact(10e3, made_up.pressure_of_storms(fine, hours)))
            for hours in made_up.DURATIONS
        ]
        slopes = np.diff(np.log(rates)) / np.diff(np.log(made_up.DURATIONS))
        np.testing.assert_allclose(slopes, -1 / made_up.POWER, rtol=1e-3)


def test_intervals_of_a_chart_hold_its_closed_form():
    rows = list(made_up.chart_coverage_rows(quick=True))
    count = 40
    # By chance alone 95 % intervals hold it as often as that in all but one of ten thousand cases.
    fewest = 0.95 - 3.8 * math.sqrt(0.95 * 0.05 / count)
    assert min(row["coverage"] for row in rows) > fewest
    assert np.mean([row["coverage"] for row in rows]) >= 0.95
    lines = [row for row in rows if "intensity" in row["case"]]
    assert len(lines) >= 5
    for row in lines:
        assert row["mean"] == pytest.approx(row["exact"], rel=0.08)
