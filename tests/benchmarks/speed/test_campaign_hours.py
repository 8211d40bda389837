"""The benchmark of a whole campaign's hours: seconds of all lives, stages that end and go on, on made-up runs."""

import json
from dataclasses import replace

import pytest

from benchmarks.measure import ROOT
from benchmarks.robustness import invented
from benchmarks.speed import campaign as hours
from cooperative import campaign, runs
from cooperative.scene import parse

TEXT = hours.scene_text("paper_section", {"samples": 20, "target_cov": 0.6, "screening_stop": 1.0, "slides": 2})
PUBLISHED, SLIDES = hours.STAGES["hours_to_cov_10"], hours.STAGES["hours_slides"]
EACH = 0.002
"""Seconds of a made-up run."""


@pytest.fixture
def made_up(monkeypatch):
    invented.invent(EACH, put=monkeypatch.setattr)


def measured(folder, stage=PUBLISHED, name="hours_to_cov_10"):
    return hours.measured(folder, name, stage, TEXT, workers=1)


def test_seconds_of_every_life_count_and_what_has_ended_is_not_run_again(tmp_path, made_up, monkeypatch):
    def killed(*arguments, **choices):
        for number, sample in enumerate(run_samples(*arguments, **choices)):
            yield sample
            if number == 14:
                raise runs.Stopped

    run_samples = runs.run_samples
    with monkeypatch.context() as patched:
        patched.setattr(runs, "run_samples", killed)
        with pytest.raises(runs.Stopped):
            measured(tmp_path)
    first = json.loads((tmp_path / "hours_to_cov_10.json").read_text())
    assert first["lives"] == 1
    assert first["seconds"].keys() == {"set-up", "screening"}
    assert first["seconds"]["screening"] >= 15 * EACH
    figures = measured(tmp_path)
    assert figures["lives"] == 2
    assert figures["seconds"].keys() == {"set-up", "screening", "audit", "rest"}
    assert figures["seconds"]["screening"] >= first["seconds"]["screening"] + 5 * EACH
    assert figures["seconds"]["audit"] >= figures["refined_runs"] * EACH
    assert figures["hours"] == pytest.approx(sum(figures["seconds"].values()) / 3600)
    assert (figures["samples"], figures["slides"]) == (20, 0)
    assert 0 < figures["cov"] <= 0.6
    monkeypatch.setattr(campaign, "run", None)
    assert measured(tmp_path) == figures


def test_slides_go_on_in_the_same_folder_and_have_hours_of_their_own(tmp_path, made_up):
    published = measured(tmp_path)
    slides = measured(tmp_path, SLIDES, "hours_slides")
    assert (slides["refined_runs"], slides["probability"]) == (published["refined_runs"], published["probability"])
    assert (tmp_path / "published" / "summary.json").exists()
    row = hours.report({"hours_to_cov_10": published | {"cov": 0.09}, "hours_slides": slides | {"cov": 0.09}}).values
    assert row["hours_to_cov_10"] == published["hours"]
    assert row["hours_slides"] == slides["hours"]
    assert row["hours_to_cov_10_default"] is None
    assert sum(row["share_of_time"].values()) == pytest.approx(1.0, abs=1e-3)
    whole = published["hours"] + slides["hours"]
    assert row["share_of_time"]["slides"] == pytest.approx(slides["hours"] / whole, abs=1e-4)
    estimators = json.loads((ROOT / "benchmarks" / "data" / "results" / "estimators.json").read_text())["values"]
    half = estimators["target_cov_runs_q50_r098"]
    seconds = published["samples"] * published["mean_rough_s"] + half * published["mean_refined_s"]
    assert 3600 * row["expected_hours_to_cov_10"] == pytest.approx(seconds + published["seconds"]["set-up"])
    assert row["expected_hours_to_cov_10_default"] is None
    assert hours.report({"hours_to_cov_10": published | {"cov": 0.11}}).values["hours_to_cov_10"] is None


def test_seconds_are_stored_while_a_part_lasts(tmp_path):
    book = tmp_path / "book.json"
    with hours.counting(book, {"seconds": {"audit": 5.0}, "lives": 2}, every=0.005) as begins:
        begins("audit")
        while not book.exists() or (stored := json.loads(book.read_text()))["seconds"]["audit"] <= 5.0:
            pass
    assert stored["lives"] == 3


def test_every_stage_ends_where_a_campaign_has_a_phase(tmp_path, made_up):
    seen = []
    campaign.run(TEXT, tmp_path, on_phase=seen.append)
    assert seen == list(hours.PARTS)
    assert {stage.before for stage in hours.STAGES.values()} <= {*seen, None}
    never = replace(PUBLISHED, before="no phase")
    assert measured(tmp_path / "whole", never)["seconds"].keys() == {"set-up", *hours.PARTS.values()}


@pytest.mark.parametrize("text", ["[]", "{", '{"seconds": {"audit": -1}, "lives": 1}', '{"seconds": {}, "lives": 0}'])
def test_a_file_that_holds_no_seconds_is_named(tmp_path, text):
    (tmp_path / "hours_to_cov_10.json").write_text(text)
    with pytest.raises(ValueError, match=r"hours_to_cov_10\.json holds no seconds.*delete"):
        measured(tmp_path)


def test_scenes_of_the_stages_are_read_and_ask_for_classes():
    for stage in hours.STAGES.values():
        for scene in stage.scene:
            asked = parse(hours.scene_text(scene, hours.PLAN | {"slides": stage.slides}))
            assert asked.plan.screening_stop == asked.run.failure_displacement
            assert asked.estimator.target_cov == 0.1
            assert asked.plan.slides == stage.slides
