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
from cooperative.estimate._chains import Chains
from cooperative.estimate._twophase import path
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
        answer = two_phase(population, answers(failed), AuditPlan(runs=200, seed=seed, growth=0.5, exploration=0))
        off.append(answer.probability / pf - 1)
        covered += answer.interval[0] <= pf <= answer.interval[1]
    assert abs(np.mean(off)) < 4 * np.std(off) / np.sqrt(40)
    assert np.std(off) < 0.45
    assert covered >= 35


def subset(seed, levels, correlation=0.98):
    """Levels down to a P_f that is a power of ten each: their population, and which of it fails."""
    pf = 10.0**-levels
    plan = SubsetPlan(per_level=100, levels=levels, replicates=8, seed=seed)
    result = subset_simulation(lambda xi: np.exp(xi[:, 0] - norm.isf(pf)), 3, plan)
    x, y = result.coefficients[:, :2].T
    failed = correlation * x + np.sqrt(1 - correlation**2) * y > norm.isf(pf)
    return Population(
        result.rough_displacement, weight=result.weight, replicate=result.replicate, chains=result.chains
    ), failed


def deep(seed, levels=6):
    """An audit of the levels."""
    population, failed = subset(seed, levels)
    return two_phase(population, answers(failed), AuditPlan(runs=60, seed=seed, growth=0.5, exploration=0))


@pytest.mark.slow  # 200 repetitions of ten chains in a level: half a minute.
@pytest.mark.parametrize("levels", range(2, 8))
def test_the_interval_covers_at_any_depth_with_few_chains(levels):
    covered = [low <= 10.0**-levels <= high for low, high in (deep(seed, levels).interval for seed in range(200))]
    assert np.mean(covered) >= 0.93


def test_the_interval_of_five_levels_covers():
    covered = [low <= 1e-5 <= high for low, high in (deep(seed, 5).interval for seed in range(30))]
    assert np.sum(covered) >= 28


def test_chains_show_the_variance_of_independent_levels():
    # Every level has samples of its own, of which a quarter lies above.
    generator = np.random.default_rng(1)
    replicates, levels, size, chains = 6, 3, 400, 100
    count = replicates * (levels + 1) * size
    response = generator.random(count)
    visits = np.arange(count).reshape(replicates, levels + 1, size)
    seeds = np.argsort(-response[visits[:, :levels]], axis=2)[:, :, :chains]
    rows = Chains(visits, seeds)
    failed = np.zeros(count)
    failed[visits[:, levels]] = response[visits[:, levels]] > 0.75
    # Three levels of a quarter, and a quarter of the last one that fails.
    assert rows.relative_variance(failed) == pytest.approx((1 + 3 / size) ** 4 / replicates - 1 / replicates, rel=0.15)
    order = generator.permutation(count)
    moved = rows.moved(np.argsort(order))
    assert moved.relative_variance(failed[order]) == rows.relative_variance(failed)


def test_chains_that_stand_still_count_once():
    # Ten chains of ten samples that are all alike are ten samples.
    visits = np.concatenate([np.arange(100), np.tile(np.arange(100, 110), 10)]).reshape(1, 2, 100)
    chains = Chains(visits, np.arange(10).reshape(1, 1, 10))
    value = np.zeros(110)
    value[[100, 103, 104, 107, 108]] = 1.0
    line = np.linspace(-1, 1, 10)
    slope = float(value[100:] @ line / (line @ line))
    last = (10 * 0.25 - slope**2 * float(line @ line)) / 8 / 10 / 0.5**2
    worth = np.append(0.5 + slope * line, np.zeros(90))
    first = worth.var(ddof=1) / 100 / worth.mean() ** 2
    assert chains.relative_variance(value) == pytest.approx((1 + last) * (1 + first) - 1)


def test_every_sample_of_a_level_is_a_visit():
    plan = SubsetPlan(per_level=100, levels=3, replicates=2)
    result = subset_simulation(lambda xi: xi[:, 0], 2, plan)
    visits, seeds = result.chains.visits, result.chains.seeds
    assert visits.shape == (2, 4, 100)
    assert seeds.shape == (2, 3, 10)
    assert set(visits.ravel()) == set(range(result.number.size))
    for replicate, level in np.ndindex(2, 3):
        at = visits[replicate, level]
        # The chains of a level start where its best samples are, by falling response.
        started = result.rough_displacement[at[seeds[replicate, level]]]
        np.testing.assert_array_equal(started, np.sort(result.rough_displacement[at])[::-1][:10])
        np.testing.assert_array_equal(visits[replicate, level + 1][:10], at[seeds[replicate, level]])


def test_the_audit_of_deep_levels_looks_where_failures_are():
    estimates = [deep(seed) for seed in range(12)]
    shares = np.array([each.probability for each in estimates]) / 1e-6
    # The audit drew no failure in nearly all of these while the model's tail decided where it looked.
    assert np.mean(shares == 0) <= 0.25
    assert 0.3 < np.median(shares) < 2
    covered = sum(each.interval[0] <= 1e-6 <= each.interval[1] for each in estimates)
    assert covered >= 9


def test_deep_levels_without_a_failure_have_a_limit_and_no_probability():
    population, failed = subset(0, 6)
    stands = answers(np.zeros_like(failed))
    estimates = path(population, stands, AuditPlan(runs=120, growth=0.5, exploration=0))
    rough = population.weights[population.rough_displacement > 1].sum()
    for estimate in estimates:
        assert (estimate.probability, estimate.interval[0]) == (0.0, 0.0)
        assert "if failures rank above what stands" in " ".join(estimate.notes)
    widths = [estimate.interval[1] / rough for estimate in estimates]
    # It never rises, and is of the order of what fails on the rough grid.
    assert len(widths) > 4
    assert np.all(np.diff(widths) <= 0)
    assert widths[2] < 10


def test_subset_simulation_takes_runs_that_broke_off_for_the_largest():
    def rough(xi):
        return np.where(xi[:, 0] > 3, np.nan, xi[:, 0])

    result = subset_simulation(rough, 2, SubsetPlan(per_level=100, levels=3, replicates=2))
    assert np.isinf(result.rough_displacement).any()
    assert result.weight.sum() == pytest.approx(1.0)


def test_chains_without_correlation_draw_anew():
    # A chain takes what lies in the top tenth, evenly by probability.
    plan = SubsetPlan(per_level=1000, levels=1, correlation=0.0)
    result = subset_simulation(lambda xi: xi[:, 0], 1, plan)
    taken = result.coefficients[result.number % (plan.rough_runs // plan.replicates) >= plan.per_level, 0]
    assert norm.sf(np.quantile(taken, [0.25, 0.5, 0.75])) == pytest.approx([0.075, 0.05, 0.025], abs=0.01)


@pytest.mark.parametrize(
    ("plan", "match"),
    [
        (SubsetPlan(level_probability=0.0), "level_probability = 0"),
        (SubsetPlan(correlation=1.0), "correlation = 1"),
        (SubsetPlan(per_level=10, level_probability=0.1), "1 chains"),
        (SubsetPlan(per_level=101, level_probability=0.1), "divide evenly"),
    ],
)
def test_bad_subset_plans_are_named(plan, match):
    with pytest.raises(ValueError, match=match):
        subset_simulation(lambda xi: xi[:, 0], 2, plan)
