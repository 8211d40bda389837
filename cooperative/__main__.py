"""`python -m cooperative run SCENE.toml --out DIR` and `python -m cooperative report DIR`."""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

import jax

from cooperative import campaign
from cooperative.report import report


def default_workers() -> int:
    """One process per core on CPU; on other devices one process for all lanes."""
    return len(os.sched_getaffinity(0)) if jax.default_backend() == "cpu" else 1


def main(arguments: list[str] | None = None) -> int:
    """Run the command; errors of the user's making are one line on stderr and exit code 2."""
    parser = argparse.ArgumentParser(prog="python -m cooperative", description="Campaigns of random slopes.")
    commands = parser.add_subparsers(dest="command", required=True)
    run = commands.add_parser("run", help="run a campaign, or go on where it was")
    run.add_argument("scene", type=Path, help="scene in TOML")
    run.add_argument("--out", type=Path, required=True, help="folder of the campaign")
    run.add_argument("--workers", type=int, default=default_workers(), help="processes to run samples in (%(default)s)")
    show = commands.add_parser("report", help="draw the figures of a campaign and print its summary")
    show.add_argument("folder", type=Path, help="folder of the campaign")
    given = parser.parse_args(arguments)
    try:
        if given.command == "run":
            campaign.run(given.scene.read_text(), given.out, workers=given.workers, progress=True)
        print(report(given.out if given.command == "run" else given.folder))
    except (ValueError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("stopped; the same command goes on from here", file=sys.stderr)
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
