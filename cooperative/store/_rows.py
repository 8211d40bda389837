"""The table of one grid, a row for each finished sample, and the index by which unchanged files are not read again.

`samples/rough.index` has one line for each file: a checksum, and in JSON the sample's record and the stamp of its file.
The controller adds a line once a file is written or verified. A line counts if its checksum fits and the file still has
the stamp; a file without such a line is read and verified. So an index may be lost, torn or deleted at any moment.
"""

from __future__ import annotations

import hashlib
import json
import os
import stat
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cooperative.store._samples import (
    KIND,
    SAID,
    SCHEMA,
    SLIDES,
    Record,
    Sample,
    Store,
    check_row,
    check_types,
    fill_sample,
    read_file,
    restart_path,
    sample_path,
)
from foundation import files
from foundation.files import DamagedFile, Scalar, set_aside

Stamp = tuple[int, int, int]
"""Size in bytes, time of the last change of a file's content and of its entry (ns): writing, copying, moving and
restoring a file change it."""


@dataclass(frozen=True)
class Rows:
    """The table of one grid. columns: equally long, by name. damaged: the files that could not be trusted."""

    columns: dict[str, np.ndarray]
    damaged: tuple[str, ...]

    @property
    def numbers(self) -> list[int]:
        """Numbers of the finished samples, ascending."""
        return [int(number) for number in self.columns["sample"]]

    @property
    def ended(self) -> np.ndarray:
        """Which runs came to their end, or broke off, rather than stop once their class was decided (runs,) bool."""
        return self.columns["status"] != "DECIDED"

    @property
    def results(self) -> dict[int, tuple[float, bool]]:
        """Sample -> its largest displacement (m), and whether the run broke off."""
        columns = (self.columns.get(name, np.zeros(0)) for name in ("displacement", "broke_off"))
        return {n: (float(u), bool(b)) for n, u, b in zip(self.numbers, *columns, strict=True)}


def read_rows(
    store: Store,
    grid: str,
    *,
    foreign: Callable[[str, Record], str | None] = lambda grid, record: None,
    look: Callable[[], None] = lambda: None,
) -> Rows:
    """Read every finished sample of one grid, and verify those that are not in the index; rows ascend by sample number.

    foreign: what a whole sample of a grid holds that the scene does not have; then it is damaged. None if nothing.
    look: called before each file, may raise to stop.
    A refined run that went on to the end of its slide has the row of that end.
    Columns: sample, status, steps, seconds, then the scalars of the rows. A scalar that some rows lack is
    nan there ("" for text). Files that cannot be trusted are named in `damaged`; the controller (who holds
    the lock) also renames them to `*.damaged`, so that their samples are run again.
    """
    found: dict[int, Record] = {}
    damaged: list[str] = []
    folders = [store.folder / "samples" / each for each in ((grid, SLIDES) if grid == "refined" else (grid,))]
    linked = next((each for each in (folders[0].parent, *folders) if each.is_symlink()), None)
    if linked is not None:
        return rows_of([], (f"{linked} leads out of the campaign's folder",))
    for folder in folders:
        stamps = {path.name: stamp_of(path) for path in sorted(folder.glob("*.h5"))}
        known = _read_index(store, folder.name, stamps)
        for name, stamp in stamps.items():
            look()
            path = folder / name
            try:
                record = known.get(name)
                if record is None:
                    record = read_file(store, folder.name, path).record
                    if store.lock is not None:
                        _add_to_index(store, folder.name, stamp, record)
                if why := foreign(grid, record):
                    raise DamagedFile(f"{path} {why}")
                found[record.number] = record
            except DamagedFile as error:
                damaged.append(str(error))
                if store.lock is not None:
                    warnings.warn(f"{error}: set aside, the sample is run again", stacklevel=2)
                    set_aside(path)
    return rows_of(list(found.values()), tuple(damaged))


def rows_of(samples: list[Record], damaged: tuple[str, ...] = ()) -> Rows:
    """The table of these samples."""
    samples = sorted(samples, key=lambda sample: sample.number)
    columns = {
        "sample": np.array([sample.number for sample in samples], dtype=int),
        "status": np.array([sample.status for sample in samples], dtype=str),
        "steps": np.array([sample.steps for sample in samples], dtype=int),
        "seconds": np.array([sample.seconds for sample in samples], dtype=float),
    }
    for name in sorted({name for sample in samples for name in sample.row} - columns.keys()):
        columns[name] = _column([sample.row.get(name) for sample in samples])
    return Rows(columns, damaged)


