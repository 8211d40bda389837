"""The finished runs of a campaign: a row of its database each, and a file for the fields of those that keep them.

A file of fields is written aside and renamed before its row is committed. Its name has the number of the sample and
the beginning of its SHA-256, so that no file ever changes: `fields/refined-000123-0f3c2a9b8d71.h5`. A file that no row
names is what a process left that was killed between the two; the controller removes it.
"""

from __future__ import annotations

import hashlib
import io
import json
import math
import os
import re
import time
import warnings
from collections.abc import Callable, Mapping
from contextlib import closing
from functools import lru_cache
from pathlib import Path
from typing import Any, cast

import h5py
import numpy as np

from cooperative.names import GRIDS
from cooperative.store import _database as sql
from cooperative.store import _samples
from cooperative.store._database import Row, Value
from cooperative.store._samples import COARSE, SLIDES, FinishedRun, Rows, RunRecord, Store
from jaxmpm.support import files, hdf5
from jaxmpm.support.files import DamagedFile
from jaxmpm.support.text import printable, shown

FIELDS = "fields"
STORED = (COARSE, *GRIDS, SLIDES)
"""What column `grid` holds."""
OF_GRID = f"grid = ? OR grid NOT IN ({', '.join('?' * len(STORED))})"
"""Rows of a grid, and those of none, which are damaged."""
COLUMN_TYPES = {bool: "BOOLEAN", int: "INTEGER", float: "REAL", str: "TEXT"}
REQUIRED = {*sql.ABOUT, "displacement", "broke_off"} - {"fields_sha256"}


def stored_as(grid: str) -> tuple[str, ...]:
    """What column `grid` holds for runs of a grid; a later one stands for the one before, a slide for a refined run."""
    return (grid, SLIDES) if grid == "refined" else (grid,)


def fields_path(folder: Path, grid: str, number: int, sha256: str) -> Path:
    """File of the fields of one run.

    Args:
        folder: of the campaign.
        grid: "coarse", "rough", "refined" or "slides".
        number: of the sample.
        sha256: of the file.

    Raises:
        DamagedFile: that is no SHA-256, and might lead elsewhere.
    """
    if grid not in STORED or not re.fullmatch("[0-9a-f]{64}", sha256):
        raise DamagedFile(f"names no file of fields by {shown(sha256)}")
    return folder / FIELDS / f"{grid}-{number:06d}-{sha256[:12]}.h5"


def restart_path(folder: str | Path, grid: str, number: int) -> Path:
    """Restart point of one sample, in the campaign's folder.

    Args:
        folder: of the campaign.
        grid: "rough" or "refined".
        number: of the sample.
    """
    return Path(folder) / "restart" / f"{grid}-{number:06d}.h5"


def write_sample(store: Store, grid: str, sample: FinishedRun, *, longer: bool = False) -> None:
    """Store one finished sample, whole or not at all; its restart point is removed.

    Args:
        store: the campaign's folder.
        grid: "coarse", "rough", "refined" or "slides".
        sample: to be stored.
        longer: whether the run goes on where the one that is there ended, whose place it takes.

    Raises:
        ValueError: a store opened for reading, an unknown grid, or a sample that is there already.
        OSError: the disk refuses, with the errno of the system, for example ENOSPC; nothing of it is stored then.
    """
    if grid not in STORED:
        raise ValueError(f"grid {shown(grid)} is unknown: give one of {', '.join(GRIDS)}")
    if sample.number < 0:
        raise ValueError(f"sample number {sample.number} is negative: numbers start at 0")
    with store.reading() as database:
        there = database.execute(
            "SELECT fields_sha256 FROM run WHERE grid = ? AND sample = ?", (grid, sample.number)
        ).fetchone()
    if there is not None and not longer:
        raise ValueError(
            f"sample {sample.number} of the {grid} grid is in {store.path} already: results are never overwritten, "
            f"`sqlite3 {store.path} \"delete from run where grid = '{grid}' and sample = {sample.number}\"` redoes it"
        )
    columns, row = database_row(store, grid, sample)
    with store.writing() as database:
        there_are = sql.columns_of(database)
        for name, kind in columns.items():
            if name not in there_are:
                database.execute(f'ALTER TABLE run ADD COLUMN "{name}" {kind}')
        sql.insert(database, row)
    if there is not None and there[0] not in (None, row["fields_sha256"]):
        fields_path(store.folder, grid, sample.number, there[0]).unlink(missing_ok=True)
    restart_path(store.folder, grid, sample.number).unlink(missing_ok=True)


