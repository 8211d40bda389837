"""Rows of CSV files: what is read, and what is named where it does not parse."""

import pytest

from benchmarks.csv_rows import appending, number, optional, read_rows, size, text, whole, word

COLUMNS = {"case": text, "grid": word("rough", "refined"), "steps": whole, "runout": optional(size), "energy": number}
ROWS = [("a, b", "rough", 7, "", -1.5), ("a, b", "refined", 0, 2.0, 0.0)]


@pytest.fixture
def table(tmp_path):
    path = tmp_path / "rows.csv"
    for row in ROWS:
        with appending(path, COLUMNS) as put:
            put(row)
    return path


def test_rows_are_read_as_they_were_appended(table):
    rows = read_rows(table, COLUMNS, ("case", "grid"))
    assert list(rows) == [("a, b", "rough"), ("a, b", "refined")]
    assert [tuple(row.values()) for row in rows.values()] == [("a, b", "rough", 7, None, -1.5), ROWS[1]]
    assert read_rows(table.with_name("none.csv"), COLUMNS, ("case",)) == {}
    table.write_text("# of these\n" + table.read_text())
    assert read_rows(table, COLUMNS, ("case", "grid"), comments=1) == rows


@pytest.mark.parametrize(
    ("was", "becomes", "message"),
    [
        ('"a, b",refined', ",refined", "case = '': give a text"),
        ("refined", "fine", "grid = 'fine': give one of rough, refined"),
        (",0,2.0", ",-1,2.0", "steps = '-1': give a whole number of 0 or more"),
        ("2.0", "-2.0", "runout = '-2.0': give 0 or more"),
        ("0.0", "nan", "energy = 'nan': give a finite number"),
        ("0.0", "x", "energy = 'x': could not convert"),
        ("2.0,", "", "4 cells instead of 5"),
        ("refined", "rough", "its run stands there twice"),
    ],
)
def test_a_row_that_does_not_parse_is_named_with_its_line(table, was, becomes, message):
    table.write_text(table.read_text().replace(was, becomes))
    with pytest.raises(ValueError, match=rf"rows\.csv, line 3: {message}.*delete"):
        read_rows(table, COLUMNS, ("case", "grid"))


def test_other_columns_are_refused(table):
    with pytest.raises(ValueError, match=r"rows\.csv: columns case,grid,steps.*: they are case,steps, put back"):
        read_rows(table, {"case": text, "steps": whole}, ("case",))
