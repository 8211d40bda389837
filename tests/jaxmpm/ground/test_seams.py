"""Weak layers thinner than the cells resolve: what counts as one, and who asks about it."""

import warnings

import numpy as np
import pytest

import jaxmpm as mpm
from benchmarks.robustness.invented import LAYERED
from cooperative.__main__ import main
from cooperative.scene import built, check_cells, parse
from tests.cooperative.scene.test_random_soil import changed

STRONG, WEAK = mpm.FrictionalSoil(20e3, 20.0), mpm.FrictionalSoil(0.0, 10.0)
SURFACE = [(0, 12), (12, 12), (24, 4), (32, 4)]


def ground(thickness, seam=WEAK, over=STRONG, base=2.0):
    """A slope over a seam of this thickness (m) on the base."""
    line = [(0, base + thickness), (32, base + thickness)]
    return mpm.Section(SURFACE, base=base), [mpm.Layer(over, line), mpm.Layer(seam)]


def build(shape, layers, cell=1.0):
    return mpm.section(shape, layers, mpm.Discretisation(cell, (cell / 2,) * 2), at_rest=False)


@pytest.mark.parametrize("thickness", [0.5, 1.0, 1.5])
def test_a_weak_layer_thinner_than_two_cells_is_warned_of(thickness):
    with pytest.warns(UserWarning, match=rf"layer 2 is {thickness:g} m thick, {thickness:g} cells of 1 m, and weaker"):
        build(*ground(thickness))


@pytest.mark.parametrize(
    "seam",
    [mpm.CamClaySoil(0.1, 0.02, 0.3), mpm.AnisotropicSoil(5e3, 4e3, 3e3), mpm.GranularSoil(10.0, 20.0, 0.001)],
    ids=lambda soil: type(soil).__name__,
)
def test_a_weak_layer_of_any_law_is_warned_of(seam):
    with pytest.warns(UserWarning, match=r"layer 2 is 0.5 m thick, 0.5 cells of 1 m, and weaker"):
        build(*ground(0.5, seam))


KNOWN = {
    "two cells": ground(2.0),
    "hardly weaker": ground(0.5, mpm.FrictionalSoil(18e3, 19.0)),
    "stronger": ground(0.5, STRONG, WEAK),
    "as strong at its critical state": ground(0.5, mpm.CamClaySoil(0.1, 0.02, 0.9), mpm.FrictionalSoil(0.0, 21.0)),
    "declared": ground(0.5, mpm.FrictionalSoil(0.0, 10.0, unusual=True)),
}


@pytest.mark.parametrize(("shape", "layers"), KNOWN.values(), ids=KNOWN)
def test_other_layers_are_not(shape, layers):
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        build(shape, layers)
    assert not [str(warning.message) for warning in seen]


def test_weakness_is_that_under_the_weight_above():
    """Sand is the weaker one near the surface, clay as strong at every depth is below."""
    clay, sand = mpm.FrictionalSoil(30e3, 0.0), mpm.FrictionalSoil(0.0, 30.0)
    shape = mpm.Section([(0, 20), (32, 20)])
    layers = [mpm.Layer(sand, depth=1.0), mpm.Layer(clay, depth=10.0), mpm.Layer(sand, depth=11.0), mpm.Layer(clay)]
    thicknesses = shape.thicknesses(layers)
    assert [each.weak for each in thicknesses] == [True, True, False, True]
    assert np.allclose([each.metres for each in thicknesses], [1, 9, 1, 9])


def test_under_a_terrain_layers_are_measured_alike():
    flat = mpm.Raster(np.full((5, 5), 6.0), (0.0, 0.0), 2.0)
    layers = [mpm.Layer(STRONG, depth=4.5), mpm.Layer(WEAK, thickness=1.0), mpm.Layer(STRONG)]
    shape = mpm.Terrain(flat, base=0.0)
    assert [round(each.metres, 6) for each in shape.thicknesses(layers)] == [4.5, 1.0, 0.5]
    with pytest.warns(UserWarning, match="layer 2 is 1 m thick, 0.5 cells of 2 m"):
        mpm.terrain(shape, layers, mpm.Discretisation(2.0, (0.5,) * 3), at_rest=False)


SEAM = changed(LAYERED, ("strength = { mean = 40e3, cov = 0.1 }", "strength = { mean = 10e3, cov = 0.1 }"))


def test_a_campaign_asks_about_a_seam_too_thin_for_its_refined_grid():
    with pytest.raises(ValueError, match=r"is 1 m thick, 1 cells of 1 m, .* cells of at most 0.5 m.* unusual = true"):
        check_cells(parse(SEAM))
    finer = changed(SEAM, ("cell = 1.0\nspacing = [0.5, 0.5]", "cell = 0.5\nspacing = [0.25, 0.25]"))
    declared = changed(SEAM, ("[soil]", "[soil]\nunusual = true"))
    for text in (finer, declared):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            built(parse(text), "rough", at_rest=False)


def test_check_gives_the_cells_of_every_layer(tmp_path, capsys):
    path = tmp_path / "scene.toml"
    path.write_text(changed(SEAM, ("[soil]", "[soil]\nunusual = true")))
    assert main(["check", str(path), "--measure", "0.1"]) == 0
    row = "1 m thick: 0.5 rough cells, 1 refined cells; a weak layer, too strong on the rough and the refined"
    assert row in capsys.readouterr().out


INTERFACE = changed(LAYERED, ("[ground]", "[ground]\ninterface = { friction = 12.0, cohesion = 3e3 }"))


def test_a_scene_gives_its_base_a_strength():
    scene, _ = built(parse(INTERFACE), "rough", at_rest=False)
    assert np.isclose(scene.boundary.friction, np.tan(np.radians(12.0)))
    assert np.isclose(scene.boundary.cohesion, 3e3)
    for wrong, message in (
        ("70.0", r"\[ground.interface\] friction = 70 degrees: give a value from 0 to 60"),
        ("0.2", "friction = 0.2 degrees, below 1.6"),
    ):
        with pytest.raises(ValueError, match=message):
            parse(changed(INTERFACE, ("friction = 12.0", f"friction = {wrong}")))
