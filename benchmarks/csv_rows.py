"""Rows of the CSV files under benchmarks/data: what a cell may hold, and where one that holds something else stands.

where: file, line and column, as messages begin with them.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from jaxmpm import Status

ENDED = tuple(status.name for status in Status if status != Status.RUNNING)
"""What the status of a run that has ended may be."""
REMEDY = "mend or delete the line"


def lines_of(path: Path) -> list[str]:
    """Lines of a text file. ValueError naming file and line where it is not UTF-8."""
    text = path.read_bytes()
    try:
        return text.decode().splitlines()
    except UnicodeDecodeError as error:
        line = text.count(b"\n", 0, error.start) + 1
        raise ValueError(f"{path}, line {line}: byte {error.start} is no UTF-8: {REMEDY}") from error


def rows_of(path: Path, columns: Sequence[str]) -> Iterator[tuple[str, dict[str, str]]]:
    """File and line, and the row there, of a file whose first line names its columns. ValueError where it names others,
    and as `lines_of` and `row_of`."""
    head, *lines = lines_of(path) or [""]
    if head != ",".join(columns):
        raise ValueError(f"{path.name}, line 1: columns {head}: they are {','.join(columns)}, put back the file")
    for at, line in enumerate(lines, start=2):
        where = f"{path.name}, line {at}"
        yield where, row_of(line, columns, where)


def row_of(line: str, columns: Sequence[str], where: str) -> dict[str, str]:
    """Cells of a line by column. ValueError for another number of them."""
    try:
        cells = next(csv.reader([line]), [])
    except csv.Error as error:
        raise ValueError(f"{where}: {error}: {REMEDY}") from error
    if len(cells) != len(columns):
        raise ValueError(f"{where}: {len(cells)} cells instead of {len(columns)}: {REMEDY}")
    return dict(zip(columns, cells, strict=True))


def word(cell: str, where: str, *, allowed: Collection[str]) -> str:
    """A cell that holds one of a few words, `""` among them where it may be empty."""
    if cell not in allowed:
        raise ValueError(f"{where} = {cell!r} is none of {', '.join(each or 'nothing' for each in allowed)}: {REMEDY}")
    return cell


def filled(cell: str, where: str) -> str:
    """A cell that holds anything but nothing."""
    if not cell:
        raise ValueError(f"{where} is empty: {REMEDY}")
    return cell


def number(cell: str, where: str, *, least: float = 0.0, above: bool = False) -> float:
    """A cell that holds a finite number, at least `least`, or more than that."""
    try:
        value = float(cell)
    except ValueError as error:
        raise ValueError(f"{where} = {cell!r} is no number: {REMEDY}") from error
    if not np.isfinite(value):
        raise ValueError(f"{where} = {cell!r} is not finite: {REMEDY}")
    if value < least or (above and value == least):
        raise ValueError(f"{where} = {cell!r} is not {'above' if above else 'at least'} {least:g}: {REMEDY}")
    return value


def whole(cell: str, where: str) -> int:
    """A cell that holds a whole number, 0 or more."""
    if not (cell.isascii() and cell.isdecimal()):
        raise ValueError(f"{where} = {cell!r} is no whole number of 0 or more: {REMEDY}")
    return int(cell)


def put_once(rows: dict[int, Any], number: int, row: Any, where: str) -> None:
    """Put a row under the number of its sample. ValueError where that has one."""
    if number in rows:
        raise ValueError(f"{where}: its run stands there twice: delete one of the two")
    rows[number] = row


@contextmanager
def appending(path: Path, columns: Sequence[str]) -> Iterator[Callable[[Sequence[object]], None]]:
    """Gives what writes a row to the end of the file at once."""
    new = not path.exists()
    with path.open("a", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")

        def put(row: Sequence[object]) -> None:
            writer.writerow(row)
            file.flush()

        if new:
            put(columns)
        yield put
