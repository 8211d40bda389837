"""From particles, walls and numerical choices to a Scene and its motionless State."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import jax
import numpy as np

from foundation import check
from jaxmpm.grid import Grid, Particles, Wall
from jaxmpm.laws import BaseMotion, WaterSurface, WaterTable, Zoned
from jaxmpm.protocols import Material
from jaxmpm.setup._discretisation import Discretisation, kernel_of
from jaxmpm.setup._fill import sorted_by_cell
from jaxmpm.setup._law import in_total_stress_at
from jaxmpm.setup._scene import scene, unstressed
from jaxmpm.soil import AnySoil, warn_of_units
from jaxmpm.transfer import band_thickness
from jaxmpm.types import Scene, State

PADDING = 1
"""Cells of grid beyond a wall."""


ROUNDING = 1e-9
"""Share of a particle's height within rounding."""


Hold = Literal["fixed", "roller", "friction"]


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
    walls: tuple[Wall, ...],
    gravity: float | Sequence[float],
    speed: float,
    friction: float | None = None,
    cohesion: float | None = None,
    wall_pressure: np.ndarray | None = None,
    water: WaterTable | WaterSurface | None = None,
    pore_pressure: np.ndarray | None = None,
    motion: BaseMotion | None = None,
    tied: tuple[int, int] | None = None,
    cut: np.ndarray | None = None,
) -> tuple[Scene, State]:
    """Scene and motionless, stress-free state of particles.

    With a `Zoned` law particles are in its order. If they have a pore pressure, it is 0 in undrained zones: their
    stress is total.

    Args:
        particles: to run.
        grid: background grid.
        material: their law.
        discretisation: cell, spacing and numerical choices.
        walls: planes that constrain nodes.
        gravity: downwards (m/s2), or a vector (d,).
        speed: largest particle speed that the time step allows for (m/s).
        friction: coefficient of walls with friction.
        cohesion: of such walls (Pa).
        wall_pressure: (nodes,) pressure of the water between these walls and the soil (Pa).
        water: table or surface of the water.
        pore_pressure: (N,) Pa.
        motion: of the base.
        tied: two planes of nodes along x that are identified.
        cut: (nodes,) bool, nodes at which nothing moves.

    Returns:
        Scene and state.

    Raises:
        ValueError: If shapes, numbers and choices do not fit, as for `scene`.
    """
    if isinstance(material, Zoned):
        if pore_pressure is not None:
            pore_pressure = np.where(in_total_stress_at(material), 0.0, pore_pressure)
    else:
        particles = sorted_by_cell(particles, grid)
    built = scene(
        particles,
        grid,
        material,
        kernel=kernel_of(discretisation),
        gravity=gravity,
        walls=walls,
        wall_friction=friction,
        wall_cohesion=cohesion,
        wall_pressure=wall_pressure,
        scheme=discretisation.scheme,
        cfl=discretisation.cfl,
        speed=speed,
        flip=discretisation.flip,
        damping=discretisation.damping,
        fbar=discretisation.fbar,
        cell_average=discretisation.cell_average,
        finite_strain=discretisation.finite_strain,
        internal_length=discretisation.internal_length,
        water=water,
        pore_pressure=pore_pressure,
        motion=motion,
        tied=tied,
        cut=cut,
    )
    return built, unstressed(built, apic=discretisation.apic)
