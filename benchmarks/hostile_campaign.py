"""`python -m cooperative` with made-up runs: what kills and signals are tried on, as a program with workers of its own.

Workers import the main module too, so theirs are made up as well.
"""

import sys

from benchmarks import invented
from cooperative import _commands as command

SECONDS = 0.02
"""Of a made-up run."""

invented.invent(SECONDS)
# Made-up fields belong to no particles that could be drawn.
command.report = lambda folder, **_: f"{folder}"  # type: ignore[attr-defined]

if __name__ == "__main__":
    sys.exit(command.main())
