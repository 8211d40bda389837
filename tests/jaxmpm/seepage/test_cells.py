"""Cells under grounds, their faces, heads at points, and what is refused."""

import subprocess
import sys
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

from jaxmpm import Section, seepage
from jaxmpm.seepage._step import Flowing
from tests import ROOT

pytestmark = pytest.mark.usefixtures("x64")

SECTION = Section([(0, 10), (8, 10), (24, 2), (30, 2)])


def tiny(*conditions, active=None, corner=(0.0, 0.0), soil="loam"):
    cells = seepage.cells((4.0, 3.0), (4, 3), corner, active)
    return seepage.problem(cells, seepage.soil_class(soil), *conditions)


def test_nothing_imports_the_room_by_itself():
    script = "import jaxmpm, cooperative, sys; print([m for m in sys.modules if m.startswith('jaxmpm.seepage')])"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, cwd=ROOT)
    assert done.stdout.strip() == "[]"


def test_cells_under_a_section_fill_it():
    cells = seepage.cells_under(SECTION, (0.7, 0.3))
    area = np.count_nonzero(cells.soil) * cells.volume
    assert area == pytest.approx(8 * 10 + 16 * 6 + 6 * 2, rel=0.02)
    x, z = cells.centres()
    assert np.all(z[cells.soil] < SECTION.heights(x[cells.soil]))


@pytest.mark.parametrize("spacing", [(1.0, 0.5), (0.7, 0.9)])
def test_rain_falls_on_the_whole_width_once(spacing):
    cells = seepage.cells_under(SECTION, spacing)
    faces = cells.faces("surface")
    assert np.sum(faces.area * faces.upward) == pytest.approx(30.0)
    # Upright steps add up to the fall of the surface.
    assert np.sum(faces.area * faces.level) == pytest.approx(8.0, abs=2 * spacing[1])


def test_sides_part_the_outer_faces():
    """Each face of soil to its outside belongs to one side, or lies on rigid ground within the box."""
    active = np.ones((4, 3), bool)
    active[2:, 2] = False  # air
    active[0, 0] = False  # rock
    cells = seepage.cells((4.0, 3.0), (4, 3), active=active)
    counts = {side: cells.faces(side).cell.size for side in ("surface", "base", "left", "right")}
    assert counts == {"surface": 4 + 1, "base": 4, "left": 2, "right": 2}
    np.testing.assert_array_equal(cells.positions("right"), [[4, 4], [0.5, 1.5]])


def test_heads_at_points_are_exact_at_rest_whatever_the_ground():
    cells = seepage.cells_under(SECTION, (1.0, 0.5))
    problem = seepage.problem(cells, seepage.soil_class("loam"))
    heads = seepage.Heads.of(problem, seepage.hydrostatic(problem, 5.0))
    at = np.random.default_rng(1).uniform((0, 0), (30, 10), (50, 2)).T
    np.testing.assert_allclose(heads.at(at), 5.0 - at[1], atol=1e-12)
    force = np.asarray(heads.push(jnp.asarray(at), 9810.0))
    np.testing.assert_allclose(force, np.stack([0 * at[0], 9810.0 * (at[1] < 5)]), atol=1e-6)
    np.testing.assert_allclose(heads.free_surface(), 5.0)


def test_pressure_is_linear_in_time():
    problem = tiny(seepage.open_face("left", level=2.0))
    flow = seepage.run(problem, seepage.hydrostatic(problem, 2.0), [0.0, 10.0, 20.0]).raise_if_failed()
    at = [[1.3, 2.0], [0.4, 2.9]]
    np.testing.assert_allclose(flow.pressure(at, 5.0), 9810 * (2.0 - np.array(at[1])), atol=1e-3)
    with pytest.raises(ValueError, match=r"time = 21: give a value from 0 to 20"):
        flow.pressure(at, 21.0)


def test_solid_has_six_sides():
    cells = seepage.cells((1.0, 2.0, 3.0), (2, 2, 3))
    areas = {side: cells.faces(side).area.sum() for side in ("surface", "left", "front", "base", "right", "back")}
    assert list(areas.values()) == pytest.approx([2, 6, 3] * 2)


def test_failure_names_place_time_and_remedy():
    problem = tiny(corner=(100.0, 50.0))
    lane = {"stopped": np.array(7.0), "worst": np.array(11), "steps": np.array(3), "problem": problem}
    fail = seepage.Flow.raise_if_failed
    stuck = SimpleNamespace(status=np.array(seepage.FlowStatus.NO_CONVERGENCE), **lane)
    with pytest.raises(ValueError, match=r"did not converge after 7 s, worst at \(103.5, 52.5\) m: give the soil"):
        fail(stuck)
    long = SimpleNamespace(status=np.array(seepage.FlowStatus.OUT_OF_STEPS), **lane)
    with pytest.raises(ValueError, match="raise max_steps or the tolerance"):
        fail(long)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: seepage.open_face(rain=20.0), "rain = 20 m/s .*divide mm/h by 3.6e6"),
        (lambda: seepage.open_face(rain=([0.0, 0.0], [1e-6, 0.0])), "do not rise"),
        (lambda: seepage.open_face(rain=([0.0], [1e-6, 0.0])), "give times .* and as many values"),
        (lambda: tiny(seepage.open_face(ponding=-1.0)), "ponding = -1 m"),
        (lambda: tiny(seepage.open_face(), seepage.open_face()), "two conditions at surface"),
        (lambda: tiny(seepage.open_face("front")), "side = 'front' of cells in 2D"),
        (lambda: seepage.held_head("left"), "give one of level and pressure_head"),
        (lambda: seepage.free_drainage("left"), "through the base alone"),
        (lambda: tiny(seepage.drain([(9.0, 1.0)], radius=0.01)), r"drain at \(9, 1\) m lies in no soil"),
        (lambda: tiny(seepage.drain([(1.0, 1.0)], radius=0.5)), "give larger cells"),
        (lambda: seepage.cells((1.0, 1.0), (0, 2)), "count = 0"),
        (lambda: seepage.cells((1.0,), (2,), active=np.zeros(2, bool)), "no cell is active"),
        (lambda: seepage.run(tiny(), -1.0, [3.0, 2.0]), "give rising times"),
        (lambda: seepage.run(tiny(), np.zeros(3), [3.0]), "initial has shape"),
        (lambda: seepage.run(tiny(), np.nan, [3.0]), "initial = nan m"),
        (lambda: seepage.run(tiny(soil="sand"), -1e300, [3.0]), "leaves soil without water"),
    ],
)
def test_bad_input_is_refused(make, words):
    with pytest.raises(ValueError, match=words):
        make()


def test_faces_of_one_cell_are_added_one_after_the_other():
    """In a turn no cell comes twice, so that what is added does not depend on an order; all faces have a turn."""
    problem = seepage.problem(
        seepage.cells_under(SECTION, (1.0, 1.5)), seepage.soil_class("loam"), seepage.open_face(rain=1e-7)
    )
    [condition] = problem.conditions
    places = condition.places
    cell, turn = np.asarray(places.cell), np.asarray(places.turn)
    assert places.turns == 2
    for number in range(places.turns):
        assert np.unique(cell[turn == number]).size == np.count_nonzero(turn == number) > 0
    part = np.random.default_rng(3).normal(size=cell.size)
    expected = np.zeros(problem.volume.size)
    np.add.at(expected, cell, part)
    np.testing.assert_array_equal(Flowing(problem).into([jnp.asarray(part)]).ravel(), expected)
