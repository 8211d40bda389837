"""`python -m benchmarks NAME [--json] [--quick] [--keep]`: run one, print its figures; `--keep` for RESULTS.md too.

Without `--keep` no file of the repository changes. `public` takes the folder of others' data by `--data`, and
`peer_mpm3d` the solver of others by `--binary`."""

from __future__ import annotations

import argparse
import inspect
import sys
from pathlib import Path

from benchmarks.measure import Refused, Report, as_json
from benchmarks.results import BENCHMARKS, SHORT, keep, module, run_all


def _table(report: Report) -> str:
    lines = [f"{name}: {value}" for name, value in report.values.items()]
    for row in report.rows:
        lines.append("  ".join(f"{key}={value}" for key, value in row.items()))
    return "\n".join(lines)


def main() -> int:
    """Parse the command line, run the benchmark, print it for people or as one JSON object."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("name", metavar="NAME", choices=(*BENCHMARKS, "all"), help=", ".join((*BENCHMARKS, "all")))
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--quick", action="store_true", help="smaller and coarser, to see that it runs")
    parser.add_argument("--keep", action="store_true", help="put the answer into RESULTS.md and draw its pictures")
    parser.add_argument(
        "--data",
        type=Path,
        metavar="FOLDER",
        help="of others' data; sources: docs/notes/verification.md",
    )
    parser.add_argument("--binary", type=Path, metavar="PATH", help="program of others that a benchmark runs")
    parser.add_argument("--only", nargs="+", metavar="NAME", help="beginnings of the names of cases to run")
    parser.add_argument("--seed", type=int, metavar="N", help="by which a benchmark draws its cases")
    parser.add_argument("--count", type=int, metavar="N", help="of cases that it draws")
    arguments = parser.parse_args()
    if arguments.keep and arguments.quick:
        parser.error("--keep and --quick: RESULTS.md holds whole runs, leave one of them out")
    if arguments.name == "all":
        failed = run_all(SHORT)
        print("\n".join(["benchmarks/RESULTS.md written", *(f"failed: {line}" for line in failed)]))
        return 1 if failed else 0
    run = module(arguments.name).run
    given = {name: getattr(arguments, name) for name in ("data", "binary", "only", "seed", "count")}
    options = {name: value for name, value in given.items() if value is not None}
    for name in options.keys() - inspect.signature(run).parameters.keys():
        parser.error(f"{arguments.name} takes no --{name}: leave it out")
    try:
        report: Report = run(quick=arguments.quick, **options)
    except Refused as why:
        parser.error(str(why))
    answer = as_json(arguments.name, report)
    print(answer if arguments.json else _table(report))
    if arguments.keep:
        keep(answer, report.draw)
    return 0


if __name__ == "__main__":
    sys.exit(main())
