"""The benchmark of the gap's memory: what it tells of rows, and rows that lie."""

import pytest

from benchmarks.settings import opened_soil
from benchmarks.settings.opened_soil import CALIBRATED, CASES, COLUMNS, LEFT, OTHERS

NAME = "section, published"


def row(number, memory, displacement, *, foremost=12.0, closed=5.0, status="SETTLED", mode="deep", name=NAME):
    closed = closed if memory else ""
    lengths = f"{displacement},13.0,{foremost - 1},200.0,50.0,{foremost}"
    return f'"{name}",{int(memory)},{number},{status},600,{lengths},{mode},{closed}'


def write(path, *rows):
    path.write_text("\n".join([",".join(COLUMNS), *rows, ""]))
    return path


def test_what_the_memory_changes(tmp_path, monkeypatch):
    thrown = f'"{NAME}",0,4,OUTSIDE_GRID,600,12.0,,,,,,,'
    rows = [
        row(0, True, 10.2, closed=0.1), row(0, False, 10.0),
        row(1, True, 10.0, foremost=15.0), row(1, False, 10.0, mode="shallow"),
        row(2, True, 0.1, mode="none"), row(2, False, 0.1, mode="none"),
        row(3, True, 0.9, mode="none"), row(3, False, 1.1),
        row(4, True, 12.0), thrown, row(5, True, 12.0),
    ]  # fmt: skip
    monkeypatch.setattr(opened_soil, "DATA", write(tmp_path / "opened.csv", *rows))
    values = opened_soil.run(quick=True).values
    expected = {
        "runs": 5, "fail": 3, "broke_off_without": 1, "broke_off_with": 0, "classes_changed": 1, "modes_changed": 1,
        "slides_nothing_closes": 1, "slides_soil_closes": 1,
    }  # fmt: skip
    assert {name: values[name] for name in expected} == expected
    assert values["median_change_nothing_closes_cells"] == pytest.approx(0.2)
    assert values["largest_change_soil_closes_cells"] == pytest.approx(3.0)


@pytest.mark.parametrize("name", CASES)
def test_a_model_of_a_case_measures_and_names_the_slides_of_its_grid(name):
    for memory in (False, True):
        campaign = opened_soil.campaign_of_case(CASES[name], memory)
        assert CASES[name].grid in campaign.modes
        assert campaign.soil.gap_memory is memory


def test_the_study_holds_the_slides_that_are_run_again():
    for name, case in CASES.items():
        if case.study is not None:
            there = case.stored()
            assert set(case.numbers()) <= there.keys(), name
            left = {sample for sample, row in there.items() if row["status"] == "OUTSIDE_GRID"}
            assert left == (set(LEFT) if case.grid == "refined" else set()), name
    assert sum(len(case.numbers()) for case in CASES.values() if case.reduction == CALIBRATED) == 200
    assert not set(LEFT) & set(OTHERS)
    assert len(OTHERS) == 10


def test_the_stored_rows_are_whole():
    for (name, memory), rows in opened_soil.read(opened_soil.DATA).items():
        assert rows.keys() <= set(CASES[name].numbers())
        assert memory or CASES[name].study is None
