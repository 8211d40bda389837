"""Sweeps: which campaigns they are, what these share, and going on."""

import json
import tomllib
from dataclasses import replace

import numpy as np
import pytest

from cooperative import runs
from cooperative.scene import parse, to_toml
from cooperative.summary import summarise
from cooperative.tools import sweep
from cooperative.tools.sweep import displacement_of
from tests import ROOT
from tests.cooperative.campaign.test_campaign import TINY
from tests.cooperative.effects.test_summary_of_slides import five_slides

TABLE = "[sweep]\nlx = [10, 20.0]\ncov = [0.2, 0.4]\nk_t = [1, 2]\n"
SWEEP = TINY.replace('fields = "both"', 'fields = "none"') + TABLE


def test_one_parameter_is_changed_at_a_time_and_the_scene_itself_runs_once():
    variants = {part.name: part for part in sweep.variants(SWEEP)}
    assert list(variants) == ["base", "lx-10", "cov-0.2", "ranked"]
    assert variants["base"].points == (("lx", 20.0), ("cov", 0.4))
    base, longer = parse(variants["base"].source), parse(variants["lx-10"].source)
    assert base.random["strength"].length == (20.0, 4.0)
    assert longer.random["strength"].length == (10.0, 4.0)
    assert longer.random["strength"].cov == base.random["strength"].cov
    assert parse(variants["cov-0.2"].source).random["strength"].cov == 0.2
    assert parse(variants["ranked"].source).estimator.k_t == 2


def test_campaigns_share_their_coefficients():
    designs = {}
    for part in sweep.variants(SWEEP):
        campaign = parse(part.source)
        designs[part.name] = runs.coefficients_of(campaign, runs.random_soil(campaign))
    modes = min(design.shape[1] for design in designs.values())
    assert len({design.shape[1] for design in designs.values()}) > 1
    for design in designs.values():
        np.testing.assert_array_equal(design[:, :modes], designs["base"][:, :modes])


def test_programs_are_released_after_each_campaign_of_a_sweep(tmp_path, monkeypatch):
    order = []
    summary = summarise(*five_slides())
    summary = replace(summary, modes=replace(summary.modes, shares=None))
    monkeypatch.setattr(sweep, "run_campaign", lambda text, where, **_: order.append(where.name) or summary)
    monkeypatch.setattr(sweep, "release_programs", lambda: order.append("released"))
    monkeypatch.setattr(sweep, "save", lambda figure, path: None)
    monkeypatch.setattr(sweep, "_counted", lambda where: (np.zeros(6), 1.0))
    monkeypatch.setattr(sweep, "_compared", lambda point, *given: point)
    sweep.run(TINY + "[sweep]\ncov = [0.2, 0.4]\n", tmp_path / "out")
    assert order == ["base", "released", "cov-0.2", "released"]


@pytest.mark.slow
def test_a_sweep_answers_for_every_value(tmp_path):
    folder = tmp_path / "tiny"
    result = sweep.run(SWEEP, folder)
    assert json.loads((folder / "sweep.json").read_text()) == result
    assert {name: [row["value"] for row in rows] for name, rows in result["parameters"].items()} == {
        "lx": [10, 20.0],
        "cov": [0.2, 0.4],
        "k_t": [1, 2],
    }
    for rows in result["parameters"].values():
        for row in rows:
            assert row["interval"][0] <= row["probability"] <= row["interval"][1]
            if row["modes"]:
                assert sum(part["ratio"] for part in row["modes"].values()) == pytest.approx(1.0)
    # Both come from the runs of the base campaign or the same samples.
    base = result["parameters"]["lx"][1]
    assert result["parameters"]["cov"][1]["probability"] == base["probability"]
    assert result["parameters"]["k_t"][1]["probability"] == base["probability"]
    fewer, more = result["parameters"]["k_t"]
    assert fewer["refined_runs"] <= more["refined_runs"]
    assert fewer["probability"] <= more["probability"]
    for name in ("probability", "modes"):
        assert (folder / "figures" / f"{name}.png").stat().st_size > 5000


def test_runs_that_broke_off_are_among_the_farthest():
    moved, broke_off = np.arange(100.0), np.zeros(100, bool)
    assert displacement_of(moved, broke_off) == pytest.approx((49.5, 89.1))
    assert displacement_of(moved, moved > 94) == pytest.approx((49.5, 89.1))
    # Whatever their displacement was when they broke off.
    assert displacement_of(moved, moved < 5) == pytest.approx((54.5, 94.1))
    assert displacement_of(moved, moved > 85) is None
    assert displacement_of(moved[:0], broke_off[:0]) is None


def test_the_folder_of_another_sweep_is_refused(tmp_path, made_up):
    made_up.setattr(sweep, "save", lambda figure, path: None)
    assert sweep.run(SWEEP, tmp_path / "mine") == sweep.run(SWEEP, tmp_path / "mine")
    with pytest.raises(ValueError, match="belongs to another sweep"):
        sweep.run(SWEEP.replace("[10, 20.0]", "[10, 30]"), tmp_path / "mine")
    (tmp_path / "letter").write_text("")
    with pytest.raises(ValueError, match="is not empty, and no sweep has begun there"):
        sweep.run(SWEEP, tmp_path)


def test_toml_written_reads_back_the_same():
    tables = tomllib.loads(TINY)
    assert tomllib.loads(to_toml(tables)) == tables
    odd = {"name": 'a "quoted" name, ü', "run": {"settle": False, "t_end": 1e22, "x": [1, 2.5]}}
    assert tomllib.loads(to_toml(odd)) == odd


@pytest.mark.parametrize(("scene", "campaigns"), [("section_sweep", 7), ("paper_sweep", 11)])
def test_sweeps_that_come_along_are_sound(scene, campaigns):
    path = ROOT / "benchmarks" / "scenes" / f"{scene}.toml"
    parts = sweep.variants(path.read_text())
    assert len(parts) == len({part.name for part in parts}) == campaigns
    for part in parts:
        parse(part.source)
