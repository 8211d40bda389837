"""Finished samples, the open folder that holds them, and the table of one grid."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Self

import numpy as np

from cooperative.store._source import Source
from jaxmpm.support.files import DamagedFile
from jaxmpm.support.hdf5 import Scalar

COARSE = "coarse"
"""A grid before the rough one, which a campaign may have: it chooses the samples of that one."""
SLIDES = "slides"
"""Beside the grids: refined runs that went on from where they had failed to the end of their slide."""


MOVING = "moving"
"""Restart points of slides that had not come to rest when they ended."""


class AnotherScene(DamagedFile):
    """A whole file of a sample of another scene."""


@dataclass(frozen=True)
class Store:
    """An open campaign `folder`.

    Args:
        folder: of the campaign.
        source: what the campaign was made from.
        lock: the file descriptor that holds the folder, None when opened for reading.
    """

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


@dataclass(frozen=True)
class Record:
    """A finished sample without its arrays, see `Sample`.

    Args:
        number: of the sample.
        status: how the run ended.
        steps: time steps.
        seconds: of wall time.
        row: scalars by name.
        shapes: of "coefficients" and of each "fields/NAME".
        versions: of the packages that made it.
    """

    number: int
    status: str
    steps: int
    seconds: float
    row: Mapping[str, Scalar]
    shapes: Mapping[str, tuple[int, ...]]
    versions: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Sample:
    """One finished sample on one grid.

    Args:
        number: sample number.
        status: how the run ended.
        steps: time steps.
        seconds: of wall time.
        coefficients: KL coefficients (modes,).
        row: the scalars that estimators and tables read.
        fields: named arrays: final displacement (d, N) m, plastic_strain (N,), of a failure also frames (T, d, N) m at
            its frame_times (T,) s, and others.
        dtype: of the computation.
        device: of the computation.
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
        steps, seconds = int(self.steps), float(self.seconds)
        return Record(int(self.number), self.status, steps, seconds, self.row, shapes, self.versions)


@dataclass(frozen=True)
class Rows:
    """The table of one grid.

    Args:
        columns: equally long, by name.
        damaged: the files that could not be trusted.
        versions: sample -> the packages that made it, where they are known.
    """

    columns: dict[str, np.ndarray]
    damaged: tuple[str, ...]
    versions: Mapping[int, Mapping[str, str]] = field(default_factory=dict)

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
    return Rows(columns, damaged, {sample.number: sample.versions for sample in samples if sample.versions})


def mixed_versions(grids: Mapping[str, Rows]) -> str:
    """Which samples were made by which versions, in words; empty where all were made by the same.

    Args:
        grids: rows by grid.
    """
    made: dict[tuple[tuple[str, str], ...], dict[str, list[int]]] = {}
    for grid, rows in grids.items():
        for number, versions in rows.versions.items():
            numbers = {name: each for name, each in versions.items() if name in DECIDING}
            made.setdefault(tuple(sorted(numbers.items())), {}).setdefault(grid, []).append(number)
    if len(made) < 2:
        return ""
    differ = {name for name in DECIDING if len({dict(each).get(name) for each in made}) > 1}
    parts = []
    for each, where in made.items():
        packages = ", ".join(f"{name} {number}" for name, number in each if name in differ)
        parts.append(" and ".join(f"{grid} {_ranges(numbers)}" for grid, numbers in where.items()) + f" by {packages}")
    return (
        f"samples were made by several versions, whose rounding differs: {'; '.join(parts)}. Each is whole, and the "
        "campaign as a whole cannot be made again bit for bit"
    )


DECIDING = ("jaxmpm", "jax", "jaxlib", "numpy", "scipy")
"""Packages on whose versions the rounding of a result depends."""


def _ranges(numbers: Sequence[int]) -> str:
    """Numbers in words: "0 to 4, 7"."""
    runs: list[list[int]] = []
    for number in sorted(numbers):
        if runs and number == runs[-1][-1] + 1:
            runs[-1][1:] = [number]
        else:
            runs.append([number])
    return ", ".join(" to ".join(map(str, run)) for run in runs)


def _column(values: list[Scalar | None]) -> np.ndarray:
    if any(isinstance(value, str) for value in values):
        return np.array(["" if value is None else str(value) for value in values])
    return np.array([np.nan if value is None else value for value in values])
