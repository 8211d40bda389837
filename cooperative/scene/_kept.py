"""Numbers that a campaign measures once, before its first run, and keeps in a file of its folder."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Generic, Protocol, TypeVar

import jax

from cooperative.scene._campaign import Calibration, FieldModes, LimitLoad
from cooperative.scene._schema import Key, read
from cooperative.store import MOST_TEXT, write_aside
from foundation import files
from jaxmpm import Scene, State


class Grid(Protocol):
    """A grid of which something is measured, see `runs.GridModel`."""

    @property
    def median(self) -> tuple[Scene, State]:
        """Scene and initial state of the median soil."""


Numbers = TypeVar("Numbers", Calibration, LimitLoad, FieldModes)


@dataclass(frozen=True)
class Kept(Generic[Numbers]):
    """Where such numbers are kept: the table of a scene that may give them too, which names the file; its keys; their
    type; what the file holds, in messages."""

    table: str
    keys: dict[str, Key]
    numbers: type[Numbers]
    what: str

    def path(self, folder: Path) -> Path:
        """The file in a campaign's folder."""
        return folder / f"{self.table}.json"

    def once(self, folder: Path, measure: Callable[[], Numbers]) -> Numbers:
        """The numbers kept in a campaign's folder, measured and written there at first. Raises as `read`."""
        if not os.path.lexists(self.path(folder)):
            write_aside(self.path(folder), json.dumps(asdict(measure())).encode())
        return self.read(folder)

    def there(self, folder: Path) -> Numbers | None:
        """The numbers that a campaign's folder keeps, None where it keeps none. Raises as `read`."""
        return self.read(folder) if os.path.lexists(self.path(folder)) else None

    def read(self, folder: Path) -> Numbers:
        """The numbers in the file, checked as those of a scene are. Raises ValueError where it is damaged, OSError
        where it is missing."""
        path = self.path(folder)
        try:
            found = self.numbers(**read(self.table, json.loads(files.read_plain(path, MOST_TEXT)), self.keys))
            found.check()
        except (ValueError, RecursionError) as error:
            raise ValueError(f"{path} holds no {self.what} ({error}): delete it to measure it again") from error
        return found

    def in_text(self, text: str, found: Numbers) -> str:
        """A scene's text with the numbers in it, so that whoever reads the text has them."""
        given = {name: value for name, value in asdict(found).items() if value is not None}
        numbers = "".join(f"{name} = {json.dumps(value)}\n" for name, value in given.items())
        return f"{text}\n[{self.table}]\n{numbers}"


def factors_at_once() -> int:
    """Reduction factors that a measurement tries at once: on CPU lanes run in turn, and bisection takes the fewest;
    elsewhere a batch costs as much time as one."""
    return 2 if jax.default_backend() == "cpu" else 8
