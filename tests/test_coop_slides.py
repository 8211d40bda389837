"""Failures that slide on to their end while the others end once they have failed."""

import csv
import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cooperative import campaign, runs
from cooperative.estimate import (
    AuditPlan,
    MonteCarlo,
    Phases,
    Population,
    Published,
    TwoPhase,
    drawn_slides,
    next_audit,
    sample_weights,
    shares,
    slide_chances,
    slide_weights,
    two_phase,
)
from cooperative.reporting import progress_of, report, words
from cooperative.scene import parse
from cooperative.store import SLIDES, open_store, read_rows, read_sample, read_store, restart_path
from tests.test_campaign import TINY

DATA = Path(__file__).resolve().parent.parent / "benchmarks" / "data" / "section_pairs.csv"
SCENE = TINY.replace("k_t = 2", "k_t = 4")


weights = st.lists(st.floats(1e-3, 1.0), min_size=1, max_size=40).map(np.array)


@given(weights, st.integers(1, 45), st.integers(0, 2**63 - 1))
def test_as_many_slide_as_are_asked_for_and_order_does_not_matter(weight, count, seed):
    number = np.arange(weight.size) * 7
    chance = slide_chances(weight, count)
    assert chance.sum() == pytest.approx(min(count, weight.size))
    assert np.all((chance > 0) & (chance <= 1))
    drawn = drawn_slides(number, chance, seed)
    assert drawn.sum() == min(count, weight.size)
    assert np.array_equal(drawn[::-1], drawn_slides(number[::-1], chance[::-1], seed))


def test_chances_are_those_of_the_draw():
    weight = np.array([5.0, 1.0, 1.0, 2.0, 1.0, 0.5])
    chance = slide_chances(weight, 3)
    assert chance == pytest.approx([1.0, 2 / 5.5, 2 / 5.5, 4 / 5.5, 2 / 5.5, 1 / 5.5])
    drawn = np.mean([drawn_slides(np.arange(6), chance, seed) for seed in range(4000)], axis=0)
    assert drawn == pytest.approx(chance, abs=0.03)
    assert np.array_equal(slide_chances(weight, None), np.ones(6))
    assert not drawn_slides(np.arange(6), slide_chances(weight, 0), 1).any()


def known_population():
    """Screening, failures, displacements and modes of 400 sections, all of which ran refined."""
    rows = list(csv.DictReader(line for line in DATA.open() if not line.startswith("#")))
    rough, refined = (np.array([float(r[f"{g}_displacement"]) for r in rows]) for g in ("rough", "refined"))
    return rough, refined, np.array([row["refined_mode"] for row in rows])


@pytest.mark.slow
def test_slides_drawn_from_an_audit_estimate_a_known_population_without_bias():
    rough, refined, mode = known_population()
    population, fails = Population(rough), refined > 1.0
    truth = float((mode[fails] == "deep").mean())
    runs, count, repeats = 60, 15, 200
    totals, covered = [], []
    for seed in range(repeats):
        plan, answers = AuditPlan(runs=runs, seed=seed), {}
        while wanted := next_audit(population, answers, plan):
            answers |= {number: bool(fails[number]) for number in wanted}
        stands_for = sample_weights(population, answers, plan)
        numbers = np.array(list(stands_for))
        weight, failed = np.array([stands_for[n] for n in numbers]), fails[numbers]
        chance, drawn = np.ones(numbers.size), failed.copy()
        chance[failed] = slide_chances(weight[failed], count)
        drawn[failed] = drawn_slides(numbers[failed], chance[failed], seed)
        whole = slide_weights(weight, failed, chance, drawn)
        totals.append((whole[drawn] @ refined[numbers[drawn]], whole[drawn].sum(), whole @ np.ones(numbers.size)))
        share = shares(mode[numbers[drawn]], whole[drawn], ("deep",))["deep"]
        covered.append(share.interval[0] <= truth <= share.interval[1])
        assert two_phase(population, answers, plan).refined_runs == runs
    totals = np.array(totals)
    error = totals.std(axis=0, ddof=1) / np.sqrt(repeats)
    expected = refined[fails].sum() / fails.size, fails.mean()
    assert np.all(np.abs(totals[:, :2].mean(axis=0) - expected) < 3.5 * error[:2])
    assert np.mean(covered) == pytest.approx(0.95, abs=0.05)


