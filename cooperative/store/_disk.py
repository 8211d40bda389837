"""The files of samples: where they lie, how they are written and read, and the index that spares reading them again.

A file is read as if a stranger had written it: whatever is not as it should be is named and not trusted.
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
from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import ArrayLike

from cooperative.names import GRIDS
from cooperative.store._opened import package_versions
from cooperative.store._samples import COARSE, SLIDES, AnotherScene, Record, Rows, Sample, Store, rows_of
from jaxmpm.support import files, hdf5
from jaxmpm.support.files import DamagedFile, set_aside
from jaxmpm.support.hdf5 import Scalar
from jaxmpm.support.text import shown

KIND = "cooperative sample"
SCHEMA = 1

Stamp = tuple[int, int, int]
"""Size in bytes, time of the last change of a file's content and of its entry (ns): writing, copying, moving and
restoring a file change it."""

MOST_INDEX = 2**28
"""Largest size (bytes) of the index of a grid's samples."""

NUMBER, FLAG, TEXT = (float, int), (bool,), (str,)
ATTRIBUTES = {"schema": (int,), "scene": TEXT, "grid": TEXT, "sample": (int,), "status": TEXT, "steps": (int,),
        "seconds": NUMBER, "dtype": TEXT, "device": TEXT, "versions": TEXT}  # fmt: skip
"""Attributes of every sample's file, and the types that they may have."""

MEASURED = dict.fromkeys(("depth", "runout", "volume", "area"), NUMBER)
ROW = {"displacement": NUMBER, "broke_off": FLAG, **MEASURED, "mode": TEXT, "masses": (int,)} | dict.fromkeys(
    ("depth_shallowest", "depth_deepest", "onset", "onset_second"), NUMBER
)
"""Types of the scalars that estimators and reports read; a row may have others, numbers or texts."""


def sample_path(store: Store, grid: str, number: int) -> Path:
    """File of one sample.

    Args:
        store: the campaign's folder.
        grid: "rough" or "refined".
        number: of the sample.

    Raises:
        ValueError: an unknown grid or a negative number.
    """
    if grid not in (COARSE, *GRIDS, SLIDES):
        raise ValueError(f"grid {shown(grid)} is unknown: give one of {', '.join(GRIDS)}")
    if number < 0:
        raise ValueError(f"sample number {number} is negative: numbers start at 0")
    return store.folder / "samples" / grid / f"{number:06d}.h5"


def restart_path(folder: str | Path, grid: str, number: int) -> Path:
    """Restart point of one sample, in the campaign's folder.

    Args:
        folder: of the campaign.
        grid: "rough" or "refined".
        number: of the sample.
    """
    return Path(folder) / "restart" / f"{grid}-{number:06d}.h5"


def write_sample(store: Store, grid: str, sample: Sample, *, longer: bool = False) -> Path:
    """Write one finished sample, whole or not at all, and its line in the index; its restart point is removed.

    Args:
        store: the campaign's folder.
        grid: "rough" or "refined".
        sample: to be written.
        longer: whether the run goes on where the one that is there ended, whose place it takes.

    Raises:
        ValueError: a store opened for reading, or a sample that is there already.
        OSError: the disk refuses, with the errno of the system, for example ENOSPC; no half file is left then.
    """
    sample = replace(sample, versions=sample.versions or package_versions())
    path = sample_path(store, grid, sample.number)
    if store.lock is None:
        raise ValueError(f"{store.folder} is open for reading: use open_store to write {path.name}")
    if os.path.lexists(path) and not longer:
        raise ValueError(f"{path} is finished already: results are never overwritten, delete it to redo it")
    hdf5.write_sealed(path, KIND, SCHEMA, lambda file: _fill(file, store, grid, sample))
    _add_to_index(store, grid, stamp_of(path), sample.record)
    restart_path(store.folder, grid, sample.number).unlink(missing_ok=True)
    return path


def _fill(group: h5py.Group, store: Store, grid: str, sample: Sample) -> None:
    """Write a sample into an empty group."""
    group.attrs.update(
        schema=SCHEMA,
        scene=store.digest,
        grid=grid,
        sample=sample.number,
        status=sample.status,
        steps=sample.steps,
        seconds=float(sample.seconds),
        dtype=sample.dtype,
        device=sample.device,
        versions=json.dumps(dict(sample.versions or package_versions()), sort_keys=True),
    )
    group["coefficients"] = np.asarray(sample.coefficients)
    group.create_group("row").attrs.update(sample.row)
    fields = group.create_group("fields")
    for name, values in sample.fields.items():
        fields[name] = np.asarray(values)


