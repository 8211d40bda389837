"""The soil of which a limit load and a calibration are: trend, layers, bedding, bounds and marginals of the scene."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from cooperative import runs
from cooperative.scene import measure, measure_limit_load, parse
from cooperative.store import GRIDS
from tests.scenes import tables

FILL_ABOVE = 7.0
SCENE = f"""
[ground]
surface = [[0.0, 10.0], [8.0, 10.0], [16.0, 2.0], [32.0, 2.0]]
[[layer]]
name = "fill"
bottom = [[0.0, {FILL_ABOVE}], [11.0, {FILL_ABOVE}]]
cohesion = {{ mean = 12e3, cov = 0.3, marginal = "beta", lower = 6e3, upper = 24e3, trend = 500, length = [6.0, 3.0] }}
[[layer]]
name = "clay"
[soil]
unit_weight = 20e3
young = 2e7
poisson = 0.3
[soil.cohesion]
mean = 8e3
cov = 0.4
trend = 1.6e3
length = [20.0, 4.0]
bedding = {{ dip = 20.0 }}
[soil.friction]
mean = 25.0
cov = 0.2
length = [20.0, 4.0]
bedding = {{ dip = 20.0 }}
{tables(run='failure = "limit load"')}calibrate = true
"""


def lognormal_median(mean, cov):
    return mean / np.sqrt(1 + cov**2)


def expected(position):
    """Cohesion (Pa) and friction (radians), from what the scene says alone."""
    x, z = np.asarray(position, float)
    depth = np.interp(x, [0, 8, 16, 32], [10, 10, 2, 2]) - z
    # A beta distribution by the mean and variance of its share of the way from 6 to 24 kPa.
    mean, variance = 6 / 18, (0.3 * 12 / 18) ** 2
    both = mean * (1 - mean) / variance - 1
    fill = 6e3 + 18e3 * stats.beta.median(mean * both, (1 - mean) * both)
    cohesion = np.where(
        z > FILL_ABOVE,
        fill * (1 + 0.5e3 / 12e3 * depth),
        lognormal_median(8e3, 0.4) * (1 + 1.6e3 / 8e3 * depth),
    )
    return cohesion, np.deg2rad(np.full(x.shape, lognormal_median(25.0, 0.2)))


def test_both_are_of_the_soil_that_the_scene_has_at_the_median(tmp_path, monkeypatch):
    measured = []

    def safe(scene, state, *, criterion=None, **_):
        measured.append((criterion, scene))
        return SimpleNamespace(kink=1.2, stable=1.2)

    monkeypatch.setattr("cooperative.scene._measured.factor_of_safety", safe)
    monkeypatch.setattr("cooperative.scene._measured._displacement", lambda *_: 0.3)
    campaign = parse(SCENE)
    soil = runs.random_soil(campaign)
    models = {grid: runs.build(campaign, grid, soil, at_rest=False) for grid in GRIDS}
    measure(campaign, tmp_path, soil.counts, models)
    assert [(criterion, scene.grid.cell) for criterion, scene in measured] == [
        ("limit load", 1.0), (None, 2.0), (None, 1.0),
    ]  # fmt: skip
    for _, scene in measured:
        cohesion, friction = expected(scene.particles.position)
        # The deepest values are three times those at the ground.
        assert np.ptp(cohesion) > 8e3
        np.testing.assert_allclose(scene.material.cohesion, cohesion, rtol=2e-3)
        np.testing.assert_allclose(scene.material.friction, friction, rtol=1e-3)


CUT = f"""
[ground]
surface = [[0.0, 22.0], [20.0, 22.0], [48.0, 8.0], [68.0, 8.0]]
[soil]
unit_weight = 17e3
young = 2e7
poisson = 0.4
[strength]
mean = 30e3
cov = 0.2
trend = 1.6e3
length = [20.0, 2.0]
{tables(4.0, 'failure = "limit load"')}"""


def factor_of_circles(surface, base, weight, strength):
    """Least factor of safety of slip circles through clay, whose strength (Pa) is that of (x, z): moments about the
    centre, of the strength along the arc and of the soil above it."""
    x = np.linspace(surface[0][0], surface[-1][0], 341)
    middle, step = (x[1:] + x[:-1]) / 2, np.diff(x)[0]
    ground = np.interp(middle, *np.transpose(surface))
    least = np.inf
    for centre in np.stack(np.meshgrid(np.arange(28, 52, 1.0), np.arange(22, 50, 1.0)), -1).reshape(-1, 2):
        for lowest in np.arange(base, 10, 0.5):
            radius = centre[1] - lowest
            below = radius**2 - (middle - centre[0]) ** 2
            arc = centre[1] - np.sqrt(np.maximum(below, 0))
            inside = (below > 0) & (arc < ground)
            along = strength(middle, arc) * radius / np.sqrt(np.maximum(below, 1e-9)) * step
            drives = (weight * (ground - arc) * (centre[0] - middle) * step)[inside].sum()
            if drives > 0:
                least = min(least, radius * along[inside].sum() / drives)
    return least


@pytest.mark.slow
def test_a_cut_in_clay_that_grows_with_depth_has_the_factor_of_slip_circles():
    campaign = parse(CUT)
    surface = ((0, 22), (20, 22), (48, 8), (68, 8))

    def strength(x, z):
        depth = np.interp(x, *np.transpose(surface)) - z
        return lognormal_median(30e3, 0.2) + lognormal_median(1.6e3, 0.2) * depth

    circles = factor_of_circles(surface, 0.0, 17e3, strength)
    model = runs.build(campaign, "refined", runs.random_soil(campaign))
    measured = measure_limit_load(campaign, model)
    assert abs(measured.factor / circles - 1) < 0.05, circles
