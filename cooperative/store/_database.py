"""`campaign.db`, the SQLite database of a campaign: opened, checked, and mended where it is damaged.

Table `campaign` has a row for each text that the campaign consists of, table `run` one for each sample and grid. The
controller alone writes, in transactions with a rollback journal: a process that is killed at any moment leaves what the
last transaction has committed.

SQLite finds damage of its own structure, not of the values in it, so each row has the SHA-256 of its values. It runs
what a schema says, triggers and views for instance: only the two tables as they are declared here are accepted. It also
follows links and reads the files of a journal, so that these are looked at before SQLite is.
"""

from __future__ import annotations

import errno
import hashlib
import os
import sqlite3
import warnings
from collections.abc import Iterable, Iterator, Mapping
from contextlib import closing, contextmanager, suppress
from functools import partial
from pathlib import Path

from jaxmpm.support import files
from jaxmpm.support.files import DamagedFile
from jaxmpm.support.text import shown

DATABASE = "campaign.db"
APPLICATION = int.from_bytes(b"jmpm")
"""Number at byte 68 of the file, by which `file` and SQLite tell what a database belongs to."""
SCHEMA = 1
"""Version of the tables, the `user_version` of the database."""
LOCK_TIMEOUT = 30.0
"""Seconds to wait for another program that reads, or writes, the same database."""
MOST, MOST_ROW = 2**36, 2**27
"""Bytes that a database and a row of it may have."""
MAGIC = b"SQLite format 3\0"
OF_SUPER_JOURNAL = bytes.fromhex("d9d505f920a163d7")
"""The end of a journal that names another one, which SQLite would open and delete."""

MENDED = "`jaxmpm resume` keeps what is whole and runs the rest again, or put back a copy"

Value = float | int | str | bytes | None
Row = Mapping[str, Value]

TEXTS = SCENE, BESIDE, MEASURED, BUDGET, SLIDES_END, SCORES, IN_TIME, FACTORS, SUMMARY = (
    "scene", "beside", "measured", "budget", "slides_t_end", "scores", "in_time", "factors", "summary",
)  # fmt: skip
"""Names of the texts of table `campaign`: the scene in TOML, and the others in JSON.

Samples that are asked in time have a text for each answer besides.
"""

CAMPAIGN = "CREATE TABLE campaign (name TEXT PRIMARY KEY, value TEXT NOT NULL, sha256 TEXT NOT NULL) WITHOUT ROWID"
TYPES = {"REAL": float, "INTEGER": int, "BOOLEAN": int, "TEXT": str, "BLOB": bytes}
"""Types that columns are declared with, and those that their values then have."""
COMMON = {
    "displacement": "REAL", "broke_off": "BOOLEAN", "depth": "REAL", "runout": "REAL", "volume": "REAL",
    "area": "REAL", "mode": "TEXT", "masses": "INTEGER", "depth_shallowest": "REAL", "depth_deepest": "REAL",
    "onset": "REAL", "onset_second": "REAL", "walls": "TEXT", "time": "REAL",
}  # fmt: skip
"""What every campaign may measure of a run. What only some measure is a column that the first such run adds."""
ABOUT = {
    "grid": "TEXT", "sample": "INTEGER", "status": "TEXT", "steps": "INTEGER", "seconds": "REAL", "written": "REAL",
    "dtype": "TEXT", "device": "TEXT", "versions": "TEXT", "fields_sha256": "TEXT", "coefficients": "BLOB",
    "sha256": "TEXT",
}  # fmt: skip
"""What a run is, beside what it measured."""


def table_of_runs(columns: Mapping[str, str]) -> str:
    """The declaration of table `run` with these columns and their types."""
    declared = ", ".join(f'"{name}" {kind}' for name, kind in columns.items())
    return f"CREATE TABLE run ({declared}, PRIMARY KEY (grid, sample)) WITHOUT ROWID"


