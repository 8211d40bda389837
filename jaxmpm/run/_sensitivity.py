"""Sensitivity to strength within a slope: one reverse run, one derivative per particle."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import jax
import jax.numpy as jnp
from jax import Array

from jaxmpm.laws import declared, with_parameters
from jaxmpm.run._checkpointed import replay
from jaxmpm.setup import check_scene
from jaxmpm.support import check
from jaxmpm.types import Scene, State, Status


def strength_sensitivity(
    scene: Scene, state: State, steps: int, objective: Callable[[State], Array], *, memory: float = 2e9
) -> tuple[Array, Array]:
    """Value of an objective after a run, and its derivative by the strength of every particle.

    Divided by a particle's volume the derivative does not depend on the number of particles.

    Args:
        scene: with a law that has a strength.
        state: at the start.
        steps: a Python integer.
        objective: State -> scalar, for example `objectives.soft_largest_displacement`.
        memory: bytes that reverse mode may use.

    Returns:
        Value (), and derivative (N,) per Pa.

    Raises:
        ValueError: If the material has no strength, a number is beyond its limit, or as for `replay`.
        FloatingPointError: If the run breaks off.
    """
    known = declared(scene.material).get("strength")
    if known is None:
        raise ValueError(
            f"{type(scene.material).__name__} has no strength: give a J2 material, as `Soil(strength=..)` makes"
        )

    def reached(strength: Array) -> tuple[Array, Array]:
        varied = replace(scene, material=with_parameters(scene.material, {known.path: strength}))
        end, _ = replay(varied, state, steps, memory=memory)
        return objective(end), end.status

    check_scene(scene)
    strength = jnp.broadcast_to(known.value, scene.particles.mass.shape)
    (value, status), derivative = jax.jit(jax.value_and_grad(reached, has_aux=True))(strength)
    if not check.is_traced(status) and int(status) > Status.DECIDED:
        raise FloatingPointError(f"the run breaks off within {steps} steps ({Status(int(status)).name}): give fewer")
    return value, derivative
