"""Answers that a folder keeps, so that nothing runs twice."""

from __future__ import annotations

import json
from collections.abc import Container
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

import numpy as np

from cooperative.store import FACTORS, GRIDS, IN_TIME, Store, read_rows, store_text, stored_text, stored_texts

ANSWER = "answer"
"""Beginning of the names of answers in the database: "answer rough 12 3" is of sample 12 in state 3 of the water."""
SYMBOLS = {True: "fails", False: "stands", None: "broke off"}
MEANINGS = {word: answer for answer, word in SYMBOLS.items()}


@dataclass
class Kept:
    """What has been asked of samples, by grid, sample and state of the water. Each answer is stored as it comes.

    Args:
        store: that has it.
        audited: samples that are asked on the refined grid too.
        chart: whether the states are of loads of a chart.
        answers: by grid, sample and state, whether it fails, None where the run broke off.
        factors: of safety of each sample in each state, None before they are known.
    """

    UNKNOWN: ClassVar[object] = object()
    store: Store
    audited: int
    chart: bool = False
    answers: dict[tuple[str, int, int], bool | None] = field(default_factory=dict)
    factors: np.ndarray | None = None

    @classmethod
    def begin(cls, store: Store, audited: int, *, chart: bool) -> Kept:
        """The answers of a folder that is open to write, to go on with.

        Args:
            store: the folder.
            audited: samples to ask on the refined grid too.
            chart: whether the states are of loads of a chart.

        Raises:
            ValueError: the folder holds a campaign, or answers to something else.
        """
        kept = cls.read(store)
        if (kept is None and any(read_rows(store, grid).numbers for grid in GRIDS)) or (kept and kept.chart != chart):
            raise ValueError(f"folder {store.folder} holds something else than these answers: give another folder")
        store_text(store, IN_TIME, json.dumps({"audited": audited, "chart": chart}))
        return cls(store, audited, chart, *((kept.answers, kept.factors) if kept else ()))

    @classmethod
    def read(cls, store: Store) -> Kept | None:
        """The answers of a folder, None where no samples were asked in time.

        Args:
            store: the folder.

        Raises:
            DamagedFile: an answer is not what was written.
        """
        about = stored_text(store.folder, IN_TIME)
        if about is None:
            return None
        answers = {}
        for name, word in stored_texts(store, ANSWER).items():
            _, grid, sample, at = name.split()
            answers[grid, int(sample), int(at)] = MEANINGS[word]
        factors = stored_text(store.folder, FACTORS)
        return cls(store, **json.loads(about), answers=answers, factors=None if factors is None else _array(factors))

    @property
    def written_to(self) -> Path:
        """The folder of what comes of the answers, in which that of the store is."""
        return self.store.folder.parent if self.store.folder.name else self.store.folder.resolve().parent

    def answer(self, grid: str, sample: int, at: int) -> object:
        """Whether a sample fails in a state, None where its run broke off, UNKNOWN where it has not run."""
        return self.answers.get((grid, sample, at), self.UNKNOWN)

    def tell(self, grid: str, sample: int, at: int, failed: bool | None) -> None:
        """Keep an answer."""
        failed = None if failed is None else bool(failed)
        store_text(self.store, f"{ANSWER} {grid} {sample} {at}", SYMBOLS[failed])
        self.answers[grid, sample, at] = failed

    def screen(self, factors: np.ndarray) -> np.ndarray:
        """Keep the factors of safety (samples, states), nan where there is none, and give them as they are kept."""
        text = json.dumps([[factor if np.isfinite(factor) else None for factor in row] for row in factors.tolist()])
        store_text(self.store, FACTORS, text)
        self.factors = _array(text)
        return self.factors

    def of(self, grid: str, samples: Container[int]) -> list[tuple[int, int, bool | None]]:
        """Answers of some samples on a grid: sample, state, whether it fails."""
        return [(n, at, failed) for (of, n, at), failed in sorted(self.answers.items()) if of == grid and n in samples]

    def count(self, grid: str) -> int:
        """Runs on a grid."""
        return sum(of == grid for of, _, _ in self.answers)


def _array(text: str) -> np.ndarray:
    return np.array(json.loads(text), float)
