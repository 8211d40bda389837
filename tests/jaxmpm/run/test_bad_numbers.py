"""Numbers that no scene may have are refused on the host, and are a lane's status on the device."""

import warnings
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxmpm as mpm
from jaxmpm.support import check
from jaxmpm.support.check import Limit

NAN, INF = float("nan"), float("inf")
SHAPE = mpm.Slope(crest=4, height=2, run_per_rise=1.0, toe=4, foundation=2)
CLAY = mpm.Soil(young=5e6, strength=9e3, softening_modulus=40e3, tension_cutoff=0.0)
NUMERICS = mpm.Discretisation(1.0, (0.5, 0.5))
BAD = mpm.Status.BAD_PARAMETER


@pytest.fixture(scope="module")
def section():
    return mpm.slope(SHAPE, CLAY, NUMERICS)


def spoilt(scene, value):
    """The scene with this strength at one particle, put there behind the builders' backs."""
    strength = jnp.full_like(scene.particles.mass, 9e3).at[3].set(value)
    return replace(scene, material=replace(scene.material, strength=strength))


def test_bad_parameter_is_a_failure_and_numbers_of_old_files_stay():
    old = ["RUNNING", "FINISHED", "SETTLED", "DECIDED", "NOT_FINITE", "OUTSIDE_GRID", "INVERTED", "TIME_STEP_TOO_LARGE"]
    assert [mpm.Status[name] for name in old] == list(range(8))
    assert BAD > mpm.Status.DECIDED


@pytest.mark.parametrize("value", [NAN, 0.0])
def test_one_bad_particle_is_refused_on_the_host(section, value):
    scene, state = section
    strength = np.full(scene.particles.mass.size, 9e3)
    strength[3] = value
    with pytest.raises(ValueError, match=r"strength = .* Pa at \[3\] \(bad at 1 of .*\): give a finite value above 0"):
        mpm.with_soil(scene, state, strength=strength)
    with pytest.raises(ValueError, match=r"strength = .* at \[1, 3\] \(bad at 1 of"):
        mpm.run.lanes(scene, strength=np.stack([np.full_like(strength, 9e3), strength]))
    with pytest.raises(ValueError, match=r"strength = .* at \[3\]"):
        mpm.slope(SHAPE, replace(CLAY, strength=strength), NUMERICS)
    with pytest.raises(ValueError, match=r"strength = .* at \[3\]"):
        mpm.solve(spoilt(scene, value), state, t_end=0.1)
    with pytest.raises(ValueError, match=r"strength = .* at \[3\]"):
        mpm.factor_of_safety(spoilt(scene, value), state)
    with pytest.raises(ValueError, match=r"strength = .* at \[3\]"):
        mpm.sensitivity(spoilt(scene, value), state, mpm.diagnostics.largest_displacement, steps=2)
    with pytest.raises(ValueError, match=r"strength = .* at \[3\]"):
        next(mpm.solve_each(spoilt(scene, value), state, {"young": [5e6]}, width=1, t_end=0.1))


def test_a_lane_with_a_bad_parameter_takes_no_step_and_leaves_its_neighbours(section):
    scene, state = section
    good = jnp.broadcast_to(scene.material.strength, (4, scene.particles.mass.size))
    varied, axes = mpm.run.lanes(scene, strength=good)
    bad = good.at[1, 3].set(NAN).at[2, 5].set(0.0).at[3, 0].set(-1.0)
    broken = replace(varied, material=replace(varied.material, strength=bad))
    whole = mpm.solve(varied, mpm.run.repeat(state, 4), t_end=0.05, axes=axes)
    result = mpm.solve(broken, mpm.run.repeat(state, 4), t_end=0.05, axes=axes)
    assert result.status.tolist() == [mpm.Status.FINISHED, BAD, BAD, BAD]
    assert np.asarray(result.state.step)[1:].tolist() == [0, 0, 0]
    assert result.broke_off.tolist() == [False, True, True, True]
    assert np.array_equal(result.state.displacement[0], whole.state.displacement[0])
    with pytest.raises(FloatingPointError, match=r"lane 1: .*not finite or beyond its limit.*\(step 0\)"):
        result.raise_if_failed()


