"""Shaking of the base, tied sides, and records of earthquakes."""

import warnings
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxmpm as mpm
from benchmarks.accuracy import earthquakes
from jaxmpm import diagnostics
from jaxmpm.soil import STANDARD_GRAVITY

HALVES = mpm.Discretisation(1.0, (0.5, 0.5))
SOIL = mpm.Soil(unit_weight=19620.0, young=2e7, poisson=0.0)


def layer(cells=1, height=6.0, soil=SOIL, numerics=HALVES, **loads):
    return mpm.section(mpm.Section([(0, height), (cells, height)]), soil, numerics, ends="tied", **loads)


def shaking(seconds=1.0, interval=0.01):
    times = np.arange(0, seconds + interval, interval)
    return mpm.BaseMotion(jnp.asarray(np.stack([np.sin(25 * times), 0.5 * np.cos(9 * times)])), jnp.asarray(interval))


def test_motion_is_linear_between_samples_and_over_after_the_last(x64):
    motion = mpm.BaseMotion(jnp.asarray([[0.0, 2.0, -1.0], [1.0, 1.0, 5.0]]), jnp.asarray(0.5))
    values = jnp.stack([motion.at(jnp.asarray(t)) for t in (0.0, 0.25, 0.5, 0.9, 1.0, 1.1)])
    assert np.allclose(values, [[0, 1], [1, 1], [2, 1], [-0.4, 4.2], [-1, 5], [0, 0]])


@pytest.mark.usefixtures("x64")
def test_a_layer_shaken_at_its_base_moves_as_the_sum_of_its_modes():
    # Undamped: u'' = Vs^2 u,zz - a(t), u = 0 at the base, no stress at the surface.
    height, pulse, amplitude, seconds = 10.0, 20.0, 1.0, 0.6
    times = np.arange(0, seconds + 0.002, 0.001)
    motion = mpm.BaseMotion(jnp.asarray(amplitude * np.stack([np.sin(pulse * times), 0 * times])), jnp.asarray(0.001))
    numerics = replace(HALVES, cell=0.5, spacing=(0.25, 0.25))
    scene, state = layer(1, height, numerics=numerics, motion=motion, gravity=0.0)
    end = mpm.solve(scene, state, t_end=seconds).state
    z, t = np.asarray(scene.particles.position[1]), int(end.step) * float(scene.numerics.time_step)
    k = (2 * np.arange(100)[:, None] + 1) * np.pi / (2 * height)
    omega = k * np.sqrt(1e7 / 2000.0)
    modal = -amplitude / (omega**2 - pulse**2) * (np.sin(pulse * t) - pulse / omega * np.sin(omega * t))
    exact = np.sum(2 / (height * k) * np.sin(k * z) * modal, axis=0)
    assert np.abs(end.displacement[0] - exact).max() < 0.02 * np.abs(exact).max()


@pytest.mark.usefixtures("x64")
@pytest.mark.slow
def test_tied_sides_are_no_ends():
    # However long, the layer moves alike along x, and alike on both engines.
    (one, start), (three, wide) = (layer(cells, motion=shaking()) for cells in (1, 3))
    assert np.allclose(np.unique(np.round(wide.stress[2], 3)), np.unique(np.round(start.stress[2], 3)))
    ends = [mpm.advance(s, at, 120) for s, at in ((one, start), (three, wide))]
    low, high = (
        np.asarray(end.displacement[:, np.argsort(scene.particles.position[1], kind="stable")])
        for end, scene in zip(ends, (one, three), strict=True)
    )
    assert np.allclose(np.repeat(low, 3, axis=1), high, rtol=1e-9, atol=1e-15)
    again = mpm.advance(replace(three, numerics=replace(three.numerics, engine=mpm.Engine.XLA)), wide, 120)
    assert np.allclose(again.displacement, ends[1].displacement, rtol=1e-9, atol=1e-15)


@pytest.mark.usefixtures("x64")
def test_affine_transfers_do_not_know_where_the_sides_are():
    affine = replace(HALVES, kernel=mpm.QuadraticBSpline, apic=True, flip=0.0)
    scene, state = layer(5, 2.0, numerics=affine)
    x, z = scene.particles.position
    turning = jnp.stack([z * jnp.sin(2 * jnp.pi * x / 5), jnp.cos(2 * jnp.pi * x / 5)])
    here, there = (
        mpm.advance(scene, replace(state, velocity=turning, displacement=state.displacement.at[0].add(by)), 20)
        for by in (0.0, 2.0)
    )
    assert np.ptp(here.velocity[0]) > 0.1
    assert np.allclose(there.velocity, here.velocity, atol=1e-10)
    assert np.allclose(there.affine, here.affine, atol=1e-9)
    seen = [diagnostics.grid_velocity(scene, state) for state in (here, there)]
    assert np.allclose(*seen, atol=1e-10)


