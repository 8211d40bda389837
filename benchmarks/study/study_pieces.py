"""Pieces of the study: of each, which runs it wants next, from what is known. Nothing here runs anything."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace

import numpy as np

from benchmarks.study.study_runs import (
    LENGTHS,
    MORE_AIR,
    ON_CPU,
    READINGS,
    SAMPLES,
    SECTION_SAMPLES,
    SWEEP_SAMPLES,
    sweep_case,
)
from benchmarks.study.study_table import Outcome, Rows, Run
from cooperative.estimate import AuditPlan, Population, next_audit, next_refined, sample_weights

LIMIT = 1.0
"""Displacement (m) from which on a slope has failed, as published."""
STEP = 100
"""Factors of safety are multiples of 1 / STEP."""
BRACKET = (100, 160)
AUDIT = AuditPlan(runs=100, seed=2024)
SWEEP_AUDIT = AuditPlan(runs=24, seed=2024)
K_T = SAMPLES // 50
"""Standing samples in a row at which the published rule ends: 2 per cent of the samples, of 1 to 10 published."""


def failed(outcome: Outcome) -> bool | None:
    """Whether the slope failed; None for a run that broke off."""
    return None if broke_off(outcome) else outcome.displacement > LIMIT


def broke_off(outcome: Outcome) -> bool:
    """Whether the run ended for numerical reasons."""
    return outcome.status not in ("FINISHED", "SETTLED", "DECIDED")


def score(outcome: Outcome) -> float:
    """What samples are ranked by (m): the displacement of a slope that stood; of one whose run ended when it had
    failed, that of 20 s at its mean speed so far, so that those which fail sooner rank above; nan if it broke off."""
    if broke_off(outcome):
        return float("nan")
    return outcome.displacement * max(1.0, 20.0 / outcome.time) if failed(outcome) else outcome.displacement


def factor_of_safety(rows: Rows, case: str, grid: str) -> float | None:
    """The least reduction factor that fails where one step less stands; None while it is not known."""
    stands, fails = _bracket(rows, case, grid)
    return fails / STEP if fails - stands == 1 and BRACKET[0] <= stands and fails <= BRACKET[1] else None


def _bracket(rows: Rows, case: str, grid: str) -> tuple[int, int]:
    tried = {
        round(run.reduction * STEP): failed(outcome)
        for run, outcome in rows.items()
        if run.case == case and run.grid == grid and run.until == "class"
    }
    fails = min((step for step, answer in tried.items() if answer is True), default=BRACKET[1] + 1)
    stands = (step for step, answer in tried.items() if answer is False and step < fails)
    return max(stands, default=BRACKET[0] - 1), fails


def bisection(rows: Rows, case: str, grid: str) -> list[Run]:
    """The next run of the search for a factor of safety; none when it is found or not within the bracket. A run that
    broke off answers nothing, and the search ends with it."""
    stands, fails = _bracket(rows, case, grid)
    return [] if fails - stands == 1 else [Run(case, grid, reduction=(stands + fails) // 2 / STEP)]


def factors(*cases: str, grids: tuple[str, ...] = ("rough", "refined")) -> Callable[[Rows], list[Run]]:
    """Factors of safety of cases without a random field, the rough grid first."""
    return lambda rows: [run for grid in grids for case in cases for run in bisection(rows, case, grid)]


def slide_at_failure(*cases: str) -> Callable[[Rows], list[Run]]:
    """The slide on the refined grid at the factor of safety, once that is known."""

    def wanted(rows: Rows) -> list[Run]:
        found = ((case, factor_of_safety(rows, case, "refined")) for case in cases)
        return [Run(case, "refined", reduction=factor, until="end") for case, factor in found if factor is not None]

    return wanted


def screening(case: str, samples: int) -> Callable[[Rows], list[Run]]:
    """Every sample on the rough grid, to its class."""
    return lambda rows: [Run(case, "rough", number) for number in range(samples)]


def on_cpu(rows: Rows) -> list[Run]:
    """Samples of the headline campaign that run on a CPU, wherever the others run."""
    del rows
    return [Run(ON_CPU, grid, number) for grid, count in (("rough", 200), ("refined", 8)) for number in range(count)]


def population(rows: Rows, case: str, samples: int, reduction: float = 1.0) -> Population | None:
    """The screened samples as the estimators take them; None while some are missing."""
    found = [rows.get(Run(case, "rough", number, reduction)) for number in range(samples)]
    known = [outcome for outcome in found if outcome is not None]
    return Population(np.array([score(outcome) for outcome in known])) if len(known) == samples else None


def refined_classes(rows: Rows, case: str) -> dict[int, bool | None]:
    """Samples of a case that ran on the refined grid, and whether they failed."""
    found: dict[int, bool | None] = {}
    for run, outcome in rows.items():
        if run.case == case and run.grid == "refined" and run.reduction == 1:
            found[run.sample] = failed(outcome)
    return found


def audit(case: str, samples: int, plan: AuditPlan) -> Callable[[Rows], list[Run]]:
    """The refined runs that the two-phase estimator draws, once the screening is whole."""

    def wanted(rows: Rows) -> list[Run]:
        screened = population(rows, case, samples)
        if screened is None:
            return []
        return [Run(case, "refined", number) for number in next_audit(screened, refined_classes(rows, case), plan)]

    return wanted


def in_rank_order(case: str, samples: int, k_t: int) -> Callable[[Rows], list[Run]]:
    """The refined runs of the published rule: down the ranking until k_t samples in a row stand."""

    def wanted(rows: Rows) -> list[Run]:
        screened = population(rows, case, samples)
        if screened is None:
            return []
        numbers = next_refined(screened.rough_displacement, refined_classes(rows, case), k_t, look_ahead=k_t)
        return [Run(case, "refined", number) for number in numbers]

    return wanted


def calibration(rows: Rows) -> float | None:
    """Reduction of the rough grid's strength that makes it fail as easily as the refined one; None while not known."""
    found = [factor_of_safety(rows, "mean strength", grid) for grid in ("rough", "refined")]
    return None if found[0] is None or found[1] is None else round(found[0] / found[1], 3)


