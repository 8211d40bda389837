"""Water tables of another program, a raster a time: what a terrain rests under, and what is refused."""

import re
from dataclasses import replace

import numpy as np
import pytest

from cooperative._arguments import parser
from cooperative._commands import COMMANDS
from cooperative.scene import parse, read, read_scene, rested
from jaxmpm import seepage
from tests.cooperative.scene.test_moving_water import HEAD, at_rest_at, scene
from tests.cooperative.scene.test_round_trip import STEP, raster

ORIGIN = (512300.0, 5240100.0)
X, Y = np.meshgrid(STEP * np.arange(8), STEP * np.arange(6), indexing="ij")
POINT = np.array([[4.3, 10.0], [5.1, 8.0], [1.0, 6.5]])
TABLES = '[["0 h", "low.asc"], ["1 h", "high.asc"]]'
SCENE = f"""
[terrain]
surface = "hill.asc"
base = 0.0
origin = {list(ORIGIN)}
x = [0.0, 18.0]
y = [0.0, 12.0]
[soil]
unit_weight = 19e3
young = 2e7
poisson = 0.3
friction = 30.0
cohesion = {{ mean = 3e3, cov = 0.3, length = [10.0, 10.0, 2.0] }}
[rain]
times = ["0 h", "1 h"]
water_tables = {TABLES}
[rough]
cell = 3.0
spacing = [1.5, 1.5, 1.5]
[refined]
cell = 1.5
spacing = [0.75, 0.75, 0.75]
[run]
t_end = 0.5
[campaign]
samples = 10
refined_runs = 10
"""


def level(x, hours):
    """Height of the water table (m), which falls with x and rises by 2 m in an hour."""
    return 3.0 - 0.1 * x + 2.0 * hours


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The scene's files, in the projection."""
    at = tmp_path_factory.mktemp("hill")
    corner = tuple(first - STEP / 2 for first in ORIGIN)
    holed = np.where((X == 8) & (Y == 8), -9999.0, level(X, 1))
    names = {
        "hill.asc": 10 - 0.3 * X, "low.asc": level(X, 0), "high.asc": level(X, 1), "holed.asc": holed,
        "above.asc": 11 - 0.3 * X, "depth.asc": np.full_like(X, -2.0),
    }  # fmt: skip
    for name, heights in names.items():
        (at / name).write_text(raster(heights, corner))
    (at / "far.asc").write_text(raster(level(X, 1), (corner[0] + 300, corner[1])))
    return at


def campaign_of(folder, text):
    (folder / "storm.toml").write_text(text)
    return parse(read_scene(folder / "storm.toml"))


def test_a_slope_rests_under_rasters_as_under_their_heads_at_points(folder):
    campaign = campaign_of(folder, SCENE)
    corners = [(x, y, z) for x in (0.0, 18.0) for y in (0.0, 12.0) for z in (0.0, 10.0)]
    rows = [[*at, t, level(at[0], t / 3600)] for t in (0.0, 3600.0) for at in corners]
    twin = campaign_of(folder, SCENE.replace(f"water_tables = {TABLES}", f"pressure = {rows}"))
    for hours in (0.0, 0.25, 1.0):
        heads = [rested(each, 3600 * hours).site.pressure.heads.at(POINT) for each in (campaign, twin)]
        np.testing.assert_allclose(heads[0], level(POINT[0], hours) - POINT[-1], atol=1e-6)
        np.testing.assert_allclose(*heads, atol=1e-6)


def test_the_folder_keeps_them_and_python_too(folder):
    campaign = campaign_of(folder, SCENE)
    assert parse(campaign.source).rain == campaign.rain
    assert read(replace(campaign, name="of a script")).rain == campaign.rain


def test_the_command_shows_them(folder, capsys):
    (folder / "storm.toml").write_text(SCENE)
    COMMANDS["seepage"](parser().parse_args(["seepage", str(folder / "storm.toml"), "--flow"]))
    assert "pressure  of another program, at 2 times" in capsys.readouterr().out
    table = seepage.read_pressure(folder / "storm-seepage" / "heads.csv")
    np.testing.assert_allclose(table.heads(1800.0).at(POINT), level(POINT[0], 0.5) - POINT[-1], atol=1e-3)


HIGH = "high.asc"
WALLS = "x = [0.0, 18.0]\ny = [0.0, 12.0]\n"
REFUSED = {
    "a hole": ({HIGH: "holed.asc"}, r"water table at 3600 s has no height at the ground's \(8, 8\) m.*fill its holes"),
    "other ground": ({HIGH: "far.asc"}, r"far\.asc does not reach the walls.*within the raster, x = 300 to 328 m"),
    "other ground, without walls": ({HIGH: "far.asc", WALLS: ""}, r"has no height.* its raster goes x = 300 to 328 m"),
    "water on the ground": ({HIGH: "above.asc"}, "of 1 m of water on the ground.*no level is given"),
    "depths": ({HIGH: "depth.asc"}, "at most -2 m, below the ground's base.*are these depths"),
    "times that do not rise": ({'["1 h", ': '["0 h", '}, r"^\[rain\] water_tables go from 0 to 0 s"),
    "times that end early": ({'["1 h", ': '["30 min", '}, "time = 3600 s: .* goes from 0 to 1800 s"),
    "no file": ({HIGH: "dry.asc"}, r"^\[rain\] water_tables: .*dry\.asc cannot be read"),
    "no pairs": (
        {TABLES: '"low.asc"'},
        r"^\[rain\] water_tables = 'low\.asc' is text: give pairs of a time and a file",
    ),
    "rain too": ({"[rain]": '[rain]\nrate = "1 mm/h"'}, "rate has no effect beside water_tables"),
    "heads too": ({"[rain]": "[rain]\npressure = [[0, 0, 0, 0, 1]]"}, "water_tables has no effect beside pressure"),
}


@pytest.mark.parametrize(("changes", "words"), REFUSED.values(), ids=REFUSED)
def test_what_is_no_water_table_of_the_ground_is_refused(folder, changes, words):
    text = SCENE
    for old, new in changes.items():
        assert old in text
        text = text.replace(old, new)
    with pytest.raises(ValueError, match=words):
        rested(campaign_of(folder, text))


def test_a_section_takes_points_instead(folder):
    text = scene(re.sub("pressure = .*", f"water_tables = {TABLES}", at_rest_at(1.0)), "", HEAD)
    with pytest.raises(ValueError, match="the ground is a section: give pressure, rows of x, z, t and head"):
        campaign_of(folder, text)


@pytest.mark.parametrize("off", [0.0, -0.5, -1.0])
def test_a_raster_of_another_corner_reaches_the_walls_at_any_step(folder, tmp_path, off):
    corner = tuple(first - STEP / 2 for first in ORIGIN)
    (tmp_path / "hill.asc").write_text((folder / "hill.asc").read_text())
    x = np.meshgrid(STEP * np.arange(12), STEP * np.arange(12), indexing="ij")[0] - STEP + off
    for name, hours in (("low.asc", 0), ("high.asc", 1)):
        (tmp_path / name).write_text(raster(level(x, hours), tuple(first - STEP + off for first in corner)))
    campaign = campaign_of(tmp_path, SCENE.replace("base = 0.0\n", "base = 0.0\nstep = 3.0\n"))
    np.testing.assert_allclose(campaign.flow.heads(0.0).at(POINT), level(POINT[0], 0) - POINT[-1], atol=1e-3)
