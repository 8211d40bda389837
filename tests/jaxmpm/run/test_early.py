"""The early rule against motions in closed form, and on slopes: the same class sooner, in any company."""

from dataclasses import replace

import numpy as np
import pytest

import jaxmpm as mpm
from jaxmpm.run import Early, Hooks
from jaxmpm.run._early import START
from jaxmpm.run._stopping import measured

SHAPE = mpm.Slope(crest=4, height=2, run_per_rise=1.0, toe=4, foundation=2)
CLAY = mpm.Soil(young=5e6, strength=9e3, softening_modulus=40e3, tension_cutoff=0.0)
NUMERICS = mpm.Discretisation(1.0, (0.5, 0.5))
WINDOW, STOP = 0.25, 1.0
EARLY = Early(horizon=20.0, displacement=STOP)
RULES = [mpm.Settle(slides=0.5), mpm.Exceeds(0.5)]
WITH = [*RULES, Early(horizon=10.0, displacement=0.5)]


def judged(displacement, strain=None, until=30.0):
    """Class and time (s) by the rule of a motion, looked at each window; "" if it stays open."""
    memory = START
    for time in np.arange(1, round(until / WINDOW) + 1) * WINDOW:
        displaced = np.asarray(displacement(time))
        plastic = displaced if strain is None else np.asarray(strain(time))
        memory, stands, speeds_up = EARLY.judged(memory, WINDOW, np.asarray(0.2), plastic, displaced)
        if stands:
            return "stands", time
        if speeds_up and EARLY.projected(displaced, time) > STOP:
            return "fails", time
    return "", until


@pytest.mark.parametrize("acceleration", [0.1, 1.0, 5.0])
def test_a_block_beyond_its_limit_fails_once_its_mean_speed_would_take_it_there(acceleration):
    """a t^2 / 2 at the horizon's mean speed a t / 2 * 20 s exceeds 1 m from t = 0.1 / a on."""
    verdict, time = judged(lambda t: acceleration * t**2 / 2)
    assert verdict == "fails"
    assert time == pytest.approx(max(2 * WINDOW, np.ceil(0.1 / acceleration / WINDOW + 1e-9) * WINDOW))


@pytest.mark.parametrize("deceleration", [0.2, 1.0])
def test_a_block_below_its_limit_that_was_pushed_stands_once_it_has_stopped(deceleration):
    stop = 0.4 / deceleration

    def displaced(t):
        t = min(t, stop)
        return 0.4 * t - deceleration * t**2 / 2

    verdict, time = judged(displaced)
    assert verdict == "stands"
    assert stop - WINDOW <= time <= stop + 2 * WINDOW


@pytest.mark.parametrize("rate", [0.5, 1.0, 3.0, 6.0])
@pytest.mark.parametrize("share", [-0.3, -0.01, -1e-3, 1e-3, 0.01, 0.3])
def test_a_block_on_softening_ground_gets_the_class_of_its_growing_part(rate, share):
    """v = A exp(l t) + B exp(-l t), A / B = share, until it stops: it fails if A > 0, and is known by then."""
    stop = np.inf if share > 0 else np.log(1 / -share) / (2 * rate)

    def displaced(t):
        t = min(t, stop)
        return 0.1 * (share * (np.exp(rate * t) - 1) + 1 - np.exp(-rate * t)) / rate

    verdict, time = judged(displaced)
    assert verdict == ("fails" if share > 0 else "stands")
    ordinary = np.log(1 + 10 * rate / share) / rate if share > 0 else stop  # passes 1 m, or has stopped
    assert time <= ordinary + 2 * WINDOW


@pytest.mark.parametrize("frequency", [2.0, 5.0, 13.0])
@pytest.mark.parametrize("phase", [0.0, 2.0])
def test_what_rings_after_it_has_yielded_once_stands(frequency, phase):
    def rings(t):
        return 0.02 * (1 - np.exp(-8 * t)) + 1e-3 * np.sin(frequency * t + phase)

    verdict, time = judged(rings, strain=lambda t: 0.01 * (1 - np.exp(-8 * t)))
    assert verdict == "stands"
    assert time <= 2.0


