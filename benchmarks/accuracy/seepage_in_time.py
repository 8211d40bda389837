"""The probability of failure against time of an infinite slope with one random number, whose answer is exact.

Cohesion is lognormal. The slope has failed once the pressure at its base has brought the factor of safety to 1, and the
pressure rises in a storm and falls after it. Runs are made up: a refined one knows the factor, a rough one is off by a
share of it. What is asked of them, and what is made of the answers, is that of `jaxmpm seepage --probability`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from scipy.stats import norm

from cooperative.estimate import Bracket, critical_factor, first_guess, in_time, record_lows

HOURS = np.array([0.0, 3.0, 6.0, 12.0, 18.0, 24.0, 36.0, 48.0])
STORM = 24.0
SLOPE, DEPTH, WEIGHT, WATER, FRICTION = math.radians(32.0), 3.0, 19e3, 9.81e3, math.radians(30.0)
MEANS, COV = {"soft": 6e3, "firm": 10e3}, 0.4
ROUGH_BIAS, ROUGH_NOISE, SLICES_NOISE = 1.03, 0.04, 0.03


def pressure(hours: np.ndarray) -> np.ndarray:
    """Pore pressure (Pa) at the base: parallel seepage in 0.9 of the depth is what a storm without end leads to."""
    wet = 1 - np.exp(-np.minimum(hours, STORM) / 12.0)
    share = 0.9 * wet * np.exp(-np.maximum(hours - STORM, 0) / 20.0)
    return WATER * share * DEPTH * math.cos(SLOPE) ** 2


def factors(cohesion: np.ndarray) -> np.ndarray:
    """Factor of safety (n, times) by equilibrium along the base."""
    normal = WEIGHT * DEPTH * math.cos(SLOPE) ** 2 - pressure(HOURS)
    driving = WEIGHT * DEPTH * math.sin(SLOPE) * math.cos(SLOPE)
    return (cohesion[:, None] + normal * math.tan(FRICTION)) / driving


def exact(mean: float) -> np.ndarray:
    """Probability (times,) that the slope has failed by each time: that cohesion is below the largest one needed."""
    needed = np.maximum.accumulate(-(factors(np.zeros(1))[0] - 1) * WEIGHT * DEPTH * math.sin(SLOPE) * math.cos(SLOPE))
    spread = math.sqrt(math.log1p(COV**2))
    middle = math.log(mean) - spread**2 / 2
    return norm.cdf((np.log(np.maximum(needed, 1e-9)) - middle) / spread)


def first_failures(fails: np.ndarray, slices: np.ndarray, critical: float) -> tuple[np.ndarray, int]:
    """When each sample fails first, of its answers (n, times), and the number of runs that it took to know."""
    first, runs = [], 0
    for answers, own in zip(fails, slices, strict=True):
        lows = record_lows(own)
        bracket, guess = Bracket.of(len(lows)), first_guess(own, lows, critical)
        while (at := bracket.next(guess)) is not None:
            bracket = bracket.told(at, bool(answers[lows[at]]))
        first.append(lows[bracket.fails] if bracket.fails < bracket.count else len(HOURS))
        runs += bracket.asked
    return np.array(first), runs


def repetition(
    rng: np.random.Generator, mean: float, samples: int, audited: int
) -> tuple[np.ndarray, np.ndarray, float]:
    """Estimates (times, 3) with their intervals from the audit, those of the refined runs alone, and runs a sample."""
    spread = math.sqrt(math.log1p(COV**2))
    cohesion = np.exp(math.log(mean) - spread**2 / 2 + spread * rng.standard_normal(samples))
    true = factors(cohesion)
    rough = true * ROUGH_BIAS * np.exp(ROUGH_NOISE * rng.standard_normal((samples, 1)))
    slices = true * np.exp(SLICES_NOISE * rng.standard_normal((samples, 1)))
    worst = int(np.argmin(true[0]))
    critical = critical_factor(slices[:10, worst].tolist(), (rough[:10, worst] < 1).tolist())
    first, runs = first_failures(rough < 1, slices, critical)
    fine, _ = first_failures(true < 1, slices, critical)
    both = in_time(first, dict(enumerate(fine[:audited].tolist())), slices, len(HOURS))
    alone = in_time(fine, None, None, len(HOURS))
    return *(np.array([(e.probability, *e.interval) for e in each]) for each in (both, alone)), runs / samples  # type: ignore[return-value]


def coverage_rows(quick: bool) -> Iterator[dict[str, Any]]:
    """How often the interval at each time holds the exact probability."""
    count, samples, audited = (40 if quick else 200), 200, 60
    for slope, mean in MEANS.items():
        rng = np.random.default_rng(63)
        every = [repetition(rng, mean, samples, audited) for _ in range(count)]
        truth = exact(mean)
        for number, name in enumerate(("both grids", "one grid")):
            answers = np.array([each[number] for each in every])
            holds = (answers[..., 1] <= truth) & (truth <= answers[..., 2])
            for at, hours in enumerate(HOURS):
                yield {
                    "case": f"P_f of a {slope} slope by {hours:g} h, {name}", "exact": round(float(truth[at]), 4),
                    "mean": round(float(answers[:, at, 0].mean()), 4), "coverage": float(holds[:, at].mean()),
                    "width": round(float((answers[:, at, 2] - answers[:, at, 1]).mean()), 3),
                    "runs_a_sample": round(float(np.mean([each[2] for each in every])), 2),
                }  # fmt: skip
