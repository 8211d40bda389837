"""Documentation: every public name says what it is; what it lists exists; shapes and units are written in one way."""

import ast
import dataclasses
import enum
import inspect
import re

import pytest

import cooperative
import cooperative.doctor
import cooperative.estimate
import cooperative.exports
import cooperative.hazard
import cooperative.measure
import cooperative.reporting
import cooperative.runs
import cooperative.store
import cooperative.summary
import cooperative.tools.research.back_analysis
import cooperative.tools.research.rare
import jaxmpm
import jaxmpm.seepage
import jaxmpm.support.check
import jaxmpm.support.files
import jaxmpm.support.hdf5
import jaxmpm.support.pytrees
import jaxmpm.support.text
import kl
import kl.plots
from tests import ROOT

PUBLIC = [
    (package, name)
    for package in (jaxmpm, kl, cooperative)
    for name in package.__all__
    if not inspect.ismodule(getattr(package, name))
]


def test_public_names_are_documented():
    for package, name in PUBLIC:
        thing = getattr(package, name)
        text = inspect.getdoc(thing) or ""
        # A dataclass without a docstring is given its signature as one.
        assert text, name
        assert not text.startswith(f"{name}(")
        fields = [each.name for each in dataclasses.fields(thing)] if dataclasses.is_dataclass(thing) else []
        assert not [each for each in fields if not re.search(rf"\b{each}\b", text)], name


# Modules whose functions a script calls by the module's name.
BY_MODULE = (
    *(jaxmpm.diagnostics, jaxmpm.objectives, jaxmpm.tensors, kl.plots),
    *(jaxmpm.support.check, jaxmpm.support.files, jaxmpm.support.hdf5, jaxmpm.support.pytrees, jaxmpm.support.text),
    *(cooperative.doctor, cooperative.hazard),
    *(cooperative.tools.research.back_analysis, cooperative.tools.research.rare),
)
LISTED = [
    (f"{package.__name__}.{name}", getattr(package, name)) for package, name in PUBLIC if package is not cooperative
]
ROOMS = (
    *(jaxmpm.ground, jaxmpm.laws, jaxmpm.run, jaxmpm.seepage, jaxmpm.setup, jaxmpm.soil, jaxmpm.transfer),
    *(kl.axis, kl.field, kl.marginal),
    *(cooperative.estimate, cooperative.exports, cooperative.measure, cooperative.reporting, cooperative.runs),
    *(cooperative.store, cooperative.summary),
)
LISTED += [
    (f"{room.__name__}.{name}", getattr(room, name))
    for room in ROOMS
    for name in room.__all__
    if all(getattr(room, name) is not thing for _, thing in LISTED)
]
LISTED += [
    (f"{module.__name__}.{name}", thing)
    for module in BY_MODULE
    for name, thing in vars(module).items()
    if not name.startswith("_") and getattr(thing, "__module__", "") == module.__name__
]
CALLED = [
    (name, thing) for name, thing in LISTED if inspect.isclass(thing) or inspect.isfunction(inspect.unwrap(thing))
]


def arguments(text: str) -> list[str]:
    """Names in the section `Args:` of a docstring, one line each."""
    _, _, section = text.partition("\nArgs:\n")
    section = re.split(r"\n(?=\S)", section)[0]
    return re.findall(r"^    \*{0,2}(\w+): \S", section, re.MULTILINE)


def expected(thing) -> list[str]:
    """Arguments of a function, fields of a dataclass or named tuple; none of other classes."""
    if dataclasses.is_dataclass(thing):
        return [field.name for field in dataclasses.fields(thing)]
    if isinstance(thing, type):
        return list(getattr(thing, "_fields", ()))
    return list(inspect.signature(thing).parameters)


def test_each_argument_has_a_line_in_order():
    for name, thing in CALLED:
        if not (isinstance(thing, type) and issubclass(thing, enum.Enum | Exception)):
            assert arguments(inspect.getdoc(thing) or "") == expected(thing), name


def test_public_methods_are_documented():
    for name, thing in CALLED:
        members = vars(thing).items() if isinstance(thing, type) else ()
        own = {key: getattr(value, "__func__", value) for key, value in members if not key.startswith("_")}
        methods = {key: value for key, value in own.items() if inspect.isfunction(value) or isinstance(value, property)}
        assert not [key for key, method in methods.items() if not method.__doc__], name
        lists = {key: method for key, method in methods.items() if "\nArgs:\n" in inspect.cleandoc(method.__doc__)}
        wrong = [key for key, method in lists.items() if arguments(inspect.getdoc(method)) != expected(method)[1:]]
        assert not wrong, name


def test_a_missing_and_a_misplaced_line_are_seen():
    text = (
        "What it does.\n\nArgs:\n    scene: a scene.\n        Goes on.\n    *rest: others.\n\nReturns:\n    state: one."
    )
    assert arguments(text) == ["scene", "rest"]
    assert arguments("What it does, of scene: and state.") == []


MODULES = [path for package in ("jaxmpm", "kl", "cooperative") for path in (ROOT / package).rglob("*.py")]

# A shape is a tuple as Python writes it: (), (N,), (d, N).
FOREIGN = {
    "brackets, as in [d, N]": r"(?<!\w)\[(?:[dNBMkm]|nodes|modes)(?:, ?\w+)+\]|\[[dNBM]\]",
    "products, as in N x d": r"\b(?:[dNBM]|nodes|modes) ?(?: x |\u00d7|\*) ?(?:[dNBM]|nodes|modes|\d)\b",
    "one axis without a comma, as in (N)": r"(?<![\w\]])\((?:[dNBMk]|nodes|modes|samples|runs)\)",
    "units in brackets, as in [m]": r"(?<!\w)\[(?:m|s|Pa|kPa|kg|N|m2|m3|m/s|1/s)\]",
    "tuples in code, as in `(d,N)`": r"\((?:[dNBM]|nodes|modes),\w+\)",
}


def foreign(text: str) -> list[str]:
    return [match for pattern in FOREIGN.values() for match in re.findall(pattern, text)]


def test_shapes_are_tuples_and_units_are_not_in_brackets():
    for path in MODULES:
        kinds = ast.Module | ast.ClassDef | ast.FunctionDef
        nodes = [node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, kinds)]
        assert not [each for node in nodes for each in foreign(ast.get_docstring(node) or "")], path


@pytest.mark.parametrize(
    "text", ["[d, N] m", "N x d", "modes \u00d7 N", "mass (N) kg", "(nodes)", "(d,N)", "[N] values", "cells [m]"]
)
def test_shapes_and_units_of_other_dialects_are_seen(text):
    assert foreign(text)


@pytest.mark.parametrize(
    "text", ["(d, N) m", "(N,)", "()", "cells (m)", "in [0, 1]", "cos(k)", "a[m, k]", "a[m]", "[lower, upper]"]
)
def test_tuples_and_what_is_no_shape_are_left_alone(text):
    assert not foreign(text)
