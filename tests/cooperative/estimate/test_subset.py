"""Subset simulation: probabilities that are known, what it feeds to the audit, and plans that are none."""

import numpy as np
import pytest
from scipy.stats import norm

from cooperative.estimate import (
    AuditPlan,
    Population,
    SubsetPlan,
    subset_simulation,
    two_phase,
)
from tests.cooperative.estimate.test_twophase import answers


def test_subset_simulation_finds_a_rare_probability():
    # P(X > 3.09) = 1e-3 for one standard normal, from a few thousand samples.
    shares, weights = [], []
    for seed in range(12):
        result = subset_simulation(lambda xi: xi[:, 0], 3, SubsetPlan(per_level=200, levels=3, replicates=8, seed=seed))
        shares.append(result.weight[result.rough_displacement > norm.isf(1e-3)].sum())
        weights.append(result.weight.sum())
        assert result.rough_displacement.size == result.weight.size == result.replicate.size
        assert result.rough_runs == 8 * (200 + 3 * 180)
        np.testing.assert_array_equal(result.coefficients[:, 0], result.rough_displacement)
    np.testing.assert_allclose(weights, 1.0)
    assert np.mean(shares) == pytest.approx(1e-3, rel=0.15)


def test_subset_simulation_feeds_the_audit():
    pf, off, covered = 1e-3, [], 0
    for seed in range(40):
        result = subset_simulation(
            lambda xi: np.exp(xi[:, 0] - norm.isf(5e-4)), 3, SubsetPlan(per_level=500, levels=3, seed=seed)
        )
        failed = 0.95 * result.coefficients[:, 0] + np.sqrt(1 - 0.95**2) * result.coefficients[:, 1] > norm.isf(pf)
        population = Population(result.rough_displacement, weight=result.weight, replicate=result.replicate)
        answer = two_phase(population, answers(failed), AuditPlan(runs=200, seed=seed, growth=0.5, proving=0))
        off.append(answer.probability / pf - 1)
        covered += answer.interval[0] <= pf <= answer.interval[1]
    assert abs(np.mean(off)) < 4 * np.std(off) / np.sqrt(40)
    assert np.std(off) < 0.45
    assert covered >= 35


def deep(seed, correlation=0.98, runs=60, fails=True):
    """Six levels down to a P_f of 1e-6: its audit, and the share that fails by the levels alone."""
    pf = 1e-6
    plan = SubsetPlan(per_level=100, levels=6, replicates=8, seed=seed)
    result = subset_simulation(lambda xi: np.exp(xi[:, 0] - norm.isf(pf)), 3, plan)
    x, y = result.coefficients[:, :2].T
    failed = (correlation * x + np.sqrt(1 - correlation**2) * y > norm.isf(pf)) & fails
    population = Population(result.rough_displacement, weight=result.weight, replicate=result.replicate)
    plan = AuditPlan(runs=runs, seed=seed, growth=0.5, proving=0)
    return two_phase(population, answers(failed), plan), result.weight[result.rough_displacement > 1].sum()


def test_the_audit_of_deep_levels_looks_where_failures_are():
    estimates = [deep(seed)[0] for seed in range(12)]
    shares = np.array([each.probability for each in estimates]) / 1e-6
    # The audit drew no failure in nearly all of these while the model's tail decided where it looked.
    assert np.mean(shares == 0) <= 0.25
    assert 0.3 < np.median(shares) < 2
    covered = sum(each.interval[0] <= 1e-6 <= each.interval[1] for each in estimates)
    assert covered >= 9


def test_deep_levels_without_a_failure_have_a_limit_and_no_probability():
    widths = []
    for runs in (20, 60, 120):
        estimate, rough = deep(0, runs=runs, fails=False)
        assert (estimate.probability, estimate.interval[0]) == (0.0, 0.0)
        assert "if failures rank above what stands" in " ".join(estimate.notes)
        widths.append(estimate.interval[1] / rough)
    # It never rises, and is of the order of what fails on the rough grid.
    assert widths[0] >= widths[1] >= widths[2]
    assert widths[0] < 10


def test_subset_simulation_takes_runs_that_broke_off_for_the_largest():
    def rough(xi):
        return np.where(xi[:, 0] > 3, np.nan, xi[:, 0])

    result = subset_simulation(rough, 2, SubsetPlan(per_level=100, levels=3, replicates=2))
    assert np.isinf(result.rough_displacement).any()
    assert result.weight.sum() == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("plan", "match"),
    [
        (SubsetPlan(share=0.0), "share = 0"),
        (SubsetPlan(correlation=1.0), "correlation = 1"),
        (SubsetPlan(per_level=10, share=0.1), "1 chains"),
        (SubsetPlan(per_level=101, share=0.1), "divide evenly"),
    ],
)
def test_bad_subset_plans_are_named(plan, match):
    with pytest.raises(ValueError, match=match):
        subset_simulation(lambda xi: xi[:, 0], 2, plan)
