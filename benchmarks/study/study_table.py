"""Rows of the study, one per run, in small CSV files that survive being cut off and never lose a row."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from typing import Any, Literal, get_args

from benchmarks.csv_rows import ENDED, REMEDY, filled, lines_of, number, row_of, whole, word
from cooperative.measure import SEVERITY
from foundation.files import write_aside
from jaxmpm import Status

Until = Literal["class", "end"]
CPU = "cpu"


@dataclass(frozen=True)
class Run:
    """One simulation. case: its name in `study_runs.CASES`. grid: "rough" or "refined". sample: number of the random
    field, 0 where the case has none. reduction: factor by which the strength is divided. until: "class" ends it once it
    has passed the failure displacement or settled, "end" lets it go on to its end."""

    case: str
    grid: str
    sample: int = 0
    reduction: float = 1.0
    until: Until = "class"


@dataclass(frozen=True)
class Outcome:
    """What a run left. status: of `jaxmpm.Status`. displacement: the largest (m), where the run ended. time: simulated
    (s). seconds: what it took, of one core's time on a CPU; on a GPU of the clock, of which runs side by side in lanes
    have their shares by their steps, and processes that share the GPU one after the other. device: "cpu", or what JAX
    calls the GPU. The rest is of a slide, as `cooperative.measure` has it, None where the run went to its class only or
    stood: runout, depth (m), volume (m3), area (m2), mode, masses, onset, onset_second (s); displacement_any,
    runout_any (m) with detached grains."""

    status: str
    displacement: float
    time: float
    steps: int
    seconds: float
    runout: float | None = None
    depth: float | None = None
    volume: float | None = None
    area: float | None = None
    mode: str | None = None
    masses: int | None = None
    onset: float | None = None
    onset_second: float | None = None
    displacement_any: float | None = None
    runout_any: float | None = None
    device: str = CPU


Rows = dict[Run, Outcome]
"""What is known of the study."""

_KINDS: dict[str, Callable[[str, str], Any]] = {"str": filled, "int": whole, "float": number}
_CELLS: dict[str, Callable[[str, str], Any]] = {
    "grid": partial(word, allowed=("rough", "refined")),
    "until": partial(word, allowed=get_args(Until)),
    "status": partial(word, allowed=ENDED),
    "mode": partial(word, allowed=SEVERITY),
    "reduction": partial(number, above=True),
}
"""How columns are read that hold less than their kind may."""
_COLUMNS = tuple(field.name for kind in (Run, Outcome) for field in fields(kind))


def read_table(path: Path, definitions: Mapping[str, Any]) -> Rows:
    """The rows of a file, none where it is not there.

    definitions: what each case is. Raises ValueError naming file and line for text that is not UTF-8, for a row that
    does not parse, that no run could have left or that stands there twice, and for a case that the file's first line
    defines otherwise. Nothing is changed.
    """
    if not path.exists():
        return {}
    lines = lines_of(path)
    try:
        head = dict(json.loads(lines[0].removeprefix("# "))["cases"])
        columns = tuple(lines[1].split(","))
    except (IndexError, KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{path}, line 1: no definitions of its cases: put back the file from before") from error
    if columns != _COLUMNS:
        raise ValueError(f"{path}, line 2: columns {', '.join(columns)}: the study has {', '.join(_COLUMNS)}")
    now = json.loads(json.dumps(dict(definitions)))
    rows: Rows = {}
    for at, line in enumerate(lines[2:], start=3):
        where = f"{path}, line {at}"
        run, outcome = _parsed(line, where)
        if run in rows:
            raise ValueError(f"{where}: {run} stands there twice: delete one of the two")
        if head.get(run.case) is None or head[run.case] != now.get(run.case):
            raise ValueError(
                f"{where}: case {run.case!r} was {head.get(run.case)} and is {now.get(run.case)} now: "
                "move the file away, or give the new case another name"
            )
        rows[run] = outcome
    return rows


def write_table(path: Path, rows: Mapping[Run, Outcome], definitions: Mapping[str, Any]) -> None:
    """All rows, written aside and renamed; the first line says what each of their cases is."""
    used = {case: definitions[case] for case in sorted({run.case for run in rows})}
    text = io.StringIO()
    text.write(f"# {json.dumps({'cases': used})}\n")
    writer = csv.DictWriter(text, _COLUMNS, lineterminator="\n")
    writer.writeheader()
    for run, outcome in rows.items():
        writer.writerow({name: _cell(value) for name, value in (vars(run) | vars(outcome)).items()})
    write_aside(path, text.getvalue().encode())


def merged(tables: Iterable[Rows]) -> Rows:
    """The rows of several tables; of a run that several have, the first stands."""
    together: Rows = {}
    for table in tables:
        together = table | together
    return together


def _cell(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    return "" if value is None else str(value)


def _parsed(line: str, where: str) -> tuple[Run, Outcome]:
    row = row_of(line, _COLUMNS, where)
    values = {
        field.name: _value(row[field.name], field.name, str(field.type), f"{where}: {field.name}")
        for kind in (Run, Outcome)
        for field in fields(kind)
    }
    run = Run(**{field.name: values.pop(field.name) for field in fields(Run)})
    outcome = Outcome(**values)
    if Status[outcome.status] <= Status.DECIDED and not (outcome.time > 0 and outcome.steps > 0):
        told = f"time = {outcome.time:g}, steps = {outcome.steps}"
        raise ValueError(f"{where}: {told} of a run that is {outcome.status}: both are above 0, {REMEDY}")
    return run, outcome


def _value(cell: str, column: str, kind: str, where: str) -> Any:
    if cell == "" and "None" in kind:
        return None
    read = _CELLS.get(column) or _KINDS[kind.removesuffix(" | None")]
    return read(cell, where)
