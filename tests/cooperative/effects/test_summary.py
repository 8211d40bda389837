"""The summary of made-up campaigns whose truth is known."""

import json
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cooperative.estimate import named_estimator
from cooperative.reporting import _page
from cooperative.reporting import _sentences as words
from cooperative.runs import phases_of
from cooperative.scene import Budget, Calibration, LimitLoad, parse
from cooperative.store import Rows
from cooperative.summary import Risk, Summary, summarise
from cooperative.summary._notes import walls_reached
from tests.cooperative.campaign.test_campaign import TINY
from tests.cooperative.effects.test_exposed import HAZARD
from tests.cooperative.estimate.test_twophase import pair

BASE = parse(TINY)


def campaign_with(*, samples, estimator="two-phase", **settings):
    chosen = named_estimator(estimator, {"seed": BASE.plan.seed, **settings})
    return replace(BASE, plan=replace(BASE.plan, samples=samples), estimator=chosen)


def rows(numbers, displacement, **columns):
    count = len(numbers)
    return Rows(
        {
            "sample": np.asarray(numbers, int),
            "status": np.full(count, "FINISHED"),
            "steps": np.ones(count, int),
            "seconds": np.ones(count),
            "displacement": np.asarray(displacement, float),
            "broke_off": np.zeros(count),
            **columns,
        },
        (),
    )


def made_up(count, pf, seed):
    """Rough rows, and a refined grid that can be asked for any samples. The worse a sample, the likelier it is deep."""
    displacement, failed = pair(count, pf, 0.95, seed)
    generator = np.random.default_rng(seed + 1)
    refined_displacement = np.where(failed, 5 + 10 * generator.random(count), 0.05 * displacement / displacement.max())
    deep = generator.random(count) < np.clip(0.4 + 0.5 * np.log(displacement), 0.1, 0.95)
    mode = np.where(failed, np.where(deep, "deep", "shallow"), "none")
    size = np.where(deep, 500.0, 200.0) * np.exp(0.3 * generator.standard_normal(count))

    def refined(numbers):
        at = np.asarray(sorted(numbers), int)
        own = {name: np.where(failed[at], size[at], 0.0) for name in ("depth", "runout", "volume", "area")}
        return rows(at, refined_displacement[at], mode=mode[at], **own)

    return rows(np.arange(count), displacement), refined, failed, mode, size


def play(campaign, rough, refined):
    numbers: list[int] = []
    while asked := phases_of(campaign, rough, refined(numbers)).next_runs(1, ()):
        numbers += asked
    return summarise(campaign, rough, refined(numbers))


@pytest.mark.slow
def test_ratios_means_and_fits_are_those_of_the_population_not_of_the_runs():
    ratio, mean, plain, covered = [], [], [], 0
    for seed in range(14):
        rough, refined, failed, mode, size = made_up(500, 0.25, seed)
        summary = play(campaign_with(samples=500, refined_runs=100), rough, refined)
        truth = np.mean(mode[failed] == "deep")
        deep = summary.modes.shares["deep"]
        ratio.append(deep.ratio - truth)
        covered += deep.interval[0] <= truth <= deep.interval[1]
        mean.append(summary.consequences.means["volume"].mean / size[failed].mean() - 1)
        plain.append(deep.count / summary.probability.failures_refined - truth)
    assert abs(np.mean(ratio)) < 4 * np.std(ratio) / np.sqrt(14)
    assert abs(np.mean(mean)) < 4 * np.std(mean) / np.sqrt(14)
    # Counting the runs alone would be off: the audit looks where failure is in doubt, and there fewer are deep.
    assert np.mean(plain) < -2 * np.std(plain) / np.sqrt(14)
    assert covered >= 11


