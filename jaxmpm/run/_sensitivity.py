"""Sensitivity to the numbers of a law within a slope: one reverse run, one derivative per particle and number."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from jaxmpm.laws import with_parameters
from jaxmpm.run._checkpointed import replay
from jaxmpm.setup import WALL_STRENGTH, check_scene, numbers_of
from jaxmpm.support import check
from jaxmpm.types import Scene, State, Status


def sensitivity(
    scene: Scene,
    state: State,
    objective: Callable[[State], Array],
    parameters: Collection[str] | None = None,
    *,
    steps: int,
    memory: float = 2e9,
) -> tuple[Array, dict[str, Array]]:
    """Value of an objective after a run, and its derivatives by the law's numbers at each particle.

    One run in reverse mode gives all of them, and those by the strength of contacts at each node. A derivative divided
    by the volume of its particle does not depend on the number of particles. The initial state is a constant: the
    stress at rest does not change with the stiffness. JAX compiles it once for each objective, set of parameters and
    number of steps.

    Args:
        scene: with a law of any kind.
        state: at the start.
        objective: State -> scalar, for example `objectives.soft_largest_displacement`.
        parameters: names of numbers that the law declares, as `laws.declared` lists them, and wall_friction and
            wall_cohesion where walls or a base have them; None for all of them.
        steps: a Python integer.
        memory: bytes that reverse mode may use.

    Returns:
        Value (), and by the names given the derivatives per unit of each number, of an angle per radian: (N,) at the
        particles, 0 in zones whose law does not have it, and (nodes,) of contacts.

    Raises:
        ValueError: If the scene has no such number, one is beyond its limit, or as for `replay`.
        FloatingPointError: If the run breaks off.
    """
    numbers = numbers_of(scene)
    names = numbers if parameters is None else parameters
    if unknown := sorted(set(names) - numbers.keys()):
        raise ValueError(f"{unknown} is no parameter of {type(scene.material).__name__}: give some of {[*numbers]}")
    check_scene(scene)
    shapes = {name: (scene.grid.nodes,) if name in WALL_STRENGTH else scene.particles.mass.shape for name in names}
    values = {name: jnp.broadcast_to(numbers[name], shape) for name, shape in shapes.items()}
    (value, status), derivatives = _derivatives(values, scene, state, objective=objective, steps=steps, memory=memory)
    if not check.is_traced(status) and int(status) > Status.DECIDED:
        remedy = "the scene from follow_soil with the state reached" if status == Status.GRID_FULL else "fewer"
        raise FloatingPointError(f"the run breaks off within {steps} steps ({Status(int(status)).name}): give {remedy}")
    return value, derivatives


@partial(jax.jit, static_argnames=("objective", "steps", "memory"))
@partial(jax.value_and_grad, has_aux=True)
def _derivatives(
    values: dict[str, Array],
    scene: Scene,
    state: State,
    *,
    objective: Callable[[State], Array],
    steps: int,
    memory: float,
) -> tuple[Array, Array]:
    """Objective and status of a run with these numbers of the law and of walls."""
    walls: dict[str, Any] = {WALL_STRENGTH[name]: value for name, value in values.items() if name in WALL_STRENGTH}
    law = with_parameters(scene.material, {name: v for name, v in values.items() if name not in WALL_STRENGTH})
    varied = replace(scene, material=law, boundary=replace(scene.boundary, **walls))
    end, _ = replay(varied, state, steps, memory=memory)
    return objective(end), end.status
