"""The benchmark of one, two and three grids."""

import pytest

from benchmarks.statistics import nested

SECONDS = dict.fromkeys(nested.GRIDS, 1.0) | {f"{grid}_default": 2.0 for grid in nested.GRIDS}


def test_hours_are_the_seconds_of_the_runs_on_each_grid():
    rows = {case.name: {"runs_q50": 60} for case in nested.GOOD}
    values = nested.hours(SECONDS | {"refined_class_core_seconds": 30.0}, rows)
    assert values["expected_hours_to_cov_10_two_grids"] == pytest.approx((1000 + 60 * 30) / 7200)
    assert values["expected_hours_to_cov_10_three_grids"] == pytest.approx((3500 + 60 * 30) / 7200)
    assert values["expected_hours_to_cov_10_one_grid"] == pytest.approx(0.72 / 0.28 * 100 * 30 / 7200)
    assert values["expected_hours_to_cov_10_default_three_grids"] == pytest.approx(2 * 3560 / 7200)
    assert values["expected_hours_rare_three_grids"] == pytest.approx((4700 + 60 * 30) / 7200)


@pytest.mark.parametrize("case", [case for case in nested.GOOD if case.coarser], ids=lambda case: case.name)
def test_a_campaign_has_the_samples_that_its_case_asks_for(case):
    rows = nested.repeat(case, 0, 1)
    again = nested.repeat(case, 0, 1)
    assert (rows == again).all()
    row = nested.summarise(case, rows)
    assert row["runs_q50"] <= case.samples[-1]
    assert row["rmse"] < 1
