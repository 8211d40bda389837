"""The study: cases are campaigns, rows in benchmarks/data are whole, and damage in them is named."""

import json

import numpy as np
import pytest

from benchmarks.study import __main__ as command
from benchmarks.study import cases, rows
from benchmarks.study.rows import Outcome, Run
from cooperative.runs import check_size

TINY = {"rough": {"cell": 4.0, "spacing": [2.0, 2.0]}, "refined": {"cell": 2.0, "spacing": [1.0, 1.0]}}
TINY |= {"run": {"t_end": 2.0}}
HEAD = '# {"cases": {}}'
STOOD = "mean strength,rough,0,1.26,class,SETTLED,0.05,2,500,1.5,,,,,,,,,,,,cpu"
SLID = "published,refined,7,1,end,FINISHED,14,20,5000,9,12,12.5,13,4000,900,deep,1,1.5,,14.2,12.6,cpu"


@pytest.mark.parametrize("case", cases.CASES)
def test_every_case_is_a_scene_and_with_its_plan_a_campaign(case):
    definition, plan = cases.CASES[case], {"campaign": cases.plan_of(case)}
    changes = definition["changes"] | {"campaign": definition["changes"].get("campaign", {}) | plan["campaign"]}
    campaign = cases.campaign_of(definition["scene"], changes)
    assert set(campaign.grids) == {"rough", "refined"}
    assert campaign.soil.gap_memory == ("default" in case)
    assert {grid.fbar for grid in campaign.grids.values()} == {"F-bar" in case}
    check_size(campaign)


@pytest.mark.slow
def test_a_case_runs_as_a_campaign_or_as_a_search(monkeypatch, tmp_path):
    few = {"campaign": {"samples": 20}}
    monkeypatch.setitem(cases.CASES, "published", {"scene": "demo", "changes": TINY | few})
    monkeypatch.setattr(command, "plan_of", lambda case: {"refined_runs": 10} if case == "published" else {})
    assert command.run_case("published", tmp_path).startswith("published: ")
    assert (tmp_path / "published" / "report.html").exists()
    monkeypatch.setitem(cases.CASES, "even", {"scene": "demo", "changes": TINY})
    assert command.run_case("even", tmp_path).startswith("even: factor of safety 1")


def test_rows_rest_on_the_cases_as_they_are():
    definitions = json.loads(json.dumps(cases.CASES))
    for name in rows.FILES:
        head = (rows.DATA / f"study_{name}.csv").read_text().split("\n", 1)[0]
        for case, definition in json.loads(head.removeprefix("# "))["cases"].items():
            assert definition == definitions[case], (name, case)


def test_all_files_of_rows_are_read():
    others = {"study_section_fos.csv"} - {f"study_{name}.csv" for name in rows.FILES}
    assert {path.name for path in rows.DATA.glob("study_*.csv")} == {
        f"study_{name}.csv" for name in rows.FILES
    } | others
    assert len(rows.read_study()) == 8985


@pytest.fixture
def table(tmp_path):
    path = tmp_path / "study_fos.csv"
    path.write_text("\n".join([HEAD, ",".join(rows.COLUMNS), STOOD, SLID, ""]))
    return path


def test_a_row_is_a_run_and_its_outcome(table):
    stood, slid = rows.read_table(table).items()
    assert stood == (Run("mean strength", "rough", reduction=1.26), Outcome("SETTLED", 0.05, 2.0, 500, 1.5))
    assert slid[0] == Run("published", "refined", 7, until="end")
    assert (slid[1].mode, slid[1].masses, slid[1].onset_second, slid[1].runout_any) == ("deep", 1, None, 12.6)


def test_slopes_that_fail_sooner_rank_above_and_all_above_those_that_stand():
    stood = Outcome("SETTLED", 0.05, 2.0, 500, 1.5)
    sooner, later = Outcome("DECIDED", 1.1, 2.0, 1, 1.0), Outcome("DECIDED", 1.3, 4.0, 1, 1.0)
    assert sooner.score > later.score > 1.0 > stood.score
    assert (sooner.failed, stood.failed) == (True, False)
    broke_off = Outcome("INVERTED", 3.0, 1.0, 1, 1.0)
    assert np.isnan(broke_off.score)
    assert broke_off.failed is None


def test_a_factor_of_safety_is_the_least_that_fails():
    outcomes = {1.3: "DECIDED", 1.15: "SETTLED", 1.22: "SETTLED", 1.26: "DECIDED", 1.24: "INVERTED"}
    known = {Run("a", "rough", 0, r): Outcome(status, 1.2 * (r > 1.23), 1.0, 1, 1.0) for r, status in outcomes.items()}
    assert rows.factor_of_safety(known, "a", "rough") == 1.26
    assert rows.factor_of_safety(known, "a", "refined") is None
