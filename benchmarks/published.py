"""The published study beside ours: every table and figure of Jiang et al. (2024), from the files of `benchmarks.study`.

Source: Jiang, Li, Ma and Rezania (2024), Computers and Geotechnics 172, 106413. Nothing is run here: what the files
`benchmarks/data/study_*.csv` do not hold is not run yet, and has no value. An interval is that of 95 per cent; of a
factor of safety, one step of the search. Hours are processor time of one core, or those of a GPU, of the runs that an
answer rests on.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import t as student

from benchmarks import study_figures as figures
from benchmarks import study_pieces as pieces
from benchmarks.measure import Report
from benchmarks.study import DATA, FIGURES, read_study
from benchmarks.study_pieces import (
    AUDIT,
    CELLS,
    K_T,
    LIMIT,
    STEP,
    SWEEP_AUDIT,
    calibration,
    factor_of_safety,
    failed,
    of_cell,
    population,
    refined_classes,
    score,
    sweep_cases,
)
from benchmarks.study_runs import (
    LENGTHS,
    MORE_AIR,
    ON_CPU,
    READINGS,
    SAMPLES,
    SECTION_SAMPLES,
    SWEEP_SAMPLES,
    sweep_case,
)
from benchmarks.study_table import CPU, Outcome, Rows, Run, merged
from cooperative.estimate import (
    AuditPlan,
    Estimate,
    correlation,
    effective_size,
    fit_distributions,
    published,
    rank_samples,
    sample_weights,
    severity_ranking,
    two_phase,
    wilson_interval,
)
from cooperative.measure import SEVERITY

FEWEST = 20
"""Pairs from which on a reading is judged."""
FEW_SLIDES = 5
"""Slides of a mode from which on the spread of their area is told."""
UNDECIDED = 2.0
"""Differences of AIC below this tell two distributions apart no better than chance."""
FEW_RUNS = 8
"""Runs from which on the mean of their seconds has an interval."""
REFINED_CLASSES = {"case": "published", "grid": "refined", "until": "class"}
"""The refined runs of the headline campaign."""
BEST_FITS = {
    "shallow": {"area": "normal", "volume": "logistic", "runout": "normal"},
    "deep": {"area": "normal", "volume": "logistic", "runout": "normal"},
    "compound": {"area": "normal", "volume": "logistic", "runout": "normal"},
    "progressive": {"area": "logistic", "volume": "Weibull", "runout": "normal"},
}
"""Distribution of least AIC that is printed for each mode and consequence (Tables 4 and 5, Fig. 19)."""
POOLED = {"shallow": 14, "deep": 1043, "compound": 177, "progressive": 353}
"""Failures of each mode behind Table 4, as BIC - AIC = 2 (ln N - 2) implies: all correlation lengths together."""


class Hours(NamedTuple):
    """What runs took: hours of one core, hours of a GPU."""

    core: float
    gpu: float

    def __str__(self) -> str:
        told = [f"{hours:.3f} {kind}" for hours, kind in ((self.core, "core"), (self.gpu, "GPU")) if hours]
        return " + ".join(told) or "none"


@dataclass(frozen=True)
class Found:
    """One answer of ours: its value, interval, what it rests on, and what that took."""

    value: float
    interval: tuple[float, float]
    rests_on: str
    hours: Hours


@dataclass(frozen=True)
class Line:
    """One row of the table. name: of the value, None for a row without one. printed: the published value, None if
    there is none. found: ours, or why there is none yet. cause: what was measured of the reasons of a difference.
    counted: the interval of the published value itself, where it is a share that was counted."""

    what: str
    name: str | None
    printed: float | None
    found: Found | str
    cause: str = ""
    counted: tuple[float, float] | None = None

    def verdict(self) -> str:
        """Whether the published value lies in our interval, and if not, why; two shares that were both counted agree
        where their difference is no larger than the root of the sum of squares of the two half widths between them.
        Where nothing was found, an interval that holds the published value decides nothing."""
        if isinstance(self.found, str):
            return f"not run yet: {self.found}"
        low, high = self.found.interval
        if self.printed is None:
            return self.cause or "not published"
        if low - 1e-9 <= self.printed <= high + 1e-9:
            return "agrees" if self.found.value else f"not resolved: none was found, up to {high:.2g} may be"
        if self.counted is not None:
            above = self.found.value > self.printed
            ours = self.found.value - low if above else high - self.found.value
            theirs = self.counted[1] - self.printed if above else self.printed - self.counted[0]
            reach = float(np.hypot(ours, theirs))
            words = f"{self.found.value - self.printed:+.3g}, where the two samples leave {reach:.3g} open"
            if abs(self.found.value - self.printed) <= reach:
                return f"agrees: {words}"
            return f"differs by {words}: {self.cause or 'cause not measured yet'}"
        return f"differs by {self.found.value - self.printed:+.3g}: {self.cause or 'cause not measured yet'}"

    def as_row(self) -> dict[str, Any]:
        """The line with the same columns for all."""
        found = self.found if isinstance(self.found, Found) else None
        return {
            "what": self.what,
            "published": "none" if self.printed is None else self.printed,
            "ours": "none" if found is None else round(found.value, 4),
            "low": "none" if found is None else round(found.interval[0], 4),
            "high": "none" if found is None else round(found.interval[1], 4),
            "rests on": "nothing" if found is None else found.rests_on,
            "hours": "none" if found is None else str(found.hours),
            "verdict": self.verdict(),
        }


def run(quick: bool) -> Report:
    """All rows, from the files; the figures are drawn beside. `quick` changes nothing, there is nothing to run."""
    del quick
    return report(DATA, FIGURES)


def report(folder: Path, draw_in: Path) -> Report:
    """Rows and values from the files in a folder, the figures of what is there. ValueError for a damaged file."""
    rows = merged(read_study(folder).values())
    lines = [*factors(rows), *table_3(rows), *probabilities(rows), *readings(rows), *lengths(rows), *modes(rows)]
    lines += hours(rows)
    figures.draw(rows, [(line.what, line.found) for line in lines], draw_in)
    values = {line.name: line.found.value for line in lines if line.name and isinstance(line.found, Found)}
    for line in lines:
        if line.name == "pf_3d" and isinstance(line.found, Found):
            values |= dict(zip(("pf_3d_low", "pf_3d_high"), line.found.interval, strict=True))
    return Report({name: round(value, 4) for name, value in values.items()}, [line.as_row() for line in lines])


def hours_of(rows: Mapping[Run, Outcome], **which: Any) -> Hours:
    """Hours of the runs whose fields are as said."""
    chosen = [o for run, o in rows.items() if all(getattr(run, name) == value for name, value in which.items())]
    core = sum(outcome.seconds for outcome in chosen if outcome.device == CPU)
    return Hours(core / 3600, (sum(outcome.seconds for outcome in chosen) - core) / 3600)


def hours_of_audit(rows: Rows, case: str, refined: Collection[int]) -> Hours:
    """Hours of the rough classes of a case and of these refined ones."""
    mine = {
        run: outcome
        for run, outcome in rows.items()
        if (run.case, run.until) == (case, "class") and (run.grid == "rough" or run.sample in refined)
    }
    return hours_of(mine)


# Factors of safety, run-out, Table 3

FACTORS = (
    ("rough", "mean strength", "", 1.26),
    ("refined", "mean strength", "", 1.15),
    ("rough", "mean strength, rollers", "_rollers", None),
    ("refined", "mean strength, rollers", "_rollers", None),
    ("rough", "mean strength, default", "_default", None),
    ("refined", "mean strength, default", "_default", None),
    ("rough", "mean strength, default, rollers", "_default_rollers", None),
    ("refined", "mean strength, default, rollers", "_default_rollers", None),
)


def factors(rows: Rows) -> Iterator[Line]:
    """First R that fails, both grids, and the run-out of the refined slide there."""
    for grid, case, suffix, printed in FACTORS:
        words = case.removeprefix("mean strength").removeprefix(", ") or "as published"
        yield Line(
            f"factor of safety in 3D, {grid}, {words}",
            f"fos_{grid}_3d{suffix}",
            printed,
            factor(rows, case, grid),
            others(rows, grid) if printed is not None else "",
        )
    slide = slide_of(rows, "mean strength")
    yield Line("run-out in 3D at that factor, refined (m)", "runout_refined_3d_m", 14.17, slide, beside(rows))


def factor(rows: Rows, case: str, grid: str) -> Found | str:
    """A factor of safety, agreeing with what lies one step of the search from it."""
    tried = [run for run in rows if (run.case, run.grid, run.until) == (case, grid, "class")]
    value = factor_of_safety(rows, case, grid)
    if value is None:
        return f"{len(tried)} runs of the search are there"
    spent = hours_of(rows, case=case, grid=grid, until="class")
    return Found(value, (value - 1 / STEP, value + 1 / STEP), f"{len(tried)} runs", spent)


def others(rows: Rows, grid: str) -> str:
    """What the same slope has with other y ends and other settings, as far as measured."""
    told = []
    for case, words in (
        ("mean strength", "y ends fixed"),
        ("mean strength, rollers", "y ends on rollers"),
        ("mean strength, default", "default settings"),
        ("section of mean strength", "section"),
    ):
        value = factor_of_safety(rows, case, grid)
        if value is not None:
            told.append(f"{words} {value:.2f}")
    return "measured with " + ", ".join(told) if len(told) > 1 else ""


def beside(rows: Rows) -> str:
    """Run-outs of the section at its own factors, beside that in 3D."""
    found = slide_of(rows, "section of mean strength")
    return "" if isinstance(found, str) else f"the section, at its own factor, runs out {found.value:.2f} m"


def slide_of(rows: Rows, case: str) -> Found | str:
    """Run-out of the slide at the factor of safety, agreeing within half a cell."""
    value = factor_of_safety(rows, case, "refined")
    run = Run(case, "refined", reduction=value or 0.0, until="end")
    if value is None or run not in rows:
        return "the slide at the factor of safety" if value else "the factor of safety comes first"
    runout, half = rows[run].runout, cell_of(case) / 2
    if runout is None:
        return f"the slide ended {rows[run].status} at {rows[run].displacement:.2g} m"
    grains = "" if rows[run].runout_any is None else f", {rows[run].runout_any:.2f} m with detached grains"
    words = f"one slide at R = {value:.2f}, {rows[run].mode}{grains}; the interval is half a cell"
    return Found(runout, (runout - half, runout + half), words, hours_of({run: rows[run]}))


def cell_of(case: str) -> float:
    """Cell of the refined grid of a case without random field (m)."""
    return float(case.split("cells of ")[1].split()[0]) if "cells of" in case else 1.0


def table_3(rows: Rows) -> Iterator[Line]:
    """The grid study: factor and run-out against the cell, in 3D as published and in the section."""
    for kind, dimension in (("mean strength", "3D"), ("section of mean strength", "section")):
        for cell, printed in zip(CELLS, (14.17, 14.52, 14.76), strict=True):
            if dimension == "3D" and cell != 0.75:
                continue
            case, words = of_cell(kind, cell), f"Table 3 with cells of {cell:g} m, {dimension}"
            yield Line(f"{words}: factor of safety", None, 1.15, factor(rows, case, "refined"), over_cells(rows))
            yield Line(f"{words}: run-out (m)", None, printed, slide_of(rows, case), over_cells(rows))


def over_cells(rows: Rows) -> str:
    """How factor and run-out of the section follow the cell, with published and with default settings."""
    told = []
    for case, words in (
        ("", "published settings, whose bands of softening soil are a cell thick"),
        (", default", "default"),
    ):
        cases = [of_cell(f"section of mean strength{case}", cell) for cell in CELLS]
        values = [factor_of_safety(rows, each, "refined") for each in cases]
        slides = [slide_of(rows, each) for each in cases]
        runouts = [f" (runs out {slide.value:.1f} m)" if isinstance(slide, Found) else "" for slide in slides]
        if all(value is not None for value in values):
            found = ", ".join(f"{value:.2f}{runout}" for value, runout in zip(values, runouts, strict=True))
            told.append(f"{words}: {found}")
    return f"the section at cells of 1, 0.75, 0.5 m, {'; '.join(told)}" if told else ""


# Probability of failure


def estimated(
    rows: Rows, case: str, samples: int, plan: AuditPlan, reduction: float = 1.0
) -> tuple[Estimate | None, str]:
    """The two-phase estimate of a case; None, and what is there, before its first wave is whole."""
    there = sum(run.case == case and run.grid == "rough" and run.until == "class" for run in rows)
    screened = population(rows, case, samples, reduction)
    if screened is None:
        return None, f"{there} of {samples} rough samples are there"
    refined = refined_classes(rows, case)
    found = two_phase(screened, refined, plan)
    if found.interval == (0.0, 1.0):
        return None, f"{samples} rough samples and {len(refined)} refined ones are there, no wave of the audit is whole"
    return found, f"{samples} rough samples, {found.refined_runs} refined"


def probability(rows: Rows, case: str, samples: int, plan: AuditPlan, reduction: float = 1.0) -> Found | str:
    """P_f of a case with its interval, by the two-phase estimator."""
    found, words = estimated(rows, case, samples, plan, reduction)
    if found is None:
        return words
    notes = "".join(f"; {note}" for note in found.notes)
    spent = hours_of_audit(rows, case, drawn(rows, case, samples, plan, reduction))
    return Found(found.probability, found.interval, words + notes, spent)


def drawn(rows: Rows, case: str, samples: int, plan: AuditPlan, reduction: float = 1.0) -> dict[int, float]:
    """Refined samples that the two-phase estimate of a case rests on, with what each stands for."""
    screened = population(rows, case, samples, reduction)
    return {} if screened is None else sample_weights(screened, refined_classes(rows, case), plan)


def probabilities(rows: Rows) -> Iterator[Line]:
    """P_f, the published rule on the same ranks, and how the grids agree."""
    counted = wilson_interval(244, 1000)
    worth = "; ".join(f"{line.what.split(': ')[-1]} {line.cause}" for line in readings(rows) if line.cause)
    cause = f"on the section: {worth}" if worth else ""
    headline = probability(rows, "published", SAMPLES, AUDIT)
    yield Line("P_f in 3D", "pf_3d", 0.244, headline, cause, counted)
    runs = "refined runs behind P_f in 3D"
    found, words = estimated(rows, "published", SAMPLES, AUDIT)
    mine = drawn(rows, "published", SAMPLES, AUDIT)
    spent = hours_of({run: o for run, o in rows.items() if run.sample in mine}, **REFINED_CLASSES)
    count = words if found is None else Found(found.refined_runs, (found.refined_runs,) * 2, words, spent)
    yield Line(
        runs, "refined_runs_3d", 280, count, "an audit draws where the ranks leave doubt, the rule runs all above"
    )
    yield published_rule(rows)
    yield from agreement(rows, "published", SAMPLES, AUDIT)
    yield devices_agree(rows)
    for case, words in (("default", "default settings"), ("rollers", "y ends on rollers")):
        answer = probability(rows, case, SWEEP_SAMPLES, SWEEP_AUDIT)
        yield Line(f"P_f in 3D, {words}", f"pf_3d_{case}", 0.244, answer, of_setting(rows, case))
    yield from agreement(rows, "default", SWEEP_SAMPLES, SWEEP_AUDIT)


def of_setting(rows: Rows, case: str) -> str:
    """What was measured of a setting that is not the published one, on the section and by factors of safety."""
    worth = {line.what.split(": ")[-1]: line.cause for line in readings(rows) if line.cause}
    named = ("F-bar", "default") if case == "default" else ()
    told = [f"on the section {name} {worth[name]}" for name in named if name in worth]
    pair = [factor_of_safety(rows, name, "refined") for name in ("mean strength", f"mean strength, {case}")]
    if None not in pair:
        told.append(f"the factor of safety in 3D is {pair[1]:.2f} in place of {pair[0]:.2f}")
    return "not the published setting" + (f"; {'; '.join(told)}" if told else "")


def published_rule(rows: Rows) -> Line:
    """What n/N down to k_t standing samples in a row makes of the same ranks."""
    what = f"P_f in 3D by the published rule (k_t = {K_T})"
    screened = population(rows, "published", SAMPLES)
    if screened is None:
        return Line(what, None, 0.244, estimated(rows, "published", SAMPLES, AUDIT)[1])
    found = published(screened.rough_displacement, refined_classes(rows, "published"), K_T)
    if any("not met yet" in note for note in found.notes):
        return Line(what, None, 0.244, f"{found.refined_runs} refined runs are there, the rule is not met yet")
    first = rank_samples(screened.rough_displacement).order[: found.refined_runs]
    spent = hours_of_audit(rows, "published", {int(sample) for sample in first})
    words = f"{SAMPLES} rough samples, {found.refined_runs} refined"
    return Line(what, None, 0.244, Found(found.probability, found.interval, words, spent), "it counts no failure below")


def agreement(rows: Rows, case: str, samples: int, plan: AuditPlan) -> Iterator[Line]:
    """Rank correlation and classes of the two grids in 3D, over the audited samples with their weights."""
    setting, suffix = ("", "") if case == "published" else (f", {case} settings", f"_{case}")
    what = "rank correlation of the grids in 3D (Spearman)", "share of samples that both grids class alike in 3D"
    names = f"spearman_3d{suffix}", f"same_class_3d{suffix}"
    found, words = estimated(rows, case, samples, plan)
    weights = drawn(rows, case, samples, plan)
    both = None
    if found is not None:
        pairs = [[score(rows[Run(case, grid, n)]) for n in weights] for grid in ("rough", "refined")]
        each = np.array(list(weights.values()))
        both = correlation(np.array(pairs[0]), np.array(pairs[1]), each, failure_displacement=LIMIT)
    if both is None:
        yield from (Line(told + setting, name, None, words) for told, name in zip(what, names, strict=True))
        return
    words = f"{both.samples} samples on both grids; of failures the rank is that of their speed to 1 m"
    spent = hours_of_audit(rows, case, weights)
    yield Line(what[0] + setting, names[0], None, Found(both.spearman, both.interval, words, spent))
    size = effective_size(each)
    limits = wilson_interval(min(both.same_class, 1.0) * size, size)
    yield Line(what[1] + setting, names[1], None, Found(both.same_class, limits, words, spent))


def devices_agree(rows: Rows) -> Line:
    """Share of the samples that ran on a CPU and on a GPU which both class alike."""
    what = "share of runs in 3D that a CPU and a GPU class alike"
    pairs = [
        (failed(outcome), failed(rows[replace(run, case="published")]))
        for run, outcome in rows.items()
        if run.case == ON_CPU and replace(run, case="published") in rows
    ]
    if not pairs:
        return Line(what, None, None, "no sample ran on both")
    alike = sum(cpu == gpu for cpu, gpu in pairs)
    interval, words = wilson_interval(alike, len(pairs)), f"{len(pairs)} runs to their class on both"
    return Line(what, None, None, Found(alike / len(pairs), interval, words, hours_of(rows, case=ON_CPU)))


# Readings of what is left open, on the section


def readings(rows: Rows) -> Iterator[Line]:
    """What each reading is worth in P_f, from common samples of the section on the refined grid."""
    base = classes(rows, "section, as here", "refined")
    share = Found(
        float(np.mean(list(base.values()))) if base else np.nan,
        wilson_interval(sum(base.values()), len(base)) if base else (0.0, 1.0),
        f"{len(base)} refined samples",
        hours_of(rows, case="section, as here", grid="refined"),
    )
    yield Line("P_f of the section", None, None, share if len(base) >= FEWEST else f"{len(base)} samples are there")
    for name in (*READINGS, "default"):
        if name == "as here":
            continue
        other = classes(rows, f"section, {name}", "refined")
        common = sorted(base.keys() & other.keys())
        what = f"P_f of the section, change by: {name}"
        if len(common) < FEWEST:
            yield Line(what, None, None, f"{len(common)} of {SECTION_SAMPLES} samples are there")
            continue
        change, limits = paired_change([base[n] for n in common], [other[n] for n in common])
        spent = hours_of(rows, case=f"section, {name}", grid="refined")
        found = Found(change, limits, f"{len(common)} common samples", spent)
        yield Line(what, None, None, found, f"is worth {change:+.3f} ({limits[0]:+.3f} to {limits[1]:+.3f})")


def classes(rows: Rows, case: str, grid: str) -> dict[int, bool]:
    """Samples of a case that have a class on a grid."""
    mine = {
        run.sample: failed(o) for run, o in rows.items() if (run.case, run.grid, run.until) == (case, grid, "class")
    }
    return {sample: answer for sample, answer in mine.items() if answer is not None}


def paired_change(before: list[bool], after: list[bool]) -> tuple[float, tuple[float, float]]:
    """Change of a share between two answers for the same samples, with its interval.

    The adjusted Wald interval of Agresti and Min (2005), Statistics in Medicine 24, 729-740: half a sample more in each
    of the four kinds of pairs, so that pairs without any change still leave room for one.
    """
    first, second = np.asarray(before, float), np.asarray(after, float)
    gained, lost = float(np.sum(second > first)), float(np.sum(second < first))
    size = first.size + 2.0
    middle = (gained - lost) / size
    deviation = np.sqrt((gained + lost + 1.0) - (gained - lost) ** 2 / size) / size
    half = 1.959964 * deviation
    return (gained - lost) / first.size, (middle - half, middle + half)


# Correlation lengths and modes


def lengths(rows: Rows) -> Iterator[Line]:
    """P_f against lx and ly (Fig. 10), each from the same samples: by a small audit of the calibrated rough grid, and
    by that grid alone, whose samples are common, so that its rise is that of pairs."""
    factor = calibration(rows)
    for axis in ("lx", "ly"):
        yield from rough_lengths(rows, axis)
    for axis in ("lx", "ly"):
        ends: list[Found] = []
        for length in LENGTHS:
            answer: Found | str = "the factors of safety come first, they calibrate the rough grid"
            if factor is not None:
                answer = probability(rows, sweep_case(axis, length), SWEEP_SAMPLES, SWEEP_AUDIT, factor)
            if isinstance(answer, Found) and length in (LENGTHS[0], LENGTHS[-1]):
                ends.append(answer)
            yield Line(f"P_f in 3D, {axis} = {length:g} m, the other 60 m", f"pf_{axis}_{length:g}", None, answer)
        what = f"rise of P_f from {axis} = {LENGTHS[0]} m to {LENGTHS[-1]} m"
        if len(ends) < 2:
            yield Line(what, None, None, "both ends of the range come first")
            continue
        rise, limits = difference(*ends)
        found = Found(rise, limits, "the two ends, taken as independent", Hours(0.0, 0.0))
        yield Line(what, None, None, found, rises(limits))


def rough_lengths(rows: Rows, axis: str) -> Iterator[Line]:
    """Share of failures on the calibrated rough grid at each length along an axis, and its rise from end to end."""
    known = {length: classes(rows, sweep_case(axis, length), "rough") for length in LENGTHS}
    for length, mine in known.items():
        what, answer = rough_length(axis, length), f"{len(mine)} of {SWEEP_SAMPLES} samples are there"
        if len(mine) < SWEEP_SAMPLES:
            yield Line(what, None, None, answer)
            continue
        fallen, spent = sum(mine.values()), hours_of(rows, case=sweep_case(axis, length), grid="rough", until="class")
        interval = wilson_interval(fallen, len(mine))
        yield Line(what, None, None, Found(fallen / len(mine), interval, f"{len(mine)} rough samples", spent))
    first, last = known[LENGTHS[0]], known[LENGTHS[-1]]
    common = sorted(first.keys() & last.keys())
    what = f"rough grid alone: rise of P_f from {axis} = {LENGTHS[0]} m to {LENGTHS[-1]} m"
    if len(common) < SWEEP_SAMPLES:
        yield Line(what, None, None, f"{len(common)} common samples are there")
        return
    rise, limits = paired_change([first[n] for n in common], [last[n] for n in common])
    found = Found(rise, limits, f"{len(common)} common samples", Hours(0.0, 0.0))
    yield Line(what, None, None, found, rises(limits))


def difference(first: Found, last: Found) -> tuple[float, tuple[float, float]]:
    """By how much the second of two independent answers is larger, with its interval, from their own intervals.

    Zou and Donner (2008), Statistics in Medicine 27, 1693-1702, DOI 10.1002/sim.3095: on each side the distances of the
    two limits that lie that way add up as squares.
    """
    change = last.value - first.value
    below = float(np.hypot(last.value - last.interval[0], first.interval[1] - first.value))
    above = float(np.hypot(last.interval[1] - last.value, first.value - first.interval[0]))
    return change, (change - below, change + above)


def rises(limits: tuple[float, float]) -> str:
    """What an interval of a rise says beside the published one, upwards."""
    return "rises, as published" if limits[0] > 0 else "falls, published as rising" if limits[1] < 0 else "not resolved"


def rough_length(axis: str, length: float) -> str:
    """Name of the row of the calibrated rough grid at a length (m)."""
    return f"rough grid alone: P_f at {axis} = {length:g} m"


@dataclass(frozen=True)
class Slides:
    """Refined slides of the headline campaign: those that ended, what each stands for (n,), the share of all failures
    that those stand for which broke off and so have no mode, and in words what they are."""

    ended: list[Outcome]
    weight: np.ndarray
    lost: float
    words: str


def weighted_slides(rows: Rows) -> Slides:
    """Refined slides of the headline campaign with their weights: all failures of as many draws as are whole."""
    screened = population(rows, "published", SAMPLES)
    there = sum(run.case == "published" and run.grid == "refined" and run.until == "end" for run in rows)
    none = Slides([], np.zeros(0), 0.0, f"{there} refined slides are there")
    if screened is None:
        return none
    refined = refined_classes(rows, "published")
    fewest = AUDIT.first_wave + int(np.isnan(screened.rough_displacement).sum())
    for runs in range(AUDIT.runs, fewest - 1, -1):
        weights = sample_weights(screened, refined, replace(AUDIT, runs=runs))
        fallen = {sample: weight for sample, weight in weights.items() if refined[sample]}
        slides = [pieces.slide_of(rows, sample) for sample in fallen]
        if fallen and None not in slides:
            weight = np.array(list(fallen.values()))
            whole = np.array([slide is not None and slide.mode is not None for slide in slides])
            lost = float(weight[~whole].sum() / weight.sum())
            words = f"{whole.sum()} refined slides of {len(slides)} failures of {runs} draws"
            if lost:
                words += (
                    f", the others broke off and stand for {lost:.0%} of failures: the interval leaves them any mode"
                )
            return Slides([slide for slide in slides if slide is not None and slide.mode], weight[whole], lost, words)
    return none


def share_found(mine: np.ndarray, slides: Slides, spent: Hours, words: str) -> Found:
    """Share of these slides (n,) bool among the failures. The interval holds whatever those that broke off would have
    been: Wilson's lower limit where none of them is one of these, the upper where all are."""
    share, size = float(slides.weight[mine].sum() / slides.weight.sum()), effective_size(slides.weight)
    ends = share * (1 - slides.lost), share * (1 - slides.lost) + slides.lost
    limits = [wilson_interval(min(end, 1.0) * size, size) for end in ends]
    return Found(share, (limits[0][0], limits[1][1]), words, spent)


