"""`python -m benchmarks NAME [--json] [--quick]`: run one benchmark and print its figures; `all` writes RESULTS.md."""

from __future__ import annotations

import argparse
import importlib
import sys

from benchmarks.measure import ROOT, Report, as_json
from benchmarks.results import run_all

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
LONG = ("campaign", "robustness", "stability_of_slopes", "random_slopes", "sites")


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
    arguments = parser.parse_args()
    if arguments.name == "all":
        failed = run_all(NAMES, ROOT / "out" / "bench")
        print("\n".join(["benchmarks/RESULTS.md written", *(f"failed: {line}" for line in failed)]))
        return 1 if failed else 0
    report: Report = importlib.import_module(f"benchmarks.{arguments.name}").run(quick=arguments.quick)
    print(as_json(arguments.name, report) if arguments.json else _table(report))
    return 0


if __name__ == "__main__":
    sys.exit(main())
