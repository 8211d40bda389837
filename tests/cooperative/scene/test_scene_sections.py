"""Ground drawn in a scene: from TOML to particles, through a campaign that is stopped, and what is refused."""

import numpy as np
import pytest

from benchmarks.robustness.invented import LAYERED
from benchmarks.sites import sites
from cooperative import run, runs
from cooperative.__main__ import main
from cooperative.reporting import report
from cooperative.scene import built, parse, read_scene
from cooperative.store import read_rows, read_store
from jaxmpm import read_line
from tests.cooperative.campaign.test_campaign import TINY
from tests.cooperative.scene.test_random_soil import SAND, STIFF, changed

GROUND = LAYERED[LAYERED.index("[ground]") : LAYERED.index("[[layer]]")]
OUTLINE = LAYERED.replace(LAYERED[LAYERED.index("[[layer]]") : LAYERED.index("[soil]")], "")


def rough(text):
    campaign = parse(text)
    return runs.build(campaign, "rough", runs.random_soil(campaign), at_rest=False)


def test_the_outline_of_a_slope_is_that_slope():
    one, other = rough(TINY), rough(OUTLINE)
    assert np.array_equal(one.scene.particles.position, other.scene.particles.position)
    coefficients = np.linspace(-1, 1, one.soil.modes)
    assert np.array_equal(one.strength(coefficients), other.strength(coefficients))
    assert runs.grid_size(one.campaign, "rough") == runs.grid_size(other.campaign, "rough")


def test_each_layer_has_its_own_distribution_of_the_one_field():
    model, plain = rough(LAYERED), rough(OUTLINE)
    coefficients = np.linspace(-2, 2, model.soil.modes)
    x, z = np.asarray(model.scene.particles.position)
    surface = np.clip(18 - x, 2, 10)
    layer = np.where(surface - z <= 1, 0, np.where(z > 1, 1, 2))
    assert np.array_equal(model.layer, layer)
    strength, alike = np.asarray(model.strength(coefficients)), np.asarray(plain.strength(coefficients))
    assert np.array_equal(strength[layer == 1], alike[layer == 1])
    marginal = model.campaign.random["strength"].marginal
    gaussian = marginal(30e3, 0.4).standardise(alike)
    assert np.allclose(strength[layer == 0], marginal(40e3, 0.1).transform(gaussian)[layer == 0], rtol=1e-5)
    assert np.all(strength[layer == 2] == 2e7)  # Young's modulus


def test_points_may_lie_in_a_file_beside_the_scene(tmp_path):
    (tmp_path / "ground.csv").write_text("x,z\n0,10\n8;10\n16 2\n32,2\n")
    # Spreadsheets write a byte order mark, with or without headings after it.
    (tmp_path / "marked.csv").write_text("\ufeff0,10\n8,10\n16,2\n32,2\n", encoding="utf-8")
    assert read_line(tmp_path / "marked.csv") == read_line(tmp_path / "ground.csv")
    drawn = OUTLINE.replace("[[0.0, 10.0], [8.0, 10.0], [16.0, 2.0], [32.0, 2.0]]", '"ground.csv"')
    (tmp_path / "scene.toml").write_text(drawn)
    text = read_scene(tmp_path / "scene.toml")
    assert parse(text).site == parse(OUTLINE).site
    with pytest.raises(ValueError, match=r"surface = 'ground.csv' is no file that was read with the scene"):
        parse(drawn)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("x_ft,z_ft\n0,10\n", "give x and z in metres, not in feet"),
        ("0,10\nten,1\n", "line 2 is 'ten,1': give x and z"),
        ("0,10,3\n", "line 1 is '0,10,3': give two finite numbers"),
        ("0,10\n1,nan\n", "line 2 is '1,nan'"),
        ("0,10\n", "holds 1 points: give 2 to 10000"),
        (None, "ground.csv cannot be read"),
    ],
)
def test_files_of_points_that_are_none_are_named(content, message, tmp_path):
    if content is not None:
        (tmp_path / "ground.csv").write_text(content)
    (tmp_path / "scene.toml").write_text('[ground]\nsurface = "ground.csv"\n')
    with pytest.raises(ValueError, match=message):
        read_scene(tmp_path / "scene.toml")


@pytest.mark.slow
def test_a_campaign_on_layers_is_stopped_and_goes_on(tmp_path, capsys):
    def stop(phase):
        if phase == "audit":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(LAYERED, tmp_path / "out", on_phase=stop)
    store = read_store(tmp_path / "out")
    assert (len(read_rows(store, "rough").numbers), read_rows(store, "refined").numbers) == (6, [])
    assert main(["resume", str(tmp_path / "out"), "--workers", "1"]) == 0
    printed = capsys.readouterr().out
    rows = read_rows(read_store(tmp_path / "out"), "refined").columns
    failed = rows["displacement"] > 1
    assert failed.sum() > 0
    assert "m below the surface" in printed
    assert "m from its rear to its front" in printed
    assert "area" not in printed
    # The rock, from 9 m below the crest on, stays; what slides is at most as deep as it lies.
    assert rows["depth"][failed].max() <= 9.0
    assert "mode" not in rows
    # The slope of 8 m on so short a crest slides from its rear end.
    assert "wall at x = 0 m" in printed
    assert report(tmp_path / "out") == printed.strip("\n")


