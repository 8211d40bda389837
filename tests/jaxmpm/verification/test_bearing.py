"""Bearing capacity of clay against Prandtl's 2 + pi, with and without F-bar."""

import numpy as np
import pytest

from benchmarks.accuracy.footing import CAPACITY, capacity
from tests.verification import order


def excess(cell, **choices):
    """Bearing capacity above theory, over it."""
    return capacity(cell, **choices)["load"] / CAPACITY - 1


def test_strip_footing_bears_what_prandtl_says_with_fbar_and_locks_without():
    plain, cured = (excess(0.25, fbar=fbar, poisson=0.49) for fbar in (False, True))
    assert 0 < cured < 0.08
    assert plain > 0.15


def test_plastic_flow_locks_at_a_poisson_ratio_of_0_3_too():
    # Flow of J2 keeps its volume whatever the elastic compressibility.
    plain, cured = (excess(0.5, fbar=fbar, poisson=0.3) for fbar in (False, True))
    assert plain > 0.15
    assert cured < 0.5 * plain


@pytest.mark.slow
@pytest.mark.parametrize(("poisson", "fbar"), [(0.3, True), (0.49, True), (0.49, False)])
def test_bearing_capacity_comes_down_to_theory_with_the_cell(poisson, fbar):
    cells = np.array([0.5, 0.25, 0.125])
    errors = [excess(cell, fbar=fbar, poisson=poisson) for cell in cells]
    assert all(error > 0 for error in errors)
    assert order(cells, errors) > 0.8
    assert errors[-1] < (0.04 if fbar else 0.15)
