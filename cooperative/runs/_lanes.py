"""Runs that go at once through one program, by the device that runs them."""

from __future__ import annotations

import jax

from cooperative.scene import Plan

SCREENED = 64
"""Rough runs at once on GPUs."""
FILLS = 681_984
"""Particles of a run that fill a GPU alone: on an H200 one of eight such runs at once costs 22 per cent more."""


def lanes_of(plan: Plan, grid: str, particles: float) -> int:
    """Runs at once on one grid, where a scene names no number.

    On a CPU runs go one after the other. Refined runs at once on a GPU have the particles that fill it together, at
    most SCREENED of them on each.

    Args:
        plan: of the campaign.
        grid: of the runs.
        particles: of one run.
    """
    given = plan.look_ahead if grid == "refined" else plan.lanes
    if given is not None:
        return given
    if jax.default_backend() == "cpu":
        return 1
    if grid != "refined":
        return SCREENED
    return jax.local_device_count() * int(min(max(FILLS // particles, 1), SCREENED))
