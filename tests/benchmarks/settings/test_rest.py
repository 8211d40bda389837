"""The benchmark of slides that end at rest: what it tells of rows, and rows that lie."""

from dataclasses import replace

import pytest

from benchmarks.settings import rest

NAME = "section, published"


def row(number, ruled, steps, displacement, area, mode="deep"):
    status = "SETTLED" if ruled else "FINISHED"
    return f'"{NAME}",{int(ruled)},{number},{status},{steps},{displacement},12.9,13.0,12.5,200.0,{area},{mode}'


def write(path, *rows):
    path.write_text("\n".join([",".join(rest.COLUMNS), *rows, ""]))


def test_what_the_rule_saves_and_what_it_changes(tmp_path, monkeypatch):
    path = tmp_path / "rest.csv"
    monkeypatch.setattr(rest, "DATA", path)
    write(
        path,
        row(3, False, 1000, 10.0, 50.0), row(3, True, 600, 10.1, 50.0),
        row(8, False, 1000, 12.0, 40.0, "progressive"), row(8, True, 800, 12.0, 39.0, "deep"),
        row(9, False, 1000, 12.0, 40.0),
    )  # fmt: skip
    values = rest.run(quick=True).values
    assert values["slides"] == 2
    assert values["saved_0"] == pytest.approx(0.3)
    assert values["largest_change_of_a_length_cells"] == pytest.approx(0.1)
    assert values["largest_change_of_an_amount"] == pytest.approx(0.025)
    assert values["modes_changed"] == 1


@pytest.mark.parametrize("name", rest.CASES)
def test_a_model_of_a_case_names_the_slides_of_its_grid(name):
    assert rest.CASES[name].grid in rest.campaign_of(rest.CASES[name]).modes


def test_slides_that_are_there_are_not_run_again(tmp_path, monkeypatch):
    monkeypatch.setattr(rest, "CASES", {NAME: replace(rest.CASES[NAME], slides=2)})
    monkeypatch.setattr(rest, "DATA", tmp_path / "rest.csv")
    write(rest.DATA, *(row(n, ruled, 600, 10.0, 50.0) for n in (3, 8) for ruled in (False, True)))
    before = rest.DATA.read_text()
    monkeypatch.setattr(rest, "prepared", lambda case: pytest.fail("built a model"))
    rest.main()
    assert rest.DATA.read_text() == before


def test_the_stored_rows_hold_what_the_rule_promises():
    values = rest.run(quick=True).values
    assert values["slides"] >= 1
    assert values["modes_changed"] == 0
    assert values["largest_change_of_depth_or_runout_cells"] <= 0.5
    assert values["largest_change_of_an_amount"] <= 0.02
