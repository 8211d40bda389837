"""A campaign is the same after its folder: every kind of ground, layer, water, hazard and random table, by property."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import jaxmpm as mpm
from cooperative import RandomField, Run
from cooperative.scene import in_folder, read
from cooperative.scene._words import source_of_value
from cooperative.store import Source, open_store, refuse_another, stored_source
from tests.cooperative.campaign.test_campaign_value import TINY_IN_PYTHON

STEP = 4.0
PARTS = st.sampled_from([0.0, 0.5, 0.25, 0.1, 0.123456, 1 / 3])
"""Of a metre, by which coordinates miss whole ones."""
GRIDS = """
[rough]
cell = 2.0
spacing = {wide}
[refined]
cell = 1.0
spacing = {fine}
[run]
t_end = 0.5
"""


def raster(heights, corner):
    """An ASCII grid of heights (nx, ny) m by the corner (2,) m of its first cell."""
    rows = "\n".join(" ".join(f"{height:.3f}" for height in row) for row in np.flipud(np.transpose(heights)))
    nx, ny = np.shape(heights)
    head = f"ncols {nx}\nnrows {ny}\nxllcorner {corner[0]!r}\nyllcorner {corner[1]!r}\ncellsize {STEP}\n"
    return head + "NODATA_value -9999\n" + rows + "\n"


@st.composite
def strengths(draw, axes, own_field=False):
    """The table of a random strength; one that stops at a layer has no values measured below it."""
    length = [float(draw(st.sampled_from([20.0, 12.5, 1e9]))) for _ in range(axes - 1)] + [3.5]
    kinds = ["", ", trend = 1.5e3, trend_from = 0.123", ', marginal = "gumbel"']
    own = draw(st.sampled_from(kinds if own_field else [*kinds, ', boreholes = "cu.csv"']))
    return f"{{ mean = 30e3, cov = {draw(PARTS) / 2 + 0.1}, length = {length}{own} }}"


@st.composite
def scenes(draw):
    """A scene's text, and the files that it names by their names."""
    kind, part, other = draw(st.sampled_from(["slope", "ground", "line", "terrain"])), draw(PARTS), draw(PARTS)
    axes = 3 if kind == "terrain" else 2
    level = "xy"[: axes - 1]
    headings, place = [f"{axis} [m]" for axis in (*level, "z")], ["9.0"] * len(level)
    names = {"cu.csv": ",".join([*headings, "strength [Pa]"]) + "\n" + ",".join([*place, "1.5", "25e3"]) + "\n"}
    layer, water, exposed, more = "", [], f"between = [{18 + part}, 21.0]", ""
    if kind == "slope":
        ground = f"[slope]\ncrest = {8 + part}\nheight = 8.0\nrun_per_rise = 1.0\ntoe = 16.0\nfoundation = 2.0\n"
    elif kind == "terrain":
        x, y = np.meshgrid(np.arange(9), np.arange(7), indexing="ij")
        corner = 512300 - STEP + part, 5240100 - STEP + other
        names |= {"hill.asc": raster(10.0 - 0.7 * x, corner), "low.asc": raster(3.0 - 0.1 * y, corner)}
        ground = '[terrain]\nsurface = "hill.asc"\nbase = 0.0\norigin = [512300.0, 5240100.0]\n'
        ground += draw(st.sampled_from(["", 'bedrock = "low.asc"\n', f"x = [0.0, 24.0]\nstep = {STEP}\n"]))
        ground += draw(st.sampled_from(["", f"run_out_line = [[2.0, 8.5], [{20 + part}, 9.0]]\n"]))
        water, exposed = ['raster = "low.asc"'], f"polygon = [[17.5, 8.0], [20.5, 8.0], [19.0, {12 + other}]]"
    else:
        points = [[0.0, 10 + part], [8 + other, 10.0], [16.0, 2.0], [32.0, 2.0]]
        names["line.csv"] = "x,z\n" + "\n".join(f"{x!r},{z!r}" for x, z in points) + "\n"
        ground = f"[ground]\nsurface = {points if kind == 'ground' else chr(34) + 'line.csv' + chr(34)}\n"
        water = ["table = [[0, 4.5], [32, 1.5]]"]
        more = draw(st.sampled_from(["", '[motion]\nrecord = "shake.csv"\nrecord_unit = "g"\n']))
        names["shake.csv"] = "time,x,z\n" + "\n".join(f"{0.01 * k:.2f},{(part + 0.1) * (k % 3)},0.0" for k in range(20))
    strength = draw(strengths(axes))
    if kind != "slope":
        drawn = f"level = {{ mean = 2.5, sd = {0.1 + part} }}" if not more else "r_u = 0.1"
        water += [f"level = {2 + part}", drawn, f"depth = {6 + other}", "r_u = 0.25"]
        lower = draw(st.sampled_from([f"depth = {1 + part}", f"thickness = {1 + part}"]))
        own = draw(st.sampled_from(["", f"strength = {draw(strengths(axes, own_field=True))}\n"]))
        layer = draw(st.sampled_from(["", f'[[layer]]\nname = "fill"\n{lower}\n{own}[[layer]]\nname = "clay"\n']))
        more += draw(st.sampled_from(["", *(f"[water]\n{each}\n" for each in water)]))
    soil = f"[soil]\nunit_weight = 20e3\nyoung = 2e7\npoisson = 0.3\nstrength = {strength}\n"
    if draw(st.booleans()):
        curve = draw(st.sampled_from(['"totschnig 2011"', f'[["{10 + part} cm", 0.0], ["1.5 m", 1.0]]']))
        more += f'[hazard]\nthresholds = ["{0.5 + part} m"]\n[[exposed]]\nname = "road"\n{exposed}\nvalue = 1e3\n'
        more += f"vulnerability = {curve}\n"
    plan = "[campaign]\nsamples = 10\nrefined_runs = 10\n"
    grids = GRIDS.format(wide=[1.0] * axes, fine=[0.5] * axes)
    return f'name = "there and back"\n{ground}{layer}{soil}{grids}{plan}{more}', names


