"""A finished sample, and how it stands in a file."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import PackageNotFoundError, version

import h5py
import numpy as np

from cooperative.store._folder import Store
from foundation.files import Scalar

KIND = "cooperative sample"
SCHEMA = 1


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
    found = {}
    for name in ("jaxmpm", "jax", "jaxlib", "numpy", "scipy", "h5py"):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "not installed"
    return found