def modes(rows: Rows) -> Iterator[Line]:
    """Shares, severity and fits of the modes at lx = ly = 60 m, and their shares on the calibrated rough grid."""
    slides = weighted_slides(rows)
    names = np.array([slide.mode for slide in slides.ended])
    slid = {run: o for run, o in rows.items() if run.case in ("published", MORE_AIR)}
    spent = hours_of(slid, grid="refined", until="end")
    pool = sum(POOLED.values())
    groups = [("deep",), ("progressive",), ("compound",), ("shallow",), ("progressive", "compound")]
    for group in groups:
        what, printed = " or ".join(group), sum(POOLED[mode] for mode in group)
        cause = f"the published share pools all correlation lengths ({printed} of some {pool} failures)"
        pooled = rough_shares(rows, sweep_cases(), group)
        if isinstance(pooled, Found):
            cause += f"; pooled here, on the calibrated rough grid, it is {pooled.value:.2f}; beyond that not measured"
        answer: Found | str = slides.words
        if names.size > 1:
            mine = np.isin(names, group)
            answer = share_found(mine, slides, spent, f"{slides.words}; {mine.sum()} {what}")
        name = f"share_{'_or_'.join(group)}"
        yield Line(f"share of {what} failures", name, printed / pool, answer, cause)
    yield from severity(slides, names, spent)
    for mode in SEVERITY:
        mine = names == mode
        if mine.sum() >= 20:
            chosen = [slide for slide, one in zip(slides.ended, mine, strict=True) if one]
            yield from fits(mode, chosen, slides.weight[mine], spent)
    yield from rough_modes(rows)


