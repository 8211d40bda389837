"""Mistakes of a scene that a reader makes, and what names them."""

import re

import pytest

from benchmarks.robustness.invented import SUBSET
from cooperative import runs
from cooperative.__main__ import main
from cooperative.example_scenes import example
from cooperative.scene import parse, remarks

DEMO, EMBANKMENT = example("demo"), example("embankment")
SAND = "[soil]\nunit_weight = 20e3\nyoung = 5e7\npoisson = 0.3\nfriction = 30.0\n"
FIELD = "[soil.cohesion]\nmean = 20e3\ncov = 0.2\nlength = [60.0, 4.0]\n" + DEMO[DEMO.index("[rough]") :]


def drawn(surface):
    """The demo on this ground."""
    return re.sub(r"\[slope\].*?(?=\n\[soil\])", f"[ground]\nsurface = {surface}", DEMO, flags=re.S)


def test_what_is_intended_is_accepted():
    swapped = DEMO.replace("length = [60.0, 2.0]", "length = [2.0, 60.0]").replace("[soil]", "[soil]\nunusual = true")
    assert parse(swapped).random["strength"].length == (2.0, 60.0)
    layer = EMBANKMENT.replace("length = [30.0, 2.0]", "length = [2.0, 30.0]").replace(
        'name = "soft clay"', 'name = "soft clay"\nunusual = true'
    )
    assert parse(layer).site.layers[1].random["strength"].length == (2.0, 30.0)


def test_a_layer_that_lies_nowhere_is_named():
    nowhere = EMBANKMENT.replace("bottom = [[0, 1], [64, 1]]", "bottom = [[0, 10], [64, 10]]")
    with pytest.raises(ValueError, match="layer 'soft clay' lies nowhere"):
        runs.random_soil(parse(nowhere))


def test_the_axis_that_is_too_far_is_named():
    far = drawn("[[0, 9012], [20, 9012], [36, 9004], [60, 9004]]\nbase = 9000.0")
    campaign = parse(far)
    with pytest.raises(ValueError, match=r"the section lies at z = 9000 to 9012 m, which float32 resolves"):
        campaign.site.shape.cells(campaign.grids["rough"])


def test_check_warns_of_a_road_on_the_crest(tmp_path, monkeypatch, capsys):
    road = '[[exposed]]\nname = "road"\nat = [{}]\n'
    assert list(remarks(parse(DEMO + road.format(110.0)))) == []
    [remark] = remarks(parse(DEMO + road.format(20.0)))
    assert remark.startswith("road stands at the crest, at z = 16 m of 16 m; x = 0 is the rear of the ground. No slide")
    scene = tmp_path / "crest.toml"
    scene.write_text(DEMO + road.format(20.0))
    assert main(["check", str(scene), "--measure", "0.01"]) == 0
    assert "WARNING        road stands at the crest" in capsys.readouterr().out


def test_a_correlation_length_of_less_than_two_cells_is_remarked():
    [remark] = remarks(parse(DEMO.replace("length = [60.0, 2.0]", "length = [60.0, 1.9]")))
    assert remark.startswith("strength has a correlation length of 1.9 m, less than two cells of 1 m of the refined gr")
    assert remark.endswith("give cells of at most 0.95 m")
    assert "length = [30.0, 2.0]" in EMBANKMENT
    assert any(
        "a correlation length of 0.1 m" in each for each in remarks(parse(EMBANKMENT.replace("30.0, 2.0", "3.0, 0.1")))
    )


def test_a_loss_beyond_the_end_and_a_front_thicker_than_the_slope_are_remarked():
    losing = DEMO.replace("[run]", "[run]\nrunout_thickness = {}", 1)
    assert list(remarks(parse(losing.format(11.9)))) == []
    [remark] = remarks(parse(losing.format(12.0)))
    assert remark.startswith("runout_thickness = 12 m, no less than the slope's height of 12 m: no deposit is so thick")
    slow = re.sub(r"softening_modulus = .*", "loss_time = {}", DEMO)
    slow = "\n".join(line for line in slow.splitlines() if "softening_" not in line and "plastic_strain" not in line)
    end = parse(DEMO).run.last("refined")
    assert list(remarks(parse(slow.format(end)))) == []
    [remark] = remarks(parse(slow.format(4 * end)))
    assert f"beyond the {end:g} s at which runs end, when 25 % of the loss has come: give t_end = {4 * end:g}" in remark


