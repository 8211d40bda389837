"""Atomic files, and safe reading of files from unknown sources.

A file is written under a temporary name, synced and renamed, and its folder is synced too. A process killed at any
moment leaves either the whole file or none. A sealed file is HDF5 with a checksum of the rest at its start (in the user
block, which HDF5 readers skip). The checksum is verified before the HDF5 library opens the file: one flipped bit can
send that library into an endless loop.

The seal detects damage, not intent: anyone can write one. So every file is read as untrusted: it must be a regular
file, not a link or a pipe, and `Contents` gives only arrays and scalars stored in the file itself, never what it
refers to.
"""

from __future__ import annotations

import errno
import hashlib
import io
import os
import stat
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from math import prod
from pathlib import Path
from typing import TextIO

import h5py
import numpy as np

from foundation.text import printable, shown

USER_BLOCK = 512
MOST = 4 * 2**30
"""Largest size (bytes) of a file that is read; a larger one was not written by this project."""

Scalar = float | int | bool | str


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
    part = path.with_name(f".{path.name}.part")
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
        full = error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
        remedy = "make room" if full else "check the disk"
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


@contextmanager
def hdf5_aside(path: str | Path) -> Iterator[h5py.File]:
    """Yield an empty HDF5 file, which replaces a path on success.

    Args:
        path: file to write.

    Yields:
        The open file.

    Raises:
        OSError: If the system refuses, with its errno, the file's name and a remedy.
    """
    # HDF5 writes through a Python file, whose errors name the cause; its own driver hides that a disk is full.
    with aside(path) as part, open(part, "w+b") as raw:
        try:
            with h5py.File(raw, "w", libver=("v110", "v110")) as file:
                yield file
        except RuntimeError as error:
            raise OSError(errno.EIO, str(error)) from error


def write_sealed(path: str | Path, kind: str, schema: int, fill: Callable[[h5py.File], None]) -> None:
    """Write a sealed HDF5 file, whole or not at all.

    Args:
        path: file to write; an existing one is replaced.
        kind: of the content; the seal contains it.
        schema: version of the layout; the seal contains it.
        fill: writes the content into an open HDF5 file.

    Raises:
        OSError: If the system refuses, with its errno, the file's name and a remedy.
    """
    # The HDF5 image is made in memory and written as plain bytes, so that errors name the cause.
    image = io.BytesIO()
    with h5py.File(image, "w", libver=("v110", "v110"), userblock_size=USER_BLOCK) as file:
        fill(file)
    content = image.getbuffer()
    content[:USER_BLOCK] = seal(kind, schema, content[USER_BLOCK:])
    write_aside(path, content)


def seal(kind: str, schema: int, content: bytes | memoryview) -> bytes:
    """User block of a sealed file: kind, schema and the SHA-256 of everything after the block.

    Args:
        kind: of the content.
        schema: version of the layout.
        content: bytes after the user block.

    Returns:
        USER_BLOCK bytes.
    """
    text = f"{kind}, schema {schema}, SHA-256 of all after these {USER_BLOCK} bytes:\n"
    return (text + hashlib.sha256(content).hexdigest() + "\n").encode().ljust(USER_BLOCK, b"\0")


