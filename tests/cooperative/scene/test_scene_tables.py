"""How tables are read: all that is wrong in them at once, and nothing taken for what it is not."""

import subprocess
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

import jaxmpm as mpm
from benchmarks.robustness.invented import LAYERED
from cooperative.scene import TABLES, parse
from cooperative.scene.tables import Part, keys, read, table
from cooperative.scene.tables._key import AboveZero, key
from tests.cooperative.campaign.test_campaign import TINY, changed


def refusal(text):
    with pytest.raises(ValueError, match=r"give|add|knows") as refused:
        parse(text)
    return str(refused.value)


def test_wrong_values_of_all_tables_are_named_at_once():
    text = LAYERED.replace("young = 2e7", "young = 0").replace("cell = 1.0", "cell = nan")
    text = text.replace("cov = 0.1", 'cov = "0.1"').replace("samples = 6", "samples = true\nslides = -1")
    assert refusal(text).split("; ") == [
        "[layer 'fill'.strength] cov = '0.1' is text: give a number",
        "[soil] young = 0 Pa: give a finite value above 0",
        "[refined] cell = nan: give finite values, in single precision (1e-30 to 1e30)",
        "[campaign] samples = True is true or false: give a whole number",
        "[campaign] slides = -1: give a whole number of 0 or more, or 'all'",
    ]


def test_a_layer_without_a_name_has_a_number():
    assert refusal(LAYERED.replace('name = "clay"', "depth = -1.0")) == (
        "[layer 2] depth = -1 m: give a finite value above 0"
    )


def test_more_than_eight_faults_are_counted():
    message = refusal(TINY.replace("[slope]", "[slope]\n" + "\n".join(f"key_{n} = 1" for n in range(11))))
    assert message.count("unknown key") == 8
    assert message.endswith("; and 3 more")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("[run]", "[run]\nsettle = 1"), "[run] settle = 1 is a whole number: give true or false"),
        (("height = 8.0", "height = true"), "[slope] height = True is true or false: give a number"),
        (("spacing = [1.0, 1.0]", "spacing = 1.0"), "[rough] spacing = 1.0 is a number: give a list of numbers, one"),
        (("young = 2e7", "young = {}"), "[soil.young] lacks mean, cov, length: add it"),
        (("[soil]", "[soil]\ndilation = 70.0"), "[soil] dilation = 70 degrees: give a value from -15 to 60"),
        (("[slope]", "slope = 3\n[slop]"), "the scene has an unknown key 'slop' (did you mean 'slope'?)"),
        (("[run]", "[hazard]\nevery = 0\n[run]"), "[hazard] every = 0: give a whole number of 1 or more"),
    ],
)
def test_nothing_is_taken_for_another(change, message):
    with pytest.raises(ValueError, match=r"give|add|mean") as refused:
        parse(changed(*change))
    assert message in str(refused.value)


@table
class _Invented(Part):
    length: AboveZero = key("A length.", 1.0)


@given(st.one_of(st.text(), st.booleans(), st.none(), st.lists(st.floats()), st.dictionaries(st.text(), st.integers())))
def test_only_numbers_are_numbers(value):
    with pytest.raises(ValueError, match="give a number"):
        _Invented(length=value)
    with pytest.raises(ValueError, match=r"^\[invented\] length = .*: give a number$"):
        read(_Invented, {"length": value}, "invented")


@given(st.one_of(st.integers(), st.floats()))
def test_numbers_of_single_precision_above_zero_are_read_and_no_others(value):
    good = 1e-30 <= value <= 1e30 and abs(value) < 2**63 if isinstance(value, int) else 1e-30 <= value <= 1e30
    if good:
        assert read(_Invented, {"length": value}, "invented").length == float(value)
    else:
        with pytest.raises(ValueError, match=r"^\[invented\] length "):
            read(_Invented, {"length": value}, "invented")


def test_every_key_has_a_meaning_and_an_example():
    for declared in TABLES.values():
        for field in keys(declared).values():
            assert field.description
            assert field.examples


def test_packages_are_imported_without_the_tables():
    loaded = "import sys, jaxmpm, kl, cooperative; print([m for m in sys.modules if m.split('.')[0] == 'pydantic'])"
    done = subprocess.run([sys.executable, "-c", loaded], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"


def test_clay_that_softens_keeps_the_residual_strength_of_the_solvers_own_clay():
    text = TINY.replace("residual_ratio = 0.5\n", "")
    assert text != TINY
    soil = parse(text).soil
    assert (soil.softening_modulus, soil.residual_ratio) == (85e3, mpm.Soil.residual_ratio)