@pytest.mark.usefixtures("x64")
def test_what_leaves_at_one_side_comes_in_at_the_other():
    scene, state = layer(3, gravity=0.0, speed=30.0)
    scene = replace(scene, boundary=replace(scene.boundary, walls=()))
    moving = jnp.asarray([[25.0], [0.0]]) * jnp.ones_like(scene.particles.mass)
    end = mpm.advance(scene, replace(state, velocity=moving), 200)
    assert int(end.status) == mpm.Status.RUNNING
    assert float(jnp.min(end.displacement[0])) > 3.0
    assert np.allclose(end.velocity, moving, atol=1e-10)
    # A hump of speed travels through the tie and loses no momentum.
    hump = jnp.stack([jnp.exp(-((scene.particles.position[0] - 2.5) ** 2)), 0 * scene.particles.mass])
    pushed = mpm.advance(scene, replace(state, velocity=hump), 200)
    assert np.allclose(
        diagnostics.momentum(scene, pushed),
        diagnostics.momentum(scene, replace(state, velocity=hump)),
        rtol=1e-9,
        atol=1e-6,
    )


@pytest.mark.usefixtures("x64")
def test_gradients_by_the_record_are_those_of_differences_and_lanes_are_runs():
    scene, state = layer(motion=shaking(), gravity=0.0)

    def swung(scale):
        motion = replace(scene.loads.motion, acceleration=scale * scene.loads.motion.acceleration)
        shaken = replace(scene, loads=replace(scene.loads, motion=motion))
        return jnp.sum(mpm.advance(shaken, state, 60).displacement[0] ** 2)

    value, slope = jax.jit(jax.value_and_grad(swung))(1.0)
    behind, here, ahead = jax.jit(jax.vmap(swung))(1 + 1e-6 * jnp.arange(-1.0, 2.0))
    assert np.isclose(slope, (ahead - behind) / 2e-6, rtol=1e-6)
    assert np.isclose(here, value, rtol=1e-12)


def test_a_block_slides_as_newmark_says():
    rows = list(earthquakes.newmark_rows(quick=True))
    assert np.isclose(rows[1]["reference"], 0.1766, atol=1e-4)
    assert np.isclose(rows[0]["reference"], 0.73575, atol=2e-4)
    assert all(abs(row["error"]) < 0.02 for row in rows)


TAKEN = "time, x\n# g\n0.00, 0.1\n0.01, -0.2\n\n0.02, 0.3\n"


@pytest.mark.parametrize("head", ["", "\ufeff"], ids=["plain", "byte order mark"])
def test_a_record_is_read(head, tmp_path):
    path = tmp_path / "record.csv"
    path.write_text(head + TAKEN, encoding="utf-8")
    motion = mpm.read_motion(path, scale=10.0)
    assert np.allclose(motion.acceleration, [[1.0, -2.0, 3.0], [0, 0, 0]])
    assert np.isclose(motion.interval, 0.01)
    assert mpm.read_motion(path, axes="xyz").acceleration.shape == (3, 3)


BAD = {
    "word": (TAKEN.replace("-0.2", "much"), "line 4: x = 'much': give a finite number"),
    "infinite": (TAKEN.replace("-0.2", "inf"), "line 4: x = 'inf'"),
    "short row": (TAKEN.replace("0.01, -0.2", "0.01"), "line 4: x = '': give a finite number"),
    "long row": (TAKEN.replace("-0.2", "-0.2, 1"), "line 4 has 3 cells and the headings"),
    "uneven": (TAKEN.replace("0.01", "0.013"), "line 4: time = 0.013 s after the first, 0.01 s with the even interval"),
    "backwards": (TAKEN.replace("0.02", "-0.02"), "goes from 0 to -0.02 s"),
    "coarse": ("time, x\n0, 1\n0, 2\n1, 3\n1, 4\n2, 5\n", "rounded to 1 s, so that its interval may be"),
    "column": (TAKEN.replace("time, x", "time, north"), "has columns"),
    "no time": (TAKEN.replace("time, x", "x, z"), "time and some of x, z"),
    "twice": (TAKEN.replace("time, x", "time, time"), "each once"),
    "one row": ("time, x\n0, 1\n", "has 1 rows of numbers"),
    "empty": ("", "has columns"),
}


@pytest.mark.parametrize(("text", "message"), BAD.values(), ids=BAD)
def test_a_record_with_bad_rows_is_refused(tmp_path, text, message):
    path = tmp_path / "record.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=message):
        mpm.read_motion(path)


WAVE = np.round(0.3 * np.sin(np.arange(400) / 9), 6)


def _listed(times="{:.3f}", head="time,x", row="{},{:.6f}", start=0.0, factor=1.0, comma=False):
    rows = [row.format(times.format(start + 0.005 * k), a * factor) for k, a in enumerate(WAVE)]
    return "\n".join([head, *(each.replace(".", ",") if comma else each for each in rows)]) + "\n"