def create(path: Path, values: Mapping[str, str], columns: Mapping[str, str], rows: Iterable[Row] = ()) -> None:
    """Write a database with these texts and runs, whole or not at all; one that is there is replaced.

    Raises:
        OSError: the disk refuses.
    """
    with files.aside(path) as part, explained(path), closing(sqlite3.connect(part, isolation_level=None)) as new:
        new.execute("PRAGMA journal_mode = OFF")
        new.execute(f"PRAGMA application_id = {APPLICATION}")
        new.execute(f"PRAGMA user_version = {SCHEMA}")
        new.execute("BEGIN")
        new.execute(CAMPAIGN)
        new.execute(table_of_runs(columns))
        for name, value in values.items():
            write_value(new, name, value)
        for row in rows:
            insert(new, row)
        new.execute("COMMIT")


def connect(path: Path, *, write: bool = False) -> sqlite3.Connection:
    """Open the database of a campaign.

    Args:
        path: of the database.
        write: also to write; only the controller does.

    Raises:
        DamagedFile: it is no database of a campaign, or damaged beyond that.
        OSError: it is not there, or the system refuses.
    """
    check_files(path)
    with explained(path):
        try:
            return _checked(path, "rw" if write else "ro")
        except sqlite3.OperationalError as error:
            if error.sqlite_errorcode != sqlite3.SQLITE_READONLY_ROLLBACK:
                raise
            # Its controller was killed as it wrote. Whoever may write there undoes that.
            _checked(path, "rw").close()
            return _checked(path, "ro")


def _checked(path: Path, mode: str) -> sqlite3.Connection:
    connection = _connection(path, mode)
    try:
        for pragma in ("trusted_schema = OFF", "cell_size_check = ON", "synchronous = FULL"):
            connection.execute(f"PRAGMA {pragma}")
        _check_schema(path, connection)
    except BaseException:
        connection.close()
        raise
    return connection


def _connection(path: Path, mode: str) -> sqlite3.Connection:
    uri = f"{path.absolute().as_uri()}?mode={mode}"
    connection = sqlite3.connect(uri, uri=True, timeout=LOCK_TIMEOUT, isolation_level=None)
    connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MOST_ROW)
    connection.text_factory = partial(str, encoding="utf-8", errors="replace")
    return connection


def check_files(path: Path) -> None:
    """Check that a database, and the journal of one that was being written, lead to no other file.

    Raises:
        DamagedFile: one does, or the file is no database of a campaign.
        OSError: it is not there.
    """
    head = files.read_plain(path, MOST, first=100)
    if not head.startswith(MAGIC) or len(head) < 100:
        raise DamagedFile(f"{path} is no SQLite database: put back a copy, or give another folder")
    application, version = (int.from_bytes(head[at : at + 4]) for at in (68, 60))
    if (application, version) != (APPLICATION, SCHEMA):
        raise DamagedFile(f"{path} is no database of a campaign that this version reads: give the folder of one")
    for ending in ("-wal", "-shm"):
        if head[18:20] != b"\1\1" or os.path.lexists(f"{path}{ending}"):
            raise DamagedFile(
                f"{path} has a write-ahead log, which no controller makes: "
                f"`sqlite3 {path} 'pragma journal_mode = delete'` ends that"
            )
    journal = Path(f"{path}-journal")
    if os.path.lexists(journal) and files.read_plain(journal, MOST, last=8) == OF_SUPER_JOURNAL:
        raise DamagedFile(f"{journal} names another file, which no controller's does: move it away")


def columns_of(connection: sqlite3.Connection) -> dict[str, str]:
    """Names and types of the columns of table `run`."""
    return {name: kind for _, name, kind, *_ in connection.execute("PRAGMA table_info(run)")}


