"""The table of one grid: a row for each finished sample."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from cooperative.store._folder import SLIDES, Store
from cooperative.store._index import add_to_index, read_index, stamp_of
from cooperative.store._reading import read_file
from cooperative.store._samples import Record
from foundation.files import DamagedFile, Scalar, set_aside


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


def read_rows(
    store: Store,
    grid: str,
    *,
    foreign: Callable[[Record], str | None] = lambda _: None,
    look: Callable[[], None] = lambda: None,
) -> Rows:
    """Read every finished sample of one grid, and verify those that are not in the index; rows ascend by sample number.

    foreign: what a whole sample holds that the scene does not have, which makes it a damaged one; None if nothing.
    look: called before each file, may raise to stop.
    A refined run that went on to the end of its slide has the row of that end.
    Columns: sample, status, steps, seconds, then the scalars of the rows. A scalar that some rows lack is
    nan there ("" for text). Files that cannot be trusted are named in `damaged`; the controller (who holds
    the lock) also renames them to `*.damaged`, so that their samples are run again.
    """
    found: dict[int, Record] = {}
    damaged: list[str] = []
    folders = [store.folder / "samples" / each for each in ((grid, SLIDES) if grid == "refined" else (grid,))]
    linked = next((each for each in (folders[0].parent, *folders) if each.is_symlink()), None)
    if linked is not None:
        return rows_of([], (f"{linked} leads out of the campaign's folder",))
    for folder in folders:
        stamps = {path.name: stamp_of(path) for path in sorted(folder.glob("*.h5"))}
        known = read_index(store, folder.name, stamps)
        for name, stamp in stamps.items():
            look()
            path = folder / name
            try:
                record = known.get(name)
                if record is None:
                    record = read_file(store, folder.name, path).record
                    if store.lock is not None:
                        add_to_index(store, folder.name, stamp, record)
                if why := foreign(record):
                    raise DamagedFile(f"{path} {why}")
                found[record.number] = record
            except DamagedFile as error:
                damaged.append(str(error))
                if store.lock is not None:
                    warnings.warn(f"{error}: set aside, the sample is run again", stacklevel=2)
                    set_aside(path)
    return rows_of(list(found.values()), tuple(damaged))


def reader(
    store: Store,
    foreign: Mapping[str, Callable[[Record], str | None]],
    look: Callable[[], None] = lambda: None,
) -> Callable[[str], Rows]:
    """Reads the rows of a grid, with what is foreign to each; see `read_rows`."""

    def read(grid: str) -> Rows:
        return read_rows(store, grid, foreign=foreign[grid], look=look)

    return read


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
    return Rows(columns, damaged)


def _column(values: list[Scalar | None]) -> np.ndarray:
    if any(isinstance(value, str) for value in values):
        return np.array(["" if value is None else str(value) for value in values])
    return np.array([np.nan if value is None else value for value in values])