@pytest.mark.parametrize("share", [0.1, 0.3, 1.0])
def test_a_block_that_goes_on_at_a_share_of_its_speed_stays_open_though_it_strains_no_more(share):
    speed = 0.03

    def displaced(t):
        return speed * (share * t + (1 - share) * (1 - np.exp(-t)))

    verdict, _ = judged(displaced, strain=lambda t: 0.01 * (1 - np.exp(-8 * t)))
    assert verdict == ""


def test_a_window_lasts_half_an_oscillation_and_looks_within_it_only_add_up():
    rng = np.random.default_rng(1)
    memory = once = np.stack([START] * 3, axis=1)
    for _ in range(5):
        strain, displaced = rng.uniform(size=(2, 3))
        once, *answer = EARLY.judged(once, 0.25, np.full(3, 0.25), strain, displaced)
        for elapsed in (0.1, 0.15):
            memory, *parts = EARLY.judged(memory, elapsed, np.full(3, 0.25), strain, displaced)
        np.testing.assert_allclose(memory, once)
        np.testing.assert_array_equal(parts, answer)


def test_slopes_get_the_same_class_sooner_in_any_company():
    scene, state = mpm.slope(SHAPE, CLAY, NUMERICS)
    strengths = {"strength": [4e3, 6e3, 7e3, 9e3, 3e4]}

    def outcome(rules, width):
        runs = mpm.solve_each(scene, state, strengths, width=width, t_end=10.0, rules=rules, every=0.1)
        return dict(sorted(runs))

    plain, one, three = outcome(RULES, 1), outcome(WITH, 1), outcome(WITH, 3)
    assert {int(result.status) for result in plain.values()} == {mpm.Status.SETTLED, mpm.Status.DECIDED}
    for number, result in one.items():
        assert int(result.status) == int(plain[number].status)
        assert int(result.state.step) <= int(plain[number].state.step)
        assert int(result.state.step) == int(three[number].state.step)
        np.testing.assert_array_equal(result.state.displacement, three[number].state.displacement)
    assert sum(int(r.state.step) for r in one.values()) < 0.7 * sum(int(r.state.step) for r in plain.values())


def test_a_run_goes_on_with_the_memory_of_its_rule():
    scene, state = mpm.slope(SHAPE, CLAY, NUMERICS)
    seen, choices = [], {"width": 1, "t_end": 10.0, "rules": WITH, "every": 0.1}
    ((_, whole),) = mpm.solve_each(
        scene, state, {"strength": [6e3]}, hooks=Hooks(observe=lambda *each: seen.append(each[-1])), **choices
    )
    assert len(seen) > 2
    ((_, resumed),) = mpm.solve_each(
        scene, state, {"strength": [6e3]}, hooks=Hooks(resume=lambda _: seen[0]), **choices
    )
    assert int(resumed.state.step) == int(whole.state.step)


def test_the_rule_is_absent_from_the_compiled_look_where_it_is_off():
    scene, state = mpm.slope(SHAPE, CLAY, NUMERICS)
    off, on = (measured.lower(scene, state, None, tuple(rules)).compile().as_text() for rules in (RULES, WITH))
    # Plastic strain, shear modulus and volume are no arguments of the program without.
    assert off.count("parameter(") < on.count("parameter(")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"soil": {"softening_modulus": None}}, "the rule Early needs plastic strain, and J2 has none"),
        ({"strained": 0.1}, "the rule Early counts plastic strain from 0, and the state has some"),
    ],
)
def test_runs_that_lack_what_the_rule_needs_are_refused(change, message):
    scene, state = mpm.slope(SHAPE, replace(CLAY, **change.get("soil", {})), NUMERICS)
    if "strained" in change:
        state = replace(state, history=state.history + change["strained"])
    with pytest.raises(ValueError, match=message):
        mpm.solve(scene, state, t_end=1.0, rules=WITH)


@pytest.mark.parametrize(
    ("numbers", "message"),
    [
        ({"horizon": 0.0}, "early's horizon"),
        ({"displacement": 0.0}, "early's displacement"),
        ({"decay": 1.0}, "early's decay"),
        ({"growth": 1.0}, "early's growth - 1"),
    ],
)
def test_numbers_out_of_range_are_refused(numbers, message):
    with pytest.raises(ValueError, match=message):
        Early(**{"horizon": 20.0, "displacement": 1.0, **numbers})
