"""Run-outs, profiles and their changes over cells, of made-up slides whose answers are known."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.accuracy import runout_convergence
from benchmarks.accuracy.runout_convergence import CASES, Case, compared, with_profiles
from benchmarks.accuracy.runout_slides import measures, thick_front


def test_run_out_and_travel_of_a_rigid_block():
    x, z = np.meshgrid(np.arange(0.25, 10, 0.5), np.arange(0.25, 4, 0.5), indexing="ij")
    position, volume = np.stack([x.ravel(), z.ravel()]), np.full(x.size, 0.25)
    displacement = np.zeros_like(position)
    displacement[0, position[0] > 5] = 6.0
    row = measures(position, displacement, volume, origin=10.0, half=0.25, slid=1.0)
    assert [row["front_m"], row["travel_m"]] == pytest.approx([6.0, 6.0])
    assert row["front_95_m"] == pytest.approx(6.0)  # the front half metre holds a tenth of what slid
    assert row["slid"] == pytest.approx(20.0)
    assert np.sum(row["thickness"]) * 2.0 == pytest.approx(40.0)
    with pytest.raises(ValueError, match="largest displacement is 6 m, below 7 m"):
        measures(position, displacement, volume, origin=10.0, half=0.25, slid=7.0)


def test_a_film_ahead_of_a_block_counts_for_its_foremost_soil_alone():
    """The block is 4 m high, the film that hangs together with it 0.25 m thick and 3 m long."""
    x, z = np.meshgrid(np.arange(0.125, 10, 0.25), np.arange(0.125, 4, 0.25), indexing="ij")
    position = np.concatenate([[x.ravel(), z.ravel()], [np.arange(10.125, 13, 0.25), np.full(12, 0.125)]], axis=1)
    displacement = np.zeros_like(position)
    displacement[0, position[0] > 5] = 6.0
    row = measures(position, displacement, np.full(position.shape[1], 0.0625), origin=10.0, half=0.125, slid=1.0)
    assert row["front_m"] == pytest.approx(6.0, abs=0.25)
    assert row["foremost_m"] == pytest.approx(9.0)


@pytest.mark.parametrize("station", [0.1, 0.25])
def test_the_front_of_a_wedge_is_where_it_is_as_thick_as_asked(station):
    """The film and the grain ahead of it do not count."""
    x = np.arange(0.0025, 4.0, 0.005)
    film = 0.02 * (x > 2)
    wedge = 0.005 * (np.maximum(1 - x / 2, 0) + film)
    assert thick_front(np.append(x, 9.0), np.append(wedge, 1e-3), 0.1, station) == pytest.approx(1.8, abs=0.02)


def test_changes_are_over_the_finest_run_out_and_the_default_is_held_against_it():
    rows = [
        {"cell_m": c, "front_m": f, "front_95_m": f / 2} for c, f in ((4.0, 1.0), (2.0, 8.0), (1.0, 9.0), (0.5, 10.0))
    ]
    result = compared(rows, Case((4, 2, 1, 0.5), 2.0, dict))
    assert result["last_two_halvings"] == pytest.approx(0.1)
    assert result["default_error"] == pytest.approx(0.2)


def test_a_slope_that_stands_has_no_change():
    rows = [{"cell_m": c, "front_m": f, "front_95_m": f} for c, f in ((4.0, 1.0), (2.0, 0.0), (1.0, 0.0))]
    assert compared(rows, Case((4, 2, 1), 2.0, dict)) == {}


def test_a_profile_is_the_share_of_the_slide_that_lies_elsewhere():
    rows = [{"thickness": [2.0, 0.0], "slid": 4.0}, {"thickness": [1.0, 1.0, 0.0], "slid": 4.0}]
    assert [row["profile"] for row in with_profiles(rows)] == [0.5, 0.0]


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_cells_of_a_case_are_halved_and_hold_the_default(case):
    assert all(coarse == 2 * fine for coarse, fine in zip(case.cells, case.cells[1:], strict=False))
    assert case.default in case.cells


def test_a_command_that_was_stopped_counts_the_cells_that_have_a_row(tmp_path, monkeypatch, capsys):
    def made(cell):
        if cell == 0.5 and interrupted:
            raise KeyboardInterrupt
        return {"front_m": 10.0 - cell, "front_95_m": 5.0}

    cases = {"a": Case((2, 1, 0.5), 1, made), "b": Case((4, 2, 1, 0.5), 2, made), "c": Case((2, 1, 0.5), 1, made)}
    monkeypatch.setattr(runout_convergence, "CASES", cases)
    monkeypatch.setattr(runout_convergence, "ROOT", tmp_path)
    interrupted = False
    runout_convergence.rows_of("b", cases["b"], stopped=False)
    interrupted = True
    report = runout_convergence.run(quick=False)
    assert "stopped in a 0.5" in capsys.readouterr().err
    assert [(row["case"], row["cell_m"]) for row in report.rows] == [
        *(("a", cell) for cell in (2, 1)),
        *(("b", cell) for cell in (4, 2, 1, 0.5)),
    ]
    assert report.values["rows_missing"] == 4
    runout_convergence.draw([row | {"seconds": 1.0} for row in report.rows], tmp_path)
    assert (tmp_path / "runout_convergence.png").exists()
    assert "a_default_error" not in report.values
    assert report.values["default_cell_error_max"] == report.values["b_default_error"] == pytest.approx(0.1579)
