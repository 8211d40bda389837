"""`benchmarks/RESULTS.md` from the stored answers: a page to judge by, and one for each benchmark in benchmarks/pages.

`python -m benchmarks NAME --keep` keeps the JSON of a benchmark in benchmarks/data/results and writes these pages anew,
so that each has the age that its own line gives. `python -m benchmarks.results` writes them alone.
"""

from __future__ import annotations

import importlib
import json
import subprocess
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from benchmarks.measure import ROOT
from benchmarks.summary import lead
from cooperative.store import write_aside

FOLDER = ROOT / "benchmarks" / "data" / "results"
FIGURES = ROOT / "benchmarks" / "figures"
PAGE = ROOT / "benchmarks" / "RESULTS.md"
PAGES = ROOT / "benchmarks" / "pages"

HEAD = """# Results

Each part by `python -m benchmarks NAME --keep` (`make bench`: all but those of hours), on the machine and day named
there. Machines are shared and noisy: times are medians, with smallest and largest beside them where they are small.
"""


# Room of each benchmark, a module with `run(quick: bool) -> Report`; the order is that of RESULTS.md.
SHORT = {
    "stability": "stability",
    "earthquakes": "accuracy",
    "seepage": "accuracy",
    "undrained": "accuracy",
    "work_precision": "accuracy",
    "slope": "accuracy",
    "throughput": "speed",
    "screening": "speed",
    "class_runs": "speed",
    "commands": "speed",
    "levers": "settings",
    "rest": "settings",
    "opened_soil": "settings",
    "averaged_friction": "settings",
    "sensitive_clay": "settings",
    "early": "settings",
    "leave_out": "speed",
    "fields": "accuracy",
    "estimators": "statistics",
    "nested": "statistics",
    "sweeps": "statistics",
    "hazard": "statistics",
    "gradients": "speed",
    "rare_events": "statistics",
    "derivative_screening": "statistics",
    "published": "study",
    "mode_readings": "study",
    "docs": "project",
    "size": "project",
}

# Of hours, or about no answer of the solver: not part of `all`.
LONG = {
    "campaign": "speed",
    "public": "public",
    "peer_mpm3d": "public",
    "robustness": "robustness",
    "stability_of_slopes": "sites",
    "runout_convergence": "accuracy",
    "runout_cures": "accuracy",
    "limit_equilibrium": "sites",
    "random_slopes": "sites",
    "sites": "sites",
    "site_data": "sites",
    "real_slides": "sites",
    "real_assumptions": "sites",
    "mutants": "project",
}

BENCHMARKS = SHORT | LONG


def module(name: str) -> Any:
    """The module of a benchmark."""
    return importlib.import_module(f"benchmarks.{BENCHMARKS[name]}.{name}")


def run_all(names: Iterable[str]) -> list[str]:
    """Run every benchmark in a process of its own and keep its answer; returns failures."""
    failed = []
    for name in names:
        print(f"{name} ...", file=sys.stderr, flush=True)
        command = [sys.executable, "-m", "benchmarks", name, "--keep"]
        done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT)
        if done.returncode:
            failed.append(f"{name}: {done.stderr.strip().splitlines()[-1:]}")
    return failed


def keep(answer: str, draw: Callable[[Path], object] | None = None) -> None:
    """Keep a benchmark's JSON, draw its pictures and write the page of all that are stored."""
    for folder in (FOLDER, FIGURES):
        folder.mkdir(parents=True, exist_ok=True)
    write_aside(FOLDER / f"{json.loads(answer)['benchmark']}.json", f"{answer}\n".encode())
    if draw is not None:
        draw(FIGURES)
    write()


def write() -> None:
    """Write the page, and that of each benchmark."""
    PAGES.mkdir(parents=True, exist_ok=True)
    answers = stored()
    write_aside(PAGE, document(answers).encode())
    for answer in answers:
        write_aside(PAGES / f"{answer['benchmark']}.md", section(answer).encode())


def stored() -> list[dict[str, Any]]:
    """The stored answers, in the order of BENCHMARKS."""
    return [json.loads(path.read_text()) for name in BENCHMARKS if (path := FOLDER / f"{name}.json").exists()]


def document(answers: list[dict[str, Any]]) -> str:
    """The page to judge by."""
    parts = [HEAD, *lead(answers), "\n## Benchmarks\n", "| benchmark | what | day |", "|---|---|---|"]
    for answer in answers:
        name = answer["benchmark"]
        about = (module(name).__doc__ or "").strip().partition("\n\n")[0]
        parts.append(f"| [{name}](pages/{name}.md) | {' '.join(about.split())} | {answer['date']} |")
    return "\n".join(parts) + "\n"


def section(answer: dict[str, Any]) -> str:
    """The page of one benchmark: what it is, where it ran, its pictures if it has any, its figures, its tables."""
    name, machine = answer["benchmark"], answer["machine"]
    about = (module(name).__doc__ or "").strip()
    versions = ", ".join(f"{package} {number}" for package, number in machine["versions"].items())
    lines = [f"# {name}", "", about, ""]
    lines += [f"{answer['date']}: {machine['processor']}, {machine['cores']} cores; {versions}.", ""]
    lines += [f"![{picture.stem}](../figures/{picture.name})" for picture in sorted(FIGURES.glob(f"{name}*.png"))]
    if answer["values"]:
        lines += ["", "| figure | value |", "|---|---|"]
        lines += [f"| {figure} | {_cell(value)} |" for figure, value in answer["values"].items()]
    return "\n".join([*lines, *tables(answer["rows"])]) + "\n"


def tables(rows: list[dict[str, Any]]) -> list[str]:
    """Rows with the same columns make one table."""
    lines: list[str] = []
    columns: list[str] = []
    for row in rows:
        if list(row) != columns:
            columns = list(row)
            lines += ["", "| " + " | ".join(columns) + " |", "|" + "---|" * len(columns)]
        lines.append("| " + " | ".join(_cell(value) for value in row.values()) + " |")
    return lines


def stored_rows(name: str) -> list[dict[str, Any]]:
    """The rows of a benchmark whose answer is stored, to draw figures anew."""
    rows: list[dict[str, Any]] = json.loads((FOLDER / f"{name}.json").read_text())["rows"]
    return rows


def _cell(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{key} {_cell(item)}" for key, item in value.items())
    if isinstance(value, list):
        return ", ".join(map(_cell, value))
    return f"{value:.4g}" if isinstance(value, float) else str(value)


if __name__ == "__main__":
    write()
