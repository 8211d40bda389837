"""Estimators at work on made-up pairs of grids: what each asks for, when it stops, and what it says."""

import numpy as np
import pytest

from cooperative import estimate
from cooperative.estimate import (
    ESTIMATORS,
    ControlVariate,
    MonteCarlo,
    Population,
    Published,
    Sampling,
    Subset,
    TwoPhase,
    after_more_runs,
    monte_carlo,
    named_estimator,
    subset_simulation,
)
from tests.cooperative.estimate.test_twophase import pair

WITH_TARGETS = (TwoPhase, ControlVariate, MonteCarlo)


def play(estimator, displacement, failed, lanes=1, seed=0):
    """Run a campaign whose refined grid answers at once, or after others; returns its answers in the order given."""
    population, answers = Population(displacement), {}
    under_way: list[int] = []
    generator = np.random.default_rng(seed)
    while True:
        asked = estimator.next_runs(population, answers, lanes, under_way)
        under_way += [number for number in asked if number not in under_way][: max(lanes - len(under_way), 0)]
        if not under_way:
            return population, answers
        number = under_way.pop(int(generator.integers(len(under_way))))
        answers[number] = bool(failed[number])


@pytest.mark.parametrize("kind", [MonteCarlo, ControlVariate])
def test_a_target_is_not_met_by_a_chance_run_of_failures(kind):
    """P_f 0.9: of ten samples all fail in 35 campaigns of a hundred, and their scatter is 0."""
    generator = np.random.default_rng(0)
    met = []
    for _ in range(40):
        displacement, failed = np.exp(generator.standard_normal(400)), generator.random(400) < 0.9
        population, answers = play(kind(target_cov=0.05), displacement, failed, lanes=10)
        met.append((len(answers), kind(target_cov=0.05).estimate(population, answers).probability))
    runs, shares = np.array(met).T
    assert runs.min() >= 30
    assert np.mean(shares) == pytest.approx(0.9, abs=3 * np.std(shares) / np.sqrt(len(shares)))


@pytest.mark.parametrize("kind", [MonteCarlo, ControlVariate])
def test_the_interval_holds_whatever_runs_without_an_answer_would_have_been(kind):
    generator = np.random.default_rng(1)
    displacement = np.exp(generator.standard_normal(60))
    answers = {number: bool(generator.random() < 0.3) for number in range(60)}
    lost = dict(answers) | dict.fromkeys(range(0, 60, 5), None)
    estimate = kind().estimate(Population(displacement), lost)
    for outcome in (False, True):
        whole = monte_carlo(np.array([outcome if each is None else each for each in lost.values()]))
        assert estimate.interval[0] <= whole.probability <= estimate.interval[1]
    assert any("12 refined runs gave no answer" in note for note in estimate.notes)
    assert kind().estimate(Population(displacement), answers).notes == ()


@pytest.mark.parametrize(
    "estimator", [kind(target_cov=target) for kind in WITH_TARGETS for target in (None, 0.2)] + [Published(8)], ids=repr
)
def test_runs_at_once_and_their_order_change_nothing(estimator):
    displacement, failed = pair(200, 0.25, 0.9, 3)
    population, alone = play(estimator, displacement, failed)
    for seed in range(3):
        _, together = play(estimator, displacement, failed, lanes=7, seed=seed)
        assert together == alone
    assert estimator.estimate(population, alone) == estimator.path(population, alone)[-1]


@pytest.mark.parametrize("runs", [7, 60, 601, 1500])
@pytest.mark.parametrize(("estimator", "step"), [(MonteCarlo(), 10), (Published(2000), 1)])
def test_a_path_has_the_closest_even_steps_that_leave_sixty_points(estimator, step, runs):
    population, failed = Population(np.arange(2000.0, 0.0, -1.0)), dict.fromkeys(range(runs), False)
    stops = [each.refined_runs for each in estimator.path(population, failed)]
    closest = next(each for each in range(step, 2001, step) if each * 60 >= runs)
    assert stops == [*range(closest, runs, closest), runs]


@pytest.mark.parametrize("kind", WITH_TARGETS)
def test_a_target_alone_stops_the_campaign_when_met(kind):
    estimator = kind(target_cov=0.15)
    population, answers = play(estimator, *pair(1500, 0.25, 0.95, 5))
    reached = estimator.estimate(population, answers)
    assert reached.cov < 0.2
    assert len(answers) < 1500
    assert "a coefficient of variation of 0.15" in estimator.why_finished(population, answers) or reached.cov <= 0.15
    assert reached.cov > 0.1


def test_a_target_out_of_reach_stops_after_the_usual_budget():
    estimator = TwoPhase(target_cov=0.05)
    population, answers = play(estimator, *pair(100, 0.25, 0.95, 5))
    assert 20 <= len(answers) < 60
    assert after_more_runs(estimator.estimate(population, answers), 10**6) > 0.05
    assert "out of reach with 100 samples" in estimator.why_finished(population, answers)


