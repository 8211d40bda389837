"""Factors of safety and run-outs of the slope of mean strength, and Table 3: the published study and this one."""

from __future__ import annotations

from collections.abc import Iterator

from benchmarks.study.answers import Answer, Line, hours_of
from benchmarks.study.cases import CELLS, of_cell
from benchmarks.study.rows import Rows, factor_of_safety

STEP = 0.01
"""Of the search for a factor of safety."""
PRINTED = {("", "rough"): 1.26, ("", "refined"): 1.15}
VARIANTS = ("", "rollers", "default", "default, rollers")
SECTION = "section of mean strength"
DEFAULT = "mean strength, default"


def factors(rows: Rows) -> Iterator[Line]:
    """First R that fails, both grids, and the run-out of the refined slide there."""
    for variant in VARIANTS:
        for grid in ("rough", "refined"):
            printed = PRINTED.get((variant, grid))
            yield Line(
                f"factor of safety in 3D, {grid}, {variant or 'as published'}",
                "_".join(["fos", grid, "3d", *variant.split(", ")]).rstrip("_"),
                printed,
                factor(rows, f"mean strength, {variant}".removesuffix(", "), grid),
                "" if printed is None else others(rows, grid),
            )
    cause = f"the section, at its own factor, runs out {runout(rows, SECTION).value:.2f} m"
    what, name = "run-out in 3D at that factor, refined", "runout_refined_3d"
    yield Line(f"{what} (m)", f"{name}_m", 14.17, runout(rows, "mean strength"), cause)
    section = runout(rows, f"{SECTION}, default").value
    cause = f"the section with these settings, at its own factor, runs out {section:.2f} m"
    yield Line(f"{what}, default settings (m)", f"{name}_default_m", 14.17, runout(rows, DEFAULT), cause)


def factor(rows: Rows, case: str, grid: str) -> Answer:
    """A factor of safety, agreeing with what lies one step of the search from it."""
    tried = {run: o for run, o in rows.items() if (run.case, run.grid, run.until) == (case, grid, "class")}
    value = factor_of_safety(rows, case, grid)
    assert value is not None
    return Answer(value, (value - STEP, value + STEP), f"{len(tried)} runs", hours_of(tried))


def others(rows: Rows, grid: str) -> str:
    """Factors of the same slope with other y ends and other settings."""
    cases = {
        "mean strength": "y ends fixed",
        "mean strength, rollers": "y ends on rollers",
        "mean strength, default": "default settings",
        SECTION: "section",
    }
    factors = {words: factor_of_safety(rows, case, grid) for case, words in cases.items()}
    return "measured with " + ", ".join(f"{words} {value:.2f}" for words, value in factors.items() if value is not None)


def runout(rows: Rows, case: str) -> Answer:
    """Run-out of the slide at the factor of safety, agreeing within half a cell."""
    ((run, slide),) = ((run, o) for run, o in rows.items() if run.case == case and run.until == "end")
    half = float(case.split("cells of ")[1].split()[0]) / 2 if "cells of" in case else 0.5
    assert slide.runout is not None
    words = f"one slide at R = {run.reduction:.2f}, {slide.mode}, its foremost soil {slide.runout_foremost:.2f} m"
    limits = (slide.runout - half, slide.runout + half)
    return Answer(slide.runout, limits, f"{words}; the interval is half a cell", hours_of({run: slide}))


def table_3(rows: Rows) -> Iterator[Line]:
    """The grid study: factor and run-out against the cell, in 3D as published and in the section."""
    printed = dict(zip(CELLS, (14.17, 14.52, 14.76), strict=True))
    for kind, dimension, cells in (("mean strength", "3D", CELLS[1:2]), (SECTION, "section", CELLS)):
        for cell in cells:
            case, words = of_cell(kind, cell), f"Table 3 with cells of {cell:g} m, {dimension}"
            yield Line(f"{words}: factor of safety", None, 1.15, factor(rows, case, "refined"), over_cells(rows))
            yield Line(f"{words}: run-out (m)", None, printed[cell], runout(rows, case), over_cells(rows))


def over_cells(rows: Rows) -> str:
    """How factor and run-out of the section follow the cell, with published and with default settings."""
    kinds = {
        SECTION: "published settings, whose bands of softening soil are a cell thick",
        f"{SECTION}, default": "default",
    }
    lists = {
        words: ", ".join(
            f"{factor_of_safety(rows, case, 'refined'):.2f} (runs out {runout(rows, case).value:.1f} m)"
            for case in (of_cell(kind, cell) for cell in CELLS)
        )
        for kind, words in kinds.items()
    }
    return f"the section at cells of 1, 0.75, 0.5 m, {'; '.join(f'{words}: {of}' for words, of in lists.items())}"
