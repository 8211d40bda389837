"""The top of a layer before a cut, from which its trend counts."""

import numpy as np
import pytest

from benchmarks.robustness.invented import TERRAIN
from cooperative.scene import parse, remarks
from cooperative.tools import safety
from tests.scenes import model_of

CUT = """
name = "cut"
[ground]
surface = [[0, 9], [30, 9], [43.5, 0], [100, 0]]
base = -8.0
[[layer]]
name = "sand"
bottom = [[0, 5], [36, 5]]
unit_weight = 19e3
young = 2e7
poisson = 0.3
cohesion = 1e3
friction = 38
[[layer]]
name = "clay"
unit_weight = 17e3
young = 2e7
poisson = 0.3
strength = { mean = 25e3, cov = 0.2, trend = 1.5e3, trend_from = "layer", length = [30.0, 2.0] }
[rough]
cell = 2.0
spacing = [1.0, 1.0]
[refined]
cell = 1.0
spacing = [0.5, 0.5]
[campaign]
samples = 10
"""
LINE = CUT.replace('name = "clay"', 'name = "clay"\ntop = [[0, 5.0], [100, 5.0]]')
LEVEL = CUT.replace('name = "clay"', 'name = "clay"\ntop = 5.0')
ELEVATION = CUT.replace('trend_from = "layer"', "trend_from = 5.0")


@pytest.mark.parametrize("text", [LINE, LEVEL])
def test_the_trend_counts_from_the_top_before_the_cut(text):
    grown, expected = (model_of(each, "rough").growth["strength"][1] for each in (text, ELEVATION))
    assert np.allclose(grown, expected)
    factors = [safety.factor_of_safety(parse(each), solver=False).equilibrium.slip.factor for each in (text, ELEVATION)]
    assert factors[0] == pytest.approx(factors[1], rel=1e-6)


def test_without_it_the_face_is_the_top_and_a_remark_says_so():
    [remark] = [each for each in remarks(parse(CUT)) if "lies at the surface" in each]
    assert "from x = 36 to 100 m, over 5 m of height" in remark
    assert not [each for each in remarks(parse(LEVEL)) if "lies at the surface" in each]


def test_points_of_a_top_are_for_a_section():
    with pytest.raises(ValueError, match=r"\[layer 1\] top is a line, which is for a scene with \[ground\]: give"):
        parse(TERRAIN.replace("[soil]", "[[layer]]\ndepth = 1.0\ntop = [[0.0, 5.0], [9.0, 5.0]]\n[[layer]]\n[soil]", 1))
