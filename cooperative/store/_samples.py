"""Where the samples of a campaign lie, and the file of one: its layout, how it is written, how it is read.

A file is read as if a stranger had written it: whatever is not as it should be is named and not trusted.
"""

from __future__ import annotations

import json
import os
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Self

import h5py
import numpy as np
from numpy.typing import ArrayLike

from cooperative.store._source import Source
from foundation import __version__, files
from foundation.files import DamagedFile, Scalar
from foundation.text import shown

KIND = "cooperative sample"
SCHEMA = 1
GRIDS = ("rough", "refined")
SLIDES = "slides"
"""Beside the grids: refined runs that went on from where they had failed to the end of their slide."""

NUMBER, FLAG, TEXT = (float, int), (bool,), (str,)
SAID = {"schema": (int,), "scene": TEXT, "grid": TEXT, "sample": (int,), "status": TEXT, "steps": (int,),
        "seconds": NUMBER, "dtype": TEXT, "device": TEXT, "versions": TEXT}  # fmt: skip
"""Attributes of every sample's file, and the types that they may have."""

MEASURED = dict.fromkeys(("depth", "runout", "volume", "area"), NUMBER)
ROW = {"displacement": NUMBER, "broke_off": FLAG, **MEASURED, "mode": TEXT, "masses": (int,)} | dict.fromkeys(
    ("depth_shallowest", "depth_deepest", "onset", "onset_second"), NUMBER
)
"""Types of the scalars that estimators and reports read; a row may have others, numbers or texts."""


@dataclass(frozen=True)
class Store:
    """An open campaign `folder`. source: what the campaign was made from. lock: the file descriptor that holds the
    folder, None when opened for reading."""

    folder: Path
    source: Source
    lock: int | None

    @property
    def digest(self) -> str:
        """Of the source; every sample's file has it."""
        return self.source.digest

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Give the folder back to other controllers."""
        if self.lock is not None:
            os.close(self.lock)


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


@dataclass(frozen=True)
class Record:
    """A finished sample without its arrays, see `Sample`. shapes: of "coefficients" and of each "fields/NAME"."""

    number: int
    status: str
    steps: int
    seconds: float
    row: Mapping[str, Scalar]
    shapes: Mapping[str, tuple[int, ...]]


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

    @property
    def record(self) -> Record:
        """The same without its arrays."""
        arrays = {"coefficients": self.coefficients} | {f"fields/{name}": each for name, each in self.fields.items()}
        shapes = {name: np.shape(values) for name, values in arrays.items()}
        return Record(int(self.number), self.status, int(self.steps), float(self.seconds), self.row, shapes)


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
        versions=json.dumps(dict(sample.versions or package_versions()), sort_keys=True),
    )
    group["coefficients"] = np.asarray(sample.coefficients)
    group.create_group("row").attrs.update(sample.row)
    fields = group.create_group("fields")
    for name, values in sample.fields.items():
        fields[name] = np.asarray(values)


@cache
def package_versions() -> Mapping[str, str]:
    """Versions of the packages that a result depends on."""
    return {"jaxmpm": __version__} | {name: version(name) for name in ("jax", "jaxlib", "numpy", "scipy", "h5py")}


def read_sample(store: Store, grid: str, number: int) -> Sample:
    """Read one sample and verify it, a refined one to the end of its slide where it has one.

    DamagedFile if it cannot be trusted, FileNotFoundError if not there.
    """
    if grid == "refined" and sample_path(store, SLIDES, number).exists():
        grid = SLIDES
    try:
        return read_file(store, grid, sample_path(store, grid, number))
    except DamagedFile as error:
        raise DamagedFile(f"{error}: `jaxmpm resume --verify` sets it aside and runs its sample again") from error


def read_file(store: Store, grid: str, path: Path) -> Sample:
    """The sample in one file of this grid. DamagedFile if it cannot be trusted."""
    with files.read_sealed(path, KIND, SCHEMA) as file:
        said, row = file.scalars("/"), file.scalars("row")
        check_types(path, said, SAID, required=SAID)
        if said["scene"] != store.digest:
            raise DamagedFile(f"{path} belongs to another scene")
        if (said["grid"], f"{said['sample']:06d}.h5") != (grid, path.name):
            raise DamagedFile(f"{path} holds sample {said['sample']} of grid {said['grid']}")
        check_row(path, grid, str(said["status"]), row)
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


def check_row(path: Path, grid: str, status: str, row: Mapping[str, Scalar]) -> None:
    """DamagedFile for a row that lacks what estimators and reports read, or has it of another type."""
    check_types(path, row, ROW, required=("displacement", "broke_off"))
    # A refined run that ended once it had failed slid no farther than that.
    cut_short = row["broke_off"] or (grid == "refined" and status == "DECIDED")
    check_types(path, row, ROW, required=() if cut_short else MEASURED)
    if not 0 <= float(row["displacement"]) < float("inf"):
        raise DamagedFile(f"{path} holds a largest displacement of {row['displacement']} m")


def check_frames(path: Path, fields: Mapping[str, ArrayLike], shape: tuple[int, ...]) -> None:
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


def check_types(
    path: Path, found: Mapping[str, Scalar], known: Mapping[str, tuple[type, ...]], required: Collection[str] = ()
) -> None:
    """DamagedFile for a value of another type than is known of it, or one that is missing."""
    for name, types in known.items():
        if name not in found and name in required:
            raise DamagedFile(f"{path} lacks {name}")
        if name in found and type(found[name]) not in types:
            raise DamagedFile(f"{path} holds {shown(name)} = {shown(found[name])}")
