"""The real population that estimators are compared on: what it says, that it can be made again, campaigns from it."""

import numpy as np
import pytest

from benchmarks.statistics import estimators_section as section
from benchmarks.statistics.section_pairs import SAMPLES, STUDIES, read, study
from cooperative import runs
from cooperative.estimate import correlation


@pytest.fixture(scope="module")
def pairs():
    return read()


def test_default_settings_bring_the_grids_together(pairs):
    default, even = read("default"), np.ones(SAMPLES)
    same = [
        correlation(of.displacement["rough"], of.displacement["refined"], even, failure_displacement=1.0)
        for of in (pairs, default)
    ]
    assert same[1].same_class > same[0].same_class
    assert same[1].pearson_log > same[0].pearson_log


def test_the_rough_grid_ranks_well_and_fails_too_seldom(pairs):
    distance, even = pairs.displacement, np.ones(SAMPLES)
    assert all(column.size == SAMPLES for column in distance.values())
    plain = correlation(distance["rough"], distance["refined"], even, failure_displacement=1.0)
    assert plain.spearman > 0.95
    assert np.mean(distance["rough"] > 1) < 0.6 * np.mean(distance["refined"] > 1)


def test_calibration_brings_the_classes_together(pairs):
    distance, even = pairs.displacement, np.ones(SAMPLES)
    same = {
        grid: correlation(distance[grid], distance["refined"], even, failure_displacement=1.0).same_class
        for grid in ("rough", "calibrated")
    }
    assert same["calibrated"] > 0.95 > same["rough"]
    assert np.mean(distance["calibrated"] > 1) == pytest.approx(np.mean(distance["refined"] > 1), rel=0.1)


def test_every_refined_failure_has_a_mode(pairs):
    fails = pairs.displacement["refined"] > 1
    assert set(pairs.mode["refined"][fails]) == {"shallow", "deep", "progressive"}
    assert set(pairs.mode["refined"][~fails]) == {"none"}


@pytest.mark.parametrize("of", ["default", pytest.param("published", marks=pytest.mark.slow)])
def test_its_samples_can_be_made_again(of):
    pairs, campaign = read(of), study(STUDIES[of][0])
    soil = runs.random_soil(campaign)
    coefficients = runs.coefficients_of(campaign, soil)
    standing = [int(n) for n in np.flatnonzero(pairs.displacement["rough"] < 0.03)[:3]]
    model = runs.build(campaign, "rough", soil)
    for sample in runs.run_samples(model, coefficients, standing, width=1):
        assert sample.row["displacement"] == pytest.approx(pairs.displacement["rough"][sample.number], rel=0.01)


@pytest.mark.parametrize("method", section.METHODS)
def test_campaigns_from_it_are_unbiased_where_they_say_so(method):
    result = section.summarise(method, 40, section.repeat((method, 40), 0, 60))
    assert result["seconds"] > 0
    if method == "screening alone":
        assert result["bias"] < -0.4
    elif not method.startswith(("published", "screening")):
        assert abs(result["bias"]) < 4 * result["bias_error"]
        assert result["coverage"] > 0.85


def test_seconds_for_an_error_are_read_off_the_curve():
    rows = [{"seconds": 10 + 0.5 / e**2, "rmse": e} for e in (0.2, 0.1, 0.05)]
    assert section.seconds_for(rows, 0.08) == pytest.approx(10 + 0.5 / 0.08**2)
