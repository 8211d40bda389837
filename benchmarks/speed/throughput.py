"""Particle-steps per second: microseconds per particle and step, per scene, scheme, dtype, engine and core count.

Each case runs in a process of its own, bound to its cores. On two cores a campaign runs lanes in two processes, one on
each; `batch16_two_core_ratio` is that of 16 lanes run so, and the one of a single process stands beside it.

The published method's open solver, MPM3D-F90 (github.com/xzhang66/MPM3D-F90, commit 4a6275f, gfortran 12, -O3
-ffast-math -march=native, GIMP and MUSL, float64, no softening), takes 5 to 10 times as long on the rough slope, by
the machine: on one core of an Intel Xeon 0.58 to 0.60 us beside 0.083, of another 0.67 to 0.70 beside the 0.130 to
0.135 of an earlier version, of an AMD EPYC 0.96 beside the 0.100 of an earlier version. In float64 both, 3 to 5.
"""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from benchmarks.measure import Report, on_cores

ROUGH = {"scene": "paper", "grid": "rough"}
REFINED = {"scene": "paper", "grid": "refined"}
DEFAULT = {"scene": "slope"}
"""Strain averaged over cells and bands as thick on every grid, which the published scenes do without."""
SECTION = {"scene": "paper_section", "grid": "refined"}

# name -> (cores, case); a case on more cores than there are is left out.
CASES: dict[str, tuple[int, dict[str, Any]]] = {
    "rough MUSL": (1, ROUGH),
    "rough MUSL, 2 cores": (2, ROUGH),
    "rough USL": (1, ROUGH | {"scheme": "USL"}),
    "rough USF": (1, ROUGH | {"scheme": "USF"}),
    "rough MUSL, 16 lanes": (1, ROUGH | {"batch": 16}),
    "rough MUSL, 16 lanes, 2 cores": (2, ROUGH | {"batch": 16}),
    "rough MUSL, float64": (1, ROUGH | {"dtype": "float64"}),
    "rough MUSL, XLA": (1, ROUGH | {"engine": "XLA", "repeats": 3}),
    "section MUSL": (1, SECTION),
    "refined MUSL": (1, REFINED | {"seconds": 2.0, "repeats": 5}),
    "refined MUSL, 2 cores": (2, REFINED | {"seconds": 2.0, "repeats": 5}),
    "rough MUSL, default settings": (1, ROUGH | DEFAULT),
    "refined MUSL, default settings": (1, REFINED | DEFAULT | {"seconds": 2.0, "repeats": 5}),
}
TWO_PROCESSES = "rough MUSL, 2 processes of 8 lanes on a core each"
QUICK = ("section MUSL", "rough MUSL", "rough USL")


# On a GPU lanes run side by side, and the cores do not count.
ON_GPU: dict[str, dict[str, Any]] = {
    "rough MUSL": ROUGH,
    "rough MUSL, 64 lanes": ROUGH | {"batch": 64},
    "refined MUSL": REFINED,
    "refined MUSL, 8 lanes": REFINED | {"batch": 8},
    "refined MUSL, float64": REFINED | {"dtype": "float64"},
    "refined MUSL, default settings": REFINED | DEFAULT,
    "section MUSL, 256 lanes": SECTION | {"batch": 256},
}


def row(name: str, cores: int, case: dict[str, Any], rounds: int) -> dict[str, Any]:
    """One case, run `rounds` times; the repeats of all rounds together."""
    answers = [on_cores(cores, "benchmarks.speed.throughput_case", json.dumps(case)) for _ in range(rounds)]
    return summary(name, cores, answers)


def side_by_side(rounds: int) -> dict[str, Any]:
    """16 lanes as a campaign's workers run them: a process on each of two cores, at the same time."""
    case = json.dumps(ROUGH | {"batch": 8})

    def one(core: int) -> dict[str, Any]:
        return on_cores(1, "benchmarks.speed.throughput_case", case, first=core)

    with ThreadPoolExecutor(2) as pool:
        answers = [answer for _ in range(rounds) for answer in pool.map(one, (0, 1))]
    # Both work at once: together they take half the time per lane that each of them does.
    return summary(TWO_PROCESSES, 2, [answer | {"us": [us / 2 for us in answer["us"]]} for answer in answers])


