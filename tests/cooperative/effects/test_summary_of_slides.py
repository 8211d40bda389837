"""The summary of made-up slides: which of them slid on, came to rest, broke off, and what that leaves unknown."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import spearmanr

from benchmarks.robustness.invented import LAYERED
from cooperative.reporting import _page
from cooperative.reporting import _sentences as words
from cooperative.runs import phases_of
from cooperative.scene import parse
from cooperative.summary import CutOff, slides_of, summarise
from tests.cooperative.campaign.test_campaign import TINY
from tests.cooperative.effects.test_exposed import HAZARD
from tests.cooperative.effects.test_summary import campaign_with, rows


def drawn_classes(slides):
    """200 samples on both grids, of which 11 stand on the rough one alone; failures end once they have failed, but for
    those drawn to slide on. The campaign, rough and refined rows."""
    generator = np.random.default_rng(8)
    rough = np.sort(np.exp(generator.normal(-1.5, 1.0, 200)))[::-1]
    fails, missed = np.zeros(200, bool), generator.choice(np.flatnonzero(rough < 1.0)[:60], 11, replace=False)
    fails[rough > 1.0] = fails[missed] = True
    displacement = np.where(fails, 1.0 + 0.01 * generator.random(200), rough.clip(max=0.9))
    campaign = campaign_with(samples=200, estimator="monte carlo")
    campaign = replace(campaign, plan=replace(campaign.plan, slides=slides))
    own = {name: np.where(fails, np.nan, 0.0) for name in ("depth", "runout", "volume", "area")}
    table = rows(np.arange(200), displacement, mode=np.full(200, "", "<U8"), **own)
    table.columns["status"] = np.where(fails, "DECIDED", "SETTLED")
    before = rows(np.arange(200), rough)
    wanted = slides_of(campaign, phases_of(campaign, before, table), table).missing
    drawn = np.isin(np.arange(200), wanted) if slides is not None else fails
    table.columns["status"][drawn] = "SETTLED"
    table.columns["mode"][drawn] = "deep"
    table.columns["displacement"][drawn] = 5 + 10 * generator.random(drawn.sum())
    for name in own:
        table.columns[name][drawn] = 20 + 10 * generator.random(drawn.sum())
    return campaign, before, table


@pytest.mark.parametrize("slides", [0, 3, None])
def test_grids_agree_as_all_classes_do_whichever_failures_slide_on(slides):
    campaign, rough, refined = drawn_classes(slides)
    grids = summarise(campaign, rough, refined).probability.grids
    assert (grids.samples, grids.same_class) == (200, pytest.approx(0.945))
    # Where some failures' ways are unknown all are, and the ranks are those of displacements up to the limit.
    displacement = refined.columns["displacement"]
    decided = refined.columns["status"] == "DECIDED"
    known = displacement if slides is None else np.minimum(displacement, displacement[decided].min())
    assert grids.spearman == pytest.approx(spearmanr(rough.columns["displacement"], known).statistic)


def test_runs_that_broke_off_have_the_class_that_they_tell():
    campaign, rough, refined = drawn_classes(None)
    lost = np.flatnonzero(refined.columns["displacement"] > 1)[[0, 1, 5]]
    lost = np.append(lost, np.flatnonzero(refined.columns["displacement"] < 1)[:2])
    refined.columns["broke_off"][lost], refined.columns["status"][lost] = 1.0, "NOT_FINITE"
    grids = summarise(campaign, rough, refined).probability.grids
    # Those that stood until they broke off have no class.
    assert grids.samples == 198
    rough.columns["broke_off"][[0, 199]] = 1.0
    assert summarise(campaign, rough, refined).probability.grids.samples == 197


def test_a_campaign_without_slides_says_that_no_consequence_was_asked_for():
    campaign, rough, refined = drawn_classes(0)
    summary = summarise(campaign, rough, refined)
    assert summary.notes[0].startswith("the scene asks for no slides (slides = 0): the 30 refined failures ended")
    assert (summary.consequences.slides, summary.consequences.planned) == (0, 0)
    assert summary.probability.failures_refined == 30
    assert _page.without_slides(summary).startswith("No consequence was asked for")
    assert "of 200 samples. Failures that ended once their class was known share one rank." in words.agreement(summary)
    three = summarise(*drawn_classes(3))
    assert three.notes[0].startswith("3 of 30 refined failures slid on")
    assert (three.consequences.planned, _page.without_slides(three)) == (3, "")
    # Drawn, and not yet at their end.
    campaign, rough, refined = drawn_classes(3)
    refined.columns["status"][refined.columns["status"] == "SETTLED"] = "DECIDED"
    assert _page.without_slides(summarise(campaign, rough, refined)) == "No slide has come to its end yet."


def five_slides(status="SETTLED", *, slid=5, reached=2):
    """20 samples that all ran refined, of which some slid; `reached` of these came over the road, worth 1000, and none
    over the house. The campaign with both elements at risk, rough and refined rows."""
    base = parse(TINY + HAZARD)
    campaign = campaign_with(samples=20, estimator="monte carlo")
    campaign = replace(campaign, hazard=base.hazard, exposed=base.exposed, run=replace(base.run, t_end=20.0))
    number = np.arange(20)
    displacement, came = np.where(number < slid, 5.0 + number, 0.1), number < reached
    fails = displacement > 1
    own = {name: np.where(fails, 0.5 * displacement, 0.0) for name in ("depth", "runout", "volume", "area")}
    for name, value in (("thickness", 2.0), ("speed", 3.0), ("arrival", 15.0)):
        own[f"{name}_at_road"] = np.where(came, value + 4.0 * (number % 2), np.nan)
        own[f"{name}_at_house"] = np.full(20, np.nan)
    own["area_columns"] = np.where(fails, 1.0, np.nan)
    table = rows(number, displacement, mode=np.where(fails, "deep", "none"), **own)
    table.columns["status"] = np.where(fails, status, "SETTLED").astype("<U10")
    return campaign, rows(number, displacement), table


def test_four_slides_have_a_range_and_no_interval_and_five_have_one():
    four = summarise(*five_slides(slid=4)).consequences.means
    five = summarise(*five_slides(slid=5)).consequences.means
    for name, (smallest, largest) in {"displacement": (5, 8), "runout": (2.5, 4), "volume": (2.5, 4)}.items():
        assert four[name].interval is None
        assert (four[name].smallest, four[name].largest) == (smallest, largest)
        low, high = five[name].interval
        assert 0.3 * five[name].mean < low < high < 3 * five[name].mean
    assert words.interval(four["runout"]) == "too few for an interval"


def test_no_mean_lies_beyond_the_time_of_the_runs_or_below_the_ground():
    campaign, rough, refined = five_slides(slid=12, reached=12)
    number, deep = np.arange(20), campaign.site.shape.extent[-1]
    refined.columns["arrival_at_road"] = np.where(number < 12, np.where(number < 5, 0.1, 19.9), np.nan)
    refined.columns["depth"] = np.where(number < 12, np.where(number < 2, 0.1 * deep, deep), 0.0)
    summary = summarise(campaign, rough, refined)
    arrival = summary.consequences.elements_at_risk["road"].arrival
    assert arrival.mean < arrival.interval[1] == 20.0
    depth = summary.consequences.means["depth"]
    assert depth.mean < depth.interval[1] == deep


@pytest.mark.parametrize(("slid", "reached"), [(0, 0), (3, 0), (3, 2), (8, 0), (8, 3)])
def test_an_expected_loss_is_at_most_value_times_the_upper_probability(slid, reached):
    summary = summarise(*five_slides(slid=slid, reached=reached))
    road, house = (summary.consequences.elements_at_risk[name] for name in ("road", "house"))
    low, high = road.loss.interval
    assert 0 <= low <= road.loss.expected <= high <= 1000 * road.reached.interval[1]
    assert summary.consequences.risk.loss.interval == (low, high)
    if slid < 5 or not reached:
        assert (low, high) == (0, pytest.approx(1000 * road.reached.interval[1]))
    assert high > 0
    assert house.loss is None
    text = " ".join(_page.risks(summary, summary.consequences.risk))
    assert ("not within 20 s" in text, "at most" in text) == (True, True)


def test_slides_that_had_not_come_to_rest_are_counted_and_all_they_do_is_at_least_that():
    campaign, rough, refined = five_slides("FINISHED")
    refined.columns["status"][0] = "SETTLED"
    summary = summarise(campaign, rough, refined)
    assert summary.consequences.cut_off == CutOff(of=5, at_t_end=4, broke_off=0, t_end=20.0)
    assert "4 of 5 slides had not come to rest when they ended at 20 s" in " ".join(summary.notes)
    assert all(each.at_least for each in summary.consequences.means.values())
    text = " ".join(_page.risks(summary, summary.consequences.risk))
    assert "at least 0.1" in text
    assert "interval of what 20 s show" in text
    assert "4 of 5 slides had not come to rest" in words.cut_off(summary)
    # Each failure may reach the road yet, and all that it is worth may then be lost.
    road, most = summary.consequences.elements_at_risk["road"], summary.probability.interval[1]
    assert (road.reached.interval[1], road.loss.interval[1]) == (most, pytest.approx(1000 * most))
    settled = summarise(*five_slides())
    assert settled.consequences.cut_off.at_t_end == 0
    assert not any(each.at_least for each in settled.consequences.means.values())
    risks = _page.risks(settled, settled.consequences.risk)
    assert "at least" not in " ".join([*risks, *settled.notes, words.cut_off(settled)])
    # Where nothing looks for rest it is not known.
    campaign = replace(campaign, run=replace(campaign.run, settle=False))
    assert any("not looked at for rest" in note for note in summarise(campaign, rough, refined).notes)


def test_a_slide_that_broke_off_went_at_least_so_far_and_has_no_other_part():
    campaign, rough, refined = five_slides()
    refined.columns["status"][1], refined.columns["broke_off"][1] = "NOT_FINITE", 1.0
    for name in ("depth", "runout", "volume", "area", "area_columns"):
        refined.columns[name][1] = np.nan
    summary = summarise(campaign, rough, refined)
    assert (summary.consequences.cut_off.broke_off, summary.consequences.cut_off.at_t_end) == (1, 0)
    assert any(note.startswith("1 of 5 slides broke off") for note in summary.notes)
    spreads = summary.consequences.means
    assert [spreads[name].at_least for name in ("displacement", "runout")] == [True, False]


def test_runs_that_had_not_settled_when_their_class_was_taken_are_named():
    campaign, rough, refined = five_slides()
    refined.columns["status"][7:9], refined.columns["displacement"][8] = "FINISHED", 0.7
    (note,) = summarise(campaign, rough, refined).notes
    assert note.startswith(
        "2 of 15 refined runs that stand had not settled at t_end = 20 s; the farthest had moved 0.7 m"
    )


def test_runs_that_settled_close_to_failure_are_named():
    campaign, rough, refined = five_slides()
    refined.columns["displacement"][7:9] = 0.21, 0.19
    (note,) = summarise(campaign, rough, refined).notes
    assert note.startswith("1 of 15 refined runs that stand settled after 0.21 m, more than 0.2 of the 1 m")


@pytest.mark.parametrize(
    ("left", "named"), [("10.0", False), ("8.9", False), ("6.0", True), ("10.0], [2.0, 6.0", True)]
)
def test_ground_with_a_second_face_is_named(left, named):
    two_faced = LAYERED.replace("[[0.0, 10.0], [8.0", f"[[0.0, {left}], [4.0, 10.0], [8.0").replace(
        "[[layer]]", "toe = 16.0\n[[layer]]", 1
    )
    campaign, rough, refined = five_slides()
    notes = summarise(replace(campaign, ground=parse(two_faced).site), rough, refined).notes
    note = "the ground falls by 4 m on the other side of its crest too. A slide there is a failure, and its run-out is"
    assert any(note in each for each in notes) == named
