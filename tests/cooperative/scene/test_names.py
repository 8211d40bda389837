"""Names that a scene or a file gives reach tables, figures, terminals and folders as they are, or are refused."""

import dataclasses
import os
import tomllib
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cooperative.reporting import save
from cooperative.scene import parse, read_scene, source_of, tables, to_toml, variants
from cooperative.store import Source
from cooperative.tools import sweep, sweep_report
from cooperative.tools.soundings import read_files
from tests.cooperative.campaign.test_campaign import TINY

SECTION = (
    TINY
    + """
[[scenario]]
name = NAME
run.k_h = 0.1
"""
)
BAD = ["=cmd|' /C calc'!A0", "@SUM(1)", "+1", "-1", "a\nb", "\x1b[2J", "\u202eevil", "", "x" * 201]


@pytest.mark.parametrize("name", BAD)
@pytest.mark.parametrize("table", ["scene", "scenario", "exposed", "layer"])
def test_names_that_run_or_mislead_are_refused(name, table):
    values = tomllib.loads(TINY)
    if table == "scene":
        values["name"] = name
    elif table == "exposed":
        values["exposed"] = [{"name": name, "at": [3.0]}]
    elif table == "layer":
        values["layer"] = [{"name": name, "thickness": 2.0}]
    else:
        values["scenario"] = [{"name": name, "run": {"k_h": 0.1}}]
    with pytest.raises(ValueError, match=r"name = .*(: give one line of at most|takes it for a formula)"):
        tables.read(tables.SceneTable, values)


@settings(max_examples=50, deadline=None)
@given(st.recursive(st.text(st.characters(codec="utf-8")) | st.integers(-9, 9) | st.booleans(),
                    lambda each: st.lists(each, max_size=3)))  # fmt: skip
def test_any_text_of_a_scene_comes_back_from_its_toml(value):
    assert tomllib.loads(to_toml({"a": value, "b": {"key \x7f😀": value}})) == {"a": value, "b": {"key \x7f😀": value}}


def test_a_dollar_in_a_name_is_drawn_as_it_is(tmp_path):
    summary = parse(TINY)  # any object: figures take what they draw from its fields
    assert summary
    point = sweep_report.Point("cost $1 and $x_{", "scenario-1", _summary())
    named = {"scenario": [point, dataclasses.replace(point, value="$$")], "layer.a$b.strength.mean": [point]}
    save(sweep_report.probabilities(named), tmp_path / "a.png")
    assert sweep_report.label_of("motion.scale of $a$.csv") == r"scale of the record [-], \$a\$.csv"


def _summary():
    return SimpleNamespace(probability=SimpleNamespace(value=0.2, interval=(0.1, 0.3)))


def test_a_soundings_name_is_one_printable_line(tmp_path):
    rows = "\n".join(f'"\x1b[2Ja\tb\u202e",5,3,{0.2 * k:g},{1 + 0.1 * np.sin(k):.3f}' for k in range(1, 9))
    path = tmp_path / "cpt.csv"
    path.write_text(f"name,x [m],top [m],depth [m],qc [MPa]\n{rows}\n", encoding="utf-8")
    [sounding], _ = read_files([path])
    assert sounding.name == "?[2Ja?b?"


@pytest.mark.parametrize("name", ["figures", "campaigns", "campaigns/base"])
def test_a_link_in_the_folder_of_a_sweep_leads_nowhere(name, tmp_path):
    outside, folder = tmp_path / "outside", tmp_path / "out"
    outside.mkdir()
    source = source_of(SECTION.replace("NAME", '"quake"'))
    assert len(variants(source)) == 2
    sweep._claim(folder, source)
    target = folder / name
    if target.exists():
        target.rmdir()
    os.symlink(outside, target)
    with pytest.raises(ValueError, match="is a link or a file, not a folder: move it away"):
        sweep.run(source, folder)
    assert not list(outside.iterdir())


def test_the_folder_of_a_scene_can_be_read_after_a_name_of_any_script(tmp_path: Path):
    for name in ("Böschung 😀", 'quoted "a" \\ b', "$1"):
        text = to_toml({**tomllib.loads(TINY), "name": name})
        (tmp_path / "scene.toml").write_text(text, encoding="utf-8")
        assert parse(read_scene(tmp_path / "scene.toml")).name == name
        assert Source(text).tables["name"] == name
