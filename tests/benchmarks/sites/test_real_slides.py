"""Scores of real slides against values worked out by hand; their scenes and surveys belong together."""

import json
import tomllib

import numpy as np
import pytest

from benchmarks.sites import real_assumptions
from benchmarks.sites.real_slides import SCENES, Slid, compared, summarised
from benchmarks.sites.real_surveys import BAND, KNOWN, Known, Survey, corominas, holds, interval_score
from cooperative.scene import parse, read_scene

ASSUMED = json.loads((SCENES / "assumptions.json").read_text())


def test_an_interval_scores_its_width_and_twenty_times_what_it_is_missed_by():
    assert interval_score(80.0, 120.0, 100.0) == pytest.approx(0.4)
    assert interval_score(110.0, 120.0, 100.0) == pytest.approx((10 + 20 * 10) / 100)
    assert interval_score(40.0, 90.0, 100.0, miss=0.5) == pytest.approx((50 + 4 * 10) / 100)


def test_an_interval_wider_than_a_factor_of_three_is_no_hit():
    assert holds(50.0, 150.0, 100.0)
    assert not holds(50.0, 150.1, 100.0)
    assert not holds(0.0, 150.0, 100.0)
    assert not holds(110.0, 150.0, 100.0)


def test_corominas_relation():
    # log(H / L) = -0.085 * 6 - 0.047 = -0.557; H = 100 m.
    low, middle, high = corominas(100.0, 1e6, miss=0.05)
    assert middle == pytest.approx(100 * 10**0.557)
    assert [low / middle, high / middle] == pytest.approx([10**-BAND, 10**BAND])
    assert pytest.approx(0.3905, abs=1e-4) == BAND
    low, middle, high = corominas(100.0, 1e6)
    assert np.log10(high / middle) == pytest.approx(BAND * 1.6449 / 1.9600, abs=1e-5)


def test_quantiles_are_weighted():
    slid = Slid({"runout": np.array([30.0, 10.0, 20.0])}, np.array([0.02, 0.9, 0.08]))
    assert slid.ends("runout") == (10.0, 10.0, 20.0)
    assert Slid({}, np.zeros(0)).ends("runout") == (None, None, None)


def test_a_quantity_without_a_slide_is_missed_and_has_no_score():
    known = Known(
        {"runout": Survey(9.0, 11.0), "travel": Survey(100.0, 100.0, checked=False)}, 0.0, fall=10.0, volume=1e5
    )
    slid = Slid({"runout": np.array([8.0, 12.0]), "travel": np.array([90.0, 95.0])}, np.ones(2))
    rows = compared("a", known, {"rough": slid, "refined": slid})
    empty = compared("b", known, {"rough": Slid({}, np.zeros(0)), "refined": Slid({}, np.zeros(0))})
    assert compared("c", known, {"rough": slid, "refined": Slid({}, np.zeros(0))})[0].grid == "rough"
    answer = summarised(rows + empty)
    assert [answer[key] for key in ("slides", "quantities", "measured_within", "checked_within")] == [1, 4, 0.25, 0.5]
    assert answer["interval_score"] == pytest.approx(np.mean([0.4, (5 + 20 * 5) / 100]))
    low, _, high = corominas(10.0, 1e5)
    assert answer["corominas_score"] == pytest.approx(interval_score(low, high, 100.0), abs=1e-3)


@pytest.mark.parametrize("name", KNOWN)
def test_a_scene_has_the_crest_from_which_its_slide_is_measured(name):
    campaign = parse(read_scene(SCENES / f"{name}.toml"))
    ground = tomllib.loads((SCENES / f"{name}.toml").read_text()).get("ground", {})
    assert KNOWN[name].crest == ground.get("crest")
    assert (campaign.site.track is None) == (KNOWN[name].crest is not None)


def test_a_slide_without_a_surveyed_travel_has_no_empirical_one():
    known = Known({"centre": Survey(1.8, 1.8)}, 0.0, fall=None, volume=None)
    slid = Slid({"centre": np.array([1.7, 2.0])}, np.ones(2))
    (row,) = compared("d", known, {"rough": slid, "refined": slid})
    assert row.hit
    assert row.corominas is None


@pytest.mark.parametrize("name", ASSUMED)
def test_every_assumption_is_a_scene(name):
    for changes in ASSUMED[name].values():
        assert real_assumptions.scene_of(name, changes).name == parse(read_scene(SCENES / f"{name}.toml")).name
