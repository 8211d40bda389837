"""Scores of real slides against values worked out by hand; their scenes and surveys belong together."""

import json
import tomllib
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.sites import real_assumptions
from benchmarks.sites.real_calibrated import calibrated, shared_factor
from benchmarks.sites.real_slides import SCENES, Slid, chosen_runs, compared, summarised
from benchmarks.sites.real_surveys import BAND, KNOWN, Known, Survey, corominas, crps, interval_score
from cooperative.runs import random_soil
from cooperative.scene import parse, read_scene

ASSUMED = json.loads((SCENES / "assumptions.json").read_text())


def slid_alike(**quantities):
    """Slides that stand for one sample each and came to rest."""
    (n,) = {len(values) for values in quantities.values()}
    ends = {"number": np.arange(n), "at_rest": np.ones(n, bool), "held": np.zeros(n, bool)}
    return Slid(ends | {name: np.array(values) for name, values in quantities.items()}, np.ones(n))


def test_an_interval_scores_its_width_and_twenty_times_what_it_is_missed_by():
    known = Survey(100.0, 100.0)
    assert interval_score(80.0, 120.0, known) == pytest.approx(0.4)
    assert interval_score(110.0, 120.0, known) == pytest.approx((10 + 20 * 10) / 100)
    assert interval_score(40.0, 90.0, known, miss=0.5) == pytest.approx((50 + 4 * 10) / 100)


def test_the_score_of_a_surveyed_range_is_the_mean_over_it():
    # An interval to the middle of the range misses half of it, by a quarter of its width in the mean of that half.
    assert interval_score(80.0, 100.0, Survey(90.0, 110.0)) == pytest.approx((20 + 20 * 2.5) / 100, rel=1e-2)
    slides, weight = np.array([95.0, 102.0, 111.0]), np.array([1.0, 2.0, 1.0])
    each = [crps(slides, weight, Survey(value, value)) * value for value in np.linspace(90, 110, 201)]
    assert crps(slides, weight, Survey(90.0, 110.0)) == pytest.approx(np.mean(each) / 100, rel=1e-9)


@given(st.floats(-2, 2), st.floats(0.2, 3), st.integers(0, 99))
@settings(max_examples=20)
def test_crps_is_the_area_between_the_distribution_and_the_step_of_what_came_true(at, scale, seed):
    rng = np.random.default_rng(seed)
    slides, weight = 10 + scale * rng.normal(size=7), rng.uniform(0.1, 1, 7)
    x = np.linspace(10 - 15, 10 + 15, 60001)
    below = (slides[:, None] <= x).T @ weight / weight.sum()
    area = np.trapezoid((below - (x >= 10 + at)) ** 2, x)
    assert crps(slides, weight, Survey(10 + at, 10 + at)) * (10 + at) == pytest.approx(area, abs=2e-3)


def test_what_is_not_scored_has_an_interval_and_no_score():
    known = Known({"volume": Survey(9.0, 11.0, scored=False, note="given")}, 0.0, fall=None, volume=None)
    slid = slid_alike(volume=[8.0, 12.0])
    (row,) = compared("a", known, {"rough": slid, "refined": slid})
    assert (row.low, row.high, row.hit, row.score, row.crps) == (8.0, 12.0, True, None, None)
    assert summarised([row])["quantities"] == 0
    for slide in KNOWN.values():
        assert all(survey.scored or survey.note for survey in slide.surveys.values())


def test_a_row_counts_the_slides_at_rest_and_those_that_a_wall_held():
    known = Known({"runout": Survey(9.0, 11.0)}, 0.0, fall=None, volume=None)
    ends = {"number": np.arange(3), "at_rest": np.array([True, False, True]), "held": np.array([False, False, True])}
    slid = Slid({"runout": np.array([8.0, 12.0, 13.0]), **ends}, np.array([1.0, 1.0, 5.0]))
    (row,) = compared("a", known, {"rough": slid_alike(runout=[9.0]), "refined": slid})
    assert (row.slides, row.at_rest, row.held) == (3, 2, 1)
    (row,) = compared("a", known, {"rough": Slid({}, np.zeros(0)), "refined": Slid({}, np.zeros(0))})
    assert (row.slides, row.at_rest, row.held) == (0, 0, 0)


