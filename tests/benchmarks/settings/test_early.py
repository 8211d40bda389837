"""The benchmark of the early rule: its file is what campaigns do, and no class changes in it."""

import json
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.measure import ROOT, scene_campaign
from benchmarks.settings import early, early_runs
from benchmarks.speed import class_runs
from cooperative import runs
from cooperative.summary import _notes
from jaxmpm import Status


def test_no_class_changes_in_more_runs_than_a_summary_names():
    values = early.run(quick=True).values
    assert values["classes_changed"] == values["classes_changed_3d"] == 0
    assert values["tested"] >= _notes.EARLY_TESTED
    assert values["tested_3d"] >= _notes.EARLY_TESTED_3D
    assert values["error_at_most"] == pytest.approx(3 / values["tested"], rel=0.01)
    assert values["spearman"] > 0.97
    for row in early.run(quick=True).rows:
        assert row["changed_where_chosen"] == 0
        if "spearman_early" in row:
            assert row["spearman_early"] > row["spearman_before"]
            assert row["spearman_early_failures"] > row["spearman_before_failures"]


def test_the_rule_on_the_side_gives_what_a_campaign_does():
    case, numbers = early_runs.CASES["section, default, rough"], [0, 2, 5]
    campaign = scene_campaign(case.scene)
    campaign = replace(campaign, plan=replace(campaign.plan, samples=case.samples))
    soil = runs.random_soil(campaign)
    model, coefficients = runs.build(campaign, case.grid, soil), runs.coefficients_of(campaign, soil)
    samples = list(
        runs.run_samples(model, coefficients, numbers, width=1, rules=campaign.rules(campaign.run.failure_displacement))
    )
    rows = [dict(zip(list(early_runs.COLUMNS)[1:], row, strict=True)) for row in early_runs._rows(case, numbers)]
    assert {sample.status for sample in samples} == {Status.DECIDED.name, Status.SETTLED.name}
    for sample, row in zip(samples, rows, strict=True):
        assert (sample.number, sample.status) == (row["number"], row["early_status"])
        assert float(row["early_time"]) == pytest.approx(sample.steps * float(model.scene.numerics.time_step), rel=1e-4)
        if sample.status == Status.DECIDED.name:
            assert float(row["early_displacement"]) == pytest.approx(sample.row["displacement"], rel=1e-4)
    stored = early_runs.read()["section, default, rough"]
    assert [stored[number].early_status for number in numbers] == [sample.status for sample in samples]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("DECIDED", "FAILED", r"early\.csv, line \d+: (early_)?status = 'FAILED': give one of"),
        ('"section, rough",1,', '"section, rough",0,', r"its run stands there twice"),
        ('"section, rough",1,', '"section",1,', r"case = 'section': give one of"),
    ],
)
def test_a_line_that_no_run_could_have_left_is_named(tmp_path, monkeypatch, old, new, message):
    text = early_runs.DATA.read_text()
    assert old in text
    monkeypatch.setattr(early_runs, "DATA", tmp_path / "early.csv")
    early_runs.DATA.write_text(text.replace(old, new, 1))
    with pytest.raises(ValueError, match=message):
        early_runs.read()


def test_core_seconds_are_those_of_a_step_times_the_mean_number_of_steps(monkeypatch):
    monkeypatch.setattr(class_runs, "on_cores", lambda cores, *arguments: {"step": 0.01, "time_step": 0.005})
    report = class_runs.run(quick=True)
    hours = {"expected_hours_to_cov_10", "expected_hours_to_cov_10_default"}
    assert report.values.keys() == {*class_runs.NAMES.values(), *hours}
    for row in report.rows:
        assert row["core_seconds"] == pytest.approx(2 * row["simulated_s"])
        assert 0 < row["simulated_s"] < 0.7 * row["simulated_before_s"]
    known = early_runs.read()["3D, rough"].values()
    estimators = json.loads((ROOT / "benchmarks" / "data" / "results" / "estimators.json").read_text())["values"]
    half = estimators["target_cov_runs_q50_r098"]
    runs_of = 1000 * report.values["rough_core_seconds"], half * report.values["refined_class_core_seconds"]
    assert report.values["expected_hours_to_cov_10"] == pytest.approx(sum(runs_of) / 7200)
    assert report.rows[0]["simulated_s"] == pytest.approx(np.mean([run.early_time for run in known]))
