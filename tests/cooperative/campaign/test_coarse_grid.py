"""A campaign with a coarse grid: which samples run where, what is stored, going on, and what is refused."""

import numpy as np
import pytest

from benchmarks.robustness.invented import TINY
from cooperative import run
from cooperative.estimate import Phases, Sampling
from cooperative.folder import read_results
from cooperative.reporting import progress_of, report
from cooperative.reporting._progress import words
from cooperative.reporting._sentences import more
from cooperative.runs import phases_of
from cooperative.scene import campaign_of, parse, variants
from cooperative.store import COARSE, read_rows, read_store
from tests.databases import delete, finished

COARSER = TINY.replace("[rough]", "[coarse]\ncell = 4.0\nspacing = [2.0, 2.0]\n[rough]").replace(
    'samples = 6\nseed = 3\nk_t = 2\nestimator = "published"',
    "samples = 40\nrough_samples = 14\nseed = 3\nrefined_runs = 10\nslides = 2",
)


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    folder = tmp_path_factory.mktemp("coarse") / "campaign"
    return folder, run(COARSER, folder)


def test_all_samples_run_on_the_coarse_grid_and_one_of_each_zone_on_the_rough_one(done):
    store, summary = read_store(done[0]), done[1]
    coarse, rough, refined = (read_rows(store, grid) for grid in (COARSE, "rough", "refined"))
    assert coarse.numbers == list(range(40))
    assert len(rough.numbers) == 14
    assert set(refined.numbers) <= set(rough.numbers)
    assert rough.columns["zone_weight"].sum() == pytest.approx(1.0)
    assert set(rough.columns["coarse_samples"]) == {40}
    # A coarse run gives its rank alone: it ends once its sample has failed there.
    order = np.argsort(-coarse.columns["displacement"], kind="stable").tolist()
    by_rank = sorted(rough.numbers, key=order.index)
    scores = [rough.columns["coarse_score"][rough.numbers.index(number)] for number in by_rank]
    assert scores == sorted(scores, reverse=True)
    assert (summary.cost.coarse_samples, summary.cost.samples) == (40, 14)
    assert sum(each.weight for each in summary.probability.stands_for.values()) == pytest.approx(1.0)


def test_the_estimate_weighs_samples_by_their_zones(done):
    store, summary = read_store(done[0]), done[1]
    campaign = campaign_of(store)
    phases = phases_of(campaign, read_rows(store, "rough"), read_rows(store, "refined"))
    assert phases.population.independent == 40
    assert phases.estimate.probability == summary.probability.value
    assert summary.probability.others == {}
    alike = Sampling(campaign.plan.rough_samples, campaign.run.failure_displacement)
    unweighted = Phases.of(campaign.estimator, alike, phases.rough, read_rows(store, "refined").results)
    assert unweighted.estimate.interval != phases.estimate.interval


def test_an_interrupted_campaign_goes_on_to_the_same_answer(done, tmp_path):
    class Enough(Exception):
        pass

    def leave(phase):
        if phase == "audit":
            raise Enough

    with pytest.raises(Enough):
        run(COARSER, tmp_path, on_phase=leave)
    # A coarse and a rough sample are lost; the same zones come out again.
    delete(tmp_path, COARSE, 3)
    delete(tmp_path, "rough", min(finished(tmp_path, "rough")))
    now = progress_of(tmp_path)
    assert [(each.grid, each.done, each.planned) for each in now.grids[:2]] == [(COARSE, 39, 40), ("rough", 13, 14)]
    assert "coarse grid    39 of 40" in words(now)
    assert "rough grid alone" in words(now)
    again = run(COARSER, tmp_path)
    assert again.probability.value == done[1].probability.value
    assert again.probability.interval == done[1].probability.interval


def test_once_all_rough_samples_are_refined_more_of_them_would_help(tmp_path):
    text = COARSER.replace("refined_runs = 10", "refined_runs = 14").replace("slides = 2", "slides = 0")
    summary = run(text, tmp_path, progress=True)
    assert summary.cost.refined_runs == summary.cost.samples == 14
    assert "refined grid 14/14" in (tmp_path / "progress.log").read_text()
    assert "only more rough samples would" in more(summary)


def test_the_rough_grid_alone_is_calibrated(tmp_path):
    def leave(phase):
        raise KeyError(phase)

    with pytest.raises(KeyError, match="screening"):
        run(COARSER.replace("seed = 3", "seed = 3\ncalibrate = true"), tmp_path, on_phase=leave)
    calibration = campaign_of(read_store(tmp_path)).measured.calibration
    assert calibration.factor == calibration.refined / calibration.rough


@pytest.mark.slow
def test_workers_do_not_change_the_answer(done, tmp_path):
    summary = run(COARSER, tmp_path, workers=2)
    assert summary.probability.value == done[1].probability.value
    assert summary.probability.interval == done[1].probability.interval


def test_a_report_names_the_coarse_grid(done):
    report(done[0])
    page = (done[0] / "report.html").read_text()
    assert "40 random slopes ran on the coarse grid, 14 of them" in page
    assert read_results(done[0]).summary == done[1]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("rough_samples = 14\n", "", r"has a coarse grid without rough_samples"),
        ("[coarse]\ncell = 4.0\nspacing = [2.0, 2.0]\n", "", r"has rough_samples without a coarse grid"),
        ("[coarse]\ncell = 4.0", "[coarse]\ncell = 2.0", "cells of 2 m, the rough one of 2 m"),
        ("rough_samples = 14", "rough_samples = 41", "rough_samples = 41 of samples = 40: give 10 to 40"),
        ("rough_samples = 14", "rough_samples = 9", "rough_samples = 9 of samples = 40: give 10 to 40"),
        ("refined_runs = 10", 'k_t = 3\nestimator = "published"', "estimator = 'published' takes all samples as alike"),
        ("refined_runs = 10", 'estimator = "monte carlo"', "estimator = 'monte carlo' takes all samples as alike"),
    ],
)
def test_a_coarse_grid_that_does_not_go_with_the_rest_is_refused(old, new, message):
    assert old in COARSER
    with pytest.raises(ValueError, match=message):
        parse(COARSER.replace(old, new))


def test_a_sweep_with_a_coarse_grid_is_refused():
    with pytest.raises(ValueError, match=r"\[coarse\] draws other samples in each campaign"):
        variants(COARSER + "[sweep]\ncov = [0.2, 0.4]\n")
