"""Slopes as the comparator by limit equilibrium is given them."""

import sys
from collections.abc import Sequence

import numpy as np
import pytest
import shapely

import jaxmpm as mpm
from benchmarks.sites import limit_equilibrium, slopes
from cooperative.tools import safety

LAYERED = [case for case in slopes.cases() if isinstance(case.soil, Sequence)]


@pytest.mark.parametrize("case", LAYERED, ids=lambda case: case.name)
def test_zones_are_the_layers_of_the_solver(case):
    zones = list(safety.zones(case.shape, case.soil))
    assert np.isclose(sum(zone.area for _, zone in zones), case.shape.volume)
    rng, (low, extent) = np.random.default_rng(3), (case.shape.corner, case.shape.extent)
    x, z = np.array(low)[:, None] + np.array(extent)[:, None] * rng.uniform(size=(2, 500))
    held = z < case.shape.heights(x)
    layer = case.shape.layer_of(case.soil, np.stack([x, z]), mpm.Discretisation(0.25, (0.125, 0.125)))
    for number, zone in zones:
        inside = shapely.contains_xy(zone, x, z)
        assert (layer[inside & held] == number).all()
        assert held[inside].all()


def test_ground_down_at_the_base_is_left_out_of_its_zone():
    [case] = [case for case in slopes.cases() if case.name == "Griffiths and Lane 1"]
    [(number, zone)] = safety.zones(case.shape, [mpm.Layer(case.soil)])
    assert number == 0
    assert zone.is_valid
    assert np.isclose(zone.area, case.shape.volume)


def test_without_the_package_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "xslope", None)
    with pytest.raises(ValueError, match=r"needs xslope.*: pip install xslope"):
        limit_equilibrium.run(quick=True)


def test_spencer_finds_the_published_factor(monkeypatch, tmp_path):
    pytest.importorskip("xslope.slice")
    stored = limit_equilibrium.INPUTS
    monkeypatch.setattr(limit_equilibrium, "INPUTS", tmp_path / "inputs")
    report = limit_equilibrium.run(quick=True)
    [row] = report.rows
    assert abs(row["circle"] - 0.984) < 0.005  # Spencer's method in Giam and Donald (1989)
    assert row["fos"] <= row["circle"]
    assert abs(row["fos"] / row["peer"] - 1) < 0.002
    assert report.draw is not None
    report.draw(tmp_path)
    [given] = (tmp_path / "inputs").glob("*.json")
    assert given.read_text() == (stored / given.name).read_text()
