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
import time
import warnings
from collections.abc import Callable, Mapping
from contextlib import closing
from functools import lru_cache
from pathlib import Path

import h5py
import numpy as np

from cooperative.names import GRIDS
from cooperative.store._database import (
    ABOUT,
    TYPES,
    Row,
    Value,
    checksum,
    columns_of,
    insert,
    refuse_damaged,
)
from cooperative.store._samples import (
    COARSE,
    SLIDES,
    Record,
    Rows,
    Sample,
    Store,
    package_versions,
    rows_of,
)
from jaxmpm.support import files, hdf5
from jaxmpm.support.files import DamagedFile
from jaxmpm.support.hdf5 import Scalar
from jaxmpm.support.text import printable, shown

FIELDS = "fields"
STORED = (COARSE, *GRIDS, SLIDES)
"""What column `grid` holds."""
OF_GRID = f"grid = ? OR grid NOT IN ({', '.join('?' * len(STORED))})"
"""Rows of a grid, and those of none, which are damaged."""
COLUMN_TYPES = {bool: "BOOLEAN", int: "INTEGER", float: "REAL", str: "TEXT"}
REQUIRED = {*ABOUT, "displacement", "broke_off"} - {"fields_sha256"}


def fields_path(folder: Path, grid: str, number: int, sha256: str) -> Path:
    """File of the fields of one run.

    Args:
        folder: of the campaign.
        grid: "coarse", "rough", "refined" or "slides".
        number: of the sample.
        sha256: of the file.
    """
    return folder / FIELDS / f"{grid}-{number:06d}-{sha256[:12]}.h5"


def restart_path(folder: str | Path, grid: str, number: int) -> Path:
    """Restart point of one sample, in the campaign's folder.

    Args:
        folder: of the campaign.
        grid: "rough" or "refined".
        number: of the sample.
    """
    return Path(folder) / "restart" / f"{grid}-{number:06d}.h5"


def write_sample(store: Store, grid: str, sample: Sample, *, longer: bool = False) -> None:
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
    columns, row = row_of(store, grid, sample)
    with store.writing() as database:
        for name in columns.keys() - columns_of(database).keys():
            database.execute(f'ALTER TABLE run ADD COLUMN "{name}" {columns[name]}')
        insert(database, row)
    if there is not None and there[0] not in (None, row["fields_sha256"]):
        fields_path(store.folder, grid, sample.number, there[0]).unlink(missing_ok=True)
    restart_path(store.folder, grid, sample.number).unlink(missing_ok=True)


def row_of(store: Store, grid: str, sample: Sample) -> tuple[dict[str, str], dict[str, Value]]:
    """The columns of a sample, and its row, whose file of fields is written.

    Raises ValueError for a scalar that is none, or of another type than its column.
    """
    measured = {name: value.item() if isinstance(value, np.generic) else value for name, value in sample.row.items()}
    with store.reading() as database:
        columns = columns_of(database)
    for name, value in measured.items():
        kind = columns.setdefault(name, COLUMN_TYPES.get(type(value), "none"))
        value = float(value) if kind == "REAL" and type(value) is int else value
        if name in ABOUT or not name.isidentifier() or COLUMN_TYPES.get(type(value)) != kind:
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
        "versions": json.dumps(dict(sample.versions or package_versions()), sort_keys=True),
        "fields_sha256": sha256,
        "coefficients": np.asarray(sample.coefficients, "<f8").tobytes(),
        # SQLite has no number for nan.
        **{name: None if isinstance(value, float) and math.isnan(value) else value for name, value in measured.items()},
    }
    return columns, row | {"sha256": checksum(store.digest, row)}


def _write_fields(store: Store, grid: str, sample: Sample) -> str:
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
    store: Store,
    grid: str,
    *,
    foreign: Callable[[Record], str | None] = lambda record: None,
    look: Callable[[], None] = lambda: None,
) -> Rows:
    """Read every finished sample of one grid.

    Columns: sample, status, steps, seconds, then the scalars of the rows. A scalar that some rows lack is nan there (""
    for text). Rows ascend by sample number. A refined run that went on to the end of its slide has the row of that end.
    Runs that cannot be trusted are named in `damaged`. The controller, who holds the lock, also deletes their rows from
    the database, once it has copied that to `*.damaged`, so that their samples are run again.

    Args:
        store: the campaign's folder.
        grid: "coarse", "rough", "refined" or "slides".
        foreign: what a whole run holds that the scene does not have; then it is damaged. None if nothing.
        look: called before each row, may raise to stop.

    Raises:
        DamagedFile: the database is damaged.
        OSError: the system refuses.
    """
    if store.connection is None:  # the controller has checked when it opened
        with store.reading() as database:
            refuse_damaged(store.path, database)
    records, bad = dict[int, Record](), dict[tuple[Value, Value], str]()
    folder = store.folder / FIELDS
    there = {path.name for path in folder.glob("*.h5")} if not folder.is_symlink() else set[str]()
    for stored in (grid, SLIDES) if grid == "refined" else (grid,):
        with store.reading() as database, closing(database.cursor()) as cursor:
            columns = columns_of(database)
            for values in cursor.execute(f"SELECT * FROM run WHERE {OF_GRID} ORDER BY sample", (stored, *STORED)):
                look()
                row = dict(zip(columns, values, strict=True))
                try:
                    record = _record(store.digest, columns, row)
                    if row["fields_sha256"] is not None:
                        path = fields_path(folder.parent, stored, record.number, str(row["fields_sha256"]))
                        if path.name not in there:
                            raise DamagedFile(f"lacks its file {path.name}")
                    if why := foreign(record):
                        raise DamagedFile(why)
                    records[record.number] = record
                except DamagedFile as error:
                    where = f"sample {shown(row['sample'])} of the {printable(str(row['grid']))} grid"
                    bad[row["grid"], row["sample"]] = f"{store.path}: {where} {error}"
    if bad and store.connection is not None:
        _delete(store, bad)
    return rows_of(list(records.values()), tuple(bad.values()))


