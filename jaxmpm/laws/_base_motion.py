"""An earthquake as the acceleration of the ground's rigid base; the scene is solved in the frame that moves with it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import jax
import jax.numpy as jnp
from jax import Array

from jaxmpm.support.check import Limit, above_zero
from jaxmpm.support.pytrees import pytree


@pytree
@dataclass(frozen=True)
class BaseMotion:
    """Acceleration of the base, sampled at equal intervals from time 0.

    It is linear between samples, and 0 after the last. Displacements and velocities of a scene with it are relative to
    the base, and every particle feels the opposite acceleration.

    Source: Clough and Penzien (1993), Dynamics of Structures, Section 2-5 (support motion).

    Args:
        acceleration: (d, m) m/s2 along the scene's axes, m > 1.
        interval: time between samples (s).
    """

    acceleration: Array
    interval: Array

    PARAMETERS: ClassVar[Mapping[str, Limit]] = {"acceleration": Limit(unit="m/s2"), "interval": above_zero("s")}

    @property
    def duration(self) -> Array:
        """Time of the last sample (s)."""
        return self.interval * (self.acceleration.shape[1] - 1)

    def at(self, time: Array) -> Array:
        """Acceleration (d,) m/s2 at a time (s)."""
        sample, last = time / self.interval, self.acceleration.shape[1] - 1
        before = jnp.clip(jnp.floor(sample), 0, last - 1)
        pair = jax.lax.dynamic_slice_in_dim(self.acceleration, before.astype(jnp.int32), 2, axis=1)
        value = pair[:, 0] + (sample - before) * (pair[:, 1] - pair[:, 0])
        return jnp.where(sample <= last, value, 0)
