"""Answers that a folder keeps, so that nothing runs twice."""

from __future__ import annotations

import json
from collections.abc import Container
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

import numpy as np

from cooperative.scene import Campaign, read
from cooperative.store import write_aside
from jaxmpm.support.files import read_plain

NAME = "answers.json"
MOST_BYTES = 2**26
SYMBOLS = {True: "fails", False: "stands", None: "broke off"}
MEANINGS = {word: answer for answer, word in SYMBOLS.items()}


@dataclass
class Kept:
    """What has been asked of samples, by grid, sample and state of the water.

    Args:
        path: of the file.
        digest: of the scene.
        answers: "grid sample state" -> whether it fails, None where the run broke off.
        factors: of safety of each sample in each state, None before they are known.
    """

    UNKNOWN: ClassVar[object] = object()
    path: Path
    digest: str
    answers: dict[tuple[str, int, int], bool | None] = field(default_factory=dict)
    factors: np.ndarray | None = None

    @classmethod
    def opened(cls, folder: Path, campaign: Campaign, states: int) -> Kept:
        """The answers of a folder, which is made if it is not there.

        Args:
            folder: of the answers.
            campaign: whose they are.
            states: of the water in which samples are asked.

        Raises:
            ValueError: the folder has answers of another scene, or a file that holds none.
        """
        folder.mkdir(parents=True, exist_ok=True)
        kept = cls(folder / NAME, read(campaign).source.digest)
        if not kept.path.exists():
            return kept
        try:
            content = json.loads(read_plain(kept.path, MOST_BYTES))
            digest = content["scene"]
            answers = {
                (str(grid), int(sample), int(at)): MEANINGS[word] for grid, sample, at, word in content["answers"]
            }
            given = content["factors"]
            factors = None if given is None else np.array(given, float)
        except (ValueError, KeyError, TypeError) as error:
            raise ValueError(f"{kept.path} holds no answers ({error}): remove it, and samples run again") from error
        shape = (campaign.plan.samples, states)
        if digest != kept.digest or (factors is not None and factors.shape != shape):
            raise ValueError(f"{kept.path} is of another scene: give another folder")
        kept.answers, kept.factors = answers, factors
        return kept

    def answer(self, grid: str, sample: int, at: int) -> object:
        """Whether a sample fails in a state, None where its run broke off, UNKNOWN where it has not run."""
        return self.answers.get((grid, sample, at), self.UNKNOWN)

    def tell(self, grid: str, sample: int, at: int, failed: bool | None) -> None:
        """Keep an answer."""
        self.answers[grid, sample, at] = None if failed is None else bool(failed)

    def of(self, grid: str, samples: Container[int]) -> list[tuple[int, int, bool | None]]:
        """Answers of some samples on a grid: sample, state, whether it fails."""
        return [(n, at, failed) for (of, n, at), failed in sorted(self.answers.items()) if of == grid and n in samples]

    def count(self, grid: str) -> int:
        """Runs on a grid."""
        return sum(of == grid for of, _, _ in self.answers)

    def write(self) -> None:
        """Write the file, whole."""
        content = {
            "scene": self.digest,
            "answers": [[*key, SYMBOLS[failed]] for key, failed in sorted(self.answers.items())],
            "factors": None if self.factors is None else np.round(self.factors, 6).tolist(),
        }
        write_aside(self.path, (json.dumps(content) + "\n").encode())
