"""Lines and measured values that a scene names: the same numbers in any form of text are the same scene."""

import numpy as np
import pytest

from cooperative.scene import built, parse
from tests.jaxmpm.support.test_table import written
from tests.scenes import tables

SURFACE = [(0.0, 10.0), (16.5, 10.0), (24.5, 4.125), (40.0, 4.125)]
MEASURED = [(4.5, 8.25, 31.5), (9.5, 2.0, 28.25), (20.5, 5.5, 33.0)]
SCENE = """
[ground]
surface = "ground.csv"
[soil]
unit_weight = 20e3
young = 2e7
poisson = 0.3
[strength]
mean = 30e3
cov = 0.2
length = [20.0, 4.0]
boreholes = "values.csv"
borehole_error = 0.1
""" + tables()
DIGITS = 6
"""Digits behind the point in a file."""
FORMS = {
    "semicolons": (";", ",", False),
    "tabs": ("\t", ",", False),
    "quotes": (",", ",", True),
    "blanks": ("  ", ".", False),
}


def scene(folder, form, encoding="utf-8", scale=1.0, length="m", stress="kPa", order=1):
    """A scene whose files have this form, units and order of columns."""
    factors = (scale, scale, 1e3 if stress == "Pa" else 1.0)
    for name, rows, heads in (
        ("ground.csv", SURFACE, [f"x [{length}]", f"z [{length}]"]),
        ("values.csv", MEASURED, [f"x [{length}]", f"z [{length}]", f"su [{stress}]"]),
    ):
        scaled = [
            [round(each * factor, DIGITS) for each, factor in zip(row, factors, strict=False)][::order] for row in rows
        ]
        (folder / name).write_bytes(written(scaled, *form, head=heads[::order]).encode(encoding))
    (folder / "scene.toml").write_text(SCENE)
    return parse(folder / "scene.toml")


@pytest.mark.parametrize("encoding", ["utf-16", "cp1252"])
@pytest.mark.parametrize("form", FORMS)
def test_a_scene_is_the_same_whatever_form_its_tables_have(form, encoding, tmp_path):
    plain = scene(tmp_path, (",", ".", False))
    assert np.allclose(plain.site.shape.surface, SURFACE)
    assert np.allclose(plain.random["strength"].boreholes, [(x, z, 1e3 * value) for x, z, value in MEASURED])
    for order in (1, -1):
        other = scene(tmp_path, FORMS[form], encoding, order=order)
        assert other.site.shape == plain.site.shape
        assert other.random["strength"] == plain.random["strength"]


@pytest.mark.parametrize(("length", "scale"), [("mm", 1e3), ("cm", 100.0), ("ft", 1 / 0.3048)])
def test_units_of_a_table_are_those_of_its_headings(length, scale, tmp_path):
    other = scene(tmp_path, (",", ".", False), scale=scale, length=length, stress="Pa")
    assert np.allclose(other.site.shape.surface, SURFACE, atol=1e-4)
    plain = scene(tmp_path, (",", ".", False))
    columns = [built(each, "rough", at_rest=False)[0].grid.shape[0] for each in (other, plain)]
    assert columns[0] == columns[1]
    assert np.allclose(other.random["strength"].boreholes, [(x, z, 1e3 * value) for x, z, value in MEASURED], atol=1e-4)


@pytest.mark.parametrize("name", ["ground.csv", "values.csv"])
def test_a_workbook_is_to_be_saved_as_a_table(name, tmp_path):
    scene(tmp_path, (",", ".", False))
    (tmp_path / name).write_bytes(b"PK\x03\x04\x14\x00\x06\x00")
    with pytest.raises(ValueError, match="a workbook of a spreadsheet, no text: save the sheet as CSV"):
        parse(tmp_path / "scene.toml")
