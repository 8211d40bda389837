"""Pore pressure in time from other programs: points and rasters, their units, and what does not fit the ground."""

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from jaxmpm import Section, Slope, seepage
from jaxmpm.ground import WATER_WEIGHT, Raster
from jaxmpm.seepage import PressureTable, read_hyetograph, read_levels, read_pressure

SECTION = Section([(0, 10), (8, 10), (24, 2), (30, 2)])
LATTICE = np.stack(np.meshgrid(np.linspace(0, 30, 11), np.linspace(0, 10, 6), indexing="ij"), -1).reshape(-1, 2)


def inside(rng: np.random.Generator, count: int = 40) -> np.ndarray:
    x = rng.uniform(0, 30, count)
    return np.stack([x, rng.uniform(0, 1, count) * SECTION.heights(x)])


@given(
    slopes=hnp.arrays(float, (2, 3), elements=st.floats(-0.3, 0.3)), share=st.floats(0, 1), seed=st.integers(0, 2**16)
)
def test_heads_linear_in_space_and_time_are_exact(slopes, share, seed):
    """Total heads a + b x + c z at two times, at points that differ between the times."""
    rng = np.random.default_rng(seed)
    others = np.vstack([LATTICE, inside(rng).T])

    def total(k, at):
        return 6 + slopes[k, 0] + slopes[k, 1] * at[:, 0] + slopes[k, 2] * at[:, 1]

    table = PressureTable.of_points([0.0, 3600.0], [LATTICE, others], [total(0, LATTICE), total(1, others)])
    at = inside(rng)
    wanted = WATER_WEIGHT * ((1 - share) * total(0, at.T) + share * total(1, at.T) - at[1])
    np.testing.assert_allclose(table.pressure(at, share * 3600.0), wanted, atol=1e-6)


def written(path, quantity, values, time="t [h]", times=(0.0, 2.0)):
    rows = [f"{x},{z},{t},{v}" for t in times for (x, z), v in zip(LATTICE, values, strict=True)]
    path.write_text("\n".join([f"x [m],z [m],{time},{quantity}", *rows]))
    return path


@pytest.mark.parametrize(
    ("quantity", "values"),
    [
        ("pressure [kPa]", 9.81 * (6 - LATTICE[:, 1])),
        ("pwp [Pa]", 9810 * (6 - LATTICE[:, 1])),
        ("pressure head [m]", 6 - LATTICE[:, 1]),
        ("total head [m]", np.full(len(LATTICE), 6.0)),
        ("head [cm]", np.full(len(LATTICE), 600.0)),
    ],
)
def test_files_name_their_quantity_and_unit(tmp_path, quantity, values):
    table = read_pressure(written(tmp_path / "p.csv", quantity, values))
    assert table.times.tolist() == [0.0, 7200.0]
    table.check_ground(SECTION)
    np.testing.assert_allclose(table.pressure([[5.0, 20.0], [1.0, 3.5]], 3600.0), [5 * 9810, 2.5 * 9810], rtol=1e-12)


def test_a_flow_and_its_table_give_the_same_pressure(x64):
    """The seam of both: what a flow gives at the cells' centres, written and read, is what it gives between them."""
    cells = seepage.cells((6.0, 4.0), (6, 8))
    problem = seepage.problem(
        cells, seepage.soil_class("sandy loam"), seepage.open_face(rain=4e-6), seepage.held_head("left", level=2.0)
    )
    flow = seepage.run(problem, seepage.hydrostatic(problem, 1.0), [0.0, 3600.0, 7200.0]).raise_if_failed()
    points = cells.centres().reshape(2, -1).T
    heads = [np.asarray(flow.heads(t).total).ravel() for t in flow.times]
    table = PressureTable.of_points(flow.times.tolist(), [points] * 3, heads)
    for time in (0.0, 1800.0, 7200.0):
        np.testing.assert_allclose(table.pressure(points.T, time), flow.pressure(points.T, time), atol=1e-6)


def test_rasters_are_water_at_rest_below_and_above_the_table():
    low, high = (Raster(np.full((3, 3), z), (0.0, 0.0), 48.0) for z in (4.0, 8.0))
    table = PressureTable.of_rasters({86400.0: high, 0.0: low})
    at = np.array([[10.0, 50.0], [5.0, 5.0], [5.0, 7.0]])
    np.testing.assert_allclose(table.heads(43200.0).at(at), [1.0, -1.0])
    table.check_ground(Slope(crest=20, height=12, toe=48, foundation=4, width=90))


@pytest.mark.parametrize(
    ("points", "head", "words"),
    [
        (LATTICE + np.array([685000, 0]), 6.0, "in the coordinates of the ground"),
        (LATTICE[LATTICE[:, 0] <= 12], 6.0, "in the coordinates of the ground"),
        (LATTICE, -3.0, "are these pressure heads"),
    ],
)
def test_a_table_of_other_ground_is_refused(points, head, words):
    table = PressureTable.of_points([0.0], [points], [np.full(len(points), head)])
    with pytest.raises(ValueError, match=words):
        table.check_ground(SECTION)