REFUSED = [
    (("[soil]", "[slope]\ncrest = 1.0\n[soil]"), r"\[slope\] lacks height, run_per_rise"),
    ((GROUND, ""), "the scene says no ground: give one of"),
    (("depth = 1.0", "depth = 1.0\nthickness = 2.0"), "layer 'fill' has both depth and thickness"),
    (("depth = 1.0", "depth = 9.5"), r"bottom of layer 'clay' crosses the bottom of layer 'fill': at x = .* m higher"),
    (("depth = 1.0", "depth = 0.5"), r"layer 'fill' is 0.5 m thick at \(0.5, 9.5\) m, less than a particle of 1 m"),
    (("depth = 1.0", ""), "all but the last with their bottom, depth or thickness"),
    (
        ("rock = true", "rock = true\nstrength = { mean = 2e3 }"),
        r"\[layer 'rock'\]: it is rock, which has no strength to vary",
    ),
    (
        ("mean = 40e3, cov = 0.1", "mean = -1.0"),
        r"\[layer 'fill'.strength\] mean = -1: give a finite value above 0",
    ),
    (
        ("mean = 40e3, cov = 0.1", "men = 1.0"),
        r"\[layer 'fill'.strength\] has an unknown key 'men' \(did you mean 'mean'",
    ),
    (("[16.0, 2.0]", "[7.0, 2.0]"), r"surface turns back from \(8, 10\) to \(7, 2\) m"),
    (("[16.0, 2.0]", "[16.0]"), r"\[ground\] surface: point 3 is \[16.0\]: give \[x, z\]"),
    (("[32.0, 2.0]", "[32.0, inf]"), r"point 4 is \[32.0, inf\]"),
    (("[rough]", "[water]\nlevel = 1.0\nr_u = 0.2\n[rough]"), r"\[water\] has level and r_u: give one of"),
    (
        ("[rough]", "[water]\ndepth = -1.0\n[rough]"),
        r"\[water\] depth = -1 m: give a finite value of 0 or more, or a level for water",
    ),
    (("[rough]", "[water]\nraster = 'a.asc'\n[rough]"), r"\[water\] raster = 'a.asc' is no file that was read"),
    (("[rough]", "[water]\nr_u = 1.0\n[rough]"), r"\[water\] r_u = 1: give a value of 0 or more and below 1"),
    (
        ("[rough]", "[water]\ntable = [[0, 12], [8, 12], [16, 2], [32, 2]]\n[rough]"),
        r"water above the ground slopes from \(0.5, 12\) to \(13.5, 5.125\) m, where a pool is level: draw one",
    ),
    (
        ("[rough]", "[water]\nlevel = 5000.0\n[rough]"),
        r"\[water\] level stands 4990 m above .* more than 10 times its height of 10 m: .* unusual = true in \[soil\]",
    ),
    (
        ("[rough]", "[water]\ntable = [[0, -1], [32, -3]]\n[rough]"),
        r"\[water\] table lies below the base at 0 m everywhere, at -1 m and lower, and wets nothing: leave \[water\]",
    ),
    (('fields = "both"', 'fields = "both"\nmodes = "both"'), "only a slope with its toe has"),
    (("[ground]", "[ground]\nwalls = [1.0]"), r"\[ground\] walls = \[1.0\]: give two numbers, the lower one first"),
    (("[ground]", "[ground]\nwalls = [-2.0, 32.0]"), r"surface ends at \(0, 10\) m, 2 m from the wall at x = -2 m"),
]


