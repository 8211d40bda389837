"""Slices against closed forms, published factors, xslope on the same surface, and their own symmetries."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import jaxmpm as mpm
from benchmarks.sites import by_xslope, slopes
from benchmarks.sites.limit_equilibrium import layers_of
from cooperative.tools import safety
from cooperative.tools.safety import _search

PUBLISHED = {"ACADS 1a": 0.984, "ACADS 3a": 1.24, "Published section": 1.142, "Griffiths and Lane 1": 1.38}
"""Factors by limit equilibrium: Spencer's method, of 3a by surfaces that follow the seam (1.24 to 1.27)."""
FACE = mpm.Section([(0, 10), (20, 10), (36, 4), (56, 4)])
CIRCLE = safety.Circle(30.0, 20.0, 18.0)
CONDITIONS = [{}, {"water": 6.0}, {"water": 8.0}, {"r_u": 0.2}, {"k_h": 0.1}, {"k_h": 0.1, "k_v": 0.1}]


def mirrored(shape, layers, loads):
    """The mirror image of a section with its layers and loads about x = 0, by their lines."""

    def line(points):
        return None if points is None else [(-x, z) for x, z in reversed(list(points))]

    loads = {key: line(value) if isinstance(value, list) else value for key, value in loads.items()}
    image = replace(shape, surface=line(shape.surface), bedrock=line(shape.bedrock))
    return image, [replace(layer, bottom=line(layer.bottom)) for layer in layers], loads


@pytest.mark.parametrize("name", PUBLISHED)
def test_critical_surfaces_have_the_published_factor(name):
    [case] = [case for case in slopes.cases() if case.name == name]
    answer = safety.critical_surface(safety.Slices.of(case.shape, layers_of(case), **case.loads))
    assert abs(answer.slip.factor / PUBLISHED[name] - 1) < 0.015
    assert answer.slip.factor <= answer.circle.factor


@pytest.mark.parametrize("conditions", CONDITIONS)
@pytest.mark.parametrize("method", ["spencer", "bishop"])
def test_a_circle_has_the_factor_that_xslope_gives_it(conditions, method):
    pytest.importorskip("xslope.slice")
    layers = [mpm.Layer(mpm.FrictionalSoil(10e3, 25.0))]
    ours = safety.Slices.of(FACE, layers, **conditions).slip(CIRCLE, method)
    assert ours.factor == pytest.approx(
        by_xslope.factor(by_xslope.inputs(FACE, layers, **conditions), CIRCLE, method), rel=2e-3
    )


@pytest.mark.parametrize("conditions", CONDITIONS)
def test_under_other_gravity_all_weights_are_in_proportion(conditions):
    def factor(strength, gravity):
        layers = [mpm.Layer(mpm.FrictionalSoil(strength * 10e3, 25.0))]
        slip = safety.Slices.of(FACE, layers, **conditions, gravity=gravity * 9.81).slip(CIRCLE)
        assert slip is not None
        return slip.factor

    assert factor(2.0, 2.0) == pytest.approx(factor(1.0, 1.0), rel=1e-6)
    assert factor(1.0, 2.0) < 0.95 * factor(1.0, 1.0)


@settings(max_examples=20, deadline=None)
@given(middle=st.floats(25.0, 31.0), chord=st.floats(6.0, 9.0), rise=st.floats(2.0, 8.0))
def test_what_slides_on_a_circle_has_the_area_and_the_thickness_of_its_segment(middle, chord, rise):
    """The chord lies in the straight face, and the middle of the circle so far above it."""
    fall = math.hypot(16, 6)
    radius = math.hypot(chord / 2, rise)
    circle = safety.Circle(middle + rise * 6 / fall, 10 - (middle - 20) * 6 / 16 + rise * 16 / fall, radius)
    slip = safety.Slices.of(FACE, [mpm.Layer(mpm.FrictionalSoil(10e3, 25.0))]).slip(circle)
    assert slip is not None
    angle = 2 * math.asin(chord / 2 / radius)
    assert slip.area == pytest.approx(radius**2 / 2 * (angle - math.sin(angle)), rel=5e-3)
    assert slip.thickness == pytest.approx((radius - rise) * fall / 16, rel=5e-3)


