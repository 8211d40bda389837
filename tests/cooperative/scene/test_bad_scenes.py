"""Scenes that no campaign can be made of: each is refused in one line, before anything is built or written."""

import math
import re
from contextlib import nullcontext
from types import SimpleNamespace

import jax
import pytest

from benchmarks.robustness.invented import LAYERED, TERRAIN
from cooperative import runs
from cooperative.__main__ import main
from cooperative.runs import check_coefficients, check_size, grid_size
from cooperative.runs._lanes import lent_by
from cooperative.scene import SEVERAL, TABLES, check_scene, parse, read_scene
from cooperative.scene.tables import _reading, keys
from cooperative.store import scene_digest
from jaxmpm.support.check import Faults
from tests.cooperative.campaign.test_campaign import SCENES, TINY


def test_a_size_is_that_of_the_grid_that_is_built():
    campaign = parse(TINY)
    for grid in ("rough", "refined"):
        size = grid_size(campaign, grid)
        scene, _ = runs.build(campaign, grid, None).scene, None
        # A slope's face is made of steps.
        assert size.particles == pytest.approx(scene.particles.mass.size, rel=0.05)
        assert size.nodes == math.prod(scene.grid.shape)
        assert size.steps == pytest.approx(campaign.run.t_end / float(scene.numerics.time_step))
        assert size.passes == (scene.numerics.nonlocal_passes or 0)


def test_scenes_that_come_along_fit_into_a_small_machine(monkeypatch):
    monkeypatch.setattr(runs._size, "memory_limit", lambda: 8e9)
    for path in SCENES.glob("*.toml"):
        if "[sweep]" not in path.read_text():
            check_size(parse(path.read_text()))
    paper = parse((SCENES / "paper.toml").read_text())
    size = grid_size(paper, "refined")
    assert (size.particles, grid_size(paper, "rough").particles) == (681_984, 42_624)
    with pytest.raises(ValueError, match=r"particles in 64 workers take some .* GB, this machine lends 8 GB"):
        check_size(paper, workers=64)
    with pytest.raises(ValueError, match=r"1000 samples of 10000000 coefficients take some 12.* GB"):
        check_coefficients(paper, 10_000_000)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_where_lanes_stand_on_devices_their_memory_decides(count, monkeypatch):
    paper = parse((SCENES / "paper.toml").read_text())
    rough, refined = (grid_size(paper, grid) for grid in ("rough", "refined"))
    needed = rough.memory(64) + refined.memory(1)
    lent = {"bytes_limit": needed}
    device = SimpleNamespace(memory_stats=lambda: lent, device_kind="NVIDIA H200")
    sharing = {1: 1, 64 * count: count, count: count, None: count}
    for module, name in ((runs._size, "devices_of"), (runs._lanes, "devices_of")):
        monkeypatch.setattr(module, name, lambda lanes=None: [device] * sharing[lanes])
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    # The host holds one lane of each grid, and would not hold all.
    monkeypatch.setattr(runs._size, "memory_limit", lambda: rough.memory(1) + refined.memory(1) + runs._size.PROCESS)
    check_size(paper)
    lent["bytes_limit"] = needed - 1
    with pytest.raises(
        ValueError,
        match=rf"{64 * count} and {count} lanes take some .* GB, each NVIDIA H200 lends .* GB: .*XLA_CLIENT_MEM",
    ):
        check_size(paper)
    with pytest.raises(ValueError, match=r"in 4 workers take some .* GB, this machine lends .* GB: "):
        check_size(paper, workers=4)


def test_devices_that_tell_no_limit_set_none():
    def device(stats):
        return SimpleNamespace(memory_stats=lambda: stats)

    assert lent_by([device(None), device({}), device({"bytes_limit": -1})]) == math.inf
    assert lent_by([device(None), device({"bytes_limit": 3}), device({"bytes_limit": 2})]) == 2
    assert lent_by(jax.devices("cpu")) == math.inf


def wrong_values():
    """Values of which each is wrong for most keys."""
    numbers = ["nan", "inf", "-inf", "-1", "0", "1e308", "1e-308", "9_223_372_036_854_775_807"]
    return [*numbers, '"text"', "true", "[]", "[1.0]", "[nan, nan]", "[[1]]", "{}", "1979-05-27", "'\\u001b'"]