def test_a_table_of_a_section_is_none_of_a_solid():
    table = PressureTable.of_points([0.0], [LATTICE], [np.full(len(LATTICE), 6.0)])
    with pytest.raises(ValueError, match="has 2 coordinates and the ground 3"):
        table.check_ground(Slope(crest=20, height=12, toe=48, foundation=4, width=96))


def test_times_beyond_the_table_are_refused():
    table = PressureTable.of_points([60.0, 120.0], [LATTICE] * 2, [np.full(len(LATTICE), 6.0)] * 2)
    with pytest.raises(ValueError, match="goes from 60 to 120 s"):
        table.pressure([[5.0], [1.0]], 30.0)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("x,z,t,pressure [kPa]\n0,0,0,1", "'t' has no unit"),
        ("x,z,t [h],pressure\n0,0,0,1", "'pressure' has no unit"),
        ("x,z,t [h],pressure [m]\n0,0,0,1", "in 'm', which is no unit known here"),
        ("x,z,t [h]\n0,0,0", "has no column of the water"),
        ("x,z,t [h],head,pressure [kPa]\n0,0,0,1,1", "has columns of total_head and pressure"),
        ("x,t [h],head\n0,0,1", "has no column z"),
        ("x,z,t [h],head\n0,0,0,1\n1,0,0,\n0,1,0,1", "line 3: total_head is no number"),
        ("x,z,t [h],head\n0,0,0,1\n1,0,0,-999.0\n0,1,0,1", "line 3: total_head is no number"),
        ("x,z,t [h],head\n0,0,0,1\n0,0,0,2\n0,1,0,1", r"2 heads at \(0, 0\) m and 0 s"),
        ("x,z,t [h],head\n0,0,0,1\n1,1,0,1\n2,2,0,1", "span no area"),
        ("0,0,0,1", "has no row of headings"),
    ],
)
def test_files_that_will_not_do(tmp_path, text, words):
    path = tmp_path / "p.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=words):
        read_pressure(path)


def test_hyetographs_and_levels_have_units(tmp_path):
    rain, levels = tmp_path / "rain.csv", tmp_path / "level.csv"
    rain.write_text("t [h];rain [mm/h]\n0;3,6\n6;36,0\n12;0,0\n")
    levels.write_text("time [d],level [m]\n0,8\n5,2\n")
    times, rates = read_hyetograph(rain)
    assert times == [0, 21600, 43200]
    np.testing.assert_allclose(rates, [1e-6, 1e-5, 0])
    assert read_levels(levels) == ([0, 432000], [8, 2])


def test_dates_of_a_gauge_count_from_its_first_row(tmp_path):
    path = tmp_path / "gauge.csv"
    path.write_text("Date,Rain [mm/h]\n2026-10-31 23:00,3.6\n2026-11-01 00:30,36\n2026-11-02 00:30,0\n")
    times, rates = read_hyetograph(path)
    assert times == [0, 5400, 91800]
    np.testing.assert_allclose(rates, [1e-6, 1e-5, 0])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("t [h],rain\n0,5\n1,0", "no unit: give one of m/s, mm/h"),
        ("t,rain [mm/h]\n0,5\n1,0", "no unit"),
        ("t [h],rain [mm]\n0,5\n1,0", "has depths in mm"),
        ("t [h],rain [mm/h]\n0,5\n2,3\n1,0", "line 4: times do not rise"),
        ("t [h],rain [mm/h]\n0,5\n1,\n", "line 3 has a gap"),
        ("t [h],rain [mm/h]\n0,5\n1,-9999\n2,0", "line 3 has a gap"),
        ("date,rain [mm/h]\n2026-11-01 00:00,5\n2026-10-31 00:00,0", "line 3: times do not rise"),
        ("date,rain [mm/h]\n2026-11-01T00:00Z,5\n2026-11-02 00:00,0", "no unit"),
        ("t [h],wind [m/s]\n0,5\n", "has 0 columns of rain"),
    ],
)
def test_hyetographs_that_will_not_do(tmp_path, text, words):
    path = tmp_path / "rain.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=words):
        read_hyetograph(path)


@pytest.mark.parametrize(
    ("text", "units", "value"),
    [("36 mm/h", seepage.RATES, 1e-5), ("0.864 m/day", seepage.RATES, 1e-5), ("1.5 d", seepage.TIMES, 129600.0)],
)
def test_quantities_in_words(text, units, value):
    assert seepage.quantity("rate", text, units) == pytest.approx(value)
    assert seepage.quantity("rate", value, units) == value


@pytest.mark.parametrize("text", ["mm/h", "5", "5 mm", "5 furlong/h"])
def test_quantities_without_a_unit_of_their_kind_are_refused(text):
    with pytest.raises(ValueError, match=re.escape("mm/h")):
        seepage.quantity("rate", text, seepage.RATES)
