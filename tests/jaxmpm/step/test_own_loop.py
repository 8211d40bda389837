"""A loop of one's own around `step`: it knows the time, and a lane that breaks off says so."""

from dataclasses import fields, is_dataclass, replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxmpm as mpm
from jaxmpm import laws
from jaxmpm.laws import declared, element_test, with_parameters

SHAPE = mpm.Slope(crest=4, height=4, run_per_rise=1.0, toe=8, foundation=2)
SOIL = mpm.Soil(young=5e6, strength=9e3, softening_modulus=40e3)


@pytest.fixture(scope="module")
def section():
    return mpm.slope(SHAPE, SOIL, mpm.Discretisation(1.0, (0.5, 0.5)), at_rest=False)


@partial(jax.jit, static_argnames="steps")
def looped(scene, state, steps, dt=None):
    """The loop that anybody writes."""
    return jax.lax.scan(
        lambda s, _: (mpm.step(scene, s, scene.numerics.time_step if dt is None else dt), None), state, None, steps
    )[0]


def pushed(x, t):
    return jnp.stack([jnp.where(t > 0.1, 8.0, 0.0) * jnp.ones_like(x[0]), jnp.zeros_like(x[1])])


def test_a_loop_of_steps_is_advance_and_knows_the_time_of_a_load(section):
    scene, state = section
    scene = replace(scene, loads=replace(scene.loads, body_force=pushed, gravity=0 * scene.loads.gravity))
    steps = 40
    assert steps * float(scene.numerics.time_step) > 0.15
    own, ours = looped(scene, state, steps), mpm.advance(scene, state, jnp.asarray(steps))
    assert (int(own.step), int(own.status)) == (steps, mpm.Status.RUNNING)
    assert float(mpm.diagnostics.largest_displacement(own)) > 1e-3
    jax.tree.map(partial(np.testing.assert_allclose, rtol=1e-4, atol=1e-4), own.displacement, ours.displacement)


def test_a_strength_that_is_not_a_number_does_not_stand(section):
    scene, state = section
    strength = jnp.full_like(scene.particles.mass, 9e3).at[3].set(jnp.nan)
    spoilt = replace(scene, material=replace(scene.material, strength=strength))
    after = looped(spoilt, state, 3)
    assert int(after.status) == mpm.Status.NOT_FINITE
    assert not np.isfinite(np.asarray(after.velocity)).all()


NUMBERS = (
    *("loads.gravity", "numerics.flip", "numerics.damping", "boundary.friction", "boundary.cohesion"),
    *("particles.mass", "particles.volume"),
)


def test_no_number_of_a_scene_that_is_not_one_stands():
    drawn = mpm.Section([(0, 4), (4, 4), (8, 2), (12, 2)], interface=mpm.Interface(20.0, cohesion=1e3))
    numerics = mpm.Discretisation(1.0, (0.5, 0.5), flip=0.99, damping=0.1)
    scene, state = mpm.section(drawn, SOIL, numerics, at_rest=False)
    assert int(looped(scene, state, 4).status) == mpm.Status.RUNNING
    stood = []
    for name in NUMBERS:
        part, _, field = name.partition(".")
        owner = getattr(scene, part)
        value = getattr(owner, field)
        spoilt = replace(owner, **{field: value.at[..., -1].set(jnp.nan) if value.ndim else value * jnp.nan})
        after = looped(replace(scene, **{part: spoilt}), state, 4)
        stood += [] if int(after.status) == mpm.Status.NOT_FINITE else [name]
    assert stood == []


def test_steps_that_are_too_long_say_so(section):
    scene, state = section
    after = looped(scene, state, 200, dt=5 * scene.numerics.time_step)
    assert int(after.status) == mpm.Status.TIME_STEP_TOO_LARGE
    assert int(looped(scene, state, 3, dt=1.5 * scene.numerics.time_step).status) == mpm.Status.RUNNING


def test_a_lane_that_broke_off_keeps_its_status_and_its_neighbours_theirs(section):
    scene, state = section
    velocity = jnp.stack([state.velocity, state.velocity.at[0, 0].set(1e4)])
    both = replace(mpm.run.repeat(state, 2), velocity=velocity)
    after = jax.vmap(lambda s: looped(scene, s, 5))(both)
    assert after.status[0] == mpm.Status.RUNNING
    assert after.status[1] > mpm.Status.DECIDED
    np.testing.assert_allclose(after.displacement[0], looped(scene, state, 5).displacement, atol=1e-6)


