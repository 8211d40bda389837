"""Documentation: every public name says what it is, and every field of a public dataclass is named there."""

import dataclasses
import inspect
import re

import pytest

import cooperative
import jaxmpm
import kl

PUBLIC = [
    (package, name)
    for package in (jaxmpm, kl, cooperative)
    for name in package.__all__
    if not inspect.ismodule(getattr(package, name))
]


@pytest.mark.parametrize(("package", "name"), PUBLIC, ids=[f"{p.__name__}.{n}" for p, n in PUBLIC])
def test_public_names_are_documented(package, name):
    thing = getattr(package, name)
    text = inspect.getdoc(thing) or ""
    # A dataclass without a docstring is given its signature as one.
    assert text
    assert not text.startswith(f"{name}(")
    if dataclasses.is_dataclass(thing):
        fields = [f.name for f in dataclasses.fields(thing)]
        assert not [f for f in fields if not re.search(rf"\b{f}\b", text)]


FUNCTIONS = [(package, name) for package, name in PUBLIC if inspect.isfunction(getattr(package, name))]


def named(text: str) -> list[str]:
    """What a docstring's list of arguments names: words at the start of a sentence, before a colon."""
    lists = re.findall(r"(?:^|\.\s+|\n\s*)((?:[a-z_0-9]+, )*[a-z_0-9]+): ", text)
    return [name for found in lists for name in found.split(", ")]


@pytest.mark.parametrize(("package", "name"), FUNCTIONS, ids=[f"{p.__name__}.{n}" for p, n in FUNCTIONS])
def test_documented_arguments_exist(package, name):
    function = getattr(package, name)
    assert not set(named(inspect.getdoc(function) or "")) - set(inspect.signature(function).parameters)
