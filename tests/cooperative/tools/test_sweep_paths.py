"""Sweeps over any number of a scene by its path, scenarios and records: which campaigns, and what is refused."""

import json

import numpy as np
import pytest
from scipy.stats import norm

from benchmarks.robustness import invented
from benchmarks.robustness.invented import LAYERED
from cooperative.__main__ import main
from cooperative.scene import parse, read_scene
from cooperative.tools import sweep
from cooperative.tools.sweep import variants
from tests.cooperative.scene.test_shaking_scenes import LEVEL, MOTION, RECORD, SCENE
from tests.databases import delete, finished
from tests.scenes import tables

TINY = invented.TINY.replace("samples = 6", "samples = 40").replace('estimator = "published"', "refined_runs = 12")
LAYERED = LAYERED.replace("samples = 6", "samples = 40").replace('estimator = "published"', "refined_runs = 12")


def test_paths_lead_to_any_number_and_scenarios_to_any_key():
    paths = '[sweep]\n"layer.clay.strength.mean" = [2e4, 3e4]\nrun.k_h = [0, -0.1]\n"water.level" = [14]\n'
    berm = '[[scenario]]\nname = "a berm"\nground.surface = [[0, 10], [8, 10], [16, 4], [32, 4]]\n"rough.cell" = 1.0\n'
    parts = {part.name: part for part in variants(LAYERED + paths + berm)}
    clay = [f"layer.clay.strength.mean-{mean}" for mean in (20000, 30000)]
    assert list(parts) == ["base", *clay, "run.k_h--0.1", "water.level-14", "scenario-a_berm"]
    assert parts["base"].points == (("run.k_h", 0),)
    campaigns = {name: parse(part.source) for name, part in parts.items()}
    assert campaigns[clay[0]].site.layers[1].random["strength"].mean == 2e4
    assert campaigns["run.k_h--0.1"].run.k_h == -0.1
    assert campaigns["water.level-14"].site.water_table == 14.0  # above the crest: a pool
    assert campaigns["scenario-a_berm"].site.shape.surface[2] == (16.0, 4.0)
    assert campaigns["scenario-a_berm"].rough.cell == 1.0
    short = variants(TINY + '[sweep]\n"soil.strength.mean" = [2e4]\n"run.strength_factor" = [0.8]\n')
    assert parse(short[1].source).random["strength"].mean == 2e4
    assert parse(short[2].source).run.strength_factor == 0.8


def test_a_sweep_is_checked_and_drawn_by_its_base(tmp_path, capsys):
    scene = tmp_path / "s.toml"
    scene.write_text(TINY + '[sweep]\nlx = [4.0, 8.0]\n"run.strength_factor" = [0.8]\n')
    count = len(variants(scene))
    assert main(["check", str(scene), "--measure", "0.01"]) == 0
    printed = capsys.readouterr().out
    assert f"a sweep of {count} campaigns" in printed
    assert "hours of one core" in printed
    assert printed.endswith(f"  sweep          {count} campaigns, each of about this time\n")
    assert main(["draw", str(scene), "--out", str(tmp_path / "s.png")]) == 0
    assert (tmp_path / "s.png").exists()
    assert main(["run", str(scene), "--out", str(tmp_path / "out")]) == 2
    assert "run it by `jaxmpm sweep`" in capsys.readouterr().err
    # What one campaign of it refuses is refused before any of them runs.
    scene.write_text(TINY + '[sweep]\n"run.strength_factor" = [0.8, -1.0]\n')
    assert main(["check", str(scene), "--measure", "0.01"]) == 2
    assert "strength_factor = -1: give" in capsys.readouterr().err


