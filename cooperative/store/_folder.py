"""Where the files of a campaign lie, and the open folder."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from cooperative.store._source import Source
from foundation.text import shown

GRIDS = ("rough", "refined")
SLIDES = "slides"
"""Beside the grids: refined runs that went on from where they had failed to the end of their slide."""


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