def test_a_sample_with_a_bad_parameter_is_a_result_of_its_own(section):
    scene, state = section
    good = jnp.full_like(scene.particles.mass, 9e3)
    strengths = [good, good.at[3].set(NAN), good, good.at[0].set(0.0)]
    results = dict(mpm.solve_each(scene, state, {"strength": strengths}, width=2, t_end=0.05))
    assert [int(results[i].status) for i in range(4)] == [mpm.Status.FINISHED, BAD, mpm.Status.FINISHED, BAD]
    assert np.array_equal(results[0].state.displacement, results[2].state.displacement)
    moduli = {"young": [5e6, NAN, -1.0], "poisson": [0.3, 0.3, 0.3]}
    stiff = dict(mpm.solve_each(scene, state, moduli, width=3, t_end=0.05))
    assert [int(stiff[i].status) for i in range(3)] == [mpm.Status.FINISHED, BAD, BAD]


def test_replay_and_advance_say_so_too(section):
    scene, state = section
    for value, status in ((NAN, BAD), (0.0, BAD), (9e3, mpm.Status.RUNNING)):
        assert int(mpm.replay(spoilt(scene, value), state, 2)[0].status) == status
        final = jax.jit(mpm.advance)(spoilt(scene, value), state, jnp.asarray(2))
        assert (int(final.status), int(final.step)) == (status, 0 if status == BAD else 2)


@pytest.mark.parametrize(
    ("name", "value"), [("time_step", -1e-3), ("time_step", NAN), ("damping", -1.0), ("flip", 2.0), ("gravity", NAN)]
)
def test_other_numbers_of_a_scene_are_held_to_their_limits(section, name, value):
    scene, state = section
    if name == "gravity":
        bad = replace(scene, loads=replace(scene.loads, gravity=jnp.full_like(scene.loads.gravity, value)))
    else:
        bad = replace(scene, numerics=replace(scene.numerics, **{name: jnp.full_like(scene.numerics.time_step, value)}))
    assert int(mpm.advance(bad, state, jnp.asarray(1)).status) == BAD
    with pytest.raises(ValueError, match=f"{name} = "):
        mpm.solve(bad, state, t_end=0.1)


def test_snap_back_in_one_lane_is_a_bad_parameter(section):
    scene, state = section
    brittle = replace(scene.material, softening=mpm.laws.ExponentialSoftening(jnp.asarray(0.5), jnp.asarray(0.01)))
    scene = replace(scene, material=brittle)  # steepest 150 S, the shear modulus 1.9 MPa
    results = dict(mpm.solve_each(scene, state, {"strength": [9e3, 20e3]}, width=2, t_end=0.02))
    assert [int(results[i].status) for i in (0, 1)] == [mpm.Status.FINISHED, BAD]
    with pytest.raises(ValueError, match="snaps back"):
        mpm.run.lanes(scene, strength=jnp.asarray([9e3, 20e3]))


def test_softening_is_held_to_its_limits_at_each_particle(section):
    scene, state = section
    good = jnp.full_like(scene.particles.mass, 0.5)
    ratios = [good, good.at[3].set(NAN), good.at[2].set(1.5)]
    results = dict(mpm.solve_each(scene, state, {"residual_ratio": ratios}, width=3, t_end=0.02))
    assert [int(results[i].status) for i in range(3)] == [mpm.Status.FINISHED, BAD, BAD]
    with pytest.raises(ValueError, match=r"softening.residual_ratio = 1.5 at \[2\] .*: give a value from 0 to 1"):
        mpm.with_soil(scene, state, residual_ratio=ratios[2])
    with pytest.raises(ValueError, match=r"softening.residual_ratio = nan at \[1, 3\]"):
        mpm.run.lanes(scene, residual_ratio=jnp.stack(ratios))
    unknown = r"\['softening.modulus'\] is no parameter of J2: use some of .*'softening_modulus', 'residual_ratio'"
    with pytest.raises(ValueError, match=unknown):
        mpm.with_soil(scene, state, **{"softening.modulus": 1e4})
    with pytest.raises(ValueError, match=r"^softening_modulus = -1"):
        mpm.with_soil(scene, state, softening_modulus=-1.0)


def test_soil_that_softening_would_harden_is_refused_and_ends_its_lane():
    sand = mpm.FrictionalSoil(5e3, 30.0, softening_strain=0.2, residual_cohesion=1e3, residual_friction=20.0)
    scene, state = mpm.slope(SHAPE, sand, NUMERICS, at_rest=False)
    for name, value in (("residual_cohesion", 6e3), ("friction", np.radians(15.0))):
        with pytest.raises(ValueError, match="softening leaves more cohesion or friction than the peak has"):
            mpm.with_soil(scene, state, **{name: value})
        with pytest.raises(ValueError, match="softening leaves more"):
            mpm.run.lanes(scene, **{name: jnp.asarray([value])})
    harder = replace(scene, material=replace(scene.material, cohesion=jnp.asarray(500.0)))
    assert int(mpm.advance(harder, state, jnp.asarray(1)).status) == BAD


