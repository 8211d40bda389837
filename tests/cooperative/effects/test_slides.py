"""Failures that slide on to their end while the others end once they have failed."""

import json
import shutil
from contextlib import nullcontext
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import norm

from benchmarks.robustness import invented
from benchmarks.statistics import estimators_means as means
from benchmarks.statistics import section_pairs
from cooperative import campaign, runs
from cooperative.estimate import (
    Failures,
    Slides,
    TwoPhase,
    shares,
)
from cooperative.estimate._phases import slide_order, zone_weights
from cooperative.folder import read_results
from cooperative.reporting import progress_of, report, words
from cooperative.runs import _samples
from cooperative.scene import parse
from cooperative.store import (
    SLIDES,
    FinishedRun,
    open_store,
    read_rows,
    read_sample,
    read_store,
    restart_path,
    write_sample,
)
from jaxmpm import Exceeds
from jaxmpm.run import Early
from tests.cooperative.campaign.test_campaign import TINY

SCENE = TINY.replace("k_t = 2", "k_t = 4")


sizes = st.lists(st.floats(0.0, 1.0), min_size=1, max_size=60).map(np.array)


@given(sizes, st.integers(0, 2**63 - 1))
def test_every_sample_that_may_fail_has_its_turn(size, seed):
    order = slide_order(size, seed) if size.any() else np.zeros(0, int)
    assert sorted(order) == np.flatnonzero(size > 0).tolist()


def test_slides_lie_along_the_ranks_as_densely_as_failures_do():
    size = 1 / (1 + np.exp((np.arange(400) - 120) / 25))
    reached = np.cumsum(size) / size.sum()
    for seed in range(20):
        for count in (5, 13, 30):
            first = np.sort(reached[slide_order(size, seed)[:count]])
            # Points of the golden section lie within 1.9 / n of even ones; a sample is up to 0.01 wide.
            assert np.abs(first - (np.arange(count) + 0.5) / count).max() < 1.9 / count + 0.01


def test_zones_hold_what_is_counted_nearest_and_never_less_than_the_slide_itself():
    even = np.full(10, 0.1)
    failures = Failures(np.arange(10), even, np.array([1.0] * 6 + [0.0] * 4), np.array([0.1] * 6 + [0.0] * 4))
    np.testing.assert_allclose(zone_weights(failures, np.array([1, 4])), [0.3, 0.3])
    np.testing.assert_allclose(zone_weights(failures, np.array([0, 1, 4])), [0.1, 0.2, 0.3])
    below = replace(failures, count=np.array([0.1] * 5 + [-0.3] + [0.0] * 4))
    assert zone_weights(below, np.array([0, 5])).min() == pytest.approx(0.1)


@given(st.lists(st.tuples(st.floats(0.01, 1.0), st.floats(0.0, 1.0), st.booleans()), min_size=3, max_size=30))
def test_zones_are_the_same_seen_from_the_other_end_of_the_ranks(ranks):
    chance, count, slides = np.array(ranks).T
    slid = np.flatnonzero(slides)
    if slid.size:
        one = Failures(np.arange(chance.size), np.full(chance.size, 0.01), chance, count)
        other = Failures(one.number, one.weight, chance[::-1], count[::-1])
        back = zone_weights(other, chance.size - 1 - slid[::-1])[::-1]
        # A failure as near to both of its slides may count for either.
        reached = np.cumsum(chance) - chance / 2
        apart = np.abs(reached[:, None] - reached[slid])
        if slid.size == 1 or np.ptp(np.sort(apart)[:, :2], axis=1).min() > 1e-9:
            np.testing.assert_allclose(zone_weights(one, slid), back)


def made_up(seed, samples=200, pf=0.2, runs=40):
    """A campaign whose audit has ended, and which samples fail."""
    rough, other = np.random.default_rng(seed).standard_normal((2, samples))
    failed = 0.95 * rough + np.sqrt(1 - 0.95**2) * other > norm.isf(pf)
    return means.audited(TwoPhase(refined_runs=runs, seed=seed), np.exp(rough - norm.isf(pf / 2)), failed), failed


