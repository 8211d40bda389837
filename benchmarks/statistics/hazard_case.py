"""What looking at columns of cells costs, in a process of its own: `python -m benchmarks.statistics.hazard_case SCENE
REPEATS`.

Prints JSON: the share of a step on the scene's rough grid, the median over turns in which the step with looks and the
one without follow each other, and how often the columns were looked at.
"""

from __future__ import annotations

import json
import statistics
import sys
from typing import Any

from benchmarks.measure import scene_campaign
from benchmarks.speed.leave_out import turns, unchanged, with_looks
from cooperative.scene import built


def measure(name: str, repeats: int) -> dict[str, Any]:
    """The share of a step on a scene of benchmarks/scenes."""
    scene, state = built(scene_campaign(name), "rough")
    looked = with_looks(scene, state)
    columns = looked[1].columns
    assert columns is not None
    shares = [1 - plain / kept for plain, kept in turns([unchanged(scene, state), looked], repeats)]
    return {"overhead_share": statistics.median(shares), "looked_at_every_steps": columns.every}


if __name__ == "__main__":
    print(json.dumps(measure(sys.argv[1], int(sys.argv[2]))))