@pytest.mark.parametrize(("change", "message"), REFUSED, ids=[message[:30] for _, message in REFUSED])
def test_ground_that_will_not_do_is_refused_before_anything_is_written(change, message, tmp_path):
    assert change[0] in LAYERED
    with pytest.raises(ValueError, match=message):
        run(LAYERED.replace(*change, 1), tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("name", sorted(path.stem for path in sites.SCENES.glob("*.toml")))
def test_scenes_of_known_slopes_are_those_built_in_python(name):
    row = sites.drawn(name)
    assert row.get("difference", 0.0) == 0.0
    assert ("difference" in row) == (name in sites.AS_CASES)


def test_every_wrong_key_is_named_at_once():
    text = LAYERED.replace("poisson", "nu").replace("cov = 0.4", "cof = 0.4\nlx = 20.0").replace("depth", "dept")
    text = text.replace("softening_modulus = 85e3", 'softening = "exponential"').replace("[run]", "[run]\nseed = 1")
    with pytest.raises(ValueError, match="unknown key") as refused:
        parse(text)
    for message in (
        "'nu' (did you mean 'poisson'?)",
        "'cof' (did you mean 'cov'?)",
        "'lx' (did you mean 'length'?)",
        "[layer 'fill'] has an unknown key 'dept' (did you mean 'depth'?)",
        "'softening' (did you mean softening_modulus (linear) or strain_95 (exponential)?)",
        "'seed' (did you mean 'seed' of [campaign]?)",
        "[soil] lacks poisson",
    ):
        assert message in str(refused.value)
    with pytest.raises(ValueError, match=r"'slope_ratio' \(did you mean 'run_per_rise'\?\)"):
        parse(TINY.replace("run_per_rise", "slope_ratio"))


def test_undrained_clay_refuses_a_share_of_its_weight_as_pore_pressure():
    with pytest.raises(ValueError, match=r"pore pressure by r_u in J2, whose strength is undrained .*: leave it out"):
        rough(LAYERED.replace("[rough]", "[water]\nr_u = 0.2\n[rough]"))


@pytest.mark.parametrize("water", ["level = 6.0", "depth = 2.0", "table = [[0, 8], [16, 2], [32, 2]]"])
def test_undrained_clay_stands_under_a_table(water):
    model = rough(LAYERED.replace("[rough]", f"[water]\n{water}\n[rough]"))
    assert model.scene.water is not None


LEVEL = """[ground]
surface = [[0.0, 8.0], [12.0, 8.0]]
base = -4.0
[water]
level = 2.0
[[layer]]
depth = 8.0
[[layer]]
saturated_unit_weight = 21e3
"""
WET = changed(
    SAND,
    (SAND[SAND.index("[slope]") : SAND.index("[soil]")], LEVEL),
    ("unit_weight = 20e3", "unit_weight = 18e3\nsaturated_unit_weight = 20e3"),
)


def test_ground_below_the_water_bears_its_saturated_weight_less_what_water_bears():
    scene, state = built(parse(WET), "refined")
    z = np.asarray(scene.particles.position[1])
    above, under = 18e3 * np.minimum(8 - z, 6), (20e3 - 9810) * np.clip(2 - z, 0, 2)
    expected = above + under + (21e3 - 9810) * np.maximum(-z, 0)
    inside = (z > -3) & (z < 7) & (abs(z - 2) > 1) & (abs(z) > 1)
    assert inside.sum() > 100
    assert np.allclose(-np.asarray(state.stress[2])[inside], expected[inside], rtol=1e-2)


SATURATED = "saturated_unit_weight = 20e3"
NO_SAY = [
    (
        ("[water]\nlevel = 2.0\n", ""),
        r"= 20000 N/m3 has no effect without water in the ground: give the water's level",
    ),
    (
        ("level = 2.0", "r_u = 0.2"),
        r"saturated_unit_weight = 20000 N/m3 has no effect beside r_u, which has no water table",
    ),
    ((SATURATED, "saturated_unit_weight = 17e3"), r"= 17000 N/m3 is below unit_weight = 18000 N/m3, .* unusual = true"),
    (
        ("saturated_unit_weight = 21e3", "unit_weight = 23e3"),
        r"\[layer 2\]: .* = 20000 N/m3 is below unit_weight = 23000",
    ),
    ((SATURATED, "saturated_unit_weight = 20.0"), r"unit_weight = 20 N/m3, below 3000 N/m3: were kN/m3 .* meant"),
    ((SATURATED, "saturated_unit_weight = nan"), "saturated_unit_weight = nan: give finite values"),
    (("[soil.cohesion]", STIFF[STIFF.index("[soil.unit") :] + "[soil.cohesion]"), "beside a unit_weight that varies"),
]


@pytest.mark.parametrize(("change", "message"), NO_SAY, ids=[message[-25:] for _, message in NO_SAY])
def test_saturated_weights_that_no_ground_has_are_refused(change, message):
    varies = "[soil.unit_weight]" in change[1]
    with pytest.raises(ValueError, match=message):
        parse(changed(WET.replace("unit_weight = 18e3\n", "") if varies else WET, change))


def test_undrained_clay_has_no_saturated_weight():
    with pytest.raises(ValueError, match="saturated_unit_weight has no say in undrained soil"):
        parse(changed(TINY, ("young = 2e7", f"young = 2e7\n{SATURATED}")))
    assert parse(changed(WET, (SATURATED, "saturated_unit_weight = 17e3\nunusual = true"))).soil is not None
    assert parse(changed(WET, ("level = 2.0", "level = 5e3"), (SATURATED, "unusual = true"))).site.water == 5e3
