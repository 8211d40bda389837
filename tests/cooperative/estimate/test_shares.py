"""Shares, weights and correlations of samples that stand for different numbers of others."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import norm, pearsonr, spearmanr

from cooperative.estimate import (
    AuditPlan,
    Population,
    correlation,
    effective_size,
    sample_weights,
    shares,
    two_phase,
    wilson_interval,
)
from cooperative.estimate._twophase import path
from tests.cooperative.estimate.test_twophase import answers, pair


def test_equal_weights_give_the_plain_share_and_wilsons_interval():
    group = np.array(["deep"] * 6 + ["shallow"] * 4)
    result = shares(group, np.full(10, 0.3), ("deep", "shallow", "compound"))
    assert (result["deep"].count, result["compound"].count) == (6, 0)
    assert result["deep"].share == pytest.approx(0.6)
    assert result["deep"].interval == pytest.approx(wilson_interval(6, 10))
    assert result["compound"].interval == pytest.approx(wilson_interval(0, 10))


@given(st.lists(st.floats(0.01, 10), min_size=1, max_size=30))
def test_no_weights_tell_more_than_equal_ones(weight):
    size = effective_size(np.array(weight))
    assert 1 - 1e-9 <= size <= len(weight) + 1e-9
    assert effective_size(np.full(len(weight), weight[0])) == pytest.approx(len(weight))


def test_correlation_agrees_with_scipy_for_equal_weights():
    generator = np.random.default_rng(0)
    rough = np.exp(generator.standard_normal(60))
    refined = rough * np.exp(0.3 * generator.standard_normal(60))
    result = correlation(rough, refined, np.full(60, 0.2), failure_displacement=1.0)
    assert result.spearman == pytest.approx(spearmanr(rough, refined).statistic)
    assert result.pearson_log == pytest.approx(pearsonr(np.log(rough), np.log(refined)).statistic)
    assert result.phi == pytest.approx(np.corrcoef(rough > 1, refined > 1)[0, 1])
    assert result.same_class == pytest.approx(np.mean((rough > 1) == (refined > 1)))
    # Bonett and Wright: Fisher's z of a rank correlation has a variance of (1 + r^2 / 2) / (n - 3).
    middle = np.arctanh(result.spearman)
    half = norm.ppf(0.975) * np.sqrt((1 + result.spearman**2 / 2) / 57)
    assert np.arctanh(result.interval) == pytest.approx((middle - half, middle + half))


def test_a_weight_counts_as_so_many_samples():
    rough, refined = np.array([1.0, 2, 3, 4, 5]), np.array([1.0, 3, 2, 6, 4])
    weight = np.array([1, 2, 1, 3, 1])
    weighted = correlation(rough, refined, weight, failure_displacement=2.5)
    repeated = correlation(np.repeat(rough, weight), np.repeat(refined, weight), np.ones(8), failure_displacement=2.5)
    assert weighted.spearman == pytest.approx(repeated.spearman)
    assert weighted.phi == pytest.approx(repeated.phi)


def test_correlation_of_nothing_is_none():
    assert correlation(np.ones(3), np.arange(3.0), np.ones(3), failure_displacement=1.0) is None
    assert correlation(np.ones(9), np.arange(9.0), np.ones(9), failure_displacement=1.0) is None


def test_weights_of_refined_runs_add_up_to_unbiased_totals():
    # What the failures stand for is P_f on average, and what a mode stands for is its part.
    totals, parts, intervals = [], [], 0
    for seed in range(150):
        displacement, failed = pair(600, 0.25, 0.9, seed)
        deep = np.random.default_rng(seed).random(600) < np.clip(0.8 - 0.1 * np.log(displacement), 0, 1)
        weight = sample_weights(Population(displacement), answers(failed), AuditPlan(runs=80, seed=seed))
        runs = np.array([run for run in weight if failed[run]])
        mine = np.array([weight[run] for run in runs])
        totals.append(mine.sum() - failed.mean())
        share = shares(np.where(deep[runs], "deep", "shallow"), mine, ("deep",))["deep"]
        truth = deep[failed].mean()
        parts.append(share.share - truth)
        intervals += share.interval[0] <= truth <= share.interval[1]
    assert abs(np.mean(totals)) < 4 * np.std(totals) / np.sqrt(150)
    assert abs(np.mean(parts)) < 4 * np.std(parts) / np.sqrt(150)
    assert intervals >= 135


def test_all_runs_refined_stand_for_themselves():
    displacement, failed = pair(40, 0.25, 0.9, 0)
    weight = sample_weights(Population(displacement), answers(failed), AuditPlan(runs=40))
    assert weight == pytest.approx(dict.fromkeys(range(40), 1 / 40))


def test_the_path_ends_with_the_estimate():
    displacement, failed = pair(300, 0.25, 0.9, 1)
    arguments = Population(displacement), answers(failed), AuditPlan(runs=60, seed=2)
    way = path(*arguments)
    assert way[-1] == two_phase(*arguments)
    assert [estimate.refined_runs for estimate in way] == sorted({estimate.refined_runs for estimate in way})


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("count", [4, 20, 100_000])
def test_a_perfect_rank_correlation_lies_in_its_own_interval(sign, count):
    rough = np.arange(1.0, count + 1)
    result = correlation(rough, 10 + sign * rough / count, np.ones(count), failure_displacement=10.5)
    assert result.spearman == pytest.approx(sign)
    assert result.interval[0] <= result.spearman <= result.interval[1]
