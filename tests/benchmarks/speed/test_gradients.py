"""Gradients against differences: every law, with every number that it may have."""

import pytest

import jaxmpm as mpm
from benchmarks.results import stored_rows
from benchmarks.speed.gradients_problems import BY_LAW, FINE, LAWS, LEVEL
from jaxmpm.laws import Elastic, Law, declared


@pytest.mark.usefixtures("x64")
def test_every_law_is_compared_in_every_number_that_it_may_have():
    materials = {n: mpm.section(LEVEL, soil, FINE, at_rest=False)[0].material for n, soil in LAWS.items()}
    assert {name: type(law).__name__ for name, law in materials.items()} == {name: name for name in LAWS}
    laws = {each for each in vars(mpm.laws).values() if isinstance(each, type) and issubclass(each, Law)}
    assert laws - {Law, Elastic} == {type(law) for law in materials.values()}
    for law in materials.values():
        known = declared(law)
        assert type(law).PARAMETERS.keys() <= {number.path for number in known.values()}
        # A factor changes no number that is 0.
        assert all(float(number.value) for number in known.values())
    assert set(BY_LAW) == {*LAWS, "J2, exponential"}


def test_derivatives_of_the_longest_run_are_numbers():
    """Their number of seconds does not show whether they are."""
    assert [row["finite"] for row in stored_rows("gradients") if "finite" in row] == [True]
