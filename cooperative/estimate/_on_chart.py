"""Probability of failure under the loads of a chart, from the same samples: their order, and estimates that rise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from cooperative.estimate._estimates import LEVEL, Estimate
from cooperative.estimate._in_time import in_time


def falling_chain(factors: np.ndarray) -> np.ndarray:
    """Loads in the order in which the factor of safety of a sample falls.

    A sample that fails under one of them fails under all behind it.

    Args:
        factors: of safety under each load (loads,).

    Returns:
        Numbers of the loads (loads,).
    """
    return np.argsort(-np.asarray(factors), kind="stable")


def fails_under(first: int, chain: Sequence[int], states: np.ndarray) -> np.ndarray:
    """Whether a sample fails in each of some states: 1, 0, or nan where a run broke off.

    Args:
        first: state of its chain in which it fails first, one that is not in the chain for never, -1 where a run broke
            off.
        chain: of states, from the safest on.
        states: that are asked for (m,), each in the chain.
    """
    if first < 0:
        return np.full(len(states), np.nan)
    place = {state: at for at, state in enumerate(chain)}
    fails_from = place.get(first, len(chain))
    return np.array([float(place[state] >= fails_from) for state in np.asarray(states).tolist()])


def on_chart(
    fails: np.ndarray, refined: Mapping[int, np.ndarray] | None, factors: np.ndarray, *, level: float = LEVEL
) -> list[Estimate]:
    """The probability of failure under each load of a chart, which rises along both of its axes.

    Each load has the estimate of `in_time` at one time. More rain at any time leaves no head lower, nor does a faster
    fall at one level: the estimates and the ends of their intervals are put in order along both axes.

    Source: Chernozhukov, Fernandez-Val and Galichon (2009), doi:10.1093/biomet/asp030 (rearrangement brings the
    estimate of a monotone function, and its band, no farther from it).

    Args:
        fails: whether each sample fails under each load (n, I, J) on the rough grid, nan where a run broke off.
        refined: the same (I, J) on the refined grid, of samples drawn without regard to their rough answers; None
            without one.
        factors: of safety of each sample under each load (n, I, J), by which samples of one class rank.
        level: confidence level of the intervals.

    Returns:
        An estimate for each load, rows of I.

    Raises:
        ValueError: No run has an answer, or there are too few refined ones.

    Example:
        >>> import numpy as np
        >>> from cooperative.estimate import on_chart
        >>> strength = np.linspace(0.5, 1.5, 40)[:, None, None]
        >>> factors = strength - np.array([[0.0, 0.1], [0.2, 0.3]])
        >>> [round(each.probability, 2) for each in on_chart(factors < 0.9, None, factors)]
        [0.4, 0.5, 0.6, 0.7]
    """

    def first(answers: np.ndarray) -> np.ndarray:
        return np.where(np.isnan(answers), -1, np.where(answers > 0, 0, 1)).astype(int)

    rough, shape = first(np.asarray(fails, float)), fails.shape[1:]
    fine = None if refined is None else {n: first(np.asarray(outcomes, float)) for n, outcomes in refined.items()}
    estimates = [
        in_time(
            rough[:, *at], None if fine is None else {n: int(outcomes[at]) for n, outcomes in fine.items()},
            factors[:, *at, None], 1, level=level,
        )[0]
        for at in np.ndindex(shape)
    ]  # fmt: skip
    values = np.array([(estimate.probability, *estimate.interval) for estimate in estimates]).reshape(*shape, 3)
    rising = np.sort(np.sort(values, axis=0), axis=1).reshape(-1, 3).tolist()
    return [
        replace(estimate, probability=chance, interval=(low, high))
        for estimate, (chance, low, high) in zip(estimates, rising, strict=True)
    ]
