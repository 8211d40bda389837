"""Where in a slope strength matters: one reverse run, one derivative per particle."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import jax
import jax.numpy as jnp
from jax import Array

from jaxmpm.laws import declared, with_parameters
from jaxmpm.run._checkpointed import replay
from jaxmpm.setup import check_scene
from jaxmpm.types import Scene, State


def strength_sensitivity(
    scene: Scene, state: State, steps: int, objective: Callable[[State], Array], *, memory: float = 2e9
) -> tuple[Array, Array]:
    """Value of `objective` after `steps` steps, and its derivative by the strength of every particle (N,) per Pa.

    objective: State -> scalar, for example `objectives.soft_largest_displacement`. memory: bytes for reverse mode.
    Divided by a particle's volume it no longer depends on how many particles the soil is cut into.
    Raises ValueError for a material without strength, for numbers beyond their limits, and as `replay` does.
    """
    known = declared(scene.material).get("strength")
    if known is None:
        raise ValueError(
            f"{type(scene.material).__name__} has no strength: give a J2 material, as `Soil(strength=..)` makes"
        )

    def reached(strength: Array) -> Array:
        varied = replace(scene, material=with_parameters(scene.material, {known.path: strength}))
        return objective(replay(varied, state, steps, memory=memory)[0])

    check_scene(scene)
    strength = jnp.broadcast_to(known.value, scene.particles.mass.shape)
    return jax.jit(jax.value_and_grad(reached))(strength)
