"""A sample file, read as if a stranger had written it: whatever is not as it should be is named and not trusted."""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from cooperative.store._folder import SLIDES, Store, sample_path
from cooperative.store._samples import KIND, SCHEMA, Sample
from foundation import files
from foundation.files import DamagedFile, Scalar
from foundation.text import shown

NUMBER, FLAG, TEXT = (float, int), (bool,), (str,)
SAID = {"schema": (int,), "scene": TEXT, "grid": TEXT, "sample": (int,), "status": TEXT, "steps": (int,),
        "seconds": NUMBER, "dtype": TEXT, "device": TEXT, "versions": TEXT}  # fmt: skip
"""What every sample file says of itself, and the types that it may have."""

MEASURED = dict.fromkeys(("depth", "runout", "volume", "area"), NUMBER)
ROW = {"displacement": NUMBER, "broke_off": FLAG, **MEASURED, "mode": TEXT, "masses": (int,)} | dict.fromkeys(
    ("depth_shallowest", "depth_deepest", "onset", "onset_second"), NUMBER
)
"""Types of the scalars that estimators and reports read; a row may have others, numbers or texts."""


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
