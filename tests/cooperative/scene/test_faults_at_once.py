"""All that is wrong with a scene's file is named in one reading."""

import tomllib

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from benchmarks.robustness.invented import LAYERED
from cooperative.__main__ import main
from cooperative.runs import check_all
from cooperative.scene import check_scene, to_toml
from jaxmpm.support.check import Faults, Gathered

WRONG = {
    "an unknown key": (("soil", "hue"), 3, "[soil] has an unknown key 'hue'"),
    "an unknown key of a part": (("campaign", "hue"), 3, "[campaign] has an unknown key 'hue'"),
    "a number out of range": (("run", "t_end"), -5.0, "[run] t_end = -5 s: give a finite value above 0"),
    "a required number": (("rough", "cell"), -2.0, "[rough] cell = -2 m: give a finite value above 0"),
    "a choice": (("rough", "kernel"), "gump", "[rough] kernel = 'gump'"),
    "a layer": (("layer", 0, "poisson"), 0.7, "[layer 'fill'] poisson = 0.7"),
    "a number of another unit": (("soil", "young"), 90.0, "[soil] young = 90 Pa"),
    "axes of a field": (("strength", "length"), [60.0], "[strength] has a length of 1 values"),
    "cells": (("refined", "cell"), 4.0, "give [rough] larger cells"),
    "a mean": (("layer", 0, "strength"), {"mean": -4.0, "cov": 0.1}, "[layer 'fill'.strength] mean = -4"),
    "an element at risk": (
        ("exposed",),
        [{"name": "house", "between": [20.0, 24.0]}] * 2,
        "name = 'house' is there 2 times",
    ),
}


def spoilt(tables, path, value):
    *way, last = path
    for part in way:
        tables = tables[part]
    tables[last] = value


def faults_of(path):
    with pytest.raises(Faults) as caught:
        check_scene(path, check_all)
    return caught.value.faults


@pytest.mark.parametrize("name", WRONG)
def test_each_fault_alone_is_named_alone(name, tmp_path):
    tables = tomllib.loads(LAYERED)
    path, value, words = WRONG[name]
    spoilt(tables, path, value)
    (tmp_path / "scene.toml").write_text(to_toml(tables))
    (fault,) = faults_of(tmp_path / "scene.toml")
    assert words in fault


TOGETHER = [*WRONG]


@settings(max_examples=12, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(names=st.sets(st.sampled_from(TOGETHER), min_size=2))
def test_faults_of_all_stages_are_named_together_and_no_others(names, tmp_path):
    tables = tomllib.loads(LAYERED)
    for name in names:
        path, value, _ = WRONG[name]
        spoilt(tables, path, value)
    (tmp_path / "scene.toml").write_text(to_toml(tables))
    faults = faults_of(tmp_path / "scene.toml")
    # A cell that will not do says nothing about how it compares with that of the other grid.
    expected = names - ({"cells"} if "a required number" in names else set())
    assert all(any(WRONG[name][2] in fault for fault in faults) for name in expected)
    assert len(faults) == len(expected)


def test_a_fault_that_may_come_of_an_example_is_left_out(tmp_path):
    tables = tomllib.loads(LAYERED)
    tables["run"] |= {"t_end": -5.0, "slides_t_end": 10.0}  # later than any t_end that will do, or not
    tables["strength"]["length"] = [60.0]
    (tmp_path / "scene.toml").write_text(to_toml(tables))
    assert [fault.partition(" = -5")[0] for fault in faults_of(tmp_path / "scene.toml")] == [
        "[run] t_end",
        "[strength] has a length of 1 values: give 2, one per axis",
    ]


OF_A_GRID = {
    "a stable step": ({"scheme": "usl", "cfl": 0.9}, "stable up to 0.72"),
    "one share of PIC": ({"flip": 0.5, "pic_damping": 1.0}, "both set the share of PIC"),
    "what APIC needs": ({"apic": True}, "give kernel = QuadraticBSpline"),
    "particles without gaps": ({"spacing": [9.0, 9.0]}, "leaves gaps"),
}


@settings(max_examples=8, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(names=st.sets(st.sampled_from([*OF_A_GRID]), min_size=2))
def test_rules_of_a_grids_keys_are_named_together(names, tmp_path):
    tables = tomllib.loads(LAYERED)
    for name in names:
        tables["rough"] |= OF_A_GRID[name][0]
    (tmp_path / "scene.toml").write_text(to_toml(tables))
    faults = [fault for fault in faults_of(tmp_path / "scene.toml") if fault.startswith("[rough]")]
    assert all(any(OF_A_GRID[name][1] in fault for fault in faults) for name in names)


def test_twenty_faults_are_printed_by_table_and_the_others_counted(tmp_path, capsys):
    tables = tomllib.loads(LAYERED)
    for number in range(15):
        tables["run"][f"hue{number}"] = tables["soil"][f"tint{number}"] = 1
    (tmp_path / "scene.toml").write_text(to_toml(tables))
    assert main(["check", str(tmp_path / "scene.toml")]) == 2
    first, *lines = capsys.readouterr().err.splitlines()
    assert first == "error: 30 faults"
    assert len(lines) == 21
    assert lines[-1] == "  and 10 more"
    # What a table knows is listed once.
    assert sum("; it knows" in line for line in lines) == 2
    assert [line.split()[0] for line in lines[:20]] in (
        ["[soil]"] * 15 + ["[run]"] * 5,
        ["[run]"] * 15 + ["[soil]"] * 5,
    )


FILES = {
    "surface": ("ground", {"surface": "none.csv"}),
    "water": ("water", {"table": "none.csv"}),
    "motion": ("motion", {"record": "none.csv"}),
    "polygon of an element at risk": ("exposed", [{"name": "house", "polygon": "none.csv"}]),
}


@pytest.mark.parametrize("name", FILES)
def test_a_file_that_cannot_be_read_is_named_beside_a_key_that_is_not_known(name, tmp_path):
    tables = tomllib.loads(LAYERED)
    table, keys = FILES[name]
    tables[table] = keys if isinstance(keys, list) else tables.get(table, {}) | keys
    tables["run"]["hue"] = 3
    (tmp_path / "scene.toml").write_text(to_toml(tables))
    faults = faults_of(tmp_path / "scene.toml")
    assert any("none.csv" in fault for fault in faults)
    assert any("unknown key 'hue'" in fault for fault in faults)


def test_gathered_faults_flatten():
    outer = Gathered()
    with outer.of("layer"):
        inner = Gathered()
        for word in ("a", "b"):
            with inner.of():
                raise ValueError(word)
        inner.raise_all()
    with pytest.raises(Faults, match="layer: a; layer: b") as caught:
        outer.raise_all()
    assert caught.value.faults == ("layer: a", "layer: b")