def test_fits_find_the_family_and_severity_the_larger_mode():
    rough, refined, *_ = made_up(3000, 0.25, 0)
    summary = summarise(campaign_with(samples=3000, estimator="monte carlo"), rough, refined(range(3000)))
    assert summary.consequences.fits["deep"]["volume"].best_aic == "lognormal"
    assert [rank.group for rank in summary.modes.severity["volume"]] == ["deep", "shallow"]
    assert summary.modes.severity["volume"][0].rank_interval == (1, 1)
    assert summary.probability.grids.spearman > 0.5
    assert summary.modes.shares["deep"].probability + summary.modes.shares["shallow"].probability == pytest.approx(
        summary.probability.value
    )


@pytest.mark.parametrize(
    ("plan", "reason"),
    [
        ({"refined_runs": 60}, "the refined runs allowed are spent"),
        ({"target_cov": 0.14}, "the coefficient of variation is at most 0.14"),
        ({"target_cov": 0.02}, "out of reach with 600 samples"),
        ({"estimator": "published", "k_t": 9}, "9 samples in a row stand"),
        ({"estimator": "monte carlo"}, "all samples ran on the refined grid"),
        ({"estimator": "monte carlo", "target_cov": 0.2}, "the coefficient of variation is at most 0.2"),
        ({"estimator": "control variate", "refined_runs": 40}, "the refined runs allowed are spent"),
    ],
)
def test_the_campaign_says_why_it_ended(plan, reason):
    rough, refined, failed, *_ = made_up(600, 0.25, 3)
    campaign = campaign_with(samples=600, **plan)
    summary = play(campaign, rough, refined)
    assert reason in summary.cost.finished
    if "target_cov" in plan and "out of reach" not in reason:
        assert summary.probability.coefficient_of_variation <= plan["target_cov"]
    if plan.get("estimator") != "published":
        assert summary.probability.interval[0] <= failed.mean() <= summary.probability.interval[1]
    if summary.cost.refined_runs < 600 and plan.get("estimator") != "published":
        assert summary.cost.after_more_runs.coefficient_of_variation < summary.probability.coefficient_of_variation
    assert summarise(campaign, rough, refined([0])).cost.finished is None


def test_a_run_that_broke_off_has_no_part_in_modes_and_fits():
    rough, refined, failed, *_ = made_up(60, 0.4, 1)
    table = refined(range(60))
    lost = int(np.flatnonzero(failed)[0])
    for name in ("depth", "runout", "volume", "area"):
        table.columns[name][lost] = np.nan
    table.columns["mode"] = table.columns["mode"].copy()
    table.columns["mode"][lost] = ""
    table.columns["broke_off"][lost] = 1.0
    summary = summarise(campaign_with(samples=60, estimator="monte carlo"), rough, table)
    assert summary.probability.failures_refined == failed.sum()
    assert sum(part.count for part in summary.modes.shares.values()) == failed.sum() - 1
    # Every sample has run: there are no more to buy.
    assert summary.cost.after_more_runs.samples_left == 0
    assert "only more samples would bring" in words.more(summary)
    rounded = replace(summary, probability=replace(summary.probability, coefficient_of_variation=3e-9))
    assert words.more(rounded).endswith("would narrow the interval.")
    # As where all fail.
    certain = replace(summary, probability=replace(summary.probability, coefficient_of_variation=0.0))
    assert words.more(certain) == "All samples are refined: only more samples would narrow the interval."
    further = replace(certain.cost.after_more_runs, runs=2, samples_left=4)
    left = replace(certain, cost=replace(certain.cost, after_more_runs=further))
    assert words.more(left) == ""
    assert summary.consequences.fits["all"]["volume"].samples == failed.sum() - 1


def test_of_elements_at_risk_nothing_is_known_before_a_slide_counts():
    rough, refined, failed, *_ = made_up(60, 0.4, 1)
    campaign = campaign_with(samples=60, estimator="monte carlo")
    campaign = replace(campaign, exposed=parse(TINY + HAZARD).exposed, plan=replace(campaign.plan, slides=2))
    fails = refined(np.flatnonzero(failed)[:3])
    fails.columns["status"][:] = "DECIDED"
    for runs in (refined([]), fails):
        summary = summarise(campaign, rough, runs)
        assert summary.consequences.risk == Risk({"road": None, "house": None}, None)
        (text,) = _page.risks(summary, summary.consequences.risk)
        assert "How likely a slide reaches road, house is not known" in text
    # Where many runs ended and none failed, that is known.
    stands = refined(range(60))
    stands.columns["displacement"][:] = 0.05
    reached = summarise(campaign, rough, stands).consequences.elements_at_risk["house"].reached
    assert reached.probability == 0
    assert 0 < reached.interval[1] < 0.2


