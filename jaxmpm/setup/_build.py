"""From particles, walls and numerical choices to a Scene and its motionless State."""

from __future__ import annotations

from dataclasses import replace

import jax
import numpy as np

from jaxmpm.grid import Grid, Hold, Particles, Wall
from jaxmpm.laws import Zoned
from jaxmpm.protocols import Material
from jaxmpm.setup._discretisation import Discretisation
from jaxmpm.setup._fill import ordered
from jaxmpm.setup._follow import follow_sparse_soil
from jaxmpm.setup._initial_stress import check_borne
from jaxmpm.setup._law import in_total_stress_at
from jaxmpm.setup._scene import scene, unstressed
from jaxmpm.setup._stable import with_stable_step
from jaxmpm.soil import AnySoil, warn_of_units
from jaxmpm.support import check
from jaxmpm.support.tracing import host
from jaxmpm.transfer import band_thickness
from jaxmpm.types import Boundary, Loads, Scene, State

PADDING = 1
"""Cells of grid beyond a wall."""


ROUNDING = 1e-9
"""Share of a particle's height within rounding."""


def end_walls(axis: int, cells: int, hold: Hold, high: Hold | None = None) -> list[Wall]:
    """Walls at both ends of an axis.

    Args:
        axis: number of the axis.
        cells: its length in cells.
        hold: constraint.
        high: that of the higher end, None for the same.

    Returns:
        Two walls.
    """
    return [Wall(axis, "low", PADDING, hold), Wall(axis, "high", PADDING + cells, high or hold)]


def below(z: np.ndarray, height: np.ndarray, rounding: float) -> np.ndarray:
    """Whether points lie below a height.

    Args:
        z: of the points (m).
        height: of the surface at each point (m).
        rounding: a point less than this below the height does not count (m).

    Returns:
        bool, of the shape of `z`.
    """
    return z < height - rounding


def material_on(discretisation: Discretisation, soil: AnySoil) -> Material:
    """The law of a soil on a grid, with warnings about units.

    Shear bands are as thick as a cell, or as the average of plastic strain makes them.

    Args:
        discretisation: cell, spacing and numerical choices.
        soil: to convert.

    Returns:
        The law.

    Raises:
        ValueError: If a number is impossible for soil.
    """
    length = discretisation.internal_length
    dtype = check.dtype(discretisation.dtype or jax.dtypes.canonicalize_dtype(float))
    law: Material = soil.material(dtype, discretisation.cell if length is None else band_thickness(length))
    warn_of_units(soil)
    return law


def build(
    particles: Particles,
    grid: Grid,
    material: Material,
    discretisation: Discretisation,
    *,
    boundary: Boundary,
    loads: Loads,
    speed: float,
) -> tuple[Scene, State]:
    """Scene and motionless, stress-free state of particles.

    With a `Zoned` law particles are in its order. If they have a pore pressure, it is 0 in undrained zones: their
    stress is total.

    Args:
        particles: to run.
        grid: background grid.
        material: their law.
        discretisation: cell, spacing and numerical choices.
        boundary: what constrains the nodes.
        loads: gravity, water and motion.
        speed: largest particle speed that the time step allows for (m/s).

    Returns:
        Scene and state.

    Raises:
        ValueError: If shapes, numbers and choices do not fit, as for `scene`.
    """
    if not isinstance(material, Zoned):
        particles = ordered(particles, grid)
    elif loads.pore_pressure is not None:
        pressure = host(loads.pore_pressure).where(in_total_stress_at(material), 0.0, loads.pore_pressure)
        loads = replace(loads, pore_pressure=pressure)
    built = scene(particles, grid, material, discretisation, boundary=boundary, loads=loads, speed=speed)
    built = with_stable_step(follow_sparse_soil(built), discretisation.cfl)
    check_borne(built)
    return built, unstressed(built, apic=discretisation.apic)
