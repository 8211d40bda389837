"""Soil with a B-value in a scene: a loaded column, a slope that liquefies as it slides, and what every run promises."""

import math
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxmpm as mpm
from jaxmpm import io
from jaxmpm.laws import excess_pressure, with_parameters
from jaxmpm.run import advance
from jaxmpm.tensors import expand, mean
from tests.differences import check_run

GRAVITY, WEIGHT = 9.81, 20e3
SAND = mpm.FrictionalSoil(
    500.0, 22.0, dilation=-4.0, unit_weight=19e3, young=1e7, tension_cutoff=0.0, b_value=0.9,
    softening_strain=0.3, residual_cohesion=500.0, residual_friction=22.0,
)  # fmt: skip
CUT = mpm.Section([(0, 6), (8, 6), (18, 1), (24, 1)], base=0)
NUMERICS = mpm.Discretisation(1.0, (0.5, 0.5), cfl=0.5, dtype="float64")


def cut(soil=SAND, **choices):
    return mpm.section(CUT, soil, replace(NUMERICS, **choices), r_u=0.4)


@pytest.fixture(scope="module")
def slope():
    with jax.enable_x64(True):
        return cut()


def excess_of(scene, state):
    return np.asarray(excess_pressure(scene.material, state.history, expand(state.stress, scene.grid.dimension)))


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("b_value", [0.5, 0.95, 0.9999])
def test_water_bears_its_share_of_a_sudden_load_on_a_column(b_value):
    """Weight that doubles at once: du over the vertical stress is M / (M + K + 4 G / 3), and B = 1 bears it all."""
    soil = mpm.FrictionalSoil(1e6, 30.0, young=1e7, unit_weight=WEIGHT, b_value=b_value)
    scene, state = mpm.column(4.0, soil, mpm.Discretisation(1.0, (0.5,), damping=20.0, dtype="float64"))
    scene = replace(scene, loads=replace(scene.loads, gravity=2 * scene.loads.gravity))
    law = scene.material
    wave = math.sqrt(float(law.p_wave_modulus) / (WEIGHT / 9.81))
    assert float(scene.numerics.time_step) < 0.9 / wave
    period = 16.0 / wave
    end = mpm.solve(scene, state, t_end=max(0.8, 4 * period)).raise_if_failed().state
    depth = 4.0 - np.asarray(scene.particles.position)[0]
    share = float(law.water_modulus / law.p_wave_modulus)
    in_cells = [values.reshape(4, 2).mean(1) for values in (excess_of(scene, end), share * WEIGHT * depth)]
    np.testing.assert_allclose(*in_cells, rtol=0.01)  # strain is that of the cell


