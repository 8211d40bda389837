"""The published study in 3D, in pieces that go on where they were stopped: `python -m benchmarks.study [PIECE ...]`.

A run is one row of a small CSV file, `study_PIECE.csv` in the folder, written as soon as the run has ended; a process
that is killed loses only the runs under way. `python -m benchmarks published` makes tables and verdicts of the files.
"""

from __future__ import annotations

import fcntl
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from functools import partial
from pathlib import Path

from benchmarks.measure import ROOT
from benchmarks.study.study_pieces import PIECES, missing
from benchmarks.study.study_runs import CASES, alike, carry_out
from benchmarks.study.study_table import CPU, Outcome, Rows, Run, merged, read_table, write_table
from cooperative.runs import process_pool

DATA = ROOT / "benchmarks" / "data"
FIGURES = ROOT / "benchmarks" / "figures"


def file_of(folder: Path, piece: str) -> Path:
    """Where the rows of a piece stand."""
    return folder / f"study_{piece}.csv"


def read_study(folder: Path) -> dict[str, Rows]:
    """The rows of every piece. ValueError naming file and line for one that does not parse."""
    return {piece: read_table(file_of(folder, piece), CASES) for piece in PIECES}


def carry_on(
    folder: Path,
    pieces: Sequence[str],
    *,
    workers: int = 1,
    lanes: int = 1,
    minutes: float = float("inf"),
    do: Callable[[Sequence[Run], int], list[Outcome]] = carry_out,
) -> None:
    """Do what is missing of the pieces, in their order; no run begins after `minutes`.

    workers: processes, each bound to its share of the cores; 1 runs in this one. lanes: runs that a process does side
    by side, which pays on a GPU; it is given up to eight times as many, whose rows are written together. ValueError for
    a piece that is none, for a file that does not parse, and where another process is at work in the folder.
    """
    unknown = [piece for piece in pieces if piece not in PIECES]
    if unknown:
        raise ValueError(f"piece {unknown[0]!r}: give some of {', '.join(PIECES)}")
    if workers < 1 or lanes < 1 or not minutes > 0:
        raise ValueError(
            f"workers = {workers}, lanes = {lanes}, minutes = {minutes:g}: give 1 or more, and minutes above 0"
        )
    end = time.monotonic() + 60 * minutes
    with _alone_in(folder), ThreadPoolExecutor(1) if workers == 1 else process_pool(workers) as crew:
        tables = read_study(folder)
        for piece in pieces:
            for found in _done(crew, workers, lanes, partial(_missing, piece, tables), end, do):
                tables[piece] |= found
                write_table(file_of(folder, piece), tables[piece], CASES)
                for run, outcome in found.items():
                    print(f"{time.strftime('%H:%M:%S')} {piece}: {in_words(run, outcome)}", flush=True)


def _missing(piece: str, tables: Mapping[str, Rows]) -> Iterator[Run]:
    return missing(piece, merged(tables.values()))


def in_words(run: Run, outcome: Outcome) -> str:
    """One line on a run that has ended."""
    return (
        f"{run.case}, {run.grid}, sample {run.sample}, R = {run.reduction:g}, to its {run.until}: {outcome.status} at "
        f"{outcome.displacement:.3g} m after {outcome.time:.2f} s, {outcome.seconds:.2f} seconds of {outcome.device}"
    )


def _done(
    crew: Executor,
    workers: int,
    lanes: int,
    wanted: Callable[[], Iterator[Run]],
    end: float,
    do: Callable[[Sequence[Run], int], list[Outcome]],
) -> Iterator[Rows]:
    """Runs as they end. What is wanted is asked anew after each, since it may depend on the answers."""
    under_way: dict[Future[list[Outcome]], tuple[Run, ...]] = {}
    while True:
        if time.monotonic() < end:
            held = {run for runs in under_way.values() for run in runs}
            waiting = [run for run in wanted() if run not in held]
            most = max(lanes, min(8 * lanes, len(waiting) // workers)) if lanes > 1 else 1
            while len(under_way) < workers and (runs := alike(waiting, most)):
                under_way[crew.submit(do, runs, lanes)] = runs
                waiting = waiting[len(runs) :]
        if not under_way:
            return
        for future in wait(under_way, return_when=FIRST_COMPLETED).done:
            yield dict(zip(under_way.pop(future), future.result(), strict=True))


@contextmanager
def _alone_in(folder: Path) -> Iterator[None]:
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / ".study.lock").open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise ValueError(f"{folder}: another process is at work here: wait, or give another folder") from error
        yield


def collect(source: Path, target: Path) -> dict[str, int]:
    """Take over the rows of another folder's files; returns how many are new, by piece. Rows that the target has stay
    as they are. ValueError for a file that does not parse, before anything is written."""
    found, known = read_study(source), read_study(target)
    new = {}
    for piece in PIECES:
        both = merged([known[piece], found[piece]])
        if added := len(both) - len(known[piece]):
            write_table(file_of(target, piece), both, CASES)
            new[piece] = added
    return new


def progress(folder: Path) -> Iterator[str]:
    """One line per piece: runs there, and runs that can be told to be missing by now."""
    tables = read_study(folder)
    everything = merged(tables.values())
    for piece, rows in tables.items():
        left = sum(1 for _ in missing(piece, everything))
        core, gpu = (
            sum(outcome.seconds for outcome in rows.values() if (outcome.device == CPU) == on_cpu) / 3600
            for on_cpu in (True, False)
        )
        yield f"{piece:20} {len(rows):5} runs, {core:6.2f} core hours, {gpu:.2f} GPU hours; {left} more wanted now"
