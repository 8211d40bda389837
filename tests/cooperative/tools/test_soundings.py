"""Soundings and laboratory values in CSV files as people write them."""

import numpy as np
import pytest

from cooperative.tools.site import Assumed, estimate_site
from cooperative.tools.soundings import read_files


def _csv(path, text):
    path.write_text(text)
    return path


def test_decimal_commas_are_read_and_other_text_is_counted(tmp_path):
    rows = (
        "# a comment, with, many, commas\nx [m];top [m];depth [m];qc [kPa]\n3;2;0,5;500,5\n3;2;1;6e2\n3;2;1,5;7,5e2\n"
    )
    (sounding,), _ = read_files([_csv(tmp_path / "a.csv", rows)])
    np.testing.assert_allclose(sounding.depth, [0.5, 1.0, 1.5])
    np.testing.assert_allclose(sounding.cone, [500.5e3, 600e3, 750e3])
    with pytest.warns(UserWarning, match=r"b.csv: cone: 2 cells are no number and count as gaps"):
        read_files([_csv(tmp_path / "b.csv", f"{rows}3;2;2;1.200,5\n3;2;2,5;n/a\n")])


def test_files_without_a_value_or_with_and_without_y_are_named(tmp_path):
    sounding = "x [m];top [m];depth [m];qc [MPa]\n3;2;1;0.5\n3;2;2;0.6\n"
    one = _csv(tmp_path / "a.csv", sounding)
    other = _csv(tmp_path / "b.csv", sounding.replace("x [m]", "y [m];x [m]").replace("\n3;", "\n1;3;"))
    with pytest.raises(ValueError, match=r"a.csv has no y, which other files have: add the column y \[m\]"):
        estimate_site([one, other], Assumed(n_kt=(14.0, 2.0)))
    with (
        pytest.warns(UserWarning, match="2 values of strength are left out"),
        pytest.raises(ValueError, match=r"no value is left of .*lab.csv"),
    ):
        estimate_site([_csv(tmp_path / "lab.csv", "x [m],z [m],su [kPa]\n1,2,-5\n1,3,-6\n")], Assumed())
