"""1D shape functions and their product stencil: three nodes per axis for every kernel.

With r the distance from a node in cells, a particle at x touches the nodes base, base + 1 and base + 2 of an
axis, base = floor(x/h - 1/2). Weights beyond a kernel's support are zero.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from types import ModuleType
from typing import TypeVar

import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmpm.grid import Grid

Points = TypeVar("Points", Array, np.ndarray)

WIDTH = 3
"""Nodes per axis in a stencil."""


def locate(grid: Grid, position: Points) -> Points:
    """Positions in cells from node 0, the unit of the other functions here.

    Args:
        grid: of the nodes.
        position: (d, N) m, of JAX or of NumPy.

    Returns:
        (d, N) cells, of the same library.
    """
    origin = _library(position).asarray(grid.origin, position.dtype)[:, None]
    return (position - origin) / grid.cell


def inside(grid: Grid, cells: Points) -> Points:
    """Whether all nodes of a particle's stencil lie on the grid.

    Args:
        grid: of the nodes.
        cells: (d, N) positions, from `locate`.

    Returns:
        (N,) bool of the same library, False for NaN.
    """
    library = _library(cells)
    limits = library.asarray(grid.shape, cells.dtype)[:, None]
    return library.all((cells >= 0.5) & (cells < limits - 1.5), axis=0)


def base_node(grid: Grid, cells: Array) -> Array:
    """Lowest node of each stencil (d, N), clipped to the grid for any position, NaN included."""
    highest = jnp.asarray(grid.shape, cells.dtype)[:, None] - WIDTH
    lowest = jnp.floor(cells - 0.5)
    return jnp.where(lowest > 0, jnp.minimum(lowest, highest), 0).astype(jnp.int32)


@dataclass(frozen=True)
class Linear:
    """Linear (hat) shape functions, 1 - |r| at r cells from the node; particles are points."""

    @classmethod
    def of_spacing(cls, spacing: tuple[float, ...]) -> Linear:
        """The same kernel for any spacing (m)."""
        return cls()

    def shape(self, axis: int, cell: float, r: Array) -> tuple[Array, Array]:
        """Value and derivative (1/m) of the function along an axis, r cells from the node."""
        support = (r >= -1) & (r < 1)
        return jnp.where(support, 1 - jnp.abs(r), 0.0), jnp.where(support, _falling(r) / cell, 0.0)

    def deviation(self, cell: float) -> float:
        """Standard deviation cell / sqrt(3), in m."""
        return cell / math.sqrt(3)


@dataclass(frozen=True)
class GIMP:
    """Undeformed generalised interpolation: a hat function averaged over a box of fixed size.

    With l the half size in cells the function is 1 - (r^2 + l^2)/(2 l) for |r| < l, 1 - |r| up to 1 - l, and
    (1 + l - |r|)^2/(4 l) up to 1 + l.

    Sources: Bardenhagen and Kober (2004), CMES 5(6), 477-495, with an undeformed particle domain; Steffen, Kirby and
    Berzins (2008), doi:10.1002/nme.2360 (the function).

    Args:
        half_size: half of the particle's edge per axis (m), above 0 and at most half a cell.
    """

    half_size: tuple[float, ...]

    @classmethod
    def of_spacing(cls, spacing: tuple[float, ...]) -> GIMP:
        """Boxes that touch each other, for particles this far apart along each axis (m)."""
        return cls(tuple(s / 2 for s in spacing))

    def shape(self, axis: int, cell: float, r: Array) -> tuple[Array, Array]:
        """Value and derivative (1/m) of the function along an axis, r cells from the node."""
        a, sign, l = jnp.abs(r), _falling(r), self.half_size[axis] / cell
        tail = jnp.where(a < 1 + l, 1 + l - a, 0)
        value = jnp.where(a < l, 1 - (r * r + l * l) / (2 * l), jnp.where(a < 1 - l, 1 - a, tail * tail / (4 * l)))
        slope = jnp.where(a < l, -r / l, jnp.where(a < 1 - l, sign, sign * tail / (2 * l)))
        return value, slope / cell

    def deviation(self, cell: float) -> float:
        """Standard deviation (m) of the hat, widened by the longest edge of the box."""
        return math.sqrt((cell**2 + 2 * max(self.half_size) ** 2) / 3)


@dataclass(frozen=True)
class QuadraticBSpline:
    """Quadratic B-splines: smooth shape functions of points, 3/4 - r^2 for |r| < 1/2, (3/2 - |r|)^2/2 up to 3/2.

    Source: Steffen, Kirby and Berzins (2008), doi:10.1002/nme.2360.
    """

    @classmethod
    def of_spacing(cls, spacing: tuple[float, ...]) -> QuadraticBSpline:
        """The same kernel for any spacing (m)."""
        return cls()

    def shape(self, axis: int, cell: float, r: Array) -> tuple[Array, Array]:
        """Value and derivative (1/m) of the function along an axis, r cells from the node."""
        a = jnp.abs(r)
        tail = jnp.where(a < 1.5, 1.5 - a, 0)
        value = jnp.where(a < 0.5, 0.75 - r * r, 0.5 * tail * tail)
        return value, jnp.where(a < 0.5, -2 * r, _falling(r) * tail) / cell

    def deviation(self, cell: float) -> float:
        """Standard deviation cell / sqrt(2), in m."""
        return cell / math.sqrt(2)


def _library(values: Array | np.ndarray) -> ModuleType:
    """NumPy for its arrays, which the host works with, else `jax.numpy`."""
    return np if isinstance(values, np.ndarray) else jnp


def _falling(r: Array) -> Array:
    """Sign of the derivative of a function that decreases away from its node."""
    return jnp.where(r < 0, 1.0, -1.0).astype(r.dtype)