def read_plain(path: str | Path, most: int = MOST) -> bytes:
    """Bytes of a regular file; a pipe is not waited for.

    Args:
        path: file to read.
        most: largest size allowed (bytes).

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
            return file.read()
    finally:
        os.close(descriptor)


@dataclass
class Contents:
    """Arrays and scalars stored in an HDF5 file itself, read as untrusted.

    Every method raises DamagedFile for links, groups instead of arrays, external storage, virtual or compressed arrays,
    text instead of numbers, arrays of another dimension than required, and missing entries.

    Args:
        path: of the file, for messages.
        file: open HDF5 file.
        left: bytes that may still be read. It limits the total: arrays that share their storage could otherwise make
            more of a file than its size.
    """

    path: str | Path
    file: h5py.File
    left: int

    def names(self, group: str) -> list[str]:
        """Names in a group; each must be letters, digits, `_` and dots.

        Args:
            group: path in the file.

        Returns:
            The names.

        Raises:
            DamagedFile: If there is no such group, or a name has other characters.
        """
        names = list(self._group(group))
        for name in names:
            self._require(name.replace(".", "_").isidentifier(), f"{group} holds the name {shown(name)}")
        return names

    def array(self, group: str, name: str, *, dimensions: int | None = None, kinds: str = "biuf") -> np.ndarray:
        """An array of numbers.

        Args:
            group: path in the file.
            name: of the array in the group.
            dimensions: required number of axes, None for any.
            kinds: allowed kinds of its dtype, as NumPy's one-letter codes.

        Returns:
            The array.

        Raises:
            DamagedFile: If it is missing, of another kind or dimension, or larger than its storage.
        """
        dataset, where = self._dataset(group, name)
        self._require(dataset.dtype.kind in kinds, f"{where} holds {dataset.dtype}")
        self._require(dimensions in (None, dataset.ndim), f"{where} has shape {dataset.shape}")
        size = prod(dataset.shape) * dataset.dtype.itemsize
        self._require(size <= self.left, f"{where} has shape {dataset.shape}, more than the file holds")
        self._require(size == dataset.id.get_storage_size(), f"{where} is shorter than its shape {dataset.shape}")
        self.left -= size
        return dataset[()]

    def value(self, group: str, name: str) -> Scalar | np.ndarray:
        """A number, a printable text, or an array of numbers, whichever is stored.

        Args:
            group: path in the file.
            name: of the entry in the group.

        Returns:
            The value.

        Raises:
            DamagedFile: If it is missing or of another kind.
        """
        dataset, where = self._dataset(group, name)
        if h5py.check_string_dtype(dataset.dtype) and dataset.shape == ():
            return self._printable(dataset[()].decode(), where)
        values = self.array(group, name)
        return values if values.ndim else values.item()

    def scalars(self, group: str) -> dict[str, Scalar]:
        """All attributes of a group: numbers and printable texts.

        Args:
            group: path in the file.

        Returns:
            Values by name.

        Raises:
            DamagedFile: If an attribute is of another kind, or there is no such group.
        """
        parent = self._group(group)
        values: dict[str, Scalar] = {}
        for name in parent.attrs:
            self._require(name.isidentifier(), f"{group} holds the name {shown(name)}")
            self._require(parent.attrs.get_id(name).shape == (), f"{group}, {name} is no single value")
            value = parent.attrs[name]
            value = value.decode() if isinstance(value, bytes) else value
            value = value.item() if isinstance(value, np.generic) else value
            self._require(type(value) in (bool, int, float, str), f"{group}, {name} is no number and no text")
            values[name] = self._printable(value, f"{group}, {name}") if isinstance(value, str) else value
        return values

    def _dataset(self, group: str, name: str) -> tuple[h5py.Dataset, str]:
        """An array stored in this file, and its path for messages."""
        where = f"{group.rstrip('/')}/{name}"
        dataset = self._own(self._group(group), name, where)
        self._require(isinstance(dataset, h5py.Dataset) and dataset.shape is not None, f"{where} is no array")
        made = dataset.id.get_create_plist()
        as_it_stands = made.get_layout() in (h5py.h5d.COMPACT, h5py.h5d.CONTIGUOUS) and not made.get_external_count()
        self._require(as_it_stands, f"{where} is not stored in the file as it stands")
        return dataset, where

    def _group(self, path: str) -> h5py.Group:
        group: h5py.Group = self.file
        for name in path.split("/"):
            if name:
                group = self._own(group, name, path)
                self._require(isinstance(group, h5py.Group), f"{path} is no group")
        return group

    def _own(self, parent: h5py.Group, name: str, where: str) -> h5py.Group | h5py.Dataset:
        """The object of this name in a group, which must be stored in this file."""
        link = parent.get(name, getlink=True)
        self._require(link is not None, f"it lacks {where}")
        self._require(type(link) is h5py.HardLink, f"{where} is a link to something else")
        return parent[name]

    def _printable(self, text: str, where: str) -> str:
        self._require(text.isprintable(), f"{where} is no text that can be printed")
        return text

    def _require(self, holds: object, why: str) -> None:
        if not holds:
            raise DamagedFile(f"{self.path} is damaged: {why}")


@contextmanager
def contents(path: str | Path, data: bytes) -> Iterator[Contents]:
    """Open the contents of an HDF5 file.

    Args:
        path: of the file, for messages.
        data: its bytes.

    Yields:
        The contents.

    Raises:
        DamagedFile: If opening or reading fails for any reason.
    """
    try:
        with h5py.File(io.BytesIO(data), "r") as file:
            yield Contents(path, file, len(data))
    except DamagedFile:
        raise
    except (OSError, KeyError, TypeError, ValueError, RuntimeError, OverflowError, MemoryError) as error:
        raise DamagedFile(f"{path} is damaged: {error}") from error


@contextmanager
def read_sealed(path: str | Path, kind: str, schema: int) -> Iterator[Contents]:
    """Open a sealed file after verifying its checksum.

    Args:
        path: file to read.
        kind: required kind.
        schema: required version of the layout.

    Yields:
        The contents.

    Raises:
        DamagedFile: If kind, schema or checksum differ, or the block reads an entry that is missing.
        OSError: If it does not exist or the system refuses.
    """
    data = read_plain(path)
    if not data.startswith(kind.encode()):
        raise DamagedFile(f"{path} is not a {kind} file")
    if data[:USER_BLOCK] != seal(kind, schema, memoryview(data)[USER_BLOCK:]):
        raise DamagedFile(f"{path} does not match its checksum, or is not of schema {schema}")
    with contents(path, data) as opened:
        yield opened


def set_aside(path: Path) -> Path:
    """Rename a damaged file, link or folder to `*.damaged`, so that it is preserved under a name that is not used.

    Args:
        path: to rename.

    Returns:
        The new path.

    Raises:
        OSError: If the system refuses.
    """
    target, again = path.with_name(path.name + ".damaged"), 1
    while os.path.lexists(target):
        target, again = path.with_name(f"{path.name}.{again}.damaged"), again + 1
    os.rename(path, target)
    return target


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
    if path.is_symlink() or (path.exists() and not path.is_dir()):
        raise ValueError(f"{path} is a link or a file, not a folder: move it away")
    path.mkdir(parents=True, exist_ok=True)
    return path


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
