"""Finished samples, the open folder that holds them, and the table of one grid."""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Self

import numpy as np

from cooperative.store._database import DATABASE, connect, explained, transaction
from cooperative.store._source import Source
from jaxmpm import __version__
from jaxmpm.support.hdf5 import Scalar
from jaxmpm.support.values import by_value

COARSE = "coarse"
"""A grid before the rough one, which a campaign may have: it chooses the samples of that one."""
SLIDES = "slides"
"""Beside the grids: refined runs that went on from where they had failed to the end of their slide."""
FAILED_AT = "failed_at"
"""Column of slides of samples that were asked in time: the time of the first failure (s), at which each began."""
SLIDES_IN_TIME = "slides"
"""Folder with these slides, in that of their answers."""
MOVING = "moving"
"""Restart points of slides that had not come to rest when they ended."""


@by_value
@dataclass(frozen=True)
class Store:
    """An open campaign `folder`.

    Args:
        folder: of the campaign.
        source: what the campaign was made from.
        lock: the file descriptor that holds the folder, None when opened for reading.
        connection: by which the controller writes, None when opened for reading.
    """

    folder: Path
    source: Source
    lock: int | None = None
    connection: sqlite3.Connection | None = None

    @property
    def digest(self) -> str:
        """Of the source; the checksum of each row is of it too."""
        return self.source.digest

    @property
    def path(self) -> Path:
        """Of the database."""
        return self.folder / DATABASE

    @contextmanager
    def reading(self) -> Iterator[sqlite3.Connection]:
        """The database, to be read in the block.

        Raises:
            DamagedFile: it is damaged.
            OSError: the system refuses.
        """
        if self.connection is not None:
            with explained(self.path):
                yield self.connection
            return
        with explained(self.path), closing(connect(self.path)) as connection:
            yield connection

    @contextmanager
    def writing(self) -> Iterator[sqlite3.Connection]:
        """The database, which holds all that the block writes once that has ended, or nothing of it.

        Raises:
            ValueError: the store is open for reading.
            OSError: the disk refuses.
        """
        if self.connection is None:
            raise ValueError(f"{self.folder} is open for reading: use open_store to write {DATABASE}")
        with transaction(self.path, self.connection) as connection:
            yield connection

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Give the folder back to other controllers."""
        if self.connection is not None:
            self.connection.close()
        if self.lock is not None:
            os.close(self.lock)


@by_value
@dataclass(frozen=True)
class RunRecord:
    """A finished sample without its arrays, see `FinishedRun`.

    Args:
        number: of the sample.
        status: how the run ended.
        steps: time steps.
        seconds: of wall time.
        row: scalars by name.
        terms: number of its coefficients.
        written: when it was stored (s since 1970).
        versions: of the packages that made it.
    """

    number: int
    status: str
    steps: int
    seconds: float
    row: Mapping[str, Scalar]
    terms: int = 0
    written: float = 0.0
    versions: Mapping[str, str] = field(default_factory=dict)


@by_value
@dataclass(frozen=True)
class FinishedRun:
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


@by_value
@dataclass(frozen=True)
class Rows:
    """The table of one grid.

    Args:
        columns: equally long, by name.
        damaged: the runs that could not be trusted, and why.
        versions: sample -> the packages that made it, where they are known.
        written: sample -> when it was stored (s since 1970).
    """

    columns: dict[str, np.ndarray]
    damaged: tuple[str, ...]
    versions: Mapping[int, Mapping[str, str]] = field(default_factory=dict)
    written: Mapping[int, float] = field(default_factory=dict)

    @classmethod
    def of(cls, samples: Iterable[RunRecord], damaged: tuple[str, ...] = ()) -> Self:
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
        versions = {sample.number: sample.versions for sample in samples if sample.versions}
        return cls(columns, damaged, versions, {sample.number: sample.written for sample in samples})

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


def mixed_versions(grids: Mapping[str, Rows]) -> str:
    """Which samples were made by which versions, in words; empty where all were made by the same.

    Args:
        grids: rows by grid.
    """
    made: dict[tuple[tuple[str, str], ...], dict[str, list[int]]] = {}
    for grid, rows in grids.items():
        for number, versions in rows.versions.items():
            numbers = {name: version for name, version in versions.items() if name in DECIDING}
            made.setdefault(tuple(sorted(numbers.items())), {}).setdefault(grid, []).append(number)
    if len(made) < 2:
        return ""
    differ = {name for name in DECIDING if len({dict(combination).get(name) for combination in made}) > 1}
    parts = []
    for combination, where in made.items():
        packages = ", ".join(f"{name} {number}" for name, number in combination if name in differ)
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


@cache
def package_versions() -> Mapping[str, str]:
    """Versions of the packages that a result depends on."""
    return {"jaxmpm": __version__} | {name: version(name) for name in ("jax", "jaxlib", "numpy", "scipy", "h5py")}