@pytest.mark.usefixtures("x64")
def test_an_infinite_slope_on_soil_that_contracts_runs_away_until_it_is_liquefied():
    """A block on a layer of thickness b: x = a / w^2 (cosh w t - 1), w^2 = tan(phi) B K beta / (rho D b).

    Slip x shears the layer by x / b, whose contraction beta x / b raises its pressure by B K times that.
    """
    theta, friction, dilation, b_value, young, block, band = math.radians(26), 24.0, -3.0, 0.9, 1e7, 8.0, 1.0
    soil = mpm.FrictionalSoil(
        0.0, friction, dilation=dilation, young=young, unit_weight=WEIGHT, b_value=b_value,
        law=mpm.laws.DruckerPrager, k0=1.0, unusual=True,
    )  # fmt: skip
    layers = [
        mpm.Layer(mpm.Soil(unit_weight=WEIGHT, young=2e8, k0=1.0), bottom=[(0, band), (2, band)]),
        mpm.Layer(soil),
    ]
    level = mpm.Section([(0, block + band), (2, block + band)], base=0)
    scene, _ = mpm.section(level, layers, replace(NUMERICS, cfl=0.9), ends="tied")
    down = GRAVITY * jnp.asarray([math.sin(theta), -math.cos(theta)])
    scene = replace(scene, loads=replace(scene.loads, gravity=down))
    times = np.asarray([0.3, 0.5, 0.7, 1.1])
    run = mpm.solve(scene, mpm.at_rest(scene), t_end=1.1, snapshots=times).raise_if_failed()
    z = np.asarray(scene.particles.position)[1]
    moved = np.asarray([np.asarray(state.displacement)[0][z > band + 1].mean() for state in run.snapshots])
    pressure = np.asarray([excess_of(scene, state)[z < band].mean() for state in run.snapshots])

    sine, dilating = math.sin(math.radians(friction)), math.sin(math.radians(dilation))
    matched = 1 / math.sqrt(1 + dilating**2 / 3)
    slope, beta = sine / (matched + sine * dilating * matched / 3), -dilating * matched
    mass, rise = WEIGHT / 9.81 * (block + band / 2), b_value * young / (3 * 0.4) * beta / band
    rate = math.sqrt(slope * rise / mass)
    start = GRAVITY * (math.sin(theta) - slope * math.cos(theta))
    expected = start / rate**2 * (np.cosh(rate * times) - 1)
    np.testing.assert_allclose(moved[:3], expected[:3], rtol=0.04)
    np.testing.assert_allclose(pressure[1:3], rise * expected[1:3], rtol=0.1)
    assert expected[2] > 1.4 * start * times[2] ** 2 / 2  # where nothing made pressure
    borne = mass * GRAVITY * math.cos(theta)
    np.testing.assert_allclose(pressure[3], borne, rtol=0.05)


@pytest.mark.usefixtures("x64")
def test_a_slide_runs_farther_undrained_and_grains_bear_no_tension(slope):
    ends = [mpm.solve(*each, t_end=2.0).raise_if_failed().state for each in (cut(replace(SAND, b_value=None)), slope)]
    drained, sealed = (float(mpm.diagnostics.largest_displacement(end)) for end in ends)
    assert sealed > 1.5 * drained
    scene = slope[0]
    effective = mean(expand(mpm.diagnostics.effective_stress(scene, ends[1]), 2))
    assert float(effective.max()) <= 1e-6
    pressure = np.asarray(mpm.diagnostics.pore_pressure(scene, ends[1]))
    assert pressure.min() >= -1e-6
    assert pressure.max() > 2 * float(scene.loads.pore_pressure.max())


@pytest.mark.usefixtures("x64")
def test_energy_of_stiff_water_does_not_grow():
    scene, state = cut(replace(SAND, b_value=0.99))
    assert scene.numerics.time_step < 0.2 * cut(replace(SAND, b_value=None))[0].numerics.time_step
    times = np.linspace(0.25, 1.0, 4)
    run = mpm.solve(scene, state, t_end=1.0, snapshots=times).raise_if_failed()
    d = mpm.diagnostics
    energy = [float(d.kinetic_energy(scene, s) + d.potential_energy(scene, s)) for s in run.snapshots]
    assert np.all(np.diff([0.0, *energy]) < 0)
    long = mpm.step(scene, state, 2.2 * scene.numerics.time_step)
    assert mpm.Status(int(long.status)) is mpm.Status.TIME_STEP_TOO_LARGE


@pytest.mark.usefixtures("x64")
def test_an_average_of_plastic_strain_leaves_the_stress_and_its_water_alone(slope):
    """Before soil yields the two programs move alike; in a slide grains still bear no tension."""
    plain, averaged = slope, cut(internal_length=2.0)
    assert jax.tree.structure(averaged[1].unaveraged) == jax.tree.structure(averaged[1].history.strain)
    for scene, _ in (plain, averaged):
        assert scene.numerics.time_step == plain[0].numerics.time_step
    stiff = replace(plain[0].material.law, cohesion=jnp.asarray(1e6))
    ends = [
        advance(replace(scene, material=replace(scene.material, law=stiff)), state, 100)
        for scene, state in (plain, averaged)
    ]
    np.testing.assert_allclose(ends[0].stress, ends[1].stress, rtol=0, atol=1e-6)
    scene, state = averaged
    end = mpm.solve(scene, state, t_end=1.0).raise_if_failed().state
    effective = mean(expand(mpm.diagnostics.effective_stress(scene, end), 2))
    assert float(effective.max()) <= 1e-6


