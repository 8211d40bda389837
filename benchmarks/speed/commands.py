"""How long one waits at a terminal: commands, each in a process of its own, from its start to its end.

`python -m benchmarks commands [--quick]` gives medians of three; `fos --quick` takes each slope once. `help_s`,
`site_s` and `slide_section_s` are seconds, those with `cpu` user and system seconds of the process and its threads,
imports among them. `speak_s_max` is the time to the first word at a terminal. The section is that of `jaxmpm new
--kind section`; `check_first_cpu_s` is the first check on a machine, which compiles its programs and the bytecode of
Python's files. `site` gets two soundings of 1,000 readings, made up with the seed SEED. `fos --quick` gets the slopes
of `stability_of_slopes` as scenes, each with its loads."""

from __future__ import annotations

import os
import pty
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.measure import Report
from benchmarks.sites.slopes import Case, cases
from cooperative.example_scenes import starters
from cooperative.scene import to_toml
from jaxmpm import Interface, Layer

REPEATS = 3
SEED, READINGS, STEP = 5, 1000, 0.02
"""Of the soundings: seed, readings of each, and their distance in depth (m)."""
COMMAND = (sys.executable, "-m", "cooperative")
NUMERICS = ("law", "matching", "plastic_strain", "decay", "softening_length", "unusual", "gap_memory")
"""Fields of a soil that a factor by slices does not ask for."""
SPEAKING = ("check", "draw", "slide", "fos", "run")
"""Commands whose first word is waited for."""


class Wait(NamedTuple):
    """Seconds, and CPU seconds, of a process."""

    seconds: float
    cpu: float


