"""Probabilities of failure, published and here: the headline, what the paper leaves open, correlation lengths."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace

import numpy as np

from benchmarks.study.answers import Answer, Hours, Line, difference, hours_of, paired_change, rises
from benchmarks.study.cases import (
    AUDIT,
    FAILS_ABOVE,
    K_T,
    LENGTHS,
    ON_CPU,
    READINGS,
    SAMPLES,
    SWEEP_AUDIT,
    SWEEP_SAMPLES,
    sweep_case,
)
from benchmarks.study.rows import Rows, Run, calibration, classes, factor_of_safety, population
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

CHANGE = "P_f of the section, change by: "


def audit_weights(rows: Rows, case: str, samples: int, plan: AuditPlan, reduction: float = 1.0) -> dict[int, float]:
    """Refined samples behind the two-phase estimate of a case, with the number of samples that each stands for."""
    return sample_weights(population(rows, case, samples, reduction), classes(rows, case, "refined"), plan)


def estimated(rows: Rows, case: str, samples: int, plan: AuditPlan, reduction: float = 1.0) -> tuple[Estimate, str]:
    """The two-phase estimate of a case, and its runs in words."""
    estimate = two_phase(population(rows, case, samples, reduction), classes(rows, case, "refined"), plan)
    return estimate, f"{samples} rough samples, {estimate.refined_runs} refined"


def probability(rows: Rows, case: str, samples: int, plan: AuditPlan, reduction: float = 1.0) -> Answer:
    """P_f of a case with its interval, by the two-phase estimator."""
    estimate, words = estimated(rows, case, samples, plan, reduction)
    spent = hours_of_audit(rows, case, audit_weights(rows, case, samples, plan, reduction))
    return Answer(estimate.probability, estimate.interval, "; ".join([words, *estimate.notes]), spent)


def hours_of_audit(rows: Rows, case: str, refined: Collection[int]) -> Hours:
    """Hours of the rough classes of a case and of these refined ones."""
    runs = {run: o for run, o in rows.items() if (run.case, run.until) == (case, "class")}
    return hours_of({run: o for run, o in runs.items() if run.grid == "rough" or run.sample in refined})


def probabilities(rows: Rows) -> Iterator[Line]:
    """P_f, the published rule on the same ranks, and how the grids agree."""
    changes = {line.what.removeprefix(CHANGE): line.cause for line in readings(rows) if line.cause}
    headline = probability(rows, "published", SAMPLES, AUDIT)
    cause = "on the section: " + "; ".join(f"{name} {worth}" for name, worth in changes.items())
    yield Line("P_f in 3D", "pf_3d", 0.244, headline, cause, wilson_interval(244, 1000))
    estimate, words = estimated(rows, "published", SAMPLES, AUDIT)
    weights = audit_weights(rows, "published", SAMPLES, AUDIT)
    refined = {run: o for run, o in rows.items() if run.sample in weights}
    spent = hours_of(refined, case="published", grid="refined", until="class")
    count = Answer(estimate.refined_runs, (estimate.refined_runs,) * 2, words, spent)
    cause = "an audit draws where the ranks leave doubt, the rule runs all above"
    yield Line("refined runs behind P_f in 3D", "refined_runs_3d", 280, count, cause)
    yield published_rule(rows)
    yield from agreement(rows, "published", SAMPLES, AUDIT)
    yield devices_agree(rows)
    worth = "; ".join(f"on the section {name} {changes[name]}" for name in ("F-bar", "default"))
    for case, words, named in (("default", "default settings", worth), ("rollers", "y ends on rollers", "")):
        pair = [factor_of_safety(rows, name, "refined") for name in ("mean strength", f"mean strength, {case}")]
        factors = f"the factor of safety in 3D is {pair[1]:.2f} in place of {pair[0]:.2f}"
        cause = "; ".join(filter(None, ["not the published setting", named, factors]))
        yield Line(
            f"P_f in 3D, {words}", f"pf_3d_{case}", 0.244, probability(rows, case, SWEEP_SAMPLES, SWEEP_AUDIT), cause
        )
    yield from agreement(rows, "default", SWEEP_SAMPLES, SWEEP_AUDIT)


def published_rule(rows: Rows) -> Line:
    """P_f by n/N down to k_t standing samples in a row, on the same ranks."""
    ranked = population(rows, "published", SAMPLES).rough_displacement
    estimate = published(ranked, classes(rows, "published", "refined"), K_T)
    first = rank_samples(ranked).order[: estimate.refined_runs]
    spent = hours_of_audit(rows, "published", {int(sample) for sample in first})
    words = f"{SAMPLES} rough samples, {estimate.refined_runs} refined"
    answer = Answer(estimate.probability, estimate.interval, words, spent)
    return Line(f"P_f in 3D by the published rule (k_t = {K_T})", None, 0.244, answer, "it counts no failure below")


def agreement(rows: Rows, case: str, samples: int, plan: AuditPlan) -> Iterator[Line]:
    """Rank correlation and classes of the two grids in 3D, over the audited samples with their weights."""
    setting, suffix = ("", "") if case == "published" else (f", {case} settings", f"_{case}")
    weights = audit_weights(rows, case, samples, plan)
    rough, refined = (np.array([rows[Run(case, grid, n)].score for n in weights]) for grid in ("rough", "refined"))
    numbers = np.array(list(weights.values()))
    both = correlation(rough, refined, numbers, failure_displacement=FAILS_ABOVE)
    assert both is not None
    words = f"{both.samples} samples on both grids; of failures the rank is that of their speed to 1 m"
    spent, size = hours_of_audit(rows, case, weights), effective_size(numbers)
    limits = wilson_interval(min(both.same_class, 1.0) * size, size)
    for what, name, value, interval in (
        ("rank correlation of the grids in 3D (Spearman)", "spearman_3d", both.spearman, both.interval),
        ("share of samples that both grids class alike in 3D", "same_class_3d", both.same_class, limits),
    ):
        yield Line(what + setting, name + suffix, None, Answer(value, interval, words, spent))


def devices_agree(rows: Rows) -> Line:
    """Share of the samples that ran on a CPU and on a GPU which both class alike."""
    on_gpu = {run: rows.get(replace(run, case="published")) for run in rows if run.case == ON_CPU}
    alike = [rows[run].failed == other.failed for run, other in on_gpu.items() if other is not None]
    interval, words = wilson_interval(sum(alike), len(alike)), f"{len(alike)} runs to their class on both"
    answer = Answer(sum(alike) / len(alike), interval, words, hours_of(rows, case=ON_CPU))
    return Line("share of runs in 3D that a CPU and a GPU class alike", None, None, answer)


def changed(before: Sequence[bool | None], after: Sequence[bool | None], words: str, hours: Hours) -> Answer:
    """Change of the share of failures between two lists of the same samples."""
    change, limits = paired_change([bool(fails) for fails in before], [bool(fails) for fails in after])
    return Answer(change, limits, f"{len(before)} {words}", hours)


def share(rows: Rows, case: str, grid: str) -> Answer:
    """Share of failures of a case on a grid."""
    fails = classes(rows, case, grid)
    failures, spent = sum(map(bool, fails.values())), hours_of(rows, case=case, grid=grid, until="class")
    return Answer(failures / len(fails), wilson_interval(failures, len(fails)), f"{len(fails)} {grid} samples", spent)


def readings(rows: Rows) -> Iterator[Line]:
    """Change of P_f by each reading, from common samples of the section on the refined grid."""
    base = classes(rows, "section, as here", "refined")
    yield Line("P_f of the section", None, None, share(rows, "section, as here", "refined"))
    for name in (*list(READINGS)[1:], "default"):
        other = classes(rows, f"section, {name}", "refined")
        common = sorted(base.keys() & other.keys())
        spent = hours_of(rows, case=f"section, {name}", grid="refined")
        answer = changed([base[n] for n in common], [other[n] for n in common], "common samples", spent)
        low, high = answer.interval
        yield Line(CHANGE + name, None, None, answer, f"is worth {answer.value:+.3f} ({low:+.3f} to {high:+.3f})")


def lengths(rows: Rows) -> Iterator[Line]:
    """P_f against lx and ly (Fig. 10), each from the same samples: by a small audit of the calibrated rough grid, and
    by that grid alone, whose samples are common, so that its rise is that of pairs."""
    from_end_to_end = f"{LENGTHS[0]} m to {LENGTHS[-1]} m"
    for axis in ("lx", "ly"):
        for length in LENGTHS:
            yield Line(rough_length(axis, length), None, None, share(rows, sweep_case(axis, length), "rough"))
        classes_at_ends = [classes(rows, sweep_case(axis, LENGTHS[end]), "rough") for end in (0, -1)]
        ends = [[fails[n] for n in range(SWEEP_SAMPLES)] for fails in classes_at_ends]
        rise = changed(ends[0], ends[1], "common samples", Hours(0.0, 0.0))
        what = f"rough grid alone: rise of P_f from {axis} = {from_end_to_end}"
        yield Line(what, None, None, rise, rises(rise.interval))
    factor = calibration(rows)
    for axis in ("lx", "ly"):
        answers = [probability(rows, sweep_case(axis, at), SWEEP_SAMPLES, SWEEP_AUDIT, factor) for at in LENGTHS]
        for length, answer in zip(LENGTHS, answers, strict=True):
            yield Line(audited_length(axis, length), f"pf_{axis}_{length:g}", None, answer)
        change, limits = difference(answers[0], answers[-1])
        rise = Answer(change, limits, "the two ends, taken as independent", Hours(0.0, 0.0))
        yield Line(f"rise of P_f from {axis} = {from_end_to_end}", None, None, rise, rises(limits))


def rough_length(axis: str, length: float) -> str:
    """Name of the row of the calibrated rough grid at a length (m)."""
    return f"rough grid alone: P_f at {axis} = {length:g} m"


def audited_length(axis: str, length: float) -> str:
    """Name of the row of the audit at a length (m)."""
    return f"P_f in 3D, {axis} = {length:g} m, the other 60 m"
