"""Scenes from ground that is filled with a lattice of particles, and the grid of its box."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from jax.typing import ArrayLike

from jaxmpm.grid import Grid, Hold, Particles, Wall
from jaxmpm.ground._base import Heights, share_above
from jaxmpm.ground._ground import Ground, check_ground, layer_of
from jaxmpm.ground._layer import Layer
from jaxmpm.laws import BaseMotion
from jaxmpm.protocols import Material
from jaxmpm.setup import (
    PADDING,
    ROUNDING,
    Discretisation,
    below,
    build,
    cells_up,
    check_discretisation,
    check_resolved,
    end_walls,
    fill,
    material_on,
    ordered,
    pseudo_static,
    settled,
)
from jaxmpm.soil import STANDARD_GRAVITY, AnySoil, law_of_layers, ratio_at_rest, weights
from jaxmpm.support import check
from jaxmpm.support.tracing import array, product, require_known, taken
from jaxmpm.types import Boundary, Loads, Scene, State

REMEDY = (
    "differentiate by gravity and its kind with `replace(scene, loads=...)`, by heights with `jaxmpm.ground.reshaped`, "
    "by soil, water and contact with a soil that is traced, or `with_soil`"
)
"""How to differentiate by what a builder has to know."""


def scene_of(
    ground: Ground,
    soil: AnySoil | Sequence[Layer],
    discretisation: Discretisation,
    *,
    inside: Callable[[np.ndarray], np.ndarray] | None = None,
    gravity: float = 9.81,
    k_h: float = 0.0,
    k_v: float = 0.0,
    motion: BaseMotion | None = None,
    ends: Sequence[Hold] = ("roller", "roller"),
    speed: float | None = None,
    at_rest: bool = True,
) -> tuple[Scene, State]:
    """Fill ground with a lattice of particles, on a fixed base between upright walls.

    Args:
        ground: its box, surface and layers.
        soil: one for all, or layers from the top down; `ground.layer_of` gives the layer of each particle.
        discretisation: cell, spacing and numerical choices.
        inside: function of positions (d, N) m that returns (N,) bool, which of them lie in the ground; by default those
            below its surface.
        gravity: downwards (m/s2).
        k_h: pseudo-static acceleration over gravity, along x.
        k_v: pseudo-static acceleration over gravity, upwards.
        motion: of the base, from time 0, after the initial stress; the scene is solved in its frame.
        ends: constraint of both walls along x, and along y.
        speed: largest particle speed that the time step allows for (m/s), by default of a fall through half the box.
        at_rest: with the stress of elastic gravity loading, else free of stress.

    Returns:
        Scene and state.

    Raises:
        ValueError: If sizes, soils and numbers do not fit the grid or each other.
    """
    require_known({"ground": ground, "gravity": gravity, "k_h": k_h, "k_v": k_v, "speed": speed}, REMEDY)
    acceleration = pseudo_static(gravity, k_h, k_v, len(ground.corner))
    layers = list(soil) if isinstance(soil, Sequence) else [Layer(soil)]
    counts = cells(ground, discretisation)
    grid = box_grid(ground.corner, counts, discretisation.cell)
    particles, law, k0 = lattice(ground, layers, discretisation, grid, inside=inside)
    upright = len(ground.corner) - 1
    walls = [wall for axis, hold in enumerate(ends[:upright]) for wall in end_walls(axis, counts[axis], hold)]
    built, state = build(
        particles,
        grid,
        law,
        discretisation,
        boundary=Boundary((*walls, Wall(upright, "low", PADDING, "fixed"))),
        loads=Loads(acceleration, motion=motion, k0=k0),
        speed=math.sqrt(gravity * ground.extent[-1]) if speed is None else speed,
    )
    return built, settled(built, state) if at_rest else state


def lattice(
    ground: Ground,
    layers: Sequence[Layer],
    discretisation: Discretisation,
    grid: Grid,
    *,
    inside: Callable[[np.ndarray], np.ndarray] | None = None,
    bedrock: Heights | None = None,
    wet: Callable[[np.ndarray], np.ndarray] | None = None,
) -> tuple[Particles, Material, ArrayLike | None]:
    """Particles of a lattice that lie in the ground, each with the mass of its layer, their law and ratio at rest.

    Args:
        ground: its box, surface and layers.
        layers: from the top down.
        discretisation: cell, spacing and numerical choices.
        grid: that the particles are sorted by.
        inside: function of positions (d, N) m that returns (N,) bool, which of them lie in the ground; by default those
            below its surface.
        bedrock: rigid ground, above which they lie; None for none.
        wet: function of positions that returns which of them lie under a water table; by default none.

    Returns:
        Particles, their law, and `jaxmpm.soil.ratio_at_rest`.
    """
    corner, spacing, dz = np.array(ground.corner, float), discretisation.spacing, discretisation.spacing[-1]

    def under(position: np.ndarray) -> np.ndarray:
        return below(position[-1], ground.heights(*position[:-1]), ROUNDING * dz)

    def within(position: np.ndarray) -> np.ndarray:
        chosen = under(position) if inside is None else inside(position)
        return chosen if bedrock is None else chosen & (share_above(bedrock, position, dz) > 0)

    particles = fill(
        (*ground.extent[:-1], math.ceil(ground.extent[-1] / dz * (1 - 1e-12)) * dz),
        spacing,
        unit_weight=STANDARD_GRAVITY,
        inside=lambda position: within(position + corner[:, None]),
        corner=tuple(corner.tolist()),
        dtype=discretisation.dtype,
    )
    particles = ordered(particles, grid)
    position = np.asarray(particles.position, float)
    number, soils = layer_of(ground, layers, position, discretisation), [layer.soil for layer in layers]
    law, order = law_of_layers([material_on(discretisation, soil) for soil in soils], number)
    mass = weights(soils, number, None if wet is None else wet(position)) / STANDARD_GRAVITY * np.prod(spacing)
    particles = replace(particles, mass=array(mass, particles.mass.dtype))
    particles = taken(particles, order)
    if bedrock is not None:
        share = share_above(bedrock, position[:, order], dz).astype(particles.volume.dtype)
        volume, mass = (product(values, share) for values in (particles.volume, particles.mass))
        particles = replace(particles, volume=volume, mass=mass)
    return particles, law, ratio_at_rest(soils, number[order], law)


def cells(ground: Ground, discretisation: Discretisation) -> list[int]:
    """Cells of a grid along each axis, with air above the highest point.

    Args:
        ground: its own `cells` is used if it has one.
        discretisation: cell, spacing and numerical choices.

    Returns:
        Number of cells along each axis.

    Raises:
        ValueError: If ground or grid is invalid, or they do not fit each other.
    """
    if hasattr(ground, "cells"):
        return ground.cells(discretisation)
    check_ground(ground)
    return box_cells("the ground", ground, discretisation)


def box_cells(what: str, ground: Ground, discretisation: Discretisation) -> list[int]:
    """Cells along each axis of a grid that ends at the walls of a box of ground.

    Args:
        what: name of the ground in messages.
        ground: its box.
        discretisation: cell, spacing and numerical choices.

    Returns:
        Number of cells along each axis.

    Raises:
        ValueError: If the grid does not fit the box.
    """
    check_discretisation(discretisation, len(ground.corner))
    counts = []
    for axis, length, spacing in zip("xy", ground.extent[:-1], discretisation.spacing, strict=False):
        name = f"{what}'s length" + (f" along {axis}" if len(ground.corner) == 3 else "")
        check.multiple(name, length, f"the spacing along {axis}", spacing)
        counts.append(check.multiple(name, length, "cell", discretisation.cell))
    check_resolved(what, ground.corner, ground.extent, discretisation)
    return [*counts, cells_up(discretisation, ground.extent[-1])]


def box_grid(corner: Sequence[float] | np.ndarray, counts: Sequence[int], cell: float) -> Grid:
    """Grid with `counts` cells along each axis from a corner (d,) m, and PADDING cells beyond the walls."""
    origin = np.array(corner) - PADDING * cell
    return Grid(tuple(count + 1 + 2 * PADDING for count in counts), cell, tuple(origin.tolist()))


def nodes_in_plan(grid: Grid, walls: Sequence[tuple[float, float]]) -> tuple[np.ndarray, ...]:
    """Positions along x and y (nx, ny) m of a grid's nodes, those on and beyond a wall just inside it.

    Where a polygon follows a wall, the wall is the constraint.

    Args:
        grid: of the nodes.
        walls: positions of the walls along x and along y (m).
    """
    axes = (start + grid.cell * np.arange(n) for start, n in zip(grid.origin, grid.shape, strict=True))
    inner = ((low + 1e-6 * grid.cell, high - 1e-6 * grid.cell) for low, high in walls)
    return np.meshgrid(*(axis.clip(*ends) for axis, ends in zip(axes, inner, strict=False)), indexing="ij")
