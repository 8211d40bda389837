"""The benchmark of estimators: campaigns that end by the coefficient of variation that they claim."""

from concurrent.futures import Future
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import spearmanr

from benchmarks.speed.campaign import PLAN
from benchmarks.statistics import estimators, estimators_campaigns

CASE = estimators.target_cases()[-1]


@pytest.fixture(scope="module")
def rows():
    return estimators.repeat(CASE, 0, 30)


def test_campaigns_that_ask_for_a_target_end_by_it(rows):
    assert (CASE.samples, CASE.target_cov) == (PLAN["samples"], PLAN["target_cov"])
    claimed, runs = rows[:, 4], rows[:, 5]
    # The number of runs is fixed before the last of them: what is claimed in the end scatters about the target.
    assert claimed.mean() < 0.1
    assert np.all(claimed < 0.115)
    assert np.all((runs >= 16) & (runs < CASE.runs))
    assert len(set(runs)) > 3
    unmet = estimators.repeat(replace(CASE, runs=16), 0, 5)
    assert np.all(unmet[:, 5] == 16)
    assert np.any(unmet[:, 4] > 0.1)


def test_its_quartiles_are_of_refined_runs_and_its_error_is_the_true_one(rows):
    row = estimators.summarise(CASE, rows)
    runs = np.sort(rows[:, 5])
    assert [row["runs_q25"], row["runs_q50"], row["runs_q75"]] == [runs[7], runs[14], runs[22]]
    assert row["rmse"] == pytest.approx(np.sqrt(np.mean((rows[:, 0] / 0.28 - 1) ** 2)))
    assert row["claimed"] == rows[:, 4].mean()
    values = estimators.target_values([row])
    assert values["target_cov_runs_q50_r098"] == row["runs_q50"]
    assert values["target_cov_rmse_r098"] == row["rmse"]
    assert "target_cov_coverage_sampling_r098" in values


def test_cases_that_spend_their_runs_have_no_target_in_their_row():
    plain = estimators.Case("two-phase", 0.244, 0.95, 100, 20)
    assert "target_cov" not in estimators.summarise(plain, estimators.repeat(plain, 0, 2))


@pytest.mark.parametrize(("link", "better"), [("Clayton", False), ("Gumbel", True)])
def test_links_have_their_probability_and_rank_correlation_and_tails(link, better):
    case = estimators.Case("two-phase", 0.1, 0.85, 20_000, 20, link=link)
    displacement, failed = estimators_campaigns.draw(case, np.random.default_rng(1))
    assert failed.mean() == pytest.approx(0.1, abs=0.008)
    # The response itself, by the share of samples that exceed ever higher limits.
    generator, rank = np.random.default_rng(1), np.zeros(case.samples)
    state = generator.bit_generator.state
    for pf in np.arange(0.005, 1.0, 0.005):
        generator.bit_generator.state = state
        rank += estimators_campaigns.draw(replace(case, pf=pf), generator)[1]
    assert spearmanr(displacement, rank).statistic == pytest.approx(0.85, abs=0.01)
    # Of the failures, those among the tenth that the rough grid ranks worst: where both tails hang together, more.
    worst = displacement >= np.quantile(displacement, 0.9)
    normal = replace(case, link="normal", correlation=0.862)
    of_normal, fails = estimators_campaigns.draw(normal, np.random.default_rng(1))
    both = fails[of_normal >= np.quantile(of_normal, 0.9)].mean()
    assert bool(failed[worst].mean() > both) is better


def test_links_are_judged_where_750_samples_can_reach_the_target():
    cases = estimators.link_cases()
    assert {case.pf for case in cases} == {0.1, 0.244}
    names = ("method", "link", "rmse", "claimed", "bias", "bias_error", "coverage")
    table = (
        ("two-phase", "normal", 0.1, 0.1, -0.02, 0.003, 0.97),
        ("two-phase", "Clayton", 0.21, 0.2, 0.01, 0.004, 0.96),
        ("two-phase", "both ends", 0.5, 0.2, 0.1, 0.01, 0.93),
        ("Monte Carlo", "normal", 0.24, 0.2, -0.03, 0.005, 0.91),
    )
    result = estimators.link_values([dict(zip(names, row, strict=True)) for row in table])
    assert result["target_cov_rmse_over_claimed_max"] == pytest.approx(1.05)
    assert (result["target_cov_bias_max"], result["target_cov_coverage_both_ends_min"]) == (0.02, 0.93)
    assert result["target_cov_rmse_over_claimed_in_order_max"] == pytest.approx(1.2)
    assert result["target_cov_bias_in_order_max"] == 0.03


def test_a_benchmark_that_was_stopped_goes_on_from_its_pieces(tmp_path, monkeypatch):
    case = estimators.Case("two-phase", 0.244, 0.95, 60, 16)
    asked = []

    class AtOnce:
        def __enter__(self):
            return self

        def __exit__(self, *_):
            pass

        def submit(self, act, folder, name, make):
            asked.append(not (folder / f"{name}.json").exists())
            done = Future()
            done.set_result(act(folder, name, make))
            return done

    monkeypatch.setattr(estimators, "ROOT", tmp_path)
    monkeypatch.setattr(estimators, "process_pool", lambda count: AtOnce())
    (tmp_path / "cooperative" / "estimate").mkdir(parents=True)
    (first,) = estimators.measured([(estimators.repeat, case, 4)], quick=True)
    np.testing.assert_array_equal(first, estimators.repeat(case, 0, 4))
    (again,) = estimators.measured([(estimators.repeat, case, 4)], quick=True)
    np.testing.assert_array_equal(again, first)
    assert asked == [True, True, False, False]


def test_campaigns_whose_runs_all_end_alike_are_covered_and_judged_by_the_binomial_limit():
    cases = estimators.alike_cases()
    assert {(case.pf, case.samples) for case in cases} == {
        (pf, samples) for pf in (0.0, 1e-6, 1e-4, 1.0) for samples in (60, 200, 750)
    }
    rows = [estimators.alike_row(case, estimators.repeat(case, 0, 4)) for case in cases if case.samples == 60]
    values = estimators.alike_values(rows)
    assert values["coverage_without_failures_min"] == 1
    assert 1 <= values["upper_without_failures_over_binomial_max"] <= 1.5
    # Coverage and width are of the interval itself.
    case = estimators.Case("two-phase", 1e-4, 0.95, 60, 20)
    row = estimators.alike_row(case, np.array([[0, 0, 0.2, 0, 0, 20, 0, 0], [0.1, 0.01, 0.3, 0, 0, 20, 0, 0]]))
    assert (row["coverage"], row["alike"]) == (0.5, 0.5)
    assert row["open_over_binomial"] == pytest.approx(0.2 / (1 - 0.05 ** (1 / 20)))
