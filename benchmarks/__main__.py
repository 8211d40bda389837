"""`python -m benchmarks NAME [--json] [--quick] [--keep]`: run one, print its figures; `--keep` for RESULTS.md too.

Without `--keep` no file of the repository changes."""

from __future__ import annotations

import argparse
import importlib
import sys

from benchmarks.measure import Report, as_json
from benchmarks.results import keep, run_all

# Each module has `run(quick: bool) -> Report`; the order is that of RESULTS.md.
NAMES = (
    "stability",
    "earthquakes",
    "work_precision",
    "slope",
    "throughput",
    "screening",
    "levers",
    "rest",
    "opened_soil",
    "leave_out",
    "fields",
    "estimators",
    "hazard",
    "gradients",
    "rare_events",
    "derivative_screening",
    "published",
    "docs",
)

# Of hours, or about no answer of the solver: not part of `all`.
LONG = ("campaign", "robustness", "stability_of_slopes", "limit_equilibrium", "random_slopes", "sites")


def _table(report: Report) -> str:
    lines = [f"{name}: {value}" for name, value in report.values.items()]
    for row in report.rows:
        lines.append("  ".join(f"{key}={value}" for key, value in row.items()))
    return "\n".join(lines)


def main() -> int:
    """Parse the command line, run the benchmark, print it for people or as one JSON object."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("name", choices=(*NAMES, *LONG, "all"))
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--quick", action="store_true", help="smaller and coarser, to see that it runs")
    parser.add_argument("--keep", action="store_true", help="put the answer into RESULTS.md and draw its pictures")
    arguments = parser.parse_args()
    if arguments.keep and arguments.quick:
        parser.error("--keep and --quick: RESULTS.md holds whole runs, leave one of them out")
    if arguments.name == "all":
        failed = run_all(NAMES)
        print("\n".join(["benchmarks/RESULTS.md written", *(f"failed: {line}" for line in failed)]))
        return 1 if failed else 0
    report: Report = importlib.import_module(f"benchmarks.{arguments.name}").run(quick=arguments.quick)
    answer = as_json(arguments.name, report)
    print(answer if arguments.json else _table(report))
    if arguments.keep:
        keep(answer, (*NAMES, *LONG), report.draw)
    return 0


if __name__ == "__main__":
    sys.exit(main())