def test_the_samples_that_count_have_their_median_on_the_rough_grid_too():
    known = Known({"runout": Survey(9.0, 11.0)}, 0.0, fall=None, volume=None)
    rough = slid_alike(runout=[30.0, 10.0, 20.0, 40.0])
    ends = {"at_rest": np.ones(3, bool), "held": np.zeros(3, bool)}
    # Sample 7 stands on the rough grid, and sample 2 stands for most.
    refined = Slid({"runout": np.ones(3), "number": np.array([2, 7, 0]), **ends}, np.array([5.0, 9.0, 1.0]))
    (row,) = compared("a", known, {"rough": rough, "refined": refined})
    assert row.rough_same == 20.0
    (row,) = compared("a", known, {"rough": rough, "refined": Slid({}, np.zeros(0))})
    assert row.rough_same == row.median == 20.0


def test_the_shared_factor_of_a_sample_is_that_of_all_its_zones():
    campaign = parse(read_scene(SCENES / "upper_san_fernando_1971.toml"))
    soil = random_soil(campaign)
    samples = np.zeros((2, soil.modes))
    field, plain = campaign.random["residual_ratio"], np.zeros(soil.modes)
    moves = [float(soil.factor(field, one)) != float(soil.factor(field, plain)) for one in np.eye(soil.modes)]
    (at,) = np.flatnonzero(moves)
    samples[1, at] = 1.0
    spread = np.sqrt(np.log1p(0.25**2))
    expected = np.exp(spread * np.array([0, 1]) - spread**2 / 2)
    np.testing.assert_allclose(shared_factor(soil, campaign, samples)["shared_factor"], expected, rtol=1e-5)


def test_a_slide_corrects_the_factor_that_both_dams_share():
    # Run-out is 50 over the factor, and 53 m were surveyed: the factor is 0.94, and so is that of the other dam.
    rng, cov, n = np.random.default_rng(3), 0.25, 4000
    factor = [np.exp(np.sqrt(np.log1p(cov**2)) * rng.normal(size=n) - np.log1p(cov**2) / 2) for _ in range(2)]
    surveys = {"runout": Survey(45.0, 61.0), "crest_loss": Survey(9.0, 10.0)}
    lower = Slid({"runout": 50 / factor[0], "crest_loss": np.full(n, 9.5), "shared_factor": factor[0]}, np.ones(n))
    upper = Slid({"centre": 2 / factor[1], "shared_factor": factor[1]}, np.ones(n))
    known, figures = calibrated(lower, upper, surveys, cov)
    # In logarithms of the run-out: a normal prior times a normal likelihood.
    prior, seen = np.log1p(cov**2), (16**2 / 12 + (0.2 * 53) ** 2) / 53**2
    mean = (-prior / 2 / prior + np.log(50 / 53) / seen) / (1 / prior + 1 / seen)
    assert figures["factor_median"] == pytest.approx(np.exp(mean), rel=0.03)
    assert np.average(np.log(upper.quantities["shared_factor"]), weights=known.weight) == pytest.approx(
        np.log(figures["factor_median"]), abs=0.01
    )
    assert np.ptp(known.ends("centre")) < np.ptp(upper.ends("centre"))


def test_corominas_relation():
    # log(H / L) = -0.085 * 6 - 0.047 = -0.557; H = 100 m.
    low, middle, high = corominas(100.0, 1e6, miss=0.05)
    assert middle == pytest.approx(100 * 10**0.557)
    assert [low / middle, high / middle] == pytest.approx([10**-BAND, 10**BAND])
    assert pytest.approx(0.3905, abs=1e-4) == BAND
    low, middle, high = corominas(100.0, 1e6)
    assert np.log10(high / middle) == pytest.approx(BAND * 1.6449 / 1.9600, abs=1e-5)