@pytest.fixture(scope="module", autouse=True)
def as_json_has_them():
    """Of types that hypothesis fills in: numbers are finite, also the ratio of factors; mappings are dictionaries."""
    st.register_type_strategy(float, st.floats(allow_nan=False, allow_infinity=False))
    st.register_type_strategy(Mapping, lambda kind: st.dictionaries(*map(st.from_type, kind.__args__), max_size=3))
    above_zero, runs = st.floats(0.5, 3.0), st.integers(1, 1000)
    st.register_type_strategy(Calibration, st.builds(Calibration, above_zero, above_zero))
    st.register_type_strategy(LimitLoad, st.builds(LimitLoad, above_zero, above_zero, above_zero))
    st.register_type_strategy(Budget, st.builds(Budget, runs, runs))
    yield
    st.register_type_strategy(float, st.floats())


@given(data=st.data())
@settings(max_examples=8, deadline=None)
def test_a_summary_is_the_same_after_json(data):
    made = data.draw(st.from_type(Summary))
    assert Summary.from_json(json.dumps(made.as_json(), allow_nan=False)) == made


def test_numbers_that_are_not_finite_are_null_in_json_and_other_json_is_no_summary():
    rough, refined, *_ = made_up(60, 0.4, 1)
    made = summarise(campaign_with(samples=60, estimator="monte carlo"), rough, refined(range(60)))
    odd = replace(
        made,
        probability=replace(made.probability, hidden_limit=np.inf),
        cost=replace(made.cost, seconds={"rough": np.nan, "refined": 1.0}),
    ).as_json()
    assert (odd["probability"]["hidden_limit"], odd["cost"]["seconds"]) == (None, {"rough": None, "refined": 1.0})
    for text in (json.dumps(odd), "[]", "{}", '{"name": "x"}', json.dumps({**made.as_json(), "name": 12})):
        with pytest.raises(ValueError, match="Summary"):
            Summary.from_json(text)


def test_walls_are_named_with_how_many_runs_reached_them():
    refined = rows([0, 1, 2], [5.0, 5.0, 0.1], walls=np.array(["x = 0 m; x = 84 m", "x = 84 m", ""]))
    assert walls_reached("refined", refined) == [
        "the slide reached the wall at x = 0 m, which held it, in 1 refined run: lengthen the ground there",
        "the slide reached the wall at x = 84 m, which held it, in 2 refined runs: lengthen the ground there",
    ]


def test_a_rough_sample_that_is_to_be_redone_is_no_obstacle():
    rough, refined, *_ = made_up(60, 0.4, 1)
    fewer = Rows({name: np.delete(column, 7) for name, column in rough.columns.items()}, ("000007.h5 is damaged",))
    summary = summarise(campaign_with(samples=60, estimator="monte carlo"), fewer, refined(range(60)))
    assert summary.probability.grids.samples <= 59
    assert summary.cost.refined_runs == 60


def test_summary_and_words_tell_sampling_from_what_was_not_seen():
    rough, refined, *_ = made_up(600, 0.25, 3)
    summary = play(campaign_with(samples=600, refined_runs=60), rough, refined)
    low, high = summary.probability.sampling_interval
    assert summary.probability.interval[0] == low
    assert summary.probability.interval[1] > high > summary.probability.value
    assert 0 < summary.probability.hidden_limit < 0.5
    text = words.hidden(summary)
    assert f"{low:.3g} to {high:.3g}" in text
    assert f"{summary.probability.coefficient_of_variation:.1%}" in text
    assert f"up to {summary.probability.hidden_limit:.2g} of all samples" in text
    plain = summarise(campaign_with(samples=600, estimator="monte carlo"), rough, refined(range(600)))
    assert (plain.probability.hidden_limit, plain.probability.sampling_interval, words.hidden(plain)) == (0.0, None, "")


