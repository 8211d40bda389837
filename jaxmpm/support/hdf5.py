"""Sealed HDF5 files, and safe reading of HDF5 files from unknown sources.

A sealed file is HDF5 with a checksum of the rest at its start, in the user block, which HDF5 readers skip. The
checksum is verified before the HDF5 library opens the file: one flipped bit can send that library into an endless loop.

The seal detects damage, not intent: anyone can write one. So every file is read as untrusted: `Contents` gives only
arrays and scalars stored in the file itself, never what it refers to.
"""

from __future__ import annotations

import errno
import hashlib
import io
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from math import prod
from pathlib import Path

import h5py
import numpy as np

from jaxmpm.support.files import DamagedFile, aside, read_plain, write_aside
from jaxmpm.support.text import shown

USER_BLOCK = 512


Scalar = float | int | bool | str


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


@dataclass
class Contents:
    """Arrays and scalars stored in an HDF5 file itself, read as untrusted.

    Every method raises DamagedFile for links, groups instead of arrays, external storage, virtual or compressed arrays,
    text instead of numbers, arrays of another dimension than required, and missing entries.

    Args:
        path: of the file, for messages.
        file: open HDF5 file.
        remaining: bytes that may still be read. It limits the total: arrays that share their storage could otherwise
            make more of a file than its size.
    """

    path: str | Path
    file: h5py.File
    remaining: int

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
        self._require(size <= self.remaining, f"{where} has shape {dataset.shape}, more than the file holds")
        self._require(size == dataset.id.get_storage_size(), f"{where} is shorter than its shape {dataset.shape}")
        self.remaining -= size
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
        dataset = self._member(self._group(group), name, where)
        self._require(isinstance(dataset, h5py.Dataset) and dataset.shape is not None, f"{where} is no array")
        made = dataset.id.get_create_plist()
        as_it_stands = made.get_layout() in (h5py.h5d.COMPACT, h5py.h5d.CONTIGUOUS) and not made.get_external_count()
        self._require(as_it_stands, f"{where} is not stored in the file as it stands")
        return dataset, where

    def _group(self, path: str) -> h5py.Group:
        group: h5py.Group = self.file
        for name in path.split("/"):
            if name:
                group = self._member(group, name, path)
                self._require(isinstance(group, h5py.Group), f"{path} is no group")
        return group

    def _member(self, parent: h5py.Group, name: str, where: str) -> h5py.Group | h5py.Dataset:
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