def _delete(store: Store, bad: Mapping[tuple[Value, Value], str]) -> None:
    """Delete runs that cannot be trusted from the database, of which a copy stays."""
    aside = files.copy_aside(store.path)
    for why in bad.values():
        warnings.warn(f"{why}: set aside in {aside.name}, the sample is run again", stacklevel=3)
    with store.writing() as database:
        database.executemany("DELETE FROM run WHERE grid IS ? AND sample IS ?", bad)


def read_sample(store: Store, grid: str, number: int) -> Sample:
    """Read one sample and verify it, a refined one to the end of its slide where it has one.

    Args:
        store: the campaign's folder.
        grid: "coarse", "rough", "refined" or "slides".
        number: of the sample.

    Raises:
        DamagedFile: it cannot be trusted.
        ValueError: it has not run.
    """
    row: Row | None = None
    with store.reading() as database:
        columns = columns_of(database)
        for stored in (SLIDES, grid) if grid == "refined" else (grid,):
            values = database.execute("SELECT * FROM run WHERE grid = ? AND sample = ?", (stored, number)).fetchone()
            if values is not None:
                row = dict(zip(columns, values, strict=True))
                break
    if row is None:
        raise ValueError(f"sample {number} of the {grid} grid is not in {store.path}: give one that has run")
    try:
        record = _record(store.digest, columns, row)
        fields = {} if row["fields_sha256"] is None else _read_fields(store, stored, number, str(row["fields_sha256"]))
    except DamagedFile as error:
        raise DamagedFile(
            f"{store.path}: sample {number} of the {grid} grid {error}: `jaxmpm resume --verify` sets it aside "
            "and runs it again"
        ) from error
    return Sample(
        number=number,
        status=record.status,
        steps=record.steps,
        seconds=record.seconds,
        coefficients=np.frombuffer(row["coefficients"], "<f8"),  # type: ignore[call-overload]
        row=record.row,
        fields=fields,
        dtype=str(row["dtype"]),
        device=str(row["device"]),
        versions=record.versions,
    )


def _read_fields(store: Store, grid: str, number: int, sha256: str) -> dict[str, np.ndarray]:
    """The fields of a run; DamagedFile where their file is not as its row says."""
    path = fields_path(store.folder, grid, number, sha256)
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


def _record(digest: str, columns: Mapping[str, str], row: Row) -> Record:
    """The record in a row; DamagedFile if it cannot be trusted."""
    if row["sha256"] != checksum(digest, row):
        raise DamagedFile("does not match its checksum")
    measured: dict[str, Scalar] = {}
    for name, value in row.items():
        if value is None:
            if name in REQUIRED:
                raise DamagedFile(f"lacks {name}")
            continue
        if type(value) not in TYPES[columns[name]] or (isinstance(value, str) and not value.isprintable()):
            raise DamagedFile(f"holds {name} = {shown(value)}")
        if name not in ABOUT:
            assert not isinstance(value, bytes)
            measured[name] = bool(value) if columns[name] == "BOOLEAN" else value
    if not 0 <= float(measured["displacement"]) < math.inf:
        raise DamagedFile(f"holds a largest displacement of {measured['displacement']} m")
    blob, versions = row["coefficients"], _versions(str(row["versions"]))
    assert isinstance(blob, bytes)
    if len(blob) % 8:
        raise DamagedFile(f"holds coefficients of {len(blob)} bytes")
    return Record(
        int(row["sample"]), str(row["status"]), int(row["steps"]), float(row["seconds"]), measured,  # type: ignore
        len(blob) // 8, float(row["written"]), versions,  # type: ignore[arg-type]
    )  # fmt: skip


@lru_cache
def _versions(text: str) -> Mapping[str, str]:
    """Packages and their versions; DamagedFile for anything else."""
    try:
        versions = json.loads(text)
    except (ValueError, RecursionError):
        versions = None
    if not isinstance(versions, dict) or not all(isinstance(each, str) for each in versions.values()):
        raise DamagedFile("holds versions that are no names and texts")
    return versions
