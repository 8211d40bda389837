"""Values at points from a CSV of the laboratory or a borehole: read in SI units, or refused by their reason."""

from contextlib import nullcontext

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cooperative.laboratory import PARAMETERS, POSITION, UNITS, read_columns, read_rows

HUNDREDTHS = st.integers(-(10**5), 10**5).map(lambda number: number / 100)


@given(data=st.data())
def test_rows_are_in_si_units_whatever_their_columns_are_called(data, tmp_path_factory):
    """Any name and unit of a parameter, in the plane and in space, by elevation or by depth below the surface."""
    parameter = data.draw(st.sampled_from([*PARAMETERS]))
    quantity, names = PARAMETERS[parameter]
    unit, size = data.draw(st.sampled_from([*UNITS[quantity].items()]))
    columns = data.draw(st.sampled_from([["x"], ["x", "y"]]))
    below = data.draw(st.booleans())
    rows = data.draw(st.lists(st.tuples(*[HUNDREDTHS] * 4, st.integers(1, 50)), min_size=1, max_size=5))
    heights = ["top", "depth"] if below else ["z"]
    head = [f"{data.draw(st.sampled_from(POSITION[name][1]))} [m]" for name in [*columns, *heights]]
    lines = ["; ".join([*head, f"{data.draw(st.sampled_from(names))} [{unit}]"])]
    # 999 and its kind stand for gaps.
    rows = [tuple(max(number, -900.0) for number in row) for row in rows]
    expected = []
    for x, y, top, depth, value in rows:
        at = [x, y][: len(columns)]
        lines.append("; ".join(map(str, [*at, *([top, depth] if below else [top]), value])))
        expected.append([*at, top - depth if below else top, value * size])
    path = tmp_path_factory.mktemp("laboratory") / "values.csv"
    path.write_text("\n".join(lines), encoding="utf-8")
    assert read_rows(path) == [pytest.approx(row) for row in expected]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x [m],z [m]\n1,2\n", r"has no column of a parameter: name one of strength \(strength or su or s_u\)"),
        ("x [m],top [m],depth [m],qc [MPa]\n1,2,1,3\n", "has no column of a parameter"),
        ("x [m],z [m],su [kPa],phi [deg]\n1,2,30,30\n", "has 2 columns of parameters: a field has values of one"),
        ("x [m],su [kPa]\n1,30\n", r"no column z \[m\]"),
        ("z [m],su [kPa]\n1,30\n", r"no column x \[m\]"),
        ("x [m],z [m],su [kPa]\n1,2,-999\n", "every row is a gap"),
        ("x [m],z [m],su\n1,2,30\n", r"the column 'su' has no unit: write su \[pa\]"),
        ("x [m],z [m],su [kPa]\n", "has no rows below its header"),
    ],
)
def test_a_table_without_values_at_points_is_refused_by_its_reason(text, message, tmp_path):
    (tmp_path / "values.csv").write_text(text)
    cone = pytest.warns(UserWarning, match="unknown columns are not read: 'qc") if "qc [MPa]" in text else nullcontext()
    with cone, pytest.raises(ValueError, match=message) as error:
        read_rows(tmp_path / "values.csv")
    assert "values.csv" in str(error.value)


def test_a_cone_beside_the_values_is_named_and_not_read(tmp_path):
    (tmp_path / "values.csv").write_text("x [m],top [m],depth [m],qc [MPa],su [kPa]\n1,10,4,0.5,30\n")
    with pytest.warns(UserWarning, match=r"unknown columns are not read: 'qc \[MPa\]'"):
        assert read_rows(tmp_path / "values.csv") == [[1.0, 6.0, 30e3]]


def test_all_columns_without_a_unit_are_named_and_no_option_that_a_scene_has_not(tmp_path):
    path = tmp_path / "values.csv"
    path.write_text("x,z,su\n1,2,30\n")
    with pytest.raises(ValueError, match=r"'x' has no unit.*'z' has no unit.*'su' has no unit") as refused:
        read_rows(path)
    assert "--units" not in str(refused.value)
    with pytest.raises(ValueError, match=r"'z' has no unit: write z \[m\] in the header, or give --units z=UNIT"):
        read_columns(path, POSITION | PARAMETERS, {"x": "m", "su": "kPa"})
