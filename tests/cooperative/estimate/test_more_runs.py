"""What more refined runs would bring, by estimator, against campaigns that had them; the control variate."""

import numpy as np
import pytest

from cooperative.estimate import (
    AuditPlan,
    Population,
    after_more_runs,
    control_variate,
    exact_limit,
    monte_carlo,
    next_audit,
    two_phase,
    wilson_interval,
)
from tests.cooperative.estimate.test_twophase import answers, pair


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
        estimate = control_variate(displacement, answers(failed[:80]))
        errors.append(estimate.probability - 0.244)
        plain.append(failed[:80].mean() - 0.244)
        covered += estimate.interval[0] <= 0.244 <= estimate.interval[1]
    assert abs(np.mean(errors)) < 4 * np.std(errors) / np.sqrt(300)
    assert np.std(errors) < 0.75 * np.std(plain)
    assert 0.9 < covered / 300 < 0.985
    with pytest.raises(ValueError, match="at least 10 runs"):
        control_variate(displacement, answers(failed[:5]))


@pytest.mark.parametrize(("pf", "correlation"), [(0.02, 0.5), (0.05, 0.5), (0.05, 0.9)])
def test_the_control_variate_covers_where_few_runs_fail(pf, correlation):
    covered = 0
    for seed in range(300):
        displacement, failed = pair(200, pf, correlation, seed)
        low, high = control_variate(displacement, answers(failed[:40])).interval
        covered += low <= pf <= high
    assert covered / 300 > 0.94  # 0.87 by the residuals alone
    none = control_variate(displacement, dict.fromkeys(range(20), False))
    assert (none.probability, none.interval) == (0.0, (0.0, exact_limit(20)))
    every = control_variate(displacement, dict.fromkeys(range(20), True))
    assert (every.probability, every.interval) == (1.0, (1 - exact_limit(20), 1.0))


@pytest.mark.parametrize(
    ("failed", "message"),
    [
        ([True, None, False], "failed holds None: give True or False of each run"),
        ([1.0, np.nan, 0.0], "failed holds nan"),
        ([1, 2, 0], "failed holds 2"),
        ([], "failed is empty"),
    ],
)
def test_an_answer_that_is_none_is_refused(failed, message):
    with pytest.raises(ValueError, match=message):
        monte_carlo(failed)


def test_without_an_answer_the_interval_is_open():
    displacement, _ = pair(100, 0.3, 0.9, 1)
    plan, given = AuditPlan(runs=30), {}
    while asked := next_audit(Population(displacement), given, plan):
        given |= dict.fromkeys(asked)
    estimate = two_phase(Population(displacement), given, plan)
    assert len(given) == 30
    assert estimate.interval == (0.0, 1.0)
    assert "no refined run gave an answer: the estimate is the model's" in estimate.notes
