"""One controller at a time: a lock that the system frees when its process ends."""

from __future__ import annotations

import os
import socket
import sys
from pathlib import Path

from cooperative.store._source import MOST_TEXT
from foundation import files
from foundation.text import short


def take_lock(folder: Path) -> int:
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
        held = _hold(descriptor)
    except BaseException:
        os.close(descriptor)
        raise
    if not held:
        os.close(descriptor)
        raise ValueError(
            f"folder {folder} is held by another controller ({lock_holder(folder)}): "
            "wait for it, stop it, or give another folder"
        )
    os.ftruncate(descriptor, 0)
    os.write(descriptor, f"process {os.getpid()} on {socket.gethostname()}".encode())
    return descriptor


def _hold(descriptor: int) -> bool:
    """Lock a file until it is closed, which the system does when the process ends; False where another holds it."""
    try:
        if sys.platform == "win32":
            import msvcrt

            # A locked byte cannot be read there, so it is one far behind the text.
            os.lseek(descriptor, MOST_TEXT, os.SEEK_SET)
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
            os.lseek(descriptor, 0, os.SEEK_SET)
        else:
            import fcntl

            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):
        return False
    return True


def lock_holder(folder: Path) -> str:
    """What the lock says of who took it last: "process 123 on host". DamagedFile or OSError where it says nothing."""
    return short(files.read_plain(folder / ".lock", MOST_TEXT).decode(errors="replace").strip(), 200)
