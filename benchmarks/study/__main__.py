"""`python -m benchmarks.study [PIECE ...]`: the published study in 3D, in pieces that go on where they were stopped.

A run is one row of a small CSV file, `study_PIECE.csv` in the folder, written as soon as the run has ended; a process
that is killed loses only the runs under way. `python -m benchmarks published` makes tables and verdicts of the files.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from benchmarks.study import study_slides
from benchmarks.study.study import DATA, FIGURES, carry_on, collect, progress, read_study
from benchmarks.study.study_pieces import PIECES
from benchmarks.study.study_table import merged


def main() -> int:
    """Parse the command line and go on with the study, collect rows, or list them."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.study", description=__doc__)
    parser.add_argument("pieces", nargs="*", metavar="PIECE", help=f"some of {', '.join(PIECES)}; all if none is named")
    parser.add_argument("--folder", type=Path, default=DATA, help="where the rows go (benchmarks/data)")
    parser.add_argument("--minutes", type=float, default=float("inf"), help="begin no run after as many")
    parser.add_argument("--workers", type=int, default=1, help="processes, each with its share of the cores")
    parser.add_argument("--lanes", type=int, default=1, help="runs that a process does side by side, for a GPU")
    parser.add_argument("--collect", type=Path, metavar="FOLDER", help="take over the rows there, run nothing")
    parser.add_argument("--draw", action="store_true", help="run and draw a typical slide of each mode, nothing else")
    parser.add_argument("--list", action="store_true", help="say what is there, run nothing")
    arguments = parser.parse_args()
    try:
        if arguments.collect is not None:
            print(collect(arguments.collect, arguments.folder) or "nothing new")
        elif arguments.draw:
            drawn = study_slides.draw(merged(read_study(arguments.folder).values()), FIGURES)
            print(*drawn.files, sep="\n")
            if drawn.broke_off:
                raise ValueError("\n".join(drawn.broke_off))
        elif arguments.list:
            print("\n".join(progress(arguments.folder)))
        else:
            carry_on(
                arguments.folder, arguments.pieces or list(PIECES), workers=arguments.workers, lanes=arguments.lanes,
                minutes=arguments.minutes,
            )  # fmt: skip
    except ValueError as error:
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
