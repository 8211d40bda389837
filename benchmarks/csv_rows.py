"""Rows of the CSV files under benchmarks/data, read by a parser for each column."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from jaxmpm import Status

Parser = Callable[[str], Any]
Row = dict[str, Any]
ENDED = tuple(status.name for status in Status if status != Status.RUNNING)
"""What the status of a run that has ended may be."""


def read_rows(
    path: Path, columns: Mapping[str, Parser], key: Sequence[str], comments: int = 0
) -> dict[tuple[Any, ...], Row]:
    """Rows of a file by the values of their key; none where there is no file.

    Args:
        path: of the file.
        columns: parser of each column, which raises ValueError for what the column may not hold.
        key: columns whose values occur together once.
        comments: lines before the one that names the columns.

    Raises:
        ValueError: naming file and line, for other columns and for a row that does not parse or occurs twice.
    """
    rows: dict[tuple[Any, ...], Row] = {}
    if not path.exists():
        return rows
    names, *lines = csv.reader(path.read_text().splitlines()[comments:])
    if names != list(columns):
        raise ValueError(f"{path.name}: columns {','.join(names)}: they are {','.join(columns)}, put back the file")
    for at, cells in enumerate(lines, start=comments + 2):
        where = f"{path.name}, line {at}"
        if len(cells) != len(columns):
            raise ValueError(f"{where}: {len(cells)} cells instead of {len(columns)}: mend or delete the line")
        row = {}
        for (name, parse), cell in zip(columns.items(), cells, strict=True):
            try:
                row[name] = parse(cell)
            except ValueError as error:
                raise ValueError(f"{where}: {name} = {cell!r}: {error}: mend or delete the line") from error
        row_key = tuple(row[name] for name in key)
        if row_key in rows:
            raise ValueError(f"{where}: its run stands there twice: delete one of the two")
        rows[row_key] = row
    return rows


def head(path: Path) -> dict[str, Any]:
    """What the first line of a file, a comment, holds as JSON."""
    with path.open() as file:
        values: dict[str, Any] = json.loads(file.readline().removeprefix("# "))
    return values


def text(cell: str) -> str:
    """A cell that is not empty."""
    if not cell:
        raise ValueError("give a text")
    return cell


def word(*allowed: str) -> Parser:
    """Of a cell that holds one of a few words."""

    def parse(cell: str) -> str:
        if cell not in allowed:
            raise ValueError(f"give one of {', '.join(allowed)}")
        return cell

    return parse


def number(cell: str) -> float:
    """A cell that holds a finite number."""
    value = float(cell)
    if not np.isfinite(value):
        raise ValueError("give a finite number")
    return value


def size(cell: str) -> float:
    """A cell that holds a finite number of 0 or more."""
    value = number(cell)
    if value < 0:
        raise ValueError("give 0 or more")
    return value


def whole(cell: str) -> int:
    """A cell that holds a whole number of 0 or more."""
    if not (cell.isascii() and cell.isdecimal()):
        raise ValueError("give a whole number of 0 or more")
    return int(cell)


def optional(parse: Parser) -> Parser:
    """Of a cell that may be empty, which is None."""
    return lambda cell: parse(cell) if cell else None


@contextmanager
def appending(path: Path, columns: Iterable[str]) -> Iterator[Callable[[Sequence[object]], None]]:
    """Gives what writes a row to the end of the file at once."""
    new = not path.exists()
    with path.open("a", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")

        def put(row: Sequence[object]) -> None:
            writer.writerow(row)
            file.flush()

        if new:
            put(list(columns))
        yield put
