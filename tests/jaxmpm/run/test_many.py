"""Samples that differ in any parameters of their soil: the same as scenes built for each, in any company."""

from dataclasses import replace
from functools import partial

import jax
import numpy as np
import pytest

import jaxmpm as mpm
from jaxmpm.run import Hooks, SlidesEnd, lanes, repeat
from jaxmpm.run._advance import advance_lanes
from jaxmpm.run._batch import Batch, Sample
from jaxmpm.run._stopping import farthest, measured
from jaxmpm.setup import vary

SHAPE = mpm.Slope(crest=4, height=2, run_per_rise=1.0, toe=4, foundation=2)
CLAY = mpm.Soil(young=5e6, strength=9e3, softening_modulus=40e3, tension_cutoff=0.0)
NUMERICS = mpm.Discretisation(1.0, (0.5, 0.5))
VALUES = {"strength": [8e3, 4e3, 9e3, 5e3], "young": [5e6, 2e7, 2e6, 9e6], "unit_weight": [20e3, 18e3, 16e3, 22e3]}
VALUES |= {"softening_modulus": [4e4, 1e4, 8e4, 2e4], "residual_ratio": [0.5, 0.9, 0.4, 0.6]}
LONGER = SlidesEnd(1.0, displacement=0.1, time=2.0)


def built(**soil):
    return mpm.slope(SHAPE, replace(CLAY, **soil), NUMERICS)


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize(
    "soil",
    [{"young": 2e7}, {"poisson": 0.45, "young": 9e6}, {"unit_weight": 15e3}, {"bulk": 8e6}, {"softening_modulus": 3e4}],
)
def test_other_soil_is_the_scene_built_with_it(soil):
    scene, state = built()
    varied, start = mpm.with_soil(scene, state, **soil)
    if "bulk" in soil:
        bulk, shear = soil["bulk"], float(scene.material.shear)
        soil = {
            "young": 9 * bulk * shear / (3 * bulk + shear),
            "poisson": (3 * bulk - 2 * shear) / (6 * bulk + 2 * shear),
        }
    other, rest = built(**{name.replace(".", "_"): value for name, value in soil.items()})
    for ours, theirs in (
        (varied.material, other.material),
        (varied.particles, other.particles),
        (start.stress, rest.stress),
    ):
        assert jax.tree.all(jax.tree.map(lambda a, b: np.allclose(a, b, rtol=1e-7), ours, theirs))
    # The scene's own, or shorter than the speed of particles in it asks for, by less than that speed's share.
    assert float(varied.numerics.time_step) <= float(scene.numerics.time_step)
    alone = min(float(other.numerics.time_step), float(scene.numerics.time_step))
    assert 0.8 < float(varied.numerics.time_step) / alone < 1 + 1e-9


def test_a_state_without_stress_stays_without_and_a_displaced_one_is_refused():
    scene, state = mpm.column(2.0, CLAY, NUMERICS, at_rest=False)
    _, start = mpm.with_soil(scene, state, young=1e7)
    assert not np.any(start.stress)
    with pytest.raises(ValueError, match="but `state` has moved: give one at rest"):
        mpm.with_soil(scene, replace(state, velocity=state.velocity + 1), young=1e7)
    varied, same = mpm.with_soil(scene, replace(state, velocity=state.velocity + 1), strength=5e3)
    assert float(varied.material.strength) == 5e3
    assert np.all(same.velocity == 1)


def test_samples_of_any_soil_are_the_runs_of_their_own_scenes_in_any_company():
    scene, state = built()
    apart, together = (
        dict(mpm.solve_each(scene, state, VALUES, width=width, t_end=0.3, numbers=range(10, 14))) for width in (1, 3)
    )
    assert sorted(apart) == sorted(together) == [10, 11, 12, 13]
    for number, result in apart.items():
        assert result.status == mpm.Status.FINISHED
        assert np.array_equal(result.state.displacement, together[number].state.displacement)
        assert float(result.time_step) == float(together[number].time_step)
        assert 0.3 <= int(result.state.step) * float(result.time_step) < 0.45
        own, start = mpm.with_soil(scene, state, **{name: values[number - 10] for name, values in VALUES.items()})
        alone = mpm.advance(own, start, np.asarray(result.state.step))
        np.testing.assert_allclose(result.state.displacement, alone.displacement, rtol=1e-4, atol=1e-7)
    xla = jax.jit(mpm.advance)(
        replace(own, numerics=replace(own.numerics, engine=mpm.Engine.XLA)), start, np.asarray(result.state.step)
    )
    np.testing.assert_allclose(xla.displacement, alone.displacement, rtol=1e-4, atol=1e-6)
    assert len({float(result.time_step) for result in apart.values()}) == 4


