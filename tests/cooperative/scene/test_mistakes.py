"""Mistakes of a scene that a reader makes, and what names them."""

import re

import pytest

from cooperative import runs
from cooperative.__main__ import main
from cooperative.scene import example, parse, remarks

DEMO, EMBANKMENT = example("demo"), example("embankment")
CLAY = r"\[layer 'soft clay'\]: strength"


def drawn(surface):
    """The demo on this ground."""
    return re.sub(r"\[slope\].*?(?=\n\[soil\])", f"[ground]\nsurface = {surface}", DEMO, flags=re.S)


GROUND = drawn("[[0, 12e3], [20, 12e3], [36, 4e3], [60, 4e3]]")


@pytest.mark.parametrize(
    ("text", "old", "new", "message"),
    [
        (DEMO, "length = [60.0, 2.0]", "length = [2.0, 60.0]",
         r"\[strength\] length = \[2.0, 60.0\]: it correlates over 60 m upwards and 2 m along.*order is x, y, z"),
        (EMBANKMENT, "length = [30.0, 2.0]", "length = [2.0, 30.0]", CLAY + " length = .* in the layer"),
        (DEMO, "height = 12.0", "height = 12000.0", r"\[slope\] has heights z up to 12004 m .* were mm or cm meant"),
        (GROUND, "", "", r"\[ground\] has heights z up to 12000 m .* were mm or cm meant"),
        (EMBANKMENT, "mean = 17e3", "mean = 17", CLAY + " mean = 17 Pa.* unusual = true in the layer"),
        (EMBANKMENT, "cohesion = 2e3  ", "strength_ratio = 0.3 ", r"the layer lacks strength_minimum"),
        (EMBANKMENT, "length = [30.0, 2.0]", "length = [30.0, 2.0, 3.0]", "layer 'soft clay': strength length has 3"),
        (EMBANKMENT, "bottom = [[0, 1], [64, 1]]\n", "", r"layers: .*; layer 'soft clay' has none"),
        (EMBANKMENT, "bottom = [[0, 1], [64, 1]]", "bottom = [[0, 10], [64, 10]]", r"layer 'soft clay' lies nowhere"),
    ],
)  # fmt: skip
def test_a_mistake_is_named(text, old, new, message):
    wrong = text.replace(old, new)
    wrong = re.sub(r"friction = \{ mean = 33.*?\n", "", wrong) if "strength_ratio" in new else wrong
    with pytest.raises(ValueError, match=message):
        runs.random_soil(parse(wrong))


def test_what_is_intended_is_accepted():
    swapped = DEMO.replace("length = [60.0, 2.0]", "length = [2.0, 60.0]").replace("[soil]", "[soil]\nunusual = true")
    assert parse(swapped).random["strength"].length == (2.0, 60.0)
    layer = EMBANKMENT.replace("length = [30.0, 2.0]", "length = [2.0, 30.0]").replace(
        'name = "soft clay"', 'name = "soft clay"\nunusual = true'
    )
    assert parse(layer).site.layers[1].random["strength"].length == (2.0, 30.0)


def test_the_axis_that_is_too_far_is_named():
    far = drawn("[[0, 9012], [20, 9012], [36, 9004], [60, 9004]]\nbase = 9000.0")
    campaign = parse(far)
    with pytest.raises(ValueError, match=r"the section lies at z = 9000 to 9012 m, which float32 resolves"):
        campaign.site.shape.cells(campaign.rough)


def test_check_warns_of_a_road_on_the_crest(tmp_path, monkeypatch, capsys):
    road = '[[exposed]]\nname = "road"\nat = [{}]\n'
    assert list(remarks(parse(DEMO + road.format(110.0)))) == []
    [remark] = remarks(parse(DEMO + road.format(20.0)))
    assert remark.startswith("road stands at the crest, at z = 16 m of 16 m; x = 0 is the rear of the ground. No slide")
    scene = tmp_path / "crest.toml"
    scene.write_text(DEMO + road.format(20.0))
    assert main(["check", str(scene), "--seconds", "0.01"]) == 0
    assert "WARNING        road stands at the crest" in capsys.readouterr().out
