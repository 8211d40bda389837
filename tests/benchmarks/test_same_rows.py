"""The comparison of two campaigns sees every change but that of a time."""

import pytest

from benchmarks.project.same_rows import main

ROWS = "grid,sample,status,seconds,displacement\nrough,0,FINISHED,1.0,2.0\nrough,1,SETTLED,2.0,\n"


@pytest.mark.parametrize(
    ("old", "new", "code"),
    [
        ("1.0,2.0", "9.0,2.0", 0),  # a time
        ("1.0,2.0", "1.0,2.0000001", 0),
        ("1.0,2.0", "1.0,2.001", 1),
        ("SETTLED", "FINISHED", 1),
        ("2.0,\n", "2.0,0.5\n", 1),
        ("rough,1,SETTLED,2.0,\n", "", 1),
        ("rough,1", "refined,1", 1),
        ("displacement", "depth", 1),
    ],
)
def test_what_differs_is_seen(old, new, code, tmp_path, capsys):
    one, other = tmp_path / "one.csv", tmp_path / "other.csv"
    one.write_text(ROWS)
    assert old in ROWS
    other.write_text(ROWS.replace(old, new))
    assert main([str(one), str(other)]) == code
    assert "rows" in capsys.readouterr().out


def test_a_path_that_does_not_exist_is_named(tmp_path, capsys):
    with pytest.raises(SystemExit) as ended:
        main([str(tmp_path / "none"), str(tmp_path)])
    assert ended.value.code == 2
    assert f"{tmp_path / 'none'} does not exist" in capsys.readouterr().err
