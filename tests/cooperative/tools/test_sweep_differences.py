"""Differences of campaigns of the same samples, and fragility curves: their intervals cover on made-up campaigns."""

import numpy as np
import pytest
from scipy.stats import norm

from cooperative.estimate import AuditPlan, Failures, Population, next_audit
from cooperative.estimate import _twophase as twophase
from cooperative.tools.sweep_differences import by_sample, covariance_of, paired_difference
from cooperative.tools.sweep_fragility import fit_fragility

MEDIAN, DEVIATION = 0.15, 0.3


def of_classes(failed):
    count = np.asarray(failed, float) / failed.size
    return by_sample(
        Failures(np.arange(failed.size), np.full(failed.size, 1 / failed.size), failed, count),
        failed.mean(),
        failed.size,
    )


def audited(rough, failed, runs):
    """Failures counted at each sample by a two-phase campaign."""
    population, plan, known = Population(rough), AuditPlan(runs, seed=1), {}
    while asked := next_audit(population, known, plan):
        known |= {sample: bool(failed[sample]) for sample in asked}
    estimate = twophase.two_phase(population, known, plan)
    return by_sample(twophase.failures(population, known, plan), estimate.probability, rough.size), estimate


def test_differences_of_the_same_samples_are_covered_and_sharper():
    generator, covered, sharper = np.random.default_rng(1), [], []
    for _ in range(400):
        margin = generator.standard_normal((3, 150))
        one, other = (
            margin[0] + 0.15 * own > norm.isf(share) * np.hypot(1, 0.15)
            for own, share in zip(margin[1:], (0.2, 0.3), strict=True)
        )
        result = paired_difference(of_classes(one), of_classes(other))
        covered.append(result.interval[0] <= 0.1 <= result.interval[1])
        sharper.append(result.unpaired)
    assert 0.93 <= np.mean(covered) <= 0.99
    assert np.mean(sharper) > 1.7


def test_two_phase_campaigns_of_the_same_samples_are_compared_with_both_audits():
    generator, covered, result = np.random.default_rng(2), [], None
    for _ in range(30):
        margin, noise = generator.standard_normal((2, 100))
        each = []
        for share in (0.2, 0.35):
            failed = margin > norm.isf(share)
            counted, estimate = audited(np.exp(0.95 * margin + 0.31 * noise - norm.isf(share)), failed, 20)
            assert counted.mean() == pytest.approx(estimate.probability)
            each.append(counted)
        result = paired_difference(*each)
        covered.append(result.interval[0] <= 0.15 <= result.interval[1])
        assert result.difference == pytest.approx(each[1].mean() - each[0].mean())
    assert np.mean(covered) >= 0.9


def test_campaigns_of_equal_classes_differ_by_0_within_a_finite_interval():
    same = of_classes(np.arange(50) < 10)
    result = paired_difference(same, same)
    assert result.difference == 0
    assert -0.05 < result.interval[0] < 0 < result.interval[1] < 0.05
    assert paired_difference(same, same, (4e-3, 4e-3)).interval[1] > result.interval[1]


def test_fragility_curves_cover_their_truth_although_the_samples_are_common():
    generator, levels = np.random.default_rng(3), np.array([0.08, 0.12, 0.16, 0.2, 0.26])
    inside = []
    unknown = [0.0] * levels.size
    for _ in range(200):
        bears = MEDIAN * np.exp(DEVIATION * generator.standard_normal(150))
        counted = [of_classes(bears < level) for level in levels]
        curve = {
            c.form: c for c in fit_fragility(levels, [z.mean() for z in counted], covariance_of(counted, unknown), 150)
        }["lognormal"]
        at = np.interp(0.18, curve.level, curve.low), np.interp(0.18, curve.level, curve.high)
        truths = (MEDIAN, DEVIATION, norm.cdf(np.log(0.18 / MEDIAN) / DEVIATION))
        limits = (curve.median_interval, curve.deviation_interval, at)
        inside.append([low <= truth <= high for truth, (low, high) in zip(truths, limits, strict=True)])
    assert np.all(np.mean(inside, axis=0) >= 0.91)
    assert np.all(np.mean(inside, axis=0) <= 0.99)


def test_curves_are_of_two_levels_between_0_and_1_and_the_lognormal_of_levels_above_0():
    share = [np.arange(100) < count for count in (5, 30, 80)]
    counted = [of_classes(each) for each in share]
    fit = [0.05, 0.3, 0.8], covariance_of(counted, [0.0] * 3), 100
    both = fit_fragility([1.0, 2.0, 3.0], *fit)
    assert {curve.form for curve in both} == {"normal", "lognormal"}
    assert both[0].log_likelihood >= both[1].log_likelihood
    assert [curve.form for curve in fit_fragility([-1.0, 2.0, 3.0], *fit)] == ["normal"]
    assert [curve.form for curve in fit_fragility([0.0, 2.0, 3.0], *fit)] == ["normal", "lognormal"]
    assert not fit_fragility([3.0, 2.0, 1.0], *fit)[0].rises
    flat = [of_classes(each) for each in (share[1], share[1], share[1])]
    assert fit_fragility([1.0, 2.0, 3.0], [0.3] * 3, covariance_of(flat, [0.0] * 3), 100) == ()
    none = [of_classes(np.arange(100) < count) for count in (0, 0, 80)]
    assert fit_fragility([1.0, 2.0, 3.0], [0.0, 0.0, 0.8], covariance_of(none, [0.0] * 3), 100) == ()


def test_a_campaign_without_a_failure_is_as_uncertain_as_its_estimator_says():
    counted = [of_classes(np.arange(100) < count) for count in (0, 30)]
    spread = covariance_of(counted, [4e-3, 1e-9])
    assert spread[0, 0] == pytest.approx(4e-3)
    assert spread[1, 1] == pytest.approx(covariance_of(counted, [0.0, 0.0])[1, 1])
    assert np.all(np.linalg.eigvalsh(spread) > 0)


def test_records_count_alike_however_sharp_their_estimates_are():
    counted = [of_classes(np.arange(100) < count) for count in (1, 2, 3, 10, 50, 90)]
    levels, shares = [1.0, 2.0, 3.0, 1.0, 2.0, 3.0], [z.mean() for z in counted]
    spread = covariance_of(counted, [0.0] * 3 + [0.02] * 3)
    even, uneven = (fit_fragility(levels, shares, spread, 100, even=alike) for alike in (True, False))
    assert np.interp(2.0, even[0].level, even[0].probability) == pytest.approx(0.26, abs=0.05)
    assert not uneven or np.interp(2.0, uneven[0].level, uneven[0].probability) < 0.15
