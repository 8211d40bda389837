"""A campaign on disk: a folder with its scene and one HDF5 file per finished sample and grid.

Files are written aside and sealed with a checksum (`foundation.files`); one that does not match is named, set aside and
counted as not done.

    scene.toml                    the scene, verbatim
    samples/rough/000123.h5       coefficients, row, fields, provenance of sample 123 on the rough grid
    samples/refined/000123.h5
    restart/refined-000123.h5     a long run under way (`cooperative.restart`), removed once it has ended
    .lock                         held by the one controller; the kernel frees it when the process ends
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import socket
import tomllib
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Self

import h5py
import numpy as np

from jaxmpm import DamagedFile, files, write_aside

GRIDS = ("rough", "refined")
SCHEMA = 1
KIND = "cooperative sample"
Scalar = float | int | bool | str


@dataclass(frozen=True)
class Sample:
    """One finished sample on one grid.

    number: sample number. status: how the run ended. steps, seconds: time steps and wall seconds spent.
    coefficients: KL coefficients (modes,). row: the scalars that estimators and tables read.
    fields: named arrays (final displacement, plastic strain ...). dtype, device: of the computation.
    versions: package versions, filled in when written.
    """

    number: int
    status: str
    steps: int
    seconds: float
    coefficients: np.ndarray
    row: Mapping[str, Scalar]
    fields: Mapping[str, np.ndarray] = field(default_factory=dict)
    dtype: str = "float32"
    device: str = "cpu"
    versions: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Store:
    """An open campaign `folder`. scene_text: its TOML. digest: of the text. lock: the file descriptor that holds the
    folder, None when opened for reading."""

    folder: Path
    scene_text: str
    digest: str
    lock: int | None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Give the folder back to other controllers."""
        if self.lock is not None:
            os.close(self.lock)


@dataclass(frozen=True)
class Rows:
    """The table of one grid. columns: equally long, by name. damaged: the files that could not be trusted."""

    columns: dict[str, np.ndarray]
    damaged: tuple[str, ...]

    @property
    def numbers(self) -> list[int]:
        """Numbers of the finished samples, ascending."""
        return [int(number) for number in self.columns["sample"]]


def scene_digest(scene_text: str) -> str:
    """SHA-256 of what the TOML text says: comments, spacing and the order of keys do not count."""
    return hashlib.sha256(json.dumps(_flat(scene_text), sort_keys=True).encode()).hexdigest()


def open_store(folder: str | Path, scene_text: str) -> Store:
    """Open the campaign folder for the one controller, made if it is not there.

    Raises ValueError when the folder cannot be written, holds something else or a campaign of another scene
    (naming what differs), or is held by another controller.
    """
    folder = Path(folder)
    digest = scene_digest(scene_text)
    scene_path = folder / "scene.toml"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        others = [entry.name for entry in folder.iterdir() if not entry.name.startswith(".")]
        if others and not scene_path.exists():
            raise ValueError(
                f"folder {folder} holds {sorted(others)[0]!r} but no scene.toml, so it is not a campaign: "
                "give a new or empty folder"
            )
        lock = _take_lock(folder)
    except OSError as error:
        raise ValueError(
            f"folder {folder} cannot be written ({error.strerror}): give a folder that you may write to"
        ) from error
    try:
        if scene_path.exists():
            differences = _differences(scene_path.read_text(), scene_text)
            if differences:
                raise ValueError(
                    f"folder {folder} belongs to another scene ({'; '.join(differences)}): "
                    "give another folder, or the scene that it was started with"
                )
        else:
            write_aside(scene_path, scene_text.encode())
        for grid in GRIDS:
            directory = folder / "samples" / grid
            directory.mkdir(parents=True, exist_ok=True)
            for leftover in directory.glob(".*.part"):
                leftover.unlink()
    except BaseException:
        os.close(lock)
        raise
    return Store(folder, scene_path.read_text(), digest, lock)


