"""An earthquake as the acceleration of the ground's rigid base, felt in the frame that moves with it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import jax
import jax.numpy as jnp
from jax import Array

from foundation.check import Limit, above_zero
from foundation.pytrees import pytree


@pytree
@dataclass(frozen=True)
class BaseMotion:
    """Acceleration (d, m) m/s2 of the base along the scene's axes, sampled every `interval` (s) from time 0, m > 1.

    Linear between samples, and none after the last. A scene with it is solved in the frame of the base: displacements
    and velocities are those over the base, and the soil is pushed against the acceleration, alike everywhere.
    Source: Clough and Penzien (1993), Dynamics of Structures, section 2-5 (support motion).
    """

    acceleration: Array
    interval: Array

    PARAMETERS: ClassVar[Mapping[str, Limit]] = {"acceleration": Limit(unit="m/s2"), "interval": above_zero("s")}

    def at(self, time: Array) -> Array:
        """Acceleration (d,) m/s2 at a time (s)."""
        place, last = time / self.interval, self.acceleration.shape[1] - 1
        before = jnp.clip(jnp.floor(place), 0, last - 1)
        pair = jax.lax.dynamic_slice_in_dim(self.acceleration, before.astype(jnp.int32), 2, axis=1)
        value = pair[:, 0] + (place - before) * (pair[:, 1] - pair[:, 0])
        return jnp.where(place <= last, value, 0)
