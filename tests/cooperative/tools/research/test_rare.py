"""Rare failures: design point and importance sampling against closed forms, then on a small slope."""

import numpy as np
import pytest
from scipy import stats

from cooperative.estimate import exact_limit
from cooperative.tools.research.rare import Search, design_point, design_points, importance_sampling


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
    assert importance_sampling(lambda x: x[:, 0] > 50, 0 * centre, 20).interval == (0.0, exact_limit(20))
    assert importance_sampling(lambda x: x[:, 0] < 50, 0 * centre, 20).interval == (1 - exact_limit(20), 1.0)
    for answer, message in ((lambda x: np.full(len(x), np.nan), "holds nan"), (lambda x: [True], "1 answers of 20")):
        with pytest.raises(ValueError, match=message):
            importance_sampling(answer, centre, 20)


def parabola(x):
    """RP89: one parabola with two nearest points, about x2, and a plane."""
    value, slope = -(x[0] ** 2) - x[1] + 8, np.array([-2 * x[0], -1.0])
    other = -x[0] / 5 - x[1] + 6
    return (value, slope) if value < other else (other, np.array([-0.2, -1.0]))


def product(x):
    """RP75: two points, and no gradient at the origin."""
    return 3 - x[0] * x[1], np.array([-x[1], -x[0]])


def cross(x):
    """RP111: four points, and no gradient at the origin."""
    sign = np.sign(x[0] * x[1])
    return 12.5 - abs(x[0] * x[1]), -sign * np.array([x[1], x[0]])


# P_f by quadrature; the limit states are those of openturns/otbenchmark (adapted from RPRepo, rprepo.readthedocs.io).
SYMMETRIC = {
    "RP89": (parabola, 0.0054712805290157256, np.sqrt(7.75), 2, (3.0, 0.0)),
    "RP75": (product, 0.00981929872154727, np.sqrt(6), 2, (1.0, 0.8)),
    "RP111": (cross, 8.035085964945839e-07, 5.0, 4, (1.0, 0.8)),
}


def hard(limit_state):
    return lambda xi: np.array([limit_state(x)[0] < 0 for x in xi])


@pytest.mark.parametrize("name", SYMMETRIC)
def test_one_design_point_of_several_regions_is_named_and_leaves_the_interval_open(name):
    limit_state, exact, beta, _, start = SYMMETRIC[name]
    point = design_point(limit_state, 2, start=np.array(start))
    assert point.converged
    assert point.beta == pytest.approx(beta, rel=2e-2)
    covered = 0
    for seed in range(20):
        estimate = importance_sampling(hard(limit_state), point.coefficients, 200, seed=seed)
        assert any("MORE THAN ONE REGION FAILS" in note for note in estimate.notes)
        covered += estimate.interval[0] <= exact <= estimate.interval[1]
    assert covered >= 18
    assert estimate.probability < 0.8 * exact


@pytest.mark.parametrize("name", SYMMETRIC)
def test_several_design_points_give_the_probability_of_all_regions(name):
    limit_state, exact, beta, count, _ = SYMMETRIC[name]
    points = design_points(limit_state, 2, starts=10)
    nearest = [point for point in points if point.beta < 1.1 * beta]
    assert len(nearest) == count
    centres = np.array([point.coefficients for point in points])
    estimates = [importance_sampling(hard(limit_state), centres, 200, seed=seed) for seed in range(40)]
    shares = np.array([each.probability for each in estimates]) / exact
    assert abs(shares.mean() - 1) < 4 * shares.std() / np.sqrt(40)
    assert np.mean([each.interval[0] <= exact <= each.interval[1] for each in estimates]) >= 0.85
    assert not any("MORE THAN ONE REGION" in note for each in estimates for note in each.notes)


def test_the_far_point_that_the_origin_leads_to_is_named_by_its_weights():
    # From the origin the search runs along the axis of the parabola and ends on the plane.
    point = design_point(parabola, 2)
    assert point.beta > 5
    estimate = importance_sampling(hard(parabola), point.coefficients, 500)
    assert estimate.interval[0] <= SYMMETRIC["RP89"][1] <= estimate.interval[1]
    assert any("MORE THAN ONE REGION" in note or "THE WEIGHTS ARE UNEVEN" in note for note in estimate.notes)


@pytest.mark.parametrize("modes", [1, 2, 30])
def test_a_plane_has_one_region(modes):
    normal, limit_state = plane(3.0, modes)
    assert len(design_points(limit_state, modes)) == 1
    estimate = importance_sampling(lambda x: x @ normal > 3, 3 * normal, 500)
    assert len(estimate.notes) == 1
    assert estimate.interval[1] < 1


def test_a_start_of_the_wrong_shape_and_no_gradient_at_the_origin_are_named():
    with pytest.raises(ValueError, match="give 2 finite coefficients"):
        design_point(product, 2, start=np.ones(3))
    with pytest.raises(ValueError, match="another start"):
        design_point(product, 2)