def severity(slides: Slides, names: np.ndarray, spent: Hours) -> Iterator[Line]:
    """Median area of each mode, and its place among those that have slides enough to tell one."""
    areas = np.array([slide.area for slide in slides.ended], float)
    groups = {mode: names == mode for mode in SEVERITY if (names == mode).any()}
    many = {mode: mine for mode, mine in groups.items() if mine.sum() >= FEW_SLIDES}
    what = "median area of {} failures (m2)"
    for mode in groups.keys() - many.keys():
        each = ", ".join(f"{area:.0f}" for area in areas[groups[mode]])
        words = f"{groups[mode].sum()} slides ({each} m2), a median wants {FEW_SLIDES}"
        yield Line(what.format(mode), None, None, words)
    if not many:
        return
    for place in severity_ranking(
        {mode: areas[mine] for mode, mine in many.items()}, weights={m: slides.weight[i] for m, i in many.items()}
    ):
        limits = (float(place.interval[0]), float(place.interval[1]))
        answer = Found(place.middle, limits, f"{place.count} slides; 90 per cent interval", spent)
        rank = f"rank {place.rank} ({place.rank_interval[0]} to {place.rank_interval[1]}) of {len(many)}"
        yield Line(what.format(place.group), None, None, answer, rank if len(many) > 1 else "no other mode to rank")


