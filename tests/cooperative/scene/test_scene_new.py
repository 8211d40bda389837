"""A scene is begun, seen and costed before it runs."""

import tomllib

import numpy as np
import pytest

from benchmarks.robustness.invented import LAYERED, TINY
from cooperative.__main__ import main
from cooperative.example_scenes import SCHEMA, starters
from cooperative.folder import models_of
from cooperative.runs import check_size, grid_size, soil_of
from cooperative.scene import parse, read_scene, to_toml


@pytest.mark.parametrize("kind", ["section", "slope", "terrain"])
def test_a_scene_of_each_kind_is_begun_and_fits(kind, tmp_path, capsys):
    path = tmp_path / "mine.toml"
    assert main(["new", "--kind", kind, "--out", str(path)]) == 0
    assert capsys.readouterr().out.split()[0] == str(path)
    campaign = parse(read_scene(path))
    check_size(campaign)
    # Only what is needed is asked for: neither a stopping rule nor a budget.
    assert not {"k_t", "refined_runs", "energy"} & set(path.read_text().replace("=", " ").split())
    assert main(["new", "--kind", kind, "--out", str(path)]) == 2
    assert "exists already" in capsys.readouterr().err
    assert set(starters()) == {"section", "slope", "terrain"}


def test_the_schema_for_editors_is_written_beside_a_scene_and_never_over_another(tmp_path, capsys):
    schema = tmp_path / SCHEMA.name
    assert main(["new", "--out", str(tmp_path / "one.toml")]) == 0
    assert capsys.readouterr().out.splitlines() == [str(tmp_path / "one.toml"), str(schema)]
    assert schema.read_bytes() == SCHEMA.read_bytes()
    assert (tmp_path / "one.toml").read_text() == f"#:schema ./{schema.name}\n" + starters()["slope"].read_text()
    # One that is there already is enough.
    assert main(["example", "demo", "--out", str(tmp_path / "two.toml")]) == 0
    assert capsys.readouterr() == (f"{tmp_path / 'two.toml'}\n", "")
    for number, other in enumerate(("{}", SCHEMA.read_text() + "\n")):
        schema.write_text(other)
        with pytest.warns(
            UserWarning, match=f"{schema} is there already, is not the schema of this version, and stays"
        ):
            assert main(["new", "--out", str(tmp_path / f"three-{number}.toml")]) == 0
        assert schema.read_text() == other
    # A scene that exists is refused before anything is written.
    schema.unlink()
    assert main(["new", "--out", str(tmp_path / "one.toml")]) == 2
    assert not schema.exists()
    (tmp_path / "nowhere").mkdir()
    (tmp_path / "nowhere" / schema.name).symlink_to(tmp_path / "gone.json")
    with pytest.warns(UserWarning, match="stays as it is"):
        assert main(["new", "--out", str(tmp_path / "nowhere" / "four.toml")]) == 0
    assert not (tmp_path / "gone.json").exists()


def test_a_scene_is_drawn(tmp_path, capsys):
    (tmp_path / "mine.toml").write_text(LAYERED + '\n[[exposed]]\nname = "road"\nbetween = [12, 14]\n')
    assert main(["draw", str(tmp_path / "mine.toml")]) == 0
    drawn = (tmp_path / "mine.png").read_bytes()
    assert drawn.startswith(b"\x89PNG")
    assert capsys.readouterr().out.strip() == str(tmp_path / "mine.png")
    assert main(["draw", str(tmp_path / "mine.toml"), "--sample", "6"]) == 2
    assert "the scene has samples 0 to 5" in capsys.readouterr().err
    assert main(["draw", str(tmp_path / "mine.toml"), "--out", str(tmp_path / "mine.html")]) == 2
    assert "a section has nothing to turn" in capsys.readouterr().err
    assert main(["draw", str(tmp_path / "mine.toml"), "--out", str(tmp_path / "mine")]) == 2
    assert "mine is no name of a picture: give a PNG, PDF or SVG" in capsys.readouterr().err
    assert main(["draw", str(tmp_path / "mine.toml"), "--out", str(tmp_path / "none" / "mine.png")]) == 2
    assert f"make {tmp_path / 'none'} and start the same command again" in capsys.readouterr().err


