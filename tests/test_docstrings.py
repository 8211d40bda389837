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