def summary(name: str, cores: int, answers: list[dict[str, Any]]) -> dict[str, Any]:
    """The repeats of all answers together, as a row."""
    us = sorted(value for answer in answers for value in answer["us"])
    return {
        "case": name,
        "cores": cores,
        "particles": answers[0]["particles"],
        "us_per_particle_step": round(statistics.median(us), 5),
        "smallest": round(us[0], 5),
        "largest": round(us[-1], 5),
        "repeats": len(us),
        "compile_s": round(max(answer["compile_s"] for answer in answers), 2),
        "peak_mb": round(max(answer["peak_mb"] for answer in answers)),
        "particle_steps_per_second": round(1e6 / statistics.median(us)),
        "device": answers[0]["device"],
    }


def run(quick: bool) -> Report:
    """Rows of the GPU where JAX finds one, else of the CPU."""
    command = [sys.executable, "-c", "import jax; print(jax.default_backend())"]
    if subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip() != "cpu":
        return on_gpu()
    return on_cpu(quick)


def on_gpu() -> Report:
    """Cases on the GPU that JAX has found."""
    rows = [row(name, 1, case, rounds=1) for name, case in ON_GPU.items()]
    us = {r["case"]: r["us_per_particle_step"] for r in rows}
    names = {"gpu_rough_us": "rough MUSL", "gpu_rough_64_lanes_us": "rough MUSL, 64 lanes"}
    names |= {"gpu_refined_us": "refined MUSL", "gpu_refined_default_us": "refined MUSL, default settings"}
    return Report({name: us[case] for name, case in names.items()}, rows)


def on_cpu(quick: bool) -> Report:
    """All cases that this machine has the cores for, and the ratios between them."""
    available = len(os.sched_getaffinity(0))
    chosen = {
        name: (cores, case)
        for name, (cores, case) in CASES.items()
        if cores <= available and (not quick or name in QUICK)
    }
    rows = [row(name, cores, case, rounds=1 if quick else 2) for name, (cores, case) in chosen.items()]
    if available > 1 and not quick:
        rows.append(side_by_side(rounds=2))
    us = {r["case"]: r["us_per_particle_step"] for r in rows}
    mb = {r["case"]: r["peak_mb"] for r in rows}

    def ratio(a: str, b: str) -> float | None:
        return round(us[a] / us[b], 3) if a in us and b in us else None

    values = {
        "rough_musl_f32_1core_us": us.get("rough MUSL"),
        "rough_usl_f32_1core_us": us.get("rough USL"),
        "rough_two_core_ratio": ratio("rough MUSL, 2 cores", "rough MUSL"),
        "batch16_two_core_ratio": ratio(TWO_PROCESSES, "rough MUSL, 16 lanes"),
        "batch16_two_core_ratio_one_process": ratio("rough MUSL, 16 lanes, 2 cores", "rough MUSL, 16 lanes"),
        "refined_musl_f32_1core_us": us.get("refined MUSL"),
        "refined_peak_mb": mb.get("refined MUSL"),
        "rough_default_us": us.get("rough MUSL, default settings"),
        "refined_default_us": us.get("refined MUSL, default settings"),
        "refined_default_peak_mb": mb.get("refined MUSL, default settings"),
        "f64_over_f32": ratio("rough MUSL, float64", "rough MUSL"),
        "xla_over_native": ratio("rough MUSL, XLA", "rough MUSL"),
        "batch16_per_lane_over_single": ratio("rough MUSL, 16 lanes", "rough MUSL"),
        "compile_s": max(r["compile_s"] for r in rows),
    }
    return Report({name: value for name, value in values.items() if value is not None}, rows)
