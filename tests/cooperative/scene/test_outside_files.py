"""Files that a scene names lie in its folder, unless whoever reads it says otherwise."""

import re

import pytest

from cooperative.__main__ import main
from cooperative._commands import parser, read_source
from cooperative.example_scenes import begin
from cooperative.scene import parse, read_scene

SECRET = "1 2\n3 hunter2:x:0:0\n"


@pytest.fixture
def scene(tmp_path):
    """The folder of a scene, the text of the scene with SURFACE to fill in, and a file beside the folder."""
    folder = tmp_path / "scene"
    folder.mkdir()
    begin("section", folder / "section.toml")
    text = (folder / "section.toml").read_text()
    text = re.sub(r"^surface = .*$", "surface = SURFACE", text, flags=re.M)
    assert "surface = SURFACE" in text
    points = re.search(r"surface = \[(.*)\]", (folder / "section.toml").read_text())[1]
    rows = "\n".join(", ".join(pair) for pair in re.findall(r"\[([-\d.]+), ([-\d.]+)\]", points))
    (folder / "line.csv").write_text(rows)
    (tmp_path / "line.csv").write_text(rows)
    (tmp_path / "secret.csv").write_text(SECRET)
    return folder, text


def given(scene, name):
    folder, text = scene
    path = folder / "section.toml"
    path.write_text(text.replace("SURFACE", f'"{name}"'))
    return path


@pytest.mark.parametrize("name", ["line.csv", "./line.csv", "../scene/line.csv", "sub/../line.csv"])
def test_a_file_in_the_folder_is_read_by_any_name(scene, name):
    (scene[0] / "sub").mkdir()
    assert parse(given(scene, name)).site.shape.extent[0] > 0


def test_the_folder_of_a_scene_may_itself_be_a_link(scene, tmp_path):
    given(scene, "line.csv")
    (tmp_path / "link").symlink_to(scene[0])
    assert read_scene(str(tmp_path / "link" / "section.toml")) == read_scene(scene[0] / "section.toml")


def outside(scene, tmp_path):
    folder = scene[0]
    (folder / "link.csv").symlink_to(tmp_path / "secret.csv")
    (folder / "data").symlink_to(tmp_path)
    return ("../secret.csv", str(tmp_path / "secret.csv"), "link.csv", "data/secret.csv", "sub/../../secret.csv")


def test_files_outside_are_refused_by_every_command_without_a_word_of_theirs(scene, tmp_path, capsys):
    (scene[0] / "sub").mkdir()
    for name in outside(scene, tmp_path):
        path = given(scene, name)
        for asked in (["check"], ["draw"], ["fos", "--quick"], ["run", "--out", str(tmp_path / "out")],
                        ["sweep", "--out", str(tmp_path / "out")]):  # fmt: skip
            assert main([asked[0], str(path), *asked[1:]]) == 2
            said = capsys.readouterr().err
            assert "lies outside the scene's folder: move it there, or allow it by --allow-outside" in said
            assert "hunter2" not in said
    assert not (tmp_path / "out").exists()


def test_a_file_outside_is_read_where_the_user_allows_it(scene):
    path = given(scene, "../line.csv")
    with pytest.raises(ValueError, match="lies outside"):
        parse(path)
    source = read_scene(path, outside=True)
    assert parse(source).site.shape == parse(given(scene, "line.csv")).site.shape
    given(scene, "../line.csv")
    for arguments in (["check"], ["draw"], ["fos"], ["run", "--out", "o"], ["sweep", "--out", "o"]):
        whole = parser().parse_args([*arguments, str(path), "--allow-outside"])
        assert read_source(whole) == source


def test_a_link_for_the_results_of_fos_is_not_followed(scene, tmp_path, capsys):
    (tmp_path / "elsewhere").mkdir()
    (scene[0] / "section-fos").symlink_to(tmp_path / "elsewhere")
    assert main(["fos", str(given(scene, "line.csv")), "--quick"]) == 2
    assert "section-fos is a link or a file, not a folder: move it away" in capsys.readouterr().err
    assert not list((tmp_path / "elsewhere").iterdir())


@pytest.mark.parametrize("key", ["surface", "water", "boreholes", "record"])
def test_every_key_that_names_a_file_keeps_to_the_folder(scene, tmp_path, key):
    path = given(scene, "../secret.csv" if key == "surface" else "line.csv")
    added = {
        "water": '[water]\ntable = "../secret.csv"\n',
        "boreholes": '[soil.young]\nmean = 2e7\ncov = 0.1\nlength = [9.0, 9.0]\nboreholes = "../secret.csv"\n',
        "record": '[motion]\nrecord = "../secret.csv"\n',
    }
    text = path.read_text()
    if key == "boreholes":
        text = re.sub(r"^young = .*\n", "", text, flags=re.M)
    if key == "water":
        text = re.sub(r"\[water\]\n(?:(?!\[).*\n)*", "", text)
    path.write_text(text + "\n" + added.get(key, ""))
    with pytest.raises(ValueError, match=r"secret.csv lies outside the scene's folder"):
        read_scene(path)
