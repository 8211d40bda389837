"""Estimators at work on made-up pairs of grids: what each asks for, when it stops, and what it says."""

from dataclasses import replace

import numpy as np
import pytest

from cooperative.estimate import DESIGNS, Population, after_more_runs, monte_carlo, rough_runs, subset_simulation
from cooperative.estimate._designs import budget, replay_subset, subset_plan
from cooperative.scene import parse
from cooperative.scene._schema import ESTIMATORS
from tests.test_campaign import TINY
from tests.test_coop_twophase import pair

PLAN = replace(parse(TINY).plan, samples=600, estimator="two-phase")
POPULATION_WIDE = ("two-phase", "control variate", "monte carlo", "published")


def play(plan, displacement, failed, places=1, seed=0):
    """Run a campaign whose refined grid answers at once, or after others; returns its answers in the order given."""
    design, population, answers = DESIGNS[plan.estimator], Population(displacement), {}
    under_way: list[int] = []
    generator = np.random.default_rng(seed)
    while True:
        asked = design.wanted(plan, population, answers, places, under_way)
        under_way += [number for number in asked if number not in under_way][: max(places - len(under_way), 0)]
        if not under_way:
            return design, population, answers
        number = under_way.pop(int(generator.integers(len(under_way))))
        answers[number] = bool(failed[number])


def test_every_name_of_a_scene_has_its_design():
    assert DESIGNS.keys() == ESTIMATORS.keys()


@pytest.mark.parametrize(
    ("estimator", "target"), [(name, target) for name in POPULATION_WIDE for target in (None, 0.2)][:-1]
)
def test_runs_at_once_and_their_order_change_nothing(estimator, target):
    plan = replace(PLAN, samples=200, k_t=8, estimator=estimator, target_cov=target)
    displacement, failed = pair(200, 0.25, 0.9, 3)
    design, population, alone = play(plan, displacement, failed)
    for seed in range(3):
        _, _, together = play(plan, displacement, failed, places=7, seed=seed)
        assert together == alone
    assert design.estimate(plan, population, alone) == design.path(plan, population, alone)[-1]


@pytest.mark.parametrize("estimator", ["two-phase", "control variate", "monte carlo"])
def test_a_target_alone_stops_the_campaign_when_met(estimator):
    plan = replace(PLAN, samples=1500, estimator=estimator, target_cov=0.15)
    displacement, failed = pair(1500, 0.25, 0.95, 5)
    design, population, answers = play(plan, displacement, failed)
    assert design.estimate(plan, population, answers).cov <= 0.15
    assert len(answers) < 1500
    before = design.path(plan, population, answers)[:-1]
    assert all(estimate.cov > 0.15 for estimate in before[2:])


def test_a_target_out_of_reach_stops_after_the_usual_budget():
    plan = replace(PLAN, samples=100, target_cov=0.05)
    displacement, failed = pair(100, 0.25, 0.95, 5)
    design, population, answers = play(plan, displacement, failed)
    assert 20 <= len(answers) < 60
    assert after_more_runs(design.estimate(plan, population, answers), 10**6) > 0.05


def test_budgets():
    assert budget(PLAN, 600) == 120
    assert budget(PLAN, 60) == 20
    assert budget(replace(PLAN, refined_runs=75), 600) == 75
    assert budget(replace(PLAN, refined_runs=75), 60) == 60
    assert budget(replace(PLAN, target_cov=0.1), 600) == 600
    assert budget(replace(PLAN, estimator="monte carlo"), 600) == 600


def test_monte_carlo_of_all_samples_is_the_plain_share():
    plan = replace(PLAN, samples=120, estimator="monte carlo")
    displacement, failed = pair(120, 0.25, 0.9, 0)
    design, population, answers = play(plan, displacement, failed, places=3)
    assert design.estimate(plan, population, answers) == monte_carlo(failed)
    assert design.weights(plan, population, answers) == dict.fromkeys(range(120), 1.0)


@pytest.mark.parametrize("estimator", ["control variate", "monte carlo"])
def test_runs_without_answer_are_said(estimator):
    plan = replace(PLAN, samples=100, estimator=estimator)
    displacement, failed = pair(100, 0.25, 0.9, 0)
    answers = dict(enumerate(failed[:40].tolist())) | {7: None}
    found = DESIGNS[estimator].estimate(plan, Population(displacement), answers)
    assert found.refined_runs == 39
    assert "1 refined runs gave no answer" in found.notes[0]
    nothing = DESIGNS[estimator].estimate(plan, Population(displacement), {})
    assert nothing.interval == (0.0, 1.0)


def test_subset_simulation_gone_through_again_is_the_same():
    plan = replace(PLAN, samples=160, estimator="subset", levels=2, replicates=4)
    asked = []

    def rough(xi):
        asked.append(xi)
        return xi[:, 0] + 0.1 * xi[:, 1]

    found = subset_simulation(rough, 3, subset_plan(plan))
    every = np.concatenate(asked)
    assert len(every) == rough_runs(plan) == found.rough_runs
    np.testing.assert_array_equal(every[found.number], found.coefficients)
    assert np.unique(found.number).size == found.number.size
    known = dict(enumerate((every[:, 0] + 0.1 * every[:, 1]).tolist()))
    again = replay_subset(plan, 3, known)
    np.testing.assert_array_equal(again.number, found.number)
    np.testing.assert_array_equal(again.weight, found.weight)
    known.pop(len(every) - 1)
    with pytest.raises(KeyError):
        replay_subset(plan, 3, known)