def read_store(folder: str | Path) -> Store:
    """Open a campaign folder for reading, whether or not a controller holds it. ValueError if it is none."""
    scene_path = Path(folder) / "scene.toml"
    if not scene_path.is_file():
        raise ValueError(f"folder {folder} has no scene.toml: give the folder of a campaign")
    scene_text = scene_path.read_text()
    return Store(Path(folder), scene_text, scene_digest(scene_text), None)


def sample_path(store: Store, grid: str, number: int) -> Path:
    """File of one sample. ValueError for an unknown grid or a negative number."""
    if grid not in GRIDS:
        raise ValueError(f"grid {grid!r} is unknown: give one of {', '.join(GRIDS)}")
    if number < 0:
        raise ValueError(f"sample number {number} is negative: numbers start at 0")
    return store.folder / "samples" / grid / f"{number:06d}.h5"


def restart_path(folder: str | Path, grid: str, number: int) -> Path:
    """Restart point of one sample, in the campaign's folder."""
    return Path(folder) / "restart" / f"{grid}-{number:06d}.h5"


def write_sample(store: Store, grid: str, sample: Sample) -> Path:
    """Write one finished sample, whole or not at all; its restart point is removed.

    Raises ValueError for a store opened for reading or a sample that is there already, OSError (with the
    errno of the system, for example ENOSPC) when the disk refuses; no half file is left then.
    """
    path = sample_path(store, grid, sample.number)
    if store.lock is None:
        raise ValueError(f"{store.folder} is open for reading: use open_store to write {path.name}")
    if path.exists():
        raise ValueError(f"{path} is finished already: results are never overwritten, delete it to redo it")

    def fill(file: h5py.File) -> None:
        file.attrs.update(
            schema=SCHEMA,
            scene=store.digest,
            grid=grid,
            sample=sample.number,
            status=sample.status,
            steps=sample.steps,
            seconds=float(sample.seconds),
            dtype=sample.dtype,
            device=sample.device,
            versions=json.dumps(package_versions(), sort_keys=True),
        )
        file["coefficients"] = np.asarray(sample.coefficients)
        file.create_group("row").attrs.update(sample.row)
        fields = file.create_group("fields")
        for name, values in sample.fields.items():
            fields[name] = np.asarray(values)

    files.write_sealed(path, KIND, SCHEMA, fill)
    restart_path(store.folder, grid, sample.number).unlink(missing_ok=True)
    return path


def read_sample(store: Store, grid: str, number: int) -> Sample:
    """Read one sample and verify it. DamagedFile if it cannot be trusted, FileNotFoundError if not there."""
    return _read(store, grid, sample_path(store, grid, number))


def read_rows(store: Store, grid: str) -> Rows:
    """Read and verify every finished sample of one grid; rows ascend by sample number.

    Columns: sample, status, steps, seconds, then the scalars of the rows. A scalar that some rows lack is
    nan there ("" for text). Files that cannot be trusted are named in `damaged`; the controller (who holds
    the lock) also renames them to `*.damaged`, so that their samples are run again.
    """
    samples: list[Sample] = []
    damaged: list[str] = []
    for path in sorted((store.folder / "samples" / grid).glob("*.h5")):
        try:
            samples.append(_read(store, grid, path))
        except DamagedFile as error:
            damaged.append(str(error))
            if store.lock is not None:
                warnings.warn(f"{error}: set aside, the sample is run again", stacklevel=2)
                set_aside(path)
    samples.sort(key=lambda sample: sample.number)
    columns = {
        "sample": np.array([sample.number for sample in samples], dtype=int),
        "status": np.array([sample.status for sample in samples], dtype=str),
        "steps": np.array([sample.steps for sample in samples], dtype=int),
        "seconds": np.array([sample.seconds for sample in samples], dtype=float),
    }
    for name in sorted({name for sample in samples for name in sample.row} - columns.keys()):
        columns[name] = _column([sample.row.get(name) for sample in samples])
    return Rows(columns, tuple(damaged))


