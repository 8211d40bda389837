"""Options of a scene: what loads its particles."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from jax import Array
from jax.typing import ArrayLike

from jaxmpm.laws import BaseMotion, WaterSurface, WaterTable


@dataclass(frozen=True)
class Loads:
    """What loads the particles of a scene.

    Args:
        gravity: downwards (m/s2), or a vector (d,).
        body_force: (initial positions (d, N) m, time s) -> acceleration (d, N) m/s2 added to gravity.
        water: table or surface of the water. The strength of undrained soil does not depend on the mean stress, so a
            table below the surface changes nothing there, and a pool is a pressure on the surface.
        pore_pressure: (N,) Pa, constant on each particle; needs a law of effective stress.
        motion: of the base, in whose frame the scene is solved.
        k0: horizontal over vertical effective stress from which the equilibrium at rest is reached, a number or one
            value per particle (N,); None for that of elastic loading, nu / (1 - nu). Level ground has it at rest.
    """

    gravity: float | Sequence[float] = 0.0
    body_force: Callable[[Array, Array], Array] | None = None
    water: WaterTable | WaterSurface | None = None
    pore_pressure: ArrayLike | None = None
    motion: BaseMotion | None = None
    k0: ArrayLike | None = None
