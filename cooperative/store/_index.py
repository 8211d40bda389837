"""The index of a folder of samples: the rows of files that were verified, so that unchanged files are not read again.

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
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from cooperative.store._folder import Store
from cooperative.store._reading import SAID, check_row, check_types
from cooperative.store._samples import KIND, SCHEMA, Record
from foundation import files
from foundation.files import DamagedFile

Stamp = tuple[int, int, int]
"""Size in bytes, time of the last change of a file's content and of its entry (ns): writing, copying, moving and
restoring a file change it."""


def stamp_of(path: Path) -> Stamp | None:
    """The stamp of a regular file, None for a link or anything else. OSError where there is nothing."""
    about = os.lstat(path)
    return (about.st_size, about.st_mtime_ns, about.st_ctime_ns) if stat.S_ISREG(about.st_mode) else None


def read_index(store: Store, grid: str, stamps: Mapping[str, Stamp | None]) -> dict[str, Record]:
    """The records of the files that have not changed since they were verified, by file name.

    stamps: of the files that are there. The controller drops the other lines; what is no regular file it sets aside.
    """
    path = _path(store, grid)
    try:
        lines = files.read_plain(path).splitlines(keepends=True)
    except FileNotFoundError:
        return {}
    except DamagedFile as error:
        if store.lock is not None:
            warnings.warn(f"{error}: set aside as {files.set_aside(path)}", stacklevel=4)
        return {}
    kept: dict[str, tuple[bytes, Record]] = {}
    for line in lines:
        name, stamp, record = _parsed(store, grid, line)
        if record is not None and stamp is not None and stamps.get(name) == stamp:
            kept[name] = line, record
    if store.lock is not None and len(kept) != len(lines):
        files.write_aside(path, b"".join(line for line, _ in kept.values()))
    return {name: record for name, (_, record) in kept.items()}


def add_to_index(store: Store, grid: str, stamp: Stamp | None, record: Record) -> None:
    """Add a line for a verified file. OSError where the disk refuses; the file is then verified again another time."""
    row = {key: value.item() if isinstance(value, np.generic) else value for key, value in record.row.items()}
    said = {"sample": record.number, "stamp": stamp, "status": record.status, "steps": record.steps,
            "seconds": record.seconds, "row": row, "shapes": record.shapes}  # fmt: skip
    text = json.dumps(said).encode()
    path = _path(store, grid)
    with files.explained(path), files.append_to(path) as file:
        file.write(f"{_checksum(store, grid, text)} {text.decode()}\n")


def drop_indices(folder: Path) -> None:
    """Have every file of the campaign in a folder read and verified anew."""
    for path in (folder / "samples").glob("*.index"):
        if not path.is_dir():  # such a one is set aside when it is read
            path.unlink()


def _path(store: Store, grid: str) -> Path:
    return store.folder / "samples" / f"{grid}.index"


def _checksum(store: Store, grid: str, text: bytes) -> str:
    """SHA-256 of a line's JSON and of the scene and grid that it is for."""
    return hashlib.sha256(f"{KIND} {SCHEMA} {store.digest} {grid} ".encode() + text).hexdigest()


def _parsed(store: Store, grid: str, line: bytes) -> tuple[str, Stamp | None, Record | None]:
    """A file's name, stamp and record; no record where the line is damaged or of another scene."""
    nothing, path = ("", None, None), _path(store, grid)
    checksum, _, text = line.removesuffix(b"\n").partition(b" ")
    if not line.endswith(b"\n") or checksum != _checksum(store, grid, text).encode():
        return nothing
    try:
        said = json.loads(text)
        check_types(path, said, SAID, required=("sample", "status", "steps", "seconds"))
        check_row(path, grid, said["status"], said["row"])
        shapes = {name: tuple(int(size) for size in shape) for name, shape in said["shapes"].items()}
        record = Record(said["sample"], said["status"], said["steps"], said["seconds"], said["row"], shapes)
        (size, changed, entered), (_,) = said["stamp"], shapes["coefficients"]
        texts = [record.status, *record.row, *(value for value in record.row.values() if isinstance(value, str))]
        plain = {type(value) for value in record.row.values()} <= {bool, int, float, str}
        if not plain or not all(text.isprintable() for text in texts):
            return nothing
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError):
        return nothing
    return f"{record.number:06d}.h5", (size, changed, entered), record