def package_versions() -> dict[str, str]:
    """Versions of the packages that a result depends on."""
    return dict(_package_versions())


@cache
def _package_versions() -> tuple[tuple[str, str], ...]:
    found = []
    for name in ("jaxmpm", "jax", "jaxlib", "numpy", "scipy", "h5py"):
        try:
            found.append((name, version(name)))
        except PackageNotFoundError:
            found.append((name, "not installed"))
    return tuple(found)


def _take_lock(folder: Path) -> int:
    descriptor = os.open(folder / ".lock", os.O_RDWR | os.O_CREAT, 0o644)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        holder = os.pread(descriptor, 200, 0).decode(errors="replace").strip()
        os.close(descriptor)
        raise ValueError(
            f"folder {folder} is held by another controller ({holder}): wait for it, stop it, or give another folder"
        ) from error
    except OSError:
        os.close(descriptor)
        raise
    os.ftruncate(descriptor, 0)
    os.pwrite(descriptor, f"process {os.getpid()} on {socket.gethostname()}".encode(), 0)
    return descriptor


def set_aside(path: Path) -> None:
    """Rename a damaged file to `*.damaged`, so that it is kept and in nobody's way."""
    target, again = path.with_name(path.name + ".damaged"), 1
    while target.exists():
        target, again = path.with_name(f"{path.name}.{again}.damaged"), again + 1
    os.rename(path, target)


def _read(store: Store, grid: str, path: Path) -> Sample:
    with files.read_sealed(path, KIND, SCHEMA) as file:
        attributes = dict(file.attrs)
        if attributes["scene"] != store.digest:
            raise DamagedFile(f"{path} belongs to another scene")
        if (attributes["grid"], f"{attributes['sample']:06d}.h5") != (grid, path.name):
            raise DamagedFile(f"{path} holds sample {attributes['sample']} of grid {attributes['grid']}")
        return Sample(
            number=int(attributes["sample"]),
            status=attributes["status"],
            steps=int(attributes["steps"]),
            seconds=float(attributes["seconds"]),
            coefficients=file["coefficients"][()],
            row={name: _plain(value) for name, value in file["row"].attrs.items()},
            fields={name: values[()] for name, values in file["fields"].items()},
            dtype=attributes["dtype"],
            device=attributes["device"],
            versions=json.loads(attributes["versions"]),
        )


def _plain(value: Any) -> Scalar:
    return value.item() if isinstance(value, np.generic) else value


def _column(values: list[Scalar | None]) -> np.ndarray:
    if any(isinstance(value, str) for value in values):
        return np.array(["" if value is None else str(value) for value in values])
    return np.array([np.nan if value is None else value for value in values])


def _flat(scene_text: str) -> dict[str, str]:
    """Dotted key -> value as text; 1 and 1.0 are the same value."""

    def walk(prefix: str, node: Any) -> dict[str, str]:
        if isinstance(node, dict):
            pairs = [(f"{prefix}.{key}" if prefix else key, value) for key, value in node.items()]
        elif isinstance(node, list):
            pairs = [(f"{prefix}[{index}]", value) for index, value in enumerate(node)]
        else:
            whole = isinstance(node, float) and node.is_integer() and abs(node) < 2**53
            return {prefix: repr(int(node) if whole else node)}
        flat = {} if pairs or not prefix else {prefix: repr(node)}
        for key, value in pairs:
            flat |= walk(key, value)
        return flat

    return walk("", tomllib.loads(scene_text))


def _differences(there: str, asked: str, most: int = 5) -> list[str]:
    old, new = _flat(there), _flat(asked)
    lines = [
        f"{key} is {old.get(key, 'not set')} there and {new.get(key, 'not set')} now"
        for key in sorted(old.keys() | new.keys())
        if old.get(key) != new.get(key)
    ]
    return lines if len(lines) <= most else [*lines[:most], f"and {len(lines) - most} more"]
