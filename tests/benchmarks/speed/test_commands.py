"""Waits at a terminal are measured of the slopes that they are named after, and of commands that end well."""

import os
from dataclasses import fields

import numpy as np
import pytest

from benchmarks.sites.limit_equilibrium import layers_of
from benchmarks.sites.slopes import cases
from benchmarks.speed import commands
from cooperative.scene import parse, to_toml
from cooperative.tools import safety
from cooperative.tools.soundings import read_files

OF_SLICES = {"unit_weight", "saturated_unit_weight", "strength", "cohesion", "friction", "strength_ratio"}


@pytest.mark.parametrize("case", cases(), ids=lambda case: case.name)
def test_the_scene_of_a_slope_is_that_slope(case):
    campaign = parse(to_toml(commands.scene_of(case)))
    shape = campaign.site.shape
    np.testing.assert_allclose(shape.surface, np.asarray(case.shape.surface, float))
    assert shape.base == case.shape.base
    assert (shape.bedrock is None) == (case.shape.bedrock is None)
    assert (shape.interface is None) == (case.shape.interface is None)
    for layer, given in zip(campaign.site.layers, layers_of(case), strict=True):
        for each in fields(given.soil):
            if each.name in OF_SLICES:
                assert getattr(layer.layer.soil, each.name) == getattr(given.soil, each.name)
    loads = dict(case.loads)
    assert campaign.site.r_u == loads.pop("r_u", None)
    assert campaign.run.k_h == loads.pop("k_h", 0.0)
    np.testing.assert_equal(np.asarray(campaign.site.water_table, float), np.asarray(loads.pop("water", None), float))
    assert not loads


def test_the_scene_of_a_slope_has_its_factor():
    case = next(case for case in cases() if case.name == "Published section")
    of_scene = safety.factor_of_safety(parse(to_toml(commands.scene_of(case))), solver=False)
    of_case = safety.critical_surface(safety.Slices.of(case.shape, layers_of(case), **case.loads))
    assert of_scene.equilibrium.slip.factor == pytest.approx(of_case.slip.factor, rel=1e-9)


def test_soundings_are_two_of_as_many_readings(tmp_path):
    soundings = read_files(commands.write_soundings(tmp_path))[0]
    assert [each.depth.size for each in soundings] == [commands.READINGS] * 2


def test_a_command_that_fails_is_no_wait():
    assert commands.wait(["--version"], os.environ).cpu > 0
    with pytest.raises(RuntimeError, match="jaxmpm new --kind hill failed"):
        commands.wait(["new", "--kind", "hill"], os.environ)
