"""Failures where the ranking does not look for them: intervals still hold the truth, and what misleads is named."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import norm, poisson

from cooperative.estimate import (
    AuditPlan,
    Population,
    two_phase,
    wilson_interval,
)
from cooperative.estimate._audit import RARELY, Surprise, draw_wave, hidden_limit
from tests.cooperative.estimate.test_twophase import answers, pair


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
        estimate = two_phase(Population(displacement), answers(failed), AuditPlan(runs=runs, seed=seed))
        truth = 0.7 * pf + 0.3 * pf * (1 - 0.7 * pf) if link == "some at the bottom" else pf
        whole += estimate.interval[0] <= truth <= estimate.interval[1]
        alone += estimate.sampling_interval[0] <= truth <= estimate.sampling_interval[1]
        errors.append(estimate.probability - failed.mean())
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
    estimate = two_phase(Population(displacement), answers(failed), AuditPlan(runs=60))
    (low, high), (alone_low, alone_high) = estimate.interval, estimate.sampling_interval
    assert low == alone_low
    assert high - estimate.probability == pytest.approx(
        np.hypot(alone_high - estimate.probability, estimate.hidden_limit)
    )
    # A target goes by the sampling, which the allowance is far from meeting.
    target = two_phase(Population(displacement), answers(failed), AuditPlan(runs=700, target_cov=0.12))
    assert target.cov == pytest.approx(0.12, abs=0.02)
    assert target.refined_runs < 150
    assert target.interval[1] > target.sampling_interval[1]
    # Notes name what trust in the ranks from the start leaves out.
    trusting = two_phase(Population(displacement), answers(failed), AuditPlan(runs=60, exploration=0))
    assert (trusting.hidden_limit, trusting.sampling_interval) == (0.0, None)
    assert "has no allowance" in trusting.notes[0]
    # Nothing is unseen where all is known.
    everything = two_phase(Population(displacement), answers(failed), AuditPlan(runs=750))
    assert everything.hidden_limit == 0.0
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
        waves.append(draw_wave(generator, model, weight=weight, finished=known, size=size, floor=share))
        known[waves[-1].ranks] = True
    outcome = np.where(known, 0.0, np.nan)
    outcome[np.flatnonzero(known)[0]] = 1.0
    limit = hidden_limit(waves, outcome, known, weight=weight, level=level)
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


@given(failed=st.integers(0, 12), expected=st.floats(1e-3, 12.0))
def test_ranks_mislead_where_poissons_law_rarely_brings_as_many_failures(failed, expected):
    rare = poisson.pmf(np.arange(failed), expected).sum() > 1 - RARELY
    assert Surprise(20, failed, expected).misled == rare


def test_ranks_that_mislead_are_noted_loudly():
    displacement, failed = hidden("against", 750, 0.244, 0)
    estimate = two_phase(Population(displacement), answers(failed), AuditPlan(runs=60))
    assert any(note.startswith("THE RANKS MISLEAD") for note in estimate.notes)
    good = [
        two_phase(Population(d), answers(f), AuditPlan(runs=60)) for d, f in (pair(750, 0.244, 0.98, s) for s in (1, 2))
    ]
    assert not any("MISLEAD" in note for estimate in good for note in estimate.notes)


def test_soil_that_fails_throughout_does_not_speak_against_the_ranks():
    displacement, _ = pair(100, 0.244, 0.95, 1)
    fails = np.ones(100, bool)
    estimate = two_phase(Population(displacement), answers(fails), AuditPlan(runs=20))
    assert not any("MISLEAD" in note for note in estimate.notes)
    # One that stands at the top of the ranking, and the failures below it are a surprise.
    fails[np.argmax(displacement)] = False
    estimate = two_phase(Population(displacement), answers(fails), AuditPlan(runs=90))
    assert any(note.startswith("THE RANKS MISLEAD") for note in estimate.notes)
