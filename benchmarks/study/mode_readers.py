"""Modes that readers name from the sheets of `mode_sheets`, and how well two judges of the same slides agree.

benchmarks/data/mode_readers.csv has a line per slide and reader. Readers know the four printed definitions alone.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from benchmarks.csv_rows import read_rows, text, whole, word
from benchmarks.study.rows import DATA
from cooperative.measure import SEVERITY

READERS = DATA / "mode_readers.csv"
UNSURE = "unsure"
"""Of a reader who cannot decide. It counts as a name of its own, which no rule gives."""
COLUMNS = {"slide": whole, "reader": text, "mode": word(*SEVERITY, UNSURE)}


def read(path: Path = READERS) -> dict[str, dict[int, str]]:
    """Mode by number of the sheet, by reader; empty without the file.

    Raises:
        ValueError: naming file and line, for a row that does not parse or occurs twice; readers of other slides.
    """
    readers: dict[str, dict[int, str]] = {}
    for row in read_rows(path, COLUMNS, ("slide", "reader")).values():
        readers.setdefault(row["reader"], {})[row["slide"]] = row["mode"]
    if len({frozenset(named) for named in readers.values()}) > 1:
        counts = ", ".join(f"{reader} {len(named)}" for reader, named in readers.items())
        raise ValueError(f"{path.name}: readers name different slides ({counts}): give each a line per slide")
    return readers


def agreement(one: Mapping[int, str], other: Mapping[int, str]) -> float:
    """Share of the slides that both name alike."""
    return sum(one[slide] == other[slide] for slide in one) / len(one)


def kappa(one: Mapping[int, str], other: Mapping[int, str]) -> float | None:
    """Agreement of two judges beyond that of chance: Cohen (1960), doi:10.1177/001316446002000104, Eq. 1.

    Args:
        one: mode by slide.
        other: of the same slides.

    Returns:
        1 where they agree on each slide and 0 where they agree as often as by chance. None where both give all slides
        one and the same mode, which is not defined.

    Raises:
        ValueError: they judge different slides.
    """
    if one.keys() != other.keys() or not one:
        raise ValueError(f"{len(one)} slides and {len(other)} others: give two judges of the same slides")
    counts, others = Counter(one.values()), Counter(other.values())
    chance = sum(number * others[mode] for mode, number in counts.items()) / len(one) ** 2
    return None if chance == 1 else (agreement(one, other) - chance) / (1 - chance)


def mean_kappa(one: Mapping[int, str], readers: Mapping[str, Mapping[int, str]]) -> float | None:
    """Mean kappa with the readers; None where one of them is not defined."""
    kappas = [kappa(one, named) for named in readers.values()]
    defined = [value for value in kappas if value is not None]
    return sum(defined) / len(defined) if defined and len(defined) == len(kappas) else None


def kappa_interval(
    one: Mapping[int, str], readers: Mapping[str, Mapping[int, str]], *, level: float = 0.95, repeats: int = 1000
) -> tuple[float, float]:
    """Interval of `mean_kappa` over slides that are drawn anew, with replacement (percentile bootstrap).

    Args:
        one: mode by slide.
        readers: the same, by reader.
        level: of confidence.
        repeats: draws of as many slides. One in which kappa is not defined does not count.
    """
    slides, generator, values = np.array(list(one)), np.random.default_rng(0), []
    for _ in range(repeats):
        resampled = dict(enumerate(generator.choice(slides, slides.size).tolist()))
        again = {reader: {at: named[n] for at, n in resampled.items()} for reader, named in readers.items()}
        values.append(mean_kappa({at: one[n] for at, n in resampled.items()}, again))
    low, high = np.quantile([value for value in values if value is not None], [(1 - level) / 2, (1 + level) / 2])
    return float(low), float(high)
