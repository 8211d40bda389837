"""Limit states of otbenchmark: that they are those, and that repetitions are counted as they should be."""

import math

import numpy as np
import pytest
from scipy import stats

from benchmarks.public import public, reliability
from benchmarks.public.reliability import PROBLEMS, Answer
from cooperative import monte_carlo

EXACT = {
    "R-S": stats.norm.cdf(-2 / math.sqrt(2)),
    "RP54": stats.gamma(20).cdf(8.951),
    "RP60": 0.0448397,
    "RP75": 0.00981929872154727,
    "RP8": 0.0007897942931,
    "RP14": 0.0007728524228,
}
"""Closed forms, and integrals of otbenchmark's data, whose README says how they were found."""


@pytest.mark.parametrize("name", EXACT)
def test_limit_states_fail_as_often_as_is_known(name):
    problem, size = PROBLEMS[name], 200_000
    failed = int((problem(np.random.default_rng(3).standard_normal((size, problem.size))) < 0).sum())
    low, high = stats.binom(size, EXACT[name]).interval(1 - 1e-4)
    assert low <= failed <= high


@pytest.mark.parametrize("name", PROBLEMS)
def test_gradients_are_the_slopes_of_the_limit_state(name):
    problem = PROBLEMS[name]
    at, along = np.random.default_rng(0).standard_normal((2, problem.size)) / 2
    value, gradient = problem.gradient(at)
    near = problem(np.stack([at + 1e-5 * along, at - 1e-5 * along, at]))
    assert near[2] == value
    assert (near[0] - near[1]) / 2e-5 == pytest.approx(gradient @ along, rel=1e-3, abs=1e-6 * abs(value))


def test_a_plane_limit_state_has_its_design_point_and_the_exact_answer():
    centres, calls = reliability.searched(PROBLEMS["RP107"])
    assert np.linalg.norm(centres[0]) == pytest.approx(5.0, rel=2e-2)
    assert calls % 21 == 0  # each gradient by differences of ten variables
    answer = reliability.by_importance(PROBLEMS["RP107"], 0.0, 1, centres=centres, search=calls)
    assert answer.interval[0] <= stats.norm.sf(5) <= answer.interval[1]
    assert answer.calls >= 1000 + calls


def test_estimators_are_those_that_a_limit_state_suits():
    assert set(reliability.estimators(PROBLEMS["RP107"], 2.9e-7)) == {"importance sampling", "subset simulation"}
    assert "two-phase" not in reliability.estimators(PROBLEMS["RP75"], 0.0098)  # flat at the median
    assert {"two-phase", "control variate", "Monte Carlo"} <= set(reliability.estimators(PROBLEMS["RP53"], 0.031))


def test_monte_carlo_holds_as_often_as_it_says():
    pf = 0.003226681209587809  # of RP31
    samples = math.ceil(100 / pf)
    counts = np.arange(40, 180)
    intervals = [monte_carlo(np.arange(samples) < count).interval for count in counts]
    held = [low <= pf <= high for low, high in intervals]
    assert float(stats.binom.pmf(counts, samples, pf) @ held) == pytest.approx(0.95, abs=2e-3)


def test_an_estimator_that_seldom_holds_is_repeated_more_often_from_the_same_seeds():
    def run(seed):
        return Answer(0.1, (0.05, 0.05 if seed % 100 < 8 and seed < 500 else 0.15), 100)

    def coverage(run, times):
        rows = reliability.repeated("a", "b", run, 0.1, times, ours=True)
        return {row["quantity"]: row["ours"] for row in rows if row["quantity"].startswith("coverage")}

    seldom, of_all = "coverage of the 95 % interval", "coverage of 1000 such intervals"
    assert coverage(run, 100) == {seldom: 0.92, of_all: 0.96}
    assert coverage(run, 50) == {seldom: 0.84}  # too few to tell
    assert coverage(lambda seed: run(seed + 500), 100) == {seldom: 1.0}


def test_repetitions_are_counted():
    answers = [Answer(0.1, (0.05, 0.15), 100), Answer(0.3, (0.25, 0.35), 300)]
    rows = reliability.repeated("a", "b", lambda seed: answers[seed], 0.1, 2, ours=True)
    ours = {row["quantity"]: row["ours"] for row in rows}
    assert ours["coverage of the 95 % interval"] == 0.5
    assert ours["mean P_f"] == pytest.approx(0.2)
    assert ours["calls"] == 200
    assert ours["root mean square error over P_f"] == pytest.approx(math.sqrt(2), rel=1e-5)
    assert ours["calls for an error of 10 %"] == pytest.approx(200 * 200, rel=1e-4)
    assert [row["figure"] for row in rows].count("reliability_coverage_min") == 1
    others = reliability.repeated("a", "b", lambda seed: answers[seed], 0.1, 2, ours=False)
    assert not any(row["figure"] for row in others)


def test_openturns_agrees_where_it_is_installed():
    pytest.importorskip("openturns")
    answer = reliability.by_openturns(PROBLEMS["R-S"], "Monte Carlo", 1)
    assert answer.interval[0] < EXACT["R-S"] < answer.interval[1]
    assert answer.calls > 500


def test_cases_that_are_left_out_say_so(monkeypatch, tmp_path):
    made = {"first": lambda: [{"case": "first"}], "second": lambda: [{"case": "second"}]}
    monkeypatch.setattr(public, "FAMILIES", {"family": lambda data, quick: made})
    monkeypatch.setattr(public, "stored", lambda family: tmp_path)
    rows = list(public.rows(tmp_path, quick=True, only=["fi"]))
    assert (rows[0]["name"], rows[0]["case"]) == ("first", "first")
    assert rows[1]["case"] == "second"
    assert rows[1]["quantity"] == "not run"
    assert public.summarised(rows[1:])["exact_error_max"] is None
    both = list(public.rows(tmp_path, quick=True))
    assert "quantity" not in both[1]
    assert list(public.rows(tmp_path, quick=True, only=["first"])) == both  # made before
    with pytest.raises(ValueError, match="--only third: no case begins so, give beginnings of first, second"):
        list(public.rows(tmp_path, quick=True, only=["third"]))
