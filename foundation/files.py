"""Files that are whole or not there at all, and files that nobody vouches for.

A file is written aside, synced and renamed, and its folder is synced too, so that a process killed at any moment leaves
either the whole file or none. A sealed file is HDF5 with a checksum of all the rest at its start (in the user block,
which HDF5 readers skip). It is checked before the HDF5 library sees the file: one flipped bit can send that library
into a loop.

The seal tells damage, not intent: anyone can make one. So a file is read as if a stranger had written it: it has to be
a regular file, no link and no pipe, and `Contents` gives only arrays and scalars that lie in it, never what it refers
to.
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
"""Bytes beyond which a file is none of ours: it would not fit into memory beside what it is read for."""

Scalar = float | int | bool | str


class DamagedFile(ValueError):
    """A file that is truncated, altered, or something else than asked for; the message names it and says why, in one
    line."""

    def __init__(self, message: str) -> None:
        # Names of files, and what the HDF5 library says, may hold anything.
        super().__init__(printable(message))


@contextmanager
def aside(path: str | Path) -> Iterator[Path]:
    """Give the name of a file to write beside `path`; it takes the place of `path`, whole, if all goes well.

    Raises OSError with the system's errno, the file's name and a remedy; what was there before stays, and no half file.
    """
    path = Path(path)
    part = path.with_name(f".{path.name}.part")
    try:
        with explained(path):
            # What a killed process left, or a link that leads elsewhere.
            part.unlink(missing_ok=True)
            yield part
            _sync(part)
            os.replace(part, path)
            _sync(path.parent)
    finally:
        part.unlink(missing_ok=True)


@contextmanager
def explained(path: Path) -> Iterator[None]:
    """Raise an OSError of what writes `path` with the system's errno, the file's name and a remedy."""
    try:
        yield
    except OSError as error:
        reason = os.strerror(error.errno) if error.errno else str(error)
        full = error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
        remedy = "make room" if full else "see to the disk"
        raise OSError(
            error.errno, f"cannot write {path} ({reason}): {remedy} and start the same command again"
        ) from error


def write_aside(path: str | Path, data: bytes | memoryview) -> None:
    """Write `data` to `path`, whole or not at all; raises what `aside` raises."""
    with aside(path) as part:
        part.write_bytes(data)


@contextmanager
def append_to(path: Path) -> Iterator[TextIO]:
    """Open a text to add to at its end, made if it is not there. A link, a folder or a pipe in its place is set aside:
    what is written there would land elsewhere. OSError where the system refuses."""
    if os.path.lexists(path) and not stat.S_ISREG(os.lstat(path).st_mode):
        set_aside(path)
    descriptor = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o644)
    with open(descriptor, "a", encoding="utf-8") as file:
        yield file


@contextmanager
def hdf5_aside(path: str | Path) -> Iterator[h5py.File]:
    """Give an empty HDF5 file to fill, which takes the place of `path` if all goes well; raises what `aside` raises."""
    # The library writes through a file of ours, whose errors are plain; its own would hide that a disk is full.
    with aside(path) as part, open(part, "w+b") as raw:
        try:
            with h5py.File(raw, "w", libver=("v110", "v110")) as file:
                yield file
        except RuntimeError as error:
            raise OSError(errno.EIO, str(error)) from error


def write_sealed(path: str | Path, kind: str, schema: int, fill: Callable[[h5py.File], None]) -> None:
    """Write the HDF5 file that `fill` fills, sealed and whole or not at all; raises what `aside` raises."""
    # The HDF5 image is made in memory: the disk then sees plain writes, whose errors are plain too.
    image = io.BytesIO()
    with h5py.File(image, "w", libver=("v110", "v110"), userblock_size=USER_BLOCK) as file:
        fill(file)
    content = image.getbuffer()
    content[:USER_BLOCK] = seal(kind, schema, content[USER_BLOCK:])
    write_aside(path, content)


def seal(kind: str, schema: int, content: bytes | memoryview) -> bytes:
    """User block: what the file is and the SHA-256 of everything after the block."""
    text = f"{kind}, schema {schema}, SHA-256 of all after these {USER_BLOCK} bytes:\n"
    return (text + hashlib.sha256(content).hexdigest() + "\n").encode().ljust(USER_BLOCK, b"\0")


def read_plain(path: str | Path, most: int = MOST) -> bytes:
    """Bytes of a regular file. DamagedFile for a link, a folder, a pipe, or more than `most` bytes.

    FileNotFoundError where there is nothing, OSError where the system refuses; nothing waits for a pipe's other end.
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
    """What an HDF5 file holds itself, read as if a stranger had written it.

    Every method raises DamagedFile for links, groups in the place of arrays, storage elsewhere, virtual or compressed
    arrays, text for numbers, arrays of other dimensions than asked for, and what is missing. left: bytes that may yet
    be read: arrays that share their storage cannot make more of a file than it is.
    """

    path: str | Path
    file: h5py.File
    left: int

    def names(self, group: str) -> list[str]:
        """Names in a group, which are names: letters, digits, `_` and dots."""
        found = list(self._group(group))
        for name in found:
            self._require(name.replace(".", "_").isidentifier(), f"{group} holds the name {shown(name)}")
        return found

    def array(self, group: str, name: str, *, dimensions: int | None = None, kinds: str = "biuf") -> np.ndarray:
        """An array of numbers. dimensions: how many it has to have. kinds: of its dtype, as NumPy calls them."""
        found, where = self._dataset(group, name)
        self._require(found.dtype.kind in kinds, f"{where} holds {found.dtype}")
        self._require(dimensions in (None, found.ndim), f"{where} has shape {found.shape}")
        size = prod(found.shape) * found.dtype.itemsize
        self._require(size <= self.left, f"{where} has shape {found.shape}, more than the file holds")
        self._require(size == found.id.get_storage_size(), f"{where} is shorter than its shape {found.shape}")
        self.left -= size
        return found[()]

    def value(self, group: str, name: str) -> Scalar | np.ndarray:
        """A number, a text that can be printed, or an array of numbers, whichever stands there."""
        found, where = self._dataset(group, name)
        if h5py.check_string_dtype(found.dtype) and found.shape == ():
            return self._printable(found[()].decode(), where)
        values = self.array(group, name)
        return values if values.ndim else values.item()

    def scalars(self, group: str) -> dict[str, Scalar]:
        """All attributes of a group: numbers, and texts that can be printed."""
        parent = self._group(group)
        found: dict[str, Scalar] = {}
        for name in parent.attrs:
            self._require(name.isidentifier(), f"{group} holds the name {shown(name)}")
            self._require(parent.attrs.get_id(name).shape == (), f"{group}, {name} is no single value")
            value = parent.attrs[name]
            value = value.decode() if isinstance(value, bytes) else value
            value = value.item() if isinstance(value, np.generic) else value
            self._require(type(value) in (bool, int, float, str), f"{group}, {name} is no number and no text")
            found[name] = self._printable(value, f"{group}, {name}") if isinstance(value, str) else value
        return found

    def _dataset(self, group: str, name: str) -> tuple[h5py.Dataset, str]:
        """An array as it stands in this file, and how messages call it."""
        where = f"{group.rstrip('/')}/{name}"
        found = self._own(self._group(group), name, where)
        self._require(isinstance(found, h5py.Dataset) and found.shape is not None, f"{where} is no array")
        made = found.id.get_create_plist()
        as_it_stands = made.get_layout() in (h5py.h5d.COMPACT, h5py.h5d.CONTIGUOUS) and not made.get_external_count()
        self._require(as_it_stands, f"{where} is not stored in the file as it stands")
        return found, where

    def _group(self, path: str) -> h5py.Group:
        found: h5py.Group = self.file
        for name in path.split("/"):
            if name:
                found = self._own(found, name, path)
                self._require(isinstance(found, h5py.Group), f"{path} is no group")
        return found

    def _own(self, parent: h5py.Group, name: str, where: str) -> h5py.Group | h5py.Dataset:
        """What a name in a group stands for, which has to lie in this file."""
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
    """The contents of an HDF5 file, whose bytes are `data`; DamagedFile for whatever goes wrong as they are read."""
    try:
        with h5py.File(io.BytesIO(data), "r") as file:
            yield Contents(path, file, len(data))
    except DamagedFile:
        raise
    except (OSError, KeyError, TypeError, ValueError, RuntimeError, OverflowError, MemoryError) as error:
        raise DamagedFile(f"{path} is damaged: {error}") from error