def test_summary_says_where_the_ranks_mislead():
    rough, _, failed, *_ = made_up(600, 0.25, 3)
    turned = np.argsort(np.argsort(rough.columns["displacement"]))
    upside_down = rows(np.arange(600), np.sort(rough.columns["displacement"])[::-1][turned])

    def refined(numbers):
        at = np.asarray(sorted(numbers), int)
        return rows(
            at, np.where(failed[at], 5.0, 0.1), **{n: np.zeros(at.size) for n in ("depth", "runout", "volume", "area")}
        )

    summary = play(campaign_with(samples=600, refined_runs=60), upside_down, refined)
    assert any(note.startswith("THE RANKS MISLEAD") for note in summary.notes)
    assert summary.probability.interval[0] <= failed.mean() <= summary.probability.interval[1]


def test_refined_runs_that_all_broke_off_beyond_the_limit_have_a_summary():
    rough, *_ = made_up(40, 0.3, seed=3)
    numbers = np.arange(12)
    refined = rows(numbers, np.full(12, 3.0), broke_off=np.ones(12), status=np.full(12, "NOT_FINITE"))
    summary = summarise(campaign_with(samples=40), rough, refined)
    assert summary.probability.failures_refined == 12
    assert summary.consequences.means["depth"] is None
    assert summary.consequences.means["displacement"].largest == 3.0
    assert summary.consequences.fits == {"all": {}}


def test_more_runs_are_no_more_than_are_left_and_all_samples_are_the_limit():
    rough, refined, failed, *_ = made_up(80, 0.4, 3)
    summary = play(campaign_with(samples=80, refined_runs=60), rough, refined)
    more = summary.cost.after_more_runs
    assert (more.runs, more.samples_left) == (20, 20)
    # All refined, only the sampling of the 80 is left.
    share = summary.probability.value
    assert more.coefficient_of_variation == more.all_samples == pytest.approx(np.sqrt((1 - share) / share / 80))
    assert "Another 20 refined runs" in words.more(summary)
    assert "only more samples help" in words.more(summary)
    whole = play(campaign_with(samples=80, refined_runs=80), rough, refined)
    share = whole.probability.value
    assert whole.probability.coefficient_of_variation == pytest.approx(np.sqrt((1 - share) / share / 80))
    assert share == pytest.approx(failed.mean())
    # Under way, the budget leaves fewer.
    campaign = campaign_with(samples=80, refined_runs=30)
    begun = summarise(campaign, rough, refined(phases_of(campaign, rough, refined([])).next_runs(1, ())))
    more = begun.cost.after_more_runs
    assert more.runs == 30 - begun.cost.refined_runs < more.samples_left == 80 - begun.cost.refined_runs
    # With 59 of 60 runs the last wave waits: its runs count once it is whole, and the forecast counts them all.
    wait, wanted = campaign_with(samples=80, refined_runs=60), []
    while (asked := phases_of(wait, rough, refined(wanted)).next_runs(1, ())) and len(wanted) < 59:
        wanted += asked[:1]
    last = summarise(wait, rough, refined(wanted))
    assert (last.cost.refined_runs, last.cost.after_more_runs.runs) == (59, 1)
    assert last.probability.runs < 59
    assert last.cost.after_more_runs.coefficient_of_variation < 0.99 * last.probability.coefficient_of_variation
    assert any("runs of the wave under way are back" in note for note in last.notes)
    # The published rule takes no more.
    ended = play(campaign_with(samples=80, estimator="published", k_t=9), rough, refined)
    assert (ended.cost.after_more_runs.coefficient_of_variation, words.more(ended)) == (None, "")
