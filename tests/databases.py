"""What tests do to the database of a campaign, as whoever has SQLite can."""

import json
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

from cooperative.store import open_store, read_store, store_text, stored_text

OF_RUN = "where grid = ? and sample = ?"


def by_sql(folder: Path, statement: str, *values: object) -> list[tuple[Any, ...]]:
    """What a statement gives, which may also change the database."""
    with closing(sqlite3.connect(folder / "campaign.db")) as database, database:
        return database.execute(statement, values).fetchall()


def finished(folder: Path, grid: str) -> dict[int, float]:
    """The samples that have run on a grid, and when each was stored; none before the campaign has begun."""
    if not (folder / "campaign.db").exists():
        return {}
    return dict(by_sql(folder, "select sample, written from run where grid = ?", grid))


def delete(folder: Path, grid: str, number: int) -> None:
    """Have a sample run again."""
    by_sql(folder, f"delete from run {OF_RUN}", grid, number)


def spoil(folder: Path, grid: str, number: int) -> None:
    """Change a run without its checksum."""
    by_sql(folder, f"update run set seconds = seconds + 1 {OF_RUN}", grid, number)


def fields_file(folder: Path, grid: str, number: int) -> Path:
    """The file of a run's fields."""
    (path,) = (folder / "fields").glob(f"{grid}-{number:06d}-*.h5")
    return path


def stored(folder: Path, name: str) -> Any:
    """What the database holds by this name, None where there is nothing."""
    text = stored_text(folder, name)
    return None if text is None else json.loads(text)


def keep(folder: Path, name: str, value: object) -> None:
    """Have the database hold that by this name."""
    with open_store(folder, read_store(folder).source) as store:
        store_text(store, name, value if isinstance(value, str) else json.dumps(value))