@pytest.mark.parametrize("estimator", [TwoPhase(refined_runs=60), MonteCarlo(refined_runs=60), Published(k_t=8)])
def test_weights_give_the_printed_probability_of_failure(estimator):
    rough, refined, _ = known_population()
    phases = Phases(estimator, 1.0, population=Population(rough))
    while wanted := phases.next_runs(8, ()):
        phases = phases.refined({n: (refined[n], False) for n in {*phases.answers, *wanted}})
    found = phases.weights
    assert sum(found.values()) == pytest.approx(1.0, abs=1e-12)
    failed = [n for n in found if phases.answers[n]]
    assert sum(found[n] for n in failed) == pytest.approx(phases.estimate.probability, abs=1e-12)
    # Among the failures they are in proportion to those of the draws.
    drawn = estimator.weights(phases.population, phases.answers)
    factors = [found[n] / drawn[n] for n in failed]
    assert factors == pytest.approx([factors[0]] * len(factors))


def test_a_run_without_an_answer_stands_for_nothing():
    phases = Phases(MonteCarlo(), 1.0, population=Population(np.arange(4.0)))
    found = phases.refined({0: (0.1, False), 1: (0.2, True), 2: (2.0, True), 3: (0.3, False)})
    assert found.answers == {0: False, 1: None, 2: True, 3: False}
    assert found.weights == pytest.approx({0: 1 / 3, 1: 0.0, 2: 1 / 3, 3: 1 / 3})


def test_slides_that_all_run_change_nothing():
    weight, failed = np.array([0.1, 0.2, 0.3]), np.array([True, True, False])
    assert np.array_equal(slide_weights(weight, failed, np.ones(3), failed), weight)
    assert np.array_equal(slide_weights(weight, failed, np.ones(3), np.zeros(3, bool)), [0.0, 0.0, 0.3])


@pytest.fixture(scope="module")
def all_slides(tmp_path_factory):
    folder = tmp_path_factory.mktemp("all")
    return folder, campaign.run(SCENE, folder)


def asked(slides):
    return SCENE + f"slides = {json.dumps(slides)}\n"


@pytest.mark.slow
def test_a_drawn_slide_goes_on_bit_for_bit(all_slides, tmp_path):
    folder, whole = all_slides
    summary = campaign.run(asked(1), tmp_path)
    assert summary["probability_of_failure"] == whole["probability_of_failure"]
    assert summary["failures_refined"] == whole["failures_refined"] > 1
    assert (summary["slides"], whole["slides"]) == (1, whole["failures_refined"])
    assert any("slid on" in note for note in summary["notes"])
    assert not any("slid on" in note for note in whole["notes"])
    with open_store(tmp_path, asked(1)) as store, open_store(folder, SCENE) as other:
        rows = read_rows(store, "refined")
        decided = [n for n, status in zip(rows.numbers, rows.columns["status"], strict=True) if status == "DECIDED"]
        assert len(decided) == whole["failures_refined"] - 1
        (slid,) = read_rows(store, SLIDES).numbers
        one, same = read_sample(store, "refined", slid), read_sample(other, "refined", slid)
        assert (one.row, one.status, one.steps) == (same.row, same.status, same.steps)
        assert all(np.array_equal(one.fields[name], same.fields[name]) for name in same.fields)
        assert not read_sample(store, "refined", decided[0]).fields
        assert not any(restart_path(tmp_path, SLIDES, number).exists() for number in rows.numbers)
    assert np.isnan(rows.columns["runout"][[rows.numbers.index(n) for n in decided]]).all()


LONGER = SCENE.replace("t_end = 4.0", "t_end = 4.0\nslides_t_end = 40.0")


def test_slides_run_on_beyond_the_time_of_their_class(all_slides, tmp_path):
    folder, before = all_slides
    whole = campaign.run(LONGER, tmp_path / "all")
    # Which samples fail, and so the answer, is what it was.
    for key in ("probability_of_failure", "interval", "failures_refined", "refined_runs"):
        assert whole[key] == before[key]
    assert whole["grids"]["same_class"] == before["grids"]["same_class"]
    assert before["cut_off"]["at_t_end"] > whole["cut_off"]["at_t_end"] == 0
    assert any("had not come to rest when they ended at 4 s" in note for note in before["notes"])
    some = campaign.run(LONGER + "slides = 2\n", tmp_path / "some")
    assert (some["slides"], some["probability_of_failure"]) == (2, whole["probability_of_failure"])
    stores = {name: read_store(tmp_path / name) for name in ("all", "some")} | {"short": read_store(folder)}
    rows = {name: read_rows(store, "refined") for name, store in stores.items()}
    short, long = rows["short"].columns, rows["all"].columns
    fails, cut = short["displacement"] > 1.0, short["status"] == "FINISHED"
    assert np.array_equal(long["displacement"] > 1.0, fails)
    assert (long["steps"][fails & cut] > short["steps"][fails & cut]).all()
    for name in ("displacement", "steps", "status"):
        assert np.array_equal(long[name][~(fails & cut)], short[name][~(fails & cut)])
    # From where a slide had failed it comes to the same end.
    for number in read_rows(stores["some"], SLIDES).numbers:
        one, same = (read_sample(stores[name], "refined", number) for name in ("some", "all"))
        assert (one.row, one.status, one.steps) == (same.row, same.status, same.steps)
    # What it costs at most is counted.
    sizes = [runs.grid_size(parse(text), grid).steps for text in (SCENE, LONGER) for grid in ("rough", "refined")]
    assert (sizes[2], sizes[3]) == (sizes[0], pytest.approx(10 * sizes[1]))


