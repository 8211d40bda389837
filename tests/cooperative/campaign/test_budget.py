"""Folders that allow more refined runs than their scene did."""

import json
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.robustness.invented import SCENE
from cooperative import campaign, reporting
from cooperative.__main__ import main
from cooperative.scene import Budget, campaign_of, kept
from cooperative.store import open_store, read_rows, read_store
from tests.cooperative.campaign.test_campaign import TINY
from tests.cooperative.campaign.test_cli import invented_campaign
from tests.databases import by_sql, keep

pytestmark = pytest.mark.usefixtures("made_up")


@pytest.mark.slow
def test_a_folder_that_allows_more_ends_as_one_that_allowed_it_from_the_start(tmp_path):
    first = campaign.run(SCENE, tmp_path / "more")
    assert (first.cost.refined_runs, first.cost.refined_runs_allowed) == (15, None)
    summary = campaign.run(SCENE, tmp_path / "more", refined_runs=30)
    assert summary.cost.refined_runs == 30
    assert summary.cost.refined_runs_allowed == Budget(refined_runs=30, scene=15)
    assert "the folder allows 30 refined runs, the scene 15" in summary.notes
    whole = campaign.run(SCENE.replace("refined_runs = 15", "refined_runs = 30"), tmp_path / "whole")
    cost = replace(summary.cost, seconds=whole.cost.seconds, refined_runs_allowed=None)
    assert replace(summary, cost=cost, notes=whole.notes) == whole
    # It is stored: who goes on, reports or looks need not give it again.
    assert campaign.run(SCENE, tmp_path / "more") == summary
    assert campaign_of(read_store(tmp_path / "more")).estimator.budget(50) == 30


def test_a_campaign_whose_rough_runs_broke_off_has_a_way_out(tmp_path, capsys, monkeypatch):
    # Fifteen rough runs broke off, and each wants one of fifteen refined runs.
    rough = [(number, -1.0 if number < 15 else 0.1 + 0.01 * number) for number in range(50)]
    folder = invented_campaign(tmp_path / "stuck", SCENE, rough, [])
    assert main(["resume", str(folder), "--workers", "1"]) == 2
    printed = capsys.readouterr().err
    assert (
        "15 rough runs broke off and want a refined run each, of 15 runs in all: give more runs (--refined-runs)"
        in printed
    )
    # Its figures would need real grids.
    monkeypatch.setattr(reporting, "report", lambda folder: "told")
    assert main(["resume", str(folder), "--workers", "1", "--refined-runs", "30"]) == 0
    refined = read_rows(read_store(folder), "refined")
    assert len(refined.numbers) == 30
    assert set(range(15)) <= set(refined.numbers)
    assert np.isfinite(json.loads((folder / "summary.json").read_text())["probability"]["coefficient_of_variation"])


@pytest.mark.parametrize(
    ("scene", "runs", "message"),
    [
        (SCENE, 15, "refined_runs = 15: the campaign allows 15 already, give more"),
        (SCENE, -1, "refined_runs = -1: the campaign allows 15 already, give more"),
        (SCENE, 99999999999999999999, "refined_runs = 99999999999999999999: give at most 2,147,483,647"),
        (SCENE, 2**31, "refined_runs = 2147483648: give at most 2,147,483,647"),
        (TINY, 20, "refined_runs = 20 while the rule of estimator 'published' alone decides when to stop"),
    ],
)
def test_a_budget_that_is_none_is_refused_before_anything_is_written(scene, runs, message, tmp_path):
    with pytest.raises(ValueError, match=message):
        campaign.run(scene, tmp_path / "out", refined_runs=runs)
    assert not (tmp_path / "out").exists()


def test_the_most_that_may_be_allowed_is_read_again(tmp_path):
    for _ in range(2):
        assert campaign.run(SCENE, tmp_path / "out", refined_runs=2**31 - 1).cost.refined_runs == 50


def test_what_a_folder_allows_does_not_shrink(tmp_path):
    campaign.run(SCENE, tmp_path / "out", refined_runs=30)
    with pytest.raises(ValueError, match="refined_runs = 20: the campaign allows 30 already"):
        campaign.run(SCENE, tmp_path / "out", refined_runs=20)
    assert campaign.run(SCENE, tmp_path / "out", refined_runs=30).cost.refined_runs == 30


@pytest.mark.parametrize(
    "content", ["", "[30]", '{"refined_runs": "30", "scene": 15}', '{"refined_runs": 1e99, "scene": 1}', "[" * 9999]
)
def test_a_budget_that_is_none_is_named(content, tmp_path):
    open_store(tmp_path, SCENE).close()
    keep(tmp_path, "budget", content)
    with pytest.raises(ValueError, match=r"campaign\.db holds no budget that .*delete from campaign"):
        kept(tmp_path, Budget)
    by_sql(tmp_path, "update campaign set value = '{}' where name = 'budget'")
    with pytest.raises(ValueError, match=r"campaign\.db holds another budget than was written: .*delete from campaign"):
        kept(tmp_path, Budget)
    by_sql(tmp_path, "delete from campaign where name = 'budget'")
    assert kept(tmp_path, Budget) is None