def _check_schema(path: Path, connection: sqlite3.Connection) -> None:
    """DamagedFile for a schema that has more than the two tables, or other ones."""
    found = set(connection.execute("SELECT type, name, sql FROM sqlite_master"))
    columns = columns_of(connection)
    expected = {("table", "campaign", CAMPAIGN), ("table", "run", table_of_runs(columns))}
    alike = all(name.isidentifier() and kind in TYPES for name, kind in columns.items())
    if not alike or found != expected or not (ABOUT | COMMON).items() <= columns.items():
        others = sorted({f"{kind} {name}" for kind, name, _ in found - expected})
        raise DamagedFile(f"{path} has other tables than a campaign ({shown(others)}): give the folder of a campaign")


@contextmanager
def explained(path: Path) -> Iterator[None]:
    """Raise an error of SQLite in the block as DamagedFile, or as OSError with errno, file and remedy."""
    try:
        yield
    except UnicodeDecodeError as error:  # an error of SQLite that quotes the damage
        raise DamagedFile(f"{path} is damaged: put back a copy, or give another folder") from error
    except sqlite3.Error as error:
        code = getattr(error, "sqlite_errorcode", sqlite3.SQLITE_INTERNAL)
        number, remedy = errno.EIO, "check the disk"
        match code & 0xFF:
            case sqlite3.SQLITE_CORRUPT | sqlite3.SQLITE_NOTADB | sqlite3.SQLITE_TOOBIG | sqlite3.SQLITE_ERROR:
                raise DamagedFile(f"{path} is damaged ({error}): {MENDED}") from error
            case sqlite3.SQLITE_FULL:
                number, remedy = errno.ENOSPC, "make room"
            case sqlite3.SQLITE_READONLY | sqlite3.SQLITE_CANTOPEN | sqlite3.SQLITE_PERM:
                number = errno.EACCES
                remedy = "have it and its folder writable, or copy the folder to where you may write"
            case sqlite3.SQLITE_BUSY | sqlite3.SQLITE_LOCKED | sqlite3.SQLITE_PROTOCOL:
                number = errno.EBUSY
                remedy = "end the other program that has it open, or put it on a file system that has locks"
            case sqlite3.SQLITE_IOERR if code in OF_LOCKS:
                number, remedy = errno.ENOLCK, "its file system has no locks: put the folder on a local disk"
        message = f"cannot use {path} ({error}): {remedy}, and start the same command again"
        raise OSError(number, message) from error


OF_LOCKS = (
    sqlite3.SQLITE_IOERR_LOCK, sqlite3.SQLITE_IOERR_RDLOCK, sqlite3.SQLITE_IOERR_UNLOCK,
    sqlite3.SQLITE_IOERR_CHECKRESERVEDLOCK,
)  # fmt: skip
"""What SQLite answers where a file cannot be locked."""


@contextmanager
def transaction(path: Path, connection: sqlite3.Connection) -> Iterator[sqlite3.Connection]:
    """Commit what the block writes, all of it or nothing."""
    with explained(path), connection:
        connection.execute("BEGIN IMMEDIATE")
        yield connection


def sum_of(*parts: str) -> str:
    """SHA-256 of texts."""
    return hashlib.sha256("\0".join(parts).encode(errors="surrogatepass")).hexdigest()


def read_value(path: Path, connection: sqlite3.Connection, name: str) -> str | None:
    """A text of table `campaign`, None where it has none of this name.

    Raises:
        DamagedFile: it does not match its checksum.
    """
    with explained(path):
        row = connection.execute("SELECT value, sha256 FROM campaign WHERE name = ?", (name,)).fetchone()
    if row is None:
        return None
    if sum_of(name, str(row[0])) != row[1]:
        raise DamagedFile(
            f"{path} holds another {name} than was written: put back a copy, or "
            f"`sqlite3 {path} \"delete from campaign where name = '{name}'\"`"
        )
    return str(row[0])