REFUSED = [
    ("strength's shape", lambda s, t: mpm.slope(SHAPE, replace(CLAY, strength=np.full(3, 9e3)), NUMERICS), "has shape"),
    ("speed", lambda s, t: mpm.slope(SHAPE, CLAY, NUMERICS, speed=-50.0), "speed = -50 m/s: give a finite value of 0"),
    ("gravity", lambda s, t: mpm.slope(SHAPE, CLAY, NUMERICS, gravity=-9.81), "gravity = -9.81 m/s2: give a finite"),
    (
        "text",
        lambda s, t: mpm.slope(SHAPE, replace(CLAY, young="stiff"), NUMERICS),
        "young = 'stiff': give a fin",
    ),
    ("velocity", lambda s, t: mpm.bar(4.0, CLAY, mpm.Discretisation(1.0, (0.5,)), velocity=NAN), "velocity = nan m/s"),
    ("settle speed", lambda s, t: mpm.Settle(speed=-0.1), "settle's speed = -0.1 m/s: give a finite value of 0 or mo"),
    ("settle drift", lambda s, t: mpm.Settle(drift=NAN), "settle's drift = nan m"),
    ("settle hold", lambda s, t: mpm.Settle(hold=INF), "settle's hold = inf s"),
    ("every", lambda s, t: mpm.solve(s, t, t_end=1.0, every=0.0), "every = 0 s: give a finite value above 0"),
    ("no rules", lambda s, t: mpm.solve(s, t, t_end=1.0, rules=mpm.Settle()), "rules = Settle"),
    ("no rule", lambda s, t: mpm.solve(s, t, t_end=1.0, rules=[True]), "rules = .True.: give a list of rules"),
    ("limit", lambda s, t: mpm.Exceeds(-1.0), "exceeds' displacement = -1 m: give a finite value above 0"),
    ("snapshots", lambda s, t: mpm.solve(s, t, t_end=1.0, snapshots=(3,)), r"snapshots at \[3\] s lie outside"),
    ("lanes' name", lambda s, t: mpm.run.lanes(s, stiffness=jnp.ones(2)), r"stiffness.*is no parameter of J2"),
    ("t_end", lambda s, t: mpm.solve(s, t, t_end=INF), "t_end = inf s: give a finite value above 0"),
    ("each t_end", lambda s, t: next(mpm.solve_each(s, t, {"strength": [9e3]}, width=1, t_end=INF)), "t_end = inf s"),
    ("each name", lambda s, t: next(mpm.solve_each(s, t, {"stiffness": [1.0]}, width=1, t_end=1.0)), "no parameter"),
    ("each both", lambda s, t: mpm.with_soil(s, t, young=1e7, bulk=1e7), "both young and bulk"),
    (
        "each count",
        lambda s, t: next(mpm.solve_each(s, t, {"strength": [9e3, 9e3], "young": [5e6]}, width=1, t_end=1.0)),
        "unequal numbers of values",
    ),
    (
        "each shape",
        lambda s, t: list(mpm.solve_each(s, t, {"strength": [9e3, np.full(3, 9e3)]}, width=1, t_end=0.02)),
        "has shape|values of shapes",
    ),
    ("state", lambda s, t: mpm.solve(s, mpm.run.repeat(t, 2), t_end=1.0), "displacement has shape"),
    ("repeat", lambda s, t: mpm.run.repeat(t, 0), "count = 0: give a whole number of 1 or more"),
    ("lanes' shape", lambda s, t: mpm.run.lanes(s, strength=np.full((2, 3), 9e3)), "a lane of strength has shape"),
    (
        "lanes' count",
        lambda s, t: mpm.run.lanes(s, strength=np.full(2, 9e3), tension_cutoff=np.full(3, 1.0)),
        "as many for every",
    ),
    ("reduction", lambda s, t: mpm.reduced(s, NAN), "factor = nan"),
    ("bracket", lambda s, t: mpm.factor_of_safety(s, t, bracket=(0.5, INF)), "bracket = inf at"),
    ("batch", lambda s, t: mpm.factor_of_safety(s, t, batch=2.5), "batch = 2.5: give a whole number of 2 or more"),
    ("fos t_end", lambda s, t: mpm.factor_of_safety(s, t, t_end=NAN), "t_end = nan s"),
    ("memory", lambda s, t: mpm.replay(s, t, 4, memory=NAN), "memory = nan bytes"),
    ("soft width", lambda s, t: mpm.objectives.soft_largest_displacement(t, width=0.0), "width = 0 m"),
    ("front width", lambda s, t: mpm.objectives.front(s, t, width=-1.0), "width = -1 m"),
    ("floor", lambda s, t: mpm.objectives.log_displacement(t, floor=0.0), "floor = 0 m"),
    ("stations", lambda s, t: mpm.objectives.column_height(s, t, jnp.asarray([NAN]), 1.0), "stations = nan m at"),
    ("times", lambda s, t: mpm.write_vtkhdf("x.vtkhdf", s, [t], [NAN]), "times = "),
    (
        "energy",
        lambda s, t: mpm.diagnostics.kinetic_energy(s, mpm.run.repeat(t, 2)),
        "the state's displacement has shape",
    ),
]


