"""Rows of `benchmarks/speed/on_gpu.sh`, and their table: `python -m benchmarks.speed.on_gpu_rows rows.jsonl`.

It exits with 1 if a row has failed, else with 2 if a part was stopped or left no row, else with 0.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

COLUMNS = ("what", "unit", "ours", "XLA's", "ratio", "bound", "result")


def row(
    what: str, ours: float, xla: float | None = None, *, unit: str = "", at_most: float | None = None, of: str = "ours"
) -> dict[str, Any]:
    """A figure, XLA's beside it, and whether what is bounded, `ours` or the `ratio`, is at most its bound."""
    given: dict[str, Any] = {"what": what, "unit": unit, "ours": ours, "XLA's": xla, "ratio": xla and ours / xla}
    if at_most is None:
        return given | {"result": "none"}
    result = "pass" if given[of] is not None and given[of] <= at_most else "fail"
    return given | {"bound": f"{of} <= {at_most:g}", "result": result}


def table(rows: Iterable[Mapping[str, Any]]) -> str:
    """Rows in columns of even width."""
    lines = [COLUMNS, *([_text(each.get(column)) for column in COLUMNS] for each in rows)]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    return "\n".join("  ".join(map(str.ljust, line, widths)).rstrip() for line in lines)


def _text(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else "" if value is None else str(value)


def code(rows: Iterable[Mapping[str, Any]]) -> int:
    """The exit code that rows ask for."""
    results = {each["result"] for each in rows}
    return 1 if "fail" in results else 2 if "stopped" in results or not results else 0


def main(path: Path) -> int:
    """Print the table of a file; its exit code."""
    rows = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []
    print(table(rows))
    return code(rows)


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
