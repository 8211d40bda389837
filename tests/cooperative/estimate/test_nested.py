"""A first phase on a chain of grids: zones of ranks, weights, the variance that the draws bring, and the estimate."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import norm

from cooperative.estimate import Phases, Population, Sampling, TwoPhase, Zone, all_samples, draw_samples, two_phase
from cooperative.estimate._nested import zone_variance

N = 400


def results(values):
    return {number: (float(np.exp(value)), False) for number, value in enumerate(values)}


def drawn(coarse, rough, samples, seed):
    """Population of the rough grid, of samples that the coarse one chose."""
    sampling = Sampling(len(coarse), 1.0)
    zones = draw_samples(all_samples(sampling, results(coarse)), samples, seed)
    return all_samples(replace(sampling, rough_samples=samples, zones=zones), results(rough))


@given(st.integers(1, 60), st.integers(0, 10**6))
def test_zones_are_of_successive_ranks_and_one_of_each_is_drawn(samples, seed):
    generator = np.random.default_rng(seed)
    size = samples + int(generator.integers(0, 200))
    coarse = generator.standard_normal(size)
    population = all_samples(Sampling(size, 1.0), results(coarse))
    zones = draw_samples(population, samples, seed)
    assert len(zones) == samples
    assert sum(zone.weight for zone in zones.values()) == pytest.approx(1.0)
    # The ranks of the drawn lie within their zones, laid end to end.
    rank = np.argsort(np.argsort(-coarse, kind="stable"))
    ends, by_rank = 0.0, sorted(zones, key=lambda number: rank[number])
    for number in by_rank:
        at = (rank[number] + 0.5) / size
        assert ends < at < ends + zones[number].weight + 1e-9
        ends += zones[number].weight


def test_weighted_sums_are_unbiased_even_where_the_coarse_ranks_mislead():
    generator = np.random.default_rng(1)
    coarse = generator.standard_normal(N)
    for rough in (-coarse, generator.standard_normal(N), np.abs(coarse)):
        fails = rough > 0.8
        sums = [
            population.weights @ fails[population.numbers]
            for population in (drawn(coarse, rough, 50, seed) for seed in range(300))
        ]
        assert abs(np.mean(sums) - fails.mean()) < 4 * np.std(sums) / np.sqrt(300)


def test_the_variance_of_the_draws_is_that_of_many_campaigns():
    generator = np.random.default_rng(2)
    coarse = generator.standard_normal(N)
    for correlation in (0.97, 0.5):
        rough = correlation * coarse + np.sqrt(1 - correlation**2) * generator.standard_normal(N)
        fails = rough > 0.6
        populations = [drawn(coarse, rough, 60, seed) for seed in range(400)]
        sums = [population.weights @ fails[population.numbers] for population in populations]
        expected = [zone_variance(each, fails[each.numbers].astype(float)) for each in populations]
        assert np.mean(expected) == pytest.approx(np.var(sums), rel=0.3)
    assert zone_variance(Population(np.exp(rough)), fails.astype(float)) == 0


def test_a_sample_that_is_a_zone_of_its_own_brings_no_variance():
    coarse = np.random.default_rng(3).standard_normal(50)
    everything = drawn(coarse, coarse, 50, 0)
    assert np.allclose(everything.weights, 1 / 50)
    assert zone_variance(everything, np.full(50, 0.5)) == pytest.approx(0, abs=1e-12)


def test_phases_can_follow_each_other():
    generator = np.random.default_rng(4)
    first = generator.standard_normal(N)
    second, third = (first + scale * generator.standard_normal(N) for scale in (0.3, 0.4))
    fails, sums, expected = third > 0.7, [], []
    for seed in range(300):
        middle = drawn(first, second, 150, seed)
        zones = draw_samples(middle, 50, seed)
        sampling = Sampling(N, 1.0, rough_samples=50, zones=zones)
        last = all_samples(sampling, results(third))
        assert set(last.numbers) <= set(middle.numbers)
        assert last.independent == N
        assert last.weights.sum() == pytest.approx(1.0)
        sums.append(last.weights @ fails[last.numbers])
        expected.append(zone_variance(last, fails[last.numbers].astype(float)))
    assert abs(np.mean(sums) - fails.mean()) < 4 * np.std(sums) / np.sqrt(300)
    assert np.mean(expected) == pytest.approx(np.var(sums), rel=0.3)


def test_drawn_samples_stand_for_all_only_together():
    coarse = np.random.default_rng(5).standard_normal(N)
    sampling = Sampling(N, 1.0)
    zones = draw_samples(all_samples(sampling, results(coarse)), 20, 0)
    known = results(coarse)
    del known[next(iter(zones))]
    assert all_samples(replace(sampling, rough_samples=20, zones=zones), known) is None


@given(st.lists(st.floats(1e-3, 1.0), min_size=1, max_size=30), st.booleans())
def test_the_share_of_a_screening_that_is_not_complete_is_none_or_all_where_all_answers_agree(weights, fail):
    """Of any weights: rounding makes no more failures than samples."""
    zones = {number: Zone(weight, 0.0, weight, len(weights)) for number, weight in enumerate(weights)}
    rough = dict.fromkeys(zones, (2.0 if fail else 0.5, False))
    estimate = Phases(TwoPhase(), 1.0, rough, planned=2 * len(weights), zones=zones).estimate
    assert estimate.probability == pytest.approx(float(fail))
    assert estimate.interval[0] <= estimate.probability <= estimate.interval[1]


def test_the_estimate_covers_the_truth_and_is_unbiased():
    rows = []
    for seed in range(60):
        first, second, third = np.random.default_rng(seed).standard_normal((3, 1000))
        rough = 0.97 * first + np.sqrt(1 - 0.97**2) * second
        fails = 0.95 * rough + np.sqrt(1 - 0.95**2) * third > norm.isf(0.25)
        population = drawn(first, rough, 200, seed)
        answers = dict(enumerate(fails[population.numbers].tolist()))
        estimate = two_phase(population, answers, TwoPhase(refined_runs=60, seed=seed).audit(population))
        rows.append((estimate.probability, *estimate.interval, estimate.cov))
    probability, low, high, cov = np.array(rows).T
    assert abs(probability.mean() - 0.25) < 4 * probability.std() / np.sqrt(60)
    assert np.mean((low <= 0.25) & (high >= 0.25)) > 0.9
    assert cov.mean() == pytest.approx(probability.std() / 0.25, rel=0.3)


@pytest.mark.parametrize("samples", [0, N + 1])
def test_a_number_of_samples_that_are_not_there_is_refused(samples):
    population = all_samples(Sampling(N, 1.0), results(np.zeros(N)))
    with pytest.raises(ValueError, match=f"give 1 to {N}"):
        draw_samples(population, samples, 0)
