"""Flow against exact answers, its balance, its boundaries, its lanes and its derivatives."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from benchmarks.accuracy import seepage as cases
from benchmarks.accuracy import seepage_exact as exact
from jaxmpm import seepage

pytestmark = pytest.mark.usefixtures("x64")

LAYERS = exact.Layered(10.0, [1.0], [cases.CM_PER_HOUR], [0.34])
RATES = 0.1 * cases.CM_PER_HOUR, 0.9 * cases.CM_PER_HOUR


def loam_column(*conditions, cells=30, **values):
    return seepage.problem(seepage.cells((3.0,), (cells,)), seepage.soil_class("loam", **values), *conditions)


def done(problem, initial, times, **options):
    return seepage.run(problem, initial, times, **options).raise_if_failed()


def test_two_derivations_of_rain_on_a_layer_agree():
    z = np.linspace(0.02, 1.0, 9)
    for t in (3600.0, 36000.0):
        printed = exact.one_layer(LAYERS, *RATES, z, t)
        np.testing.assert_allclose(LAYERS.heads(*RATES, z, t), printed, atol=1e-10)


def test_two_derivations_of_drains_agree():
    deep = 2 * np.pi * 1e-5 / np.log(np.sinh(0.2 * np.pi) * 10 / np.pi / 0.05)
    assert exact.kirkham(1e-5, 1.0, 400.0, 10.0, 0.05) == pytest.approx(deep, rel=1e-9)


def test_sorptivity_of_constant_diffusivity_is_that_of_heat():
    class Linear(exact.Curves):
        def k(self, head):
            return 1e-6 * np.exp(3 * head)

        def capacity(self, head):
            return 0.9 * np.exp(3 * head)

    soil = Linear(1e-6, 3.0, 2.0, 0.4, 0.1)
    heat = 2 * 0.3 * (1 - np.exp(-6.0)) * np.sqrt(1e-6 / 0.9 / np.pi)
    assert exact.sorptivity(soil, 0.0, -2.0) == pytest.approx(heat, rel=1e-5)


def test_rain_on_gardners_soil():
    """Srivastava and Yeh (1991): heads within 2 per cent of the largest suction in 100 cells."""
    column, problem = cases.rain_on(LAYERS, 100)
    initial, converged = seepage.steady(problem(RATES[0]), -0.3)
    assert converged
    z, times = column.centres()[0], [3600.0, 36000.0]
    np.testing.assert_allclose(initial, np.log(LAYERS.steady(RATES[0], z)) / 10 - z, atol=2e-4)
    flow = done(problem(RATES[1]), initial, times, tolerance=5e-4)
    right = np.stack([LAYERS.heads(*RATES, z, t) for t in times])
    assert np.abs(np.asarray(flow.head) - right).max() < 0.02 * np.abs(right).max()
    assert cases.lost(flow) < 1e-9


def test_front_into_dry_soil():
    """Celia et al. (1990): 40 cells find the front within 10 per cent of its depth, and lose no water."""
    (row,) = cases.celia_rows(quick=True)
    assert row["error"] < 0.1
    assert row["water_lost"] < 1e-6


def test_water_at_rest_stays_at_rest():
    column = loam_column(seepage.held_head("base", level=1.0))
    flow = done(column, seepage.hydrostatic(column, 1.0), [1e6])
    z = column.cells.centres()[-1]
    np.testing.assert_allclose(flow.head[-1], 1.0 - z, atol=1e-9)
    assert int(flow.steps) < 30


@pytest.mark.parametrize("times", [1.0, 10.0])
def test_surface_takes_rain_up_to_what_it_conducts_and_sheds_the_rest(times):
    """Ponded long enough, soil takes in its conductivity; before, it takes in all rain below it."""
    loam = seepage.soil_class("loam")
    rate = times * float(loam.conductivity) / 2
    column = loam_column(seepage.open_face(rain=rate), seepage.free_drainage())
    flow = done(column, -1.0, [20 * cases.DAY], tolerance=0.05)
    fallen = float(flow.record.rain.sum())
    assert fallen == pytest.approx(rate * 20 * cases.DAY)
    at_end = float(seepage.infiltration(column, flow.head[-1])[0].sum())
    assert at_end == pytest.approx(min(rate, float(loam.conductivity)), rel=1e-3)
    shed = float(flow.runoff)
    assert shed == pytest.approx(fallen - float(flow.record.inflow.sum()))
    assert (shed > 0.5 * fallen) if times > 2 else (shed < 1e-6 * fallen)
    assert cases.lost(flow) < 1e-6


def test_evaporation_dries_up_at_the_driest_head():
    column = loam_column(seepage.open_face(rain=-1e-7, driest=-20.0))
    flow = done(column, -1.0, [3 * cases.DAY, 300 * cases.DAY], tolerance=0.05)
    assert float(flow.record.rain.sum()) == 0
    rates = np.asarray(flow.record.outflow)[: int(flow.steps)] / flow.durations
    assert rates[0] == pytest.approx(1e-7)
    assert rates[-1] < 0.2e-7
    assert float(flow.head.min()) > -20.0


def test_rain_table_is_taken_to_the_drop():
    """The steps meet the times of the table, so that what falls is exact."""
    table = ([0.0, 3600.0, 5000.0], [1e-6, 0.0, 2e-6])
    column = loam_column(seepage.open_face(rain=table))
    flow = done(column, -2.0, [4000.0, 9000.0], tolerance=0.05)
    assert float(flow.record.inflow.sum()) == pytest.approx(3600e-6 + 8000e-6, rel=1e-6)
    assert np.any(np.isclose(np.cumsum(flow.durations), 5000.0, rtol=1e-12))


def test_more_rain_leaves_no_head_lower():
    """Of two storms the one with the higher rate, or that lasts longer, has the higher heads everywhere after it."""
    column = seepage.cells((3.0,), (30,))

    def heads(rate, hours):
        rain = seepage.open_face(rain=([0.0, 3600.0 * hours], [rate, 0.0]))
        problem = seepage.problem(column, seepage.soil_class("loam"), rain, seepage.held_head("base", level=0.5))
        return np.asarray(done(problem, seepage.hydrostatic(problem, 0.5), [2 * cases.DAY], tolerance=0.002).head[-1])

    by_storm = np.array([[heads(rate, hours) for hours in (6.0, 12.0, 24.0)] for rate in (1e-6, 3e-6, 1e-5)])
    # Steps are those of each flow, which leaves some mm.
    assert np.diff(by_storm, axis=0).min() > -0.005
    assert np.diff(by_storm, axis=1).min() > -0.005
    assert np.ptp(by_storm, axis=(0, 1)).max() > 0.5


def test_drawdown_leaves_a_seepage_face():
    """A level that falls from 9 to 2 m: soil drains through the face above it, and head there is that of air."""
    dam = seepage.cells((6.0, 10.0), (6, 10))
    soil = seepage.gardner(conductivity=1e-6, alpha=2.0, porosity=0.3)
    problem = seepage.problem(dam, soil, seepage.open_face("right", level=([0.0, 3600.0], [9.0, 2.0])))
    flow = done(problem, seepage.hydrostatic(problem, 9.0), [cases.DAY], tolerance=0.05)
    (into,) = seepage.infiltration(problem, flow.head[-1], time=cases.DAY)
    heights = dam.positions("right")[1]
    assert np.all(np.asarray(into)[heights < 6] < 0)
    assert float(flow.record.inflow.sum()) < 0.01 * float(flow.record.outflow.sum())
    assert float(flow.head[-1].max()) > 4.0  # the core is still full
    assert cases.lost(flow) < 1e-6


def test_dam_discharges_as_dupuit_says():
    (row,) = cases.dupuit_rows(quick=True)
    assert row["error"] < 0.01


def test_drains_take_what_kirkham_says():
    (row,) = cases.drain_rows(quick=True)
    assert row["error"] < 0.01


def test_solid_is_that_of_tracy():
    """Three axes, in the steady state and on the way."""
    edges = (1.0, 1.0, 1.0)
    solid = seepage.cells(edges, (8, 8, 8))
    soil = seepage.gardner(conductivity=1e-5, alpha=2.0, porosity=0.45, residual=0.15, storage=0.0)
    problem = seepage.problem(
        solid,
        soil,
        seepage.held_head("surface", pressure_head=exact.tracy_top(2.0, edges, -1.0)),
        *(seepage.held_head(side, pressure_head=-1.0) for side in ("base", "left", "right", "front", "back")),
    )
    flow = done(problem, -1.0, [3600.0], tolerance=2e-3)
    right = exact.tracy(2.0, 1e-5, 0.3, edges, -1.0, solid.centres().reshape(3, -1), 3600.0)
    wet = np.exp(2.0 * np.asarray(flow.head[-1]).ravel()), np.exp(2.0 * right)
    assert np.sqrt(np.mean((wet[0] - wet[1]) ** 2)) < 0.02 * wet[1].max()


def test_anisotropy_stretches_the_level_axis():
    """Soil of kh/kv = 9 is isotropic soil three times as short: the discharge follows."""
    heads = []
    for ratio, length in ((9.0, 18.0), (1.0, 6.0)):
        dam = seepage.cells((length, 4.0), (12, 8))
        soil = seepage.gardner(conductivity=1e-5, alpha=3.0, porosity=0.3, anisotropy=ratio)
        problem = seepage.problem(
            dam, soil, seepage.held_head("left", level=4.0), seepage.open_face("right", level=1.0)
        )
        head, converged = seepage.steady(problem, seepage.hydrostatic(problem, 2.0))
        assert converged
        heads.append(head)
    np.testing.assert_allclose(heads[0], heads[1], atol=1e-6)


def test_slope_to_the_left_is_that_to_the_right():
    slope, soil = cases.hillside(12, 8)
    left = replace(slope, active=slope.soil[::-1])
    ends = []
    for cells, (near, far) in ((slope, ("left", "right")), (left, ("right", "left"))):
        problem = seepage.problem(
            cells,
            soil,
            seepage.open_face(rain=2e-6),
            seepage.held_head(near, level=4.0),
            seepage.open_face(far, level=2.0),
        )
        ends.append(done(problem, seepage.hydrostatic(problem, 3.0), [cases.DAY], tolerance=0.05).head[-1])
    at = np.asarray(slope.soil)
    np.testing.assert_allclose(np.asarray(ends[1])[::-1][at], np.asarray(ends[0])[at], atol=1e-6)


def test_height_above_the_sea_changes_nothing():
    heads = []
    for corner in (0.0, 2000.0):
        column = seepage.problem(
            seepage.cells((3.0,), (20,), (corner,)),
            seepage.soil_class("loam"),
            seepage.open_face(rain=1e-6),
            seepage.held_head("base", level=corner + 0.5),
        )
        heads.append(done(column, seepage.hydrostatic(column, corner + 0.5), [cases.DAY], tolerance=0.05).head[-1])
    np.testing.assert_allclose(heads[0], heads[1], atol=1e-8)


def test_lanes_are_runs_of_their_own_and_a_failed_one_leaves_its_neighbours():
    column = loam_column(seepage.open_face(rain=2e-6), seepage.held_head("base", level=0.0), cells=12)
    initial = seepage.hydrostatic(column, 0.0)

    def run(factor):
        soil = replace(column.soil, conductivity=column.soil.conductivity * factor)
        return seepage.run(replace(column, soil=soil), initial, [cases.DAY], tolerance=0.05, max_steps=60)

    factors = jnp.asarray([1.0, 0.1, jnp.nan])
    lanes = jax.jit(jax.vmap(lambda factor: (lambda f: (f.head, f.status, f.steps))(run(factor))))(factors)
    assert np.asarray(lanes[1]).tolist()[:2] == [seepage.FlowStatus.DONE] * 2
    assert lanes[1][2] == seepage.FlowStatus.NO_CONVERGENCE
    for n in (0, 1):
        alone = run(float(factors[n]))
        assert int(lanes[2][n]) == int(alone.steps)
        np.testing.assert_allclose(lanes[0][n], alone.head, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("name", ["column", "section"])
def test_gradients_are_those_of_differences(name):
    if name == "column":
        problem = loam_column(seepage.open_face(rain=5e-6), seepage.held_head("base", level=0.0), cells=12)
        initial, end = seepage.hydrostatic(problem, 0.0), 0.3 * cases.DAY
    else:
        problem = cases.storm(*cases.hillside(6, 5), 1e-6)
        initial, end = seepage.hydrostatic(problem, 3.0), 0.3 * cases.DAY
    flow = done(problem, initial, [end], tolerance=0.1)
    pattern = jnp.asarray(np.random.default_rng(7).normal(size=problem.shape))

    def mean(size):
        soil = replace(problem.soil, conductivity=problem.soil.conductivity * jnp.exp(size * pattern))
        head = seepage.replay(replace(problem, soil=soil), initial, flow.durations)[-1]
        return jnp.sum(problem.volume * head) / jnp.sum(problem.volume)

    slope = float(jax.grad(mean)(0.0))
    values = [float(mean(n * 1e-4)) for n in (-2, -1, 1, 2)]
    right = (values[0] - 8 * values[1] + 8 * values[2] - values[3]) / 12e-4
    assert right != 0
    assert slope == pytest.approx(right, rel=1e-6)


def test_replay_is_the_run():
    column = loam_column(seepage.open_face(rain=2e-6), seepage.held_head("base", level=0.0), cells=12)
    flow = done(column, -1.0, [3600.0, 9000.0], tolerance=0.05)
    again = seepage.replay(column, -1.0, flow.durations)[np.asarray(flow.reached) - 1]
    np.testing.assert_allclose(again, flow.head, rtol=1e-9)


def test_steady_flow_is_differentiated_at_its_end():
    """A column between two heads: the steady flux is that of Kirchhoff's integral, by conductivity itself."""
    soil = seepage.gardner(conductivity=1e-5, alpha=2.0, porosity=0.3)
    column = seepage.problem(
        seepage.cells((1.0,), (20,)),
        soil,
        seepage.held_head("surface", pressure_head=-0.2),
        seepage.held_head("base", pressure_head=-1.0),
    )

    def flux(conductivity):
        problem = replace(column, soil=replace(column.soil, conductivity=jnp.full(20, conductivity)))
        head, _ = seepage.steady(problem, -0.5)
        return seepage.infiltration(problem, head)[0].sum()

    value, slope = jax.value_and_grad(flux)(1e-5)
    assert float(slope * 1e-5) == pytest.approx(float(value), rel=1e-8)


@pytest.mark.parametrize("row", list(range(6)))
def test_extremes_end_and_lose_no_water(row):
    rows = cases.extreme_rows(quick=True)
    for _ in range(row):
        next(rows)
    found = next(rows)
    assert found["status"] == "DONE", found
    assert found["water_lost"] < 1e-6, found