@settings(max_examples=8, deadline=None)
@given(st.integers(0, 30), st.integers(1, 8), st.randoms(use_true_random=False))
def test_as_many_slide_as_are_asked_for_in_whatever_order_they_run(seed, count, random):
    audit, failed = made_up(seed)
    _, numbers, whole = means.slid(audit, failed, count, seed)
    assert whole.slid.sum() == count
    assert whole.weight[whole.slid].sum() == pytest.approx(audit.estimate.probability)
    assert whole.weight.sum() == pytest.approx(1.0)
    assert np.all(whole.weight[whole.failed & ~whole.slid] == 0)
    # One by one in any order, looked at anew after each, as a campaign that is killed again and again.
    phases, ended = audit, {n for n, fails in audit.answers.items() if not fails}
    while True:
        there = sorted(phases.answers)
        slides = Slides.of(phases, there, np.array([n in ended for n in there]), count, seed)
        if not slides.missing:
            break
        one = random.choice(slides.missing)
        ended.add(one)
        phases = replace(phases, answers={**phases.answers, one: bool(failed[one])})
    assert there == numbers
    assert np.array_equal(slides.slid, whole.slid)
    np.testing.assert_allclose(slides.weight, whole.weight)
    assert phases.estimate == audit.estimate


def test_slides_run_beyond_the_audit_where_it_seldom_looked():
    audit, failed = made_up(3)
    phases, _, slides = means.slid(audit, failed, 20, 3)
    beyond = phases.answers.keys() - audit.answers.keys()
    assert slides.slid.sum() == 20
    assert len(beyond) > 5
    # They are no runs of the audit: its estimate and what its runs stand for stay.
    assert {n: w for n, w in phases.weights.items() if n not in beyond} == pytest.approx(audit.weights)
    assert all(phases.weights[n] == 0 for n in beyond)


def test_slides_of_an_earlier_draw_count_and_no_more_are_asked_for():
    audit, _ = made_up(5)
    waiting = [n for n, fails in audit.answers.items() if fails]
    numbers = sorted(audit.answers)
    ended = np.array([n in waiting[:6] or not audit.answers[n] for n in numbers])
    slides = Slides.of(audit, numbers, ended, 6, 5)
    assert (slides.slid.sum(), slides.missing, slides.planned) == (6, (), 6)
    more = Slides.of(audit, numbers, ended, 8, 5)
    assert (more.slid.sum(), len(more.missing)) == (6, 2)
    none = Slides.of(audit, numbers, ended, 0, 5)
    assert (none.slid.sum(), none.planned) == (0, 0)


@settings(max_examples=8, deadline=None)
@given(st.integers(0, 30), st.sampled_from([10, 40]), st.integers(1, 30))
def test_without_a_failure_in_the_audit_none_are_sought_beyond_it(seed, runs, count):
    """The model gives every sample a chance, and as many runs as the scene has samples might find no failure."""
    rough = np.exp(np.random.default_rng(seed).standard_normal(200) - 3)
    audit = means.audited(TwoPhase(refined_runs=runs, seed=seed), rough, np.zeros(200, bool))
    numbers = sorted(audit.answers)
    slides = Slides.of(audit, numbers, np.ones(len(numbers), bool), count, seed)
    assert audit.estimate.probability == 0
    assert (slides.missing, slides.planned) == ((), 0)


def known_population():
    """Screening, failures, displacements and modes of 400 sections, all of which ran refined."""
    pairs = section_pairs.read()
    return pairs.displacement["rough"], pairs.displacement["refined"], pairs.mode["refined"]


@pytest.mark.slow
def test_slides_of_a_known_population_stand_for_all_of_its_failures():
    rough, refined, mode = known_population()
    fails = refined > 1.0
    truth, share = refined[fails].mean(), float((mode[fails] == "deep").mean())
    errors, former, covered, repeats = [], [], [], 100
    for seed in range(repeats):
        audit = means.audited(TwoPhase(refined_runs=60, seed=seed), rough, fails)
        _, numbers, slides = means.slid(audit, fails, 15, seed)
        slid, weight = np.array(numbers)[slides.slid], slides.weight[slides.slid]
        errors.append(weight @ refined[slid] / weight.sum() / truth - 1)
        former.append(means._former_mean(audit, refined, 15, np.random.default_rng(seed)) / truth - 1)
        low, high = shares(mode[slid], weight, ("deep",))["deep"].interval
        covered.append(low <= share <= high)
    assert abs(np.mean(errors)) < 0.02
    assert np.std(errors) < 0.8 * np.std(former)
    assert np.mean(covered) >= 0.9