def test_a_campaign_that_was_stopped_before_its_refined_runs_has_slides_on_the_rough_grid_alone():
    """What slid and its weight are of the finest grid with runs, the rough one here."""
    columns = {"displacement": np.array([2.0, 0.1, 3.0]), "broke_off": np.array([False, False, True])}
    nothing = SimpleNamespace(numbers=[], columns={})
    stopped = SimpleNamespace(
        rough=SimpleNamespace(numbers=[4, 5, 6], columns=columns), refined=nothing,
        slid=np.array([True, False, False]), weight=np.array([3.0, 0.0, 0.0]),
    )  # fmt: skip
    chosen = chosen_runs(stopped, 1.0)
    assert [part.tolist() for part in chosen["rough"][1:]] == [[True, False, False], [1.0, 1.0, 1.0]]
    assert [len(part) for part in chosen["refined"]] == [0, 0, 0]
    refined = SimpleNamespace(numbers=[5, 6], columns={})
    ended = SimpleNamespace(rough=stopped.rough, refined=refined, slid=np.ones(2, bool), weight=np.array([1.0, 2.0]))
    assert chosen_runs(ended, 1.0)["refined"][2].tolist() == [1.0, 2.0]


def test_quantiles_are_weighted():
    slid = Slid({"runout": np.array([30.0, 10.0, 20.0])}, np.array([0.02, 0.9, 0.08]))
    assert slid.ends("runout") == (10.0, 10.0, 20.0)
    assert Slid({}, np.zeros(0)).ends("runout") == (None, None, None)


def test_a_quantity_without_a_slide_is_missed_and_has_no_score():
    known = Known(
        {"runout": Survey(9.0, 11.0), "travel": Survey(100.0, 100.0, checked=False)}, 0.0, fall=10.0, volume=1e5
    )
    slid = slid_alike(runout=[8.0, 12.0], travel=[90.0, 95.0])
    rows = compared("a", known, {"rough": slid, "refined": slid})
    empty = compared("b", known, {"rough": Slid({}, np.zeros(0)), "refined": Slid({}, np.zeros(0))})
    assert compared("c", known, {"rough": slid, "refined": Slid({}, np.zeros(0))})[0].grid == "rough"
    answer = summarised(rows + empty)
    assert [answer[key] for key in ("slides", "quantities", "measured_within", "checked_within")] == [1, 4, 0.25, 0.5]
    assert answer["interval_score"] == pytest.approx(np.mean([0.4, (5 + 20 * 5) / 100]))
    low, _, high = corominas(10.0, 1e5)
    assert answer["corominas_score"] == pytest.approx(interval_score(low, high, Survey(100.0, 100.0)), abs=1e-3)


@pytest.mark.parametrize("name", KNOWN)
def test_a_scene_has_the_crest_from_which_its_slide_is_measured(name):
    campaign = parse(read_scene(SCENES / f"{name}.toml"))
    ground = tomllib.loads((SCENES / f"{name}.toml").read_text()).get("ground", {})
    assert KNOWN[name].crest == ground.get("crest")
    assert (campaign.site.track is None) == (KNOWN[name].crest is not None)


def test_a_slide_without_a_surveyed_travel_has_no_empirical_one():
    known = Known({"centre": Survey(1.8, 1.8)}, 0.0, fall=None, volume=None)
    slid = slid_alike(centre=[1.7, 2.0])
    (row,) = compared("d", known, {"rough": slid, "refined": slid})
    assert row.hit
    assert row.corominas is None


@pytest.mark.parametrize("name", ASSUMED)
def test_every_assumption_is_a_scene(name):
    for changes in ASSUMED[name].values():
        assert real_assumptions.scene_of(name, changes).name == parse(read_scene(SCENES / f"{name}.toml")).name
