"""Collapse of a column of dry sand in the plane: statics, similarity, and the run-out measured in experiments."""

import numpy as np
import pytest

from benchmarks.accuracy.collapse import FRICTION, collapsed

# Run-out over the initial width of columns of aspect ratio a, of sand (Lube et al. 2005, 10.1103/PhysRevE.72.041301)
# and of glass beads (Lajeunesse et al. 2005, 10.1063/1.2087592); both after Lagree et al. (2011),
# 10.1017/jfm.2011.335, section 3. What grains differ by is the scatter that a law for all of them has.
LOW = (1.2, 1.8)  # times a, below a = 1.8
TALL = (1.9, 2.3)  # times a^(2/3), above a = 2.8


def front(aspect, cells):
    """Run-out of the front over the width; what is left of the motion must be nothing to speak of."""
    result = collapsed(aspect, cells)
    assert result["speed_left"] < 0.01
    return result["front"]


@pytest.mark.slow
def test_low_columns_run_out_by_their_height_alone_and_rest_below_the_angle_of_friction():
    # A collapse that does not reach the wall behind has no length but the height: the linear law. Both are 4 cells
    # high.
    by_height = np.array([front(0.5, 8) / 0.5, front(1.0, 4)])
    assert abs(by_height[1] / by_height[0] - 1) < 0.01
    # The sand that left the column lies at less than the angle of friction: a triangle as long as this, at least.
    assert np.all(by_height > 1 / (2 * np.tan(FRICTION)))


@pytest.mark.slow
def test_low_column_converges_to_a_run_out_between_that_of_sand_and_of_glass_beads():
    # The front ends at single cells until they are as small as this: 1.02, 1.27, 1.44, 1.68 and 1.72 widths with 8 to
    # 128 cells a width.
    coarse, middle, fine = (collapsed(1.0, cells) for cells in (16, 32, 64))
    assert LOW[0] < fine["front"] < LOW[1]
    changes = np.diff([run["front_of_95_percent"] for run in (coarse, middle, fine)])
    assert 0 < changes[1] < 0.75 * changes[0]


@pytest.mark.slow
def test_run_out_of_a_tall_column_lies_between_that_of_sand_and_of_glass_beads():
    # At 16 cells a width one cell is a few grains of the experiments.
    run_out = front(3.0, 16) / 3 ** (2 / 3)
    assert TALL[0] < run_out < TALL[1]


@pytest.mark.slow
def test_run_out_of_tall_columns_grows_with_an_exponent_as_measured():
    # 0.65 +- 0.05 in narrow slots and 0.9 +- 0.1 in wide channels (Balmforth and Kerswell 2005,
    # 10.1017/S0022112005005537), whose walls hold back less; in plane strain there are none.
    aspects = np.array([3.0, 5.0, 8.0])
    measured = np.array([front(aspect, 8) for aspect in aspects])
    assert 0.65 - 0.05 < np.polyfit(np.log(aspects), np.log(measured), 1)[0] < 0.9 + 0.1