def database_row(store: Store, grid: str, sample: FinishedRun) -> tuple[dict[str, str], dict[str, Value]]:
    """The columns of a sample, and its row, whose file of fields is written.

    Raises ValueError for a scalar that is none, or of another type than its column.
    """
    measured = {name: value.item() if isinstance(value, np.generic) else value for name, value in sample.row.items()}
    with store.reading() as database:
        columns = sql.columns_of(database)
    for name, value in measured.items():
        kind = columns.setdefault(name, COLUMN_TYPES.get(type(value), "none"))
        value = float(value) if kind == "REAL" and type(value) is int else value
        if name in sql.ABOUT or not name.isidentifier() or COLUMN_TYPES.get(type(value)) != kind:
            raise ValueError(f"sample {sample.number} has {shown(name)} = {shown(value)}: a row has no such {kind}")
        measured[name] = value
    sha256 = _write_fields(store, grid, sample) if sample.fields else None
    row: dict[str, Value] = {
        "grid": grid,
        "sample": int(sample.number),
        "status": sample.status,
        "steps": int(sample.steps),
        "seconds": float(sample.seconds),
        "written": time.time(),
        "dtype": sample.dtype,
        "device": sample.device,
        "versions": json.dumps(dict(sample.versions or _samples.package_versions()), sort_keys=True),
        "fields_sha256": sha256,
        "coefficients": np.asarray(sample.coefficients, "<f8").tobytes(),
        # SQLite has no number for nan.
        **{name: None if isinstance(value, float) and math.isnan(value) else value for name, value in measured.items()},
    }
    return columns, row | {"sha256": sql.checksum(store.digest, row)}


def _write_fields(store: Store, grid: str, sample: FinishedRun) -> str:
    """Write the file of a sample's fields; its SHA-256."""
    # HDF5's own driver hides that a disk is full.
    image = io.BytesIO()
    with h5py.File(image, "w", libver=("v110", "v110")) as file:
        for name, values in sample.fields.items():
            file[name] = np.asarray(values)
    content = image.getbuffer()
    sha256 = hashlib.sha256(content).hexdigest()
    files.write_aside(fields_path(store.folder, grid, sample.number, sha256), content)
    return sha256


def read_rows(
    store: Store | str | Path,
    grid: str = "refined",
    *,
    foreign: Callable[[RunRecord], str | None] = lambda record: None,
    check: Callable[[], None] = lambda: None,
) -> Rows:
    """Read every finished sample of one grid.

    Columns: sample, status, steps, seconds, then the scalars of the rows. A scalar that some rows lack is nan there (""
    for text). Rows ascend by sample number. A refined run that went on to the end of its slide has the row of that end.
    Runs that cannot be trusted are named in `damaged`. The controller, who holds the lock, also deletes their rows from
    the database, once it has copied that to `*.damaged`, so that their samples are run again.

    Args:
        store: the campaign's folder, open or its path, or that of its campaign.db.
        grid: "coarse", "rough", "refined" or "slides".
        foreign: what a whole run holds that the scene does not have; then it is damaged. None if nothing.
        check: called before each row, may raise to stop.

    Raises:
        DamagedFile: the database is damaged.
        ValueError: the path leads to no campaign.
        OSError: the system refuses.

    Example:
        >>> import cooperative
        >>> rows = cooperative.read_rows("out/campaign.db")  # doctest: +SKIP
        >>> rows.columns["displacement"].max()  # doctest: +SKIP
    """
    if not isinstance(store, Store):
        from cooperative.store._opened import read_store  # which writes rows, too

        path = Path(store)
        store = read_store(path.parent if path.name == sql.DATABASE else path)
    records, bad = dict[int, RunRecord](), dict[tuple[Value, Value], str]()
    folder = store.folder / FIELDS
    there = set(os.listdir(folder)) if folder.is_dir() and not folder.is_symlink() else set[str]()

    def trusted(row: Row) -> RunRecord:
        record = _record(store.digest, columns, row)
        if (path := _file_of(store, row)) is not None and path.name not in there:
            raise DamagedFile(f"lacks its file {path.name}")
        if why := foreign(record):
            raise DamagedFile(why)
        return record

    with store.reading() as database:
        if store.connection is None:  # the controller has checked when it opened
            sql.refuse_damaged(store.path, database)
        columns = sql.columns_of(database)
        for stored in stored_as(grid):
            query = f"SELECT * FROM run WHERE {OF_GRID} ORDER BY sample"
            with closing(database.execute(query, (stored, *STORED))) as found:
                for values in found:
                    check()
                    row = dict(zip(columns, values, strict=True))
                    try:
                        record = trusted(row)
                        records[record.number] = record
                    except DamagedFile as error:
                        key = row["grid"], row["sample"]
                        bad[key] = f"{store.path}: sample {shown(key[1])} of the {printable(str(key[0]))} grid {error}"
    if bad and store.connection is not None:
        aside = files.copy_aside(store.path)
        for why in bad.values():
            warnings.warn(f"{why}: set aside in {aside.name}, the sample is run again", stacklevel=2)
        with store.writing() as database:
            database.executemany("DELETE FROM run WHERE grid IS ? AND sample IS ?", bad)
    return Rows.of(records.values(), tuple(bad.values()))


