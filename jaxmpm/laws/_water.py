"""Prescribed water in the ground: hydrostatic pressure below a table, which continues in a pool above the ground."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

import jax.numpy as jnp
from jax import Array
from jax.scipy.ndimage import map_coordinates

from jaxmpm.support.check import Limit, above_zero
from jaxmpm.support.pytrees import pytree


@pytree
@dataclass(frozen=True)
class WaterTable:
    """Pore pressure u = unit_weight (z_w(x) - z) below a table at z_w(x), and none above it: no suction.

    The pressure belongs to the position, whichever soil moves there. A scene with a table solves for the effective
    stress. The force -grad u pushes the soil, whose weight includes the water in it. Where the table lies above the
    ground, u continues in the pool, so its load on the face follows.

    Sources: Griffiths and Lane (1999), doi:10.1680/geot.1999.49.3.387, Fig. 17 (load of the pool); Terzaghi (1943),
    Theoretical Soil Mechanics (equilibrium in effective stress, div s' - grad u + rho g = 0).

    Args:
        x: (m,) rising positions of points of the table (m); beyond them it is level.
        z: (m,) elevations of these points (m).
        unit_weight: of water (N/m3).
        height: of a particle (m); the push on one that the table cuts is proportional to its part below.
    """

    x: Array
    z: Array
    unit_weight: Array
    height: Array

    PARAMETERS: ClassVar[Mapping[str, Limit]] = {"unit_weight": above_zero("N/m3"), "height": above_zero("m")}

    def at_level(self, level: Array) -> WaterTable:
        """The table, level at this height () m."""
        return replace(self, z=jnp.full_like(self.z, level))

    def pressure(self, position: Array) -> Array:
        """Pore pressure u (N,) Pa at positions (d, N) m."""
        return self.unit_weight * jnp.maximum(jnp.interp(position[0], self.x, self.z) - position[-1], 0)

    def push(self, position: Array) -> Array:
        """Force per volume -grad u (d, N) N/m3 at positions (d, N) m."""
        along, upwards = jnp.clip(position[0], self.x[0], self.x[-1]), position[-1]
        slopes = (self.z[1:] - self.z[:-1]) / (self.x[1:] - self.x[:-1])
        slope, table = slopes[0], self.z[0] + slopes[0] * (along - self.x[0])
        for k in range(1, len(slopes)):
            change = slopes[k] - slopes[k - 1]
            # At a point of the table the mean of both slopes: a mirror image has the same.
            slope = slope + change * (jnp.sign(along - self.x[k]) + 1) / 2
            table = table + change * jnp.maximum(along - self.x[k], 0)
        outside = (position[0] < self.x[0]) | (position[0] > self.x[-1])
        under = self.unit_weight * jnp.clip((table - upwards) / self.height + 0.5, 0, 1)
        sideways = [-jnp.where(outside, 0, slope) * under]
        return jnp.stack([*sideways, *[jnp.zeros_like(under)] * (len(position) - 2), under])


@pytree
@dataclass(frozen=True)
class WaterSurface:
    """Pore pressure as of `WaterTable`, below a surface of heights on a square grid of points in plan.

    The surface is linear between the points, and level along an axis beyond the outermost ones.

    Args:
        heights: (nx, ny) m.
        corner: (2,) position of the first point (m).
        step: distance of the points (m).
        unit_weight: of water (N/m3).
        height: of a particle (m), as in `WaterTable`.
    """

    heights: Array
    corner: Array
    step: Array
    unit_weight: Array
    height: Array

    PARAMETERS: ClassVar[Mapping[str, Limit]] = {**WaterTable.PARAMETERS, "step": above_zero("m")}

    def at_level(self, level: Array) -> WaterSurface:
        """The surface, level at this height () m."""
        return replace(self, heights=jnp.full_like(self.heights, level))

    def pressure(self, position: Array) -> Array:
        """Pore pressure u (N,) Pa at positions (3, N) m."""
        table = map_coordinates(
            self.heights, list((position[:2] - self.corner[:, None]) / self.step), 1, mode="nearest"
        )
        return self.unit_weight * jnp.maximum(table - position[-1], 0)

    def push(self, position: Array) -> Array:
        """Force per volume -grad u (3, N) N/m3 at positions (3, N) m."""
        last = jnp.asarray(self.heights.shape, position.dtype)[:, None] - 1
        scaled = (position[:2] - self.corner[:, None]) / self.step
        outside, scaled = (scaled < 0) | (scaled > last), jnp.clip(scaled, 0, last)
        i, j = jnp.minimum(jnp.floor(scaled), last - 1).astype(jnp.int32)
        s, t = scaled[0] - i, scaled[1] - j
        # From the points before and after: those on both sides of a point of the grid, where so the slope is the mean.
        before = jnp.maximum(jnp.ceil(scaled) - 1, 0).astype(jnp.int32)
        after = jnp.minimum(jnp.floor(scaled) + 1, last).astype(jnp.int32)
        h = self.heights

        def across(i: Array) -> Array:
            return h[i, j] + t * (h[i, j + 1] - h[i, j])

        def along(j: Array) -> Array:
            return h[i, j] + s * (h[i + 1, j] - h[i, j])

        rise = jnp.stack([across(after[0]) - across(before[0]), along(after[1]) - along(before[1])])
        slope = jnp.where(outside, 0, rise / ((after - before) * self.step))
        table = across(i) + s * (across(i + 1) - across(i))
        under = self.unit_weight * jnp.clip((table - position[-1]) / self.height + 0.5, 0, 1)
        return jnp.concatenate([-slope * under, under[None]])
