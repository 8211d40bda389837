"""What rain costs a campaign: the demo's section with cohesion and friction, with rain at 12 times and without."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from benchmarks.measure import ROOT

SAMPLES, REFINED = 40, 12
SCENE = """
[ground]
surface = [[0.0, 16.0], [60.0, 16.0], [84.0, 4.0], [132.0, 4.0]]
[water]
level = 4.0
[soil]
unit_weight = 20e3
young = 1e8
poisson = 0.3
friction = 20.0
[soil.cohesion]
mean = 6e3
cov = 0.4
length = [60.0, 2.0]
[rough]
cell = 2.0
spacing = [1.0, 1.0]
[refined]
cell = 1.0
spacing = [0.5, 0.5]
[run]
t_end = 20.0
failure_displacement = 1.0
[campaign]
samples = {samples}
refined_runs = {refined}
slides = 0
seed = 1
"""
RAIN = """
[rain]
times = [{times}]
rate = "8 mm/h"
soil = {{ soil_class = "loam" }}
cell = [2.0, 1.0]
"""


def _seconds(*arguments: str) -> float:
    """CPU seconds of a command of this package, with those of the processes that it starts."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(
        [sys.executable, "-m", "cooperative", *arguments], check=True, cwd=ROOT, stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL, env={**os.environ, "JAX_PLATFORMS": "cpu"},
    )  # fmt: skip
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def rain_cost_rows(quick: bool) -> Iterator[dict[str, Any]]:
    """CPU seconds of both campaigns, each once what they compile is kept."""
    samples, refined = (12, 10) if quick else (SAMPLES, REFINED)
    still = SCENE.format(samples=samples, refined=refined)
    moving = still + RAIN.format(times=", ".join(f'"{6 * k} h"' for k in range(1, 13)))
    seconds = {}
    for name, text, command in (("without rain", still, "run"), ("rain at 12 times", moving, "seepage")):
        with tempfile.TemporaryDirectory() as folder:
            scene = Path(folder) / "scene.toml"
            scene.write_text(text)
            options = ["--probability", "--refined-runs", str(refined)] if command == "seepage" else []
            for out in ("first", "second"):
                arguments = [command, str(scene), *options, "--workers", "1", "--out", str(Path(folder) / out)]
                seconds[name] = _seconds(*arguments)
        row = {"case": f"campaign, {name}", "samples": samples, "refined": refined}
        yield row | {"seconds": round(seconds[name], 1), "ratio": seconds[name] / seconds["without rain"]}
