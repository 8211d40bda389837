"""Rare failures: design point and importance sampling against closed forms, then on a small slope."""

import numpy as np
import pytest
from scipy import stats

from cooperative.estimate import wilson_interval
from cooperative.research.rare import Search, design_point, importance_sampling


def plane(beta, modes, seed=0):
    """Limit state beta - n.x, which fails with probability Phi(-beta)."""
    normal = np.random.default_rng(seed).standard_normal(modes)
    normal /= np.linalg.norm(normal)
    return normal, lambda x: (beta - float(normal @ x), -normal)


def test_design_point_of_a_plane_is_its_foot():
    normal, limit_state = plane(3.2, 30)
    result = design_point(limit_state, 30)
    assert result.converged
    np.testing.assert_allclose(result.coefficients, 3.2 * normal, atol=1e-6)
    assert result.probability == pytest.approx(stats.norm.sf(3.2), rel=1e-6)


def test_design_point_of_a_curved_limit_state():
    # g = 3 + 0.1 (x - y)^2 - (x + y) / sqrt 2, whose point of least norm is (3, 3) / sqrt 2 by symmetry.
    def limit_state(x):
        difference = x[0] - x[1]
        slope = np.array([0.2 * difference, -0.2 * difference]) - 1 / np.sqrt(2)
        return 3 + 0.1 * difference**2 - (x[0] + x[1]) / np.sqrt(2), slope

    result = design_point(limit_state, 2, Search(tolerance=1e-4, steps=100))
    assert result.converged
    assert result.beta == pytest.approx(3.0, rel=1e-3)


@pytest.mark.parametrize("beta", [2.5, 3.5])
def test_importance_sampling_is_unbiased_and_its_interval_covers(beta):
    normal, _ = plane(beta, 40)
    exact = stats.norm.sf(beta)
    estimates = [importance_sampling(lambda x: x @ normal > beta, beta * normal, 300, seed=seed) for seed in range(200)]
    shares = np.array([e.probability for e in estimates]) / exact
    assert abs(shares.mean() - 1) < 4 * shares.std() / np.sqrt(200)
    covered = np.mean([e.interval[0] <= exact <= e.interval[1] for e in estimates])
    assert 0.9 <= covered <= 0.99
    # Plain Monte Carlo would take some (1 - p) / p / cov^2 samples for as little scatter.
    assert np.mean([e.cov for e in estimates]) ** 2 * 300 < 0.2 / exact


def test_a_poor_design_point_costs_variance_and_no_bias():
    normal, _ = plane(2.5, 10)
    off = 2.0 * normal + 0.7 * np.eye(10)[0]
    exact = stats.norm.sf(2.5)
    shares = [importance_sampling(lambda x: x @ normal > 2.5, off, 500, seed=s).probability / exact for s in range(100)]
    assert abs(np.mean(shares) - 1) < 4 * np.std(shares) / 10


@pytest.mark.parametrize(
    ("limit_state", "message"),
    [
        (lambda x: (-0.1, np.ones(3)), "fails too often to be called rare"),
        (lambda x: (1.0, np.zeros(3)), "a smooth measure that still changes"),
        (lambda x: (float("nan"), np.ones(3)), "a smooth measure that still changes"),
    ],
)
def test_hopeless_searches_are_refused(limit_state, message):
    with pytest.raises(ValueError, match=message):
        design_point(limit_state, 3)


def test_one_sample_is_refused():
    with pytest.raises(ValueError, match="samples = 1"):
        importance_sampling(lambda x: x[:, 0] > 0, np.zeros(2), 1)


def test_a_search_that_does_not_end_says_so():
    # The limit state never reaches 0.
    result = design_point(lambda x: (1 + float(np.exp(-x[0])), np.array([-np.exp(-x[0]), 0.0])), 2, Search(steps=5))
    assert not result.converged


def test_importance_sampling_without_a_failure_bounds_nothing():
    centre = np.array([3.0, 0.0])
    none = importance_sampling(lambda x: x[:, 0] > 50, centre, 400)
    assert (none.probability, none.interval) == (0.0, (0.0, 1.0))
    # Around 0 it is Monte Carlo.
    assert importance_sampling(lambda x: x[:, 0] > 50, 0 * centre, 20).interval == wilson_interval(0, 20)
    assert importance_sampling(lambda x: x[:, 0] < 50, 0 * centre, 20).interval == wilson_interval(20, 20)
    for answer, message in ((lambda x: np.full(len(x), np.nan), "holds nan"), (lambda x: [True], "1 answers of 20")):
        with pytest.raises(ValueError, match=message):
            importance_sampling(answer, centre, 20)