PEER = (
    "PEER NGA STRONG MOTION DATABASE RECORD\nmade up event\nACCELERATION TIME SERIES IN UNITS OF G\n{}\n"
    + "\n".join("".join(f"{a:15.7E}" for a in WAVE[k : k + 5]) for k in range(0, 400, 5))
)
RECORDS = {
    "a.csv": (_listed(), "g"),
    "begins at the interval.csv": (_listed(start=0.005), "g"),
    "units.csv": (_listed(head="Time (s),Acceleration (g)"), None),
    "rounded.csv": (_listed("{:.2f}"), "g"),
    "semicolons.csv": (_listed(head="time;x", row="{};{:.6f}", comma=True), "g"),
    "commas at the end.csv": (_listed(head="time,x,", row="{},{:.6f},"), "g"),
    "capitals.csv": (_listed(head="Time,X"), "g"),
    "no headings.txt": (_listed(row="{} {:.6f}").partition("\n")[2], "g"),
    "rec.AT2": (PEER.format("NPTS=   400, DT=   .0050 SEC"), None),
    "old.at2": (PEER.format("  400    0.0050    NPTS, DT"), "g"),
}


@pytest.mark.parametrize("name", RECORDS)
@pytest.mark.filterwarnings("ignore:.*its times are rounded")
def test_one_record_in_any_form_is_one_motion(name, tmp_path):
    text, unit = RECORDS[name]
    (tmp_path / name).write_text(text)
    motion = mpm.read_motion(tmp_path / name, unit=unit)
    assert np.allclose(motion.acceleration, [STANDARD_GRAVITY * WAVE, 0 * WAVE], rtol=1e-5, atol=1e-6)
    assert np.isclose(motion.interval, 0.005, rtol=1e-6)


def test_what_a_record_states_of_itself_is_kept_to(tmp_path):
    (tmp_path / "a.AT2").write_text(PEER.format("NPTS= 400, DT= .005 SEC"))
    with pytest.raises(ValueError, match="has its x in g, and cm/s2 is asked for"):
        mpm.read_motion(tmp_path / "a.AT2", unit="cm/s2")
    (tmp_path / "a.AT2").write_text(PEER.format("NPTS= 401, DT= .005 SEC"))
    with pytest.raises(ValueError, match=r"declares 401 values, each 0\.005 s, and holds 400"):
        mpm.read_motion(tmp_path / "a.AT2")
    (tmp_path / "a.VT2").write_text(PEER.format("NPTS= 400, DT= .005 SEC").replace("ACCELERATION", "VELOCITY"))
    with pytest.raises(ValueError, match="does not say that it has accelerations"):
        mpm.read_motion(tmp_path / "a.VT2")
    (tmp_path / "a.csv").write_text(_listed(head="time,velocity"))
    with pytest.raises(ValueError, match="has columns"):
        mpm.read_motion(tmp_path / "a.csv")
    (tmp_path / "a.csv").write_text("time [ms],x [mm/s2],disp [m]\n0,1000,0\n5,2000,1\n10,3000,2\n")
    with pytest.warns(UserWarning, match="columns beside time and acceleration are not read: 'disp'"):
        motion = mpm.read_motion(tmp_path / "a.csv", axes="x")
    assert np.allclose(motion.acceleration, [[1.0, 2.0, 3.0]])
    assert np.isclose(motion.interval, 0.005)


def motion_of(shape, interval=0.1):
    return mpm.BaseMotion(jnp.ones(shape), jnp.asarray(interval))


REFUSED = {
    "shape": ({"motion": motion_of((3, 5))}, r"motion has acceleration \(3, 5\)"),
    "one sample": ({"motion": motion_of((2, 1))}, "m > 1"),
    "interval": ({"motion": motion_of((2, 5), 0.0)}, "interval = 0 s: give a finite value above 0"),
    "nan": ({"motion": motion_of((2, 5), float("nan"))}, "interval = nan"),
    "array": ({"motion": np.ones((2, 5))}, "give a BaseMotion, or None"),
    "averages": (
        {
            "soil": mpm.Soil(strength=1e4, softening_modulus=1e4, tension_cutoff=0.0),
            "numerics": replace(HALVES, internal_length=1.5),
        },
        "with tied sides, across which it does not average",
    ),
    "water": ({"soil": mpm.FrictionalSoil(1e3, 30.0), "water": [(0, 3), (1, 4)]}, "the water is at 3 m at one wall"),
}


def test_a_pulse_within_a_time_step_is_warned_of():
    pulse = jnp.zeros((2, 2000)).at[0, 1003:1012].set(1.0)
    with pytest.warns(UserWarning, match=r"a sample every 0.0001 s, and time steps of 0\.\d+ s skip pulses"):
        layer(motion=mpm.BaseMotion(pulse, jnp.asarray(1e-4)))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        layer(motion=shaking(interval=0.001))


@pytest.mark.parametrize(("given", "message"), REFUSED.values(), ids=REFUSED)
def test_shaking_that_cannot_be_is_refused(given, message):
    with pytest.raises(ValueError, match=message):
        layer(**given)


def test_ground_of_unlike_ends_cannot_be_tied():
    with pytest.raises(ValueError, match="the top of layer 1 is at 6 m at one wall and at 3 m at the other"):
        mpm.section(mpm.Section([(0, 6), (8, 3)]), SOIL, HALVES, ends="tied")
    scene, _ = layer()
    with pytest.raises(ValueError, match=r"tied = \(0, 3\): give two nodes along x"):
        mpm.scene(scene.particles, scene.grid, scene.material, HALVES, boundary=mpm.Boundary(tied=(0, 3)))