def test_a_displacement_that_is_none_a_low_slope_and_layers_of_one_name_are_remarked():
    tiny = re.sub(r"failure_displacement = .*", "failure_displacement = 1e-4", DEMO)
    [remark] = remarks(parse(tiny))
    assert remark.startswith("failure_displacement = 0.0001 m, less than a thousandth of the slope's height of")
    [remark] = remarks(parse(DEMO.replace("height = 12.0", "height = 2.0")))
    assert "1 cells of 2 m of the rough grid, which hardly resolves a slide: give cells of at most 0.5 m" in remark
    twice = EMBANKMENT.replace('name = "sand fill"', 'name = "soft clay"')
    assert any("2 layers are called 'soft clay'" in each for each in remarks(parse(twice)))
    assert not any("layers are called" in each for each in remarks(parse(EMBANKMENT)))


def test_soil_without_cohesion_that_forgets_its_gap_is_remarked():
    dry = DEMO[: DEMO.index("[soil]")] + SAND.replace("friction = 30.0\n", "cohesion = 0.0\n")
    field = FIELD.replace("[soil.cohesion]\nmean = 20e3", "[soil.friction]\nmean = 30.0").replace(
        "cov = 0.2", "cov = 0.1"
    )
    [remark] = remarks(parse(dry + field))
    assert remark.startswith(
        "cohesion = 0 with friction = 30 degrees and without tension_cutoff: soil that opens forgets"
    )
    assert not list(remarks(parse(dry + "tension_cutoff = 0.0\n" + field)))
    assert not list(remarks(parse(dry.replace("cohesion = 0.0", "cohesion = 1e3") + field)))


def test_dilation_without_an_end_and_small_levels_are_remarked():
    sand = DEMO[: DEMO.index("[soil]")] + SAND
    assert not any("dilation" in each for each in remarks(parse(sand + "dilation = 0.0\n" + FIELD)))
    [remark] = remarks(parse(sand + "dilation = 10.0\n" + FIELD))
    assert remark.startswith("dilation = 10 degrees without softening_strain: soil gains volume")
    assert not list(remarks(parse(sand + "dilation = 10.0\nsoftening_strain = 0.3\n" + FIELD)))
    [remark] = remarks(parse(SUBSET))
    assert remark.startswith("levels of 20 samples in each of 2 replicates")
    assert remark.endswith("give samples = 500 or more")


def test_check_says_how_much_ground_a_slide_may_need_beyond_the_toe(tmp_path, capsys):
    scene = tmp_path / "short.toml"
    scene.write_text(DEMO.replace("toe = 48.0", "toe = 10.0"))
    assert main(["check", str(scene), "--measure", "0.01"]) == 0
    printed = capsys.readouterr().out
    assert "  beyond the toe 10 m of ground; all soil above the toe" in printed
    assert "WARNING        a slide may reach the end of the ground, 10 m beyond the toe: make that" in printed


def test_soil_that_floats_in_some_sample_is_refused():
    wet = drawn("[[0, 16], [20, 16], [44, 4], [92, 4]]").replace("[soil]", "[water]\nlevel = 8.0\n[soil]")
    weight = "unit_weight = { mean = 11e3, cov = 0.05, length = [60.0, 2.0] }"
    with pytest.raises(ValueError, match=r"unit_weight comes down to 8996 N/m3, 4 deviations .* no more than the 9810"):
        parse(re.sub(r"unit_weight = \S+", weight, wet))
    assert parse(re.sub(r"unit_weight = \S+", weight.replace("11e3", "19e3"), wet)).random
