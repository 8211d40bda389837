"""Flow in slopes against the answers of others: a free surface by finite elements, and factors in a slow drawdown.

Sources: the seepage case of Sloan (2013), 10.1680/geot.12.RL.001, as computed in Beremi/slope_stability_petsc4py
(BSD 2-Clause, commit 749fb53) by linear finite elements with cells of 0.5 m; Griffiths and Lane (1999),
10.1680/geot.1999.49.3.387, Example 5.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import jax
import numpy as np

from cooperative.scene import parse, rested
from cooperative.tools.safety import factor_of_safety
from jaxmpm import Section, seepage

WATER = 9810.0
SLOAN = Section([(0, 20.25), (15, 20.25), (39.46268, 8.0), (59.46268, 8.0)])
LEVELS = (18.25, 9.0)
"""Water (m) beyond the left end, and over the toe."""
PRESSURES: tuple[tuple[float, float, float], ...] = (
    (10, 2, 140428.8),
    (20, 2, 119498.0),
    (30, 2, 95761.5),
    (37.5, 2, 79157.2),
    (20, 8, 61591.2),
    (30, 8, 37015.5),
    (35, 8, 21302.3),
    (10, 12, 43819.8),
    (20, 12, 23682.3),
    (30, 7, 46687.5),
)
"""Points x and z (m), and the pore pressure there (Pa)."""

DRAWDOWN = {-0.2: 1.85, 0.0: 1.85, 0.4: 1.4, 0.7: 1.3, 1.0: 1.4}
"""Depth of the level below the crest over the height of the slope, and the factor read off a figure."""
HEIGHT = 15.24
DAY = 86400.0
SCENE = """
[ground]
surface = [[0, 15.24], [18.288, 15.24], [48.768, 0], [80, 0]]
base = -0.001
[drawdown]
times = {times}
level = {level}
cell = [1.524, 0.762]
suction = false
left = "closed"
right = "closed"
soil = {{ conductivity = 0.04, alpha = 14.5, n = 2.68, porosity = 0.43, residual = 0.045 }}
[soil]
unit_weight = 19636
young = 1e8
poisson = 0.3
friction = 20.0
[soil.cohesion]
mean = 14963
cov = 0.1
length = [20.0, 5.0]
[rough]
cell = 1.524
spacing = [0.762, 0.762]
[refined]
cell = 1.524
spacing = [0.762, 0.762]
[campaign]
samples = 40
"""


def free_surface_row(cell: float) -> dict[str, Any]:
    """Pore pressure of steady flow under a free surface, over the largest fall of the water."""
    with jax.enable_x64(True):
        cells = seepage.cells_under(SLOAN, (cell, cell / 2))
        problem = seepage.problem(
            cells, seepage.soil_class("sand"), seepage.open_face(level=LEVELS[1]),
            seepage.open_face("left", level=LEVELS[0]), seepage.open_face("right", level=LEVELS[1]),
        )  # fmt: skip
        head, converged = seepage.steady(problem, seepage.hydrostatic(problem, LEVELS[0]))
        x, z, expected = np.array(PRESSURES).T
        found = np.asarray(seepage.Heads.of(problem, head).pressure(np.stack([x, z]), WATER))
    off = np.maximum(found, 0) - expected
    fall = WATER * (LEVELS[0] - LEVELS[1])
    return {
        "case": f"free surface in a slope, cells of {cell:g} m", "converged": bool(converged),
        "error": float(np.abs(off).max() / fall), "mean_error": float(np.abs(off).mean() / fall), "points": x.size,
    }  # fmt: skip


def drawdown_rows() -> Iterator[dict[str, Any]]:
    """The factor of safety by slices as a reservoir is drawn down so slowly that its water stays level."""
    depths = sorted(DRAWDOWN)
    times = [100 * DAY * number for number in range(1, len(depths) + 1)]
    levels = [[0.0, HEIGHT * (1 - depths[0])]]
    for time, depth in zip(times, depths, strict=True):
        # A fifth of the time to fall, the rest to wait.
        levels += [[time - 80 * DAY, HEIGHT * (1 - depth)], [time, HEIGHT * (1 - depth)]]
    campaign = parse(SCENE.format(times=times, level=levels))
    for time, depth in zip(times, depths, strict=True):
        found = factor_of_safety(rested(campaign, time), solver=False).equilibrium
        assert found is not None
        yield {
            "case": f"drawdown to {depth:g} of the height below the crest", "factor": found.slip.factor,
            "published": DRAWDOWN[depth], "error": found.slip.factor / DRAWDOWN[depth] - 1,
        }  # fmt: skip