@contextmanager
def read_sealed(path: str | Path, kind: str, schema: int) -> Iterator[Contents]:
    """Open a sealed file, checked. DamagedFile if it cannot be trusted or lacks what is asked of it inside."""
    data = read_plain(path)
    if not data.startswith(kind.encode()):
        raise DamagedFile(f"{path} is not a {kind} file")
    if data[:USER_BLOCK] != seal(kind, schema, memoryview(data)[USER_BLOCK:]):
        raise DamagedFile(f"{path} does not match its checksum, or is not of schema {schema}")
    with contents(path, data) as found:
        yield found


def set_aside(path: Path) -> Path:
    """Rename what is damaged, a file, a link or a folder, to `*.damaged`: it is kept, and in nobody's way."""
    target, again = path.with_name(path.name + ".damaged"), 1
    while os.path.lexists(target):
        target, again = path.with_name(f"{path.name}.{again}.damaged"), again + 1
    os.rename(path, target)
    return target


def own_folder(path: Path) -> Path:
    """Make a folder where there is none yet. ValueError for a link or a file in its place: what is written there would
    land elsewhere."""
    if path.is_symlink() or (path.exists() and not path.is_dir()):
        raise ValueError(f"{path} is a link or a file, not a folder: move it away")
    path.mkdir(parents=True, exist_ok=True)
    return path


def claimed_folder(path: Path) -> Path:
    """Make a folder where there is none yet; a link or a file in its place is set aside, with a warning."""
    if path.is_symlink() or (path.exists() and not path.is_dir()):
        warnings.warn(f"{path} is a link or a file, not a folder: set aside as {set_aside(path)}", stacklevel=3)
    return own_folder(path)


def _sync(path: Path) -> None:
    if os.name == "nt" and path.is_dir():
        return  # Windows knows no sync of folders.
    descriptor = os.open(path, os.O_RDWR if os.name == "nt" else os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
