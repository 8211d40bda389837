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
from tests.cooperative.scene.test_random_soil import SAND, changed
from tests.scenes import model_of

GROUND = LAYERED[LAYERED.index("[ground]") : LAYERED.index("[[layer]]")]
OUTLINE = LAYERED.replace(LAYERED[LAYERED.index("[[layer]]") : LAYERED.index("[soil]")], "")


def test_the_outline_of_a_slope_is_that_slope():
    one, other = model_of(TINY), model_of(OUTLINE)
    assert np.array_equal(one.scene.particles.position, other.scene.particles.position)
    coefficients = np.linspace(-1, 1, one.soil.modes)
    assert np.array_equal(one.strength(coefficients), other.strength(coefficients))
    assert runs.grid_size(one.campaign, "rough") == runs.grid_size(other.campaign, "rough")


def test_each_layer_has_its_own_distribution_of_the_one_field():
    model, plain = model_of(LAYERED), model_of(OUTLINE)
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
    (tmp_path / "ground.csv").write_text("z;x\n10;0\n10;8\n2;16\n2;32\n")
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
        ("x_ft,z_furlong\n0,10\n", "has the headings .* name the distance along the section x"),
        ("0,10\nten,1\n", "line 2 has 'ten', '1': give x and z"),
        ("0,10,3\n", "line 1 has 3 columns: give two, x and z"),
        ("0,10\n1,nan\n", "line 2 has '1', 'nan': give x and z"),
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


@pytest.mark.parametrize("name", sorted(path.stem for path in sites.SCENES.glob("*.toml")))
def test_scenes_of_known_slopes_are_those_built_in_python(name):
    row = sites.compare_scene(name)
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
        model_of(LAYERED.replace("[rough]", "[water]\nr_u = 0.2\n[rough]"))


@pytest.mark.parametrize("water", ["level = 6.0", "depth = 2.0", "table = [[0, 8], [16, 2], [32, 2]]"])
def test_undrained_clay_stands_under_a_table(water):
    model = model_of(LAYERED.replace("[rough]", f"[water]\n{water}\n[rough]"))
    assert model.scene.loads.water is not None


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


def test_undrained_clay_has_no_saturated_weight():
    with pytest.raises(ValueError, match="saturated_unit_weight has no effect in undrained soil"):
        parse(changed(TINY, ("young = 2e7", "young = 2e7\nsaturated_unit_weight = 20e3")))
    weight = "saturated_unit_weight = 20e3"
    assert parse(changed(WET, (weight, "saturated_unit_weight = 17e3\nunusual = true"))).soil is not None
    assert parse(changed(WET, ("level = 2.0", "level = 5e3"), (weight, "unusual = true"))).site.water_table == 5e3
