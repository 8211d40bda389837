"""Where the depth of a trend is counted from: the ground's surface, the top of a layer, or an elevation."""

from itertools import product

import numpy as np
import pytest

from jaxmpm import factor_of_safety
from tests.scenes import model_of, tables

SCENE = f"""
[ground]
surface = [[0.0, 10.0], [8.0, 10.0], [16.0, 2.0], [32.0, 2.0]]
[[layer]]
name = "crust"
bottom = [[0.0, 7.0], [8.0, 6.0], [12.0, 6.0]]
[[layer]]
name = "clay"
strength = {{ mean = 20e3, cov = 0.0 }}
[soil]
unit_weight = 20e3
young = 2e7
poisson = 0.49
[strength]
mean = 40e3
cov = 0.0
length = [20.0, 4.0]
trend = 1.5e3
TREND_FROM
{tables()}"""
RESOLVED = 2.0
"""Gain of strength (Pa) over more than a thousandth of a particle, to which a layer's top is known."""
PLAIN = SCENE[: SCENE.index("[[layer]]")] + SCENE[SCENE.index("[soil]") :]


def strength_of(scene, trend_from, grid="refined"):
    model = model_of(scene.replace("TREND_FROM", trend_from), grid)
    return np.asarray(model.scene.particles.position, float), np.asarray(model.strength(), float), model.layer


def surface(x):
    return np.interp(x, [0, 8, 16, 32], [10, 10, 2, 2])


def bottom_of_crust(x):
    return np.minimum(surface(x), np.interp(x, [0, 8, 12], [7, 6, 6]))


@pytest.mark.parametrize(
    ("trend_from", "crust", "clay"),
    [
        ("", surface, surface),
        ('trend_from = "surface"', surface, surface),
        ('trend_from = "layer"', surface, bottom_of_crust),
        ("trend_from = 10.0", lambda x: 10.0, lambda x: 10.0),
        ("trend_from = 6.5", lambda x: 6.5, lambda x: 6.5),
    ],
)
def test_strength_grows_from_where_the_scene_counts_its_trend(trend_from, crust, clay):
    (x, z), strength, layer = strength_of(SCENE, trend_from)
    assert 0.1 < layer.mean() < 0.9
    mean, top = np.where(layer == 0, 40e3, 20e3), np.where(layer == 0, crust(x), clay(x))
    np.testing.assert_allclose(strength, mean * (1 + 1.5e3 / mean * np.maximum(top - z, 0)), rtol=1e-5, atol=RESOLVED)


def test_ground_of_one_soil_is_a_layer_whose_top_is_the_surface():
    plain = PLAIN.replace("mean = 40e3\ncov = 0.0", "mean = 40e3\ncov = 0.3")
    np.testing.assert_array_equal(strength_of(plain, "")[1], strength_of(plain, 'trend_from = "layer"')[1])


def test_a_layer_may_count_its_trend_from_elsewhere():
    own = SCENE.replace("mean = 20e3, cov = 0.0", 'mean = 20e3, cov = 0.0, trend_from = "layer"')
    (x, z), strength, layer = strength_of(own, "trend_from = 10.0")
    top = np.where(layer == 0, 10.0, bottom_of_crust(x))
    np.testing.assert_allclose(strength, np.where(layer == 0, 40e3, 20e3) + 1.5e3 * (top - z), rtol=1e-5, atol=RESOLVED)


def test_boreholes_count_the_trend_from_the_top_of_their_layer():
    alike = SCENE.replace("strength = { mean = 20e3, cov = 0.0 }", "").replace("cov = 0.0", "cov = 0.3")
    holes = 'trend_from = "layer"\nboreholes = [[4.5, 3.5, 31e3], [4.5, 8.5, 52e3]]'
    for scene, layers in ((alike, [1, 0]), (PLAIN.replace("cov = 0.0", "cov = 0.3"), None)):
        (x, z), strength, layer = strength_of(scene, holes, "rough")
        at = [int(np.argmin(np.hypot(x - 4.5, z - hole))) for hole in (3.5, 8.5)]
        assert layer is None or layer[at].tolist() == layers
        np.testing.assert_allclose(strength[at], [31e3, 52e3], rtol=5e-3)


CUT = f"""
[ground]
surface = [[0.0, 24.0], [24.0, 24.0], [38.0, 10.0], [64.0, 10.0]]
[soil]
unit_weight = 18e3
young = 4e7
poisson = 0.49
[strength]
mean = 30e3
cov = 0.2
length = [40.0, 4.0]
trend = 1.6e3
TREND_FROM
{tables(4.0, "t_end = 10.0")}"""


def before_the_cut(x):
    return np.full(np.shape(x), 24.0)


def after_the_cut(x):
    return np.interp(x, [0, 24, 38, 64], [24, 24, 10, 10])


def slip_circles(top):
    """Least factor of safety of slip circles in soil without friction, by moments about their centre.

    top: where depth is counted from.
    """
    median, least = 30e3 / np.sqrt(1 + 0.2**2), np.inf
    for cx, cz, low in product(np.linspace(24, 44, 41), np.linspace(24.5, 60, 41), np.linspace(0, 11, 23)):
        radius = cz - low
        x, width = np.linspace(cx - radius, cx + radius, 801, retstep=True)
        z = cz - np.sqrt(np.maximum(radius**2 - (x - cx) ** 2, 1e-9))
        inside = np.flatnonzero((after_the_cut(x) > z) & (x > 0) & (x < 64))
        if inside.size < 2 or (np.diff(inside) > 1).any() or x[inside[0]] < 0.1 or x[inside[-1]] > 63.9:
            continue
        x, z = x[inside], z[inside]
        strength = median * (1 + 1.6e3 / 30e3 * (top(x) - z))
        turning = 18e3 * np.sum((after_the_cut(x) - z) * (cx - x)) * width
        if turning > 0:
            along = width * radius / (cz - z)
            least = min(least, radius * np.sum(strength * along) / turning)
    return least


@pytest.mark.slow
def test_a_cut_stands_more_firmly_where_strength_is_that_of_the_ground_before_it():
    factors, circles = [], [slip_circles(after_the_cut), slip_circles(before_the_cut)]
    for trend_from in ("", "trend_from = 24.0"):
        scene, state = model_of(CUT.replace("TREND_FROM", trend_from), "refined", at_rest=True).median
        result = factor_of_safety(scene, state, t_end=10.0)
        factors.append((result.stable + result.fails) / 2)
    # 0.985 and 1.135 on cells of 2 m, 0.943 and 1.062 by circles.
    np.testing.assert_allclose(factors, circles, rtol=0.08)
    assert factors[1] / factors[0] == pytest.approx(circles[1] / circles[0], rel=0.05)
