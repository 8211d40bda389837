"""Failure modes of made-up slides whose class is known, and what must not change it."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cooperative.measure import ModeRules, ReleaseHistory, failure_mode
from jaxmpm import Face

SLOPE = Face(toe_x=54.0, toe_z=4.0, height=12.0)
LENGTH = 96.0
TIMES = np.arange(0.0, 20.5, 0.5)


@dataclass(frozen=True)
class Mass:
    """A bowl that slides: centre and half width along y [m], depth below the crest [m], start [s] and duration [s]."""

    y: float
    half_width: float
    depth: float
    start: float = 1.0
    lasts: float = 4.0
    distance: float = 10.0
    x: tuple[float, float] = (28.0, 60.0)


def lattice(spacing):
    axes = [np.arange(s / 2, high, s) for s, high in zip(spacing, (96.0, LENGTH, 16.0), strict=True)]
    x, y, z = (grid.ravel() for grid in np.meshgrid(*axes, indexing="ij"))
    top = np.clip(16.0 - (x - 30.0) / 2, 4.0, 16.0)
    inside = z < top
    return np.stack([x[inside], y[inside], z[inside]])


def slide(masses, spacing=(2.0, 2.0, 1.0), fine=1):
    """Particles of the slope, how they end and how they got there. `fine` splits each particle along every axis, its
    parts moving with it."""
    position = lattice(spacing)
    travelled = np.zeros((TIMES.size, position.shape[1]))
    for mass in masses:
        across = 1 - ((position[1] - mass.y) / mass.half_width) ** 2
        depth = mass.depth * np.sqrt(np.maximum(across, 0.0))
        inside = (position[2] > 16.0 - depth) & (mass.x[0] < position[0]) & (position[0] < mass.x[1])
        part = np.clip((TIMES - mass.start) / mass.lasts, 0.0, 1.0)
        path = mass.distance * part**2 * (3 - 2 * part)
        travelled[:, inside] = np.maximum(travelled[:, inside], path[:, None])
    spacing = np.asarray(spacing)
    offsets = (np.arange(fine) + 0.5) / fine - 0.5
    shifts = np.stack([g.ravel() for g in np.meshgrid(offsets, offsets, offsets, indexing="ij")]) * spacing[:, None]
    position = (position[:, :, None] + shifts[:, None, :]).reshape(3, -1)
    history = np.repeat(travelled, fine**3, axis=1)
    displacement = np.zeros_like(position)
    displacement[0] = history[-1]
    volume = np.full(position.shape[1], np.prod(spacing) / fine**3)
    return position, displacement, volume, spacing / 2 / fine, history


def motion_of(history, volume, times=TIMES):
    motion = ReleaseHistory.start(volume, 1.0)
    for time, displacement in zip(times[1:], history[1:], strict=True):
        motion = motion.after(float(time), displacement)
    return motion


def mode_of(masses, history=True, **kwargs):
    position, displacement, volume, half, travelled = slide(masses, **kwargs)
    past = {"motion": motion_of(travelled, volume)} if history else {}
    return failure_mode(position, displacement, volume, SLOPE, half_size=half, **past)


SHALLOW, DEEP = Mass(24.0, 16.0, 9.0), Mass(66.0, 22.0, 14.5)
KNOWN = {
    "none": [],
    "shallow": [SHALLOW],
    "shallow, just": [replace(SHALLOW, depth=12.0)],
    "deep": [DEEP],
    "deep, just": [replace(DEEP, depth=13.0)],
    "shallow, two side by side": [SHALLOW, replace(SHALLOW, y=70.0)],
    "deep, two side by side": [replace(DEEP, y=24.0), replace(DEEP, y=72.0)],
    "compound": [SHALLOW, DEEP],
    "compound, touching": [replace(SHALLOW, y=30.0), replace(DEEP, y=66.0)],
    "compound, at once": [replace(SHALLOW, start=1.5), DEEP],
    "progressive": [replace(SHALLOW, start=9.0), DEEP],
    "progressive, behind": [
        replace(SHALLOW, x=(38.0, 60.0)),
        Mass(24.0, 16.0, 9.0, start=8.0, x=(28.0, 38.0)),
    ],
    "shallow, a stray clod later": [SHALLOW, Mass(80.0, 3.0, 3.0, start=14.0)],
}


@pytest.mark.parametrize("name", KNOWN)
def test_made_up_slides_get_their_name(name):
    mode = mode_of(KNOWN[name])
    assert mode.name == name.split(",")[0]
    assert mode.depth.size == 48


@pytest.mark.parametrize(("valley", "pulses"), [(0.6, 1), (0.4, 2), (0.0, 2)])
def test_two_pulses_with_a_valley_below_half_of_the_lesser_are_progressive(valley, pulses):
    # Soil lets go at rates 2, `valley` and 1, each for three seconds, whether or not the first mass still runs.
    position, displacement, volume, half, history = slide([DEEP])
    gone = np.flatnonzero(history[-1] > 0)
    rates = np.repeat([2.0, valley, 1.0], 1200)
    onset = 1.0 + np.interp(
        (np.arange(gone.size) + 0.5) / gone.size * rates.sum(), np.cumsum(rates), np.arange(3600) / 400
    )
    times = np.arange(0.0, 12.05, 0.1)
    history = np.zeros((times.size, volume.size))
    history[:, gone] = np.maximum(times[:, None] - onset + 1.0, 0.0)
    mode = failure_mode(
        position, displacement, volume, SLOPE, half_size=half, motion=motion_of(history, volume, times=times)
    )
    assert mode.name == ("progressive" if pulses == 2 else "deep")
    assert len(mode.released) == pulses
    assert mode.released[0] == pytest.approx(1.0, abs=0.1)
    assert pulses == 1 or 4.0 < mode.released[1] < 7.2


def test_without_history_the_answer_says_what_it_lacks():
    mode = mode_of(KNOWN["progressive"], history=False)
    assert mode.name == "compound"
    assert "progressive failure cannot be recognised" in mode.notes[0]


def test_masses_and_depths_are_reported():
    mode = mode_of([SHALLOW, DEEP])
    assert len(mode.masses) == 2
    assert mode.masses[0] == pytest.approx(9.0, abs=1.01)
    assert mode.masses[1] == pytest.approx(14.5, abs=1.01)
    assert mode.depth[0] == 0.0
    assert mode.depth.max() == max(mode.masses)


def test_a_section_is_one_slice():
    position, displacement, volume, half, history = slide([DEEP])
    inside = np.isclose(position[1], 65.0)
    section = failure_mode(
        position[[0, 2]][:, inside],
        displacement[[0, 2]][:, inside],
        volume[inside],
        SLOPE,
        half_size=half[[0, 2]],
        motion=motion_of(history[:, inside], volume[inside]),
    )
    assert section.name == "deep"
    assert section.depth.shape == (1,)


bowls = st.builds(
    Mass,
    y=st.sampled_from([20.0, 30.0, 48.0, 66.0, 76.0]),
    half_width=st.sampled_from([8.0, 14.0, 18.0]),
    depth=st.sampled_from([6.0, 9.0, 11.0, 14.0]),
    start=st.sampled_from([0.5, 2.0, 6.0, 11.0]),
    lasts=st.sampled_from([2.0, 4.0]),
)


@settings(max_examples=30, deadline=None)
@given(st.lists(bowls, min_size=1, max_size=3), st.floats(-500, 500), st.booleans(), st.sampled_from([1, 2]))
def test_moving_mirroring_and_finer_sampling_leave_the_class_alone(masses, shift, mirror, fine):
    known = mode_of(masses)
    position, displacement, volume, half, history = slide(masses, fine=fine)
    if mirror:
        position, displacement = position * [[1], [-1], [1]], displacement * [[1], [-1], [1]]
    position = position + np.array([[shift], [2 * shift], [0.0]])
    geometry = replace(SLOPE, toe_x=SLOPE.toe_x + shift)
    mode = failure_mode(position, displacement, volume, geometry, half_size=half, motion=motion_of(history, volume))
    assert mode.name == known.name
    assert sorted(mode.masses) == pytest.approx(sorted(known.masses))
    assert mode.released == pytest.approx(known.released)


@settings(max_examples=8, deadline=None)
@given(st.floats(6.0, 11.0), st.floats(14.0, 15.5), st.sampled_from([(2.0, 2.0, 1.0), (1.0, 2.0, 0.5)]))
def test_the_lattice_does_not_name_the_mode(shallow, deep, spacing):
    masses = [replace(SHALLOW, depth=shallow), replace(DEEP, depth=deep)]
    assert mode_of(masses, spacing=spacing).name == "compound"
    assert mode_of(masses[:1], spacing=spacing).name == "shallow"
    assert mode_of(masses[1:], spacing=spacing).name == "deep"


def test_onset_is_interpolated_between_snapshots():
    history = np.array([[0.0, 0.0, 0.0], [0.5, 0.0, 2.0], [1.5, 0.0, 2.0]])
    motion = motion_of(history, np.ones(3), times=[0.0, 1.0, 2.0])
    np.testing.assert_allclose(motion.onset, [1.5, np.inf, 0.5])


@given(st.integers(0, 2**32 - 1), st.sampled_from([0.3, 0.7, 1.0]), st.integers(1, 6))
@settings(deadline=None, max_examples=25)
def test_onsets_are_those_of_each_particle_by_itself(seed, limit, looks):
    """Soil that comes back, stands, or lets go between the first two snapshots, in double precision on the host."""
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.uniform(0.05, 0.3, looks))
    moved = rng.uniform(0.0, 1.3 * limit, (looks, 50)).astype(np.float32)
    motion = ReleaseHistory.start(np.ones(50), limit)
    for time, now in zip(times, moved, strict=True):
        motion = motion.after(float(time), now)
    path = np.vstack([np.zeros(50), moved.astype(float)])
    for particle, onset in enumerate(motion.onset):
        gone = np.flatnonzero(path[:, particle] >= limit)
        if not gone.size:
            assert onset == np.inf
            continue
        (t0, t1), (a, b) = np.array([0.0, *times])[gone[0] - 1 :][:2], path[gone[0] - 1 :, particle][:2]
        assert onset == t0 + (limit - a) / (b - a) * (t1 - t0)
    assert np.array_equal(motion.moved, moved[-1])


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"position": np.zeros((4, 3))}, r"shape \(4, 3\)"),
        ({"volume": np.ones(2)}, "volume has shape"),
        ({"motion": ReleaseHistory.start(np.ones(2), 1.0)}, "motion is of 2 particles"),
        (
            {"motion": ReleaseHistory.start(np.ones(3), 0.5)},
            r"failure displacement 0.5 m: start it with the rules' 1 m",
        ),
    ],
)
def test_bad_input_is_named(change, match):
    good = {
        "position": np.zeros((3, 3)),
        "displacement": np.zeros((3, 3)),
        "volume": np.ones(3),
        "geometry": SLOPE,
        "half_size": np.ones(3),
        "motion": ReleaseHistory.start(np.ones(3), 1.0),
        "rules": ModeRules(),
    }
    with pytest.raises(ValueError, match=match):
        failure_mode(**{**good, **change})


def test_snapshots_come_in_order():
    with pytest.raises(ValueError, match="times do not ascend"):
        ReleaseHistory.start(np.ones(2), 1.0).after(1.0, np.zeros(2)).after(1.0, np.zeros(2))