@pytest.fixture(scope="module")
def all_slides(tmp_path_factory):
    folder = tmp_path_factory.mktemp("all")
    return folder, campaign.run(SCENE, folder)


def asked(slides):
    return SCENE + f"slides = {json.dumps(slides)}\n"


LONGER = SCENE.replace("t_end = 4.0", "t_end = 4.0\nslides_t_end = 40.0")


def test_slides_run_on_beyond_the_time_of_their_class(all_slides, tmp_path):
    folder, before = all_slides
    whole = campaign.run(LONGER, tmp_path / "all")
    # Which samples fail, and so the answer, is what it was.
    for key in ("value", "interval", "failures_refined"):
        assert getattr(whole.probability, key) == getattr(before.probability, key)
    assert whole.cost.refined_runs == before.cost.refined_runs
    assert whole.probability.grids.same_class == before.probability.grids.same_class
    assert before.consequences.cut_off.at_t_end > whole.consequences.cut_off.at_t_end == 0
    assert any("had not come to rest when they ended at 4 s" in note for note in before.notes)
    some = campaign.run(LONGER + "slides = 2\n", tmp_path / "some")
    assert (some.consequences.slides, some.probability.value) == (2, whole.probability.value)
    stores = {name: read_store(tmp_path / name) for name in ("all", "some")} | {"short": read_store(folder)}
    rows = {name: read_rows(store, "refined") for name, store in stores.items()}
    short, long = rows["short"].columns, rows["all"].columns
    fails, cut = short["displacement"] > 1.0, short["status"] == "FINISHED"
    assert np.array_equal(long["displacement"] > 1.0, fails)
    assert (long["steps"][fails & cut] > short["steps"][fails & cut]).all()
    for name in ("displacement", "steps", "status"):
        assert np.array_equal(long[name][~(fails & cut)], short[name][~(fails & cut)])
    # From where a slide had failed it comes to the same end, bit for bit.
    for number in read_rows(stores["some"], SLIDES).numbers:
        one, same = (read_sample(stores[name], "refined", number) for name in ("some", "all"))
        assert (one.row, one.status, one.steps) == (same.row, same.status, same.steps)
        assert all(np.array_equal(one.fields[name], same.fields[name]) for name in same.fields)
    (decided, *_) = np.flatnonzero(rows["some"].columns["status"] == "DECIDED")
    assert np.isnan(rows["some"].columns["runout"][decided])
    assert not read_sample(stores["some"], "refined", rows["some"].numbers[decided]).fields
    # What it costs at most is counted.
    sizes = [runs.grid_size(parse(text), grid).steps for text in (SCENE, LONGER) for grid in ("rough", "refined")]
    assert (sizes[2], sizes[3]) == (sizes[0], pytest.approx(10 * sizes[1]))


@pytest.mark.parametrize("slides", ["all", pytest.param(2, marks=pytest.mark.slow)])
def test_slides_that_had_not_come_to_rest_go_on_without_a_run_repeated(all_slides, tmp_path, monkeypatch, slides):
    """They end, bit for bit, where those of a scene with that time do; in steps, with a kill in between."""
    text, folder = (SCENE, tmp_path / "later") if slides == "all" else (asked(slides), tmp_path / "later")
    shutil.copytree(all_slides[0], folder) if slides == "all" else campaign.run(text, folder)
    before = read_rows(read_store(folder), "refined")
    moving = [n for n, status in zip(before.numbers, before.columns["status"], strict=True) if status == "FINISHED"]
    moving = [n for n in moving if before.columns["displacement"][before.numbers.index(n)] > 1.0]
    assert {path.name for path in (folder / "restart").iterdir()} == {f"moving-{n:06d}.h5" for n in moving}
    assert moving
    gone_on: list[tuple[int, float]] = []
    resumed = _samples.read_restart

    def remembered(*args, **kwargs):
        point = resumed(*args, **kwargs)
        if point is not None:
            gone_on.append((args[2], point.motion.times[-1]))
        return point

    monkeypatch.setattr(_samples, "read_restart", remembered)
    half = campaign.run(text, folder, slides_t_end=5.0)
    assert half.consequences.cut_off.t_end == 5.0
    assert sorted(n for n, _ in gone_on) == moving
    assert min(time for _, time in gone_on) >= 4.0 - 1e-5
    del gone_on[:]
    later = campaign.run(text, folder, slides_t_end=40.0)
    assert all(time >= 5.0 - 1e-5 for _, time in gone_on)
    assert (later.consequences.cut_off.at_t_end, later.consequences.cut_off.t_end) == (0, 40.0)
    assert campaign.run(text, folder) == later  # the folder keeps it, and nothing runs again
    assert list((folder / "restart").iterdir()) == []
    assert read_results(folder).summary == later
    at_once = tmp_path / "at once"
    longer = campaign.run(LONGER + text.removeprefix(SCENE), at_once)
    assert replace(longer, cost=replace(longer.cost, seconds=later.cost.seconds)) == later
    rows = [read_rows(read_store(each), "refined").columns for each in (folder, at_once)]
    for name in rows[0].keys() - {"seconds"}:
        np.testing.assert_array_equal(rows[0][name], rows[1][name], err_msg=name)
    with pytest.raises(ValueError, match="slides_t_end = 20 s: slides go on until 40 s already, give more"):
        campaign.run(text, folder, slides_t_end=20.0)