def test_under_a_deep_pool_soil_has_its_weight_less_that_of_water():
    # The pool's pressure on the ground and the pore pressure at the base are uplift alone, on any surface.
    soil = mpm.FrictionalSoil(10e3, 25.0, unit_weight=20e3)
    points = np.array([(14.0, 10.0), (20.0, 4.5), (28.0, 2.2), (36.0, 2.6), (41.0, 4.0)])
    wet = safety.Slices.of(FACE, [mpm.Layer(soil)], water=25.0).slip(points, "janbu")
    buoyant = mpm.Layer(replace(soil, unit_weight=20e3 - mpm.ground.WATER_WEIGHT))
    assert wet.factor == pytest.approx(safety.Slices.of(FACE, [buoyant]).slip(points, "janbu").factor, rel=1e-6)


@pytest.mark.parametrize("depth", [1.0, 2.0])
@pytest.mark.parametrize("contact", [None, (2e3, 20.0)])
def test_soil_on_inclined_bedrock_has_the_factor_of_an_infinite_slope(depth, contact):
    # Without an interface soil on bedrock has its own strength there.
    angle, length, weight = math.radians(29.0), 200.0, 19e3
    fall = length * math.tan(angle)
    surface = [(0, fall + 40), (length, 40)]
    bedrock = [(x, z - depth / math.cos(angle)) for x, z in surface]
    interface = None if contact is None else mpm.Interface(cohesion=contact[0], friction=contact[1])
    shape = mpm.Section(surface, bedrock=bedrock, interface=interface)
    slices = safety.Slices.of(shape, [mpm.Layer(mpm.FrictionalSoil(6e3, 32.0, unit_weight=weight))])
    cohesion, friction = contact or (6e3, 32.0)
    pressed, pulled = weight * depth * math.cos(angle), weight * depth * math.sin(angle)
    expected = (cohesion + pressed * math.tan(math.radians(friction))) / pulled
    critical = safety.critical_surface(slices).slip
    # Its ends carry a slide of finite length a little.
    assert expected * 0.99 < critical.factor < expected * 1.06
    assert critical.on_rigid > 0.7


@settings(max_examples=4, deadline=None)
@given(
    crest=st.floats(6, 12), run=st.floats(1.0, 3.0), strong=st.booleans(),
    loads=st.sampled_from([{}, {"water": [(0, 8.0), (30, 7.0), (70, 3.0)]}, {"r_u": 0.2}, {"k_h": 0.15}]),
    kind=st.sampled_from(["clay", "friction", "layers", "seam", "bedrock"]),
)  # fmt: skip
def test_a_mirrored_slope_has_one_factor(crest, run, strong, loads, kind):
    end = 70.0
    surface = [(0, crest), (25, crest), (25 + run * (crest - 3), 3), (end, 3)]
    soil = mpm.FrictionalSoil(8e3 * (1 + strong), 24.0, unit_weight=19e3)
    clay = mpm.Soil(19e3, strength=30e3 * (1 + strong), tension_cutoff=0.0)
    layers = {
        "clay": [mpm.Layer(clay)],
        "friction": [mpm.Layer(soil)],
        "layers": [mpm.Layer(soil, [(0, 4.0), (end, 2.0)]), mpm.Layer(clay)],
        "seam": [
            mpm.Layer(soil, [(0, 3.5), (end, 1.5)]),
            mpm.Layer(mpm.FrictionalSoil(0.0, 12.0, unit_weight=19e3), [(0, 3.0), (end, 1.0)]),
            mpm.Layer(soil),
        ],
        "bedrock": [mpm.Layer(soil)],
    }[kind]
    shape = mpm.Section(surface, bedrock=[(0, 3.0), (40, 1.5), (end, 1.0)] if kind == "bedrock" else None)
    image = mirrored(shape, layers, loads)
    ours, other = (
        safety.critical_surface(safety.Slices.of(*each[:2], **each[2])) for each in ((shape, layers, loads), image)
    )
    assert other.slip.factor == pytest.approx(ours.slip.factor, rel=2e-3)
    assert other.slip.points[:, 0].max() == pytest.approx(-ours.slip.points[:, 0].min(), abs=0.1 * crest)
    # One surface has one factor.
    one = safety.Slices.of(shape, layers, **loads).slip(ours.slip.points, "janbu")
    same = safety.Slices.of(*image[:2], **image[2]).slip((ours.slip.points * [-1, 1])[::-1], "janbu")
    assert (one is None) == (same is None)
    assert one is None or same.factor == pytest.approx(one.factor, rel=1e-5)


