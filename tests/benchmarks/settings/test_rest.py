"""The benchmark of slides that end at rest: what it tells of rows, and rows that lie."""

import csv
from dataclasses import replace

import pytest

from benchmarks.settings import rest
from benchmarks.study.cases import campaign_of
from cooperative.runs import build, coefficients_of, random_soil, run_samples
from jaxmpm import Settle
from tests.benchmarks.study.test_study import TINY

NAME = "section, published"
DEFAULT = "section, default"


def row(number, ruled, steps, displacement, area, mode="deep"):
    status = "SETTLED" if ruled else "FINISHED"
    return f'"{NAME}",{int(ruled)},{number},{status},{steps},{displacement},13.0,12.5,200.0,{area},{mode}'


def write(path, *rows):
    path.write_text("\n".join([",".join(rest.COLUMNS), *rows, ""]))


def test_what_the_rule_saves_and_what_it_changes(tmp_path, monkeypatch):
    path = tmp_path / "rest.csv"
    monkeypatch.setattr(rest, "DATA", path)
    monkeypatch.setattr(rest, "LONGER", tmp_path / "none.csv")
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
    assert values["moved_20_to_25_slides"] is values["moved_20_to_25_max_cells"] is None
    assert values["second_release_after_max_s"] is None


def longer(case, number, *, runout=(12.5, 12.6), volume=(200.0, 202.0), runout_any=(13.0, 16.0), second=""):
    """A row of a slide that ran on."""
    twice = ((10.0, 10.1), (13.0, 13.0), runout, volume, runout, (11.0, 11.0), runout_any)
    values = [each[at] for at in (0, 1) for each in twice]
    mode = "progressive" if second else "deep"
    return f'"{case}",{number},FINISHED,9000,' + ",".join(map(str, (*values, mode, 2.5, second)))


def test_how_far_slides_move_after_20_s_and_when_a_second_mass_lets_go(tmp_path, monkeypatch):
    monkeypatch.setattr(rest, "LONGER", tmp_path / "rest_25_s.csv")
    lines = longer(NAME, 3), longer(NAME, 8, second=9.0), longer(DEFAULT, 3, runout=(12.5, 12.1), second=5.0)
    broke_off = f'"{DEFAULT}",4,OUTSIDE_GRID,900,' + "," * 16
    rest.LONGER.write_text("\n".join([",".join(rest.COLUMNS_LONGER), *lines, broke_off, ""]))
    report = rest.run(quick=True)
    assert report.values["moved_20_to_25_slides"] == 4
    assert report.values["moved_20_to_25_broke_off"] == 1
    assert report.values["moved_20_to_25_max_cells"] == pytest.approx(0.4)
    assert report.values["moved_20_to_25_max_share"] == pytest.approx(0.032)
    assert report.values["moved_20_to_25_any_max_cells"] == pytest.approx(3.0)
    assert report.values["second_release_after_max_s"] == pytest.approx(6.5)
    published, default = report.rows[-2:]
    assert (published["case"], published["slides"], published["progressive"]) == (NAME, 2, 1)
    assert published["moved_displacement_cells"] == pytest.approx(0.1)
    assert (default["slides"], default["broke_off"]) == (2, 1)


def test_a_slide_that_runs_on_is_measured_twice_in_one_run():
    campaign = campaign_of("demo", TINY)
    soil = random_soil(campaign)
    model, coefficients = build(campaign, "rough", soil), coefficients_of(campaign, soil)
    run = replace(model.campaign.run, settle=Settle())
    plan = replace(model.campaign.plan, modes=("rough",))
    model = replace(model, campaign=replace(model.campaign, run=run, plan=plan), strength_factor=0.25)
    first, second = rest.run_on(model, coefficients, 0, (1.5, 2.0))
    (alone,) = run_samples(model, coefficients, [0], width=1)
    assert second.row == alone.row
    assert second.row["onset"] > 0
    assert 1.0 < first.row["displacement"] < second.row["displacement"]
    assert first.row["runout_any"] < second.row["runout_any"]


def test_slides_that_are_there_are_not_run_again(tmp_path, monkeypatch):
    monkeypatch.setattr(rest, "CASES", {NAME: replace(rest.CASES[NAME], slides=2)})
    monkeypatch.setattr(rest, "DATA", tmp_path / "rest.csv")
    monkeypatch.setattr(rest, "LONGER", tmp_path / "rest_25_s.csv")
    write(rest.DATA, *(row(n, ruled, 600, 10.0, 50.0) for n in (3, 8) for ruled in (False, True)))
    before, asked = rest.DATA.read_text(), []
    rest.LONGER.write_text("\n".join([",".join(rest.COLUMNS_LONGER), longer(NAME, 3), ""]))

    def run_longer(name, case, samples):
        asked.extend(samples)
        return [next(csv.reader([longer(name, sample)])) for sample in samples]

    monkeypatch.setattr(rest, "prepared", lambda case: pytest.fail("built a model"))
    monkeypatch.setattr(rest, "_rows_longer", run_longer)
    rest.main()
    assert asked == [8]
    assert sorted(rest.read_longer(rest.LONGER)[NAME]) == [3, 8]
    rest.main()
    assert asked == [8]
    assert rest.DATA.read_text() == before


def test_the_stored_rows_hold_what_the_rule_promises():
    values = rest.run(quick=True).values
    assert values["slides"] >= 1
    assert values["modes_changed"] == 0
    assert values["largest_change_of_a_length_cells"] <= 0.5
    assert values["largest_change_of_an_amount"] <= 0.02