def test_no_slide_goes_on_where_none_is_asked_for(tmp_path):
    with pytest.raises(ValueError, match="slides_t_end = 60 s: the scene asks for no slides"):
        campaign.run(asked(0), tmp_path, slides_t_end=60.0)
    assert list(tmp_path.iterdir()) == []


def test_slides_that_lost_their_restart_point_start_afresh(all_slides, tmp_path, monkeypatch):
    class Killed(Exception):
        pass

    def interrupted(*_):
        raise Killed

    folder, _ = all_slides
    with monkeypatch.context() as patched:
        patched.setattr(campaign, "slide", interrupted)
        with pytest.raises(Killed):
            campaign.run(asked(2), tmp_path)
    files = list((tmp_path / "restart").glob("slides-*.h5"))
    assert len(files) >= 2
    status = progress_of(tmp_path)
    assert (status.grids[2].grid, status.grids[2].done, status.grids[2].planned) == (SLIDES, 0, 2)
    assert not status.grids[2].at_least
    assert "  slides         0 of 2 samples" in words(status)
    for path in files[1:]:
        path.unlink()
    again = campaign.run(asked(2), tmp_path)
    assert again.consequences.slides == 2
    assert (progress_of(tmp_path).grids[2].done, len(progress_of(folder).grids)) == (2, 2)
    with open_store(tmp_path, asked(2)) as store, open_store(folder, SCENE) as other:
        for number in read_rows(store, SLIDES).numbers:
            assert read_sample(store, "refined", number).row == read_sample(other, "refined", number).row


def test_a_slide_that_breaks_off_as_it_goes_on_keeps_what_it_did_before(tmp_path):
    row = {"displacement": 4.0, "broke_off": False, "runout": 3.0, "time": 4.0}
    before = FinishedRun(2, "FINISHED", 100, 1.0, np.zeros(2), row, {"displacement": np.ones((2, 5), np.float32)})
    after = FinishedRun(2, "NOT_FINITE", 160, 2.0, np.zeros(2), {"displacement": 9.0, "broke_off": True, "time": 6.4})
    with open_store(tmp_path, SCENE) as store:
        write_sample(store, "refined", before)
        runner = SimpleNamespace(
            campaign=SimpleNamespace(run=SimpleNamespace(last=lambda _: 40.0)),
            store=store,
            bar=lambda *_: nullcontext(SimpleNamespace(update=lambda: None)),
            samples=lambda *_, slides: iter([after]),
        )
        refined = read_rows(store, "refined")
        slides = SimpleNamespace(slid=np.array([True]))
        campaign._slide_longer(runner, SimpleNamespace(coefficients=None), refined, slides)
        kept = read_sample(store, "refined", 2)
        assert (kept.status, kept.row, kept.seconds) == ("NOT_FINITE", row, 2.0)
        np.testing.assert_array_equal(kept.fields["displacement"], before.fields["displacement"])
        # Its measures are least values, and it does not go on again.
        rows = read_rows(store, "refined")
        assert rows.columns["status"].tolist() == ["NOT_FINITE"]


