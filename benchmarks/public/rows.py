"""A row of the comparison: one quantity of a case, ours beside theirs."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from benchmarks.measure import ROOT, code_digest, sources

Row = dict[str, Any]


def row(
    case: str,
    quantity: str,
    ours: float,
    theirs: float,
    start: float,
    *,
    cell: float | None = None,
    figure: str | None = None,
    finest: bool = False,
    difference: float | None = None,
) -> Row:
    """One quantity.

    Args:
        case: name.
        quantity: with its unit.
        ours: value here.
        theirs: value of the source.
        start: `time.perf_counter` at the start of the run.
        cell: edge of the cells (m); None without a grid.
        figure: of the benchmark that the quantity is part of; None for none.
        finest: whether the row is of the finest cells of its case, which count for the figure.
        difference: in the unit of the quantity; None for ours over theirs less 1.
    """
    return {
        "case": case,
        "cell_m": cell,
        "quantity": quantity,
        "ours": float(f"{ours:.6g}"),
        "theirs": float(f"{theirs:.6g}"),
        "difference": float(f"{ours / theirs - 1 if difference is None else difference:.4g}"),
        "seconds": round(time.perf_counter() - start, 1),
        "figure": figure,
        "finest": finest,
    }


def without_answer(case: str, why: str = "not run") -> Row:
    """The row of a case that was left out, or that the program of others does not answer."""
    return {
        **dict.fromkeys(("case", "cell_m", "quantity", "ours", "theirs", "difference", "seconds", "figure")),
        "case": case,
        "quantity": why,
        "finest": False,
    }


def stored(family: Callable[..., object]) -> Path:
    """Folder of what a family has made, by the code that makes it: a change of another family leaves it."""
    return ROOT / "out" / "public" / code_digest(*sources(family, without_answer))