@settings(max_examples=25, suppress_health_check=[HealthCheck.too_slow], deadline=None)
@given(scenes())
def test_a_scene_is_the_same_after_its_folder(tmp_path_factory, scene):
    text, names = scene
    folder = tmp_path_factory.mktemp("there")
    for name, content in names.items():
        (folder / name).write_text(content)
    (folder / "scene-of-mine.toml").write_text(text)
    out = folder / "out"
    out.mkdir()
    campaign, source = in_folder(folder / "scene-of-mine.toml", out, None, None)
    open_store(out, source).close()
    there = stored_source(out)
    assert there.digest == source.digest
    assert refuse_another(out, source) == there
    again = read(there)
    assert again.source.digest == source.digest
    assert source_of_value(again) == source_of_value(read(Source(text, source.beside)))
    # The same campaign as one that was written in Python.
    in_words = tmp_path_factory.mktemp("in-python")
    open_store(in_words, source_of_value(campaign)).close()
    assert source_of_value(read(stored_source(in_words))) == source_of_value(campaign)


NUMBERS = (int, float, np.float64, np.float32, np.int64, np.int16)


@given(kinds=st.lists(st.sampled_from(NUMBERS), min_size=5, max_size=5))
def test_numbers_of_numpy_are_plain_in_a_campaign_of_python(tmp_path_factory, kinds):
    crest, foundation, mean, length, t_end = kinds
    campaign = replace(
        TINY_IN_PYTHON,
        ground=mpm.Slope(crest(8), 8.0, 1.0, 16.0, foundation(2)),
        random={"strength": RandomField(mean(3000), 0.4, (length(20), 4.0))},
        run=Run(t_end=t_end(4)),
    )
    folder = tmp_path_factory.mktemp("there")
    _, source = in_folder(campaign, folder, None, None)
    open_store(folder, source).close()
    there = stored_source(folder)
    assert refuse_another(folder, source) == there
    assert there.digest == source.digest == source_of_value(read(there)).digest
    assert isinstance(read(there).site.shape.crest, int | float)


@given(st.recursive(st.floats(allow_nan=False) | st.integers(-(2**40), 2**40) | st.booleans() | st.text(), st.lists))
def test_what_stands_beside_a_scene_is_plain_however_it_came(value):
    def of_numpy(each):
        if isinstance(each, list):
            return tuple(map(of_numpy, each))
        return np.asarray(each)[()] if not isinstance(each, str) else np.str_(each)

    assert Source("", {"files": {"a": of_numpy(value)}}).digest == Source("", {"files": {"a": value}}).digest


def test_what_has_no_numbers_does_not_enter():
    with pytest.raises(TypeError, match="keeps only these"):
        Source("", {"files": {"a": object()}})