def test_restart_points_that_wait_for_the_draw_are_no_more_than_twice_the_slides(tmp_path):
    for number in range(7):
        path = restart_path(tmp_path, SLIDES, number)
        path.parent.mkdir(exist_ok=True)
        path.touch()
    restart_path(tmp_path, SLIDES, 5).unlink()
    phases = SimpleNamespace(answers={**dict.fromkeys(range(6), True), 6: False})
    store = SimpleNamespace(folder=tmp_path)

    def kept(slides):
        plan = SimpleNamespace(slides=slides)
        campaign._drop_restart_points(SimpleNamespace(campaign=SimpleNamespace(plan=plan), store=store), phases)
        return [number for number in range(6) if restart_path(tmp_path, SLIDES, number).exists()]

    assert kept(None) == kept(0) == kept(3) == [0, 1, 2, 3, 4]
    assert kept(2) == [0, 1, 2, 3]
    assert kept(1) == [0, 1]


@pytest.mark.usefixtures("unrendered")
def test_a_class_is_all_that_an_audit_without_slides_asks(all_slides, tmp_path):
    _, whole = all_slides
    summary = campaign.run(asked(0), tmp_path)
    assert summary.probability.value == whole.probability.value
    assert summary.consequences.slides == 0
    assert summary.consequences.means == {}
    assert not (tmp_path / "restart").exists() or not list((tmp_path / "restart").iterdir())
    assert not any("slid on" in note for note in summary.notes)
    assert [each.grid for each in progress_of(tmp_path).grids] == ["rough", "refined"]
    assert "note: the scene asks for no slides (slides = 0)" in report(tmp_path)
    shown = (tmp_path / "report.html").read_text()
    # Every section that needs slides says so.
    for section in ("How far, how much, how deep", "What the slope looks like", "Distributions of what the slides do"):
        assert f"<h2>{section}</h2>\n<p>No consequence was asked for" in shown


FULL = invented.SCENE.replace("samples = 50", "samples = 120\nslides = 8").replace("runs = 15", "runs = 30")


@pytest.fixture
def deciding(made_up):
    """Made-up runs that end once they have failed, where only their class is asked for."""

    def run_samples(*arguments, rules=(), **choices):
        limit = next((rule.displacement for rule in rules if isinstance(rule, (Exceeds, Early))), np.inf)
        for sample in invented.run_samples(*arguments, **choices):
            if arguments[0].grid == "refined" and sample.row["displacement"] > limit:
                cut = dict.fromkeys(("depth", "runout", "volume", "area"), np.nan) | {"displacement": 1.01 * limit}
                sample = replace(sample, status="DECIDED", row=sample.row | cut, fields={})
            yield sample

    made_up.setattr(campaign.runs, "run_samples", run_samples)


def test_a_campaign_runs_refined_what_its_slides_want_beyond_the_audit(tmp_path, deciding, monkeypatch):
    whole = campaign.run(FULL, tmp_path / "whole")
    assert (whole.consequences.slides, whole.consequences.planned) == (8, 8)
    assert whole.cost.refined_runs > 30
    assert whole.cost.finished == "the refined runs allowed are spent"
    audit = campaign.run(FULL.replace("slides = 8", "slides = 0"), tmp_path / "audit")
    assert (audit.consequences.slides, audit.cost.refined_runs) == (0, 30)
    for same in ("value", "interval", "convergence", "coefficient_of_variation"):
        assert getattr(whole.probability, same) == getattr(audit.probability, same)
    # Killed after every second slide, it comes to the same end.
    written = campaign.write_sample

    def killed(store, grid, sample):
        written(store, grid, sample)
        if grid == SLIDES or (lives > 1 and grid == "refined"):
            raise KeyboardInterrupt

    monkeypatch.setattr(campaign, "write_sample", killed)
    lives, summary = 0, None
    while summary is None:
        try:
            summary = campaign.run(FULL, tmp_path / "killed")
        except KeyboardInterrupt:
            lives += 1
    assert lives > 2
    assert replace(summary, cost=replace(summary.cost, seconds=whole.cost.seconds)) == whole
    # More runs allowed later: what slid stays, and no more slides than asked for.
    monkeypatch.setattr(campaign, "write_sample", written)
    more = campaign.run(FULL, tmp_path / "killed", refined_runs=50)
    assert more.consequences.slides == 8
    status = progress_of(tmp_path / "killed")
    assert (status.grids[2].done, status.grids[2].planned) == (8, 8)
