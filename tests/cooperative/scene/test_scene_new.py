"""A scene is begun, seen and costed before it runs."""

import tomllib

import pytest

from benchmarks.robustness.invented import LAYERED, TINY
from cooperative.__main__ import main
from cooperative.example_scenes import SCHEMA, starters
from cooperative.runs import check_size, grid_size
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


@pytest.mark.parametrize("command", ["draw", "check", "run"])
def test_commands_for_random_slopes_say_that_nothing_is_random(command, tmp_path, capsys):
    tables = tomllib.loads(TINY)
    tables["soil"]["strength"] = tables.pop("strength")["mean"]
    (tmp_path / "certain.toml").write_text(to_toml(tables))
    more = {"run": ["--out", str(tmp_path / "out"), "--workers", "1"]}.get(command, [])
    assert main([command, str(tmp_path / "certain.toml"), *more]) == 2
    assert "nothing in the scene is random: give at least one parameter" in capsys.readouterr().err


def test_check_says_what_a_scene_costs(tmp_path, capsys):
    text = LAYERED.replace('name = "rock"', 'name = "gneiss"')
    (tmp_path / "mine.toml").write_text(text)
    assert main(["check", str(tmp_path / "mine.toml"), "--seconds", "0.1"]) == 0
    printed = capsys.readouterr().out
    campaign = parse(text)
    for grid in ("rough", "refined"):
        size = grid_size(campaign, grid)
        assert f"{size.particles:,.0f} particles, {size.nodes:,.0f} nodes" in printed
        assert f"runs of {size.steps:,.0f} steps" in printed
    for name in ("fill", "clay", "gneiss, rock", "hours of one core", "GB for all grids"):
        assert name in printed
    assert main(["check", str(tmp_path / "mine.toml"), "--seconds", "0"]) == 2
    assert "give more than 0" in capsys.readouterr().err


def test_check_names_every_wrong_key_and_builds_nothing(tmp_path, capsys):
    (tmp_path / "mine.toml").write_text(LAYERED.replace("poisson", "nu").replace("cov = 0.4", "cof = 0.4"))
    assert main(["check", str(tmp_path / "mine.toml")]) == 2
    printed = capsys.readouterr().err
    assert "(did you mean 'poisson'?)" in printed
    assert "(did you mean 'cov'?)" in printed
