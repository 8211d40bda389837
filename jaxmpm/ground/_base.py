"""Rigid ground under soil: its boundary, and for bedrock of any shape its nodes, their normals and areas."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import product

import jax
import numpy as np
from jax import Array

from jaxmpm.equations import gap_of
from jaxmpm.grid import Grid, RigidBase, Wall
from jaxmpm.setup import PADDING, RESOLVED
from jaxmpm.soil import Interface, radians
from jaxmpm.support import check
from jaxmpm.support.tracing import array, at_once, host
from jaxmpm.types import Boundary

Heights = Callable[..., np.ndarray]
"""Function of x or, in 3D, of x and y (m), arrays of any shape: elevations (m) of their shape."""

SAMPLES = 4
"""Points along each edge of a cell at which the surface is sampled."""

NEAR = 0.5 - 1e-6
"""Distance of a node from rigid ground, over the cell, below which it belongs to it."""

COVER = 3.0
"""Thickness of the soil, in cells along the normal, over which it is counted."""


def check_bedrock(plan: np.ndarray, bedrock: np.ndarray, surface: np.ndarray, base: float) -> None:
    """Refuse bedrock that does not lie between the ground's surface and the base.

    Args:
        plan: positions of points in plan (d - 1, n) m.
        bedrock: its heights there (n,) m.
        surface: those of the ground (n,) m.
        base: height of the base (m).

    Raises:
        ValueError: If a point lies above the surface or below the base.
    """
    for beyond, where in (
        (bedrock - surface, "above the surface: draw it below, or along the surface where rock crops out"),
        (base - bedrock, f"below the base at {base:g} m: lower the base"),
    ):
        worst = int(np.argmax(beyond))
        if beyond[worst] > 1e-6 * (1 + abs(bedrock[worst])):
            at = ", ".join(f"{coordinate:g}" for coordinate in (*plan[:, worst], bedrock[worst]))
            raise ValueError(f"bedrock at ({at}) m lies {beyond[worst]:g} m {where}")


def boundary_of_base(
    grid: Grid,
    bedrock: Heights | None,
    interface: Interface | None,
    pressure: np.ndarray | None,
    cut: np.ndarray | None = None,
) -> Boundary:
    """Boundary of the rigid ground under soil.

    Under a water table soil presses on it with its effective stress alone, with r_u with that of the water too.

    Args:
        grid: of the nodes.
        bedrock: its surface; None for a level base at the lowest wall.
        interface: strength of the contact; None if soil sticks to it.
        pressure: (nodes,) of r_u on it (Pa); None without.
        cut: (nodes,) bool, other nodes at which nothing moves; None for none.

    Returns:
        Boundary without upright walls.
    """
    level = Wall(grid.dimension - 1, "low", PADDING, "fixed" if interface is None else "friction")
    boundary = Boundary((level,) if bedrock is None else (), cut=cut)
    if interface is not None:
        boundary = replace(
            boundary,
            friction=tangent_of(interface.friction),
            cohesion=interface.cohesion if check.is_traced(interface.cohesion) else interface.cohesion or None,
            pressure=pressure,
            softening=None if interface.slip_length is None else (interface.residual_ratio, interface.slip_length),
            softens=interface.softens,
        )
    if bedrock is None:
        return boundary
    base = rigid_base(grid, bedrock)
    if interface is not None:
        return replace(boundary, base=base)
    stuck = np.asarray(base.normal.any(axis=1))
    return replace(boundary, cut=stuck if cut is None else stuck | cut)


def tangent_of(friction: float | Array) -> float | Array:
    """The coefficient of a friction angle (degrees), of a number or of an array."""
    if isinstance(friction, int | float):
        return math.tan(math.radians(friction))
    tangent: Array = host(friction).tan(radians(friction))
    return tangent


def share_above(bedrock: Heights, position: np.ndarray, spacing: float) -> np.ndarray:
    """Share (N,) of particles that counts as soil: 1 above bedrock, 0 below, a half where their centre lies on it.

    Args:
        bedrock: its surface.
        position: of the particles (d, N) m.
        spacing: of theirs along z (m), a share of which rounds.
    """
    height = position[-1] - bedrock(*position[:-1])
    return np.where(np.abs(height) < RESOLVED * spacing, 0.5, height > 0)


def rigid_base(grid: Grid, heights: Heights) -> RigidBase:
    """Bedrock on a grid: the nodes up to half a cell above its surface, so that it is neither too high nor too low.

    Args:
        grid: of the nodes.
        heights: of its surface.

    Returns:
        The base.
    """
    axes = [start + grid.cell * np.arange(n) for start, n in zip(grid.origin, grid.shape, strict=True)]
    *across, z = np.meshgrid(*axes, indexing="ij")
    normal = normals(heights, across, grid.cell)
    height = (z - heights(*across)) * normal[-1]
    on_base = (height < NEAR * grid.cell).ravel()
    area, volume = _covered(grid, heights, on_base)
    field = volume.reshape(grid.shape)
    # Soil above a node of the base counts as reaching down to it.
    between = at_once(jax.jit(gap_of), field[..., :-1], field[..., 1:])
    gap = np.pad(np.asarray(between), [(0, 0)] * (grid.dimension - 1) + [(0, 1)]).ravel()
    volume = volume / (1 - gap) ** 2
    vectors = np.where(on_base[:, None], normal.reshape(grid.dimension, -1).T, 0.0)
    fields = vectors, area, np.where(area > 0, volume, 1.0)
    return RigidBase(*(array(values, jax.dtypes.canonicalize_dtype(float)) for values in fields))


def normals(heights: Heights, across: list[np.ndarray], step: float) -> np.ndarray:
    """Unit normals (d, ...) of a surface at points in plan (m), by differences over a step (m)."""
    slopes = []
    for axis in range(len(across)):
        low, high = (
            heights(*(at + side * step / 2 if k == axis else at for k, at in enumerate(across))) for side in (-1, 1)
        )
        slopes.append((high - low) / step)
    vector = np.stack([*(-slope for slope in slopes), np.ones(across[0].shape)])
    return vector / np.linalg.norm(vector, axis=0)


def _covered(grid: Grid, heights: Heights, on_base: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Area of the surface (nodes,) m2 by the nodes on the base, and volume of soil in full cells above them (m3)."""
    part = grid.cell / SAMPLES
    plan = [
        start + grid.cell / 2 + part * (np.arange((n - 2) * SAMPLES) + 0.5)
        for start, n in zip(grid.origin[:-1], grid.shape[:-1], strict=True)
    ]
    across = [axis.ravel() for axis in np.meshgrid(*plan, indexing="ij")]
    upright = normals(heights, across, grid.cell)[-1]
    surface = np.array([*across, heights(*across)])
    patch = part ** len(across)
    volume = np.zeros(grid.nodes)
    for level in range(round(COVER * SAMPLES)):
        points = surface.copy()
        points[-1] += (level + 0.5) * part / upright
        weights, nodes = _hats(grid, points)
        volume += np.bincount(nodes.ravel(), (weights * patch * part / upright).ravel(), grid.nodes)
    # By the uppermost nodes of the base, which soil that has come down reaches too.
    upper = on_base.reshape(grid.shape).copy()
    upper[..., :-1] &= ~upper[..., 1:]
    weights, nodes = _hats(grid, surface)
    weights = weights * np.where(upper.ravel(), volume, 0.0)[nodes]
    total = weights.sum(axis=0)
    shares = np.divide(weights, total, out=np.zeros_like(weights), where=total > 0)
    return np.bincount(nodes.ravel(), (shares * patch / upright).ravel(), grid.nodes), volume


def _hats(grid: Grid, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Weights (2**d, n) of linear shape functions at points (d, n) m, and their nodes; 0 beyond the grid."""
    cells = (points - np.array(grid.origin)[:, None]) / grid.cell
    first = np.clip(np.floor(cells), 0, np.array(grid.shape)[:, None] - 2).astype(int)
    along = cells - first
    inside = ((along >= 0) & (along <= 1)).all(axis=0)
    weights, nodes = [], []
    for corner in product((0, 1), repeat=grid.dimension):
        side = np.array(corner)[:, None]
        weights.append(np.where(side, along, 1 - along).prod(axis=0) * inside)
        nodes.append(np.ravel_multi_index(tuple(first + side), grid.shape))
    return np.array(weights), np.array(nodes)
