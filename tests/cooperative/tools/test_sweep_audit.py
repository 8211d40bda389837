"""Audits that campaigns of the same samples share: the same draws, unbiased, sharper differences, true signs."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.statistics.sweeps import CASES, LEVELS, Case, repeat, summarise
from cooperative.estimate import Population, SharedAudit, TwoPhase
from cooperative.tools import sweep
from cooperative.tools.sweep_audit import shared_audit
from cooperative.tools.sweep_differences import paired_difference, unit_of

SAMPLES, RUNS = 40, 16


def campaigns(
    seed: int, *, lost: tuple[int, ...] = (), limit: float = 1.0
) -> tuple[list[Population], list[np.ndarray]]:
    """Populations of three campaigns of the same samples, and which samples fail in each."""
    generator = np.random.default_rng(seed)
    rough, other = generator.standard_normal((2, SAMPLES))
    broke_off = np.isin(np.arange(SAMPLES), lost)
    populations, failed = [], []
    for added in (0.0, 0.3, 1.0):
        displacement = np.exp(rough + added - limit)
        populations.append(Population(displacement, broke_off if added == 0.3 else None))
        failed.append(0.9 * rough + 0.4 * other + added > limit)
    return populations, failed


def audit(population: Population, failed: np.ndarray, estimator: TwoPhase) -> list[list[int]]:
    """Samples of each wave, in any order within it."""
    answers, waves = {}, []
    while asked := estimator.next_runs(population, answers, SAMPLES, ()):
        waves.append(sorted(asked))
        answers |= {sample: bool(failed[sample]) for sample in asked}
    return waves


@settings(max_examples=20)
@given(seed=st.integers(0, 10**6), lost=st.sets(st.integers(0, SAMPLES - 1), max_size=3))
def test_campaigns_refine_the_same_samples_in_the_same_waves(seed, lost):
    populations, failed = campaigns(seed, lost=tuple(lost))
    shared = shared_audit(populations)
    assert set(shared.certain) == lost
    waves = [
        audit(replace(each, shared=shared), of, TwoPhase(RUNS, seed=seed))
        for each, of in zip(populations, failed, strict=True)
    ]
    assert waves[0] == waves[1] == waves[2]
    assert sum(map(len, waves[0])) == RUNS


def test_the_base_decides_by_its_target_and_the_others_follow():
    populations, failed = campaigns(3)
    shared = shared_audit(populations)
    estimator = TwoPhase(SAMPLES, target_cov=0.5, seed=1)
    base = audit(replace(populations[0], shared=shared), failed[0], estimator)
    runs = sum(map(len, base))
    assert runs < SAMPLES
    follows = replace(populations[2], shared=replace(shared, runs=runs))
    assert audit(follows, failed[2], estimator) == base
    answers = {sample: bool(failed[2][sample]) for wave in base for sample in wave}
    assert "base of the sweep" in estimator.why_finished(follows, answers)


def test_a_shared_audit_is_unbiased():
    # So many fail that every audit meets failures, and samples that stand.
    populations, failed = campaigns(7, limit=0.3)
    shared = shared_audit(populations)
    for population, fails in zip(populations, failed, strict=True):
        answers = dict(enumerate(fails.tolist()))
        found = np.array([
            TwoPhase(refined_runs=RUNS, seed=seed).estimate(replace(population, shared=shared), answers).probability
            for seed in range(400)
        ])  # fmt: skip
        assert abs(found.mean() - fails.mean()) < 4 * found.std() / np.sqrt(found.size)


@settings(max_examples=20)
@given(seed=st.integers(0, 10**6), more=st.sets(st.integers(0, SAMPLES - 1)))
def test_failures_that_are_added_never_lower_the_probability(seed, more):
    (population, *_), (failed, *_) = campaigns(seed)
    populations = [population, replace(population, rough_displacement=1.5 * population.rough_displacement)]
    shared = shared_audit(populations)
    estimates = [
        TwoPhase(refined_runs=RUNS, seed=seed).estimate(replace(each, shared=shared), dict(enumerate(of.tolist())))
        for each, of in zip(populations, (failed, failed | np.isin(np.arange(SAMPLES), list(more))), strict=True)
    ]
    assert estimates[1].probability >= estimates[0].probability - 1e-12


def test_other_samples_or_weights_share_no_audit():
    with pytest.raises(ValueError, match="populations of 3, 4 samples: give populations of the same"):
        shared_audit([Population(np.ones(3)), Population(np.ones(4))])
    with pytest.raises(ValueError, match="equally weighted"):
        shared_audit([Population(np.ones(2), weight=np.array([0.3, 0.7]), replicate=np.arange(2))])


def test_signs_that_a_sweep_calls_resolved_are_right_and_differences_sharper():
    case = Case(0.3, 0.85, 200, 40)
    assert case in CASES
    answer = summarise(case, repeat(case, 0, 12))
    assert answer["resolved"] > 0.2
    assert answer["wrong_sign"] <= 0.05
    assert answer["coverage"] >= 0.85
    assert answer["error"] < 0.9 * answer["error_apart"]
    assert len(LEVELS) == 5


def test_equal_campaigns_have_an_unresolved_sign_whose_interval_shrinks_with_more_refined_runs():
    z = np.r_[np.ones(10), np.zeros(30)]
    wide, narrow = (paired_difference(z, z, unit=unit) for unit in (2.0, 1.0))
    assert not wide.resolved
    assert wide.interval[1] == pytest.approx(2 * narrow.interval[1])
    assert paired_difference(np.zeros(400), np.r_[np.ones(40), np.zeros(360)]).resolved


def test_a_refined_run_stands_for_the_samples_that_it_was_drawn_from():
    assert unit_of(dict.fromkeys(range(10), 0.1), 10) == pytest.approx(1.0)
    assert unit_of(dict.fromkeys(range(5), 0.2), 10) == pytest.approx(2.0)
    # Draws without doubt stand for many and do not count.
    assert unit_of({0: 0.1, 1: 0.9}, 10, [1.0, 0.0]) == pytest.approx(1.0)


@pytest.mark.slow
def test_a_sweep_refines_the_same_samples_and_stores_its_audit(tmp_path):
    from cooperative.scene import stored_measured
    from cooperative.store import read_rows, read_store
    from tests.cooperative.tools.test_sweep import SWEEP

    text = SWEEP.replace("cov = [0.2, 0.4]\nk_t = [1, 2]\n", "").replace("samples = 6", "samples = 14")
    text = text.replace('estimator = "published"', "refined_runs = 10")
    result = sweep.run(text, tmp_path / "sweep")
    folders = sorted((tmp_path / "sweep" / "campaigns").iterdir())
    shared = {each.name: stored_measured(each).shared for each in folders}
    assert all(isinstance(each, SharedAudit) for each in shared.values())
    assert len({each.doubt for each in shared.values()}) == 1
    assert len({tuple(read_rows(read_store(each), "refined").numbers) for each in folders}) == 1
    assert result["base"]["campaign"] == "base"
    assert sweep.run(text, tmp_path / "sweep") == result
    page = (tmp_path / "sweep" / "report.html").read_text()
    assert "As the scene is" in page
    assert (tmp_path / "sweep" / "sweep.csv").read_text().splitlines()[1].startswith("base,base,")
