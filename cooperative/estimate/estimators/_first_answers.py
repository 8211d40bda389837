"""What the first samples tell without any model: their share that fails."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cooperative.estimate._estimates import Estimate, monte_carlo
from cooperative.estimate._protocol import Answers, Population


def first_answers(answers: Answers) -> tuple[dict[int, bool], tuple[str, ...]]:
    """Answers of the samples from number 0 on without a gap, and a note on those that broke off."""
    count = without_gap(answers)
    known = {number: bool(answers[number]) for number in range(count) if answers[number] is not None}
    lost = count - len(known)
    return known, (f"{lost} refined runs gave no answer and are left out",) if lost else ()


def monte_carlo_of_first(population: Population, answers: Answers) -> Estimate:
    """The share of the first samples that fails."""
    known, notes = first_answers(answers)
    if not known:
        return Estimate(0.0, (0.0, 1.0), np.inf, 0, "Monte Carlo", notes=("no refined run yet",))
    return replace(monte_carlo(np.array(list(known.values())), samples=population.size), notes=notes)


def monte_carlo_of_all(population: Population, answers: Answers) -> list[Estimate]:
    """Plain Monte Carlo, where every sample has an answer."""
    whole = len(answers) == population.size and None not in answers.values()
    return [monte_carlo_of_first(population, answers)] if whole else []


def without_gap(answers: Answers) -> int:
    """How many samples have an answer or broke off, from number 0 on without a gap."""
    return next(number for number in range(len(answers) + 1) if number not in answers)
