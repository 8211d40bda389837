"""A campaign's folder, opened to write or to read.

One controller has it at a time, by a lock that the system frees when its process ends. A README describes the folder to
whoever opens it in five years.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import platform
import socket
import sys
import textwrap
import warnings
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from datetime import date
from pathlib import Path

from cooperative.store import _database as sql
from cooperative.store import _runs
from cooperative.store._database import DATABASE
from cooperative.store._runs import FIELDS, STORED, fields_path
from cooperative.store._samples import SLIDES_IN_TIME, Store, package_versions
from cooperative.store._source import MOST_TEXT, SCRIPTS, Source, differences, source_from, table_of
from jaxmpm.support import files
from jaxmpm.support.files import DamagedFile, set_aside, write_aside
from jaxmpm.support.text import printable, short, shown

NO_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP, errno.ENOTSUP)
"""What file systems answer that have no locks."""
README = "README.txt"
"""Made from `_readme.txt`, which describes each file by its content, whichever of them there are."""


def open_store(
    folder: str | Path,
    source: Source | str,
    *,
    verify: bool = False,
    check: Callable[[], None] = lambda: None,
) -> Store:
    """Open the campaign folder for the one controller, made if it is not there.

    A database whose structure is damaged is replaced by what is whole of it, with a warning.

    Args:
        folder: of the campaign.
        source: what the campaign is made from, or a scene's text alone.
        verify: read every file of fields and compare it with its checksum.
        check: called before each such file, may raise to stop.

    Raises:
        ValueError: the folder cannot be written, holds something else or a campaign of another scene (naming what
            differs), or is held by another controller.
        OSError: the disk refuses.
    """
    folder, source = Path(folder), Source(source) if isinstance(source, str) else source
    source.digest  # noqa: B018, no folder is made for a text that is no scene
    with _writable(folder):
        folder.mkdir(parents=True, exist_ok=True)
        others = sorted(entry.name for entry in folder.iterdir() if not entry.name.startswith("."))
    if refuse_another(folder, source) is None and others:
        raise ValueError(
            f"folder {folder} holds {shown(others[0])}, and no campaign has begun there: give a new or empty folder"
        )
    with _writable(folder):
        lock = _taken_lock(folder)
    path, connection = folder / DATABASE, None
    try:
        # Another controller may have begun since, and ended.
        there = refuse_another(folder, source)
        if there is None:
            texts = {} if source.text is None else {sql.SCENE: source.text}
            sql.create(path, {**texts, sql.BESIDE: json.dumps(source.beside)}, sql.ABOUT | sql.COMMON)
        connection = sql.connect(path, write=True)
        if (problem := sql.integrity(connection)) != "ok":
            connection.close()
            sql.mend(path, source.digest if there is None else there.digest, problem)
            connection = sql.connect(path, write=True)
        _write_readme(folder, source)
        store = Store(folder, there or source, lock, connection)
        _claim_fields(store, check if verify else None)
        for leftover in (*folder.glob(".*.part"), *folder.glob("figures/.*.part")):
            leftover.unlink(missing_ok=True)
        files.remove_leftovers(folder / "restart")
        return store
    except BaseException:
        if connection is not None:
            connection.close()
        os.close(lock)
        raise


@contextmanager
def _writable(folder: Path) -> Iterator[None]:
    """Raise an OSError of the block as ValueError."""
    try:
        yield
    except OSError as error:
        raise ValueError(
            f"folder {folder} cannot be written ({error.strerror}): give a folder that you may write to"
        ) from error


def _claim_fields(store: Store, check: Callable[[], None] | None) -> None:
    """Have the folder of fields hold only files that rows name; with `check` also verify these."""
    folder = files.claimed_folder(store.folder / FIELDS)
    with store.reading() as database:
        rows = database.execute(
            "SELECT grid, sample, fields_sha256 FROM run WHERE fields_sha256 IS NOT NULL"
        ).fetchall()
    sums = {}
    for row in rows:
        with suppress(DamagedFile, TypeError):  # which whoever reads that row names
            sums[fields_path(store.folder, *row)] = row[2]
    made = [path for name in (*(f"{grid}-*.h5" for grid in STORED), ".*.part") for path in folder.glob(name)]
    for path in made:
        if path not in sums:
            path.unlink()
    if check is None:
        return
    for path, sha256 in sums.items():
        check()
        with suppress(FileNotFoundError):
            try:
                whole = hashlib.sha256(_runs.read_fields_file(path)).hexdigest() == sha256
            except DamagedFile:
                whole = False
            if not whole:
                warnings.warn(f"{path} does not match its checksum: set aside as {set_aside(path)}", stacklevel=3)


def read_store(folder: str | Path) -> Store:
    """Open a campaign folder for reading, whether or not a controller holds it.

    Args:
        folder: of the campaign, or that in whose `slides` the slides of samples are that were asked in time.

    Raises:
        ValueError: the folder holds no campaign.
    """
    folder = Path(folder)
    if not os.path.lexists(folder / DATABASE) and os.path.lexists(folder / SLIDES_IN_TIME / DATABASE):
        folder = folder / SLIDES_IN_TIME
    source = stored_source(folder)
    if source is None:
        raise ValueError(
            f"folder {folder} holds no campaign: give the folder of one, of a sweep or of classes of storms one in its "
            "campaigns/, of a chart its chart/"
        )
    return Store(folder, source)


def stored_source(folder: Path) -> Source | None:
    """What the campaign in a folder was made from, None where no campaign has begun there.

    Args:
        folder: of the campaign.

    Raises:
        ValueError: the database cannot be trusted.
    """
    path = folder / DATABASE
    if not os.path.lexists(path):
        return None
    with closing(sql.connect(path)) as connection:
        text, beside = (sql.read_value(path, connection, name) for name in (sql.SCENE, sql.BESIDE))
    if beside is None:
        raise DamagedFile(f"{path} has no scene any more: put back a copy, or give another folder")
    return source_from(text, beside, str(path))


def stored_text(folder: Path, name: str) -> str | None:
    """A text that the database of a campaign's folder holds, None where there is none.

    Args:
        folder: of the campaign.
        name: of the text.

    Raises:
        DamagedFile: it does not match its checksum, or the database is damaged.
        OSError: the system refuses.
    """
    path = folder / DATABASE
    if not os.path.lexists(path):
        return None
    with closing(sql.connect(path)) as connection:
        return sql.read_value(path, connection, name)


def stored_texts(store: Store, beginning: str) -> dict[str, str]:
    """Texts that the database of a campaign holds, by name.

    Args:
        store: the campaign's folder.
        beginning: of their names.

    Raises:
        DamagedFile: one does not match its checksum, or the database is damaged.
        OSError: the system refuses.
    """
    with store.reading() as database:
        names = sql.names_of_values(database, beginning)
        texts = {name: sql.read_value(store.path, database, name) for name in names}
    return {name: text for name, text in texts.items() if text is not None}


def store_text(store: Store, name: str, text: str) -> None:
    """Keep a text in a campaign's database, unless it is there.

    Args:
        store: the campaign's folder, opened to write.
        name: of the text.
        text: to be kept.

    Raises:
        OSError: the disk refuses.
    """
    with store.writing() as database:
        there = database.execute("SELECT value FROM campaign WHERE name = ?", (name,)).fetchone()
        if there != (text,):
            sql.write_value(database, name, text)


def contents_sum(store: Store) -> str:
    """SHA-256 of all runs and texts of a campaign but its summary.

    Args:
        store: the campaign's folder.

    Raises:
        DamagedFile: the database is damaged.
        OSError: the system refuses.
    """
    sums = "SELECT sha256 FROM campaign WHERE name <> ? UNION ALL SELECT sha256 FROM run ORDER BY 1"
    with store.reading() as database:
        return sql.sum_of(*(str(text) for (text,) in database.execute(sums, (sql.SUMMARY,))))


def refuse_another(folder: Path, source: Source) -> Source | None:
    """What the campaign in a folder was made from, None where none has begun there.

    Args:
        folder: of the campaign.
        source: what the campaign was made from.

    Raises:
        ValueError: the folder is of another campaign; the message names what differs.

    Warns:
        UserWarning: a file of the script changed since the campaign began.
    """
    there = stored_source(folder)
    if there is not None and (differ := differences(there, source)):
        raise ValueError(
            f"folder {folder} belongs to another scene ({'; '.join(differ)}): "
            "give another folder, or the scene that it was started with"
        )
    if there is not None:
        before, now = table_of(there.beside, SCRIPTS), table_of(source.beside, SCRIPTS)
        for name in sorted(before.keys() & now.keys()):
            if before[name] != now[name]:
                warnings.warn(
                    f"the file that defines {name} is not as it was when the campaign in {folder} began: its samples "
                    "are of one campaign only if what they run did not change",
                    stacklevel=2,
                )
    return there


def _taken_lock(folder: Path) -> int:
    """Hold a campaign's folder, and write there who does; the file descriptor that holds it.

    Raises ValueError where another controller holds it, or where the lock is no regular file, OSError where the folder
    cannot be written.
    """
    path = folder / ".lock"
    # A link would have the text below written elsewhere, a pipe would wait for its other end.
    flags = os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
    descriptor = os.open(path, flags, 0o644)
    try:
        if not path.is_file():
            raise ValueError(f"{path} is no regular file: delete it")
        _hold(descriptor)
    except BaseException as error:
        os.close(descriptor)
        if isinstance(error, OSError) and error.errno in NO_LOCKS:
            raise ValueError(
                f"the file system of {folder} has no locks ({error.strerror}), by which one controller at a time has a "
                "folder: give a folder on a local disk, or have this one mounted with locks (NFS: lockd, Lustre: flock)"
            ) from error
        if not isinstance(error, BlockingIOError | PermissionError):
            raise
        raise ValueError(
            f"folder {folder} is held by another controller ({lock_holder(folder)}): "
            "wait for it, stop it, or give another folder"
        ) from error
    os.ftruncate(descriptor, 0)
    os.write(descriptor, f"process {os.getpid()} on {socket.gethostname()}".encode())
    return descriptor


def _hold(descriptor: int) -> None:
    """Lock a file until it is closed, which the system does when the process ends.

    BlockingIOError, or on Windows PermissionError, where another holds it.
    """
    if sys.platform == "win32":
        import msvcrt

        # A locked byte cannot be read there, so it is one far behind the text.
        os.lseek(descriptor, MOST_TEXT, os.SEEK_SET)
        msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        os.lseek(descriptor, 0, os.SEEK_SET)
    else:
        import fcntl

        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)


def lock_holder(folder: Path) -> str:
    """The process that took the lock last, in words: "process 123 on host".

    Args:
        folder: of the campaign.

    Raises:
        DamagedFile: the lock holds no text.
    """
    return short(files.read_plain(folder / ".lock", MOST_TEXT).decode(errors="replace").strip(), 200)


def _write_readme(folder: Path, source: Source) -> None:
    """Write into a campaign's folder what it is, where no such file is there; OSError where the disk refuses."""
    if os.path.lexists(folder / README):
        return
    name = source.tables.get("campaign" if source.text is None else "name")
    name = name.get("name") if isinstance(name, dict) else name
    title = printable(name) if isinstance(name, str) and name.strip() else "a campaign"
    python = f"Python {platform.python_version()} on {platform.system()} {platform.machine()}"
    software = ", ".join([python, *(f"{name} {number}" for name, number in package_versions().items())])
    versions = textwrap.fill(software, 110, initial_indent="  ", subsequent_indent="  ")
    text = Path(__file__).with_name("_readme.txt").read_text(encoding="utf-8")
    text = text.format(title=title, day=date.today().isoformat(), versions=versions)
    write_aside(folder / README, text.encode())
