"""Functions that rank samples in place of a coarse grid, on a real population."""

import numpy as np
import pytest
from scipy.stats import spearmanr

from benchmarks.statistics import surrogate


def test_slices_and_a_small_regression_rank_the_population():
    refined = surrogate.read_once()["refined"]
    assert spearmanr(surrogate.scores()["slices"], refined).statistic > 0.9
    unseen = slice(surrogate.TRAINED, None)
    assert spearmanr(surrogate.scores()["regression"][unseen], refined[unseen]).statistic > 0.6


def test_the_regression_finds_a_linear_response():
    coefficients = np.random.default_rng(1).normal(size=(600, 5))
    response = coefficients @ [1.0, -0.5, 0.2, 0.0, 0.0] - 3
    fitted = surrogate.regression(coefficients, np.exp(response[:400]))
    assert np.corrcoef(fitted[400:], response[400:])[0, 1] > 0.99


def test_ranks_save_refined_runs_and_misleading_ones_cost_them_but_no_bias():
    cases = {case.rank: case for case in surrogate.CASES if case.rough == 400}
    rows = {
        rank: surrogate.summarise(cases[rank], surrogate.repeat(cases[rank], 0, 12))
        for rank in ("slices", None, "slices, turned round")
    }
    runs = [row["refined_q50"] for row in rows.values()]
    assert runs == sorted(runs)
    assert runs[0] < 0.8 * runs[-1]
    for row in rows.values():
        assert abs(row["bias"]) < 3 * row["bias_error"]
        assert row["coverage"] >= 11 / 12


@pytest.mark.parametrize("rank", ["slices", None])
def test_a_first_phase_stands_for_all_samples(rank):
    case = surrogate.Case(rank, 50, 300)
    population = surrogate.screened(case, np.arange(300 if rank else 50), 3)
    assert population.size == 50
    assert population.weights.sum() == pytest.approx(1.0)