@pytest.mark.parametrize(("call", "message"), [r[1:] for r in REFUSED], ids=[r[0] for r in REFUSED])
def test_bad_numbers_are_refused_naming_value_and_limit(section, call, message):
    with pytest.raises(ValueError, match=message):
        call(*section)


GRID = mpm.Grid((6, 5), 1.0, (0.0, 0.0))
PARTICLES = mpm.Particles(jnp.array([[2.25, 2.75], [2.25, 2.25]]), jnp.full(2, 500.0), jnp.full(2, 0.25))
ROUGH = (mpm.Wall(1, "low", 1, "friction"),)
MISFITS = {
    "axes": ({"grid": mpm.Grid((6, 5, 4, 3), 1.0, (0.0,) * 4)}, "give 1, 2 or 3 axes"),
    "shapes": ({"particles": replace(PARTICLES, mass=jnp.ones(3))}, r"mass \(3,\).*: give \(2, N\), \(N,\)"),
    "precisions": ({"particles": replace(PARTICLES, mass=np.full(2, 500.0))}, "mix float32, float64: give all"),
    "outside": ({"particles": replace(PARTICLES, position=PARTICLES.position + 9)}, "enlarge the grid by a cell"),
    "no wall": ({"boundary": mpm.Boundary(walls=(1,))}, r"walls hold 1: give Wall\("),
    "no axis": ({"boundary": mpm.Boundary(walls=(mpm.Wall(2, "low", 1, "fixed"),))}, "no such axis or node"),
    "no side": ({"boundary": mpm.Boundary(walls=(mpm.Wall(1, "left", 1, "fixed"),))}, "side is 'low' or 'high'"),
    "smooth": ({"boundary": mpm.Boundary(friction=0.5)}, "give it with, and only with, walls of 'friction'"),
    "nothing holds": ({"boundary": mpm.Boundary(cohesion=1e3)}, "without walls of 'friction' or a base: leave them"),
    "nodes": ({"boundary": mpm.Boundary(walls=ROUGH, friction=jnp.ones(7))}, r"shape \(7,\): give a number or \(30,\)"),
    "pressure": ({"boundary": mpm.Boundary(walls=ROUGH, friction=0.5, pressure=jnp.ones(7))}, r"give \(30,\), in Pa"),
    "cut": ({"boundary": mpm.Boundary(cut=np.ones(30))}, r"give \(30,\), one bool for each node"),
    "cell": ({"discretisation": mpm.Discretisation(2.0, (0.5, 0.5))}, "cells of 1 m: give the same"),
    "engine": ({"engine": "xla"}, "engine = 'xla': give a member of Engine"),
}


@pytest.mark.parametrize(("parts", "message"), MISFITS.values(), ids=MISFITS)
def test_parts_that_do_not_fit_each_other_make_no_scene(parts, message):
    law = mpm.laws.DruckerPrager(*map(jnp.asarray, (5e6, 3e6, 1e4, 0.4, 0.0)))
    fitting = {"particles": PARTICLES, "grid": GRID, "material": law, "discretisation": NUMERICS}
    with pytest.raises(ValueError, match=message):
        mpm.scene(**fitting | parts)


