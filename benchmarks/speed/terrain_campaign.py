"""A campaign on terrain, nodes near its soil or all: `python -m benchmarks.speed.terrain_campaign near` (or all).

The slide of S-1000 (benchmarks/scenes/real), four samples on both grids, for the first seconds. Prints JSON: CPU
seconds and the largest resident set (MB) of the process, and steps and displacement (m) of each run by grid.
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
import warnings
from dataclasses import replace
from typing import Any

import cooperative
from benchmarks.measure import ROOT, peak_memory_mb
from cooperative.estimate import Published
from cooperative.scene import parse, read_scene
from cooperative.store import GRIDS, read_rows
from jaxmpm.setup import _follow

SCENE, SAMPLES, SECONDS = ROOT / "benchmarks" / "scenes" / "real" / "s1000_2021.toml", 4, 10.0


def cost(nodes: str) -> dict[str, Any]:
    """The figures of this process, with nodes "near" the soil or "all" of them."""
    if nodes == "all":
        _follow.SPARSE = 10**9
    campaign = parse(read_scene(SCENE))
    plan = replace(campaign.plan, samples=SAMPLES, fields=())
    campaign = replace(campaign, estimator=Published(SAMPLES), plan=plan, run=replace(campaign.run, t_end=SECONDS))
    start = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        cooperative.run(campaign, folder)
        seconds = time.process_time() - start
        columns = {grid: read_rows(folder, grid).columns for grid in GRIDS}
    return {
        "cpu_s": seconds,
        "peak_mb": peak_memory_mb(),
        "steps": {grid: of_grid["steps"].tolist() for grid, of_grid in columns.items()},
        "displacement": {grid: of_grid["displacement"].tolist() for grid, of_grid in columns.items()},
    }


if __name__ == "__main__":
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        print(json.dumps(cost(sys.argv[1])))