def test_slides_go_on_where_others_end_and_from_any_point_bit_for_bit():
    scene, state = built()
    strengths, seen, settle = {"strength": [4e3, 30e3, 6e3, 30e3]}, {}, mpm.Settle(slides=0.1)

    def runs(t_end=LONGER, width=2, **hooks):
        choices = {"width": width, "t_end": t_end, "rules": [settle], "every": 0.1, "hooks": Hooks(**hooks)}
        return dict(mpm.solve_each(scene, state, strengths, **choices))

    whole = runs(observe=lambda n, t, midway: seen.setdefault((n, round(t, 6)), midway))
    short, alike = runs(t_end=1.0), runs(width=4)
    times = {n: int(r.state.step) * float(r.time_step) for n, r in whole.items()}
    farthest = {n: float(np.linalg.norm(r.state.displacement, axis=0).max()) for n, r in short.items()}
    assert [farthest[n] > 0.1 for n in range(4)] == [True, False, True, False]
    for number, result in whole.items():
        assert np.array_equal(result.state.displacement, alike[number].state.displacement)
        if farthest[number] <= 0.1:
            assert np.array_equal(result.state.displacement, short[number].state.displacement)
            assert result.status == short[number].status
            continue
        # A class is that of t_end: the slide passed it as the shorter run did.
        assert result.status == mpm.Status.FINISHED == short[number].status
        assert 2.0 <= times[number] < 2.2
        end = int(short[number].state.step) * float(result.time_step)
        assert np.array_equal(seen[number, round(end, 6)].state.displacement, short[number].state.displacement)
    # From a point before t_end or after it.
    for at in (0.5, 1.5):
        points = {n: min((t for m, t in seen if m == n and t >= at), default=None) for n in (0, 2)}
        again = runs(resume=lambda n, p=points: p.get(n) and seen[n, p[n]])
        for number in points:
            assert np.array_equal(again[number].state.displacement, whole[number].state.displacement)
    with pytest.raises(ValueError, match=r"slides' time = 0.5 s lies before t_end = 1 s"):
        SlidesEnd(1.0, 0.1, 0.5)


def test_what_a_rule_reads_of_a_lane_does_not_depend_on_how_many_there_are():
    scene, state = mpm.slope(SHAPE, CLAY, mpm.Discretisation(0.25, (0.125, 0.125)))
    start = mpm.solve(scene, state, t_end=0.1).state
    rules = (mpm.Settle(slides=1e-4, least_volume=0.5),)

    def readings(width):
        varied, axes = lanes(scene, strength=np.full(width, 9e3))
        lane = jax.tree.map(lambda leaf: leaf[0], measured(varied, repeat(start, width), axes, rules))
        return jax.tree.leaves((lane, farthest(varied, repeat(start, width), axes, 0.5)[0]))

    alone = jax.tree.leaves((measured(scene, start, None, rules), farthest(scene, start, None, 0.5)))
    assert float(alone[0]) > 0
    assert float(alone[2]) > 0
    assert [readings(width) for width in (1, 2, 24)] == [alone] * 3


def test_only_what_samples_differ_in_has_lanes():
    scene, state = built()
    samples = [Sample(i, *vary(scene, state, {"strength": 9e3 + i}), None) for i in range(3)]
    batch = Batch.of(scene, samples, t_end=1.0, every=0.25)
    lanes = [path for path, axis in jax.tree_util.tree_leaves_with_path(batch.axes) if axis == 0]
    assert [jax.tree_util.keystr(path) for path in lanes] == [".material.strength"]


@pytest.mark.parametrize(("backend", "expected"), [("gpu", [9, 9, 9, 9, 9, 3, 3, 3]), ("cpu", [9] * 8)])
def test_a_batch_has_two_widths_where_lanes_run_side_by_side_and_one_on_a_cpu(backend, expected, monkeypatch):
    scene, state = built()
    samples = [Sample(i, *vary(scene, state, {"strength": 9e3 + i}), None) for i in range(9)]
    batch, widths = Batch.of(scene, samples, t_end=1.0, every=0.25), []
    monkeypatch.setattr(jax, "default_backend", lambda: backend)
    for gone in range(8):
        batch = batch.refill(batch.numbers.index(gone), None).shrink(9)
        assert sorted(batch.number(lane) for lane in batch.busy) == list(range(gone + 1, 9))
        for lane in batch.busy:
            assert float(batch.scene.material.strength[lane]) == 9e3 + batch.number(lane)
        widths.append(len(batch.numbers))
    assert widths == expected