KEYS = [(section, key) for section, table in TABLES.items() for key in keys(table) if section != "sweep"]


@pytest.mark.parametrize(("section", "key"), KEYS, ids=[f"{section}-{key}" for section, key in KEYS])
def test_every_wrong_value_of_every_key_is_fine_or_ends_in_one_line(section, key):
    messages = [refusal(with_value(section, key, value)) for value in wrong_values()]
    assert all("\n" not in line and len(line) < 500 for line in messages)
    assert sum(map(bool, messages)) >= 6


def refusal(text):
    """Message that refuses a scene; empty for one that will do."""
    try:
        check_size(parse(text))
    except ValueError as error:
        return str(error)
    return ""


def with_value(section, key, value):
    """The small scene with one key of one table set, of the first where there are several."""
    drawn = {"ground": LAYERED, "layer": LAYERED, "water": LAYERED, "terrain": TERRAIN}
    header = f"[[{section}]]" if section in SEVERAL else f"[{section}]"
    lines, here, done = [], "", False
    for line in drawn.get(section, TINY).splitlines():
        if line.startswith("["):
            here = line
            lines += [line, *([f"{key} = {value}"] if here == header and not done else [])]
            done = done or here == header
        elif not (here == header and line.split(" = ")[0] == key):
            lines.append(line)
    return "\n".join(lines if done else [*lines, header, f"{key} = {value}"])


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"\x89PNG\r\n\x1a\n\x00\xff", r"scene .*scene.toml is no text in UTF-8 \(byte 0, in line 1\)"),
        ('name = "a"\n# B\u00f6schung'.encode("latin-1"), r"\(byte 14, in line 2\).* saved with the encoding UTF-8"),
        (None, "there is no scene "),
        (b"a" * 1_000_001, "has 1000001 bytes, the limit is 1000000"),
    ],
)
def test_files_that_are_no_scene_are_named(content, message, tmp_path, capsys):
    path = tmp_path / "scene.toml"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(ValueError, match=message):
        read_scene(path)
    for command in ("run", "sweep"):
        assert main([command, str(path), "--out", str(tmp_path / "out")]) == 2
        printed = capsys.readouterr().err
        assert printed.startswith("error: ")
        assert str(path) in printed
        assert printed.count("\n") == 1
    with pytest.raises(ValueError, match="is no file"):
        read_scene(tmp_path)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"], ids=["unix", "windows", "mac"])
def test_a_scene_is_read_in_the_encoding_that_it_states(encoding, end, tmp_path):
    path = tmp_path / "scene.toml"
    named = "# B\u00f6schung\n" + TINY
    path.write_bytes(named.replace("\n", end).encode(encoding))
    assert read_scene(path).text == named


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-be"])
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"], ids=["unix", "windows", "mac"])
def test_all_faults_of_a_scene_are_named_in_any_encoding(encoding, end, tmp_path):
    path = tmp_path / "scene.toml"
    faulty = TINY.replace("samples = ", "wobble = 3\nsamples = -")
    assert faulty != TINY
    text = ("\ufeff" * (encoding == "utf-16-be") + faulty).replace("\n", end)
    path.write_bytes(text.encode(encoding))
    with pytest.raises(Faults) as refused:
        check_scene(path, lambda _: None)
    assert any("wobble" in fault for fault in refused.value.faults)
    assert any("samples" in fault for fault in refused.value.faults)


