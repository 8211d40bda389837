"""A campaign on disk: a folder with its scene and one HDF5 file per finished sample and grid.

Files are written aside and sealed with a checksum (`foundation.files`). A sample file is read as if a stranger had
written it: one that does not match its seal, holds anything but the numbers and texts expected, or is no file at all is
named, set aside and counted as not done.

    scene.toml                    the scene, verbatim
    samples/rough/000123.h5       coefficients, row, fields, provenance of sample 123 on the rough grid
    samples/refined/000123.h5
    samples/slides/000123.h5      the same run to the end of its slide, where samples/refined has it until it failed
    restart/refined-000123.h5     a long run under way (`cooperative.runs`), removed once it has ended
    .lock                         held by the one controller; the kernel frees it when the process ends
"""

from __future__ import annotations

import hashlib
import json
import os
import socket
import sys
import tomllib
import warnings
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Self

import h5py
import numpy as np

from foundation.text import short, shown
from jaxmpm import files

GRIDS = ("rough", "refined")
SLIDES = "slides"
"""Beside the grids: refined runs that went on from where they had failed to the end of their slide."""
SCHEMA = 1
KIND = "cooperative sample"
Scalar = files.Scalar
DamagedFile = files.DamagedFile
write_aside = files.write_aside
set_aside = files.set_aside
own_folder = files.own_folder
MOST_TEXT = 2**20
"""Bytes that a scene, a lock or another small text of a campaign's folder may have."""

NUMBER, FLAG, TEXT = (float, int), (bool,), (str,)
SAID = {"schema": (int,), "scene": TEXT, "grid": TEXT, "sample": (int,), "status": TEXT, "steps": (int,),
        "seconds": NUMBER, "dtype": TEXT, "device": TEXT, "versions": TEXT}  # fmt: skip
"""What every sample file says of itself, and the types that it may have."""

MEASURED = dict.fromkeys(("depth", "runout", "volume", "area"), NUMBER)
ROW = {"displacement": NUMBER, "broke_off": FLAG, **MEASURED, "mode": TEXT, "masses": (int,)} | dict.fromkeys(
    ("depth_shallowest", "depth_deepest", "onset", "onset_second"), NUMBER
)
"""Types of the scalars that estimators and reports read; a row may have others, numbers or texts."""


