"""Answers of other codes, of experiments and of closed forms beside ours, with what each took.

The data stand in a folder that `--data` or JAXMPM_PUBLIC names, one folder a case; docs/notes/verification.md names
their sources. `difference` is ours over theirs less 1, unless the row has a unit. Rows that have been made stand in
out/public, and a command that was stopped goes on behind them. `--only NAMES` makes rows of the cases whose name begins
so; rows of the others are those kept on an earlier `day`, and say "not run" where none is.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator, Sequence
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

from benchmarks.measure import Refused, Report, beginning_so, stored_row
from benchmarks.public import dam_breaks, elastic, frank, granular, reliability, slopes
from benchmarks.public.rows import Row, stored, without_answer
from benchmarks.results import stored_rows

VARIABLE = "JAXMPM_PUBLIC"
"""Environment variable that names the folder of the data."""

FAMILIES: dict[str, Callable[[Path, bool], dict[str, Callable[[], list[Row]]]]] = {
    "elastic": elastic.cases,
    "reliability": reliability.cases,
    "dam breaks": dam_breaks.cases,
    "granular": granular.cases,
    "frank": frank.cases,
    "slopes": slopes.cases,
}
"""Cases by name, the cheapest families first: a function of the data's folder and of whether all is coarser."""

FIGURES = {
    "frank_travel_error_max": ("frank 10", "frank 25"),
    "mangeney_front_error": ("mangeney",),
    "bui_surface_rms": ("bui",),
    "bui_front_error": ("bui",),
    "cantilever_tip_error": ("cantilever",),
    "slopes_2d_error_max": ("homogeneous", "Kozinec"),
    "slopes_3d_error": ("nose",),
    "exact_error_max": ("cbgeo",),
    "reliability_coverage_min": ("otbenchmark",),
}
"""Of the finest rows that name them the largest difference; of a least coverage the least value. None where a case was
not run whose name begins so."""


def folder(data: Path | None) -> Path:
    """The folder of the data.

    Args:
        data: as the command line gives it; None for that of the environment.

    Raises:
        Refused: If none is given, or it is no folder.
    """
    folder = os.environ.get(VARIABLE) if data is None else str(data)
    if not folder:
        raise Refused(
            f"the data of others are not part of this project: give --data FOLDER or set {VARIABLE}; "
            "docs/notes/verification.md names their sources"
        )
    found = Path(folder)
    if not found.is_dir():
        raise Refused(f"{found} is no folder: give the one that holds one folder a case")
    return found


def rows(data: Path, quick: bool, only: Sequence[str] = ("",)) -> Iterator[Row]:
    """All rows, those of finished cases from out/public; of cases that are left out the kept ones, or one.

    Args:
        data: folder.
        quick: whether all is coarser.
        only: beginnings of the names of cases to run.

    Raises:
        Refused: If no case begins so, or a file of its data is missing.
    """
    made = {name: (make, family) for family in FAMILIES.values() for name, make in family(data, quick).items()}
    chosen, earlier = beginning_so(made, only), {} if quick else kept()
    for name, (make, family) in made.items():
        folder, file = stored(family), f"{name}{' quick' if quick else ''}"
        if name not in chosen and not (folder / f"{file}.json").is_file():
            yield from earlier.get(name, _of(name, None, [without_answer(name)]))
            continue
        print(f"{name} ...", file=sys.stderr, flush=True)
        try:
            yield from stored_row(folder, file, partial(_made, name, make))["rows"]
        except FileNotFoundError as error:
            raise Refused(
                f"{error.filename} of the case {name} is missing: docs/notes/verification.md names its source, or "
                "leave the case out by --only"
            ) from error


def kept() -> dict[str, list[Row]]:
    """The rows of the kept answer by the name of their case, without those that were not run."""
    found: dict[str, list[Row]] = {}
    for row in stored_rows("public"):
        if row["day"] is not None:
            found.setdefault(row["name"], []).append(row)
    return found


def _made(name: str, make: Callable[[], list[Row]]) -> Row:
    return {"rows": _of(name, datetime.now(UTC).date().isoformat(), make())}


def _of(name: str, day: str | None, rows: list[Row]) -> list[Row]:
    return [{"name": name, **row, "day": day} for row in rows]


def summarised(rows: list[Row]) -> Row:
    """The figures; None without rows, and where one lacks."""
    values: Row = {}
    for name, cases in FIGURES.items():
        lacks = any(row["day"] is None and row["name"].startswith(cases) for row in rows)
        counted = [row for row in rows if row["figure"] == name and row["finest"] and not lacks]
        if name.endswith("_min"):
            values[name] = min((row["ours"] for row in counted), default=None)
        else:
            values[name] = max((abs(row["difference"]) for row in counted), default=None)
    return values


def run(quick: bool, data: Path | None = None, only: Sequence[str] = ("",)) -> Report:
    """All cases, or those that begin so; `quick` on coarse cells."""
    found = list(rows(folder(data), quick, only))
    return Report(summarised(found), found)
