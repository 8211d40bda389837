"""Tables as people save them: the same numbers in any form read alike, or are refused by their reason."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxmpm.support.table import MOST_BYTES, VOIDS, decoded, measured, number, plain_unit, read_table, table_of

NAMES, UNITS = ("x", "depth", "qc"), ("m", "m", "kN/m²")
ROWS = [(0.25, 10.0, -3.125), (16.0, 1.0, 0.001), (24.5, 1234.5, 7.0)]
HEADS = [f"{name} [{unit}]" for name, unit in zip(NAMES, UNITS, strict=True)]


def written(rows, delimiter, decimal, quoted=False, head=HEADS):
    cells = [[f"{value:.4f}".replace(".", decimal) for value in row] for row in rows]
    mark = '"' if quoted else ""
    return "\n".join(delimiter.join(f"{mark}{cell}{mark}" for cell in row) for row in ([head] if head else []) + cells)


FORMS = {
    "commas": written(ROWS, ",", "."),
    "semicolons": written(ROWS, ";", ","),
    "sep": "sep=;\n" + written(ROWS, ";", ","),
    "tabs": written(ROWS, "\t", ","),
    "bars": written(ROWS, "|", "."),
    "blanks": written(ROWS, "   ", "."),
    "blanks and decimal commas": written(ROWS, "  ", ","),
    "quotes": written(ROWS, ",", ",", quoted=True),
    "a blank behind each comma": written(ROWS, ", ", "."),
    "a row of units": f"{','.join(NAMES)}\n{','.join(UNITS)}\n" + written(ROWS, ",", ".", head=None),
    "comments": "# surveyed, with care\n\n% and drawn\n" + written(ROWS, ",", "."),
    "empty columns": written(ROWS, ",", ".").replace("\n", ",,\n") + ",,",
}
ENCODINGS = ("utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "cp1252")


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"], ids=["unix", "windows", "mac"])
@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("form", FORMS)
def test_the_same_numbers_in_any_form_are_the_same_table(form, encoding, end, tmp_path):
    path = tmp_path / "table.csv"
    path.write_bytes(FORMS[form].replace("\n", end).encode(encoding))
    table = read_table(path)
    assert (table.names, table.units) == (NAMES, UNITS)
    assert [tuple(map(number, row)) for row in table.rows] == ROWS
    assert table.lines == tuple(range(table.lines[0], table.lines[0] + 3))
    assert FORMS[form].splitlines()[table.lines[0] - 1].startswith(("0", '"0'))


@given(
    st.lists(st.tuples(*[st.floats(-1e6, 1e6)] * 3), min_size=2, max_size=5),
    st.sampled_from([(",", ".", False), (";", ",", False), ("\t", ",", False), ("\t", ".", False), (" ", ",", False),
                     (" ", ".", False), (",", ",", True), (";", ".", True)]),
    st.booleans(),
)  # fmt: skip
def test_any_numbers_come_back(rows, form, headed):
    table = table_of("any.csv", written(rows, *form, head=HEADS if headed else None))
    assert table.names == (NAMES if headed else ())
    assert [tuple(map(number, row)) for row in table.rows] == [tuple(float(f"{v:.4f}") for v in row) for row in rows]


@pytest.mark.parametrize(
    "mark", [" ", "\u00a0", "\u202f", "'", "’"], ids=["blank", "no-break", "narrow", "apostrophe", "curly"]
)
@pytest.mark.parametrize("decimal", [".", ","])
def test_marks_of_thousands_that_are_no_decimals_are_taken_out(mark, decimal):
    rows = [[f"1{mark}155{mark}000{decimal}5", f"-12{mark}345", "7"], ["999", f"1{mark}000", f"0{decimal}25"]]
    text = "\n".join(";".join(row) for row in [["x", "y", "z"], *rows])
    assert table_of("a.csv", text).rows == (("1155000.5", "-12345", "7"), ("999", "1000", "0.25"))


@pytest.mark.parametrize("cell", ["12 34", "1 2345", "borehole 1 000", "012 345"])
def test_other_blanks_stay(cell):
    assert table_of("a.csv", f"x;y\n{cell};1").rows == ((cell, "1"),)


def test_headings_in_a_comment_are_told():
    table = table_of("numpy.txt", "# z x\n0.0 1.0\n2.0 3.0\n")
    assert (table.header, table.remark, len(table.rows)) == ((), ("z", "x"), 2)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("x,z\n0,0,10,5\n", "line 2 has 4 cells .* semicolons if commas mark decimals"),
        ("Client: A\nx,z\n0,10\n4,10\n", "line 2 has 2 cells .* put # before"),
        ("x;z\n1,234;5.5\n", "may mark decimals or thousands"),
        ("x\tz\n1,234\t5,500\n", "may mark decimals or thousands"),
        ('x,z\n0,"1' + "9" * 200_000, "field larger than field limit"),
    ],
)
def test_what_is_not_clear_is_refused(text, why):
    with pytest.raises(ValueError, match=why):
        table_of("points.csv", text)


@pytest.mark.parametrize(
    ("data", "why"),
    [
        (b"PK\x03\x04\x14\x00", "a workbook of a spreadsheet, no text: save the sheet as CSV"),
        (b"\xd0\xcf\x11\xe0\xa1", "an old workbook of Excel, no text"),
        (b"a\0b\0\0\0\0", "is no text"),
    ],
)
def test_what_is_no_text_is_named(data, why):
    with pytest.raises(ValueError, match=why):
        decoded("points.xlsx", data)


def test_a_large_file_is_not_read(tmp_path):
    path = tmp_path / "sparse.csv"
    with path.open("wb") as file:
        file.truncate(MOST_BYTES + 1)
    with pytest.raises(ValueError, match="bytes, more than"):
        read_table(path)


@pytest.mark.parametrize("text", ["", "1_000", "٣", "nan", "inf", "0x10", "1,5", "1 000", "12 m", "--1", "1e999"])
def test_what_is_no_number_is_nan(text):
    assert math.isnan(number(text))


def test_numbers_and_units_in_their_usual_forms():
    assert [number(text) for text in ("−5.5", " 1.0D+02 ", ".5", "3.", "+4E-1")] == [-5.5, 100.0, 0.5, 3.0, 0.4]
    assert {plain_unit(text) for text in ("m/s²", "M/S^2", "m / s2")} == {"m/s2"}


@given(st.sampled_from(VOIDS), st.sampled_from(["{}", "{:.3f}", " {:e} "]))
def test_codes_for_nothing_measured_are_no_measured_values(code, form):
    text = form.format(code)
    assert number(text) == pytest.approx(code)
    assert np.isnan(measured(text))


@given(st.floats(-998.0, 1e6))
def test_other_numbers_are_measured_values_unless_their_file_declares_them(value):
    assert measured(repr(value)) == value
    assert np.isnan(measured(repr(value), value))