def fits(mode: str, slides: list[Outcome], weight: np.ndarray, spent: Hours) -> Iterator[Line]:
    """Best distribution of each consequence of a mode beside the printed one."""
    for measure, printed in BEST_FITS[mode].items():
        values = np.array([getattr(slide, measure) for slide in slides], float)
        done = fit_distributions(values, weight)
        by_name = {fit.name: fit.aic for fit in done.fits}
        if done.best_aic is None or printed not in by_name:
            continue
        behind = by_name[printed] - by_name[done.best_aic]
        words = "fits best, as printed" if not behind else f"{done.best_aic} fits best, {printed} by {behind:.1f} worse"
        words += ", which these slides do not tell apart" if done.notes and behind < UNDECIDED else ""
        notes = "".join(f"; {note}" for note in done.notes)
        found = Found(behind, (behind, behind), f"{len(slides)} slides{notes}", spent)
        yield Line(
            f"AIC of the printed {printed} over the best, {measure} of {mode} failures", None, None, found, words
        )


def rough_modes(rows: Rows) -> Iterator[Line]:
    """Fig. 20: shares of the modes against lx and ly, from slides of the calibrated rough grid; then all pooled,
    as Table 4 pools them."""
    for axis in ("lx", "ly"):
        for length in LENGTHS:
            case = [sweep_case(axis, length)]
            what = f"share of deep failures, rough grid calibrated, {axis} = {length:g} m"
            others = ((mode, rough_shares(rows, case, (mode,))) for mode in SEVERITY if mode != "deep")
            rest = ", ".join(f"{mode} {other.value:.2f}" for mode, other in others if isinstance(other, Found))
            yield Line(what, None, None, rough_shares(rows, case, ("deep",)), rest)
    for mode, count in POOLED.items():
        what = f"share of {mode} failures, rough grid calibrated, all lengths"
        answer, cause = rough_shares(rows, sweep_cases(), (mode,)), "its lengths and numbers of samples are not printed"
        yield Line(what, None, count / sum(POOLED.values()), answer, cause)


