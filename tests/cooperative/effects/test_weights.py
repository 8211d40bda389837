"""What each refined run stands for, by estimator, and which slides stand for nothing."""

import numpy as np
import pytest

from cooperative.estimate import (
    MonteCarlo,
    Phases,
    Population,
    Published,
    Slides,
    TwoPhase,
)
from tests.cooperative.effects.test_slides import known_population


@pytest.mark.parametrize("estimator", [TwoPhase(refined_runs=60), MonteCarlo(refined_runs=60), Published(k_t=8)])
def test_weights_give_the_printed_probability_of_failure(estimator):
    rough, refined, _ = known_population()
    phases = Phases(estimator, 1.0, population=Population(rough))
    while wanted := phases.next_runs(8, ()):
        phases = phases.refined({n: (refined[n], False) for n in {*phases.answers, *wanted}})
    weights = phases.weights
    assert sum(weights.values()) == pytest.approx(1.0, abs=1e-12)
    failed = [n for n in weights if phases.answers[n]]
    assert sum(weights[n] for n in failed) == pytest.approx(phases.estimate.probability, abs=1e-12)
    # Among the failures they are in proportion to those of the draws.
    drawn = estimator.weights(phases.population, phases.answers)
    factors = [weights[n] / drawn[n] for n in failed]
    assert factors == pytest.approx([factors[0]] * len(factors))


def test_a_run_without_an_answer_stands_for_nothing():
    phases = Phases(MonteCarlo(), 1.0, population=Population(np.arange(4.0)))
    after = phases.refined({0: (0.1, False), 1: (0.2, True), 2: (2.0, True), 3: (0.3, False)})
    assert after.answers == {0: False, 1: None, 2: True, 3: False}
    assert after.weights == pytest.approx({0: 1 / 3, 1: 0.0, 2: 1 / 3, 3: 1 / 3})


def test_estimators_without_a_model_draw_their_slides_from_their_failures_alone():
    displacement = np.random.default_rng(2).permutation(np.linspace(0.1, 3.0, 50))
    phases = Phases(MonteCarlo(refined_runs=30), 1.0, population=Population(displacement))
    phases = phases.refined({n: (displacement[n], False) for n in range(30)})
    numbers, failed = list(range(30)), displacement[:30] > 1.0
    slides = Slides.of(phases, numbers, ~failed, 6, 1)
    assert len(slides.missing) == 6
    assert all(failed[n] for n in slides.missing)
    every = Slides.of(phases, numbers, np.ones(30, bool), None, 1)
    np.testing.assert_allclose(every.weight, 1 / 30)


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_slides_that_the_estimator_does_not_count_stand_for_nothing():
    # Monte Carlo counts the samples from the first on without a gap: here none.
    phases = Phases(MonteCarlo(), 1.0, population=Population(np.linspace(3.0, 0.1, 30)))
    phases = phases.refined(dict.fromkeys((5, 6, 9), (3.0, False)))
    slides = Slides.of(phases, [5, 6, 9], np.ones(3, bool), None, 1)
    assert slides.slid.all()
    assert slides.weight.tolist() == [0.0] * 3
