"""Numbers of a scene's soil that look like slips, and fields that no soil has: refused, unless declared unusual."""

import pytest

from benchmarks.robustness.invented import TINY
from cooperative import run, runs
from cooperative.scene import parse
from tests.cooperative.scene.test_random_soil import changed


def test_a_scene_may_mean_what_looks_like_a_slip():
    odd = changed(TINY, ("mean = 30e3", "mean = 30.0"), ("unit_weight = 20e3", "unit_weight = 18.0\nunusual = true"))
    assert parse(odd).soil.unit_weight == 18.0
    spun = changed(TINY, ("[run]", "[run]\ngravity = 490.5"), ("young = 2e7", "young = 1e5\nunusual = true"))
    assert parse(spun).run.gravity == 490.5


def test_a_campaign_of_odd_numbers_leaves_no_folder(tmp_path):
    odd = changed(TINY, ("young = 2e7", "young = 1e5"), ("[run]", "[run]\ngravity = 490.5"))
    with pytest.raises(ValueError, match=r"\[run\] gravity = 490.5 m/s2, above 30 m/s2"):
        run(odd, tmp_path / "new")
    assert not (tmp_path / "new").exists()


def test_boreholes_that_cannot_be_are_refused():
    outside = changed(TINY, ("cov = 0.4", "cov = 0.4\nboreholes = [[99.0, 1.0, 35e3]]"))
    with pytest.raises(ValueError, match=r"35000 at .* lies outside the ground.*\(values outside: 1 of 1\)"):
        runs.random_soil(parse(outside))
    bounded = changed(TINY, ("cov = 0.4", 'cov = 0.2\nmarginal = "uniform"\nboreholes = [[4.0, 1.0, 95e3]]'))
    with pytest.raises(ValueError, match=r"value 95000 at \[4.0, 1.0\] m cannot occur in Uniform"):
        runs.random_soil(parse(bounded))
