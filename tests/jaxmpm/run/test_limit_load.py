"""A factor of safety by the limit load: when a slope moves on, and where its displacement turns over R."""

import re
from dataclasses import replace

import numpy as np
import pytest

import jaxmpm as mpm
from jaxmpm.run._limit_load import Times, find_kink, speeds_up
from tests.jaxmpm.verification.test_limits import CUT

TIME = np.linspace(0.05, 4.0, 80)
PATHS = {
    "slides off": (0.5 * 0.2 * TIME**2, True),
    "yields, then slides off": (0.01 * (1 - np.exp(-5 * TIME)) + 0.05 * TIME**2, True),
    "slides, then stands again": (1 - np.cos(np.pi * np.minimum(TIME / 3, 1)), True),
    "creeps": (0.1 * TIME**0.95, False),
    "comes to rest": (0.3 * (1 - np.exp(-2 * TIME)), False),
    "rings": (0.01 * (1 - np.cos(9 * TIME)), False),
    "does not move": (np.zeros_like(TIME), False),
}


def test_lanes_are_judged_apart():
    displacements = np.stack([path for path, _ in PATHS.values()], axis=1)
    assert speeds_up(displacements, first=8).tolist() == [on for _, on in PATHS.values()]


@pytest.mark.parametrize("turn", [1.1, 1.16, 1.2, 1.21])
def test_the_kink_is_where_the_branches_meet(turn):
    # Time alone may say too much: the search starts at 1.2 and goes down to where the displacement turns.
    kink = find_kink(lambda factor: 0.004 * factor**3 + 3 * np.maximum(factor - turn, 0), 1.2)
    assert abs(kink.at / turn - 1) < 0.01
    assert kink.stands <= kink.at <= kink.moves
    assert not kink.jumps
    assert kink.sharpness > 100


def test_where_displacement_jumps_the_kink_is_at_the_jump():
    kink = find_kink(lambda factor: np.where(factor < 1.2, 0.004 * factor, 2 + 3 * (factor - 1.2)), 1.21)
    assert kink.jumps
    assert kink.stands < 1.2 < kink.moves
    assert kink.sharpness > 1000


def test_displacement_that_grows_evenly_has_no_kink():
    with pytest.raises(ValueError, match=r"no kink, .* grows too evenly .* give a failure_displacement"):
        find_kink(lambda factor: 0.01 * factor, 1.2)


def test_displacement_that_falls_is_no_even_growth_and_is_named():
    # As a slope of sand with half its weight borne by water does: it moves at 0.80 and 0.82 and stands at 0.84.
    over = [0.76, 0.78, 0.80, 0.82, 0.84, 0.87, 0.95, 1.1]
    displacement = [0.04, 0.05, 0.69, 0.83, 0.12, 0.33, 0.72, 1.9]
    with pytest.raises(ValueError, match=r"no kink, .* share of PIC") as refused:
        find_kink(lambda factor: np.interp(factor, over, displacement), 0.9)
    with pytest.warns(UserWarning, match=r"limit load at R = 0.8\d+ is in doubt") as warned:
        find_kink(lambda factor: np.interp(factor, over, displacement), 0.82)
    for message in (str(refused.value), str(warned[0].message)):
        seen = re.search(r"it moves ([\d.]+) m at R = ([\d.]+) and ([\d.]+) m at R = ([\d.]+),", message)
        more, at, less, then = map(float, seen.groups())
        assert more > 1.5 * less
        assert 0.78 < at < 0.83 < then < 0.87


@pytest.mark.slow
def test_clay_that_does_not_soften_has_the_limit_load_of_slip_circles():
    # The published section: 1.142 to 1.147 by slip circles, 1.14 by finite differences.
    soil = mpm.Soil(strength=42e3)
    scene, state = mpm.slope(mpm.Slope(), soil, mpm.Discretisation(2.0, (1.0, 1.0), fbar=True))
    result = mpm.factor_of_safety(scene, state, criterion="limit load", bracket=(1.0, 1.4), resolution=0.04, batch=3)
    assert abs(result.kink / 1.144 - 1) < 0.04
    assert result.stable <= result.kink <= result.fails
    assert result.sharpness > 10


@pytest.mark.slow
def test_where_soil_softens_both_criteria_mean_the_same():
    shape = mpm.Slope(crest=6, height=4, run_per_rise=1.0, toe=8, foundation=2)
    soil = mpm.Soil(young=1e7, strength=22e3, softening_modulus=60e3)
    scene, state = mpm.slope(shape, soil, mpm.Discretisation(1.0, (0.5, 0.5)))
    choices = {"bracket": (1.1, 1.6), "resolution": 0.02, "batch": 4, "t_end": 6.0}
    by_displacement = mpm.factor_of_safety(scene, state, failure_displacement=0.5, **choices)
    by_load = mpm.factor_of_safety(scene, state, criterion="limit load", **choices)
    assert by_displacement.kink is by_displacement.sharpness is None
    assert abs(by_load.fails - by_displacement.fails) <= 0.02
    assert abs(by_load.kink - by_displacement.stable) < 0.04


def test_other_criteria_and_times_too_short_are_refused():
    soil = mpm.Soil(young=1e5, strength=22e3)
    scene, state = mpm.slope(CUT, soil, mpm.Discretisation(1.0, (0.5, 0.5)))
    with pytest.raises(ValueError, match="criterion = 'limit': give 'limit load', or a failure_displacement"):
        mpm.factor_of_safety(scene, state, criterion="limit")
    with pytest.raises(ValueError, match="both criterion and failure_displacement"):
        mpm.factor_of_safety(scene, state, criterion="limit load", failure_displacement=0.5)
    with pytest.raises(ValueError, match="gravity = 0 m/s2"):
        mpm.factor_of_safety(replace(scene, gravity=0 * scene.gravity), state, criterion="limit load")
    needed = 4 * Times.of(scene, 1e3).elastic
    with pytest.raises(ValueError, match=f"t_end = 4 s, but soil this soft takes .* give {needed:.2g} s or more"):
        mpm.factor_of_safety(scene, state, criterion="limit load", t_end=4.0)
