"""Atomic files, and reading of files from unknown sources.

A file is written under a temporary name, synced and renamed, and its folder is synced too. A process killed at any
moment leaves either the whole file or none. A file that is read must be a regular file, not a link or a pipe.
"""

from __future__ import annotations

import errno
import os
import shutil
import stat
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TextIO

from jaxmpm.support.text import printable

MOST = 4 * 2**30
"""Largest size (bytes) of a file that is read; a larger one was not written by this project."""


class DamagedFile(ValueError):
    """A file that is truncated, altered or of another kind than expected.

    Args:
        message: names the file and the reason; made one printable line.
    """

    def __init__(self, message: str) -> None:
        # Names of files and messages of the HDF5 library may contain any character.
        super().__init__(printable(message))


@contextmanager
def aside(path: str | Path) -> Iterator[Path]:
    """Yield a temporary name beside a path; on success the file written there replaces the path.

    If anything fails, the previous file stays and no partial file remains.

    Args:
        path: file to write.

    Yields:
        Path of the temporary file.

    Raises:
        OSError: If the system refuses, with its errno, the file's name and a remedy.
    """
    path = Path(path)
    part = path.with_name(f".{path.name}.{os.getpid()}.part")  # another process may write the same file
    try:
        with explained(path):
            # A leftover of a killed process, or a link to another file.
            part.unlink(missing_ok=True)
            yield part
            _sync(part)
            os.replace(part, path)
            _sync(path.parent)
    finally:
        part.unlink(missing_ok=True)


@contextmanager
def explained(path: Path) -> Iterator[None]:
    """Raise an OSError of the block with the system's errno, the file's name and a remedy.

    Args:
        path: file that the block writes.

    Yields:
        None.

    Raises:
        OSError: If the block raises one.
    """
    try:
        yield
    except OSError as error:
        reason = os.strerror(error.errno) if error.errno else str(error)
        if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
            remedy = "make room"
        elif error.errno in (errno.EROFS, errno.EACCES, errno.EPERM):
            remedy = "have it writable, or copy its folder to where you may write"
        else:
            remedy = "check the disk" if path.parent.is_dir() else f"make {path.parent}"
        raise OSError(
            error.errno, f"cannot write {path} ({reason}): {remedy} and start the same command again"
        ) from error


def write_aside(path: str | Path, data: bytes | memoryview) -> None:
    """Write a file, whole or not at all.

    Args:
        path: file to write; an existing one is replaced.
        data: its bytes.

    Raises:
        OSError: If the system refuses, with its errno, the file's name and a remedy.
    """
    with aside(path) as part:
        part.write_bytes(data)


@contextmanager
def append_to(path: Path) -> Iterator[TextIO]:
    """Open a text file to append to, made if it does not exist.

    A link, folder or pipe of this name is renamed first, because writing to it would change something else.

    Args:
        path: file to append to.

    Yields:
        The open file.

    Raises:
        OSError: If the system refuses.
    """
    if os.path.lexists(path) and not stat.S_ISREG(os.lstat(path).st_mode):
        set_aside(path)
    descriptor = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o644)
    with open(descriptor, "a", encoding="utf-8") as file:
        yield file


def read_plain(path: str | Path, most: int = MOST, *, first: int = -1, last: int | None = None) -> bytes:
    """Bytes of a regular file; a pipe is not waited for.

    Args:
        path: file to read.
        most: largest size allowed (bytes).
        first: number of bytes to read, -1 for all.
        last: number of bytes from the end of the file to read instead.

    Returns:
        Its bytes.

    Raises:
        DamagedFile: If it is a link, a folder or a pipe, has more than `most` bytes, or its name is not allowed.
        OSError: If it does not exist or the system refuses.
    """
    flags = os.O_RDONLY
    for name in ("O_NOFOLLOW", "O_NONBLOCK", "O_CLOEXEC", "O_BINARY"):
        flags |= getattr(os, name, 0)
    try:
        descriptor = os.open(path, flags)
    except OSError as error:
        if error.errno in (errno.ELOOP, errno.EMLINK, errno.ENXIO, errno.EISDIR):
            raise DamagedFile(f"{path} is no regular file") from error
        raise
    except ValueError as error:
        raise DamagedFile(f"{path} names no file ({error}): give a name that the system allows") from error
    try:
        about = os.fstat(descriptor)
        if not stat.S_ISREG(about.st_mode):
            raise DamagedFile(f"{path} is no regular file")
        if about.st_size > most:
            raise DamagedFile(f"{path} has {about.st_size} bytes, more than the {most} that such a file may have")
        with open(descriptor, "rb", closefd=False) as file:
            if last is not None:
                file.seek(max(about.st_size - last, 0))
            return file.read(first)
    finally:
        os.close(descriptor)


