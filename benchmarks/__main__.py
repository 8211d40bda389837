"""`python -m benchmarks NAME [--json] [--quick]`: run one benchmark and print its figures."""

from __future__ import annotations

import argparse
import importlib

from benchmarks.measure import Report, as_json

# Each module has `run(quick: bool) -> Report`; the order is that of RESULTS.md.
NAMES = ("slope", "fields", "estimators")


def _table(report: Report) -> str:
    lines = [f"{name}: {value}" for name, value in report.values.items()]
    for row in report.rows:
        lines.append("  ".join(f"{key}={value}" for key, value in row.items()))
    return "\n".join(lines)


def main() -> None:
    """Parse the command line, run the benchmark, print it for people or as one JSON object."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("name", choices=NAMES)
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--quick", action="store_true", help="smaller and coarser, to see that it runs")
    arguments = parser.parse_args()
    report: Report = importlib.import_module(f"benchmarks.{arguments.name}").run(quick=arguments.quick)
    print(as_json(arguments.name, report) if arguments.json else _table(report))


if __name__ == "__main__":
    main()