def test_budgets():
    assert TwoPhase().budget(600) == Subset().budget(600) == ControlVariate().budget(600) == 120
    assert TwoPhase().budget(60) == 20
    assert TwoPhase(refined_runs=75).budget(600) == 75
    assert TwoPhase(refined_runs=75).budget(60) == 60
    assert TwoPhase(target_cov=0.1).budget(600) == 600
    assert MonteCarlo().budget(600) == 600
    assert Published(8).budget(600) is None


def test_the_audit_looks_first_where_the_campaign_begins_to_fail():
    # The same grids in other units: what fails at 0.3 m here is what fails at 1 m there.
    displacement, failed = pair(300, 0.2, 0.95, 1)
    metre = play(TwoPhase(), displacement, failed)[1]
    population, answers = Population(0.3 * displacement, failure_displacement=0.3), {}
    while asked := TwoPhase().next_runs(population, answers, 1, ()):
        answers |= {sample: bool(failed[sample]) for sample in asked}
    assert answers.keys() == metre.keys()
    assert TwoPhase().estimate(population, answers).probability == pytest.approx(
        TwoPhase().estimate(Population(displacement), metre).probability
    )


def test_a_scene_names_estimators_and_gives_them_what_they_take():
    kinds = {kind for kind in vars(estimate).values() if isinstance(kind, type) and "name" in vars(kind)}
    assert set(ESTIMATORS.values()) == kinds - {estimate.Estimator}
    assert named_estimator("two-phase", {"seed": 3, "k_t": 8, "levels": None}) == TwoPhase(k_t=8, seed=3)
    assert named_estimator("published", {"seed": 3, "k_t": 8}) == Published(8)
    assert named_estimator("subset", {"seed": 3, "k_t": None, "levels": 2}) == Subset(levels=2, seed=3)
    with pytest.raises(ValueError, match=r"k_t = 8 is for estimator = .*, not 'subset': leave it out"):
        named_estimator("subset", {"k_t": 8})
    with pytest.raises(ValueError, match="lacks k_t"):
        named_estimator("published", {"k_t": None})
    with pytest.raises(ValueError, match=r"replicates = 2 is for estimator = 'subset', not 'two-phase'"):
        named_estimator("two-phase", {"replicates": 2})


def test_monte_carlo_of_all_samples_is_the_plain_share():
    displacement, failed = pair(120, 0.25, 0.9, 0)
    population, answers = play(MonteCarlo(), displacement, failed, lanes=3)
    whole = monte_carlo(failed, samples=120)
    assert MonteCarlo().estimate(population, answers) == whole
    # More runs of these samples would buy nothing.
    assert (whole.audit_variance, after_more_runs(whole, 50, samples=120)) == (0, pytest.approx(whole.cov))
    assert MonteCarlo().weights(population, answers) == dict.fromkeys(range(120), 1.0)
    assert MonteCarlo().why_finished(population, answers) == "all samples ran on the refined grid"
    assert TwoPhase().beside(population, answers) == Published(5).beside(population, answers) == [whole]
    assert MonteCarlo().beside(population, answers) == []


@pytest.mark.parametrize("estimator", [ControlVariate(), MonteCarlo()])
def test_runs_without_answer_are_noted(estimator):
    displacement, failed = pair(100, 0.25, 0.9, 0)
    answers = dict(enumerate(failed[:40].tolist())) | {7: None}
    estimate = estimator.estimate(Population(displacement), answers)
    assert estimate.refined_runs == 39
    assert "1 refined runs gave no answer" in estimate.notes[0]
    nothing = estimator.estimate(Population(displacement), {})
    assert nothing.interval == (0.0, 1.0)


def test_subset_simulation_asked_step_by_step_is_the_same():
    estimator, asked = Subset(levels=2, replicates=4), []

    def rough(xi):
        asked.append(xi)
        return xi[:, 0] + 0.1 * xi[:, 1]

    sampling = Sampling(160, 1.0, modes=lambda: 3)
    subset = subset_simulation(rough, 3, estimator.plan(sampling))
    every = np.concatenate(asked)
    assert len(every) == estimator.rough_runs(sampling) == subset.rough_runs
    np.testing.assert_array_equal(every[subset.number], subset.coefficients)
    assert np.unique(subset.number).size == subset.number.size
    known: dict[int, tuple[float, bool]] = {}
    while len(xi := estimator.coefficients(sampling, known)) > len(known):
        assert estimator.population(sampling, known) is None
        known |= {n: (float(xi[n, 0] + 0.1 * xi[n, 1]), False) for n in range(len(known), len(xi))}
    np.testing.assert_array_equal(xi, every)
    population = estimator.population(sampling, known)
    np.testing.assert_array_equal(population.numbers, subset.number)
    np.testing.assert_array_equal(population.weight, subset.weight)
    # A result that was lost is asked for again, and nothing after it that might depend on it.
    lost = {number: result for number, result in known.items() if number != 30}
    again = estimator.coefficients(sampling, lost)
    assert 30 < len(again) < len(every)
    np.testing.assert_array_equal(again, every[: len(again)])