def read_rows(
    store: Store,
    grid: str,
    *,
    foreign: Callable[[str, Record], str | None] = lambda grid, record: None,
    look: Callable[[], None] = lambda: None,
) -> Rows:
    """Read every finished sample of one grid, and verify those that are not in the index.

    Columns: sample, status, steps, seconds, then the scalars of the rows. A scalar that some rows lack is nan there (""
    for text). Rows ascend by sample number. A refined run that went on to the end of its slide has the row of that end.
    Files that cannot be trusted are named in `damaged`; the controller (who holds the lock) also renames them to
    `*.damaged`, so that their samples are run again.

    Args:
        store: the campaign's folder.
        grid: "rough" or "refined".
        foreign: what a whole sample of a grid holds that the scene does not have; then it is damaged. None if nothing.
        look: called before each file, may raise to stop.

    Raises:
        ValueError: files of another scene and none of this one, as after its scene.toml was edited.
    """
    records, bad = dict[int, Record](), dict[Path, DamagedFile]()
    damaged: list[str] = []
    samples = store.folder / "samples"
    folders = [samples / each for each in ((grid, SLIDES) if grid == "refined" else (grid,))]
    linked = next((each for each in (samples, *folders) if each.is_symlink()), None)
    if linked is not None:
        folders, damaged = [], [f"{linked} leads out of the campaign's folder"]
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
                records[record.number] = record
            except DamagedFile as error:
                bad[path] = error
    if bad and not records and all(isinstance(each, AnotherScene) for each in bad.values()):
        raise ValueError(
            f"{store.folder} holds {len(bad)} samples of another scene, and none of this one: put back the scene.toml "
            "with which it began, or give another folder"
        )
    for path, why_bad in bad.items():
        damaged.append(str(why_bad))
        if store.lock is not None:
            warnings.warn(f"{why_bad}: set aside, the sample is run again", stacklevel=2)
            set_aside(path)
    return rows_of(list(records.values()), tuple(damaged))


def read_sample(store: Store, grid: str, number: int) -> Sample:
    """Read one sample and verify it, a refined one to the end of its slide where it has one.

    Args:
        store: the campaign's folder.
        grid: "rough" or "refined".
        number: of the sample.

    Raises:
        DamagedFile: it cannot be trusted.
        FileNotFoundError: it is not there.
    """
    if grid == "refined" and sample_path(store, SLIDES, number).exists():
        grid = SLIDES
    try:
        return read_file(store, grid, sample_path(store, grid, number))
    except DamagedFile as error:
        raise DamagedFile(f"{error}: `jaxmpm resume --verify` sets it aside and runs its sample again") from error


def read_file(store: Store, grid: str, path: Path) -> Sample:
    """The sample in one file of this grid; DamagedFile if it cannot be trusted."""
    with hdf5.read_sealed(path, KIND, SCHEMA) as file:
        attributes, row = file.scalars("/"), file.scalars("row")
        _check_types(path, attributes, ATTRIBUTES, required=ATTRIBUTES)
        if attributes["scene"] != store.digest:
            raise AnotherScene(f"{path} belongs to another scene")
        if (attributes["grid"], f"{attributes['sample']:06d}.h5") != (grid, path.name):
            raise DamagedFile(f"{path} holds sample {attributes['sample']} of grid {attributes['grid']}")
        _check_row(path, grid, str(attributes["status"]), row)
        fields = {name: file.array("fields", name) for name in file.names("fields")}
        check_frames(path, fields, fields.get("displacement", np.empty(0)).shape)
        versions = json.loads(str(attributes["versions"]))
        if not isinstance(versions, dict) or not all(isinstance(value, str) for value in versions.values()):
            raise DamagedFile(f"{path} holds versions that are no names and texts")
        return Sample(
            number=int(attributes["sample"]),
            status=str(attributes["status"]),
            steps=int(attributes["steps"]),
            seconds=float(attributes["seconds"]),
            coefficients=file.array("/", "coefficients", dimensions=1, kinds="f"),
            row=row,
            fields=fields,
            dtype=str(attributes["dtype"]),
            device=str(attributes["device"]),
            versions=versions,
        )


def _check_row(path: Path, grid: str, status: str, row: Mapping[str, Scalar]) -> None:
    """DamagedFile for a row that lacks what estimators and reports read, or has it of another type."""
    _check_types(path, row, ROW, required=("displacement", "broke_off"))
    # A refined run that ended once it had failed slid no farther than that.
    cut_short = row["broke_off"] or (grid == "refined" and status == "DECIDED")
    _check_types(path, row, ROW, required=() if cut_short else MEASURED)
    if not 0 <= float(row["displacement"]) < float("inf"):
        raise DamagedFile(f"{path} holds a largest displacement of {row['displacement']} m")


