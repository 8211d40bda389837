"""Rank order, the published stopping rule, and how well the ranks agree, as pure functions of what is known.

Jiang, Li, Ma and Rezania (2024), Computers and Geotechnics 172, 106413: samples are run on the refined grid
in the order of their rough displacement until k_t consecutive ones stand. The count starts anew at each
failure. Because these functions look only at the rank order and at the results known so far, the answer does
not depend on how many runs were under way at once, nor on the order in which they came back.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np
import scipy

from cooperative.estimate._estimates import LEVEL, effective_size


@dataclass(frozen=True)
class Ranking:
    """Samples by rough displacement, largest first.

    Args:
        order: sample indices (N,).
        broke_off: indices whose rough run gave no result; they lead the order.
    """

    order: np.ndarray
    broke_off: np.ndarray


def rank_samples(rough_displacement: np.ndarray, broke_off: np.ndarray | None = None) -> Ranking:
    """Rank N samples by their largest rough displacement (N,) m, largest first, ties by sample number.

    A rough run that broke off (`broke_off` (N,) bool, or a displacement that is not finite) shows nothing about its
    sample, and most lanes fail because the soil moved far. It is therefore placed first, where it certainly gets a
    refined run, and reported; dropping it would bias the probability.

    Args:
        rough_displacement: largest displacement of each sample on the rough grid (N,) m.
        broke_off: rough runs without a result (N,) bool.

    Example:
        >>> import numpy as np
        >>> from cooperative import rank_samples
        >>> rank_samples(np.array([0.1, 3.0, 0.4, 2.0])).order.tolist()
        [1, 3, 2, 0]
    """
    displacement = np.asarray(rough_displacement, dtype=float)
    if displacement.ndim != 1 or displacement.size == 0:
        raise ValueError(f"rough_displacement has shape {displacement.shape}: give one number per sample, at least one")
    failed = ~np.isfinite(displacement)
    if broke_off is not None:
        if np.shape(broke_off) != displacement.shape:
            raise ValueError(f"broke_off has shape {np.shape(broke_off)}: give one for each of {displacement.size}")
        failed |= np.asarray(broke_off, dtype=bool)
    key = np.where(failed, np.inf, displacement)
    order = np.argsort(-key, kind="stable")
    return Ranking(order, np.flatnonzero(failed))


def stopping_rank(order: np.ndarray, refined: Mapping[int, bool | None], k_t: int) -> int | None:
    """How many of the ranked samples the rule needs, or None while it is not known yet.

    Args:
        order: sample indices by rank (N,).
        refined: sample -> whether it failed on the refined grid; None for a run that gave no answer, which neither
            counts towards k_t nor resets it. If k_t consecutive samples never stand, all N are needed.
        k_t: consecutive samples that must stand.
    """
    rank, missing = _walk(order, refined, k_t)
    return None if missing else rank


def next_refined(
    rough_displacement: np.ndarray,
    refined: Mapping[int, bool | None],
    k_t: int,
    look_ahead: int = 1,
    *,
    broke_off: np.ndarray | None = None,
    under_way: Collection[int] = (),
) -> list[int]:
    """Samples to start on the refined grid now, in rank order; empty when there is nothing to start.

    At most `look_ahead` runs are under way together, those in `under_way` included. A sample is asked for only if the
    rule needs it whatever the missing results turn out to be, so looking ahead wastes no run.

    Args:
        rough_displacement: (N,) m.
        refined: sample -> whether it failed on the refined grid, None for a run that gave no answer.
        k_t: consecutive samples that must stand.
        look_ahead: most runs under way together.
        broke_off: rough runs without a result (N,) bool.
        under_way: samples that are running.
    """
    if look_ahead < 1:
        raise ValueError(f"look_ahead = {look_ahead} is below 1: give the number of runs at once")
    order = rank_samples(rough_displacement, broke_off).order
    missing = _walk(order, refined, k_t)[1]
    free = max(look_ahead - len(under_way), 0)
    return [sample for sample in missing if sample not in under_way][:free]


def _walk(order: np.ndarray, refined: Mapping[int, bool | None], k_t: int) -> tuple[int, list[int]]:
    """Rank at which the rule stops if all missing results stand, and the missing samples up to there."""
    if k_t < 1:
        raise ValueError(f"k_t = {k_t} is below 1: give how many consecutive samples must stand")
    standing, missing = 0, []
    for rank, sample in enumerate(map(int, order), start=1):
        if sample not in refined:
            missing.append(sample)
            standing += 1
        elif refined[sample] is not None:
            standing = 0 if refined[sample] else standing + 1
        if standing == k_t:
            return rank, missing
    return len(order), missing


@dataclass(frozen=True)
class Correlation:
    """How well the rough grid predicts the refined one, over samples run on both, each with its weight.

    Args:
        samples: run on both.
        spearman: correlation of the ranks.
        interval: confidence limits of that.
        pearson_log: of the logarithm of the largest displacement.
        same_class: share of samples that both grids call failed or both standing.
        phi: correlation of the two classes, None where either grid has one class only.
    """

    samples: int
    spearman: float
    interval: tuple[float, float]
    pearson_log: float
    same_class: float
    phi: float | None


def correlation(
    rough: np.ndarray, refined: np.ndarray, weight: np.ndarray, *, failure_displacement: float, level: float = LEVEL
) -> Correlation | None:
    """Correlation between the grids; None for fewer than 4 samples, or without any spread.

    Args:
        rough: largest displacements (n,) m of the same samples.
        refined: largest displacements (n,) m of the same samples.
        weight: (n,).
        failure_displacement: beyond which a sample has failed (m). The interval of the rank correlation is Fisher's,
            with the variance of Bonett and Wright (2000), Psychometrika 65, 23-28, for the effective number of samples.
        level: confidence level of the interval.
    """
    if rough.size < 4 or np.ptp(rough) == 0 or np.ptp(refined) == 0:
        return None
    ranks = _ranks(rough, weight), _ranks(refined, weight)
    spearman = min(max(_pearson(*ranks, weight), -1.0), 1.0)
    size = max(effective_size(weight), 3.5)
    half = float(scipy.special.ndtri(0.5 + level / 2) * np.sqrt((1 + spearman**2 / 2) / (size - 3)))
    middle = np.arctanh(min(max(spearman, -1 + 1e-12), 1 - 1e-12))
    fails = (rough > failure_displacement).astype(float), (refined > failure_displacement).astype(float)
    both = np.ptp(fails[0]) > 0 and np.ptp(fails[1]) > 0
    tiny = np.finfo(float).tiny
    return Correlation(
        samples=rough.size,
        spearman=spearman,
        # At a correlation of 1 the limits round to just below it.
        interval=(min(float(np.tanh(middle - half)), spearman), max(float(np.tanh(middle + half)), spearman)),
        pearson_log=_pearson(np.log(np.maximum(rough, tiny)), np.log(np.maximum(refined, tiny)), weight),
        same_class=float(weight[fails[0] == fails[1]].sum() / weight.sum()),
        phi=_pearson(*fails, weight) if both else None,
    )


def _ranks(values: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Weighted ranks from 0 to 1: the share below, and half of that which is equal."""
    distinct, which = np.unique(values, return_inverse=True)
    normalised = np.bincount(which, weight, distinct.size) / weight.sum()
    return (np.cumsum(normalised) - normalised / 2)[which]


def _pearson(a: np.ndarray, b: np.ndarray, weight: np.ndarray) -> float:
    normalised = weight / weight.sum()
    a, b = a - normalised @ a, b - normalised @ b
    return float((normalised @ (a * b)) / np.sqrt((normalised @ a**2) * (normalised @ b**2)))