def kept_in(folder: Path) -> dict[str, str]:
    """The environment of a user whose first command keeps compiled programs and bytecode, in a folder of their own."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    return {
        **environment,
        "JAX_COMPILATION_CACHE_DIR": str(folder / "compiled"),
        "PYTHONPYCACHEPREFIX": str(folder / "bytecode"),
    }


def wait(arguments: Sequence[str | Path], environment: Mapping[str, str]) -> Wait:
    """Run a command of `jaxmpm`; RuntimeError with what it says where it fails."""
    with tempfile.TemporaryFile() as said:
        start = time.perf_counter()
        process = subprocess.Popen(
            [*COMMAND, *map(str, arguments)], stdout=said, stderr=said, stdin=subprocess.DEVNULL, env=dict(environment)
        )
        _, status, usage = os.wait4(process.pid, 0)
        seconds = time.perf_counter() - start
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode:
            said.seek(0)
            words = said.read().decode(errors="replace")[-2000:]
            raise RuntimeError(f"jaxmpm {' '.join(map(str, arguments))} failed:\n{words}")
    return Wait(seconds, usage.ru_utime + usage.ru_stime)


def first_word(arguments: Sequence[str | Path], environment: Mapping[str, str]) -> float:
    """Seconds until a command writes to its terminal, after which it is ended."""
    ours, theirs = pty.openpty()
    start = time.perf_counter()
    process = subprocess.Popen(
        [*COMMAND, *map(str, arguments)], stdout=theirs, stderr=theirs, stdin=subprocess.DEVNULL, env=dict(environment)
    )
    try:
        os.read(ours, 1)
        return time.perf_counter() - start
    finally:
        process.kill()
        process.wait()
        os.close(ours)
        os.close(theirs)


def scene_of(case: Case) -> dict[str, Any]:
    """The tables of a scene of one slope, with its loads; what varies is nothing."""
    layers = list(case.soil) if isinstance(case.soil, Sequence) else [Layer(case.soil)]
    loads = dict(case.loads)
    water: dict[str, Any] = {name: loads.pop(name) for name in ("r_u", "water") if name in loads}
    if "water" in water:
        level = water.pop("water")
        water["level" if isinstance(level, float | int) else "table"] = _plain(level)
    shape = case.shape
    ground = {"surface": _plain(shape.surface), "base": float(shape.base)}
    ground |= {name: _plain(getattr(shape, name)) for name in ("walls", "bedrock") if getattr(shape, name) is not None}
    if shape.interface is not None:
        ground["interface"] = _non_defaults(shape.interface)
    cell = float(case.cells[0])
    return {
        "name": case.name,
        "ground": ground,
        "layer": [
            {"name": layer.name or f"soil {number}", "unusual": True, **_non_defaults(layer.soil), **_boundary(layer)}
            for number, layer in enumerate(layers, 1)
        ],
        **({"water": water} if water else {}),
        **{grid: {"cell": cell, "spacing": [cell / 2, cell / 2]} for grid in ("rough", "refined")},
        **({"run": {name: float(value) for name, value in loads.items()}} if loads else {}),
        "campaign": {"samples": 20},
    }


def _boundary(layer: Layer) -> dict[str, Any]:
    places = {name: getattr(layer, name) for name in ("bottom", "depth", "thickness")}
    return {name: _plain(value) for name, value in places.items() if value is not None}


def _non_defaults(part: Any) -> dict[str, Any]:
    """Fields of a soil or an interface that have another value than their default."""
    values = {
        field.name: (getattr(part, field.name), field.default) for field in fields(part) if field.name not in NUMERICS
    }
    required = ("unit_weight", "young", "poisson")
    return {
        name: float(value)
        for name, (value, default) in values.items()
        if value is not None and (value != default or (name in required and not isinstance(part, Interface)))
    }


def _plain(value: Any) -> Any:
    return np.asarray(value, float).tolist()


def write_soundings(folder: Path) -> list[Path]:
    """Two cone penetration tests in clay 32 m apart, as CSV."""
    random, depth = np.random.default_rng(SEED), STEP * np.arange(1, READINGS + 1)
    distance = np.abs(depth[:, None] - depth) / 0.8
    root = np.linalg.cholesky(np.exp(-distance) + 1e-9 * np.eye(READINGS))
    paths = []
    for number in (1, 2):
        cone = (0.35 + 0.03 * depth) * np.exp(0.2 * root @ random.standard_normal(READINGS))
        rows = [
            f"cpt {number},{32 * number},0,0,{z:.2f},{q:.4f},{20 * q:.3f}" for z, q in zip(depth, cone, strict=True)
        ]
        head = "name,x [m],y [m],top [m],depth [m],qt [MPa],fs [kPa]"
        path = folder / f"cpt-{number}.csv"
        path.write_text("\n".join([head, *rows]) + "\n")
        paths.append(path)
    return paths


def run(quick: bool) -> Report:
    """Waits of all commands; `quick` takes each once, and the first two slopes."""
    repeats, slopes = (1, cases()[:2]) if quick else (REPEATS, cases())
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        environment = kept_in(folder)
        section = folder / "section.toml"
        section.write_text(starters()["section"].read_text())
        rows: list[dict[str, Any]] = []
        more = {"run": ("--out", str(folder / "out"))}

        def median(name: str, *arguments: str | Path, repeats: int = repeats) -> Wait:
            waits = [wait(arguments, environment) for _ in range(repeats)]
            typed = Wait(*(statistics.median(column) for column in zip(*waits, strict=True)))
            rows.append({"command": name, "seconds": round(typed.seconds, 2), "cpu_s": round(typed.cpu, 2)})
            return typed

        first = wait(["check", section], environment)
        values: dict[str, Any] = {
            "help_s": median("--help", "--help").seconds,
            "speak_s_max": max(first_word([name, section, *more.get(name, ())], environment) for name in SPEAKING),
            "check_section_cpu_s": median("check", "check", section).cpu,
            "check_first_cpu_s": first.cpu,
            "draw_section_cpu_s": median("draw", "draw", section).cpu,
        }
        soundings = write_soundings(folder)
        values["site_s"] = median("site", "site", *soundings, "--n-kt", "14", "--out", folder / "site").seconds
        waits = []
        for number, case in enumerate(slopes):
            scene = folder / f"slope-{number}.toml"
            scene.write_text(to_toml(scene_of(case)))
            waits.append(median(f"fos --quick, {case.name}", "fos", scene, "--quick", repeats=1).cpu)
        values |= {
            "fos_quick_cpu_s_max": max(waits),
            "fos_quick_cpu_s_median": statistics.median(waits),
            "slide_section_s": median("slide", "slide", section, "--out", folder / "slide").seconds,
        }
    return Report({name: round(value, 2) for name, value in values.items()}, rows)
