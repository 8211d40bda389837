"""Limits of P_f where all refined runs end alike: exact, wherever failures hide, and lower with every run."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import hypergeom, sem

from cooperative.estimate import AuditPlan, Population, TwoPhase, Zone, draw_samples, exact_limit, two_phase
from cooperative.estimate._audit import UNPROVEN, Wave, draw_wave
from cooperative.estimate._estimates import lognormal_limits
from cooperative.estimate._one_outcome import even_chance, even_limit, missed, ranked_limit
from cooperative.estimate._twophase import path

COUNTS = ((10, 10), (60, 12), (60, 20), (60, 60), (200, 40), (750, 60), (750, 150))


def campaign(samples, runs, outcome, seed=0):
    displacement = np.exp(np.random.default_rng(seed).standard_normal(samples) - 2)
    return Population(displacement), dict.fromkeys(range(samples), outcome), AuditPlan(runs=runs, seed=seed)


def ordered(order, model, even):
    """Waves of two draws each that come in this order, none of which fails, and the probability of that order."""
    known, waves, probability = np.zeros(model.size, bool), [], 1.0
    for first in range(0, len(order), 2):
        wave = draw_wave(
            np.random.default_rng(0),
            model,
            weight=np.full(model.size, 1 / model.size),
            finished=known,
            size=2,
            floor=even,
        )
        ranks = np.array(order[first : first + 2])
        chances = wave.chance[ranks]
        each = chances / (1 - np.concatenate([[0.0], np.cumsum(chances)[:-1]]))
        waves.append(Wave(ranks, each, wave.chance, model, even))
        probability *= each.prod()
        known[ranks] = True
    return waves, probability


@pytest.mark.parametrize("even", [1.0, UNPROVEN, 0.2])
@pytest.mark.parametrize("draws", [2, 4])
def test_no_set_of_failures_is_missed_more_often_than_the_limit_allows(draws, even):
    # All orders of draws, each weighed by its probability, and all sets of failures.
    count, model = 6, np.array([0.5, 0.5, 0.4, 0.1, 0.01, 0.001])
    ways = [(order, *ordered(order, model, even)) for order in itertools.permutations(range(count), draws)]
    assert sum(chance for _, _, chance in ways) == pytest.approx(1.0)
    allowed = missed(even_chance(ways[0][1]), np.arange(count + 1), 0)
    if even == 1:
        np.testing.assert_allclose(allowed, hypergeom.pmf(0, count, np.arange(count + 1), draws), atol=1e-12)
    for size in range(1, count + 1):
        for failing in itertools.combinations(range(count), size):
            misses = sum(chance for order, _, chance in ways if not set(order) & set(failing))
            assert misses <= allowed[size] + 1e-12
            # The last rank, which the model takes to stand, is missed nearly as often.
            assert size > 1 or failing != (count - 1,) or misses >= 0.8 * allowed[1]


@given(st.integers(1, 30), st.integers(0, 4), st.data())
def test_even_draws_meet_failures_as_those_without_replacement_do(samples, unanswered, data):
    draws, failures = data.draw(st.integers(0, samples)), np.arange(samples + 1)
    at_most = hypergeom.cdf(unanswered, samples, failures, draws)
    np.testing.assert_allclose(missed(1 / (samples - np.arange(draws)), failures, unanswered), at_most, atol=1e-12)


@pytest.mark.parametrize(("samples", "runs"), COUNTS)
def test_runs_that_all_end_alike_leave_at_most_half_more_open_than_as_many_even_draws(samples, runs):
    none, every = (two_phase(*campaign(samples, runs, outcome)) for outcome in (False, True))
    assert (none.probability, none.interval[0], none.cov) == (0.0, 0.0, np.inf)
    assert (every.probability, every.interval[1]) == (1.0, 1.0)
    assert 1 - every.interval[0] == pytest.approx(none.interval[1])
    assert exact_limit(runs) * (1 - 1e-9) <= none.interval[1] <= 1.5 * exact_limit(runs)
    assert none.sampling_interval == (0.0, pytest.approx(exact_limit(samples)))
    assert none.hidden_limit == (none.interval[1] if runs < samples else 0.0)


@settings(max_examples=30, deadline=None)
@given(st.integers(10, 400), st.floats(0.05, 1.0), st.booleans(), st.integers(0, 100))
def test_every_wave_narrows_what_is_open(samples, part, outcome, seed):
    population, answers, plan = campaign(samples, max(int(part * samples), 10), outcome, seed)
    widths = [np.diff(each.interval)[0] for each in path(population, answers, plan)]
    assert np.all(np.diff(widths) < 0)
    assert widths[-1] >= exact_limit(plan.runs) * (1 - 1e-9)
    # So does a larger budget, up to all samples.
    more = two_phase(population, answers, replace(plan, runs=min(plan.runs + 1, samples)))
    assert np.diff(more.interval)[0] <= widths[-1] * (1 + 1e-12)


@pytest.mark.parametrize("level", [0.3, 0.5, 0.8])
def test_the_limit_of_trusted_ranks_is_the_fewest_first_ones_that_the_draws_would_have_met(level):
    # The chance of each draw to meet one of the first ranks, given the draws before it: of all orders that begin so.
    count, model = 6, np.array([0.5, 0.5, 0.4, 0.3, 0.3, 0.1])
    ways = {order: ordered(order, model, 0.2) for order in itertools.permutations(range(count))}
    chance: dict[tuple[int, ...], float] = {}
    for order, (_, probability) in ways.items():
        for n in range(count + 1):
            chance[order[:n]] = chance.get(order[:n], 0.0) + probability
    for order, (waves, _) in ways.items():
        limit = 1.0
        for draws in (2, 4, 6):
            finished = np.isin(np.arange(count), order[:draws])
            missed_by = np.ones(count)
            for n in range(draws):
                each = [0.0 if finished[rank] else chance[(*order[:n], rank)] for rank in range(count)]
                missed_by *= 1 - np.cumsum(each) / chance[order[:n]]
            fewest = int((missed_by > 1 - level).sum()) + 1
            limit = min(min(fewest / count, 1.0) + exact_limit(count, level), limit)
            told = ranked_limit(waves[: draws // 2], finished, np.full(count, 1 / count), None, level=level)
            assert told == pytest.approx(limit)


@pytest.mark.parametrize("draws", [2, 6, 10])
def test_the_weight_of_trusted_ranks_is_as_uncertain_as_its_replicates_show(draws):
    generator = np.random.default_rng(draws)
    weight, replicate = generator.dirichlet(np.full(40, 5.0)), generator.permutation(np.arange(40) % 4)
    model, finished = np.linspace(0.4, 0.001, 40), np.arange(40) < draws
    wave = draw_wave(np.random.default_rng(0), model, weight=weight, finished=np.zeros(40, bool), size=draws, floor=0.2)
    known = ranked_limit([wave], finished, weight, None, level=0.9) - exact_limit(40, 0.9)
    first = int(np.argmin(np.abs(np.cumsum(weight) - known))) + 1
    totals = np.bincount(replicate[:first], weight[:first], 4)
    limit = lognormal_limits(known, sem(totals) / totals.mean(), 3, 0.8)[1]
    assert ranked_limit([wave], finished, weight, replicate, level=0.9) == pytest.approx(limit)
    assert limit < 1


@pytest.mark.parametrize("where", ["bottom", "anywhere"])
def test_the_limit_covers_wherever_the_failures_hide(where):
    # A P_f just above the limit of 20 runs without a failure: such campaigns are to come once in 20 times at most.
    samples, runs, repeats = 60, 20, 250
    pf = two_phase(*campaign(samples, runs, False)).interval[1] * 1.001
    missed_all, generator = 0, np.random.default_rng(1)
    for seed in range(repeats):
        rough = generator.standard_normal(samples)
        failed = generator.random(samples) < pf
        if where == "bottom":
            failed[np.argsort(rough)] = np.sort(~failed) < 1
        answers = dict(enumerate(failed.tolist()))
        estimate = two_phase(Population(np.exp(rough - 2)), answers, AuditPlan(runs=runs, seed=seed))
        missed_all += estimate.probability == 0
    assert missed_all / repeats <= 0.05 + 3 * np.sqrt(0.05 * 0.95 / repeats)
    assert missed_all


def test_what_gave_no_answer_may_have_failed():
    population, answers, plan = campaign(200, 40, False)
    drawn = list(answers)
    limits = [two_phase(population, answers, plan).interval[1]]
    for lost in (1, 3):
        limits.append(two_phase(population, answers | dict.fromkeys(drawn[: lost * 20], None), plan).interval[1])
    assert limits == sorted(limits)
    assert limits[0] < limits[-1]
    # All drawn evenly: the binomial limit of j failures among n.
    chance = 1 / (5000.0 - np.arange(30))
    assert even_limit(chance, 5000, unknown=4970, unanswered=2, level=0.95) == pytest.approx(0.1953, rel=2e-2)
    assert even_limit(chance, 5000, unknown=4970, level=0.95) == pytest.approx(exact_limit(30), rel=1e-6)


def test_what_ran_for_certain_without_an_answer_opens_itself_alone():
    population, answers, plan = campaign(200, 43, False)
    broken = replace(population, rough_displacement=np.append(np.full(3, np.nan), population.rough_displacement[3:]))
    lost = answers | dict.fromkeys(range(3), None)
    before, after = (two_phase(broken, each, plan).interval[1] for each in (answers, lost))
    assert before < after < before + 2 * 3 / 200


@pytest.mark.parametrize(("coarse", "rough", "runs"), [(2000, 200, 40), (300, 60, 60)])
def test_samples_that_stand_for_zones_leave_as_much_open_as_their_heaviest(coarse, rough, runs):
    generator = np.random.default_rng(0)
    first = Population(np.exp(generator.standard_normal(coarse) - 2))
    zones: dict[int, Zone] = draw_samples(first, rough, 0)
    weight = np.array([zone.weight for zone in zones.values()])
    population = Population(
        np.exp(generator.standard_normal(rough) - 2), weight=weight, number=np.array(list(zones)),
        zones=tuple(zones.values()),
    )  # fmt: skip
    answers = dict.fromkeys(range(rough), False)
    limits = [each.interval[1] for each in path(population, answers, AuditPlan(runs=runs))]
    assert np.all(np.diff(limits) < 0)
    # Equal zones would leave the limit of as many even draws.
    assert exact_limit(runs) <= limits[-1] <= 2 * exact_limit(runs) * rough * weight.max()


def test_a_target_is_not_met_without_a_failure():
    population, _, _ = campaign(200, 40, False)
    estimator = TwoPhase(target_cov=0.2)
    asked: dict[int, bool | None] = {}
    while wanted := estimator.next_runs(population, asked, 4, ()):
        asked |= dict.fromkeys(wanted, False)
    assert len(asked) >= 40
    assert estimator.estimate(population, asked).cov == np.inf
    assert "no refined run has failed" in str(estimator.why_finished(population, asked))


def test_a_wave_under_way_is_named():
    population, answers, plan = campaign(60, 60, True)
    late = {sample: fails for sample, fails in answers.items() if sample != 7}
    assert "runs of the wave under way are back; they count once all are" in " ".join(
        two_phase(population, late, plan).notes
    )
    assert not any("under way" in note for note in two_phase(population, answers, plan).notes)
