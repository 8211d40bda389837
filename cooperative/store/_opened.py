"""A campaign's folder, opened to write or to read.

One controller has it at a time, by a lock that the system frees when its process ends. A README describes the folder to
whoever opens it in five years.
"""

from __future__ import annotations

import errno
import os
import platform
import socket
import sys
import textwrap
from collections.abc import Collection, Mapping
from datetime import date
from functools import cache
from importlib.metadata import version
from pathlib import Path

from cooperative.names import GRIDS
from cooperative.store._samples import SLIDES, Store
from cooperative.store._source import CAMPAIGN, MOST_TEXT, Source, refuse_another, stored_source
from jaxmpm import __version__
from jaxmpm.support import files
from jaxmpm.support.files import write_aside
from jaxmpm.support.text import printable, short, shown

NO_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP, errno.ENOTSUP)
"""What file systems answer that have no locks."""
README = "README.txt"
"""Made from `_readme.txt`, which describes each file by its content, whichever of them there are."""


def open_store(
    folder: str | Path, source: Source | str, *, verify: bool = False, grids: Collection[str] = GRIDS
) -> Store:
    """Open the campaign folder for the one controller, made if it is not there.

    Args:
        folder: of the campaign.
        source: what the campaign is made from, or a scene's text alone.
        verify: read and verify every sample's file anew, those too that have not changed since they were verified.
        grids: of the campaign.

    Raises:
        ValueError: the folder cannot be written, holds something else or a campaign of another scene (naming what
            differs), or is held by another controller.
    """
    folder, source = Path(folder), Source(source) if isinstance(source, str) else source
    source.digest  # noqa: B018, no folder is made for a text that is no scene
    try:
        folder.mkdir(parents=True, exist_ok=True)
        others = [entry.name for entry in folder.iterdir() if not entry.name.startswith(".")]
        there = refuse_another(folder, source)
        if there is None and set(others) - {CAMPAIGN}:
            raise ValueError(
                f"folder {folder} holds {shown(sorted(set(others) - {CAMPAIGN})[0])}, and no campaign has begun there: "
                "give a new or empty folder"
            )
        lock = _taken_lock(folder)
    except OSError as error:
        raise ValueError(
            f"folder {folder} cannot be written ({error.strerror}): give a folder that you may write to"
        ) from error
    try:
        # Another controller may have begun since, and ended.
        there = refuse_another(folder, source)
        if there is None:
            source.write(folder)
        _write_readme(folder, source)
        for directory in (folder / "samples", *(folder / "samples" / grid for grid in (*grids, SLIDES))):
            files.claimed_folder(directory)
            for leftover in directory.glob(".*.part"):
                leftover.unlink()
        for leftover in (*folder.glob(".*.part"), *folder.glob("figures/.*.part")):
            leftover.unlink(missing_ok=True)
        # An index that is a folder is set aside when it is read.
        for index in (folder / "samples").glob("*.index") if verify else ():
            if not index.is_dir():
                index.unlink()
        return Store(folder, there or source, lock)
    except BaseException:
        os.close(lock)
        raise


def read_store(folder: str | Path) -> Store:
    """Open a campaign folder for reading, whether or not a controller holds it.

    Args:
        folder: of the campaign.

    Raises:
        ValueError: the folder holds no campaign.
    """
    source = stored_source(Path(folder))
    if source is None:
        raise ValueError(f"folder {folder} holds no campaign: give the folder of one, of a sweep one in its campaigns/")
    return Store(Path(folder), source, None)


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


@cache
def package_versions() -> Mapping[str, str]:
    """Versions of the packages that a result depends on."""
    return {"jaxmpm": __version__} | {name: version(name) for name in ("jax", "jaxlib", "numpy", "scipy", "h5py")}
