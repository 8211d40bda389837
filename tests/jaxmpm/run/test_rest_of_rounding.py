"""The stress at rest of many cells in float32, where strains are differences of large displacements."""

import pytest

import jaxmpm as mpm
from jaxmpm.setup import _initial_stress as initial


@pytest.fixture(scope="module")
def slope():
    shape = mpm.Slope(crest=10.0, height=6.0, run_per_rise=1.0, toe=12.0, foundation=3.0)
    soil = mpm.FrictionalSoil(10e3, 30.0)
    choices = mpm.Discretisation(0.25, (0.125, 0.125), cell_average=False, dtype="float32")
    return mpm.slope(shape, soil, choices, at_rest=False)


def unbalanced(scene, stress):
    """Share of the load that a stress leaves, without solving for more."""
    return float(initial.elastic_equilibrium(scene, stress, iterations=0)[1])


def test_what_rounding_leaves_is_solved_for_once_more(slope, monkeypatch):
    scene, _ = slope
    once = unbalanced(scene, mpm.at_rest(scene).stress)
    monkeypatch.setattr(initial, "RESIDUAL", once / 2)
    assert unbalanced(scene, mpm.at_rest(scene).stress) < once / 2


def test_the_message_has_what_the_stress_leaves(slope, monkeypatch):
    scene, _ = slope
    monkeypatch.setattr(initial, "RESIDUAL", 1e-12)
    with pytest.raises(ValueError, match=r"the initial stress leaves \d\.\de-0\d of the weight unbalanced"):
        mpm.at_rest(scene)
