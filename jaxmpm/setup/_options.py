"""Options of a scene: what constrains its nodes, and what loads its particles."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, TypeVar

from jax import Array
from jax.typing import ArrayLike

from jaxmpm.grid import Grid, RigidBase, Wall
from jaxmpm.laws import BaseMotion, WaterSurface, WaterTable
from jaxmpm.protocols import Kernel
from jaxmpm.setup._discretisation import Discretisation


@dataclass(frozen=True)
class Boundary:
    """What constrains the nodes of a grid.

    Args:
        walls: planes that constrain nodes.
        friction: coefficient of walls with friction and of the base.
        cohesion: of those (Pa); None for none.
        pressure: (nodes,) pressure of the water between these walls and the soil (Pa); None for none.
        tied: numbers of two planes of nodes along x that are identified; None for none.
        cut: (nodes,) bool, nodes at which nothing moves; None if walls are all.
        base: rigid ground of any shape, with the friction, cohesion and water pressure of walls with friction; None for
            none.
        softening: share of that friction and cohesion which slip leaves, and the slip (m) over which they fall to it;
            None for none.
    """

    walls: Sequence[Wall] = ()
    friction: float | None = None
    cohesion: float | None = None
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
    """

    gravity: float | Sequence[float] = 0.0
    body_force: Callable[[Array, Array], Array] | None = None
    water: WaterTable | WaterSurface | None = None
    pore_pressure: ArrayLike | None = None
    motion: BaseMotion | None = None


RENAMED = {"wall_friction": "friction", "wall_cohesion": "cohesion", "wall_pressure": "pressure"}
"""Keywords that `scene` had before, by another name than that of the option."""

Options = TypeVar("Options", Discretisation, Boundary, Loads)


def regrouped(grid: Grid, keywords: Mapping[str, Any]) -> tuple[Kernel, Discretisation, Boundary, Loads]:
    """Options from the keywords that `scene` had before, with a DeprecationWarning.

    Args:
        grid: of the scene.
        keywords: those that were given.

    Returns:
        Kernel, numerical choices, boundary and loads.

    Raises:
        TypeError: If a keyword is unknown, or there is no kernel.
    """
    given = {RENAMED.get(name, name): value for name, value in keywords.items()}
    known = {"kernel", *(field.name for kind in (Discretisation, Boundary, Loads) for field in fields(kind))}
    if unknown := sorted(given.keys() - known):
        raise TypeError(f"scene() takes no {', '.join(unknown)}")
    if "kernel" not in given:
        raise TypeError("scene() has no numerical choices: give discretisation = Discretisation(cell, spacing)")
    warnings.warn(
        f"the keywords {', '.join(sorted(keywords))} of scene() will leave the next version, give discretisation, "
        "boundary and loads",
        DeprecationWarning,
        stacklevel=3,
    )
    kernel = given.pop("kernel")

    def of(kind: type[Options], **first: Any) -> Options:
        return kind(**first, **{field.name: given[field.name] for field in fields(kind) if field.name in given})

    numerics = of(Discretisation, cell=grid.cell, spacing=(grid.cell,) * grid.dimension)
    return kernel, numerics, of(Boundary), of(Loads)