def _column(values: list[Scalar | None]) -> np.ndarray:
    if any(isinstance(value, str) for value in values):
        return np.array(["" if value is None else str(value) for value in values])
    return np.array([np.nan if value is None else value for value in values])


def write_sample(store: Store, grid: str, sample: Sample) -> Path:
    """Write one finished sample, whole or not at all, and its line in the index; its restart point is removed.

    Raises ValueError for a store opened for reading or a sample that is there already, OSError (with the
    errno of the system, for example ENOSPC) when the disk refuses; no half file is left then.
    """
    path = sample_path(store, grid, sample.number)
    if store.lock is None:
        raise ValueError(f"{store.folder} is open for reading: use open_store to write {path.name}")
    if os.path.lexists(path):
        raise ValueError(f"{path} is finished already: results are never overwritten, delete it to redo it")
    files.write_sealed(path, KIND, SCHEMA, lambda file: fill_sample(file, store, grid, sample))
    _add_to_index(store, grid, stamp_of(path), sample.record)
    restart_path(store.folder, grid, sample.number).unlink(missing_ok=True)
    return path


def stamp_of(path: Path) -> Stamp | None:
    """The stamp of a regular file, None for a link or anything else. OSError where there is nothing."""
    about = os.lstat(path)
    return (about.st_size, about.st_mtime_ns, about.st_ctime_ns) if stat.S_ISREG(about.st_mode) else None


def _read_index(store: Store, grid: str, stamps: Mapping[str, Stamp | None]) -> dict[str, Record]:
    """The records of the files that have not changed since they were verified, by file name.

    stamps: of the files that are there. The controller drops the other lines; what is no regular file it sets aside.
    """
    path = index_path(store.folder, grid)
    try:
        lines = files.read_plain(path).splitlines(keepends=True)
    except FileNotFoundError:
        return {}
    except DamagedFile as error:
        if store.lock is not None:
            warnings.warn(f"{error}: set aside as {set_aside(path)}", stacklevel=4)
        return {}
    kept: dict[str, tuple[bytes, Record]] = {}
    for line in lines:
        try:
            stamp, record = _parsed(store, grid, line)
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
            continue
        name = f"{record.number:06d}.h5"
        if stamps.get(name) == stamp:
            kept[name] = line, record
    if store.lock is not None and len(kept) != len(lines):
        files.write_aside(path, b"".join(line for line, _ in kept.values()))
    return {name: record for name, (_, record) in kept.items()}


def _add_to_index(store: Store, grid: str, stamp: Stamp | None, record: Record) -> None:
    """Add a line for a verified file. OSError where the disk refuses; the file is then verified again another time."""
    said = {"sample": record.number, "stamp": stamp, "status": record.status, "steps": record.steps,
            "seconds": record.seconds, "row": dict(record.row), "shapes": record.shapes}  # fmt: skip
    text = json.dumps(said, default=np.generic.item)
    path = index_path(store.folder, grid)
    with files.explained(path), files.append_to(path) as file:
        file.write(checked_line(store, grid, text.encode()).decode())


def index_path(folder: Path, grid: str) -> Path:
    """The index of a grid of the campaign in a folder."""
    return folder / "samples" / f"{grid}.index"


def checked_line(store: Store, grid: str, text: bytes) -> bytes:
    """A line of an index: the SHA-256 of its JSON and of the scene and grid that it is for, and the JSON."""
    checksum = hashlib.sha256(f"{KIND} {SCHEMA} {store.digest} {grid} ".encode() + text).hexdigest()
    return f"{checksum} ".encode() + text + b"\n"


def _parsed(store: Store, grid: str, line: bytes) -> tuple[Stamp, Record]:
    """The stamp and record of a line. Raises ValueError, or what reading the wrong type raises, for a line that is
    damaged or of another scene."""
    text = line.partition(b" ")[2].removesuffix(b"\n")
    if line != checked_line(store, grid, text):
        raise ValueError("it does not match its checksum")
    said, path = json.loads(text), index_path(store.folder, grid)
    row, (size, changed, entered) = said["row"], said["stamp"]
    check_types(path, said, SAID, required=("sample", "status", "steps", "seconds"))
    check_row(path, grid, said["status"], row)
    shapes = {name: tuple(map(int, shape)) for name, shape in said["shapes"].items()}
    (_,) = shapes["coefficients"]
    if not {type(value) for value in row.values()} <= {bool, int, float, str}:
        raise ValueError("its row has what is no number and no text")
    if not all(text.isprintable() for text in (said["status"], *row, *map(str, row.values()))):
        raise ValueError("it has text that cannot be printed")
    record = Record(said["sample"], said["status"], said["steps"], said["seconds"], row, shapes)
    return (size, changed, entered), record
