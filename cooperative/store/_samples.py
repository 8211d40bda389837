"""A finished sample, and how it is written."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import h5py
import numpy as np

from cooperative.store._folder import Store, restart_path, sample_path
from foundation import files
from foundation.files import Scalar

KIND = "cooperative sample"
SCHEMA = 1


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
    found = {}
    for name in ("jaxmpm", "jax", "jaxlib", "numpy", "scipy", "h5py"):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "not installed"
    return found