def test_a_lane_that_had_ended_goes_on_and_can_break_off(section):
    scene, state = section
    ended = replace(state, status=jnp.asarray(int(mpm.Status.FINISHED), jnp.int32))
    assert int(looped(scene, ended, 1).status) == mpm.Status.RUNNING
    assert int(looped(scene, replace(ended, velocity=state.velocity * jnp.nan), 1).status) == mpm.Status.NOT_FINITE


def number(value):
    return jnp.asarray(value, jnp.float32)


MODULI = number(5e6), number(2e6)
FRICTION = number(5e3), number(0.5), number(0.1)
SOFTER = laws.FrictionalSoftening(number(1e3), number(0.3), number(0.1))
REMOULDED = laws.ExponentialSoftening(number(0.5), number(0.1))
EVERY = {
    "elastic": laws.Elastic(*MODULI),
    "linear": laws.J2(*MODULI, number(9e3), laws.Softening(number(4e4), number(0.5)), number(0.0)),
    "exponential": laws.J2(*MODULI, number(9e3), REMOULDED, None, laws.RateEffect(number(0.1), number(1e-3))),
    "viscous": laws.J2(*MODULI, number(9e3), None, None, None, True, number(1e3)),
    "cone": laws.DruckerPrager(*MODULI, *FRICTION, SOFTER, number(0.0)),
    "pyramid": laws.MohrCoulomb(*MODULI, *FRICTION, SOFTER, number(0.0)),
    "clay": laws.ModifiedCamClay(*MODULI, *map(number, (0.1, 0.02, 1.0, 1.0, 1e3))),
    "anisotropic": laws.AnisotropicUndrained(*MODULI, *map(number, (9e3, 8e3, 7e3, 0.05))),
    "grains": laws.MuI(*MODULI, *map(number, (0.3, 0.5, 0.28, 1e-3, 2500.0))),
}
"""A law of each kind, with every part that it may have."""


def test_there_is_a_law_of_each_kind():
    kinds = {law for law in vars(laws).values() if isinstance(law, type) and issubclass(law, laws.Law)} - {laws.Law}
    assert {type(law) for law in EVERY.values()} == kinds
    parts = {type(getattr(law, f.name)) for law in EVERY.values() for f in fields(law)}
    assert {p for p in parts if is_dataclass(p)} == {
        *(laws.Softening, laws.ExponentialSoftening, laws.FrictionalSoftening, laws.RateEffect)
    }


@pytest.mark.parametrize("name", EVERY)
def test_a_number_that_is_not_one_reaches_the_stress_of_any_law(name):
    law = EVERY[name]
    known = declared(law)
    # Strained well beyond yield, in compression with shear, and apart at the end.
    one = jnp.ones(1)
    given = jnp.asarray([[-2e-3, 0.0, -1e-3, 0.0, 0.0, 8e-3]] * 4 + [[2e-2, 0.0, 2e-2, 0.0, 0.0, 1e-2]])

    def strained(values):
        varied = with_parameters(law, values)
        particles = mpm.Particles(jnp.ones((3, 1)), one, one)
        start = tuple(-1e4 * one if k < 3 else 0 * one for k in range(6))
        history = varied.history_at_rest(varied.initial_history(particles), start)

        def one_step(carry, increment):
            after = varied.update(tuple(increment[:, None]), *carry, number(1e-3))
            return after, jnp.stack(after[0])

        return jax.lax.scan(one_step, (start, history), given)[1]

    values = jnp.asarray([number.value for number in known.values()])
    lanes = jnp.where(jnp.eye(len(known), dtype=bool), jnp.nan, values)
    stress = jax.jit(jax.vmap(lambda row: strained(dict(zip(known, row, strict=True)))))(lanes)
    finite = np.isfinite(np.asarray(stress)).all(axis=(1, 2, 3))
    assert not [name for name, hidden in zip(known, finite, strict=True) if hidden]
    assert np.isfinite(np.asarray(jax.jit(strained)(dict(zip(known, values, strict=True))))).all()


def test_a_number_that_is_not_one_is_refused_by_an_element_test():
    with pytest.raises(ValueError, match="strength = nan"):
        element_test(laws.J2(*MODULI, number(np.nan)), "oedometer", pressure=1e4, strain=0.01)