def test_values_are_drawn_one_by_one():
    scene, state = built()
    drawn = []

    def strengths():
        for i in range(4):
            drawn.append(i)
            yield 9e3 + i

    runs = mpm.solve_each(scene, state, {"strength": strengths()}, width=1, t_end=0.05)
    next(runs)
    assert drawn == [0]
    next(runs)
    assert drawn == [0, 1]
    unequal = mpm.solve_each(scene, state, {"strength": strengths(), "young": iter([5e6])}, width=1, t_end=0.05)
    with pytest.raises(ValueError, match=r"\['young'\] has 1 values, other names have more"):
        list(unequal)


def test_a_lane_alone_runs_without_the_selects_of_a_batch(monkeypatch):
    """Beside a CPU, where lanes run in turn: the loop of a batch selects the state of lanes that have ended."""
    scene, state = built()
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")

    def program(count):
        strength = np.full((count, scene.particles.mass.size), 9e3, np.float32)
        several, axes = lanes(scene, strength=strength)
        run = partial(advance_lanes.__wrapped__, axes=axes)
        arguments = several, repeat(state, count), np.full(count, 3)
        return str(jax.make_jaxpr(run)(*arguments)), jax.jit(run)(*arguments)

    (batch, two), (alone, one) = program(2), program(1)
    assert alone.count("select_n") < batch.count("select_n")
    for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(two), strict=True):
        np.testing.assert_allclose(a[0], b[0], rtol=1e-6, atol=1e-6 * np.abs(b).max())


def test_snapshots_of_each_sample_are_states_on_its_way():
    scene, _ = mpm.column(4.0, mpm.Soil(young=5e6, strength=9e3), mpm.Discretisation(cell=1.0, spacing=(0.5,)))
    still = mpm.unstressed(scene)
    strengths = [9e3, 20e3, 30e3]
    runs = dict(
        mpm.solve_each(
            scene, still, {"strength": strengths}, width=2, t_end=0.4, every=0.05, snapshots=[0.31, 0.1, 0.4]
        )
    )
    assert runs.keys() == {0, 1, 2}
    for number, result in runs.items():
        dt = float(result.time_step)
        assert list(result.times) == pytest.approx([0.1, 0.31, 0.4], abs=0.051)
        assert all(time >= due - dt for time, due in zip(result.times, [0.1, 0.31, 0.4], strict=True))
        for time, snapshot in zip(result.times, result.snapshots, strict=True):
            assert int(snapshot.step) * dt == pytest.approx(time)
        varied, start = mpm.with_soil(scene, still, strength=strengths[number])
        first = result.snapshots[0]
        known, _ = mpm.replay(varied, start, int(first.step))
        assert np.asarray(first.displacement) == pytest.approx(np.asarray(known.displacement), abs=1e-7)
        assert np.array_equal(result.snapshots[-1].displacement, result.state.displacement)


def test_a_sample_that_ends_early_keeps_its_last_state_and_a_bar_counts_samples(capsys):
    scene, state = mpm.column(4.0, mpm.Soil(young=5e6, strength=9e3), mpm.Discretisation(cell=1.0, spacing=(0.5,)))
    runs = mpm.solve_each(
        scene, state, {"strength": [9e3, 20e3]}, width=1, t_end=5.0, rules=[lambda scene, state: state.step > 60],
        snapshots=[4.9], progress=True,
    )  # fmt: skip
    for _, result in runs:
        assert result.times[0] == pytest.approx(float(result.state.step) * float(result.time_step))
        assert result.times[0] < 4.9
    assert "2/2" in capsys.readouterr().err


def test_snapshots_outside_the_run_are_refused():
    scene, state = mpm.column(4.0, mpm.Soil(young=5e6, strength=9e3), mpm.Discretisation(cell=1.0, spacing=(0.5,)))
    with pytest.raises(ValueError, match=r"snapshots at \[2.0\] s lie outside the run"):
        next(mpm.solve_each(scene, state, {"strength": [9e3]}, width=1, t_end=1.0, snapshots=[2.0]))
