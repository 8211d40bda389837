"""P_f on charts of rain and of drawdowns: which loads there are, which runs they take, their lines and their files."""

import csv
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cooperative.scene import parse
from cooperative.tools.in_time import _answer, _chart, chart_lines, probability_chart, rate_at, write_chart
from tests.cooperative.scene.test_moving_water import LEVEL, RAIN, scene

STORMS = RAIN + '[rain.chart]\nrates = ["5 mm/h", "10 mm/h", "20 mm/h"]\ndurations = ["6 h", "24 h"]\nafter = ["3 h"]\n'
FALLS = """
[drawdown]
times = ["1 d"]
level = [["0 d", 7.0], ["1 d", 6.0], ["9 d", 3.0], ["10 d", 4.0]]
soil = { soil_class = "loam" }
chart = { rates = ["0.1 m/day", "1 m/day", "10 m/day"] }
"""


def made(moving=STORMS, samples=40):
    campaign = parse(scene(moving, LEVEL if "[rain]" in moving else ""))
    return replace(campaign, plan=replace(campaign.plan, samples=samples))


def true_factors(states, samples):
    """Factors of safety (samples, states) that fall as more water moves or moves faster."""
    moved = np.log([rate * min(state.time, duration) ** 0.5 for state in states for rate, duration in [of(state)]])
    return np.random.default_rng(5).normal(1.03, 0.08, (samples, 1)) - (moved - moved.mean()) / 10


def of(state):
    table = state.campaign.seepage
    if state.campaign.drawdown is not None:
        (_, first), (duration, last) = table.level
        return (first - last) / duration, duration
    return table.rate[0][1], table.rate[1][0]


@pytest.fixture
def asked(monkeypatch):
    """Runs that fail where slices have a factor below 1.03 on the rough grid and 1 on the refined."""
    record = []

    def screened(runner, progress):
        return runner.kept.screen(true_factors(runner.states, runner.campaign.plan.samples))

    def ask(runner, grid, at, numbers):
        for number in numbers:
            record.append((grid, at, number))
            yield number, bool(runner.kept.factors[number, at] < {"rough": 1.03, "refined": 1.0}[grid])

    monkeypatch.setattr(_chart, "screened", screened)
    monkeypatch.setattr(_answer.StateRunner, "ask", ask)
    return record


def test_storms_rain_at_one_rate_and_are_asked_at_their_end_and_after_it():
    rows = _chart.loads_of(made())
    assert [load.words for load in rows[0]] == ["5 mm/h for 6 h", "5 mm/h for 24 h"]
    for row, rate in zip(rows, (5, 10, 20), strict=True):
        for load, hours in zip(row, (6, 24), strict=True):
            table = load.campaign.rain
            np.testing.assert_allclose(table.rate, [(0, rate / 3.6e6), (hours * 3600, 0)])
            assert table.times == (hours * 3600, hours * 3600 + 3 * 3600)
            assert [state.time for state in load.states(0)] == list(table.times)


def test_drawdowns_fall_from_the_first_level_to_the_lowest():
    rows = _chart.loads_of(made(FALLS))
    for (load,), days in zip(rows, (40, 4, 0.4), strict=True):
        np.testing.assert_allclose(load.campaign.drawdown.level, [(0, 7), (days * 86400, 3)])
        assert load.duration == pytest.approx(days * 86400) == load.states(0)[-1].time


@pytest.mark.parametrize("moving", [STORMS, FALLS], ids=["storms", "drawdowns"])
def test_a_chart_has_the_answers_of_all_runs_by_a_few_of_them(asked, moving, tmp_path):
    campaign = made(moving)
    result = probability_chart(campaign, tmp_path, refined_runs=20)
    states = _chart.states_on_chart(_chart.loads_of(campaign))
    shape = result.probability.shape
    least = true_factors(states, 40).reshape(40, *shape, -1).min(axis=-1)
    np.testing.assert_array_equal(result.rough, least < 1.03)
    np.testing.assert_array_equal([result.refined[n] for n in range(20)], least[:20] < 1.0)
    np.testing.assert_allclose(result.factors, least)
    assert 0 < result.rough.mean() < 1
    assert len({(n, at) for grid, at, n in asked if grid == "rough"}) == result.runs["rough"] <= 3.5 * 40
    # More rain and a faster fall are no safer.
    for axis in (0, 1):
        assert np.all(np.diff(result.probability, axis=axis) >= 0)
        assert np.all(np.diff(result.interval, axis=axis + 1) >= 0)
    low, high = result.interval
    assert np.all((low <= result.probability) & (result.probability <= high))

    before = len(asked)
    again = probability_chart(campaign, tmp_path, refined_runs=20)
    assert len(asked) == before
    np.testing.assert_array_equal(again.rough, result.rough)

    names = [path.name for path in write_chart(result, tmp_path)]
    assert names == ["chart.png", "chart.csv", "chart_lines.csv"]
    with (tmp_path / "chart.csv").open() as file:
        table = list(csv.DictReader(file))
    assert [float(row["P_f"]) for row in table] == pytest.approx(result.probability.ravel())
    assert float(table[-1]["intensity [mm/h]" if moving is STORMS else "fall [m/day]"]) == pytest.approx(
        20 if moving is STORMS else 10
    )
    with (tmp_path / "chart_lines.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 3 * shape[1]
    words = "\n".join(chart_lines(result))
    assert f"{result.probability[-1, -1]:.3f}" in words
    assert f"{result.runs['rough']} and" in words


@given(
    rates=st.lists(st.floats(1e-9, 1e-3), min_size=2, max_size=8, unique=True).map(sorted),
    chances=st.lists(st.floats(0, 1), min_size=8, max_size=8).map(sorted),
    chance=st.floats(0, 1),
)
def test_a_line_stands_where_the_probability_is_passed(rates, chances, chance):
    chances = chances[: len(rates)]
    found = rate_at(chance, rates, chances)
    if chance < chances[0] or chance > chances[-1]:
        assert np.isnan(found)
    else:
        assert rates[0] * (1 - 1e-9) <= found <= rates[-1] * (1 + 1e-9)
        below = [rate for rate, value in zip(rates, chances, strict=True) if value < chance]
        above = [rate for rate, value in zip(rates, chances, strict=True) if value >= chance]
        assert max(below, default=0.0) <= found * (1 + 1e-9)
        assert found <= min(above) * (1 + 1e-9)


def test_what_has_no_chart_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"add \[rain.chart\]"):
        probability_chart(made(RAIN), tmp_path)
    assert not list(tmp_path.iterdir())


@pytest.mark.usefixtures("asked")
def test_a_chart_without_factors_is_refused(monkeypatch, tmp_path):
    monkeypatch.setattr(_chart, "screened", lambda runner, progress: np.full((40, len(runner.states)), np.nan))
    with pytest.raises(ValueError, match="by slices"):
        probability_chart(made(), tmp_path)


@pytest.mark.slow  # the flow of four storms, and two searches for a critical surface
def test_a_chart_of_a_slope_rises_with_the_rain(tmp_path):
    campaign = made(STORMS.replace('"5 mm/h", "10 mm/h"', '"2 mm/h"'), samples=12)
    result = probability_chart(campaign, tmp_path, refined_runs=0)
    # Each sample has the lower factor under more rain.
    assert np.all(np.diff(result.factors, axis=1) <= 1e-6)
    assert np.all(np.diff(result.factors, axis=2) <= 1e-6)
    assert result.factors[:, 1, 1].mean() < result.factors[:, 0, 0].mean() - 0.02
