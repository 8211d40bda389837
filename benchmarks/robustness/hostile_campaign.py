"""`python -m cooperative` with made-up runs: what kills and signals are tried on, as a program with workers of its own.

Workers import the main module too, so theirs are made up as well.
"""

import os
import signal
import sys
from multiprocessing import connection, parent_process
from pathlib import Path

from benchmarks.robustness import invented
from cooperative import reporting
from cooperative.__main__ import main
from cooperative.store import _runs

SECONDS = 0.02
"""Of a made-up run."""


def torn(whole: object = connection.Connection._send) -> None:  # type: ignore[attr-defined]
    """Have this worker look for such a file whenever it sends what is as long as a sample; it removes that first."""

    def send(self: object, data: memoryview, *write: object) -> None:
        for file in Path(os.environ[invented.TORN]).iterdir() if len(data) > 10_000 else ():
            try:
                file.unlink()
            except FileNotFoundError:
                continue  # another worker was faster
            whole(self, data[: len(data) // 2], *write)  # type: ignore[operator]
            os.kill(os.getpid(), signal.SIGKILL)
        whole(self, data, *write)  # type: ignore[operator]

    connection.Connection._send = send  # type: ignore[attr-defined]


def counted(path: Path) -> bytes:
    """The bytes of a file of fields, once that is noted."""
    with open(os.environ[invented.VERIFIED], "ab") as file:
        file.write(b".")
    return READ(path)


READ = _runs.read_fields_file
if invented.VERIFIED in os.environ:
    _runs.read_fields_file = counted
if parent_process() is not None and invented.TORN in os.environ:
    torn()
invented.invent(SECONDS)
# Made-up fields belong to no particles that could be drawn.
reporting.report = lambda folder, **_: f"{folder}"  # type: ignore[assignment]

if __name__ == "__main__":
    sys.exit(main())
