"""Files that are whole or not there at all, and that say so themselves.

A file is written aside, synced and renamed, and its folder is synced too, so that a process killed at any moment leaves
either the whole file or none. A sealed file is HDF5 with a checksum of all the rest at its start (in the user block,
which HDF5 readers skip). It is checked before the HDF5 library sees the file: one flipped bit can send that library
into a loop.
"""

from __future__ import annotations

import errno
import hashlib
import io
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import h5py

USER_BLOCK = 512


class DamagedFile(ValueError):
    """A file that is truncated, altered, or something else than asked for; the message names it and says why."""


@contextmanager
def aside(path: str | Path) -> Iterator[Path]:
    """Give the name of a file to write beside `path`; it takes the place of `path`, whole, if all goes well.

    Raises OSError with the system's errno, the file's name and a remedy; what was there before stays, and no half file.
    """
    path = Path(path)
    part = path.with_name(f".{path.name}.part")
    try:
        yield part
        _sync(part)
        os.replace(part, path)
        _sync(path.parent)
    except OSError as error:
        reason = error.strerror or str(error)
        full = error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
        remedy = "make room" if full else "see to the disk"
        raise OSError(
            error.errno, f"cannot write {path} ({reason}): {remedy} and start the same command again"
        ) from error
    finally:
        part.unlink(missing_ok=True)


def write_aside(path: str | Path, data: bytes | memoryview) -> None:
    """Write `data` to `path`, whole or not at all; raises what `aside` raises."""
    with aside(path) as part:
        part.write_bytes(data)


def write_sealed(path: str | Path, kind: str, schema: int, fill: Callable[[h5py.File], None]) -> None:
    """Write the HDF5 file that `fill` fills, sealed and whole or not at all; raises what `aside` raises."""
    # The HDF5 image is made in memory: the disk then sees plain writes, whose errors are plain too.
    image = io.BytesIO()
    with h5py.File(image, "w", libver=("v110", "v110"), userblock_size=USER_BLOCK) as file:
        fill(file)
    content = image.getbuffer()
    content[:USER_BLOCK] = _seal(kind, schema, content[USER_BLOCK:])
    write_aside(path, content)


@contextmanager
def read_sealed(path: str | Path, kind: str, schema: int) -> Iterator[h5py.File]:
    """Open a sealed file, checked. DamagedFile if it cannot be trusted or lacks what is asked of it inside."""
    data = Path(path).read_bytes()
    if not data.startswith(kind.encode()):
        raise DamagedFile(f"{path} is not a {kind} file")
    if data[:USER_BLOCK] != _seal(kind, schema, memoryview(data)[USER_BLOCK:]):
        raise DamagedFile(f"{path} does not match its checksum, or is not of schema {schema}")
    try:
        with h5py.File(io.BytesIO(data), "r") as file:
            yield file
    except (OSError, KeyError, RuntimeError) as error:
        raise DamagedFile(f"{path} lacks what a {kind} file holds ({error})") from error


def _seal(kind: str, schema: int, content: memoryview) -> bytes:
    """User block: what the file is and the SHA-256 of everything after the block."""
    text = f"{kind}, schema {schema}, SHA-256 of all after these {USER_BLOCK} bytes:\n"
    return (text + hashlib.sha256(content).hexdigest() + "\n").encode().ljust(USER_BLOCK, b"\0")


def _sync(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
