"""Rain and drawdown in a scene: what they are read as, what is refused, and the pressure under which a slope rests."""

import subprocess
import sys
from dataclasses import replace

import jax
import numpy as np
import pytest
from scipy.spatial import cKDTree

import jaxmpm as mpm
from cooperative import runs
from cooperative.one_run import _certain
from cooperative.scene import (
    Campaign,
    Drawdown,
    Hydraulics,
    Rain,
    RandomConductivity,
    built,
    parse,
    read,
    rested,
)
from cooperative.tools.safety import Circle, slices_at_rest
from cooperative.tools.safety._moving import MovingWater
from jaxmpm import seepage
from jaxmpm.ground import WATER_WEIGHT
from jaxmpm.seepage import Heads
from jaxmpm.soil import STANDARD_GRAVITY
from tests import ROOT
from tests.scenes import tables

HEAD = """
[ground]
surface = [[0.0, 8.0], [6.0, 8.0], [14.0, 2.0], [22.0, 2.0]]
"""
SOIL = """
[soil]
unit_weight = 19e3
young = 2e7
poisson = 0.3
friction = 30.0
[soil.cohesion]
mean = 3e3
cov = 0.3
length = [10.0, 2.0]
"""
RAIN = """
[rain]
times = ["0 h", "6 h", "12 h"]
rate = "14 mm/h"
soil = { soil_class = "loam" }
"""
LEVEL = "[water]\nlevel = 1.0\n"


def scene(moving=RAIN, water=LEVEL, head=HEAD, soil=SOIL):
    return head + water + soil + moving + tables(1.0)


def at_rest_at(level: float, times=(0.0, 3600.0)) -> str:
    """The pressure of another program, of water at rest that rises by a metre an hour."""
    rows = [[x, z, t, level + t / 3600] for t in times for x in (0.0, 22.0) for z in (0.0, 8.0)]
    return f"[rain]\ntimes = [0, 3600]\nat = 0\npressure = {rows}\n"


