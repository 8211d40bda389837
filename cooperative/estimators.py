"""Probability of failure with an interval: the published estimate n/N.

Estimators read rows only: a rough displacement per sample and the refined results known so far.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.stats import norm

from cooperative.ranking import rank_samples, stopping_rank


@dataclass(frozen=True)
class Estimate:
    """A probability of failure.

    probability: P_f. interval: confidence limits (low, high) at `level`. cov: coefficient of variation of the
    estimator, its standard error over P_f (inf at P_f = 0). refined_runs: runs on the refined grid that it
    used. method: name of the estimator. notes: what a reader must know, in words.
    """

    probability: float
    interval: tuple[float, float]
    cov: float
    refined_runs: int
    method: str
    level: float = 0.95
    notes: tuple[str, ...] = ()


def wilson_interval(failures: float, samples: float, level: float = 0.95) -> tuple[float, float]:
    """Score interval of Wilson (1927), JASA 22, 209-212, for `failures` among `samples`.

    Both may be fractional, for effective sample sizes. ValueError unless 0 <= failures <= samples, samples > 0
    and 0 < level < 1.
    """
    if not 0 <= failures <= samples or not samples > 0:
        raise ValueError(f"{failures} failures among {samples} samples: give 0 <= failures <= samples, samples > 0")
    if not 0 < level < 1:
        raise ValueError(f"level = {level} is not between 0 and 1: give for example 0.95")
    z = norm.ppf(0.5 + level / 2)
    share, weight = failures / samples, z**2 / samples
    centre = (share + weight / 2) / (1 + weight)
    half = z / (1 + weight) * np.sqrt(share * (1 - share) / samples + weight / (4 * samples))
    # At the ends the limit is exactly 0 or 1; rounding must not put it beyond.
    low = 0.0 if failures == 0 else max(float(centre - half), 0.0)
    high = 1.0 if failures == samples else min(float(centre + half), 1.0)
    return low, high


def published(
    rough_displacement: np.ndarray,
    refined: Mapping[int, bool | None],
    k_t: int,
    *,
    failed_lanes: np.ndarray | None = None,
    level: float = 0.95,
) -> Estimate:
    """n/N of Jiang et al. (2024), Computers and Geotechnics 172, 106413, with a Wilson interval.

    n failures are counted down to the stopping rank of k_t; all samples below it are taken to stand, which
    makes the estimate too low when the grids disagree. The interval holds the sampling of the N only.
    rough_displacement: (N,) [m]. refined: sample -> failed, None for a run without an answer.
    """
    order = rank_samples(rough_displacement, failed_lanes).order
    rank = stopping_rank(order, refined, k_t)
    ranked = [refined[int(sample)] for sample in order[:rank] if int(sample) in refined]
    failures, unanswered = ranked.count(True), ranked.count(None)
    notes = ["samples below the stopping rank are taken to stand: the estimate tends to be low"]
    if rank is None:
        notes.append(f"the stopping rule (k_t = {k_t}) is not met yet")
    if unanswered:
        notes.append(f"{unanswered} refined runs gave no answer: up to {unanswered / order.size:.2g} more")
    share = failures / order.size
    return Estimate(
        probability=share,
        interval=wilson_interval(failures, order.size, level),
        cov=float(np.sqrt((1 - share) / failures)) if failures else float("inf"),
        refined_runs=len(ranked),
        method="published n/N",
        level=level,
        notes=tuple(notes),
    )
