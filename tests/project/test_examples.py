"""Examples in docstrings run, as by `pytest --doctest-modules`, and the main public functions have one."""

import doctest
from importlib import import_module

import pytest

from tests import ROOT

PATHS = [
    path.relative_to(ROOT) for package in ("jaxmpm", "kl", "cooperative") for path in (ROOT / package).rglob("*.py")
]
MODULES = [".".join(path.with_suffix("").parts) for path in sorted(PATHS) if ">>> " in (ROOT / path).read_text("utf-8")]
EXAMPLES = {
    test.name: test
    for module in MODULES
    for test in doctest.DocTestFinder().find(import_module(module), module)
    if test.examples
}

MAIN = (
    *("section", "slope", "read_line", "read_raster", "overburden", "with_soil", "numbers_of", "reduced"),
    *("solve", "solve_each", "save_state"),
    *("Lognormal", "expand", "field_at", "field_on_lattice", "captured_variance", "condition", "latin_hypercube"),
    *("wilson_interval", "monte_carlo", "rank_samples", "two_phase", "fit_fragility"),
)


def test_the_main_functions_have_an_example():
    assert not {*MAIN} - {name.rpartition(".")[2] for name in EXAMPLES}


@pytest.mark.parametrize("name", EXAMPLES)
def test_an_example_runs(name):
    runner = doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE)
    said: list[str] = []
    runner.run(EXAMPLES[name], out=said.append)
    assert not runner.failures, "".join(said)