@pytest.mark.usefixtures("x64")
def test_gradients_lanes_and_engines_agree(slope):
    scene, state = slope

    def moved(scene, b_value, contraction):
        law = with_parameters(scene.material, {"b_value": b_value, "dilation": -contraction})
        return jnp.mean(advance(replace(scene, material=law), state, 40).displacement[0])

    check_run(moved, scene, (0.8, 0.05), (1e-5, 1e-5), 1e-4)


def test_single_precision_keeps_the_pressure(slope):
    with jax.enable_x64(True):
        exact = mpm.solve(*slope, t_end=0.3).state
        expected = excess_of(slope[0], exact)
    scene, state = cut(dtype="float32")
    found = excess_of(scene, mpm.solve(scene, state, t_end=0.3).state)
    assert found.dtype == np.float32
    assert abs(found - expected).max() < 2e-3 * abs(expected).max()


@pytest.mark.usefixtures("x64")
def test_a_restart_goes_on_bit_for_bit_and_exports_have_the_pressure(slope, tmp_path):
    scene, state = slope
    half = advance(scene, state, 100)
    io.save_state(tmp_path / "half.h5", half)
    read, _ = io.load_state(tmp_path / "half.h5", state)
    for one, other in zip(*(jax.tree.leaves(advance(scene, each, 100)) for each in (half, read)), strict=True):
        np.testing.assert_array_equal(np.asarray(one), np.asarray(other))
    io.write_vtkhdf(tmp_path / "run.vtkhdf", scene, [half], [1.0])
    import h5py

    with h5py.File(tmp_path / "run.vtkhdf") as file:
        fields = file["VTKHDF/PointData"]
        assert {"pore_pressure", "plastic_strain"} <= fields.keys()
        np.testing.assert_array_equal(fields["pore_pressure"], mpm.diagnostics.pore_pressure(scene, half))
    label = mpm.plot.state(scene, half, "pore_pressure").axes[1].get_ylabel()
    assert label == "pore pressure (kPa)"


@pytest.mark.usefixtures("x64")
def test_soil_under_a_table_is_sealed_and_soil_above_it_is_not():
    scene, state = mpm.section(CUT, SAND, NUMERICS, water=[(0, 3.0), (18, 1.0), (24, 1.0)])
    under = np.asarray(scene.particles.position)[1] < np.interp(
        np.asarray(scene.particles.position)[0], [0, 18, 24], [3.0, 1.0, 1.0]
    )
    stiff = np.asarray(scene.material.water_modulus) > 0
    assert np.all(stiff[under])
    assert np.mean(stiff == under) > 0.9  # a table that cuts a particle wets it
    at_rest = np.asarray(mpm.diagnostics.pore_pressure(scene, state))
    assert np.all((at_rest > 0) == under)


@pytest.mark.usefixtures("x64")
def test_a_larger_b_value_shortens_the_time_step_and_leaves_the_stress_at_rest(slope):
    scene, state = slope
    varied, start = mpm.with_soil(scene, state, b_value=0.97)
    shorter = math.sqrt(float(jnp.max(scene.material.p_wave_modulus) / jnp.max(varied.material.p_wave_modulus)))
    np.testing.assert_allclose(varied.numerics.time_step, scene.numerics.time_step * shorter)
    assert start.stress is state.stress


def test_what_does_not_go_together_is_refused():
    with pytest.raises(ValueError, match="b_value = 1"):
        cut(replace(SAND, b_value=1.0), dtype="float32")
    with pytest.raises(ValueError, match="contraction takes more stress"):
        cut(replace(SAND, dilation=-14.0, friction=40.0, residual_friction=40.0, poisson=0.45), dtype="float32")