def test_steep_clay_has_the_factor_of_its_moments():
    # Taylor (1937): at 45 degrees over a foundation of a quarter of the height, c / (gamma H F) is 0.17.
    shape = mpm.Section([(0, 10), (8, 10), (16, 2), (32, 2)])
    answer = safety.critical_surface(
        safety.Slices.of(shape, [mpm.Layer(mpm.Soil(20e3, strength=28e3, tension_cutoff=0.0))])
    )
    assert answer.slip.factor == pytest.approx(28 / (20 * 8 * 0.17), rel=0.05)
    assert answer.slip.method == "bishop"


def test_a_vertical_cut_in_clay_has_its_stability_number():
    # Taylor (1937): gamma H F / c is 3.83 for circles.
    shape = mpm.Section([(0, 10), (20, 10), (20, 5), (40, 5)])
    answer = safety.critical_surface(
        safety.Slices.of(shape, [mpm.Layer(mpm.Soil(20e3, strength=30e3, tension_cutoff=0.0))])
    )
    assert answer.slip.factor == pytest.approx(3.83 * 30 / (20 * 5), rel=0.02)


def test_the_factor_changes_little_with_the_number_of_slices():
    slices = safety.Slices.of(FACE, [mpm.Layer(mpm.FrictionalSoil(10e3, 25.0))], water=[(0, 9.0), (36, 4.0), (56, 4.0)])
    factors = [replace(slices, slices=count).slip(CIRCLE).factor for count in (50, 400)]
    assert factors[0] == pytest.approx(factors[1], rel=1e-3)


def test_level_ground_has_no_factor():
    with pytest.raises(ValueError, match="no surface has a factor"):
        safety.critical_surface(
            safety.Slices.of(mpm.Section([(0, 10), (50, 10)]), [mpm.Layer(mpm.FrictionalSoil(10e3, 25.0))])
        )


def test_where_spencers_method_has_no_answer_bishops_stands_in(monkeypatch):
    slices = safety.Slices.of(FACE, [mpm.Layer(mpm.FrictionalSoil(10e3, 25.0))])
    usual = safety.critical_surface(slices)
    monkeypatch.setattr("cooperative.tools.safety._slices._spencer", lambda bodies: np.full(len(bodies.valid), np.inf))
    stands_in = safety.critical_surface(slices)
    assert (usual.slip.method, stands_in.slip.method) == ("spencer", "bishop")
    assert stands_in.slip.factor == pytest.approx(usual.circle.factor, rel=0.01)


def test_a_search_computes_surfaces_by_the_set(monkeypatch):
    # A set of surfaces takes as long as a few, and no search computes one after the other.
    calls = []
    factors = safety.Slices.factors

    def counted(self, surfaces, method):
        calls.append(len(surfaces.x))
        return factors(self, surfaces, method)

    monkeypatch.setattr(safety.Slices, "factors", counted)
    answer = safety.critical_surface(safety.Slices.of(FACE, [mpm.Layer(mpm.FrictionalSoil(10e3, 25.0))]))
    assert len(calls) < 12 * _search.ROUNDS
    assert sum(calls) == answer.surfaces
