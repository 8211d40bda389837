"""Strength against depth at the stations of a section, as `jaxmpm draw` shows it."""

import re
from dataclasses import replace
from functools import lru_cache

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cooperative.reporting import _profiles as profiles
from cooperative.reporting._plots import section_panels_beside
from tests.cooperative.scene.test_mixed_scenes import MIXED
from tests.cooperative.scene.test_random_level import SCENE as RANDOM_LEVEL
from tests.cooperative.scene.test_top_of_layer import CUT, LEVEL
from tests.scenes import model_of

RATIO = re.sub(r"strength = \{ mean.*\}", "strength_ratio = 0.25\nstrength_minimum = 5e3", MIXED)
RATIO = RATIO.replace("[rough]", "[water]\nlevel = 4.0\n[rough]", 1)
TRENDS = RANDOM_LEVEL.replace("[water.level]\nmean = 3.0\nsd = 0.8\n", "trend = 800.0\n[water]\nlevel = 3.0\n")


@given(
    st.floats(0.5, 40),
    st.floats(0, 30),
    st.floats(1, 60),
    st.floats(0, 50),
    st.floats(-200, 3000),
    st.integers(40, 200),
)
def test_stations_of_a_slope_and_of_its_mirror_image_are_the_same(height, crest, run, toe, foot, count):
    x = np.linspace(0, crest + run + toe, count)
    z = foot + height * np.interp(x, [crest, crest + run], [1.0, 0.0])
    step, found = x[1] - x[0], profiles.stations(x, z)
    reach = step + profiles.LEVEL * run
    assert x[found["crest"]] == pytest.approx(crest, abs=reach)
    assert x[found["toe"]] == pytest.approx(crest + run, abs=reach)
    assert abs(x[found["mid slope"]] - (crest + run / 2)) <= step / 2 + reach / 2
    mirrored = profiles.stations(x, z[::-1])
    assert {name: count - 1 - at for name, at in mirrored.items() if name != "mid slope"} == {
        name: at for name, at in found.items() if name != "mid slope"
    }


def test_level_ground_has_one_station():
    assert profiles.stations(np.arange(9.0), np.full(9, 3.0)) == {"mid slope": 4}


@lru_cache
def of(scene):
    model = model_of(scene, "refined")
    shown = profiles.profiles(model, np.ones(model.scene.particles.mass.size, bool))
    return {each.station: each for each in shown}


def test_a_trend_counts_from_the_top_of_the_layer_before_the_cut():
    cut, level = of(CUT), of(LEVEL)
    assert (cut["toe"].x, cut["mid slope"].x, cut["crest"].x) == (43.25, 36.75, 30.25)
    for station, face in (("toe", 0.0), ("mid slope", 4.5), ("crest", 9.0)):
        mine, other = level[station], cut[station]
        assert mine.elevation == pytest.approx(face, abs=0.3)
        elevation = mine.elevation - mine.depth
        clay = elevation < 5.0
        assert mine.mean["strength"][clay] == pytest.approx(25e3 + 1.5e3 * (5.0 - elevation[clay]), rel=5e-3)
        assert np.all(np.isnan(mine.mean["strength"][~clay]))
        # Without its top the trend of the clay counts from the face, which at the toe lies 5 m below it.
        gap = (mine.mean["strength"] - other.mean["strength"])[clay]
        assert gap == pytest.approx(1.5e3 * max(5.0 - mine.elevation, 0.0), abs=30)


@pytest.mark.parametrize("scene", [LEVEL, RANDOM_LEVEL, RATIO, TRENDS], ids=["layers", "water", "ratio", "one soil"])
def test_parameters_of_some_particles_are_those_of_all(monkeypatch, scene):
    """Whatever is random: in zones of several laws, under a random water level, by the stress at rest, with a trend."""
    model = model_of(scene)
    rng = np.random.default_rng(0)
    sample = rng.normal(size=model.soil.modes)
    for count in (1, 40):
        chosen = np.sort(rng.choice(model.scene.particles.mass.size, count, replace=False))
        few, every = model.of(chosen).parameters(sample), model.parameters(sample)
        assert set(few) == set(every)
        for name, values in every.items():
            np.testing.assert_allclose(few[name], np.asarray(values)[chosen], rtol=2e-6)
    monkeypatch.setitem(profiles.SAMPLES, 2, 8)
    drawn = profiles._drawn(model, model.names, chosen[::-1])
    ascending = profiles._drawn(model, model.names, chosen)
    for name, values in drawn.items():
        assert values.shape == (8, 40)
        np.testing.assert_array_equal(values[:, ::-1], ascending[name])


def test_what_belongs_to_no_particle_stays_whole_whatever_its_length():
    """A water table of as many points as the grid has particles."""
    model = model_of(RATIO)
    count = model.scene.particles.mass.size
    table = model.scene.loads.water
    table = replace(table, x=jnp.linspace(0.0, 16.0, count), z=jnp.full(count, 4.0))
    model = replace(model, scene=replace(model.scene, loads=replace(model.scene.loads, water=table)))
    few = model.of(np.array([1, 5]))
    assert few.scene.loads.water is table
    assert few.scene.particles.position.shape == (2, 2)


def test_the_band_holds_the_quantiles_of_the_marginal_and_certain_strength_has_none():
    toe, crest = (of(LEVEL)[station] for station in ("toe", "crest"))
    # A lognormal of cov 0.2; the expansion holds 99.9 % of its variance over the section.
    spread = np.sqrt(np.log1p(0.2**2))
    expected = np.exp(np.array([[-1.645], [1.645]]) * spread - spread**2 / 2) * toe.mean["strength"]
    assert toe.tails["strength"] == pytest.approx(expected, rel=0.05)
    assert set(crest.tails) == {"strength"}
    sand = crest.depth < 4.0
    assert crest.mean["friction"][sand] == pytest.approx(38.0, rel=1e-5)
    assert np.all(np.isnan(crest.mean["friction"][~sand]))


def test_each_parameter_has_a_panel_whose_axes_carry_units():
    shown = list(of(LEVEL).values())
    _, _, beside = section_panels_beside(np.array([[0.0, 100.0], [0.0, 17.0]]), 3, len(shown[0].mean))
    profiles.draw_profiles(beside, shown)
    assert [ax.get_xlabel() for ax in beside] == [
        "cohesion $c$ [kPa]", r"friction angle $\varphi$ [degrees]", "undrained strength $S_u$ [kPa]"
    ]  # fmt: skip
    for ax in beside:
        assert ax.get_ylabel() == "depth [m]"
        assert ax.get_ylim() == (max(each.depth.max() for each in shown), 0.0)
    assert [text.get_text() for text in beside[0].get_legend().get_texts()] == [
        "toe, x = 43.25 m", "mid slope, x = 36.75 m", "crest, x = 30.25 m"
    ]  # fmt: skip


def test_a_law_without_strength_has_no_panel():
    toe = of(LEVEL)["toe"]
    bare = profiles.Profile("toe", toe.x, toe.elevation, toe.depth, {}, {})
    figure, axes, beside = section_panels_beside(np.array([[0.0, 100.0], [0.0, 17.0]]), 3, len(bare.mean))
    profiles.draw_profiles(beside, [bare])
    assert (len(figure.axes), len(axes), beside) == (3, 3, [])
