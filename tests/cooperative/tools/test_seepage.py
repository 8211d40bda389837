"""Pressure and factor of safety at the times of a scene: words, tables and pictures, and what a table gives back."""

import json

import numpy as np
import pytest
from PIL import Image

from cooperative._arguments import parser
from cooperative._commands import COMMANDS
from cooperative.scene import parse
from cooperative.tools.seepage import lines, wetted, write_animation, write_wetted
from jaxmpm import seepage
from tests.cooperative.scene.test_moving_water import LEVEL, at_rest_at, scene


@pytest.fixture(scope="module")
def result():
    campaign = parse(scene(at_rest_at(1.0).replace("at = 0", 'soil = { soil_class = "loam" }'), ""))
    return wetted(campaign, factors=False)


def test_each_moment_is_the_ground_at_its_time(result):
    first, last = result.moments
    z = result.cells.centres()[-1]
    soil = result.cells.soil
    np.testing.assert_allclose(first.head[soil], (1.0 - z)[soil], atol=1e-4)
    np.testing.assert_allclose(last.head[soil], (2.0 - z)[soil], atol=1e-4)
    assert np.isnan(first.head[~soil]).all()
    assert 0 < first.wet < last.wet < 1
    wanted = np.asarray(seepage.soil_class("loam").saturation((1.0 - z)[soil]))
    np.testing.assert_allclose(first.saturation[soil], wanted, atol=1e-4)


def test_its_files_say_the_same(result, tmp_path):
    names = [path.name for path in write_wetted(result, tmp_path / "out")]
    assert names == ["seepage.png", "seepage.csv", "heads.csv", "seepage.json"]
    again = seepage.read_pressure(tmp_path / "out" / "heads.csv")
    np.testing.assert_allclose(again.heads(3600.0).at([[4.0], [1.5]]), [0.5], atol=1e-3)
    moments = json.loads((tmp_path / "out" / "seepage.json").read_text())["moments"]
    assert [each["time"] for each in moments] == [0, 3600]
    said = "\n".join(lines(result))
    assert "pressure  of another program, at 2 times" in said
    assert f"{result.moments[1].wet:4.0%} saturated" in said


def test_an_animation_goes_through_the_times_between(result, tmp_path):
    """The ground of another program is linear between its times; each moment is a picture."""
    between = wetted(result.campaign, factors=False, times=[0.0, 1800.0, 3600.0])
    soil, z = result.cells.soil, result.cells.centres()[-1]
    np.testing.assert_allclose(between.moments[1].head[soil], (1.5 - z)[soil], atol=1e-4)
    with Image.open(write_animation(between, tmp_path / "seepage.gif")) as picture:
        assert picture.n_frames == 3


def test_the_command_has_factors_and_refuses_a_scene_whose_water_rests(tmp_path, capsys):
    path = tmp_path / "storm.toml"
    path.write_text(scene(at_rest_at(1.0), ""))
    args = parser().parse_args(["seepage", str(path)])
    COMMANDS["seepage"](args)
    said = capsys.readouterr().out
    assert said.count("factor of safety  1.") == 2
    assert (tmp_path / "storm-seepage" / "factor.png").exists()
    path.write_text(scene("", LEVEL))
    with pytest.raises(ValueError, match="no water moves in the scene"):
        COMMANDS["seepage"](args)


def test_another_time_is_that_of_the_ground():
    campaign = parse(scene(at_rest_at(1.0), ""))
    assert campaign.resting_at("0.5 h").rain.at == 1800.0
    with pytest.raises(ValueError, match="after the last of times"):
        campaign.resting_at("2 h")
    with pytest.raises(ValueError, match="leave it out"):
        parse(scene("", LEVEL)).resting_at(0.0)
