"""The two-phase estimator: exactly unbiased, covering, and the same whatever ran when."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import kurtosis, norm

from cooperative.estimate import (
    AuditPlan,
    Population,
    next_audit,
    two_phase,
    wilson_interval,
)
from cooperative.estimate import _audit as audit_module
from cooperative.estimate import _twophase as two_phase_module
from cooperative.estimate._audit import (
    audit_total,
    draw_wave,
)
from cooperative.estimate._estimates import count_interval
from cooperative.estimate._logistic import fit_logistic, predict_logistic
from cooperative.estimate._twophase import target_weights, weights_by_order


def pair(count, pf, correlation, seed):
    generator = np.random.default_rng(seed)
    rough, other = generator.standard_normal((2, count))
    refined = correlation * rough + np.sqrt(1 - correlation**2) * other
    return np.exp(rough - norm.isf(pf / 2)), refined > norm.isf(pf)


def answers(failed):
    return dict(enumerate(failed.tolist()))


def test_the_logistic_fit_is_the_posterior_mode():
    generator = np.random.default_rng(0)
    score = generator.standard_normal(50)
    failed = (generator.random(50) < 1 / (1 + np.exp(-3 * (score - 0.4)))).astype(float)
    a, b = fit_logistic(score, failed, 0.7)

    def log_posterior(a, b):
        p = predict_logistic((a, b), score, 0.7)
        return np.sum(np.log(np.where(failed == 1, p, 1 - p))) - a**2 / 18 - (b - 4) ** 2 / 8

    best = log_posterior(a, b)
    for da, db in itertools.product((-1e-3, 0, 1e-3), repeat=2):
        assert log_posterior(a + da, b + db) <= best + 1e-12


def test_draws_have_the_probabilities_they_claim():
    generator = np.random.default_rng(0)
    model, weight = np.array([0.9, 0.5, 0.2, 0.01, 0.5]), np.full(5, 0.2)
    known = np.array([False, False, False, False, True])
    counts: dict[tuple[int, int], int] = {}
    claimed: dict[tuple[int, int], float] = {}
    for _ in range(20_000):
        wave = draw_wave(generator, model, weight=weight, finished=known, size=2, floor=0.2)
        pair_drawn = (int(wave.ranks[0]), int(wave.ranks[1]))
        counts[pair_drawn] = counts.get(pair_drawn, 0) + 1
        claimed[pair_drawn] = float(wave.probability.prod())
    assert sum(claimed.values()) == pytest.approx(1.0)
    assert all(4 not in pair_drawn for pair_drawn in counts)
    for pair_drawn, probability in claimed.items():
        assert counts[pair_drawn] / 20_000 == pytest.approx(probability, abs=4 * np.sqrt(probability / 20_000))


@pytest.mark.parametrize("outcome", [(1, 0, 1, 0), (0, 0, 0, 1), (1, 1, 1, 1), (0, 0, 0, 0)])
def test_the_ordered_estimate_is_exactly_unbiased(outcome):
    # All ordered pairs of draws, each weighed by its probability, with a second wave that adapts to the first.
    outcome = np.array(outcome, dtype=float)
    weight = np.array([0.1, 0.2, 0.3, 0.4])
    first_model = np.array([0.9, 0.6, 0.3, 0.05])
    expectation = variance = square = 0.0
    by_group = np.zeros(3)
    for i, j in itertools.permutations(range(4), 2):
        known = np.zeros(4, dtype=bool)
        waves, probability = [], 1.0
        for rank in (i, j):
            model = first_model if rank == i else np.clip(0.5 * first_model + 0.5 * outcome[i], 0.01, 0.99)
            chance = np.where(known, 0.0, weight * np.sqrt(model * (1 - model)))
            chance /= chance.sum()
            waves.append(audit_module.Wave(np.array([rank]), chance[[rank]], chance, model))
            probability *= chance[rank]
            known[rank] = True
        groups = np.array([0, 1, 1, 2])
        result = audit_total(
            waves,
            outcome,
            np.zeros(0, int),
            weight=weight,
            model=first_model,
            draw_weight=weights_by_order(0, 2),
            group=groups,
        )
        by_group += probability * result.by_group
        assert result.by_group.sum() == pytest.approx(result.total)
        expectation += probability * result.total
        square += probability * result.total**2
        variance += probability * result.variance
    assert expectation == pytest.approx(float(weight @ outcome), abs=1e-12)
    truth_by_group = [weight[0] * outcome[0], weight[1:3] @ outcome[1:3], weight[3] * outcome[3]]
    np.testing.assert_allclose(by_group, truth_by_group, atol=1e-12)
    # The spread of two draws is a rough estimate of the variance, of the right size on average.
    truth = square - expectation**2
    assert 0.5 * truth - 1e-12 <= variance <= 1.5 * truth + 1e-12


@pytest.mark.parametrize("failed", [1, 2, 10])
def test_draws_count_by_the_kurtosis_of_their_outcomes(failed):
    # Of very many samples one draw hardly changes the rest: each draw's total is its own outcome.
    even, outcome = np.full(10**5, 1e-5), np.zeros(10**5)
    outcome[:failed] = 1
    wave = audit_module.Wave(np.arange(20), even[:20], even, np.full(10**5, 0.1))
    result = audit_total(
        [wave], outcome, np.zeros(0, int), weight=even, model=wave.model, draw_weight=np.full(20, 1 / 20)
    )
    assert result.effective_draws == pytest.approx(20 / kurtosis(outcome[:20], fisher=False), rel=1e-3)


def test_all_samples_known_gives_the_exact_share():
    displacement, failed = pair(40, 0.3, 0.9, 0)
    estimate = two_phase(Population(displacement), answers(failed), AuditPlan(runs=40))
    assert estimate.probability == pytest.approx(failed.mean())
    assert estimate.audit_variance == 0.0
    assert estimate.interval == pytest.approx(wilson_interval(int(failed.sum()), 40))


@pytest.mark.parametrize("outcome", [False, True])
def test_few_samples_that_all_end_alike_leave_the_probability_open(outcome):
    displacement, _ = pair(10, 0.3, 0.9, 0)
    estimate = two_phase(Population(displacement), dict.fromkeys(range(10), outcome), AuditPlan(runs=10))
    assert estimate.probability == outcome
    assert estimate.interval == estimate.sampling_interval == pytest.approx(count_interval(10 * outcome, 10))


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 1000), st.randoms(use_true_random=False))
def test_runs_asked_for_one_by_one_in_any_order_give_the_same_answer(seed, random):
    displacement, failed = pair(120, 0.2, 0.9, seed)
    displacement[:2] = np.nan
    plan = AuditPlan(runs=40, seed=seed)
    results: dict[int, bool | None] = {}
    while wanted := next_audit(Population(displacement), results, plan):
        assert not set(wanted) & results.keys()
        for sample in random.sample(wanted, random.randint(1, len(wanted))):
            results[sample] = bool(failed[sample])
    assert len(results) == 40
    assert {0, 1} <= results.keys()
    assert two_phase(Population(displacement), results, plan) == two_phase(
        Population(displacement), answers(failed), plan
    )


def test_a_target_stops_the_audit_early():
    displacement, failed = pair(800, 0.244, 0.98, 1)
    target = two_phase(Population(displacement), answers(failed), AuditPlan(runs=400, target_cov=0.12))
    assert target.cov == pytest.approx(0.12, abs=0.02)
    assert target.refined_runs < 100
    # What the target does not need before the budget ends is shared out as without one.
    unmet = two_phase_module._replay(Population(displacement), answers(failed), AuditPlan(runs=40, target_cov=0.01))
    np.testing.assert_allclose(unmet.draw_weight, weights_by_order(0, 40) / weights_by_order(0, 40).sum())


@given(st.lists(st.floats(0.0, 0.2), min_size=30, max_size=30), st.integers(9, 200), st.integers(1, 12), st.booleans())
def test_shares_add_up_to_one_whatever_the_target_needs(needed, budget, size, early):
    rest, drawn, shares = 1.0, 0, []
    for need in itertools.cycle(needed):
        some = min(size, budget - drawn)
        share = target_weights(need * early, rest, before=drawn, size=some, budget=budget - drawn)
        assert 0 < share.size <= some
        assert np.all(share > 0)
        shares.append(share)
        rest, drawn = rest - share.sum(), drawn + share.size
        if rest < 1e-9 or drawn == budget:
            break
    assert np.concatenate(shares).sum() == pytest.approx(1.0)
    if not early:
        np.testing.assert_allclose(
            np.concatenate(shares), weights_by_order(0, budget) / weights_by_order(0, budget).sum()
        )


@pytest.mark.parametrize("failing", [{1, 3}, {5}])
def test_an_audit_that_ends_by_its_target_is_exactly_unbiased(failing, monkeypatch):
    # All orders of draws, each weighed by its probability: the audit looks after every wave whether it may end.
    count, plan = 6, AuditPlan(runs=5, target_cov=0.8, first_wave=2, growth=1.0, exploration=2)
    population, outcome = Population(np.exp(-np.arange(float(count)))), {n: n in failing for n in range(count)}

    def drawing(ordered):
        def draw(generator, model, *, weight, finished, size, floor, doubt, order):
            assert order is None
            # A target draws where failures may hide.
            assert doubt is not None
            first = draw_wave(
                np.random.default_rng(0), model, weight=weight, finished=finished, size=1, floor=floor, doubt=doubt
            )
            chances = first.chance
            ranks = np.array(ordered[finished.sum() :][:size])
            each = chances[ranks] / (1 - np.concatenate([[0.0], np.cumsum(chances[ranks])[:-1]]))
            return audit_module.Wave(ranks, each, chances, model)

        return draw

    # It is so whatever the model and the shares of the first wave.
    monkeypatch.setattr(
        two_phase_module, "weights_by_order", lambda drawn, size: 1 / np.arange(drawn + 1, drawn + size + 1)
    )
    monkeypatch.setattr(two_phase_module, "fit_logistic", lambda score, failed, centre: (failed.sum() - 1.0, 2.0))
    ways = {}
    for order in itertools.permutations(range(count)):
        if order[:4] in ways or order[:5] in ways:
            continue
        monkeypatch.setattr(two_phase_module, "draw_wave", drawing(order))
        replay = two_phase_module._replay(population, outcome, plan)
        drawn = sum(wave.ranks.size for wave in replay.waves)
        probability = np.prod([wave.probability.prod() for wave in replay.waves])
        ways[order[:drawn]] = float(probability), two_phase_module._audit(replay).total
    chance, total = np.array(list(ways.values())).T
    assert chance.sum() == pytest.approx(1.0)
    assert chance @ total == pytest.approx(len(failing) / count, abs=1e-12)
    # It ends early in some orders and not in others.
    assert {len(order) for order in ways} == {4, 5}


def test_runs_without_answer_are_noted_and_do_not_break():
    displacement, failed = pair(300, 0.2, 0.95, 2)
    plan = AuditPlan(runs=50)
    results: dict[int, bool | None] = dict(answers(failed))
    results[next_audit(Population(displacement), {}, plan)[0]] = None
    estimate = two_phase(Population(displacement), results, plan)
    assert "1 refined runs gave no answer" in estimate.notes[0]
    assert 0 < estimate.probability < 1


def test_nothing_known_and_no_refined_failure_are_noted():
    displacement, _ = pair(500, 0.2, 0.95, 2)
    start = two_phase(Population(displacement), {}, AuditPlan(runs=50))
    assert start.interval == (0.0, 1.0)
    assert "no wave" in start.notes[0]
    none = two_phase(Population(displacement), answers(np.zeros(500, dtype=bool)), AuditPlan(runs=50))
    assert (none.probability, none.interval[0]) == (0.0, 0.0)
    assert "no refined run has failed: P_f is 0 so far, and at most 0.0799 " in none.notes[0]
    assert none.interval[1] > 3 / 500


@pytest.mark.parametrize(
    ("plan", "match"),
    [
        (AuditPlan(runs=1), "runs = 1"),
        (AuditPlan(runs=50, floor=0.0), "floor = 0.0"),
        (AuditPlan(runs=50, growth=-1), "growth = -1"),
        (AuditPlan(runs=50, exploration=-1), "exploration = -1"),
        (AuditPlan(runs=50, target_cov=0.0), "target_cov = 0.0"),
    ],
)
def test_bad_plans_are_named(plan, match):
    with pytest.raises(ValueError, match=match):
        next_audit(Population(np.ones(100)), {}, plan)


def test_bad_populations_are_named():
    with pytest.raises(ValueError, match="sums to 2"):
        two_phase(Population(np.ones(4), weight=np.full(4, 0.5)), {}, AuditPlan(runs=20))
    with pytest.raises(ValueError, match="replicate"):
        two_phase(Population(np.ones(4), weight=np.full(4, 0.25)), {}, AuditPlan(runs=20))
    with pytest.raises(ValueError, match="fewer than 2"):
        two_phase(Population(np.ones(4), replicate=np.zeros(4, dtype=int)), {}, AuditPlan(runs=20))
    with pytest.raises(ValueError, match="30 rough runs broke off"):
        two_phase(Population(np.full(30, np.nan)), {}, AuditPlan(runs=20))


@pytest.mark.parametrize("target", [None, 0.3])
@pytest.mark.parametrize("pf", [0.2, 0.9])
def test_the_variance_is_that_of_the_audit_and_the_binomial_one_of_the_samples(target, pf):
    found = []
    for seed in range(60):
        displacement, failed = pair(60, pf, 0.6, seed)
        estimate = two_phase(
            Population(displacement), answers(failed), AuditPlan(runs=16, seed=seed, target_cov=target)
        )
        p = estimate.probability
        if not any("refined run has failed" in note for note in estimate.notes):  # then a limit takes its place
            found.append(p)
            assert (estimate.cov * p) ** 2 == pytest.approx(estimate.audit_variance + p * (1 - p) / 60)
    # Weights of draws may add up to more than all samples.
    assert (max(found) == 1) == (pf == 0.9)


@pytest.mark.parametrize("correlation", [0.8, 0.95])
def test_bias_and_coverage_by_simulation(correlation):
    pf, count, repeats = 0.244, 400, 400
    errors, covered = [], 0
    for seed in range(repeats):
        displacement, failed = pair(count, pf, correlation, seed)
        estimate = two_phase(Population(displacement), answers(failed), AuditPlan(runs=60, seed=seed))
        errors.append(estimate.probability - failed.mean())
        low, high = estimate.sampling_interval
        covered += low <= pf <= high
    assert abs(np.mean(errors)) < 4 * np.std(errors) / np.sqrt(repeats)
    assert np.std(errors) < 0.08
    # Binomial: a coverage of 95 % gives 380 of 400 give or take 4.4.
    assert 0.91 < covered / repeats < 0.985


def test_a_rough_grid_that_says_nothing_still_gives_an_unbiased_answer():
    errors = []
    for seed in range(300):
        displacement, failed = pair(300, 0.2, 0.0, seed)
        estimate = two_phase(Population(displacement), answers(failed), AuditPlan(runs=60, seed=seed))
        errors.append(estimate.probability - failed.mean())
    assert abs(np.mean(errors)) < 4 * np.std(errors) / np.sqrt(300)


def test_rough_runs_that_broke_off_may_be_many_where_all_samples_can_run_refined():
    broke_off = np.arange(10) < 6
    population = Population(np.linspace(0.1, 1.0, 10), broke_off)
    answers = {sample: sample % 2 == 0 for sample in range(10)}
    assert two_phase(population, answers, AuditPlan(runs=10)).probability == 0.5
    with pytest.raises(ValueError, match="6 rough runs broke off"):
        next_audit(population, {}, AuditPlan(runs=9))


@pytest.mark.parametrize("target", [None, 0.2])
def test_results_that_come_in_count_at_once_and_the_path_is_that_of_each_wave(target):
    displacement, failed = pair(150, 0.2, 0.9, 3)
    population, plan = Population(displacement), AuditPlan(runs=60, seed=3, target_cov=target)
    results: dict[int, bool | None] = {}
    met = []
    while wanted := next_audit(population, results, plan):
        # The same mapping and population, with other contents.
        results |= {sample: bool(failed[sample]) for sample in wanted}
        met.append(two_phase(population, results, plan))
        assert met[-1] == two_phase(Population(displacement), dict(results), plan)
    assert len(met) > 2
    assert two_phase_module.path(population, results, plan) == met
