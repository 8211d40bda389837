"""The two-phase estimator: exactly unbiased, covering, and the same whatever ran when."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import norm

from cooperative.estimate import (
    AuditPlan,
    Population,
    SubsetPlan,
    after_more_runs,
    control_variate,
    monte_carlo,
    next_audit,
    rank_samples,
    subset_simulation,
    two_phase,
    wilson_interval,
)
from cooperative.estimate import _audit as audit_module
from cooperative.estimate import _twophase as two_phase_module
from cooperative.estimate._audit import (
    audit_total,
    draw_wave,
    even_share,
    surprise,
    unseen,
)
from cooperative.estimate._logistic import fit_logistic, normal_scores, predict_logistic
from cooperative.estimate._twophase import share_by_order, target_share


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


def test_without_data_the_model_is_the_prior_and_perfect_separation_is_finite():
    assert fit_logistic(np.zeros(0), np.zeros(0), 1.0) == pytest.approx((0.0, 4.0))
    a, b = fit_logistic(np.array([-1.0, 1.0]), np.array([0.0, 1.0]), 0.0)
    assert np.isfinite([a, b]).all()
    assert fit_logistic(np.array([-1.0, 1.0] * 50), np.array([1.0, 0.0] * 50), 0.0)[1] == 0.3


def test_normal_scores_are_those_of_equal_shares():
    np.testing.assert_allclose(normal_scores(np.ones(4)), norm.isf([0.125, 0.375, 0.625, 0.875]))


def test_draws_have_the_probabilities_they_claim():
    generator = np.random.default_rng(0)
    model, weight = np.array([0.9, 0.5, 0.2, 0.01, 0.5]), np.full(5, 0.2)
    known = np.array([False, False, False, False, True])
    counts: dict[tuple[int, int], int] = {}
    claimed: dict[tuple[int, int], float] = {}
    for _ in range(20_000):
        wave = draw_wave(generator, model, weight=weight, known=known, size=2, floor=0.2)
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
            waves, outcome, np.zeros(0, int), weight=weight, model=first_model, share=share_by_order(0, 2), group=groups
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


def test_all_samples_known_gives_the_exact_share():
    displacement, failed = pair(40, 0.3, 0.9, 0)
    found = two_phase(Population(displacement), answers(failed), AuditPlan(runs=40))
    assert found.probability == pytest.approx(failed.mean())
    assert found.audit_variance == 0.0
    assert found.interval == pytest.approx(wilson_interval(int(failed.sum()), 40))


@pytest.mark.parametrize("outcome", [False, True])
def test_few_samples_that_all_end_alike_leave_the_probability_open(outcome):
    displacement, _ = pair(10, 0.3, 0.9, 0)
    found = two_phase(Population(displacement), dict.fromkeys(range(10), outcome), AuditPlan(runs=10))
    assert found.sampling_interval == pytest.approx(wilson_interval(10 * outcome, 10))


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 1000), st.sampled_from([None, 3]), st.randoms(use_true_random=False))
def test_runs_asked_for_one_by_one_in_any_order_give_the_same_answer(seed, k_t, random):
    displacement, failed = pair(120, 0.2, 0.9, seed)
    displacement[:2] = np.nan
    plan = AuditPlan(runs=40, seed=seed, k_t=k_t)
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


def test_the_ranked_prefix_is_the_published_one():
    displacement, failed = pair(200, 0.2, 0.98, 4)
    plan = AuditPlan(runs=120, k_t=4)
    results: dict[int, bool | None] = {}
    wanted = next_audit(Population(displacement), results, plan)
    order = rank_samples(displacement).order
    assert wanted == order[:4].tolist()
    while wanted and set(wanted) <= set(order[: 120 // 2].tolist()):
        results |= {sample: bool(failed[sample]) for sample in wanted}
        wanted = next_audit(Population(displacement), results, plan)
    standing = [not failed[sample] for sample in order[: len(results)]]
    assert all(standing[-4:]) or len(results) == 60


def test_a_target_stops_the_audit_early():
    displacement, failed = pair(800, 0.244, 0.98, 1)
    target = two_phase(Population(displacement), answers(failed), AuditPlan(runs=400, target_cov=0.12))
    assert target.cov == pytest.approx(0.12, abs=0.02)
    assert target.refined_runs < 100
    # What the target does not need before the budget ends leaves the answer as it is without one.
    plan = AuditPlan(runs=40, target_cov=0.01)
    unmet = two_phase(Population(displacement), answers(failed), plan)
    assert unmet.probability == pytest.approx(
        two_phase(Population(displacement), answers(failed), replace(plan, target_cov=None)).probability
    )
    assert unmet.refined_runs == 40


@given(st.lists(st.floats(0.0, 0.2), min_size=30, max_size=30), st.integers(9, 200), st.integers(1, 12), st.booleans())
def test_shares_add_up_to_one_whatever_the_target_needs(needed, budget, size, early):
    rest, drawn, shares = 1.0, 0, []
    for need in itertools.cycle(needed):
        some = min(size, budget - drawn)
        share = target_share(need * early, rest, drawn=drawn, size=some, left=budget - drawn)
        assert 0 < share.size <= some
        assert np.all(share > 0)
        shares.append(share)
        rest, drawn = rest - share.sum(), drawn + share.size
        if rest < 1e-9 or drawn == budget:
            break
    assert np.concatenate(shares).sum() == pytest.approx(1.0)
    if not early:
        np.testing.assert_allclose(np.concatenate(shares), share_by_order(0, budget) / share_by_order(0, budget).sum())


@pytest.mark.parametrize("failing", [{1, 3}, {5}])
def test_an_audit_that_ends_by_its_target_is_exactly_unbiased(failing, monkeypatch):
    # All orders of draws, each weighed by its probability: the audit looks after every wave whether it may end.
    count, plan = 6, AuditPlan(runs=5, target_cov=0.8, first_wave=2, growth=1.0, proving=2)
    population, outcome = Population(np.exp(-np.arange(float(count)))), {n: n in failing for n in range(count)}

    def drawing(order):
        def draw(generator, model, *, weight, known, size, floor):
            chances = draw_wave(np.random.default_rng(0), model, weight=weight, known=known, size=1, floor=floor).chance
            ranks = np.array(order[known.sum() :][:size])
            each = chances[ranks] / (1 - np.concatenate([[0.0], np.cumsum(chances[ranks])[:-1]]))
            return audit_module.Wave(ranks, each, chances, model)

        return draw

    # It is so whatever the model and the shares of the first wave.
    monkeypatch.setattr(
        two_phase_module, "share_by_order", lambda drawn, size: 1 / np.arange(drawn + 1, drawn + size + 1)
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


def test_runs_without_answer_are_said_and_do_not_break():
    displacement, failed = pair(300, 0.2, 0.95, 2)
    plan = AuditPlan(runs=50)
    results: dict[int, bool | None] = dict(answers(failed))
    results[next_audit(Population(displacement), {}, plan)[0]] = None
    found = two_phase(Population(displacement), results, plan)
    assert "1 refined runs gave no answer" in found.notes[0]
    assert 0 < found.probability < 1


def test_nothing_known_and_no_failure_found_are_said():
    displacement, _ = pair(500, 0.2, 0.95, 2)
    start = two_phase(Population(displacement), {}, AuditPlan(runs=50))
    assert start.interval == (0.0, 1.0)
    assert "no wave" in start.notes[0]
    none = two_phase(Population(displacement), answers(np.zeros(500, dtype=bool)), AuditPlan(runs=50))
    assert "no refined failure" in none.notes[0]
    assert none.interval[1] > 3 / 500


@pytest.mark.parametrize(
    ("plan", "match"),
    [
        (AuditPlan(runs=1), "runs = 1"),
        (AuditPlan(runs=50, floor=0.0), "floor = 0.0"),
        (AuditPlan(runs=50, growth=-1), "growth = -1"),
        (AuditPlan(runs=50, proving=-1), "proving = -1"),
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


@pytest.mark.parametrize(("correlation", "k_t"), [(0.8, None), (0.95, None), (0.95, 4)])
def test_bias_and_coverage_by_simulation(correlation, k_t):
    pf, count, repeats = 0.244, 400, 400
    errors, covered = [], 0
    for seed in range(repeats):
        displacement, failed = pair(count, pf, correlation, seed)
        found = two_phase(Population(displacement), answers(failed), AuditPlan(runs=60, seed=seed, k_t=k_t))
        errors.append(found.probability - failed.mean())
        low, high = found.sampling_interval
        covered += low <= pf <= high
    assert abs(np.mean(errors)) < 4 * np.std(errors) / np.sqrt(repeats)
    assert np.std(errors) < 0.08
    # Binomial: a coverage of 95 % gives 380 of 400 give or take 4.4.
    assert 0.91 < covered / repeats < 0.985


def test_a_rough_grid_that_says_nothing_still_gives_an_unbiased_answer():
    errors = []
    for seed in range(300):
        displacement, failed = pair(300, 0.2, 0.0, seed)
        found = two_phase(Population(displacement), answers(failed), AuditPlan(runs=60, seed=seed))
        errors.append(found.probability - failed.mean())
    assert abs(np.mean(errors)) < 4 * np.std(errors) / np.sqrt(300)


def hidden(link, count, pf, seed):
    """Rough displacement and refined failure where the ranking is bad."""
    generator = np.random.default_rng(seed)
    rough, other = generator.standard_normal((2, count))
    good = 0.95 * rough + np.sqrt(1 - 0.95**2) * other
    failed = {
        "against": 0.9 * rough + np.sqrt(1 - 0.9**2) * other < norm.ppf(pf),
        "both ends": np.abs(good) > norm.isf(pf / 2),
        "middle": np.abs(good) < norm.ppf(0.5 + pf / 2),
        "some at the bottom": (good > norm.isf(0.7 * pf)) | ((rough < norm.ppf(0.3)) & (generator.random(count) < pf)),
    }[link]
    return np.exp(rough - norm.isf(pf / 2)), failed


def coverage(link, pf, runs, repeats):
    """Shares of campaigns whose interval, and whose interval of sampling alone, hold P_f; and the errors of P_f."""
    whole, alone, errors = 0, 0, []
    for seed in range(repeats):
        displacement, failed = hidden(link, 750, pf, seed)
        found = two_phase(Population(displacement), answers(failed), AuditPlan(runs=runs, seed=seed))
        truth = 0.7 * pf + 0.3 * pf * (1 - 0.7 * pf) if link == "some at the bottom" else pf
        whole += found.interval[0] <= truth <= found.interval[1]
        alone += found.sampling_interval[0] <= truth <= found.sampling_interval[1]
        errors.append(found.probability - failed.mean())
    return whole / repeats, alone / repeats, np.array(errors)


def test_the_interval_holds_where_half_of_the_failures_hide_at_the_bottom():
    whole, alone, errors = coverage("both ends", 0.05, 60, 80)
    assert alone < 0.85
    assert whole >= 0.92
    assert abs(errors.mean()) < 4 * errors.std() / np.sqrt(80)


@pytest.mark.slow
@pytest.mark.parametrize("runs", [60, 120])
@pytest.mark.parametrize("pf", [0.05, 0.244])
@pytest.mark.parametrize("link", ["against", "both ends", "middle", "some at the bottom"])
def test_the_interval_holds_wherever_failures_hide(link, pf, runs):
    whole, _, errors = coverage(link, pf, runs, 400)
    assert whole >= 0.90
    assert abs(errors.mean()) < 4 * errors.std() / np.sqrt(400)


def test_the_allowance_widens_upwards_only_and_leaves_the_rest_alone():
    displacement, failed = pair(750, 0.244, 0.95, 0)
    found = two_phase(Population(displacement), answers(failed), AuditPlan(runs=60))
    (low, high), (alone_low, alone_high) = found.interval, found.sampling_interval
    assert low == alone_low
    assert high - found.probability == pytest.approx(np.hypot(alone_high - found.probability, found.unseen))
    # A target goes by the sampling, which the allowance is far from meeting.
    target = two_phase(Population(displacement), answers(failed), AuditPlan(runs=700, target_cov=0.12))
    assert target.cov == pytest.approx(0.12, abs=0.02)
    assert target.refined_runs < 150
    assert target.interval[1] > target.sampling_interval[1]
    # Who trusts the ranks from the start is told what that leaves out.
    trusting = two_phase(Population(displacement), answers(failed), AuditPlan(runs=60, proving=0))
    assert (trusting.unseen, trusting.sampling_interval) == (0.0, None)
    assert "has no allowance" in trusting.notes[0]
    # Nothing is unseen where all is known.
    everything = two_phase(Population(displacement), answers(failed), AuditPlan(runs=750))
    assert everything.unseen == 0.0
    assert everything.interval == pytest.approx(wilson_interval(int(failed.sum()), 750))


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000), st.floats(0.5, 0.99), st.booleans())
def test_no_draw_meets_what_is_hidden_more_rarely_than_the_limit_says(seed, level, weighted):
    generator = np.random.default_rng(seed)
    count = 60
    weight = generator.gamma(2.0, size=count) if weighted else np.ones(count)
    weight /= weight.sum()
    model = np.sort(generator.beta(0.3, 1.0, size=count))[::-1].clip(1e-9, 1 - 1e-9)
    known, waves = np.zeros(count, dtype=bool), []
    for size, share in ((8, 1.0), (6, 0.5), (10, 0.2)):
        waves.append(draw_wave(generator, model, weight=weight, known=known, size=size, floor=share))
        known[waves[-1].ranks] = True
    outcome = np.where(known, 0.0, np.nan)
    outcome[np.flatnonzero(known)[0]] = 1.0
    limit = unseen(waves, outcome, known, weight=weight, level=level)
    below = np.flatnonzero(~known & (np.arange(count) > np.flatnonzero(known)[0]))
    hiding = generator.permutation(below)[: generator.integers(1, below.size + 1)]
    chance = 1.0
    for wave in waves:
        left = wave.chance[wave.ranks] / wave.probability
        chance *= np.prod(1 - wave.chance[hiding].sum() / left)
    # With `limit` of the weight hidden, the draws would all miss it with 1 - level at most, wherever it is.
    assert chance <= (1 - level) ** (weight[hiding].sum() / limit) * (1 + 1e-9) or limit == pytest.approx(
        weight[below].sum()
    )


def test_draws_are_even_until_the_ranks_have_proved_themselves():
    plan, outcome = AuditPlan(runs=100, proving=16, floor=0.05), np.zeros(400)
    assert even_share(plan, [], outcome) == 1.0

    def wave(ranks):
        return audit_module.Wave(np.asarray(ranks), np.ones(len(ranks)), np.ones(400), np.full(400, 0.001))

    assert even_share(plan, [wave(range(16))], outcome) == 0.5
    assert even_share(plan, [wave(range(48))], outcome) == 0.25
    assert even_share(plan, [wave(range(400))], outcome) == 0.05
    outcome[300] = 1.0
    assert surprise([wave(range(400))], outcome) == audit_module.Surprise(400, 1, pytest.approx(0.4))
    assert even_share(plan, [wave(range(400))], outcome) == 0.05
    # One failure among 48 draws where 0.048 were to be expected, and there is no trust.
    outcome[30] = 1.0
    assert even_share(plan, [wave(range(48))], outcome) == 0.5
    assert even_share(replace(plan, proving=0), [wave(range(48))], outcome) == 0.05


def test_ranks_that_mislead_are_said_loudly():
    displacement, failed = hidden("against", 750, 0.244, 0)
    found = two_phase(Population(displacement), answers(failed), AuditPlan(runs=60))
    assert any(note.startswith("THE RANKS MISLEAD") for note in found.notes)
    good = [
        two_phase(Population(d), answers(f), AuditPlan(runs=60)) for d, f in (pair(750, 0.244, 0.98, s) for s in (1, 2))
    ]
    assert not any("MISLEAD" in note for found in good for note in found.notes)


def test_soil_that_fails_throughout_does_not_speak_against_the_ranks():
    displacement, _ = pair(100, 0.244, 0.95, 1)
    fails = np.ones(100, bool)
    found = two_phase(Population(displacement), answers(fails), AuditPlan(runs=20))
    assert not any("MISLEAD" in note for note in found.notes)
    # One that stands at the top of the ranking, and the failures below it are a surprise.
    fails[np.argmax(displacement)] = False
    found = two_phase(Population(displacement), answers(fails), AuditPlan(runs=20, k_t=1))
    assert any(note.startswith("THE RANKS MISLEAD") for note in found.notes)


def test_what_more_runs_would_buy():
    displacement, failed = pair(2000, 0.244, 0.95, 3)
    forecast, measured = [], []
    for seed in range(40):
        now = two_phase(Population(displacement), answers(failed), AuditPlan(runs=60, seed=seed))
        later = two_phase(Population(displacement), answers(failed), AuditPlan(runs=110, seed=seed))
        forecast.append(after_more_runs(now, 50))
        measured.append(later.cov)
    assert np.mean(forecast) == pytest.approx(np.mean(measured), rel=0.12)
    with pytest.raises(ValueError, match="more = -1"):
        after_more_runs(now, -1)


def test_what_more_runs_would_buy_where_few_samples_are_left():
    displacement, failed = pair(160, 0.3, 0.8, 3)
    population, forecast, measured = Population(displacement), [], []
    for seed in range(60):
        now, later, last = (
            two_phase(population, answers(failed), AuditPlan(runs=runs, seed=seed)) for runs in (60, 120, 160)
        )
        forecast.append([after_more_runs(now, more, samples=160) for more in (60, 100, 10**6)])
        measured.append([later.cov, last.cov, last.cov])
        # The limit is the sampling of the 160.
        assert forecast[-1][1] == forecast[-1][2] == pytest.approx(np.sqrt((1 / now.probability - 1) / 160))
        assert after_more_runs(last, 50, samples=160) == last.cov
    np.testing.assert_allclose(np.mean(forecast, axis=0), np.mean(measured, axis=0), rtol=0.05)


def test_more_monte_carlo_runs_shrink_as_the_square_root():
    failed = np.arange(100) < 20
    assert after_more_runs(monte_carlo(failed), 300) == pytest.approx(monte_carlo(failed).cov / 2)
    # Whether 400 samples are all that there are does not matter for the first 400 of them.
    assert after_more_runs(monte_carlo(failed, samples=400), 900, samples=400) == pytest.approx(
        monte_carlo(failed).cov / 2
    )
    assert monte_carlo(failed).interval == wilson_interval(20, 100)


def test_control_variate_is_unbiased_and_beats_monte_carlo():
    errors, plain, covered = [], [], 0
    for seed in range(300):
        displacement, failed = pair(1000, 0.244, 0.95, seed)
        found = control_variate(displacement, answers(failed[:80]))
        errors.append(found.probability - 0.244)
        plain.append(failed[:80].mean() - 0.244)
        covered += found.interval[0] <= 0.244 <= found.interval[1]
    assert abs(np.mean(errors)) < 4 * np.std(errors) / np.sqrt(300)
    assert np.std(errors) < 0.75 * np.std(plain)
    assert 0.9 < covered / 300 < 0.985
    with pytest.raises(ValueError, match="at least 10 runs"):
        control_variate(displacement, answers(failed[:5]))


def test_subset_simulation_finds_a_rare_probability():
    # P(X > 3.09) = 1e-3 for one standard normal, from a few thousand samples.
    shares, weights = [], []
    for seed in range(12):
        found = subset_simulation(lambda xi: xi[:, 0], 3, SubsetPlan(per_level=200, levels=3, replicates=8, seed=seed))
        shares.append(found.weight[found.rough_displacement > norm.isf(1e-3)].sum())
        weights.append(found.weight.sum())
        assert found.rough_displacement.size == found.weight.size == found.replicate.size
        assert found.rough_runs == 8 * (200 + 3 * 180)
        np.testing.assert_array_equal(found.coefficients[:, 0], found.rough_displacement)
    np.testing.assert_allclose(weights, 1.0)
    assert np.mean(shares) == pytest.approx(1e-3, rel=0.15)


def test_subset_simulation_feeds_the_audit():
    pf, off, covered = 1e-3, [], 0
    for seed in range(40):
        found = subset_simulation(
            lambda xi: np.exp(xi[:, 0] - norm.isf(5e-4)), 3, SubsetPlan(per_level=500, levels=3, seed=seed)
        )
        failed = 0.95 * found.coefficients[:, 0] + np.sqrt(1 - 0.95**2) * found.coefficients[:, 1] > norm.isf(pf)
        population = Population(found.rough_displacement, weight=found.weight, replicate=found.replicate)
        answer = two_phase(population, answers(failed), AuditPlan(runs=200, seed=seed, growth=0.5, proving=0))
        off.append(answer.probability / pf - 1)
        covered += answer.interval[0] <= pf <= answer.interval[1]
    assert abs(np.mean(off)) < 4 * np.std(off) / np.sqrt(40)
    assert np.std(off) < 0.45
    assert covered >= 35


def test_subset_simulation_takes_runs_that_broke_off_for_the_largest():
    def rough(xi):
        return np.where(xi[:, 0] > 3, np.nan, xi[:, 0])

    found = subset_simulation(rough, 2, SubsetPlan(per_level=100, levels=3, replicates=2))
    assert np.isinf(found.rough_displacement).any()
    assert found.weight.sum() == pytest.approx(1.0)


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