@pytest.mark.parametrize(
    ("value", "why"),
    [
        (r'"my data\terrain.csv"', "has a backslash, or a special character that one gave .*cannot be read"),
        (r'"C:\Users\me\terrain.csv"', r"not valid TOML .*: a backslash in double quotes begins a special character"),
        (r"'my data\terrain.csv'", "terrain.csv' has a backslash"),
    ],
)
def test_a_path_of_windows_is_named_by_its_backslash(value, why, tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text(f"[ground]\nsurface = {value}\n")
    with pytest.raises(ValueError, match=f"{why}.*write folders of a path with / in between"):
        read_scene(path)


@pytest.mark.parametrize(
    ("line", "why"),
    [
        ("t_end = 3,5", "a point marks decimals"),
        ("t_end = -3,5  # s", "a point marks decimals"),
        ("name = \u201cclay\u201d", "straight quotation marks"),
        ("name = \u00abclay\u00bb", "straight quotation marks"),
        ("t_end\u00a0= 3", "a special blank"),
        ("t_end: 3", "have = between them"),
        ("t_end = ", "write it as toml.io says"),
        ('name = "\u201cclay\u201d\u00a0: 1,5" x', "write it as toml.io says"),
    ],
)
def test_what_is_usually_wrong_in_a_line_that_is_no_toml_is_said(line, why, tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text(f"# run\n{line}\n[run]\n", encoding="utf-8")
    with pytest.raises(ValueError, match=f"not valid TOML .*at line 2.*: .*{why}"):
        read_scene(path)


def test_a_file_that_cannot_be_read_for_another_reason_has_no_backslash(tmp_path):
    path = tmp_path / "scene.toml"
    for text in ('[ground]\nsurface = "my data/none.csv"\n', "[ground]\nsurface = \n"):
        path.write_text(text)
        with pytest.raises(ValueError) as refused:  # noqa: PT011 the text is looked at below
            read_scene(path)
        assert "backslash" not in str(refused.value)


def test_of_many_unknown_keys_the_first_are_explained(monkeypatch):
    asked = []
    words = _reading._suggestion
    monkeypatch.setattr(_reading, "_suggestion", lambda *given: asked.append(given) or words(*given))
    many = TINY.replace("[soil]", "[soil]\n" + "\n".join(f"kez{k} = 1" for k in range(3000)))
    with pytest.raises(ValueError, match=r"unknown key 'kez0'.*unknown key 'kez7'.*; and 2992 more$"):
        parse(many)
    assert len(asked) == _reading.NAMED


def test_a_byte_order_mark_at_the_head_of_a_file_is_no_part_of_the_scene(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text("\ufeff" + TINY, encoding="utf-8")
    assert read_scene(path).text == TINY
    assert read_scene(path).digest == scene_digest(TINY)
    with pytest.raises(ValueError, match=r"begins with a byte order mark .*: read its file with encoding"):
        parse("\ufeff" + TINY)


@pytest.mark.parametrize("name", ["a\\u0000b.csv", "a\\u0000b.dxf#GROUND"])
def test_a_file_whose_name_holds_what_no_name_may_is_named(name, tmp_path, capsys):
    path = tmp_path / "scene.toml"
    path.write_text(f'[ground]\nsurface = "{name}"\n')
    assert main(["check", str(path)]) == 2
    assert re.search(r"(?m)^  \[ground\] surface: .*/a\?b.\w+ names no file \(.*\): give .*\n", capsys.readouterr().err)


@pytest.mark.parametrize("workers", [0, -3])
def test_no_workers_are_refused_before_the_folder_is_made(workers, tmp_path, capsys):
    scene = tmp_path / "scene.toml"
    scene.write_text(TINY)
    for command in ("run", "sweep"):
        text = TINY if command == "run" else TINY + "[sweep]\nlx = [10.0]\n"
        scene.write_text(text)
        short = pytest.warns(UserWarning, match="a slide may reach the end of the ground")
        with short if command == "run" else nullcontext():
            assert main([command, str(scene), "--out", str(tmp_path / "out"), "--workers", str(workers)]) == 2
        assert capsys.readouterr().err == f"error: workers = {workers}: give 1 or more\n"
        assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("address", ["nowhere", "tcp://127.0.0.1:1", "http://127.0.0.1:1", "tcp://", ""])
def test_a_scheduler_that_does_not_answer_is_named_before_the_folder_is_made(address, tmp_path, capsys, monkeypatch):
    pytest.importorskip("distributed", reason="extra `dask` is not installed")
    monkeypatch.setattr(runs._dask, "ANSWER_TIMEOUT", 1)
    for name in ("build", "random_soil"):
        monkeypatch.setattr(runs, name, lambda *_, **__: type("Invented", (), {"modes": 3, "counts": (3,)})())
    scene = tmp_path / "scene.toml"
    scene.write_text(TINY)
    with pytest.warns(UserWarning, match="a slide may reach the end of the ground"):
        assert main(["run", str(scene), "--out", str(tmp_path / "out"), "--dask", address]) == 2
    printed = capsys.readouterr().err.splitlines()[-1]
    assert printed.startswith(f"error: no Dask scheduler answers at {address!r} (")
    assert not (tmp_path / "out").exists()