def sweep_cases() -> list[str]:
    """The cases of the sweep, each once, the ends of the range first."""
    ends = sorted(LENGTHS, key=lambda length: (length not in (LENGTHS[0], LENGTHS[-1]), length))
    return list(dict.fromkeys(sweep_case(axis, length) for length in ends for axis in ("lx", "ly")))


def sweep_screening(rows: Rows) -> list[Run]:
    """The common samples of every correlation length on the rough grid, its strength calibrated."""
    factor = calibration(rows)
    if factor is None:
        return []
    return [Run(case, "rough", number, factor) for case in sweep_cases() for number in range(SWEEP_SAMPLES)]


def sweep_audit(rows: Rows) -> list[Run]:
    """A small audit of every correlation length."""
    factor = calibration(rows)
    if factor is None:
        return []
    wanted = []
    for case in sweep_cases():
        screened = population(rows, case, SWEEP_SAMPLES, factor)
        if screened is not None:
            numbers = next_audit(screened, refined_classes(rows, case), SWEEP_AUDIT)
            wanted += [Run(case, "refined", number) for number in numbers]
    return wanted


def sweep_slides(rows: Rows) -> list[Run]:
    """Slides of the calibrated rough samples that failed, to tell their modes."""
    return [
        Run(run.case, "rough", run.sample, run.reduction, "end")
        for case in sweep_cases()
        for run, outcome in rows.items()
        if run.case == case and run.grid == "rough" and run.until == "class" and failed(outcome)
    ]


def slides(rows: Rows) -> list[Run]:
    """Slides of the samples that the audit drew and that failed; those of the published rule alone are no probability
    sample."""
    screened = population(rows, "published", SAMPLES)
    if screened is None:
        return []
    refined = refined_classes(rows, "published")
    drawn = sample_weights(screened, refined, AUDIT)
    return [Run("published", "refined", sample, 1.0, "end") for sample in drawn if refined[sample]]


def slides_more_air(rows: Rows) -> list[Run]:
    """Slides that left the grid once more, on a higher one."""
    left = (run for run in slides(rows) if run in rows and rows[run].status == "OUTSIDE_GRID")
    return [replace(run, case=MORE_AIR) for run in left]


def refined_slide(rows: Rows, sample: int) -> Outcome | None:
    """The refined slide of a sample of the headline campaign, on the higher grid where it left the other; None if it
    is not there."""
    run = Run("published", "refined", sample, 1.0, "end")
    return rows.get(replace(run, case=MORE_AIR), rows.get(run))


def section(rows: Rows) -> list[Run]:
    """Every sample of the section under each reading of what the publication leaves open; on the rough grid too under
    those that random fields enter."""
    refined = [(f"section, {name}", "refined") for name in READINGS]
    rough = [(f"section, {name}", "rough") for name in ("as here", "one strength per cell")]
    default = [("section, default", grid) for grid in ("refined", "rough")]
    return [Run(case, grid, number) for case, grid in refined + rough + default for number in range(SECTION_SAMPLES)]


CELLS = (1.0, 0.75, 0.5)
"""Of Table 3 (m)."""


def of_cell(case: str, cell: float) -> str:
    """Name of a case without random field whose refined grid has these cells (m)."""
    return case if cell == 1 else f"{case}, cells of {cell:g} m"


SECTION_OF_TABLE_3 = tuple(
    of_cell(case, cell) for case in ("section of mean strength", "section of mean strength, default") for cell in CELLS
)

PIECES: Mapping[str, Callable[[Rows], list[Run]]] = {
    "fos_rough": factors("mean strength", "mean strength, rollers", grids=("rough",)),
    "section_fos": factors(*SECTION_OF_TABLE_3, grids=("refined",)),
    "section_slides": slide_at_failure(*SECTION_OF_TABLE_3),
    "section": section,
    "fos_refined": factors("mean strength", grids=("refined",)),
    "screening": screening("published", SAMPLES),
    "fos_rollers": factors("mean strength, rollers", grids=("refined",)),
    "slide": slide_at_failure("mean strength"),
    "slide_default": slide_at_failure("mean strength, default"),
    "audit": audit("published", SAMPLES, AUDIT),
    "on_cpu": on_cpu,
    "fos_default": factors("mean strength, default"),
    "screening_default": screening("default", SWEEP_SAMPLES),
    "audit_default": audit("default", SWEEP_SAMPLES, SWEEP_AUDIT),
    "screening_rollers": screening("rollers", SWEEP_SAMPLES),
    "audit_rollers": audit("rollers", SWEEP_SAMPLES, SWEEP_AUDIT),
    "sweep": sweep_screening,
    "sweep_audit": sweep_audit,
    "slides": slides,
    "slides_more_air": slides_more_air,
    "sweep_slides": sweep_slides,
    "ranked": in_rank_order("published", SAMPLES, K_T),
    "fos_default_rollers": factors("mean strength, default, rollers"),
    "table_3": factors(of_cell("mean strength", 0.75), grids=("refined",)),
    "table_3_slide": slide_at_failure(of_cell("mean strength", 0.75)),
}
"""In the order in which they are done unless asked otherwise: what tells most for its time first. Each has a file of
its own, `study_NAME.csv`."""


def missing(piece: str, rows: Rows) -> Iterator[Run]:
    """The runs that a piece wants now and that are not there yet, in its order."""
    return (run for run in PIECES[piece](rows) if run not in rows)
