"""Elements at risk and hazard in a scene: which columns they take, what they lose, and what is refused."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from cooperative import runs
from cooperative.measure import ColumnPlan, ElementAtRisk, Vulnerability, quantity
from cooperative.scene import parse
from jaxmpm import Face
from tests.cooperative.campaign.test_campaign import TINY

SECTION = ColumnPlan((-1.0,), 1.0, (12,), ((0.0, 10.0),))
GROUND = ColumnPlan((-1.0, -1.0), 1.0, (8, 6), ((0.0, 6.0), (0.0, 4.0)))

HAZARD = """
[hazard]
thresholds = ["50 cm", "3.6 km/h", "1 m"]
[[exposed]]
name = "road"
between = [18.0, 21.0]
value = 1000.0
vulnerability = [["0 m", 0.0], ["0.5 m", 0.5], ["2 m", 1.0]]
[[exposed]]
name = "house"
at = [22.5]
"""


def test_a_scene_names_its_elements_at_risk_and_thresholds_in_their_units():
    campaign = parse(TINY + HAZARD)
    hazard = campaign.hazard
    assert hazard.thickness == (0.5, 1.0)
    assert hazard.speed == pytest.approx((1.0,))
    road, house = campaign.elements_at_risk
    assert road.corners == ((18.0,), (21.0,))
    assert road.vulnerability.share(np.array([0.0, 0.25, 1.25, 9.0])) == pytest.approx([0.0, 0.25, 0.75, 1.0])
    assert (house.value, house.vulnerability) == (None, None)
    assert parse(TINY).hazard is None
    assert parse(TINY + "[hazard]\n").hazard.every == 20


def test_points_stretches_and_polygons_take_their_columns():
    assert np.flatnonzero(ElementAtRisk("a", ((3.2,),)).columns(SECTION)).tolist() == [4]
    assert np.flatnonzero(ElementAtRisk("end", ((10.0,),)).columns(SECTION)).tolist() == [10]
    assert np.flatnonzero(ElementAtRisk("b", ((3.0,), (5.5,))).columns(SECTION)).tolist() == [4, 5, 6]
    square = ElementAtRisk("c", ((1.0, 1.0), (3.0, 1.0), (3.0, 2.0), (1.0, 2.0)))
    assert np.argwhere(square.columns(GROUND)).tolist() == [[2, 2], [3, 2]]
    assert np.argwhere(ElementAtRisk("d", ((5.5, 0.5),)).columns(GROUND)).tolist() == [[6, 1]]
    assert SECTION.ground == (slice(1, 11),)
    assert GROUND.ground == (slice(1, 7), slice(1, 5))


@given(st.integers(0, 2**32), st.integers(3, 7))
def test_a_polygon_takes_the_columns_that_points_in_it_lie_in(seed, count):
    generator = np.random.default_rng(seed)
    angle = np.sort(generator.random(count)) * 2 * np.pi
    radius = 0.3 + 1.6 * generator.random(count)
    corners = np.stack([3 + radius * np.cos(angle), 2 + radius * np.sin(angle)], axis=-1)
    pairs = list(zip(corners, np.roll(corners, -1, axis=0), strict=True))
    # Triangles with the middle that all turn left make a star; other corners may make a polygon that crosses itself.
    assume(all((one[0] - 3) * (other[1] - 2) > (one[1] - 2) * (other[0] - 3) for one, other in pairs))
    columns = ElementAtRisk("star", tuple(map(tuple, corners.tolist()))).columns(GROUND)
    inside = np.zeros(GROUND.shape, bool)
    for one, other in pairs:
        share = generator.dirichlet([1, 1, 1], size=60)
        points = share @ np.array([[3.0, 2.0], one, other])
        inside[tuple(np.floor(points - GROUND.origin).astype(int).T)] = True
    assert not (inside & ~columns).any()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: ElementAtRisk("x", ((12.5,),)).columns(SECTION),
            r"'x' has x = 12.5 m, outside the ground, .* 0 to 10 m",
        ),
        (lambda: ElementAtRisk("x", ((3.0, 2.0),)).columns(SECTION), "given by 2 numbers, the ground has 1"),
        (lambda: ElementAtRisk("x", ((1, 1), (3, 1), (3, 5), (1, 5))).columns(GROUND), "y = 5 m, outside the ground"),
        (lambda: ElementAtRisk("x", ((1, 1), (3, 3), (3, 1), (1, 3))), "crosses itself, between corners 1 and 3"),
        (lambda: ElementAtRisk("x", ((1, 1), (2, 2), (3, 3))), "has no area"),
        (lambda: ElementAtRisk("x", ((3.0,), (2.0,))), "from 3 to 2 m: give the lower end first"),
        (lambda: ElementAtRisk("x", ((float("nan"),),)), "give finite metres"),
        (lambda: Vulnerability("speed", (0.0, 1.0), (0.5, 0.2)), "falls from 0.5 at 0 m/s to 0.2 at 1 m/s"),
        (lambda: Vulnerability("thickness", (0.0, 1.0), (0.0, 1.2)), "loses 1.2 at 1 m: give a share from 0 to 1"),
        (lambda: Vulnerability("thickness", (1.0, 1.0), (0.0, 1.0)), "do not ascend"),
    ],
)
def test_elements_at_risk_and_curves_that_make_no_sense_are_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_an_element_at_risk_outside_the_ground_is_refused_before_anything_runs():
    campaign = parse(TINY + HAZARD.replace("[22.5]", "[99.0]"))
    with pytest.raises(
        ValueError, match=r"element at risk 'house' has x = 99 m, outside the ground, .* from 0 to 32 m"
    ):
        runs.build(campaign, "refined", runs.random_soil(campaign), at_rest=False)


@given(st.floats(0, 1e6), st.sampled_from(["m", "cm", "m/s", "km/h"]))
def test_a_quantity_is_read_with_its_unit(number, unit):
    of, value = quantity(f"{number!r} {unit}")
    assert of == ("speed" if "/" in unit else "thickness")
    assert value == pytest.approx(number * {"m": 1, "cm": 0.01, "m/s": 1, "km/h": 1 / 3.6}[unit])


def test_what_hits_a_house_is_above_its_ground_and_what_carries_it_away_is_its_ground():
    """On the face of a slope that fails the deposit is far thinner than the soil above the slip surface."""
    exposed = '[[exposed]]\nname = "{}"\nbetween = {}\n'
    places = {"face": [9.0, 12.0], "toe": [15.0, 17.0], "beyond": [18.0, 20.0]}
    campaign = parse(TINY + "[hazard]\n" + "".join(exposed.format(*each) for each in places.items()))
    soil = runs.random_soil(campaign)
    model = runs.build(campaign, "refined", soil)
    (sample,) = runs.run_samples(model, {0: np.full(soil.modes, -1.0, np.float32)}, [0])
    assert sample.row["displacement"] > 2.0
    position, moved = np.asarray(model.scene.particles.position), sample.fields["displacement"]
    now, plan, heights = position + moved, model.columns, campaign.site.shape.heights
    column = np.floor((now[0] - plan.origin[0]) / plan.cell).astype(int)
    slides, area = np.linalg.norm(moved, axis=0) >= 1.0, np.asarray(model.scene.particles.volume)
    whole = np.bincount(column[slides], area[slides], plan.shape[0]) / plan.cell
    over = np.clip((now[1] - heights(now[0])) / 0.5 + 0.5, 0.0, 1.0) * slides * area
    above = np.bincount(column, over, plan.shape[0]) / plan.cell
    np.testing.assert_allclose(sample.fields["column_deposit"], above, atol=2e-3)
    for name, (low, high) in places.items():
        mine = ElementAtRisk(name, ((low,), (high,))).columns(plan)
        deposit, thickness = above[mine].max(), sample.row[f"thickness_at_{name}"]
        # The largest of all looks, and not more than stands between the old surface and the highest soil.
        assert thickness >= deposit - 1e-3
        own = (position[0] >= low) & (position[0] < high) & (heights(position[0]) - position[1] <= plan.cell)
        own_moved = np.linalg.norm(moved[:, own], axis=0).max()
        assert sample.row[f"ground_at_{name}"] == pytest.approx(own_moved, rel=1e-3)
    face = ElementAtRisk("face", ((9.0,), (12.0,))).columns(plan)
    assert sample.row["ground_at_face"] > 1.0
    assert sample.row["thickness_at_face"] < 0.2 * whole[face].max()
    assert whole[face].max() > 2.0
    assert sample.row["thickness_at_beyond"] > 0.5


@pytest.mark.parametrize("toe", [3.0, 3.4])
def test_the_columns_beyond_the_toe_are_on_the_side_to_which_the_slope_falls(toe):
    edges = SECTION.edges(0)
    right, left = (SECTION.beyond(Face(at, 0.0, 5.0, way)) for at, way in ((toe, 1), (10.0 - toe, -1)))
    assert edges[right.start] == np.ceil(toe)
    assert right.stop == 12
    assert (left.start, left.stop) == (0, 12 - right.start)
    assert SECTION.beyond(None) == slice(0, 12)