def check_frames(path: Path, fields: Mapping[str, ArrayLike], shape: tuple[int, ...]) -> None:
    """DamagedFile for frames that are not (T, *shape), or whose times (T,) do not ascend.

    None at all will do.

    Args:
        path: of the file.
        fields: with or without frames.
        shape: of a displacement.
    """
    if "frames" not in fields and "frame_times" not in fields:
        return
    frames, times = (np.asarray(fields.get(name)) for name in ("frames", "frame_times"))
    numbers = frames.dtype.kind == times.dtype.kind == "f"
    if not (numbers and times.ndim == 1 and frames.shape == (times.size, *shape) and (np.diff(times) > 0).all()):
        raise DamagedFile(
            f"{path} holds frames of shape {frames.shape} for {times.size} times: times ascend, and each has one "
            f"displacement of shape {shape}"
        )


def _check_types(
    path: Path, values: Mapping[str, Scalar], known: Mapping[str, tuple[type, ...]], required: Collection[str] = ()
) -> None:
    """DamagedFile for a value of another type than is known of it, or one that is missing."""
    for name, types in known.items():
        if name not in values and name in required:
            raise DamagedFile(f"{path} lacks {name}")
        if name in values and type(values[name]) not in types:
            raise DamagedFile(f"{path} holds {shown(name)} = {shown(values[name])}")


def stamp_of(path: Path) -> Stamp | None:
    """The stamp of a regular file, None for a link or anything else; OSError where there is nothing."""
    about = os.lstat(path)
    return (about.st_size, about.st_mtime_ns, about.st_ctime_ns) if stat.S_ISREG(about.st_mode) else None


def _read_index(store: Store, grid: str, stamps: Mapping[str, Stamp | None]) -> dict[str, Record]:
    """The records of the files that have not changed since they were verified, by file name.

    stamps: of the files that are there. The controller drops the other lines; what is no regular file it sets aside.
    """
    path = index_path(store.folder, grid)
    try:
        lines = files.read_plain(path, MOST_INDEX).splitlines(keepends=True)
    except FileNotFoundError:
        return {}
    except DamagedFile as error:
        if store.lock is not None:
            warnings.warn(f"{error}: set aside as {set_aside(path)}", stacklevel=4)
        return {}
    valid: dict[str, tuple[bytes, Record]] = {}
    for line in lines:
        try:
            stamp, record = _parsed(store, grid, line)
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
            continue
        name = f"{record.number:06d}.h5"
        if stamps.get(name) == stamp:
            valid[name] = line, record
    if store.lock is not None and len(valid) != len(lines):
        files.write_aside(path, b"".join(line for line, _ in valid.values()))
    return {name: record for name, (_, record) in valid.items()}


def _add_to_index(store: Store, grid: str, stamp: Stamp | None, record: Record) -> None:
    """Add a line for a verified file; where the disk refuses (OSError) the file is verified again another time."""
    entry = {"sample": record.number, "stamp": stamp, "status": record.status, "steps": record.steps,
            "seconds": record.seconds, "row": dict(record.row), "shapes": record.shapes,
             "packages": dict(record.versions)}  # fmt: skip
    text = json.dumps(entry, default=np.generic.item)
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
    """The stamp and record of a line; ValueError, or what a wrong type raises, for a damaged or foreign one."""
    text = line.partition(b" ")[2].removesuffix(b"\n")
    if line != checked_line(store, grid, text):
        raise ValueError("it does not match its checksum")
    entry, path = json.loads(text), index_path(store.folder, grid)
    row, shapes = entry["row"], {name: tuple(map(int, shape)) for name, shape in entry["shapes"].items()}
    (size, changed, entered), (_,) = entry["stamp"], shapes["coefficients"]
    _check_types(path, entry, ATTRIBUTES, required=("sample", "status", "steps", "seconds"))
    _check_row(path, grid, entry["status"], row)
    if not {type(value) for value in row.values()} <= {bool, int, float, str}:
        raise DamagedFile(f"{path} holds a row with what is no number and no text")
    if not all(word.isprintable() for word in (entry["status"], *row, *map(str, row.values()))):
        raise DamagedFile(f"{path} holds text that cannot be printed")
    versions = entry["packages"]
    if not isinstance(versions, dict) or not all(str(each).isprintable() for each in versions.values()):
        raise DamagedFile(f"{path} holds versions that are no names and texts")
    record = Record(entry["sample"], entry["status"], entry["steps"], entry["seconds"], row, shapes, versions)
    return (size, changed, entered), record
