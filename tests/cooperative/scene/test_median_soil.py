"""The soil of which a limit load and a calibration are: trend, layers, bedding, bounds and marginals of the scene."""

from types import SimpleNamespace

import numpy as np
from scipy import stats

from cooperative import runs
from cooperative.scene import measure, parse
from cooperative.store import GRIDS, Source, open_store
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
        return SimpleNamespace(kink=1.2, stable=1.2, sharpness=40.0, local=None)

    monkeypatch.setattr("cooperative.scene._measured.factor_of_safety", safe)
    monkeypatch.setattr("cooperative.scene._measured._displacement", lambda *_: 0.3)
    campaign = parse(SCENE)
    soil = runs.random_soil(campaign)
    models = {grid: runs.build(campaign, grid, soil, at_rest=False) for grid in GRIDS}
    with open_store(tmp_path / "measured", Source(SCENE)) as store:
        measure(campaign, store, soil.counts, models)
    assert [(criterion, scene.grid.cell) for criterion, scene in measured] == [
        ("limit load", 1.0), (None, 2.0), (None, 1.0),
    ]  # fmt: skip
    for _, scene in measured:
        cohesion, friction = expected(scene.particles.position)
        # The deepest values are three times those at the ground.
        assert np.ptp(cohesion) > 8e3
        np.testing.assert_allclose(scene.material.cohesion, cohesion, rtol=2e-3)
        np.testing.assert_allclose(scene.material.friction, friction, rtol=1e-3)
