"""Runs that go at once through one program, by the device that runs them."""

from __future__ import annotations

import math
from collections.abc import Iterable

import jax

from cooperative.scene import Plan
from jaxmpm.run import devices_of

SCREENED = 64
"""Rough runs at once on a GPU."""
FILLS = 681_984
"""Particles of a run that fill a GPU alone: on an H200 one of eight such runs at once costs 22 per cent more."""


def lanes_of(plan: Plan, grid: str, particles: float) -> int:
    """Runs at once on one grid, where a scene names no number.

    On a CPU runs go one after the other. Each GPU has SCREENED rough runs at once, or as many refined ones as fill it
    together, at most SCREENED.

    Args:
        plan: of the campaign.
        grid: of the runs.
        particles: of one run.
    """
    lanes = plan.look_ahead if grid == "refined" else plan.lanes
    if lanes is not None:
        return lanes
    if jax.default_backend() == "cpu":
        return 1
    filling = SCREENED if grid != "refined" else int(min(max(FILLS // particles, 1), SCREENED))
    return len(devices_of()) * filling


def lent_by(devices: Iterable[jax.Device]) -> float:
    """Bytes that each of some devices lends to arrays, the least of them; inf where these stand in the host's memory.

    JAX takes its share of a GPU, three quarters of it by default, and tells no more than that.

    Args:
        devices: of this process.
    """
    statistics = [device.memory_stats() or {} for device in devices]
    limits = [float(of_device.get("bytes_limit", 0)) for of_device in statistics]
    return min((limit for limit in limits if limit > 0), default=math.inf)
