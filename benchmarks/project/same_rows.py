"""`python -m benchmarks.project.same_rows ONE OTHER`: whether two campaigns have the same rows.

Each is a folder of a campaign, or a table that `jaxmpm export --as table` wrote, of this state of the code or another.
The largest difference of each column is printed, over the column's largest value; the exit code is 1 where rows or
texts differ, or a number by more than `--most`.
"""

from __future__ import annotations

import argparse
import csv
import math
import sys
from pathlib import Path

TIMES = ("seconds",)
"""Columns that no two runs share."""

Table = dict[tuple[str, str], dict[str, str]]


def table_of(path: Path) -> Table:
    """Rows of a campaign by grid and sample."""
    if path.is_dir():
        from cooperative import export

        path = next(iter(export(path, ("table",))))
    with path.open(encoding="utf-8", newline="") as file:
        return {(row["grid"], row["sample"]): row for row in csv.DictReader(file)}


def differences(one: Table, other: Table) -> dict[str, float]:
    """Of each column the largest difference over its largest value; infinite where rows, columns or texts differ."""
    if one.keys() != other.keys():
        return {"rows": math.inf}
    names = dict.fromkeys(name for table in (one, other) for row in table.values() for name in row)
    return {name: _difference([(one[key].get(name), other[key].get(name)) for key in one]) for name in names
            if name not in TIMES}  # fmt: skip


def _difference(pairs: list[tuple[str | None, str | None]]) -> float:
    try:
        numbers = [(float(a), float(b)) for a, b in pairs if a != b]  # type: ignore[arg-type]
        largest = max((abs(float(a)) for a, _ in pairs if a), default=0.0) or 1.0
    except (TypeError, ValueError):
        return math.inf if any(a != b for a, b in pairs) else 0.0
    return max((abs(a - b) / largest for a, b in numbers), default=0.0)


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.project.same_rows", description=__doc__)
    parser.add_argument("one", type=Path, help="folder of a campaign, or its table")
    parser.add_argument("other", type=Path, help="another")
    parser.add_argument("--most", type=float, default=1e-6, help="largest difference that passes (%(default)g)")
    args = parser.parse_args(arguments)
    for path in (args.one, args.other):
        if not path.exists():
            parser.error(f"{path} does not exist: give the folder of a campaign, or its table")
    one, other = table_of(args.one), table_of(args.other)
    found = differences(one, other)
    for name, difference in found.items():
        print(f"{name:20} {difference:.2g}")
    print(f"{len(one)} rows, largest difference {max(found.values()):.2g}")
    return int(max(found.values()) > args.most)


if __name__ == "__main__":
    sys.exit(main())
