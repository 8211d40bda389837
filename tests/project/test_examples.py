"""Examples in docstrings: the main public functions have one that runs, as by `pytest --doctest-modules` too."""

import doctest

import pytest

import cooperative
import jaxmpm
import kl
from cooperative.tools.sweep_fragility import fit_fragility

MAIN = (
    *(jaxmpm.slope, jaxmpm.solve, jaxmpm.solve_each, jaxmpm.with_soil),
    *(kl.expand, kl.field_at, kl.Lognormal),
    *(
        cooperative.estimate.wilson_interval,
        cooperative.monte_carlo,
        cooperative.rank_samples,
        cooperative.estimate.two_phase,
    ),
    fit_fragility,
)


@pytest.mark.parametrize("thing", MAIN, ids=lambda thing: f"{thing.__module__}.{thing.__name__}")
def test_a_main_function_has_an_example_that_runs(thing):
    examples = [test for test in doctest.DocTestFinder(recurse=False).find(thing, thing.__name__) if test.examples]
    assert examples
    runner = doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE)
    said = []
    for test in examples:
        runner.run(test, out=said.append)
    assert not runner.failures, "".join(said)
