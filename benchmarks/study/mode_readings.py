"""Shares of failure modes of the same slides under each reading of the four printed definitions.

The paper distinguishes modes by eye and prints no rule. `python -m benchmarks.study.mode_readings` runs calibrated
rough slides that benchmarks/data/mode_pasts.npz lacks, and with `--draw` draws sheets of twenty in a folder, from which
readers name the mode. `python -m benchmarks mode_readings` names the modes by each reading; `low` and `high` are the
95 % interval of the share of progressive or compound slides. Where readers have named the twenty
(benchmarks/data/mode_readers.csv), it compares each reading with each reader by Cohen's kappa.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Callable, Mapping
from functools import partial
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.measure import Report
from benchmarks.study import mode_readers, mode_sheets
from benchmarks.study.mode_pasts import EVERY, Past, keep, slides, stored, watch
from benchmarks.study.modes import POOLED
from cooperative.estimate import wilson_interval
from cooperative.measure import SEVERITY, ModeRules, second_release

LEAST = ModeRules().smallest_share
"""Share of the sliding volume below which a pulse is none."""


def pulses(past: Past, valley: float) -> bool:
    """Whether soil lets go in two pulses, as `ModeRules` has it, with this share of the lesser peak between them."""
    return second_release(np.asarray(past.released, float), LEAST, valley) is not None


def lull(past: Past, share: float) -> bool:
    """Whether less than this share of the volume lets go in a second, with at least LEAST of it before and after."""
    seconds = round(1 / EVERY)
    total = np.concatenate([[0.0], np.cumsum(past.released)])
    before, until = total[:-seconds], total[seconds:]
    return bool(np.any((before >= LEAST) & (total[-1] - until >= LEAST) & (until - before < share)))


def adjoining(past: Past, least: float) -> bool:
    """Whether slices deeper than the slope is high and shallower ones each have this share of the volume."""
    deep = float(past.share[past.depth > past.height].sum())
    return min(deep, 1 - deep) >= least


def named(past: Past, progressive: Callable[[Past], bool], compound: Callable[[Past], bool] | None) -> str:
    """Mode by the precedence of the rules; None for the default rule of compound slides."""
    if progressive(past):
        return "progressive"
    if past.mode == "compound" if compound is None else compound(past):
        return "compound"
    return "deep" if float(past.depth.max()) > past.height else "shallow"


Reading = tuple[Callable[[Past], bool], Callable[[Past], bool] | None]
DEFAULT = partial(pulses, valley=ModeRules().valley)
READINGS: dict[str, Reading] = {
    "two pulses, valley below 1/2 of the lesser (the default)": (DEFAULT, None),
    "two pulses, valley below 1/3 of the lesser": (partial(pulses, valley=1 / 3), None),
    "two pulses, valley below 1/5 of the lesser": (partial(pulses, valley=1 / 5), None),
    **{f"a second with less than {part:.0%}": (partial(lull, share=part), None) for part in (0.02, 0.05, 0.1)},
    **{
        f"deep and shallow slices, {part:.0%} each": (DEFAULT, partial(adjoining, least=part))
        for part in (0.05, 0.1, 0.2)
    },
}


def shares(pasts: list[Past], reading: Reading) -> dict[str, float]:
    """Share of each mode by a reading, and of progressive and compound slides together, with its interval."""
    names = Counter(named(past, *reading) for past in pasts)
    either = names["progressive"] + names["compound"]
    low, high = wilson_interval(either, len(pasts))
    result = {mode: names[mode] / len(pasts) for mode in SEVERITY}
    result |= {"progressive_or_compound": either / len(pasts), "low": low, "high": high}
    return {name: round(share, 3) for name, share in result.items()}


def run(quick: bool) -> Report:
    """Shares by each reading, beside the printed ones, and kappa with each reader; `quick` makes no difference.

    Raises:
        ValueError: readers of other slides than those that are stored.
    """
    pasts, readers = stored(), mode_readers.read()
    table: dict[str, dict[str, Any]] = {
        name: shares(list(pasts.values()), reading) for name, reading in READINGS.items()
    }
    values: dict[str, Any] = {"slides": len(pasts)}
    for mode in SEVERITY:
        mode_shares = [row[mode] for row in table.values()]
        values |= {f"{mode}_least": min(mode_shares), f"{mode}_most": max(mode_shares)}
        values |= {f"{mode}_printed": round(POOLED[mode] / sum(POOLED.values()), 3)}
        values |= {f"{mode}_verdict": verdict(min(mode_shares), max(mode_shares), len(pasts))}
    if readers:
        values |= between(readers)
        sheets = mode_sheets.numbered(list(pasts))
        for name, reading in READINGS.items():
            table[name] |= against({number: named(pasts[n], *reading) for number, n in sheets.items()}, readers)
    return Report(values, [{"reading": name, **row} for name, row in table.items()])


def against(rule: Mapping[int, str], readers: Mapping[str, Mapping[int, str]]) -> dict[str, object]:
    """Kappa of a rule with each reader, the mean with its interval, and the mean share of slides that both name alike.

    Args:
        rule: mode by number of the sheet.
        readers: the same, by reader.
    """
    of_reader = {f"kappa_{reader}": rounded(mode_readers.kappa(rule, modes)) for reader, modes in readers.items()}
    alike = np.mean([mode_readers.agreement(rule, modes) for modes in readers.values()])
    low, high = mode_readers.kappa_interval(rule, readers)
    mean = {
        "kappa_mean": rounded(mode_readers.mean_kappa(rule, readers)),
        "kappa_interval": [rounded(low), rounded(high)],
    }
    return {**of_reader, **mean, "alike": round(float(alike), 3)}


def between(readers: Mapping[str, Mapping[int, str]]) -> dict[str, float | str]:
    """Kappa of each pair of readers, and the share of slides of each mode by each reader."""
    values: dict[str, float | str] = {}
    for one, other in combinations(readers, 2):
        values[f"kappa_{one}_{other}"] = rounded(mode_readers.kappa(readers[one], readers[other]))
    for reader, modes in readers.items():
        names = Counter(modes.values())
        values |= {f"{mode}_{reader}": round(number / len(modes), 3) for mode, number in names.most_common()}
    return values


def rounded(value: float | None) -> float | str:
    """For a table: "none" where a value is not defined."""
    return "none" if value is None else round(value, 3)


def verdict(least: float, most: float, slides: int) -> str:
    """Whether a mode's share depends on the reading, from its least and most share of so many slides."""
    if least == most:
        return "the same by each reading"
    apart = wilson_interval(least * slides, slides)[1] < wilson_interval(most * slides, slides)[0]
    return "depends on a rule that is not printed" if apart else "too few slides to decide"


def main() -> None:
    """Run the slides that the stored file lacks, or draw their sheets."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.study.mode_readings", description=__doc__)
    parser.add_argument("--draw", type=Path, metavar="FOLDER", help="draw the sheets that this folder lacks")
    arguments = parser.parse_args()
    if arguments.draw is not None:
        for sheet in mode_sheets.draw(arguments.draw):
            print(sheet, flush=True)
        return
    pasts = stored()
    for slide in slides():
        if slide.sample not in pasts:
            pasts[slide.sample] = watch(slide).past
            keep(pasts)
            print(slide.sample, pasts[slide.sample].mode, file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
