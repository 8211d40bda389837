"""The probability of failure, against time and on a chart, of an infinite slope with one random number: it is exact.

Cohesion is lognormal. The slope has failed once the pressure at its base has brought the factor of safety to 1, and the
pressure rises in a storm and falls after it. Runs are made up: a refined one knows the factor, a rough one is off by a
share of it. What is asked of them, and what is made of the answers, is that of `jaxmpm seepage --probability` and
`--chart`. On the chart the pressure at the end of a storm follows from intensity^0.7 duration, so that lines of one P_f
fall with the slope -1 / 0.7 on logarithmic axes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import norm

from cooperative.estimate import (
    Bracket,
    critical_factor,
    fails_under,
    falling_chain,
    first_guess,
    in_time,
    on_chart,
    record_lows,
)
from cooperative.tools.in_time import rate_at

HOURS = np.array([0.0, 3.0, 6.0, 12.0, 18.0, 24.0, 36.0, 48.0])
STORM = 24.0
SLOPE, DEPTH, WEIGHT, WATER, FRICTION = math.radians(32.0), 3.0, 19e3, 9.81e3, math.radians(30.0)
MEANS, COV = {"soft": 6e3, "firm": 10e3}, 0.4
ROUGH_BIAS, ROUGH_NOISE, SLICES_NOISE = 1.03, 0.04, 0.03
INTENSITIES, DURATIONS = np.geomspace(2.0, 64.0, 6), np.array([6.0, 12.0, 24.0, 48.0])
"""Of the storms of the chart (mm/h, h)."""
POWER, FILLING = 0.7, 120.0
LINES = (0.1, 0.5, 0.9)


def pressure(hours: np.ndarray) -> np.ndarray:
    """Pore pressure (Pa) at the base: parallel seepage in 0.9 of the depth is what a storm without end leads to."""
    wet = 1 - np.exp(-np.minimum(hours, STORM) / 12.0)
    share = 0.9 * wet * np.exp(-np.maximum(hours - STORM, 0) / 20.0)
    return WATER * share * DEPTH * math.cos(SLOPE) ** 2


def pressure_of_storms(intensities: np.ndarray, durations: np.ndarray) -> np.ndarray:
    """Pore pressure (Pa) at the base as storms end."""
    share = 0.9 * -np.expm1(-(intensities**POWER) * durations / FILLING)
    return WATER * share * DEPTH * math.cos(SLOPE) ** 2


def factors(cohesion: np.ndarray, under: np.ndarray) -> np.ndarray:
    """Factor of safety (n, m) by equilibrium along the base under pressures (m,) Pa."""
    normal = WEIGHT * DEPTH * math.cos(SLOPE) ** 2 - under
    driving = WEIGHT * DEPTH * math.sin(SLOPE) * math.cos(SLOPE)
    return (cohesion[:, None] + normal * math.tan(FRICTION)) / driving


def exact(mean: float, under: np.ndarray) -> np.ndarray:
    """Probability (m,) of failure under pressures (m,) Pa: that cohesion is below the one needed."""
    needed = -(factors(np.zeros(1), under)[0] - 1) * WEIGHT * DEPTH * math.sin(SLOPE) * math.cos(SLOPE)
    spread = math.sqrt(math.log1p(COV**2))
    middle = math.log(mean) - spread**2 / 2
    return norm.cdf((np.log(np.maximum(needed, 1e-9)) - middle) / spread)


def first_failures(
    fails: np.ndarray, slices: np.ndarray, chains: list[list[int]], critical: float
) -> tuple[np.ndarray, int]:
    """The state of its chain in which each sample fails first, of its answers (n, m), and how many runs that took."""
    first, runs = [], 0
    for answers, sample_factors, lows in zip(fails, slices, chains, strict=True):
        bracket, guess = Bracket.of(len(lows)), first_guess(sample_factors, lows, critical)
        while (at := bracket.next(guess)) is not None:
            bracket = bracket.told(at, bool(answers[lows[at]]))
        first.append(lows[bracket.fails] if bracket.fails < bracket.count else fails.shape[1])
        runs += bracket.asked
    return np.array(first), runs


@dataclass(frozen=True)
class Runs:
    """Answers of a campaign of made-up runs under pressures.

    Args:
        slices: factors (n, m) that screen.
        chains: of the samples.
        rough: state in which each fails first.
        fine: the same on the refined grid.
        per_sample: runs on the rough grid for each sample.
    """

    slices: np.ndarray
    chains: list[list[int]]
    rough: np.ndarray
    fine: np.ndarray
    per_sample: float

    @classmethod
    def sampled(
        cls, rng: np.random.Generator, mean: float, samples: int, under: np.ndarray,
        chain: Callable[[np.ndarray], Sequence[int]],
    ) -> Runs:  # fmt: skip
        """The answers of random samples."""
        spread = math.sqrt(math.log1p(COV**2))
        cohesion = np.exp(math.log(mean) - spread**2 / 2 + spread * rng.standard_normal(samples))
        true = factors(cohesion, under)
        rough = true * ROUGH_BIAS * np.exp(ROUGH_NOISE * rng.standard_normal((samples, 1)))
        slices = true * np.exp(SLICES_NOISE * rng.standard_normal((samples, 1)))
        chains = [list(chain(sample_factors)) for sample_factors in slices]
        worst = int(np.argmin(true[0]))
        critical = critical_factor(slices[:10, worst].tolist(), (rough[:10, worst] < 1).tolist())
        first, runs = first_failures(rough < 1, slices, chains, critical)
        return cls(slices, chains, first, first_failures(true < 1, slices, chains, critical)[0], runs / samples)


def repetition(
    rng: np.random.Generator, mean: float, samples: int, audited: int
) -> tuple[np.ndarray, np.ndarray, float]:
    """Estimates (times, 3) with their intervals from the audit, those of the refined runs alone, and runs a sample."""
    found = Runs.sampled(rng, mean, samples, pressure(HOURS), record_lows)
    both = in_time(found.rough, dict(enumerate(found.fine[:audited].tolist())), found.slices, len(HOURS))
    alone = in_time(found.fine, None, None, len(HOURS))
    audited_and_alone = (np.array([(e.probability, *e.interval) for e in estimates]) for estimates in (both, alone))
    return *audited_and_alone, found.per_sample  # type: ignore[return-value]


def chart(rng: np.random.Generator, mean: float, samples: int, audited: int) -> tuple[np.ndarray, float]:
    """Estimates (intensities, durations, 3) of the storms with their intervals, and runs a sample."""
    storms = pressure_of_storms(INTENSITIES[:, None], DURATIONS)
    found = Runs.sampled(
        rng, mean, samples, storms.ravel(), lambda sample_factors: falling_chain(sample_factors).tolist()
    )
    every = np.arange(storms.size)

    def under(first: np.ndarray) -> np.ndarray:
        fails = [fails_under(at, chain, every) for at, chain in zip(first, found.chains, strict=False)]
        return np.array(fails).reshape(-1, *storms.shape)

    fine = dict(enumerate(under(found.fine[:audited])))
    estimates = on_chart(under(found.rough), fine, found.slices.reshape(-1, *storms.shape))
    return np.array([(e.probability, *e.interval) for e in estimates]).reshape(*storms.shape, 3), found.per_sample


def coverage_rows(quick: bool) -> Iterator[dict[str, Any]]:
    """How often the interval at each time holds the exact probability."""
    count, samples, audited = (40 if quick else 200), 200, 60
    for slope, mean in MEANS.items():
        rng = np.random.default_rng(63)
        every = [repetition(rng, mean, samples, audited) for _ in range(count)]
        truth = exact(mean, np.maximum.accumulate(pressure(HOURS)))
        for number, name in enumerate(("both grids", "one grid")):
            answers = np.array([repeated[number] for repeated in every])
            holds = (answers[..., 1] <= truth) & (truth <= answers[..., 2])
            for at, hours in enumerate(HOURS):
                yield {
                    "case": f"P_f of a {slope} slope by {hours:g} h, {name}", "exact": round(float(truth[at]), 4),
                    "mean": round(float(answers[:, at, 0].mean()), 4), "coverage": float(holds[:, at].mean()),
                    "width": round(float((answers[:, at, 2] - answers[:, at, 1]).mean()), 3),
                    "runs_a_sample": round(float(np.mean([repeated[2] for repeated in every])), 2),
                }  # fmt: skip


def chart_coverage_rows(quick: bool) -> Iterator[dict[str, Any]]:
    """How often intervals hold the exact probability under each storm, and the exact intensity of each line."""
    count, samples, audited = (40 if quick else 200), 200, 60
    mean = MEANS["firm"]
    rng = np.random.default_rng(64)
    every = [chart(rng, mean, samples, audited) for _ in range(count)]
    answers = np.array([repeated[0] for repeated in every])
    truth = exact(mean, pressure_of_storms(INTENSITIES[:, None], DURATIONS).ravel()).reshape(answers.shape[1:3])
    holds = (answers[..., 1] <= truth) & (truth <= answers[..., 2])
    for (i, j), chance in np.ndenumerate(truth):
        yield {
            "case": f"P_f of {INTENSITIES[i]:g} mm/h for {DURATIONS[j]:g} h", "exact": round(float(chance), 4),
            "mean": round(float(answers[:, i, j, 0].mean()), 4), "coverage": float(holds[:, i, j].mean()),
            "width": round(float((answers[:, i, j, 2] - answers[:, i, j, 1]).mean()), 3),
            "runs_a_sample": round(float(np.mean([repeated[1] for repeated in every])), 2),
        }  # fmt: skip
    fine = np.geomspace(INTENSITIES[0], INTENSITIES[-1], 20001)
    for chance in LINES:
        for j, hours in enumerate(DURATIONS):
            right = rate_at(chance, fine, exact(mean, pressure_of_storms(fine, hours)))
            if not np.isfinite(right):
                continue
            found = np.array(
                [[rate_at(chance, INTENSITIES, repeated[:, j, k]) for k in (0, 2, 1)] for repeated in answers]
            )
            # An end beyond the chart is no bound.
            low, high = np.nan_to_num(found[:, 1], nan=0.0), np.nan_to_num(found[:, 2], nan=np.inf)
            yield {
                "case": f"intensity of P_f = {chance:g} in {hours:g} h", "exact": right,
                "mean": float(np.nanmean(found[:, 0])), "coverage": float(((low <= right) & (right <= high)).mean()),
            }  # fmt: skip