def read_sample(store: Store, grid: str, number: int) -> FinishedRun:
    """Read one sample and verify it, a refined one to the end of its slide where it has one.

    Args:
        store: the campaign's folder.
        grid: "coarse", "rough", "refined" or "slides".
        number: of the sample.

    Raises:
        DamagedFile: it cannot be trusted.
        ValueError: it has not run.
    """
    query = "SELECT * FROM run WHERE grid = ? AND sample = ?"
    with store.reading() as database:
        columns = sql.columns_of(database)
        found = (database.execute(query, (stored, number)).fetchone() for stored in reversed(stored_as(grid)))
        values = next(filter(None, found), None)
    if values is None:
        raise ValueError(f"sample {number} of the {grid} grid is not in {store.path}: give one that has run")
    row = dict(zip(columns, values, strict=True))
    try:
        record, path = _record(store.digest, columns, row), _file_of(store, row)
        fields = {} if path is None else _read_fields(path, row["fields_sha256"])
        coefficients = np.frombuffer(cast(bytes, row["coefficients"]), "<f8")
        return FinishedRun(
            number, record.status, record.steps, record.seconds, coefficients, record.row, fields,
            dtype=str(row["dtype"]), device=str(row["device"]), versions=record.versions,
        )  # fmt: skip
    except DamagedFile as error:
        where = f"{store.path}: sample {number} of the {grid} grid"
        raise DamagedFile(f"{where} {error}: `jaxmpm resume --verify` sets it aside and runs it again") from error


def _file_of(store: Store, row: Row) -> Path | None:
    """The file of the fields of a run, None where it keeps none."""
    sha256 = row["fields_sha256"]
    return (
        None if sha256 is None else fields_path(store.folder, str(row["grid"]), cast(int, row["sample"]), str(sha256))
    )


def _read_fields(path: Path, sha256: Value) -> dict[str, np.ndarray]:
    """The fields of a run; DamagedFile where their file is not as its row says."""
    try:
        data = read_fields_file(path)
    except OSError as error:
        raise DamagedFile(f"lacks its file {path.name} ({error.strerror})") from error
    if hashlib.sha256(data).hexdigest() != sha256:
        raise DamagedFile(f"has fields that do not match their checksum ({path.name})")
    with hdf5.contents(path, data) as file:
        return {name: file.array("/", name) for name in file.names("/")}


def read_fields_file(path: Path) -> bytes:
    """Bytes of a file of fields; DamagedFile where it is none, or leads out of the folder."""
    if path.parent.is_symlink():
        raise DamagedFile(f"has a file that leads out of the campaign's folder ({path.name})")
    return files.read_plain(path)


def _record(digest: str, columns: Mapping[str, str], row: Row) -> RunRecord:
    """The record in a row; DamagedFile if it cannot be trusted."""
    if row["sha256"] != sql.checksum(digest, row):
        raise DamagedFile("does not match its checksum")
    for name, value in row.items():
        if not _may_hold(name, columns[name], value):
            raise DamagedFile(f"holds {name} = {shown(value)}")
    there: dict[str, Any] = {name: value for name, value in row.items() if value is not None}
    measured = {
        name: bool(value) if columns[name] == "BOOLEAN" else value
        for name, value in there.items()
        if name not in sql.ABOUT
    }
    terms, versions = len(there["coefficients"]) // 8, _versions(there["versions"])
    number, status, steps, seconds = (there[name] for name in ("sample", "status", "steps", "seconds"))
    return RunRecord(number, status, steps, seconds, measured, terms, there["written"], versions)


def _may_hold(name: str, kind: str, value: Value) -> bool:
    """Whether a run may have this value in a column."""
    if value is None:
        return name not in REQUIRED
    if type(value) is not sql.TYPES[kind] or (isinstance(value, str) and not value.isprintable()):
        return False
    if isinstance(value, bytes):
        return len(value) % 8 == 0
    return value in STORED if name == "grid" else name != "displacement" or 0 <= float(value) < math.inf


@lru_cache
def _versions(text: str) -> Mapping[str, str]:
    """Packages and their versions; DamagedFile for anything else."""
    try:
        return {name: f"{version}" for name, version in json.loads(text).items()}
    except (ValueError, AttributeError, RecursionError) as error:
        raise DamagedFile("holds versions that are no names and texts") from error
