"""What messages and reports show of values and texts that may be long or made to mislead."""

import csv
import io
import math
import sys
import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from cooperative import _commands
from cooperative.__main__ import main
from cooperative.example_scenes import example
from cooperative.scene import parse
from cooperative.store import open_store, read_rows, write_sample
from jaxmpm.support import check
from jaxmpm.support.text import MOST_SHOWN, csv_text, literal, printable, short, shown
from tests.cooperative.campaign.test_campaign import TINY
from tests.cooperative.store.test_store import sample
from tests.databases import by_sql

DEEP = st.recursive(
    st.text() | st.integers() | st.binary(), lambda each: st.lists(each) | st.dictionaries(st.text(), each)
)


@settings(max_examples=30)
@given(DEEP)
def test_a_value_is_shown_in_one_short_line(value):
    assert len(shown(value)) <= MOST_SHOWN
    assert shown(value).isprintable()


@given(st.text())
def test_texts_keep_what_can_be_printed_and_nothing_else(text):
    assert printable(text).isprintable()
    assert [each for each in printable(text) if each != "?"] == [c for c in text if c.isprintable() and c != "?"]
    assert len(short(text, 10)) <= 10


def test_values_too_long_to_be_written_are_named():
    assert shown(16**100_000) == "a int too long to be written"


@pytest.mark.parametrize(
    "refused",
    [
        lambda: check.positive("cell", "x" * 5000),
        lambda: check.whole("steps", "x" * 5000),
        lambda: check.dtype("x" * 5000),
        lambda: check.axes("origin", list(range(5000)), 2),
        lambda: parse(f"[slope]\n{'crest' * 1000} = 1\n"),
        lambda: parse(TINY.replace("crest = 8.0", f"crest = '{'x' * 5000}'")),
        lambda: parse(f"name = '{'x' * 5000}'\n"),
        lambda: parse(TINY.replace("samples = 6", f"samples = 0x{'f' * 50_000}")),
        lambda: example("x" * 5000),
    ],
)
def test_refusals_show_the_beginning_of_what_is_too_long(refused):
    with pytest.raises(ValueError, match=r"give|did you mean|unknown") as raised:
        refused()
    assert len(str(raised.value)) < 600
    assert str(raised.value).isprintable()


def test_a_folder_of_another_scene_is_refused_in_a_short_line(tmp_path):
    open_store(tmp_path, f"name = '{'a' * 5000}'\n").close()
    with pytest.raises(ValueError, match=r"name is 'aaa.* there and 'bbb.* now") as raised:
        open_store(tmp_path, f"name = '{'b' * 5000}'\n")
    assert len(str(raised.value)) < 600


def test_texts_of_a_database_that_a_terminal_would_obey_are_masked(tmp_path, capsys):
    with open_store(tmp_path / "c", TINY) as store:
        write_sample(store, "rough", sample(0))
    by_sql(tmp_path / "c", "update run set grid = ?", "\x1b[2J\n  probability of failure so far  0")
    assert main(["status", str(tmp_path / "c")]) == 0
    printed = capsys.readouterr().out
    assert all(line.isprintable() for line in printed.splitlines())
    assert not any(line.startswith("  probability of failure") for line in printed.splitlines())
    with open_store(tmp_path / "c", TINY) as store, pytest.warns(UserWarning, match="set aside") as warned:
        assert np.size(read_rows(store, "rough").numbers) == 0
    assert str(warned[0].message).isprintable()


def test_errors_are_masked_too(tmp_path, capsys):
    assert main(["status", str(tmp_path / "\x1b[31mred\nerror: all is well")]) == 2
    printed = capsys.readouterr().err
    assert printed.count("\n") == 1
    assert printed.rstrip("\n").isprintable()


def test_a_warning_of_a_command_is_one_line(tmp_path, monkeypatch, capsys):
    def status(given):
        warnings.warn(f"in {given.folder.name} \x1b[31m something is odd", stacklevel=1)
        raise ValueError("it cannot be read")

    monkeypatch.setitem(_commands.COMMANDS, "status", status)
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        warnings.showwarning = lambda message, *_: sys.stderr.write(warnings.formatwarning(message, Warning, "", 0))
        assert main(["status", str(tmp_path)]) == 2
    warned, error = capsys.readouterr().err.splitlines()
    assert warned.startswith(f"warning: in {tmp_path.name} ")
    assert warned.isprintable()
    assert error == "error: it cannot be read"


@given(st.lists(st.text(st.characters(codec="utf-8", exclude_characters="\r\n\0")), min_size=1))
def test_no_cell_of_a_table_is_a_formula_and_every_text_stays(texts):
    cells = next(csv.reader(io.StringIO(csv_text([texts]))), [])
    assert [cell.removeprefix("'") for cell in cells] == [text.removeprefix("'") for text in texts]
    for cell in cells:
        assert not cell.startswith(("=", "@", "\t")) or is_number(cell)
        assert not cell.startswith(("+", "-")) or is_number(cell) or cell == "-"


def is_number(text):
    try:
        return math.isfinite(float(text)) or True
    except ValueError:
        return False


def test_numbers_of_a_table_stay_numbers():
    assert csv_text([["-1.5", -2.0, "+3", "-1e-3", "=1", "-x", "-"]]) == "-1.5,-2.0,+3,-1e-3,'=1,'-x,-\n"


@given(st.text(st.sampled_from("$ab\\{}_^ %"), max_size=12))
def test_a_literal_text_is_drawn_without_formulas(text):
    whole = literal(text)
    Figure().text(0, 0, whole).get_window_extent(FigureCanvasAgg(Figure()).get_renderer())
    assert whole.count(r"\$") == text.count("$")


@given(st.floats(1e-3, 1e4), st.floats(1e-3, 1e4))
def test_the_divisor_that_a_message_asks_for_is_accepted(length, unit):
    try:
        check.multiple("length", length, "unit", unit)
    except ValueError as error:
        remedy = str(error).split("e.g. ")[1].removesuffix(" m")
        assert check.multiple("length", length, "unit", float(remedy)) >= 1


@given(st.floats(1e-3, 1e3), st.integers(1, 10_000))
def test_a_multiple_in_single_precision_is_whole(unit, count):
    assert check.multiple("length", float(np.float32(count * unit)), "unit", unit) == count


def test_a_message_shows_the_digits_by_which_a_multiple_is_none():
    with pytest.raises(ValueError, match=r"length = 40\.00001 m is no whole multiple of cell = 2 m"):
        check.multiple("length", 40.00001, "cell", 2.0)


def test_the_divisor_has_few_digits_where_some_will_do():
    with pytest.raises(ValueError, match=r"to a divisor, e\.g\. 0\.375 m$"):
        check.multiple("cell", 0.75, "spacing", 0.373832)
    with pytest.raises(ValueError, match=r"to a divisor, e\.g\. 0\.5 m$"):
        check.multiple("edge", 4.0, "cell", 0.53)