def names_of_values(connection: sqlite3.Connection, beginning: str = "") -> list[str]:
    """Names of the texts of table `campaign` that begin so."""
    found = connection.execute("SELECT name FROM campaign WHERE substr(name, 1, ?) = ?", (len(beginning), beginning))
    return [str(name) for (name,) in found]


def write_value(connection: sqlite3.Connection, name: str, value: str) -> None:
    """Write a text of table `campaign` in place of the one of this name."""
    connection.execute("REPLACE INTO campaign VALUES (?, ?, ?)", (name, value, sum_of(name, value)))


def insert(connection: sqlite3.Connection, row: Row) -> None:
    """Write a row of table `run` in place of the one of its grid and sample."""
    names, marks = ", ".join(f'"{name}"' for name in row), ", ".join("?" * len(row))
    connection.execute(f"REPLACE INTO run ({names}) VALUES ({marks})", tuple(row.values()))


def checksum(digest: str, row: Row) -> str:
    """SHA-256 of a row of table `run` of the campaign with this digest; what is NULL does not count.

    Whole numbers count as the floats that SQLite may make of them.
    """
    parts = []
    for name in sorted(row):
        value = row[name]
        if value is None or name == "sha256":
            continue
        if isinstance(value, bytes):
            value = hashlib.sha256(value).hexdigest()
        elif not isinstance(value, str):
            value = float(value) + 0.0
        parts.append((name, value))
    return sum_of(digest, repr(parts))


def integrity(connection: sqlite3.Connection) -> str:
    """What is wrong with the structure of a database, "ok" where nothing is."""
    try:
        return str(connection.execute("PRAGMA integrity_check(1)").fetchone()[0]).splitlines()[-1]
    except (sqlite3.DatabaseError, UnicodeDecodeError) as error:
        return str(error)


def refuse_damaged(path: Path, connection: sqlite3.Connection) -> None:
    """Check that rows can be missing only where none were written.

    Raises:
        DamagedFile: the structure of the database is damaged.
    """
    if (problem := integrity(connection)) != "ok":
        raise DamagedFile(f"{path} is damaged ({problem}): {MENDED}")


def mend(path: Path, digest: str, problem: str) -> None:
    """Replace a damaged database by one with all texts and rows that match their checksums.

    The damaged one stays as `*.damaged`.

    Args:
        path: of the database.
        digest: of the campaign.
        problem: what is wrong, for the warning.

    Raises:
        DamagedFile: the texts of the scene are not whole.
        OSError: the disk refuses.
    """
    texts: dict[str, str] = {}
    rows: dict[tuple[Value, Value], Row] = {}
    with explained(path), closing(_connection(path, "ro")) as old:
        columns, names = columns_of(old), dict.fromkeys(TEXTS)
        with suppress(sqlite3.DatabaseError, UnicodeDecodeError):
            names |= dict.fromkeys(names_of_values(old))
        for name in names:
            with suppress(DamagedFile, OSError):
                if (text := read_value(path, old, name)) is not None:
                    texts[name] = text
        # Rows behind a damaged page are found from the other end.
        for order in ("ASC", "DESC"):
            with suppress(sqlite3.DatabaseError, UnicodeDecodeError):
                for values in old.execute(f"SELECT * FROM run ORDER BY grid {order}, sample {order}"):
                    row = dict(zip(columns, values, strict=True))
                    if checksum(digest, row) == row["sha256"]:
                        rows[row["grid"], row["sample"]] = row
    if BESIDE not in texts:
        raise DamagedFile(f"{path} is damaged ({problem}): put back a copy, or give another folder")
    aside = files.copy_aside(path)
    create(path, texts, columns, rows.values())
    whole = [name for name in TEXTS if name in texts]
    if answers := len(texts) - len(whole):
        whole.append(f"{answers} answers")
    warnings.warn(
        f"{path} is damaged ({problem}): copied to {aside.name}; {', '.join(whole)} and {len(rows)} runs are whole, "
        "the others are run again",
        stacklevel=3,
    )