def test_slides_that_lost_their_restart_point_start_afresh(all_slides, tmp_path, monkeypatch):
    class Killed(Exception):
        pass

    def interrupted(*_):
        raise Killed

    folder, _ = all_slides
    with monkeypatch.context() as patched:
        patched.setattr(campaign, "_slide_on", interrupted)
        with pytest.raises(Killed):
            campaign.run(asked(2), tmp_path)
    kept = list((tmp_path / "restart").glob("slides-*.h5"))
    assert len(kept) >= 2
    status = progress_of(tmp_path)
    assert (status.grids[2].grid, status.grids[2].done, status.grids[2].planned) == (SLIDES, 0, 2)
    assert not status.grids[2].at_least
    assert "  slides         0 of 2 samples" in words(status)
    for path in kept[1:]:
        path.unlink()
    again = campaign.run(asked(2), tmp_path)
    assert again["slides"] == 2
    assert (progress_of(tmp_path).grids[2].done, len(progress_of(folder).grids)) == (2, 2)
    with open_store(tmp_path, asked(2)) as store, open_store(folder, SCENE) as other:
        for number in read_rows(store, SLIDES).numbers:
            assert read_sample(store, "refined", number).row == read_sample(other, "refined", number).row


def test_restart_points_that_wait_for_the_draw_are_no_more_than_twice_the_slides(tmp_path):
    for number in range(7):
        path = restart_path(tmp_path, SLIDES, number)
        path.parent.mkdir(exist_ok=True)
        path.touch()
    restart_path(tmp_path, SLIDES, 5).unlink()
    weights = {0: 0.1, 1: 0.4, 2: 0.2, 3: 0.3, 4: 0.0, 5: 0.5}
    phases = SimpleNamespace(answers={**dict.fromkeys(range(6), True), 6: False}, weights=weights)
    store = SimpleNamespace(folder=tmp_path)

    def kept(slides):
        hands = SimpleNamespace(campaign=SimpleNamespace(plan=SimpleNamespace(slides=slides)))
        campaign._drop_restart_points(hands, store, phases)
        return [number for number in range(6) if restart_path(tmp_path, SLIDES, number).exists()]

    assert kept(None) == kept(0) == kept(3) == [0, 1, 2, 3, 4]
    assert kept(2) == [1, 2, 3, 4]
    assert kept(1) == [1, 4]


@pytest.mark.usefixtures("unrendered")
def test_a_class_is_all_that_an_audit_without_slides_asks(all_slides, tmp_path):
    _, whole = all_slides
    summary = campaign.run(asked(0), tmp_path)
    assert summary["probability_of_failure"] == whole["probability_of_failure"]
    assert summary["slides"] == 0
    assert summary["consequences_of_failures"] == {}
    assert not (tmp_path / "restart").exists() or not list((tmp_path / "restart").iterdir())
    assert not any("slid on" in note for note in summary["notes"])
    assert [each.grid for each in progress_of(tmp_path).grids] == ["rough", "refined"]
    assert "note: the scene asks for no slides (slides = 0)" in report(tmp_path)
    shown = (tmp_path / "report.html").read_text()
    # Every section that needs slides says so.
    for section in ("How far, how much, how deep", "What the slope looks like", "Distributions of what the slides do"):
        assert f"<h2>{section}</h2>\n<p>No consequence was asked for" in shown


@pytest.mark.parametrize(
    ("said", "match"),
    [
        ('slides = 0\nmodes = "refined"', "slides = 0 ends every refined run.*modes = 'refined'"),
        ("slides = -1", "slides = -1: give 0 or more"),
        ('slides = "some"', "or 'all'"),
        ("[run]\nslides_t_end = 3.0", "slides_t_end = 3 s is before t_end = 4 s"),
        ("slides = 0\n[run]\nslides_t_end = 9.0", "slides_t_end = 9 s has no say beside .* slides = 0"),
    ],
)
def test_bad_slides_are_named(said, match):
    plan, _, run = said.partition("[run]")
    with pytest.raises(ValueError, match=match):
        parse(SCENE.replace("[run]", f"[run]{run}") + plan)
