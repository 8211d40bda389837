"""What a notebook shows of a public value: ten lines at most, whatever it holds; `==` of two values is a bool."""

import copy
import dataclasses
import importlib

import jax.numpy as jnp
import numpy as np
import pytest

import cooperative
import jaxmpm as mpm
import kl
from benchmarks.measure import ROOT
from cooperative import runs
from cooperative.scene import parse

ROOMS = {
    "jaxmpm": "laws run types ground seepage transfer",
    "kl": "axis field marginal estimation",
    "cooperative": "scene runs estimate measure summary store tools.safety tools.site tools.soundings",
}
SHOWS_ITS_NUMBERS = {cooperative.estimate.Chances}
"""It holds a number for each of some modes."""


def public_classes(package):
    """Dataclasses that a package and its rooms export."""
    modules = [importlib.import_module(name) for name in (package, *(f"{package}.{r}" for r in ROOMS[package].split()))]
    exported = [getattr(module, name) for module in modules for name in getattr(module, "__all__", vars(module))]
    classes = {each for each in exported if isinstance(each, type) and dataclasses.is_dataclass(each)}
    return sorted(classes - SHOWS_ITS_NUMBERS, key=lambda c: (c.__module__, c.__qualname__))


def filled(cls):
    """A value whose arrays are large, and whose other fields are numbers."""
    value = object.__new__(cls)
    for field in dataclasses.fields(cls):
        kind = str(field.type)
        array = ("Array" in kind or "ndarray" in kind) and "Callable" not in kind
        held = np.arange(900.0).reshape(30, 30) if array else 1.5
        object.__setattr__(value, field.name, held)
    return value


@pytest.mark.parametrize("package", ROOMS)
def test_every_public_value_is_shown_in_ten_lines(package):
    long = {cls.__qualname__: text for cls in public_classes(package) if not short(text := repr(filled(cls)))}
    assert not long


def short(text):
    return len(text.splitlines()) <= 10 and len(text) <= 1000


@pytest.mark.parametrize("package", ["jaxmpm", "kl"])
def test_equality_of_public_values_is_a_bool_and_of_every_array(package):
    by_value = [cls for cls in public_classes(package) if cls.__eq__ is not object.__eq__]
    assert len(by_value) > 20
    for cls in by_value:
        value = filled(cls)
        again = copy.deepcopy(value)
        assert (value == again) is True, cls
        arrays = [
            f.name for f in dataclasses.fields(cls) if f.compare and isinstance(getattr(value, f.name), np.ndarray)
        ]
        for name in arrays:
            other = copy.copy(value)
            object.__setattr__(other, name, getattr(value, name) + 1)
            assert (value == other) is False, (cls, name)


def test_what_a_session_holds_is_shown_in_ten_lines():
    campaign = parse(ROOT / "benchmarks" / "scenes" / "paper_section.toml")
    soil = runs.random_soil(campaign)
    scene, state = mpm.column(4.0, mpm.Soil(young=5e6, strength=9e3), mpm.Discretisation(cell=1.0, spacing=(0.5,)))
    result = mpm.solve(scene, state, t_end=0.05, snapshots=[0.02])
    varying, expansion = campaign.random["strength"], soil.groups[0].expansion
    held = [campaign, campaign.soil, campaign.ground, campaign.rough, varying, soil, expansion]
    held += [scene, state, result, result.snapshots[0], kl.Empirical(jnp.arange(400.0))]
    assert all(short(repr(value)) and max(map(len, repr(value).splitlines())) <= 100 for value in held)
    assert repr(campaign.soil) == (
        "Soil(strength=42000.0, softening_modulus=85000.0, tension_cutoff=0.0, softening_length='cell')"
    )
    assert "index=int32[2," in repr(expansion)
    assert expansion == runs.random_soil(campaign).groups[0].expansion


def test_a_long_sequence_shows_its_ends_so_that_all_fields_are_seen():
    tried = tuple((k / 10, k / 1000) for k in range(100))
    shown = repr(mpm.run.FactorOfSafety(stable=1.0, fails=1.1, tried=tried, kink=1.05))
    assert short(shown)
    assert shown.startswith("FactorOfSafety(stable=1.0, fails=1.1, tried=((0.0, 0.0), (0.1, 0.001), ..., (9.8, 0.098)")
    assert shown.endswith("kink=1.05)")