def read_given(path: Path, most: int) -> bytes:
    """Bytes of a regular file that a user names.

    Args:
        path: file to read.
        most: largest size allowed (bytes).

    Returns:
        Its bytes.

    Raises:
        ValueError: If it is no regular file or too large, or the system refuses.
    """
    try:
        return read_plain(path, most)
    except OSError as error:
        raise ValueError(f"{path} cannot be read ({error.strerror})") from error


def set_aside(path: Path) -> Path:
    """Rename a damaged file, link or folder to `*.damaged`, so that it is preserved under a name that is not used.

    Args:
        path: to rename.

    Returns:
        The new path.

    Raises:
        OSError: If the system refuses.
    """
    target = _unused(path)
    os.rename(path, target)
    return target


def copy_aside(path: Path) -> Path:
    """Copy a damaged file to `*.damaged`, under a name that is not used.

    Args:
        path: to copy.

    Returns:
        The path of the copy.

    Raises:
        OSError: If the system refuses.
    """
    target = _unused(path)
    with explained(target):
        return Path(shutil.copyfile(path, target))


def _unused(path: Path) -> Path:
    """A name for a damaged file beside it that is not used."""
    target, again = path.with_name(path.name + ".damaged"), 1
    while os.path.lexists(target):
        target, again = path.with_name(f"{path.name}.{again}.damaged"), again + 1
    return target


def not_linked(path: Path) -> Path:
    """Return the path of a folder that exists or may be made.

    Args:
        path: of the folder.

    Returns:
        The same path.

    Raises:
        ValueError: If it is a link or a file: data would be written elsewhere.
    """
    if path.is_symlink() or (path.exists() and not path.is_dir()):
        raise ValueError(f"{path} is a link or a file, not a folder: move it away")
    return path


def own_folder(path: Path) -> Path:
    """Make a folder, unless it exists.

    Args:
        path: of the folder.

    Returns:
        The same path.

    Raises:
        ValueError: If it is a link or a file: data would be written elsewhere.
        OSError: If the system refuses.
    """
    not_linked(path)
    with explained(path):
        path.mkdir(parents=True, exist_ok=True)
    return path


def remove_leftovers(folder: Path) -> None:
    """Remove what processes that were killed while they wrote left in a folder, see `aside`.

    A part stays whose process may still write it: one of its number runs here, or it changed in the last minute, as one
    of another machine does.

    Args:
        folder: which need not be there.
    """
    for part in folder.glob(".*.part"):
        with suppress(OSError):
            number = part.name.split(".")[-2]
            if number.isdecimal() and not _runs(int(number)) and time.time() - part.lstat().st_mtime > STILL:
                part.unlink()


STILL = 60.0
"""Seconds without a change, after which a part of a process that does not run here is a leftover."""


def _runs(process: int) -> bool:
    """Whether a process of this number runs here, as far as the system tells."""
    if os.name == "nt":  # where a signal of number 0 ends the process
        return False
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        return True
    return True


def claimed_folder(path: Path) -> Path:
    """Make a folder, unless it exists; a link or a file of this name is renamed first, with a warning.

    Args:
        path: of the folder.

    Returns:
        The same path.

    Raises:
        OSError: If the system refuses.
    """
    if path.is_symlink() or (path.exists() and not path.is_dir()):
        warnings.warn(f"{path} is a link or a file, not a folder: set aside as {set_aside(path)}", stacklevel=3)
    return own_folder(path)


def _sync(path: Path) -> None:
    if os.name == "nt" and path.is_dir():
        return  # Windows cannot sync folders.
    descriptor = os.open(path, os.O_RDWR if os.name == "nt" else os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def named_beside(path: Path, ending: str) -> Path | None:
    """The file beside another that has its name and another ending, in letters of any case.

    Args:
        path: of the file beside which it is looked for.
        ending: with its point, in small letters.

    Returns:
        The first by name; None without one.
    """
    named = (each for each in path.parent.glob("*") if each.stem == path.stem and each.suffix.lower() == ending)
    return min(named, default=None)