@dataclass(frozen=True)
class Sample:
    """One finished sample on one grid.

    number: sample number. status: how the run ended. steps, seconds: time steps and wall seconds spent.
    coefficients: KL coefficients (modes,). row: the scalars that estimators and tables read.
    fields: named arrays: final displacement (d, N) m, plastic_strain (N,), of a failure also frames (T, d, N) m at its
    frame_times (T,) s, and others. dtype, device: of the computation.
    versions: of the packages that made it; those installed where it is empty.
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

    @property
    def result(self) -> tuple[float, bool]:
        """Its largest displacement (m), and whether the run broke off."""
        return float(self.row["displacement"]), bool(self.row["broke_off"])


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

    @property
    def ended(self) -> np.ndarray:
        """Which runs came to their end, or broke off, rather than stop once their class was decided (runs,) bool."""
        return self.columns["status"] != "DECIDED"

    @property
    def results(self) -> dict[int, tuple[float, bool]]:
        """Sample -> its largest displacement (m), and whether the run broke off."""
        columns = (self.columns.get(name, np.zeros(0)) for name in ("displacement", "broke_off"))
        return {n: (float(u), bool(b)) for n, u, b in zip(self.numbers, *columns, strict=True)}


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
                f"folder {folder} holds {shown(sorted(others)[0])} but no scene.toml, so it is not a campaign: "
                "give a new or empty folder"
            )
        lock = _take_lock(folder)
    except OSError as error:
        raise ValueError(
            f"folder {folder} cannot be written ({error.strerror}): give a folder that you may write to"
        ) from error
    try:
        if scene_path.exists():
            differences = _differences(_small_text(scene_path), scene_text)
            if differences:
                raise ValueError(
                    f"folder {folder} belongs to another scene ({'; '.join(differences)}): "
                    "give another folder, or the scene that it was started with"
                )
        else:
            write_aside(scene_path, scene_text.encode())
        for directory in (folder / "samples", *(folder / "samples" / grid for grid in (*GRIDS, SLIDES))):
            _claim(directory)
            for leftover in directory.glob(".*.part"):
                leftover.unlink()
    except BaseException:
        os.close(lock)
        raise
    return Store(folder, _small_text(scene_path), digest, lock)


def read_store(folder: str | Path) -> Store:
    """Open a campaign folder for reading, whether or not a controller holds it. ValueError if it is none."""
    scene_path = Path(folder) / "scene.toml"
    if not scene_path.exists():
        raise ValueError(f"folder {folder} has no scene.toml: give the folder of a campaign")
    scene_text = _small_text(scene_path)
    return Store(Path(folder), scene_text, scene_digest(scene_text), None)


def sample_path(store: Store, grid: str, number: int) -> Path:
    """File of one sample. ValueError for an unknown grid or a negative number."""
    if grid not in (*GRIDS, SLIDES):
        raise ValueError(f"grid {shown(grid)} is unknown: give one of {', '.join(GRIDS)}")
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
    if os.path.lexists(path):
        raise ValueError(f"{path} is finished already: results are never overwritten, delete it to redo it")

    files.write_sealed(path, KIND, SCHEMA, lambda file: fill_sample(file, store, grid, sample))
    restart_path(store.folder, grid, sample.number).unlink(missing_ok=True)
    return path


def fill_sample(group: h5py.Group, store: Store, grid: str, sample: Sample) -> None:
    """Write a sample into an empty group, as its own file has it."""
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
        versions=json.dumps(dict(sample.versions) or package_versions(), sort_keys=True),
    )
    group["coefficients"] = np.asarray(sample.coefficients)
    group.create_group("row").attrs.update(sample.row)
    fields = group.create_group("fields")
    for name, values in sample.fields.items():
        fields[name] = np.asarray(values)


def read_sample(store: Store, grid: str, number: int) -> Sample:
    """Read one sample and verify it, a refined one to the end of its slide where it has one.

    DamagedFile if it cannot be trusted, FileNotFoundError if not there.
    """
    if grid == "refined" and sample_path(store, SLIDES, number).exists():
        grid = SLIDES
    return _read(store, grid, sample_path(store, grid, number))


def read_rows(store: Store, grid: str, *, samples: int | None = None) -> Rows:
    """Read and verify every finished sample of one grid; rows ascend by sample number.

    samples: how many the scene has; files of higher numbers are damaged. A refined run that went on to the end of its
    slide has the row of that end.
    Columns: sample, status, steps, seconds, then the scalars of the rows. A scalar that some rows lack is
    nan there ("" for text). Files that cannot be trusted are named in `damaged`; the controller (who holds
    the lock) also renames them to `*.damaged`, so that their samples are run again.
    """
    found: dict[int, Sample] = {}
    damaged: list[str] = []
    folders = [store.folder / "samples" / each for each in ((grid, SLIDES) if grid == "refined" else (grid,))]
    linked = next((each for each in (folders[0].parent, *folders) if each.is_symlink()), None)
    if linked is not None:
        return rows_of([], (f"{linked} leads out of the campaign's folder",))
    for path in [path for folder in folders for path in sorted(folder.glob("*.h5"))]:
        try:
            sample = _read(store, path.parent.name, path)
            if samples is not None and sample.number >= samples:
                raise DamagedFile(f"{path} is of a sample that the scene, with {samples}, does not have")
            found[sample.number] = sample
        except DamagedFile as error:
            damaged.append(str(error))
            if store.lock is not None:
                warnings.warn(f"{error}: set aside, the sample is run again", stacklevel=2)
                set_aside(path)
    return rows_of(list(found.values()), tuple(damaged))


def rows_of(samples: list[Sample], damaged: tuple[str, ...] = ()) -> Rows:
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
    path = folder / ".lock"
    # A link would have the text below written elsewhere, a pipe would wait for its other end.
    flags = os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
    descriptor = os.open(path, flags, 0o644)
    try:
        if not path.is_file():
            raise ValueError(f"{path} is no regular file: delete it")
        held = _hold(descriptor)
    except BaseException:
        os.close(descriptor)
        raise
    if not held:
        os.close(descriptor)
        raise ValueError(
            f"folder {folder} is held by another controller ({lock_holder(folder)}): "
            "wait for it, stop it, or give another folder"
        )
    os.ftruncate(descriptor, 0)
    os.write(descriptor, f"process {os.getpid()} on {socket.gethostname()}".encode())
    return descriptor


def _hold(descriptor: int) -> bool:
    """Lock a file until it is closed, which the system does when the process ends; False where another holds it."""
    try:
        if sys.platform == "win32":
            import msvcrt

            # A locked byte cannot be read there, so it is one far behind the text.
            os.lseek(descriptor, MOST_TEXT, os.SEEK_SET)
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
            os.lseek(descriptor, 0, os.SEEK_SET)
        else:
            import fcntl

            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):
        return False
    return True


def lock_holder(folder: Path) -> str:
    """What the lock says of who took it last: "process 123 on host". DamagedFile or OSError where it says nothing."""
    return short(files.read_plain(folder / ".lock", MOST_TEXT).decode(errors="replace").strip(), 200)


def _small_text(path: Path) -> str:
    """Text of a scene. ValueError for what is no regular file or no text."""
    try:
        return files.read_plain(path, MOST_TEXT).decode()
    except UnicodeDecodeError as error:
        raise ValueError(f"{path} is not text in UTF-8: {error}") from error


def _claim(directory: Path) -> None:
    """Make a folder of samples; what stands in its place, a link that leads elsewhere above all, is set aside."""
    if directory.is_symlink() or (directory.exists() and not directory.is_dir()):
        warnings.warn(
            f"{directory} is a link or a file, not a folder: set aside as {set_aside(directory)}", stacklevel=3
        )
    directory.mkdir(parents=True, exist_ok=True)


def _read(store: Store, grid: str, path: Path) -> Sample:
    with files.read_sealed(path, KIND, SCHEMA) as file:
        said, row = file.scalars("/"), file.scalars("row")
        _check_types(path, said, SAID, required=SAID)
        _check_types(path, row, ROW, required=("displacement", "broke_off"))
        # A refined run that ended once it had failed slid no farther than that.
        cut_short = row["broke_off"] or (grid == "refined" and said["status"] == "DECIDED")
        _check_types(path, row, ROW, required=() if cut_short else MEASURED)
        if said["scene"] != store.digest:
            raise DamagedFile(f"{path} belongs to another scene")
        if (said["grid"], f"{said['sample']:06d}.h5") != (grid, path.name):
            raise DamagedFile(f"{path} holds sample {said['sample']} of grid {said['grid']}")
        if not 0 <= float(row["displacement"]) < float("inf"):
            raise DamagedFile(f"{path} holds a largest displacement of {row['displacement']} m")
        fields = {name: file.array("fields", name) for name in file.names("fields")}
        check_frames(path, fields, fields.get("displacement", np.empty(0)).shape)
        versions = json.loads(str(said["versions"]))
        if not isinstance(versions, dict) or not all(isinstance(value, str) for value in versions.values()):
            raise DamagedFile(f"{path} holds versions that are no names and texts")
        return Sample(
            number=int(said["sample"]),
            status=str(said["status"]),
            steps=int(said["steps"]),
            seconds=float(said["seconds"]),
            coefficients=file.array("/", "coefficients", dimensions=1, kinds="f"),
            row=row,
            fields=fields,
            dtype=str(said["dtype"]),
            device=str(said["device"]),
            versions=versions,
        )


def check_frames(path: Path, fields: Mapping[str, Any], shape: tuple[int, ...]) -> None:
    """DamagedFile for frames that are not (T, *shape), or whose times (T,) do not ascend. None at all will do."""
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
    path: Path, found: Mapping[str, Scalar], known: Mapping[str, tuple[type, ...]], required: Collection[str] = ()
) -> None:
    """DamagedFile for a value of another type than is known of it, or one that is missing."""
    for name, types in known.items():
        if name not in found and name in required:
            raise DamagedFile(f"{path} lacks {name}")
        if name in found and type(found[name]) not in types:
            raise DamagedFile(f"{path} holds {shown(name)} = {shown(found[name])}")


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
        f"{short(key)} is {short(old.get(key, 'not set'))} there and {short(new.get(key, 'not set'))} now"
        for key in sorted(old.keys() | new.keys())
        if old.get(key) != new.get(key)
    ]
    return lines if len(lines) <= most else [*lines[:most], f"and {len(lines) - most} more"]