def rough_shares(rows: Rows, cases: list[str], group: tuple[str, ...]) -> Found | str:
    """Share of these modes among the calibrated rough slides of some cases; why not, while any slide is missing.

    The cases have common samples, whose slides are alike: as many count as samples that fail in all cases or in none
    would tell as much, the effective size of samples weighted by their number of slides.
    """
    known = {run: o for run, o in rows.items() if run.case in cases and run.grid == "rough" and o.mode}
    fallen = sum(sum(classes(rows, case, "rough").values()) for case in cases)
    screened = all(len(classes(rows, case, "rough")) == SWEEP_SAMPLES for case in cases)
    if not screened or not known or len(known) < fallen:
        return f"{len(known)} slides of {fallen} failures are there"
    mine = sum(outcome.mode in group for outcome in known.values())
    samples = np.unique([run.sample for run in known], return_counts=True)[1]
    share, size = mine / len(known), effective_size(samples)
    words = f"{len(known)} rough slides of {samples.size} samples, {mine} {' or '.join(group)}"
    return Found(share, wilson_interval(share * size, size), words, hours_of(known))


def mean_seconds(seconds: np.ndarray) -> tuple[float, tuple[float, float], str]:
    """Mean of the seconds of some runs (n,) with its interval by Student's t; of too few runs the least and the most
    instead, and words that say so."""
    middle = float(seconds.mean())
    if seconds.size < FEW_RUNS:
        return middle, (float(seconds.min()), float(seconds.max())), "; the interval is from the least to the most"
    half = float(student.ppf(0.975, seconds.size - 1) * seconds.std(ddof=1) / np.sqrt(seconds.size))
    return middle, (middle - half, middle + half), ""