def test_a_scene_without_it_does_not_load_the_flow():
    script = (
        f"import sys\nfrom cooperative.scene import parse\nparse({scene('')!r})\nprint('jaxmpm.seepage' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, cwd=ROOT)
    assert done.stdout.strip() == "False"


def test_keys_have_their_units(tmp_path):
    (tmp_path / "storm.csv").write_text("t [h],rain [mm/h]\n0,3.6\n6,36\n12,0\n")
    path = tmp_path / "scene.toml"
    path.write_text(
        scene(RAIN.replace('"14 mm/h"', '"storm.csv"').replace('"loam" }', '"loam", conductivity = "0.36 m/d" }'))
    )
    campaign = parse(path)
    assert isinstance(campaign.rain, Rain)
    assert campaign.rain.times == (0, 21600, 43200)
    np.testing.assert_allclose(campaign.rain.rate, [(0, 1e-6), (21600, 1e-5), (43200, 0)])
    assert campaign.rain.soil.conductivity == pytest.approx(0.36 / 86400)
    # The folder keeps the file's numbers, and Python its own.
    assert parse(campaign.source).rain == campaign.rain
    again = read(replace(campaign, name="of a script"))
    assert again.rain == campaign.rain


VARIES = 'conductivity = { mean = "25 cm/day", cov = 1.0, length = [10.0, 2.0] }'

REFUSED = {
    "conductivity in m/day": (RAIN.replace('"loam"', '"loam", conductivity = 0.9'), r"conductivity = 0\.9 m/s.*m/day"),
    "far from its class": (RAIN.replace('"loam"', '"clay", conductivity = 0.01'), "times that of clay"),
    "m/day beside the curve of a loam": (
        RAIN.replace('soil_class = "loam"', "conductivity = 0.05, alpha = 3.6, n = 1.56, porosity = 0.43"),
        r"conductivity = 0\.05 m/s is .* times that of soil with alpha = 3.6 1/m",
    ),
    "mm/h for m/s": (RAIN.replace('"14 mm/h"', "14"), r"rate = 14 m/s: .*was mm/h meant"),
    "a storm that ends before it begins": (
        RAIN.replace('"14 mm/h"', '[["6 h", "14 mm/h"], ["2 h", 0]]'), "begins before it ends",
    ),
    "a storm after all": (RAIN.replace('"14 mm/h"', '[["13 h", "14 mm/h"]]'), "is 0 up to the last of times"),
    "times back": (RAIN.replace('"6 h"', '"16 h"'), "go from 57600 to 43200 s"),
    "no times": ('[rain]\nrate = "1 mm/h"\n', "lacks times"),
    "no rain": ('[rain]\ntimes = ["1 h"]\nsoil = { soil_class = "loam" }\n', "lacks rate"),
    "no soil": ('[rain]\ntimes = ["1 h"]\nrate = "1 mm/h"\n', "lacks the soil"),
    "no class": (RAIN.replace('"loam"', '"lome"'), "give one of sand"),
    "a unit of something else": (RAIN.replace('"6 h"', '"6 m"'), "'6 m': give a number in s"),
    "two tables": (RAIN + RAIN.replace("[rain]", "[drawdown]\nlevel = 3.0"), r"^\[drawdown\] is given .*: leave"),
    "a layer that is none": (
        RAIN + '[[rain.layer]]\nname = "a"\nsoil_class = "clay"\n',
        r"^\[rain.layer 'a'\] name = 'a' is no \[\[layer\]\] of the ground: it has none, give soil instead$",
    ),
    "another program and rain": (at_rest_at(4.0) + 'rate = "1 mm/h"\n', "another program"),
    "random conductivity in another unit": (
        RAIN.replace('"loam" }', '"loam", conductivity = { mean = 0.25, cov = 1.0, length = [9.0, 2.0] } }'),
        r"conductivity.* mean = 0\.25 m/s.*m/day",
    ),
    "its cov in per cent": (
        RAIN.replace('"loam" }', f'"loam", {VARIES} }}').replace("1.0,", "100.0,"), "per cent meant",
    ),
    "of other axes": (RAIN.replace('"loam" }', f'"loam", {VARIES} }}').replace("[10.0, 2.0]", "[10.0]"), "1 value"),
    "below 0 somewhere": (
        RAIN.replace('"loam" }', f'"loam", {VARIES} }}').replace("cov = 1.0", "cov = 1.0, marginal = \"normal\""),
        r"conductivity.* has values of -.* m/s",
    ),
    "beside another program": (at_rest_at(1.0) + f'soil = {{ soil_class = "loam", {VARIES} }}\n', "one answer for all"),
    "a chart of storms without durations": (RAIN + 'chart = { rates = ["1 mm/h", "2 mm/h"] }\n', "lacks durations"),
    "a chart in m/s": (RAIN + 'chart = { rates = [5, 10], durations = ["6 h"] }\n', "rates = 5 m/s: .*mm/h"),
    "a chart of one rate": (RAIN + 'chart = { rates = ["1 mm/h"], durations = ["6 h"] }\n', "two rates"),
    "a chart that falls": (
        RAIN + 'chart = { rates = ["2 mm/h", "1 mm/h"], durations = ["6 h"] }\n', "give them rising"
    ),
    "a chart of another program": (
        at_rest_at(4.0) + 'chart = { rates = ["1 mm/h", "2 mm/h"], durations = ["6 h"] }\n', "another program",
    ),
    "a chart of a level that rises": (
        RAIN.replace("[rain]", "[drawdown]").replace('rate = "14 mm/h"', 'level = [["0 h", 3.0], ["6 h", 4.0]]')
        + 'chart = { rates = ["1 m/d", "2 m/d"] }\n', "does not fall",
    ),
    "durations of a drawdown": (
        RAIN.replace("[rain]", "[drawdown]").replace('rate = "14 mm/h"', 'level = [["0 h", 3.0], ["6 h", 1.0]]')
        + 'chart = { rates = ["1 m/d", "2 m/d"], durations = ["6 h"] }\n', "is of rain",
    ),
    "at beyond the times": (RAIN + 'at = "13 h"\n', "after the last of times"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_is_refused_in_words(name):
    text, words = REFUSED[name]
    with pytest.raises(ValueError, match=words):
        parse(scene(text))


CLAY = SOIL.replace("friction = 30.0\n[soil.cohesion]\nmean = 3e3", "[soil.strength]\nmean = 3e4")
HEAVY = SOIL.replace("unit_weight = 19e3", "") + "[soil.unit_weight]\nmean = 19e3\ncov = 0.05\nlength = [9.0, 2.0]\n"


@pytest.mark.parametrize(
    ("water", "soil", "words"),
    [
        ("[water]\nr_u = 0.2\n", SOIL, r"^r_u = 0.2 beside rain.*: leave one out$"),
        (
            "[water.level]\nmean = 1.0\nsd = 0.1\n",
            SOIL,
            r"^the water level is random beside rain.*: give its mean$",
        ),
        (LEVEL, CLAY, r"^\[rain\] acts on undrained soil.*: give cohesion and friction$"),
        (LEVEL, HEAVY, r"^unit_weight varies beside rain.*: give it as a number$"),
    ],
)
def test_soil_and_water_on_which_no_flow_acts_are_refused(water, soil, words):
    with pytest.raises(ValueError, match=words):
        parse(scene(water=water, soil=soil))


@pytest.mark.parametrize(
    ("moving", "water", "words"),
    [
        (RAIN, "[water]\nlevel = 4.0\n", "above the ground at .* and no level is given"),
        (RAIN, "", "not known: give .water. a level"),
        (
            '[rain]\ntimes = ["1 h"]\nrate = "1 mm/h"\nsoil = { conductivity = 1e-6 }\n',
            LEVEL,
            "lacks alpha, n, porosity",
        ),
        (at_rest_at(4.0).replace("at = 0", "at = 3600"), "", "2 m of water on the ground"),
        (at_rest_at(1.0, times=(0.0,)), "", "goes from 0 to 0 s"),
    ],
)
def test_states_that_are_not_known_or_flood_the_ground_are_refused(moving, water, words):
    campaign = parse(scene(moving, water))
    with pytest.raises(ValueError, match=words):
        campaign.flow  # noqa: B018


CIRCLE = Circle(13.0, 12.0, 10.05)
"""Through the toe."""


def factor(campaign: Campaign, time: float | None = None) -> float:
    """Of a circle through the toe."""
    side = campaign.site.shape.downhill
    slip = slices_at_rest(rested(campaign, time)).slip(replace(CIRCLE, x=side * CIRCLE.x), "bishop")
    assert slip is not None
    return slip.factor


MIRRORED = "\n[ground]\nsurface = [[-22.0, 2.0], [-14.0, 2.0], [-6.0, 8.0], [0.0, 8.0]]\n"


@pytest.mark.parametrize("head", [HEAD, MIRRORED])
def test_water_at_rest_is_that_of_a_water_table(head):
    """The pressure of another program, of water at rest, against the scene's own level: slices and particles."""
    level = 1.0
    moving = at_rest_at(level) if head is HEAD else at_rest_at(level).replace("22.0", "-22.0")
    given, known = scene(moving, "", head), scene("", f"[water]\nlevel = {level}\n", head)
    assert factor(parse(given)) == pytest.approx(factor(parse(known)), rel=2e-3)
    under, table = (built(parse(text), "rough")[0] for text in (given, known))
    z = np.asarray(under.particles.position[-1])
    np.testing.assert_allclose(under.loads.pore_pressure, WATER_WEIGHT * np.maximum(level - z, 0), atol=1.0)
    np.testing.assert_array_equal(under.particles.mass, table.particles.mass)
    deep = z < 0.5
    stress = [np.asarray(mpm.at_rest(each).stress)[2] for each in (under, table)]
    np.testing.assert_allclose(stress[0][deep], stress[1][deep], atol=0.03 * np.abs(stress[1]).max())


def test_pressure_that_rises_lowers_the_factor():
    rows = [[x, z, t, 1.0 + 3.0 * t / 3600 * (1 - x / 22)] for t in (0, 3600) for x in (0.0, 22.0) for z in (0.0, 8.0)]
    campaign = replace(parse(scene("", LEVEL)), rain=Rain([0, 3600], pressure=rows))
    assert factor(campaign, 3600.0) < factor(campaign, 0.0) - 0.01


def test_a_pool_holds_a_slope_and_its_pressure_stays_when_it_is_gone():
    """Rows keep the water of a pool at 6 m in the ground; a lower pool holds the slope less."""
    rows = [[x, z, t, 6.0] for t in (0.0, 3600.0) for x in (0.0, 22.0) for z in (0.0, 8.0)]
    campaign = replace(
        parse(scene("", "[water]\nlevel = 6.0\n")), drawdown=Drawdown([0, 3600], level=6.0, pressure=rows)
    )
    held = rested(campaign)
    gone = replace(held, ground=replace(held.site, pressure=replace(held.site.pressure, level=4.5)))
    before, after = factor(held), factor(gone)
    assert before == pytest.approx(factor(parse(scene("", "[water]\nlevel = 6.0\n"))), rel=2e-3)
    assert after < 0.9 * before
    under, _ = built(gone, "rough")
    z = np.asarray(under.particles.position[-1])
    left_over = WATER_WEIGHT * (np.maximum(6 - z, 0) - np.maximum(4.5 - z, 0))
    np.testing.assert_allclose(under.loads.pore_pressure, left_over, atol=1.0)


def test_weight_and_suction_follow_the_water():
    """Soil is as heavy as its saturated weight less the water that it lacks, for particles and slices alike."""
    wet = SOIL.replace("unit_weight = 19e3", "unit_weight = 17e3\nsaturated_unit_weight = 20e3")
    text = scene(at_rest_at(1.0), "", soil=wet)
    with pytest.raises(ValueError, match="saturated_unit_weight beside the pressure of another program"):
        parse(text).flow  # noqa: B018
    campaign = parse(text.replace("at = 0", 'at = 0\nsoil = { soil_class = "silt loam" }'))
    under, _ = built(campaign, "rough")
    retention, position = seepage.soil_class("silt loam"), np.asarray(under.particles.position)
    head = 1.0 - position[-1]
    weight = np.asarray(under.particles.mass / under.particles.volume) * STANDARD_GRAVITY
    np.testing.assert_allclose(
        weight, 20e3 - WATER_WEIGHT * (0.45 - np.asarray(retention.water_content(head))), rtol=1e-4
    )
    np.testing.assert_allclose(under.loads.pore_pressure, seepage.suction_stress(retention, head), rtol=1e-3, atol=2.0)
    moving = MovingWater.of(rested(campaign), campaign.site.shape, campaign.site.soils(campaign.soil))
    x, z = np.array([3.0, 10.0]), np.array([2.0, 0.5])
    pressure, above, moment = moving.at(x, z)
    np.testing.assert_allclose(pressure, seepage.suction_stress(retention, 1.0 - z), rtol=0.02, atol=50.0)
    top = np.asarray(campaign.site.shape.heights(x))
    for k in range(2):
        heights = np.linspace(z[k], top[k], 2001)
        gamma = 20e3 - WATER_WEIGHT * (0.45 - np.asarray(retention.water_content(1.0 - heights)))
        assert above[k] == pytest.approx(np.trapezoid(gamma, heights), rel=5e-3)
        assert moment[k] == pytest.approx(np.trapezoid(gamma * heights, heights), rel=5e-3)
    assert factor(campaign, 0.0) > factor(replace(campaign, rain=replace(campaign.rain, suction=False)), 0.0)


DRAWN_DOWN = """
[drawdown]
times = ["0 h", "1 h", "2 d"]
level = [["0 h", 6.0], ["1 h", 3.0]]
soil = { soil_class = "loam" }
cell = [2.0, 1.0]
[[drawdown.layer]]
name = "sand"
soil_class = "sand"
"""
LAYERS = '[[layer]]\nname = "loam"\nbottom = [[0, 2], [22, 1]]\n[[layer]]\nname = "sand"\n'


def test_a_pool_drawn_down_by_the_flow_of_its_scene():
    """Soil that drains slowly keeps its water; the balance closes, and what is left of the pool pushes the slope."""
    campaign = parse(scene(DRAWN_DOWN, "", soil=SOIL + LAYERS))
    flow = campaign.flow
    assert flow.balance < 1e-6
    points = np.array([[2.0, 16.0], [5.0, 1.0]])
    first, soon, late = (flow.pressure(points, time) / WATER_WEIGHT for time in campaign.drawdown.times)
    np.testing.assert_allclose(first, [1.0, 5.0], atol=1e-6)
    assert 0.6 < soon[0] <= 1.0  # far from the pool the loam holds its water for days
    assert 2.0 < soon[1] < 4.0
    assert late[0] < soon[0]
    assert late[1] < soon[1]
    assert [rested(campaign, time).site.pressure.level for time in campaign.drawdown.times] == [6.0, 3.0, 3.0]
    assert set(np.unique(flow.number)) == {0, 1}


LOAM = DRAWN_DOWN.replace('{ soil_class = "loam" }', '{ soil_class = "loam", ' + VARIES + " }")
SAND = DRAWN_DOWN + "conductivity = { mean = 8e-5, cov = 0.5, length = [8.0, 4.0] }\n"
TOGETHER = '[cross_correlation]\nparameters = ["cohesion", "conductivity"]\nmatrix = [[1.0, -0.9], [-0.9, 1.0]]\n'


def drawn(campaign: Campaign) -> tuple[runs.RandomSoil, np.ndarray]:
    soil = runs.random_soil(campaign)
    return soil, runs.coefficients_of(campaign, soil)


def test_each_sample_rests_under_the_flow_of_its_own_conductivity():
    """Against one flow by the solver with that field, and the pressure that it puts on the particles."""
    text = scene(LOAM, "", soil=SOIL.replace("unit_weight = 19e3", "unit_weight = 17e3\nsaturated_unit_weight = 20e3"))
    campaign = parse(text + LAYERS)
    soil, samples = drawn(campaign)
    conductivity = runs.conductivity_of(campaign, soil, samples[2])
    flow = next(runs.own_flows(campaign, soil, samples[2:3]))
    flowing, number = campaign.flowing, campaign.flowing.number
    with jax.enable_x64(True):
        loam, sand = seepage.soil_class("loam"), seepage.soil_class("sand")
        conductivity = np.where(number == 0, conductivity, 712.8 / 864e4)
        field = replace(seepage.zoned([loam, sand], number), conductivity=conductivity)
        pool = seepage.open_face("surface", level=([0.0, 3600.0], [6.0, 3.0]))
        problem = seepage.problem(flowing.cells, field, pool, seepage.open_face("left", level=6.0))
        alone = seepage.run(problem, seepage.hydrostatic(problem, 6.0), campaign.drawdown.times)
        heads = [Heads.of(problem, head) for head in alone.head]
    for time, known in zip(campaign.drawdown.times, heads, strict=True):
        np.testing.assert_allclose(flow.heads(time).total, known.total, atol=1e-4)
    assert np.abs(np.asarray(flow.heads(2 * 86400.0).total - campaign.flow.heads(2 * 86400.0).total)).max() > 0.05

    model = runs.build(campaign, "rough", soil, at_rest=False)
    under, _ = model.of_sample(samples[2])
    position = np.asarray(under.particles.position)
    head = np.asarray(flow.heads(campaign.drawdown.moment).at(position))
    retention = seepage.zoned([seepage.soil_class("loam"), seepage.soil_class("sand")], model.layer)
    pool = WATER_WEIGHT * np.maximum(3.0 - position[-1], 0)
    wanted = seepage.suction_stress(retention, head) - pool
    np.testing.assert_allclose(under.loads.pore_pressure, wanted, rtol=1e-3, atol=30.0)
    weight = np.asarray(under.particles.mass / under.particles.volume) * STANDARD_GRAVITY
    wet = 20e3 - WATER_WEIGHT * (np.asarray(retention.porosity) - np.asarray(retention.water_content(head)))
    np.testing.assert_allclose(weight, wet, rtol=1e-3)


def test_conductivity_varies_in_its_layers_and_with_the_strength():
    """Medians and scatter of fields through layers and of one; numbers elsewhere; the correlation that is asked for."""
    campaign = parse(scene(LOAM, "", soil=SOIL + LAYERS) + TOGETHER)
    soil, samples = drawn(replace(campaign, plan=replace(campaign.plan, samples=200)))
    assert "conductivity" in soil.expansions
    layer, cells = campaign.flowing.layer, campaign.flowing.cells
    logs = np.log(np.stack([runs.conductivity_of(campaign, soil, sample) for sample in samples]))
    np.testing.assert_allclose(logs[:, layer == 1], np.log(712.8 / 864e4), rtol=1e-4)
    inside = logs[:, layer == 0]
    assert inside.mean() == pytest.approx(np.log(0.25 / 86400) - np.log(2) / 2, abs=0.1)
    assert inside.std(axis=0).mean() == pytest.approx(np.sqrt(np.log(2)), rel=0.1)
    model = runs.build(campaign, "rough", soil, at_rest=False)
    cohesion = np.log(np.stack([model._drawn(sample)["cohesion"] for sample in samples]))
    centres = cells.centres().reshape(2, -1)[:, layer.ravel() == 0]
    nearest = cKDTree(np.asarray(model.scene.particles.position).T).query(centres.T)
    close = nearest[0] < 0.5
    pairs = zip(inside[:, close].T, cohesion[:, nearest[1][close]].T, strict=True)
    assert np.mean([np.corrcoef(*pair)[0, 1] for pair in pairs]) == pytest.approx(-0.9, abs=0.08)

    apart = parse(scene(SAND, "", soil=SOIL + LAYERS))
    soil, samples = drawn(apart)
    assert {group.layer for group in soil.groups if "conductivity" in group.names} == {1}
    fields = np.stack([runs.conductivity_of(apart, soil, sample) for sample in samples])
    assert np.ptp(fields[:, layer == 0]) == 0
    assert np.std(np.log(fields[:, layer == 1])) == pytest.approx(np.sqrt(np.log(1.25)), rel=0.3)


def test_python_has_the_same_conductivity_and_mean_soil_its_mean():
    campaign = parse(scene(RAIN.replace('"loam" }', f'"loam", {VARIES} }}')))
    field = RandomConductivity(mean="25 cm/day", cov=1.0, length=(10.0, 2.0))
    rain = replace(campaign.rain, soil=Hydraulics("loam", conductivity=field))
    assert campaign.rain == rain
    assert read(replace(campaign, name="of a script")).rain == rain
    certain = _certain(campaign)
    soil = runs.random_soil(certain)
    np.testing.assert_allclose(runs.conductivity_of(certain, soil), 0.25 / 86400, rtol=1e-3)
    alone = replace(campaign, random={})
    assert alone.varies
    assert runs.random_soil(alone).modes > 0


@pytest.mark.slow  # compiles the flow of lanes
def test_flows_side_by_side_are_those_of_single_ones(monkeypatch):
    campaign = parse(scene(LOAM, "", soil=SOIL + LAYERS))
    soil, samples = drawn(campaign)
    fields = [runs.conductivity_of(campaign, soil, sample) for sample in samples[:3]]
    together = campaign.flowing.solved(fields)
    for field, lane in zip(fields, together, strict=True):
        (single,) = campaign.flowing.solved([field])
        for one, other in zip(single.at_times, lane.at_times, strict=True):
            np.testing.assert_allclose(one.total, other.total, atol=1e-6)


@pytest.mark.slow  # compiles a flow
def test_rain_that_runs_off_all_the_time_is_named():
    with pytest.warns(UserWarning, match=r"of .* m2 of rain no more than .* soak in, .* such as mm/day"):
        parse(scene(RAIN.replace("14 mm/h", "300 mm/h") + "cell = [2.0, 1.0]\n")).flow  # noqa: B018


@pytest.mark.slow  # compiles flow and steady flow
def test_rain_that_no_ground_drains_is_named():
    """A steady rain above the conductivity fills the ground before the storm, and a storm above it later."""
    heavy = RAIN.replace('"14 mm/h"', '"14 mm/h"\ninitial_rate = "2 mm/h"\nleft = "closed"\nright = "closed"')
    heavy = heavy.replace('"loam"', '"silty clay"') + "cell = [2.0, 1.0]\n"
    with pytest.raises(ValueError, match="more than the ground drains"):
        parse(scene(heavy)).flow  # noqa: B018