def test_a_law_of_the_users_own_is_held_to_its_own_limits(section):
    @mpm.pytree
    @dataclass(frozen=True)
    class Own(mpm.laws.Law):
        """Elastic, with a number that must lie between 1 and 2."""

        bulk: float
        shear: float
        exponent: float

        PARAMETERS = {"exponent": Limit(least=1.0, most=2.0)}  # noqa: RUF012

        def update(self, strain_increment, stress, history, dt=None):
            return stress, history

    scene, _ = section
    assert bool(check.admissible(Own(1.0, 1.0, 1.5)))
    for law in (Own(1.0, 1.0, 3.0), Own(0.0, 1.0, 1.5), Own(1.0, NAN, 1.5)):
        assert not bool(check.admissible(law))
        with pytest.raises(ValueError, match="give a"):
            mpm.scene(scene.particles, scene.grid, law, NUMERICS)


@pytest.mark.parametrize(
    ("limit", "inside", "outside", "words"),
    [
        (Limit(above=0.0), [1e-30, 1e30], [0.0, -1.0, NAN, INF], "a finite value above 0"),
        (Limit(least=0.0), [0.0, 3.0], [-1e-30, NAN, INF], "a finite value of 0 or more"),
        (Limit(least=0.0, most=1.0), [0.0, 1.0], [-0.1, 1.1, NAN], "a value from 0 to 1"),
        (Limit(above=-1.0, below=0.5), [0.0], [-1.0, 0.5, NAN], "a value above -1 and below 0.5"),
        (Limit(), [-1e30, 0.0], [NAN, INF, -INF], "a finite value"),
    ],
)
def test_limits_mean_the_same_on_host_and_device(limit, inside, outside, words):
    assert str(limit) == words
    for holds in (limit.holds, jax.jit(limit.holds)):
        assert np.all(holds(np.asarray(inside)))
        assert not np.any(holds(np.asarray(outside)))


def test_linear_hats_are_warned_of_where_they_cannot_work():
    soil, room = mpm.Soil(young=1e6), {"domain": (4, 4), "corner": (1.0, 1.0)}
    halves = replace(NUMERICS, kernel=mpm.Linear)
    with pytest.warns(UserWarning, match="kernel = Linear with scheme = USL: nodes that are nearly empty"):
        mpm.block((1, 1), soil, replace(halves, scheme=mpm.Scheme.USL), **room)
    with pytest.warns(UserWarning, match="3 of 4 particles within 0.01 cells of a cell's face"):
        mpm.block((1, 1), soil, halves, **(room | {"corner": (1.25, 1.25)}))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        mpm.block((1, 1), soil, halves, **room)


@pytest.mark.parametrize(
    ("soil", "message"),
    [
        (mpm.FrictionalSoil(3e3, 0.35), "friction = 0.35 degrees, below 1.6 degrees: .* degrees meant"),
        (mpm.FrictionalSoil(3.0, 30.0), "cohesion = 3 Pa, below 100 Pa: were kPa meant"),
        (
            mpm.Soil(unit_weight=18.0, strength=30.0, tension_cutoff=0.0),
            "strength = 30 Pa, .*; unit_weight = 18 N/m3, .* unusual=True",
        ),
    ],
    ids=["radians", "cohesion", "both"],
)
def test_numbers_that_betray_another_unit_are_warned_of_once(soil, message):
    with pytest.warns(UserWarning, match=message) as warned:
        mpm.slope(SHAPE, soil, NUMERICS, at_rest=False)
    assert len(warned) == 1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        mpm.slope(SHAPE, replace(soil, unusual=True), NUMERICS, at_rest=False)
        mpm.slope(SHAPE, mpm.Soil(strength=30e3, tension_cutoff=0.0), NUMERICS, at_rest=False)


def test_dilation_above_friction_is_refused_wherever_it_comes_from():
    sand = mpm.FrictionalSoil(5e3, 30.0, dilation=10.0)
    scene, state = mpm.slope(SHAPE, sand, NUMERICS, at_rest=False)
    with pytest.raises(ValueError, match="dilation is up to 2 degrees above the friction"):
        mpm.with_soil(scene, state, friction=np.radians(8.0))
    friction = jnp.radians(jnp.full_like(scene.particles.mass, 30.0)).at[3].set(0.1)
    with pytest.raises(ValueError, match=r"dilation is up to 4.27 degrees above the friction"):
        mpm.with_soil(scene, state, friction=friction)
    with pytest.raises(ValueError, match="dilation is up to 1 degrees above the friction"):
        mpm.run.lanes(scene, friction=np.radians([20.0, 9.0]))
    mpm.run.lanes(scene, friction=np.radians([20.0, 11.0]))