def hours(rows: Rows) -> Iterator[Line]:
    """What the study took, beside the published hours."""
    for grid, printed in (("rough", 11.3), ("refined", 92.4)):
        for kind, unit in (("core", "one core"), ("GPU", "one GPU, which no published hour is beside")):
            mine = ON_CPU if kind == "core" else "published", grid, "class"
            done = {run: o for run, o in rows.items() if (run.case, run.grid, run.until) == mine}
            done = {run: o for run, o in done.items() if (o.device == CPU) == (kind == "core")}
            answer: Found | str = "no run is there"
            if done:
                wanted = 1000 if grid == "rough" else 280
                middle, limits, spread = mean_seconds(np.array([o.seconds for o in done.values()]))
                low, high = (each * wanted / 3600 for each in limits)
                words = f"{len(done)} runs to their class, scaled to {wanted}{spread}"
                answer = Found(middle * wanted / 3600, (low, high), words, hours_of(done))
            yield Line(
                f"{kind} hours of {grid} runs",
                None,
                printed if kind == "core" else None,
                answer,
                f"theirs ran on to 20 s, ten at a time on a desktop with 12 cores; ours are hours of {unit}",
            )
    spent = hours_of(rows)
    for name, total in (("hours_total", spent.core), ("gpu_hours_total", spent.gpu)):
        kind = "GPU" if name.startswith("gpu") else "core"
        everything = Found(total, (total, total), f"{len(rows)} runs, all pieces", spent) if rows else "no run is there"
        yield Line(f"{kind} hours of the whole study", name, None, everything)
