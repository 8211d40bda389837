"""Pressure heads at points: the seam to particles."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from jaxmpm.grid import static
from jaxmpm.seepage._step import Problem
from jaxmpm.support.pytrees import pytree


@pytree
@dataclass(frozen=True)
class Heads:
    """Heads at one time, linear between the centres of cells.

    The total head is interpolated, so that water at rest is exact. Above and below the soil of a column it is that of
    the next cell with soil, and beyond the ends of the cells that of the last column.

    Args:
        total: total heads of the cells' shape, above the cells' corner (m), in cells without soil too.
        spacing: edges of a cell (m); static.
        corner: lowest corner of the cells (m); static.
    """

    total: Array
    spacing: tuple[float, ...] = static()
    corner: tuple[float, ...] = static()

    @classmethod
    def of(cls, problem: Problem, head: Array) -> Heads:
        """Heads of the cells of a problem, from their pressure heads (m)."""
        z = (jnp.arange(problem.shape[-1]) + 0.5).astype(head.dtype) * problem.spacing[-1]
        total = head + z
        if problem.active is not None:
            total = total.ravel()[_nearest(np.asarray(problem.active) > 0)]
        return cls(total, problem.spacing, problem.corner)

    def at(self, position: ArrayLike) -> Array:
        """Pressure heads at points.

        Args:
            position: (d, N) m.

        Returns:
            (N,) m, below 0 under suction.
        """
        place = jnp.asarray(position)
        if place.ndim != 2 or len(place) != self.total.ndim:
            raise ValueError(f"position has shape {place.shape}: give ({self.total.ndim}, N)")
        low, share = [], []
        for at, corner, h, n in zip(place, self.corner, self.spacing, self.total.shape, strict=True):
            cell = jnp.clip((at - corner) / h - 0.5, 0, n - 1)
            first = jnp.clip(jnp.floor(cell), 0, max(n - 2, 0)).astype(jnp.int32)
            low.append(first)
            share.append(cell - first)
        value = jnp.zeros(place.shape[1], self.total.dtype)
        for ends in product((0, 1), repeat=len(low)):
            weight = jnp.ones_like(value)
            for end, part in zip(ends, share, strict=True):
                weight = weight * (part if end else 1 - part)
            number = tuple(
                jnp.minimum(first + end, n - 1) for first, end, n in zip(low, ends, self.total.shape, strict=True)
            )
            value = value + weight * self.total[number]
        return value - (place[-1] - self.corner[-1])

    def pressure(self, position: ArrayLike, unit_weight: float) -> Array:
        """Pore pressures (N,) Pa at points (d, N) m, below 0 under suction, by the weight of water (N/m3)."""
        return unit_weight * self.at(position)

    def push(self, position: Array, unit_weight: float) -> Array:
        """Force per volume -grad u (d, N) N/m3 of pressures u above 0 at points (d, N) m."""

        def pressure(point: Array) -> Array:
            return unit_weight * jnp.maximum(self.at(point[:, None])[0], 0)

        return -jax.vmap(jax.grad(pressure), in_axes=1, out_axes=1)(position)

    def free_surface(self) -> Array:
        """Height (m) of the highest point of each column below which soil is saturated; nan where none is."""
        z = (jnp.arange(self.total.shape[-1]) + 0.5).astype(self.total.dtype) * self.spacing[-1]
        head = self.total - z
        wet = head >= 0
        top = self.total.shape[-1] - 1 - jnp.argmax(jnp.flip(wet, -1), axis=-1)
        level = jnp.take_along_axis(self.total, top[..., None], -1)[..., 0]
        over = jnp.take_along_axis(head, jnp.minimum(top + 1, self.total.shape[-1] - 1)[..., None], -1)[..., 0]
        under = jnp.take_along_axis(head, top[..., None], -1)[..., 0]
        crossing = z[top] + self.spacing[-1] * under / jnp.maximum(under - over, jnp.finfo(under.dtype).tiny)
        found = jnp.where(top == self.total.shape[-1] - 1, level, crossing)
        return jnp.where(jnp.any(wet, -1), found + self.corner[-1], jnp.nan)


def _nearest(soil: np.ndarray) -> np.ndarray:
    """Number of the cell with soil whose total head each cell takes: in its column, else in the nearest column."""
    number = np.arange(soil.size).reshape(soil.shape)
    n = soil.shape[-1]
    level = np.broadcast_to(np.arange(n), soil.shape)
    under = np.maximum.accumulate(np.where(soil, level, -1), axis=-1)
    over = np.flip(np.minimum.accumulate(np.flip(np.where(soil, level, n), -1), axis=-1), -1)
    nearer_under = (under >= 0) & ((over == n) | (level - under <= over - level))
    chosen = np.where(nearer_under, under, np.minimum(over, n - 1))
    columns = np.take_along_axis(number, chosen, -1)
    has = soil.any(axis=-1)
    if not has.all():
        plan = np.stack(np.meshgrid(*map(np.arange, has.shape), indexing="ij"), axis=-1)
        full, bare = plan[has], plan[~has]
        nearest = full[((bare[:, None] - full[None]) ** 2).sum(-1).argmin(axis=1)]
        columns[~has] = columns[tuple(nearest.T)]
    return columns
