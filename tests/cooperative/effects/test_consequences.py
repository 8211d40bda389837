"""Consequences of slides whose measures are known by hand, and their independence of the sampling."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from cooperative.measure import OpenGround, Track, consequences, walls_reached
from cooperative.measure._consequences import _joined
from jaxmpm import Face

# Crest level 16 m, toe at x = 54 m and z = 4 m, as in the published slope.
SLOPE = Face(toe_x=54.0, toe_z=4.0, height=12.0)


def block(low, high, spacing):
    """Particles that fill a box: positions (d, N), volumes (N,), half sizes (d,)."""
    axes = [np.arange(a + s / 2, b, s) for a, b, s in zip(low, high, spacing, strict=True)]
    position = np.stack([a.ravel() for a in np.meshgrid(*axes, indexing="ij")])
    return position, np.full(position.shape[1], np.prod(spacing)), np.asarray(spacing) / 2


def slide_3d(spacing, move=(10.0, 0.0, -2.0), shift=0.0):
    """A 10 x 20 x 8 m block that slides, beside and above soil that stays."""
    low, high = (46.0, 30.0 + shift, 4.0), (56.0, 50.0 + shift, 12.0)
    position, volume, half = block(low, high, spacing)
    rest, rest_volume, _ = block((20.0, 0.0 + shift, 0.0), (46.0, 96.0 + shift, 4.0), spacing)
    displacement = np.zeros((3, position.shape[1] + rest.shape[1]))
    displacement[:, : position.shape[1]] = np.array(move)[:, None]
    displacement[0, position.shape[1] :] = 0.3
    return np.hstack([position, rest]), displacement, np.concatenate([volume, rest_volume]), half


def test_a_block_in_3d_by_hand():
    position, displacement, volume, half = slide_3d((1.0, 2.0, 1.0))
    got = consequences(position, displacement, volume, SLOPE, half_size=half)
    assert got.displacement == pytest.approx(np.hypot(10, 2))
    assert got.depth == pytest.approx(12.0)
    assert got.runout == pytest.approx(12.0)
    assert got.volume == pytest.approx(10 * 20 * 8)
    assert got.area == pytest.approx(12 * 20)


def test_the_same_block_in_a_section_is_per_width():
    position, displacement, volume, half = slide_3d((1.0, 2.0, 1.0))
    inside = np.isclose(position[1], 31.0)
    section = (position[[0, 2]][:, inside], displacement[[0, 2]][:, inside], volume[inside] / 2.0, SLOPE)
    got = consequences(*section, half_size=half[[0, 2]])
    assert (got.volume, got.area, got.runout) == pytest.approx((80.0, 12.0, 12.0))
    whole = consequences(position, displacement, volume, SLOPE, half_size=half)
    wide = got.as_row() | {"volume": 20.0 * got.volume, "area": 20.0 * got.area}
    assert wide == pytest.approx(whole.as_row())


def test_a_deep_slide_reaches_below_the_toe():
    position, volume, half = block((40.0, 2.0), (60.0, 14.0), (1.0, 1.0))
    got = consequences(position, np.full(position.shape, 2.0), volume, SLOPE, half_size=half)
    assert got.depth == pytest.approx(14.0)
    assert got.depth > SLOPE.height


def test_a_slide_that_stops_on_the_slope_has_no_runout():
    position, volume, half = block((40.0, 10.0), (45.0, 12.0), (1.0, 1.0))
    got = consequences(position, np.full(position.shape, 2.0), volume, SLOPE, half_size=half)
    assert (got.runout, got.area) == (0.0, 0.0)
    assert got.volume == pytest.approx(10.0)


def test_a_standing_slope_has_only_its_displacement():
    position, volume, half = block((40.0, 10.0), (45.0, 12.0), (1.0, 1.0))
    got = consequences(position, np.full(position.shape, 0.1), volume, SLOPE, half_size=half)
    length = np.hypot(0.1, 0.1)
    nothing = dict.fromkeys(("depth", "runout", "volume", "area", "runout_foremost", "runout_any"), 0.0)
    assert got.as_row() == pytest.approx({"displacement": length, "displacement_any": length, **nothing})


@pytest.mark.parametrize("dimension", [2, 3])
def test_grains_that_came_off_do_not_decide(dimension):
    axes = [0, 2] if dimension == 2 else [0, 1, 2]
    low, high, spacing = (np.array(v)[axes] for v in ((40.0, 0.0, 4.0), (56.0, 4.0, 12.0), (1.0, 1.0, 1.0)))
    position, volume, half = block(low, high, spacing)
    displacement = np.zeros(position.shape)
    displacement[0] = 10.0
    whole = consequences(position, displacement, volume, SLOPE, half_size=half, reach=1.5)
    assert (whole.displacement, whole.runout) == (whole.displacement_any, whole.runout_any)
    front = np.argmax(position[0])
    displacement[0, front] += 0.4
    still_there = consequences(position, displacement, volume, SLOPE, half_size=half, reach=1.5)
    assert still_there.runout == pytest.approx(whole.runout + 0.4)
    displacement[0, front] += 20.0
    gone = consequences(position, displacement, volume, SLOPE, half_size=half, reach=1.5)
    assert (gone.displacement, gone.runout) == (whole.displacement, whole.runout)
    assert (gone.displacement_any, gone.runout_any) == pytest.approx((30.4, whole.runout + 20.4))
    assert (gone.volume, gone.depth) == (whole.volume, whole.depth)
    assert gone.area <= whole.area
    plain = consequences(position, displacement, volume, SLOPE, half_size=half, runout_thickness=0.0)
    assert (plain.displacement, plain.runout) == (gone.displacement_any, gone.runout_any)


def test_a_second_mass_counts_and_the_largest_always_does():
    position, volume, half = block((40.0, 4.0), (56.0, 12.0), (1.0, 1.0))
    displacement = np.zeros(position.shape)
    displacement[0] = np.where(position[0] > 54.0, 30.0, 10.0)
    got = consequences(position, displacement, volume, SLOPE, half_size=half, reach=1.5)
    assert got.displacement == 30.0
    apart = np.stack([10.0 * np.arange(400), np.full(400, 10.0)])
    spread = consequences(apart, np.full(apart.shape, 2.0), np.ones(400), SLOPE, half_size=half, reach=1.5)
    assert spread.volume == 400.0
    assert spread.runout == spread.runout_any


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("spacing", [0.25, 0.5])
def test_a_thin_tongue_ahead_of_the_deposit_does_not_decide(dimension, spacing):
    axes = [0, 2] if dimension == 2 else [0, 1, 2]
    steps = np.full(dimension, spacing)
    deposit, volume, half = block(np.array([60.0, 0.0, 0.0])[axes], np.array([70.0, 4.0, 2.0])[axes], steps)
    tongue, thin, _ = block(np.array([70.0, 0.0, 0.0])[axes], np.array([80.0, 4.0, spacing])[axes], steps)
    position, volume = np.concatenate([deposit, tongue], axis=1), np.concatenate([volume, thin])
    moved = np.zeros(position.shape)
    moved[0] = 20.0
    runs = {
        least: consequences(position - moved, moved, volume, SLOPE, half_size=half, runout_thickness=least)
        for least in (0.0, spacing / 2, 1.0, 3.0)
    }
    assert {run.runout_foremost for run in runs.values()} == {runs[0.0].runout}
    assert runs[spacing / 2].runout == runs[0.0].runout == pytest.approx(80 - SLOPE.toe_x)
    assert runs[1.0].runout == pytest.approx(70 - SLOPE.toe_x)
    assert runs[3.0].runout == 0


@given(st.floats(0.0, 3.0), st.floats(0.0, 3.0), st.integers(0, 1000))
def test_a_thicker_front_lies_nowhere_farther(one, other, seed):
    rng = np.random.default_rng(seed)
    position, volume, half = block((40.0, 4.0), (56.0, 12.0), (1.0, 1.0))
    displacement = np.stack([rng.uniform(2, 30, volume.size), np.zeros(volume.size)])
    thin, thick = (
        consequences(position, displacement, volume, SLOPE, half_size=half, runout_thickness=least).runout
        for least in sorted((one, other))
    )
    assert thick <= thin


@pytest.mark.parametrize("least", [-1.0, np.nan, np.inf])
def test_a_thickness_that_is_none_is_refused(least):
    position, volume, half = block((40.0, 10.0), (45.0, 12.0), (1.0, 1.0))
    with pytest.raises(ValueError, match=r"runout_thickness = .*: give metres from 0 on"):
        consequences(position, np.zeros(position.shape), volume, SLOPE, half_size=half, runout_thickness=least)


def test_the_threshold_is_the_callers():
    position, volume, half = block((40.0, 10.0), (45.0, 12.0), (1.0, 1.0))
    got = consequences(position, np.full(position.shape, 0.1), volume, SLOPE, half_size=half, failure_displacement=0.1)
    assert got.volume == pytest.approx(10.0)


@given(
    st.sampled_from([(1.0, 2.0, 1.0), (0.5, 0.5, 0.5), (1.0, 1.0, 0.5)]),
    st.floats(1.0, 30.0),
    st.floats(-3.0, 0.0),
)
def test_finer_sampling_changes_nothing(spacing, along, down):
    coarse = slide_3d((1.0, 2.0, 1.0), (along, 0.0, down))
    fine = slide_3d(spacing, (along, 0.0, down))
    rows = [consequences(*case[:3], SLOPE, half_size=case[3]).as_row() for case in (coarse, fine)]
    assert rows[0] == pytest.approx(rows[1], rel=1e-9)


@given(st.integers(-100, 100), st.booleans())
def test_moving_or_mirroring_across_the_slope_changes_nothing(shift, mirror):
    position, displacement, volume, half = slide_3d((1.0, 2.0, 1.0), shift=float(shift))
    if mirror:
        position, displacement = position * [[1], [-1], [1]], displacement * [[1], [-1], [1]]
    got = consequences(position, displacement, volume, SLOPE, half_size=half)
    here = slide_3d((1.0, 2.0, 1.0))
    assert got.as_row() == pytest.approx(consequences(*here[:3], SLOPE, half_size=here[3]).as_row())


@given(move=st.floats(-3.0, 30.0), drop=st.floats(-6.0, 0.0))
def test_a_slope_that_faces_left_has_the_consequences_of_its_mirror_image(move, drop):
    position, displacement, volume, half = slide_3d((1.0, 2.0, 1.0), (move, 0.0, drop))
    turn = np.array([-1.0, 1.0, 1.0])[:, None]
    left = Face(-SLOPE.toe_x, SLOPE.toe_z, SLOPE.height, downhill=-1)
    images = (turn * position, turn * displacement, volume, left)
    got = consequences(*images, half_size=half)
    assert got.as_row() == pytest.approx(consequences(position, displacement, volume, SLOPE, half_size=half).as_row())


def test_a_curved_front_is_integrated():
    # Fronts on a parabola 12 (1 - (y/20)^2) over y in [-20, 20]: area 320 m2.
    errors = []
    for spacing in (2.0, 1.0, 0.5):
        y = np.arange(-20 + spacing / 2, 20, spacing)
        position = np.stack([np.full(y.size, 54 - spacing / 2), y, np.full(y.size, 5.0)])
        displacement = np.zeros_like(position)
        displacement[0] = 12 * (1 - (y / 20) ** 2)
        got = consequences(
            position,
            displacement,
            np.ones(y.size),
            SLOPE,
            half_size=np.full(3, spacing / 2),
            failure_displacement=1e-6,
        )
        errors.append(abs(got.area - 320.0))
    assert errors[0] > errors[1] > errors[2]
    assert errors[2] < 0.1


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"position": np.zeros((4, 2))}, r"shape \(4, 2\)"),
        ({"displacement": np.zeros((2, 3))}, "displacement has shape"),
        ({"volume": np.zeros(3)}, "volume has shape"),
        ({"half_size": np.zeros(3)}, "half_size has shape"),
        ({"displacement": np.full((2, 2), np.nan)}, "displacement is not finite"),
        ({"slice_width": 0.0}, "slice_width = 0.0"),
        ({"reach": 0.0}, "reach = 0.0"),
        ({"failure_displacement": -1.0}, "failure_displacement = -1.0"),
    ],
)
def test_bad_input_is_named(change, match):
    good = {
        "position": np.zeros((2, 2)),
        "displacement": np.zeros((2, 2)),
        "volume": np.ones(2),
        "geometry": SLOPE,
        "half_size": np.ones(2),
    }
    with pytest.raises(ValueError, match=match):
        consequences(**{**good, **change})


def test_on_open_ground_nothing_needs_a_toe():
    # A layer 2 m thick and 6 m long on ground that falls by 1 in 4 moves 10 m along x; a row below it stays.
    x, z = (each.ravel() for each in np.meshgrid(np.arange(0.5, 6), np.arange(-2.5, 0)))
    position = np.stack([x, z - x / 4])
    along_x = np.where(z > -2, 10.0, 0.2)
    got = consequences(
        position, np.stack([along_x, -along_x / 4]), np.ones(x.size), OpenGround(-x / 4), half_size=np.full(2, 0.5)
    )
    assert got.displacement == pytest.approx(10 * np.hypot(1, 0.25))
    assert (got.depth, got.runout, got.area, got.volume) == pytest.approx((2.0, 16.0, 16.0, 12.0))


def test_on_open_ground_the_run_out_follows_the_slide():
    # A slab of 8 x 4 m slides 6 m towards (-3, 4) / 5; turned or not, it has the same numbers.
    x, y, z = (each.ravel() for each in np.meshgrid(np.arange(0.5, 8), np.arange(0.5, 4), [-0.5]))
    for along in ((1.0, 0.0), (0.0, -1.0)):
        across = (-along[1], along[0])
        position = np.stack([along[0] * x + across[0] * y, along[1] * x + across[1] * y, z])
        displacement = np.stack([6.0 * along[0] + 0 * x, 6.0 * along[1] + 0 * x, 0 * x])
        got = consequences(position, displacement, np.ones(x.size), OpenGround(0 * x), half_size=np.full(3, 0.5))
        assert (got.runout, got.depth, got.area) == pytest.approx((14.0, 1.0, 32.0))


@pytest.mark.parametrize("backwards", [False, True])
def test_the_run_out_follows_the_line_that_is_drawn(backwards):
    # A slab of 4 x 2 m comes down along x and turns into a valley along y; the line may be drawn from either end.
    line = [(0.0, 1.0), (20.0, 1.0), (20.0, 31.0)]
    x, y = (each.ravel() for each in np.meshgrid(np.arange(0.5, 4), np.arange(0.5, 2)))
    position = np.stack([x + 3, y, 0 * x])
    turned = np.stack([20 + (1 - y), 8 + x, 0 * x])
    ground = OpenGround(0 * x, Track(tuple(line[::-1] if backwards else line)))
    got = consequences(position, turned - position, np.ones(x.size), ground, half_size=np.full(3, 0.5))
    # From x = 3 m to the corner, and from there to y = 12 m.
    assert got.runout == pytest.approx(17.0 + 11.0)
    straight = consequences(position, turned - position, np.ones(x.size), OpenGround(0 * x), half_size=np.full(3, 0.5))
    assert straight.runout < got.runout - 3


def test_a_line_goes_on_beyond_its_ends():
    distance, direction = Track(((0.0, 0.0), (3.0, 4.0))).along(np.array([[-3.0, 6.0, 1.5], [-4.0, 8.0, 2.0]]))
    assert np.allclose(distance, [-5.0, 10.0, 2.5])
    assert np.allclose(direction, np.array([[0.6], [0.8]]))


@pytest.mark.parametrize(
    ("points", "message"),
    [
        ([(0, 0)], "give two or more points"),
        ([(0, 0), (1, np.nan)], "give two or more points"),
        ([(0, 0), (2, 1), (2, 1), (3, 3)], r"has the point \(2, 1\) m twice in a row"),
        ([(0, 0), (4, 0), (2, 2), (2, -2)], "crosses itself"),
    ],
)
def test_lines_that_have_no_order_are_refused(points, message):
    with pytest.raises(ValueError, match=message):
        Track(tuple(points))
    section = OpenGround(np.zeros(2), Track(((0.0, 0.0), (1.0, 0.0))))
    with pytest.raises(ValueError, match="for ground in 3D: leave it out in a section"):
        consequences(np.zeros((2, 2)), np.zeros((2, 2)), np.ones(2), section, half_size=np.ones(2))


def test_walls_that_a_slide_reached_or_left_are_named():
    position = np.stack([np.arange(0.5, 10), np.full(10, 0.5)])
    walls = ((0, -1, 0.0), (0, 1, 20.0))

    def reached(first, last, by):
        along_x = np.where((np.arange(10) >= first) & (np.arange(10) <= last), by, 0.0)
        return walls_reached(
            position, np.stack([along_x, 0 * along_x]), np.ones(10), walls,
            half_size=np.full(2, 0.5), failure_displacement=1.0, within=1.0,
        )  # fmt: skip

    assert reached(3, 6, 5.0) == ""
    assert reached(0, 6, 5.0) == "x = 0 m"
    assert reached(3, 9, 9.5) == "x = 20 m"
    assert reached(0, 9, 9.5) == "x = 0 m; x = 20 m"
    assert reached(0, 9, 0.5) == ""


@given(
    points=st.integers(2, 3).flatmap(
        lambda d: st.lists(
            st.tuples(*[st.floats(-3, 3) | st.integers(-6, 6).map(lambda n: n / 2) | st.just(1e12)] * d),
            min_size=1,
            max_size=30,
        )
    ),
    reach=st.sampled_from([0.5, 1.0, 1.5]),
)
def test_groups_are_those_of_all_pairs_within_reach(points, reach):
    points = np.array(points).T
    apart = np.linalg.norm(points[:, :, None] - points[:, None], axis=0)
    # A pair apart by the reach itself, but for rounding, may hang together or not.
    assume(not (np.isclose(apart, reach, rtol=1e-8) & (apart != reach)).any())
    joined = apart <= reach
    for _ in points.T:
        joined = joined @ joined
    group = _joined(points, reach)
    np.testing.assert_array_equal(group[:, None] == group, joined)
