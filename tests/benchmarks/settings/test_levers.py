"""The table of what particles and time step change: its file, and what it makes of one."""

import numpy as np
import pytest

from benchmarks.settings import levers, levers_runs

PLAIN = ("section", "rough", 1.0, 0.5, "class")
FASTER = ("section", "rough", 1.0, 0.9, "class")


def outcome(displacement, *, status=2, steps=100, time=2.0, energy=-1.0):
    values = status, steps, time, displacement, 0.0, energy
    return dict(zip(levers_runs.MEASURED, map(float, values), strict=True))


def test_the_default_time_step_is_that_of_the_table():
    values = levers.run(quick=True).values
    assert values["samples_cfl"] == 1600
    assert values["classes_changed_cfl"] == values["broke_off_cfl"] == values["runs_that_gain_energy_cfl"] == 0
    assert values["spearman_cfl"] > 0.99
    assert values["cost_share_cfl"] < 0.62


def test_changed_classes_energy_and_broken_runs_are_counted():
    plain = {0: outcome(0.1), 1: outcome(1.2, status=3), 2: outcome(1.1, status=3, time=1.0), 3: outcome(0.2)}
    faster = {
        0: outcome(0.1, steps=50),
        1: outcome(0.9, steps=50),
        2: outcome(1.1, status=3, energy=2.0),
        4: outcome(0.3),
    }
    row = levers.row(FASTER, {PLAIN: plain, FASTER: faster})
    assert (row["samples"], row["fail"], row["classes_changed"]) == (3, 1, 1)
    assert (row["runs_that_gain_energy"], row["broke_off"]) == (1, 0)
    assert row["cost_share"] == pytest.approx(200 / 300, abs=1e-3)


def test_slopes_that_fail_sooner_rank_above():
    runs = [outcome(1.05, status=3, time=1.0), outcome(1.2, status=3, time=4.0), outcome(0.5)]
    rank = levers.rank_by({name: np.array([run[name] for run in runs]) for name in levers_runs.MEASURED})
    assert rank == pytest.approx([21.0, 6.0, 0.5])


GOOD = "section,rough,1.0,0.5,class,6,2,490,1.8,0.07,0,-1"
NEXT = GOOD.replace(",6,", ",7,")


@pytest.mark.parametrize(
    ("row", "message"),
    [
        (NEXT.replace("490", "many"), "steps = 'many' is no number"),
        (NEXT.replace("-1", "nan"), "energy = 'nan' is not finite"),
        (NEXT.replace("0.07", "inf"), "displacement = 'inf' is not finite"),
        (NEXT.replace("0.07", "-0.07"), "displacement = '-0.07' is not at least 0"),
        (NEXT.replace("1.8", "0"), "time = '0' is not above 0"),
        (NEXT.replace(",2,490", ",0,490"), "status = '0' is none of 1, 2, 3, 4"),
        (NEXT.replace(",7,", ",-7,"), "number = '-7' is no whole number"),
        (NEXT.replace("class", "clas"), "until = 'clas' is none of class, end"),
        (NEXT.replace("1.0,", "1.5,"), "spacing = 1.5, cfl = 0.5 of the rough grid to its class is no variant"),
        ("section,rough,1.0", "3 cells instead of 12"),
        (NEXT + ",1", "13 cells instead of 12"),
        ("a,b,c,d,e,f,g,h,i,j,k,l", "scene = 'a' is none of paper_section, section"),
        (GOOD, "its run stands there twice"),
    ],
)
def test_a_row_that_does_not_parse_is_named_with_its_line(tmp_path, monkeypatch, row, message):
    path = tmp_path / "levers.csv"
    path.write_text("\n".join([",".join(levers_runs.COLUMNS), GOOD, row, ""]))
    monkeypatch.setattr(levers_runs, "DATA", path)
    with pytest.raises(ValueError, match=rf"levers\.csv, line 3: .*{message}.*delete"):
        levers_runs.read()
    assert path.read_text().startswith(",".join(levers_runs.COLUMNS) + "\n" + GOOD)


def test_a_run_that_broke_off_at_once_may_have_taken_no_time(tmp_path, monkeypatch):
    path = tmp_path / "levers.csv"
    path.write_text(",".join(levers_runs.COLUMNS) + "\n" + GOOD.replace("2,490,1.8", "8,0,0"))
    monkeypatch.setattr(levers_runs, "DATA", path)
    (row,) = levers_runs.read()[PLAIN].values()
    assert row["time"] == 0
