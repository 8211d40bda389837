"""What every benchmark shares: the machine it ran on, timings with their spread, runs pinned to cores."""

from __future__ import annotations

import hashlib
import inspect
import json
import os
import platform
import re
import resource
import statistics
import subprocess
import sys
import time
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar

import jax

from cooperative.scene import Campaign, parse
from cooperative.store import write_aside

ROOT = Path(__file__).resolve().parent.parent
Case = TypeVar("Case")
Source = Callable[..., object] | ModuleType | Path
"""What a file of code or data is told by: a function or module that stands in it, or its path."""


@dataclass(frozen=True)
class Report:
    """A benchmark's answer: `values` are the named figures, `rows` the table behind them. draw: what `--keep` draws in
    a folder or writes, None for nothing."""

    values: dict[str, Any]
    rows: list[dict[str, Any]]
    draw: Callable[[Path], object] | None = None


@dataclass(frozen=True)
class Timing:
    """Seconds of repeated runs: median, and the spread as smallest and largest."""

    median: float
    smallest: float
    largest: float
    repeats: int

    def scaled(self, factor: float) -> dict[str, float | int]:
        """The timing times `factor` (another unit, or per particle and step), ready for JSON."""
        return {
            "median": self.median * factor,
            "smallest": self.smallest * factor,
            "largest": self.largest * factor,
            "repeats": self.repeats,
        }


def timed(run: Callable[[], Any], repeats: int = 5, clock: Callable[[], float] = time.perf_counter) -> Timing:
    """Time `run` (which must block until its result is there) `repeats` times by a clock, after one warm-up call."""
    run()
    seconds = []
    for _ in range(repeats):
        start = clock()
        run()
        seconds.append(clock() - start)
    return Timing(statistics.median(seconds), min(seconds), max(seconds), repeats)


def scene_campaign(name: str) -> Campaign:
    """A scene that stands in benchmarks/scenes."""
    return parse((ROOT / "benchmarks" / "scenes" / f"{name}.toml").read_text())


def code_digest(*texts: str, folders: Iterable[str] = ("jaxmpm", "kl", "cooperative")) -> str:
    """Of the code in these folders that runs, native kernels included, and of the scenes that it runs."""
    digest = hashlib.sha256("\0".join(texts).encode())
    for package in folders:
        for path in sorted((ROOT / package).rglob("*")):
            if path.suffix in (".py", ".so"):
                digest.update(f"{path.relative_to(ROOT)}\0".encode() + path.read_bytes())
    return digest.hexdigest()[:16]


def sources(*made: Source) -> list[str]:
    """Texts of files, for `code_digest`."""
    return [(one if isinstance(one, Path) else Path(inspect.getfile(one))).read_text() for one in made]


class Refused(ValueError):
    """What a command line asks for and a benchmark cannot do."""


def beginning_so(cases: Mapping[str, Case], only: Sequence[str]) -> dict[str, Case]:
    """The cases whose names begin as one of `only` does.

    Raises:
        Refused: If none begins as one of them does.
    """
    if strange := [start for start in only if not any(name.startswith(start) for name in cases)]:
        raise Refused(f"--only {strange[0]}: no case begins so, give beginnings of {', '.join(cases)}")
    return {name: case for name, case in cases.items() if name.startswith(tuple(only))}


def stored_row(folder: Path, name: str, make: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """The row that a command which was stopped later left in the folder, else one made now and left there."""
    path = folder / f"{name}.json"
    if not path.is_file():
        folder.mkdir(parents=True, exist_ok=True)
        write_aside(path, json.dumps(make()).encode())
    row: dict[str, Any] = json.loads(path.read_text())
    return row


def peak_memory_mb() -> float:
    """Most memory that this process has held so far, in MB: of the first device, or its resident set on a CPU."""
    stats = jax.devices()[0].memory_stats()
    if stats is not None and "peak_bytes_in_use" in stats:
        return float(stats["peak_bytes_in_use"]) / 2**20
    status = Path("/proc/self/status")
    if status.is_file():  # `ru_maxrss` is at least that of the process which started this one
        return int(status.read_text().partition("VmHWM:")[2].split()[0]) / 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (2**20 if sys.platform == "darwin" else 1024)


def on_cores(cores: int, module: str, *arguments: str, first: int = 0) -> dict[str, Any]:
    """Run `python -m module arguments` bound to `cores` cores from the `first` on; its last line is its JSON answer.

    XLA sizes its thread pool when it starts, so a core count needs a process of its own.
    """
    available = sorted(os.sched_getaffinity(0))
    if first + cores > len(available):
        raise ValueError(f"{cores} cores asked for, {len(available)} available: ask for fewer")
    done = subprocess.run(
        [sys.executable, "-m", module, *arguments],
        preexec_fn=lambda: os.sched_setaffinity(0, available[first : first + cores]),
        capture_output=True,
        text=True,
        cwd=ROOT,
    )
    if done.returncode:
        raise RuntimeError(f"{module} {' '.join(arguments)} failed:\n{done.stderr[-2000:]}")
    for warning in re.findall(r"^.*?\w*Warning: (.*)$", done.stderr, re.MULTILINE):
        warnings.warn(f"{module}: {warning}", stacklevel=2)
    return json.loads(done.stdout.strip().splitlines()[-1])


def machine() -> dict[str, Any]:
    """Processor, cores this process may use, and the versions that the figures depend on."""
    processor = platform.processor() or platform.machine()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        names = [line for line in cpuinfo.read_text().splitlines() if line.startswith("model name")]
        processor = names[0].split(":", 1)[1].strip() if names else processor
    return {
        "processor": processor,
        "cores": len(os.sched_getaffinity(0)),
        "system": f"{platform.system()} {platform.machine()}",
        "versions": {
            "python": platform.python_version(),
            **{name: version(name) for name in ("jaxmpm", "jax", "jaxlib", "numpy", "scipy")},
        },
    }


def as_json(name: str, report: Report) -> str:
    """One JSON object: the benchmark's name, day, machine and versions, values and rows."""
    today = datetime.now(UTC).date().isoformat()
    answer = {"values": report.values, "rows": report.rows}
    return json.dumps({"benchmark": name, "date": today, "machine": machine(), **answer})
