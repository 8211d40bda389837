"""Probabilities of failure, published and ours: the headline, what the paper leaves open, correlation lengths."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import replace

import numpy as np

from benchmarks.study import study_pieces, study_runs
from benchmarks.study.published_answers import Found, Hours, Line, difference, hours_of, paired_change, rises
from benchmarks.study.study_pieces import (
    K_T,
    LIMIT,
    SWEEP_AUDIT,
    calibration,
    factor_of_safety,
    failed,
    population,
    refined_classes,
    score,
)
from benchmarks.study.study_runs import LENGTHS, ON_CPU, READINGS, SECTION_SAMPLES, SWEEP_SAMPLES, sweep_case
from benchmarks.study.study_table import Rows, Run
from cooperative.estimate import (
    AuditPlan,
    Estimate,
    correlation,
    effective_size,
    published,
    rank_samples,
    sample_weights,
    two_phase,
    wilson_interval,
)

FEWEST = 20
"""Pairs from which on a reading is judged."""

REFINED_CLASSES = {"case": "published", "grid": "refined", "until": "class"}
"""The refined runs of the headline campaign."""


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


def hours_of_audit(rows: Rows, case: str, refined: Collection[int]) -> Hours:
    """Hours of the rough classes of a case and of these refined ones."""
    mine = {
        run: outcome
        for run, outcome in rows.items()
        if (run.case, run.until) == (case, "class") and (run.grid == "rough" or run.sample in refined)
    }
    return hours_of(mine)


def probabilities(rows: Rows) -> Iterator[Line]:
    """P_f, the published rule on the same ranks, and how the grids agree."""
    counted = wilson_interval(244, 1000)
    worth = "; ".join(f"{line.what.split(': ')[-1]} {line.cause}" for line in readings(rows) if line.cause)
    cause = f"on the section: {worth}" if worth else ""
    headline = probability(rows, "published", study_runs.SAMPLES, study_pieces.AUDIT)
    yield Line("P_f in 3D", "pf_3d", 0.244, headline, cause, counted)
    runs = "refined runs behind P_f in 3D"
    found, words = estimated(rows, "published", study_runs.SAMPLES, study_pieces.AUDIT)
    mine = drawn(rows, "published", study_runs.SAMPLES, study_pieces.AUDIT)
    spent = hours_of({run: o for run, o in rows.items() if run.sample in mine}, **REFINED_CLASSES)
    count = words if found is None else Found(found.refined_runs, (found.refined_runs,) * 2, words, spent)
    yield Line(
        runs, "refined_runs_3d", 280, count, "an audit draws where the ranks leave doubt, the rule runs all above"
    )
    yield published_rule(rows)
    yield from agreement(rows, "published", study_runs.SAMPLES, study_pieces.AUDIT)
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
    screened = population(rows, "published", study_runs.SAMPLES)
    if screened is None:
        return Line(what, None, 0.244, estimated(rows, "published", study_runs.SAMPLES, study_pieces.AUDIT)[1])
    found = published(screened.rough_displacement, refined_classes(rows, "published"), K_T)
    if any("not met yet" in note for note in found.notes):
        return Line(what, None, 0.244, f"{found.refined_runs} refined runs are there, the rule is not met yet")
    first = rank_samples(screened.rough_displacement).order[: found.refined_runs]
    spent = hours_of_audit(rows, "published", {int(sample) for sample in first})
    words = f"{study_runs.SAMPLES} rough samples, {found.refined_runs} refined"
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


def rough_length(axis: str, length: float) -> str:
    """Name of the row of the calibrated rough grid at a length (m)."""
    return f"rough grid alone: P_f at {axis} = {length:g} m"