def test_records_are_crossed_with_their_scales_and_packed(tmp_path):
    (tmp_path / "record.csv").write_text(RECORD)
    (tmp_path / "other.csv").write_text("time,x\n0,0.1\n1,-0.2\n2,0.3\n")
    crossed = '[sweep]\n"motion.record" = ["record.csv", "other.csv"]\n"motion.scale" = [0.5, 2.0]\n'
    (tmp_path / "scene.toml").write_text(SCENE + MOTION + crossed)
    source = read_scene(tmp_path / "scene.toml")
    assert set(source.tables["files"]) == {"record.csv", "other.csv"}
    parts = variants(source)
    assert [part.points for part in parts] == [
        (("motion.scale of record.csv", 0.5),),
        (("motion.scale of record.csv", 2.0),),
        (("motion.scale of other.csv", 0.5),),
        (("motion.scale of other.csv", 2.0),),
    ]
    peaks = [float(np.abs(parse(part.source).shaking.acceleration[0]).max()) for part in parts]
    np.testing.assert_allclose(peaks[2:], [0.15 * 9.81, 0.6 * 9.81], rtol=1e-5)
    (tmp_path / "scene.toml").write_text(SCENE + MOTION + crossed.replace("other", "missing"))
    with pytest.raises(ValueError, match=r"missing\.csv"):
        read_scene(tmp_path / "scene.toml")


def test_a_sweep_over_paths_compares_and_goes_on_where_it_was(tmp_path, made_up):
    text = TINY + '[sweep]\nrun.k_h = [0, 0.1, 0.2]\n[[scenario]]\nname = "steep"\nslope.run_per_rise = 0.5\n'
    result = sweep.run(text, tmp_path / "out")
    assert json.loads((tmp_path / "out" / "sweep.json").read_text()) == result
    rows = (tmp_path / "out" / "sweep.csv").read_text().splitlines()
    assert [row.split(",")[:2] for row in rows[1:]] == [
        ["base", "base"],
        *([["run.k_h", at] for at in ("0", "0.1", "0.2")]),
        ["scenario", "steep"],
    ]
    assert len({row.count(",") for row in rows}) == 1
    zero, more, _ = result["parameters"]["run.k_h"]
    assert zero["difference"] is None
    assert more["difference"]["difference"] == pytest.approx(more["probability"] - zero["probability"])
    (steep,) = result["parameters"]["scenario"]
    assert steep["value"] == "steep"
    assert {path.name for path in (tmp_path / "out" / "figures").iterdir()} >= {"difference.png", "displacement.png"}
    folder = tmp_path / "out/campaigns/run.k_h-0.1"
    delete(folder, "rough", 3)
    (tmp_path / "out" / "sweep.json").unlink()
    assert sweep.run(text, tmp_path / "out") == result
    assert 3 in finished(folder, "rough")


@pytest.mark.slow
def test_the_fragility_curve_of_level_ground_is_that_of_its_strength(tmp_path):
    # The strength is one number of a sample, so that it fails from k_h = strength / weight above its lowest particles.
    cov, mean, height = 0.3, 12e3, 6.0
    run = "t_end = 6.0\nfailure_displacement = 0.3"
    scene = LEVEL.replace("cov = 0.1", f"cov = {cov}") + tables(1.0, run)
    scene = scene.replace("samples = 10", "samples = 40\nslides = 0").replace("refined_runs = 10", "refined_runs = 16")
    result = sweep.run(scene + '[sweep]\n"run.k_h" = [0.05, 0.08, 0.11, 0.14, 0.18]\n', tmp_path / "out")
    deviation = np.sqrt(np.log(1 + cov**2))
    median = mean / np.sqrt(1 + cov**2) / (20e3 * (height - 0.125))
    for row in result["parameters"]["run.k_h"]:
        low, high = row["interval"]
        assert low <= norm.cdf(np.log(row["value"] / median) / deviation) <= high
    curve = {each["form"]: each for each in result["fragility"]["run.k_h"]}["lognormal"]
    assert curve["median_interval"][0] <= median <= curve["median_interval"][1]
    assert curve["deviation_interval"][0] <= deviation <= curve["deviation_interval"][1]
