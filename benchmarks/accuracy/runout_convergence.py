"""Run-out, travel and deposit of slides against the cell: error against seconds.

Each slide runs on cells that are halved. `front_m` is the run-out, where the deposit is as thick as a tenth of the
slope's height, of sand as 5 % of the column's; `foremost_m` is that of the foremost soil that hangs together with the
slide, `front_95_m` that of 95 % of the soil that slid, all from the toe or the edge of a column. `travel_m` is the
displacement of the centre of the soil that slid.
`profile` is the area between the deposit's thickness and that on the finest cells, over the area that slid. Of each
case, `last_two_halvings` is the largest change of both run-outs in the last two halvings, over the finest one, and
`default_error` their error on the cell that a scene would have.
Finished rows stay in out/runout_convergence, and the next command goes on from there. A command that was stopped counts
the cells that have a row, those of a case up to the first that has none; `rows_missing` counts the others.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import TABLEAU_COLORS

from benchmarks.accuracy.runout_slides import (
    LONG_TOE,
    SLIDES,
    STATION,
    Row,
    Tables,
    clay_dam,
    half_slope,
    of_scene,
    retrogression,
    sand,
    terrain,
)
from benchmarks.measure import ROOT, Report, code_digest, sources, stored_row
from cooperative.reporting import panels, save
from jaxmpm.laws import DruckerPrager


@dataclass(frozen=True)
class Case:
    """A slide. cells: halved (m). default: the one that a scene would have. run: the row on cells of a size. obstacle:
    what is known to forbid convergence."""

    cells: tuple[float, ...]
    default: float
    run: Callable[[float], Row]
    obstacle: str | None = None


SHORTER: Tables = {"ground": {"surface": [[0, 5], [20, 5], [25, 0], [105, 0]]}}
"""Ground on which float32 resolves the finest particles."""

IN_SAND = (1 / 16, 1 / 32, 1 / 64, 1 / 128, 1 / 256)
"""Cells of the columns of sand. The front, 5 % of the height, is three cells thick on 1/64 in the lower one."""
BLOCKS = "whether one block more lets go moves the front by metres, and rounding decides it"
ROUNDING = "whose front of 95 % counts a film a grain thick, and which rounding moves by as much as the last halving"
BANDS = "bands 2.4 m thick take cells of 0.5 m, as in the section; the next halving in 3D takes a core a day"
CASES = {
    "section_1.2": Case(
        (2, 1, 0.5, 0.25, 0.125), 1.0, lambda c: of_scene("section", c, reduction=1.2, changes=LONG_TOE).row()
    ),
    "section_1.4": Case(
        (2, 1, 0.5, 0.25), 1.0, lambda c: of_scene("section", c, reduction=1.4, changes=LONG_TOE).row()
    ),
    "sand_1": Case(IN_SAND, 1 / 32, partial(sand, 1.0)),
    "sand_2": Case(IN_SAND[:-1], 1 / 32, partial(sand, 2.0), ROUNDING),
    "sand_2_start_1": Case(IN_SAND[1:-1], 1 / 32, partial(sand, 2.0, start=1), ROUNDING),
    "sand_2_start_2": Case(IN_SAND[1:-1], 1 / 32, partial(sand, 2.0, start=2), ROUNDING),
    "sand_1_cone": Case(IN_SAND, 1 / 32, partial(sand, 1.0, criterion=DruckerPrager)),
    "sand_2_cone": Case(IN_SAND[:-1], 1 / 32, partial(sand, 2.0, criterion=DruckerPrager)),
    "clay_dam": Case((1, 0.5, 0.25, 0.125), 0.5, lambda c: clay_dam(c).row()),
    "retrogression": Case(
        (1, 0.5, 0.25, 0.125), 0.25, lambda c: of_scene("sites/retrogression_5m", c, changes=SHORTER).row(), BLOCKS
    ),
    "retrogression_buoyant": Case((1, 0.5, 0.25, 0.125), 0.25, retrogression, BLOCKS),
    "terrain": Case((24, 12, 6, 3), 12.0, terrain),
    # On cells of 4 m, three over its height, it stands.
    "slope_3d_1.2": Case((2, 1, 0.5), 2.0, lambda c: half_slope(c).row(), BANDS),
}
RUN_OUTS = ("front_m", "front_95_m")
COLOURS = (*TABLEAU_COLORS, "black")


def timed(case: Case, cell: float) -> Row:
    """A row with its seconds, compilation included."""
    start = time.perf_counter()
    return {"cell_m": cell} | case.run(cell) | {"seconds": round(time.perf_counter() - start, 1)}


def compared(rows: list[Row], case: Case) -> dict[str, float]:
    """Changes of run-outs in the last two halvings, and their error on the default cell, over the finest; none of a
    slope that stands there."""
    finest = rows[-1]
    names = [name for name in RUN_OUTS if finest.get(name)]
    if not names:
        return {}
    steps = list(zip(rows[-3:-1], rows[-2:], strict=True))
    default = next(row for row in rows if row["cell_m"] == case.default)
    return {
        "last_two_halvings": max(abs(b[n] - a[n]) / abs(finest[n]) for a, b in steps for n in names),
        "default_error": max(abs(default[n] / finest[n] - 1) for n in names),
    }


def with_profiles(rows: list[Row]) -> list[Row]:
    """The rows with `profile` in place of thicknesses."""
    if not rows or "thickness" not in rows[-1]:
        return rows
    finest, answer = np.array(rows[-1]["thickness"]), []
    for row in rows:
        thickness = np.array(row["thickness"])
        both = [
            np.pad(profile, (0, max(thickness.size, finest.size) - profile.size)) for profile in (thickness, finest)
        ]
        apart = float(np.abs(both[0] - both[1]).sum() * STATION / 2 / rows[-1]["slid"])
        answer.append({k: v for k, v in row.items() if k != "thickness"} | {"profile": round(apart, 4)})
    return answer


def rows_of(name: str, case: Case, stopped: bool) -> tuple[list[Row], bool]:
    """The rows of a case, from earlier commands or made now, and whether the command is stopped.

    Args:
        name: of the case.
        case: whose rows.
        stopped: make none, and take those before the first that is missing.
    """
    folder = ROOT / "out" / "runout_convergence" / code_digest(*sources(rows_of, *SLIDES))
    rows: list[Row] = []
    for cell in case.cells:
        row = f"{name} {cell:g}"
        if stopped and not (folder / f"{row}.json").is_file():
            break
        try:
            rows.append(stored_row(folder, row, partial(timed, case, cell)))
        except KeyboardInterrupt:
            print(f"stopped in {row}: the same command goes on", file=sys.stderr)
            stopped = True
            break
    return rows, stopped


def draw(rows: list[Row], folder: Path) -> None:
    """Error of the run-out against the cell, over the default one, and against seconds; a line per case.

    The error is the larger of both run-outs, over the finest cells. Sand that starts with noise has no line.
    """
    figure, (left, right) = panels(1, 2, size=(4.6, 3.4))
    of_case = {name: [row for row in rows if row["case"] == name] for name in CASES if "start_" not in name}
    for number, (name, case_rows) in enumerate(of_case.items()):
        if not case_rows:
            continue
        names = [quantity for quantity in RUN_OUTS if quantity in case_rows[-1]]
        error = [max(abs(row[quantity] / case_rows[-1][quantity] - 1) for quantity in names) for row in case_rows[:-1]]
        style = {"marker": "os^Dv*"[number % 6], "color": COLOURS[number], "label": name, "ms": 4}
        if CASES[name].obstacle is not None:
            style |= {"linestyle": ":"}
        left.loglog([row["cell_m"] / CASES[name].default for row in case_rows[:-1]], error, **style)
        right.loglog([row["seconds"] for row in case_rows[:-1]], error, **style)
    left.set_xscale("log", base=2)
    left.set(xlabel="cell / default cell", ylabel="error of the run-out")
    right.set(xlabel="seconds")
    for axis in (left, right):
        axis.axhline(0.05, color="0.7", lw=0.8)
    figure.legend(*left.get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False)
    save(figure, folder / "runout_convergence.png", dpi=90)


def run(quick: bool) -> Report:
    """All cases; `quick` the first three cells of the columns of sand, four times as large."""
    cases = CASES
    if quick:
        sands = {name: case for name, case in CASES.items() if "sand" in name and "start" not in name}
        coarse = {name: tuple(4 * cell for cell in case.cells[:3]) for name, case in sands.items()}
        cases = {name: replace(CASES[name], cells=cells, default=cells[1]) for name, cells in coarse.items()}
    values: dict[str, Any] = {"rows_missing": 0}
    table: list[Row] = []
    stopped = False
    for name, case in cases.items():
        if quick:
            rows = [timed(case, cell) for cell in case.cells]
        else:
            rows, stopped = rows_of(name, case, stopped)
        values["rows_missing"] += len(case.cells) - len(rows)
        if len(rows) > 2 and case.default in [row["cell_m"] for row in rows]:
            values |= {f"{name}_{key}": round(value, 4) for key, value in compared(rows, case).items()}
        table += [{"case": name} | row for row in with_profiles(rows)]
    free = [name for name, case in CASES.items() if case.obstacle is None and f"{name}_default_error" in values]
    for key, named in (("last_two_halvings", "last_two_halvings_max"), ("default_error", "default_cell_error_max")):
        values[named] = max((values[f"{name}_{key}"] for name in free), default=None)
    return Report(values, table, None if quick else partial(draw, table))
