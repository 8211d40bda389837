"""Factors of safety and run-outs of the slope of mean strength, and Table 3: the published study beside ours."""

from __future__ import annotations

from collections.abc import Iterator

from benchmarks.study.published_answers import Found, Line, hours_of
from benchmarks.study.study_pieces import CELLS, STEP, factor_of_safety, of_cell
from benchmarks.study.study_table import Rows, Run

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
    what, name = "run-out in 3D at that factor, refined, default settings (m)", "runout_refined_3d_default_m"
    cause = "not the published setting, whose bands of softening soil are as thick as a cell"
    yield Line(what, name, 14.17, slide_of(rows, "mean strength, default"), cause)


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
