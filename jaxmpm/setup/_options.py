"""Options of a scene: what constrains its nodes, and what loads its particles."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from jax import Array
from jax.typing import ArrayLike

from jaxmpm.grid import RigidBase, Wall
from jaxmpm.laws import BaseMotion, WaterSurface, WaterTable


@dataclass(frozen=True)
class Boundary:
    """What constrains the nodes of a grid.

    Args:
        walls: planes that constrain nodes.
        friction: coefficient of walls with friction and of the base, a number or (nodes,).
        cohesion: of those (Pa), likewise; None for none.
        pressure: (nodes,) pressure of the water between these walls and the soil (Pa); None for none.
        tied: numbers of two planes of nodes along x that are identified; None for none.
        cut: (nodes,) bool, nodes at which nothing moves; None if walls are all.
        base: rigid ground of any shape, with the friction, cohesion and water pressure of walls with friction; None for
            none.
        softening: share of that friction and cohesion which slip leaves, and the slip (m) over which they fall to it;
            None for none.
    """

    walls: Sequence[Wall] = ()
    friction: ArrayLike | None = None
    cohesion: ArrayLike | None = None
    pressure: ArrayLike | None = None
    tied: tuple[int, int] | None = None
    cut: ArrayLike | None = None
    base: RigidBase | None = None
    softening: tuple[float, float] | None = None


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
