"""The dam of remoulded clay: shallow-water theory against closed forms, and the solver's dam beside it."""

import numpy as np
import pytest

from benchmarks.settings import remoulded_clay
from benchmarks.settings.remoulded_clay import DENSITY, GRAVITY, HEIGHT, LENGTH, STRENGTH


def test_without_strength_the_dam_is_ritters():
    time = 1.0
    x, depth = remoulded_clay.shallow_water(0.05, time, strength=0.0)
    wave = np.sqrt(GRAVITY * HEIGHT)
    fan = (2 * wave - (x - LENGTH) / time) ** 2 / (9 * GRAVITY)
    ritter = np.where(x < LENGTH - wave * time, HEIGHT, np.where(x < LENGTH + 2 * wave * time, fan, 0.0))
    assert np.abs(depth - ritter).mean() < 0.01
    assert depth.sum() * 0.05 == pytest.approx(LENGTH * HEIGHT)


def test_clay_that_rests_is_held_by_its_base():
    cell = 0.1
    x, depth = remoulded_clay.shallow_water(cell, 20.0)
    inside = depth[:-1] * depth[1:] > 0
    push = DENSITY * GRAVITY * np.abs(np.diff(depth**2)) / (2 * cell)
    assert push[inside].max() < 1.1 * STRENGTH
    np.testing.assert_array_equal(depth, remoulded_clay.shallow_water(cell, 21.0)[1])  # it has stopped
    assert x[depth > 0.01].max() > remoulded_clay.parabola()  # inertia carries it beyond


def test_the_parabola_holds_the_dams_clay_under_its_strength():
    x = np.linspace(0, remoulded_clay.parabola(), 100_001)
    depth = np.sqrt(2 * STRENGTH / (DENSITY * GRAVITY) * (x[-1] - x))
    assert np.trapezoid(depth, x) == pytest.approx(LENGTH * HEIGHT, rel=1e-6)


def test_the_dam_runs_out_between_both_theories_and_viscosity_holds_it_back():
    runs = {viscosity: remoulded_clay.of_dam(1.0, viscosity) for viscosity in (None, 400.0)}
    waves, still = remoulded_clay.by_theory()
    assert still["runout_m"] < runs[None]["runout_m"] < waves["runout_m"]
    assert runs[400.0]["runout_m"] < 0.9 * runs[None]["runout_m"]
    assert runs[None]["runout_m"] < runs[None]["runout_foremost_m"]
