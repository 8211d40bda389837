"""Runs of which only the class is asked for end early: the same classes, fewer steps, ranks that go on."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.robustness.invented import TINY
from cooperative import runs
from cooperative.scene import parse
from jaxmpm import Status
from jaxmpm.run import Early

LIMIT = 1.0
LONG = TINY.replace("t_end = 4.0", "t_end = 10.0")


@pytest.fixture(scope="module")
def model():
    campaign = parse(LONG)
    return runs.build(campaign, "rough", runs.random_soil(campaign))


def rows(model, limit, **changes):
    campaign = replace(model.campaign, run=replace(model.campaign.run, **changes))
    coefficients = runs.coefficients_of(campaign, model.soil)
    numbers = range(campaign.plan.samples)
    ran = runs.run_samples(
        replace(model, campaign=campaign), coefficients, numbers, width=1, rules=campaign.rules(limit)
    )
    return sorted(ran, key=lambda sample: sample.number)


def test_classes_are_those_of_whole_runs_in_fewer_steps_and_failures_keep_their_order(model):
    early, before, whole = rows(model, LIMIT), rows(model, LIMIT, early=False), rows(model, None)
    displacements = [np.array([sample.row["displacement"] for sample in each]) for each in (early, before, whole)]
    fails = displacements[2] > LIMIT
    assert 0 < fails.sum() < fails.size
    for each in displacements[:2]:
        np.testing.assert_array_equal(each > LIMIT, fails)
    assert sum(sample.steps for sample in early) < 0.7 * sum(sample.steps for sample in before)
    assert {sample.status for sample in early} == {Status.DECIDED.name, Status.SETTLED.name}
    # Slopes that stand have come as far, to some millimetres.
    np.testing.assert_allclose(displacements[0][~fails], displacements[1][~fails], atol=0.01)


def test_where_more_than_the_class_is_asked_for_nothing_ends_early(model):
    early, without = rows(model, None), rows(model, None, early=False)
    assert [(sample.steps, sample.row) for sample in early] == [(sample.steps, sample.row) for sample in without]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            ("softening_modulus = 85e3", ""),
            r"early = true while not all soil softens linearly: its rule holds for slopes that settle",
        ),
        (("[run]\n", "[run]\nsettle = false\n"), r"early = true while settle is off"),
    ],
)
def test_a_rule_that_does_not_hold_is_refused_where_it_is_asked_for(change, message):
    text = LONG.replace(*change)
    assert text != LONG
    assert not any(isinstance(rule, Early) for rule in parse(text).rules(LIMIT))
    with pytest.raises(ValueError, match=message):
        parse(text.replace("[run]\n", "[run]\nearly = true\n"))
