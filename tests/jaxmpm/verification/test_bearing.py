"""Bearing capacity of clay against Prandtl's 2 + pi, with and without a cure of locking."""

import numpy as np
import pytest

from benchmarks.accuracy.footing import CAPACITY, capacity
from tests.verification import order


def excess(cell, **choices):
    """Bearing capacity above theory, over it."""
    return capacity(cell, **choices)["load"] / CAPACITY - 1


FBAR, AVERAGED = {"fbar": True}, {"cell_average": True}


def test_strip_footing_bears_what_prandtl_says_with_a_cure_and_locks_without():
    plain, *cured = (excess(0.25, poisson=0.49, **cure) for cure in ({}, FBAR, AVERAGED))
    assert all(0 < each < 0.08 for each in cured)
    assert plain > 0.15


def test_plastic_flow_locks_at_a_poisson_ratio_of_0_3_too():
    # Flow of J2 keeps its volume whatever the elastic compressibility. The average over cells cures it less here.
    plain, by_neighbours, by_cells = (excess(0.5, poisson=0.3, **cure) for cure in ({}, FBAR, AVERAGED))
    assert plain > 0.15
    assert by_neighbours < 0.5 * plain
    assert by_cells < 0.7 * plain


@pytest.mark.slow
@pytest.mark.parametrize("poisson", [0.3, 0.49])
@pytest.mark.parametrize("cure", [FBAR, AVERAGED, pytest.param({}, id="none")])
def test_bearing_capacity_comes_down_to_theory_with_the_cell(poisson, cure):
    cells = np.array([0.5, 0.25, 0.125])
    errors = [excess(cell, poisson=poisson, **cure) for cell in cells]
    assert all(error > 0 for error in errors)
    assert order(cells, errors) > 0.8
    assert errors[-1] < (0.04 if cure else 0.15)
