"""Rank order and the published stopping rule, as pure functions of what is known.

Jiang, Li, Ma and Rezania (2024), Computers and Geotechnics 172, 106413: samples are run on the refined grid
in the order of their rough displacement until k_t consecutive ones stand. The count starts anew at each
failure. Because these functions look only at the rank order and at the results known so far, the answer does
not depend on how many runs were under way at once, nor on the order in which they came back.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Ranking:
    """Samples by rough displacement, largest first.

    order: sample indices (N,). broke_off: indices whose rough run gave no result; they lead the order.
    """

    order: np.ndarray
    broke_off: np.ndarray


def rank_samples(rough_displacement: np.ndarray, broke_off: np.ndarray | None = None) -> Ranking:
    """Rank N samples by their largest rough displacement (N,) m, largest first, ties by sample number.

    A rough run that broke off (`broke_off` (N,) bool, or a displacement that is not finite) says nothing
    about its sample, and most lanes fail because the soil moved far. It is therefore placed first, where it
    certainly gets a refined run, and reported; dropping it would bias the probability.
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

    order: sample indices by rank (N,). refined: sample -> whether it failed on the refined grid; None for a
    run that gave no answer, which neither counts towards k_t nor resets it. If k_t consecutive samples never
    stand, all N are needed.
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

    At most `look_ahead` runs are under way together, those in `under_way` included. A sample is asked for
    only if the rule needs it whatever the missing results turn out to be, so looking ahead wastes no run.
    """
    if look_ahead < 1:
        raise ValueError(f"look_ahead = {look_ahead} is below 1: give the number of runs at once")
    order = rank_samples(rough_displacement, broke_off).order
    missing = _walk(order, refined, k_t)[1]
    places = max(look_ahead - len(under_way), 0)
    return [sample for sample in missing if sample not in under_way][:places]


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