def certain(path):
    tables = tomllib.loads(TINY)
    tables["soil"]["strength"] = tables.pop("strength")["mean"]
    path.write_text(to_toml(tables))
    return path


def test_a_run_of_a_scene_without_anything_random_says_what_to_do(tmp_path, capsys):
    scene = certain(tmp_path / "certain.toml")
    assert main(["run", str(scene), "--out", str(tmp_path / "out"), "--workers", "1"]) == 2
    printed = capsys.readouterr().err
    assert "nothing in the scene is random, so all samples are alike: `jaxmpm slide` runs this one slope" in printed
    assert "for a probability give at least one parameter of the soil as a table" in printed
    assert not (tmp_path / "out").exists()


def test_a_scene_without_anything_random_is_checked_and_drawn(tmp_path, capsys):
    scene = certain(tmp_path / "certain.toml")
    assert main(["check", str(scene)]) == 0
    printed = capsys.readouterr().out
    assert f"nodes; a run of {grid_size(parse(scene), 'refined').steps:,.0f} steps\n" in printed
    assert "nothing: `jaxmpm slide` and `jaxmpm fos` take this scene, `jaxmpm run` does not" in printed
    assert main(["draw", str(scene)]) == 0
    assert scene.with_suffix(".png").stat().st_size > 10_000
    assert main(["draw", str(scene), "--sample", "0"]) == 2
    assert "sample = 0 is given, and nothing in the scene is random: leave it out" in capsys.readouterr().err


def test_a_scene_without_anything_random_is_drawn_by_its_strength():
    tables = tomllib.loads(LAYERED)
    del tables["strength"]["cov"], tables["strength"]["length"]
    tables["soil"]["strength"] = tables.pop("strength")["mean"]
    for layer in tables["layer"]:
        if isinstance(layer.get("strength"), dict):
            layer["strength"] = layer["strength"]["mean"]
    campaign = parse(to_toml(tables))
    assert not campaign.varies
    model = models_of(campaign)["refined"]
    drawn = soil_of(model, np.zeros(0)).values
    rock = [each.rock for each in campaign.site.layers]
    for number, layer in enumerate(campaign.site.layers):
        values = drawn["strength"][np.asarray(model.layer) == number]
        assert values.size
        np.testing.assert_allclose(values, np.nan if rock[number] else layer.layer.soil.strength, rtol=1e-6)


def test_check_says_what_a_scene_costs(tmp_path, capsys):
    text = LAYERED.replace('name = "rock"', 'name = "gneiss"')
    (tmp_path / "mine.toml").write_text(text)
    assert main(["check", str(tmp_path / "mine.toml"), "--measure", "0.1"]) == 0
    printed = capsys.readouterr().out
    campaign = parse(text)
    for grid in ("rough", "refined"):
        size = grid_size(campaign, grid)
        assert f"{size.particles:,.0f} particles, {size.nodes:,.0f} nodes" in printed
        assert f"runs of {size.steps:,.0f} steps" in printed
    for name in ("fill", "clay", "gneiss, rock", "hours of one core", "GB for all grids"):
        assert name in printed
    assert main(["check", str(tmp_path / "mine.toml"), "--measure", "0"]) == 2
    assert "give more than 0" in capsys.readouterr().err


def test_check_names_every_wrong_key_and_builds_nothing(tmp_path, capsys):
    (tmp_path / "mine.toml").write_text(LAYERED.replace("poisson", "nu").replace("cov = 0.4", "cof = 0.4"))
    assert main(["check", str(tmp_path / "mine.toml")]) == 2
    printed = capsys.readouterr().err
    assert "(did you mean 'poisson'?)" in printed
    assert "(did you mean 'cov'?)" in printed
