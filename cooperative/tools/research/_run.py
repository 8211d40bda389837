"""A run of a scene with other numbers of its soil, differentiable by them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from jaxmpm import Scene, State, Status, replay, with_soil

Field = Callable[[Array], Mapping[str, ArrayLike]]
"""Coefficients (n,) -> values that `jaxmpm.with_soil` takes, by name."""


def varied_run(
    scene: Scene, state: State, values: Mapping[str, ArrayLike], steps: int, **choices: Any
) -> tuple[State, Any]:
    """`jaxmpm.replay` of the scene with other values, nan where the run breaks off.

    Initial stress follows the values. All runs have the scene's time step, so that they last as long.

    Args:
        scene: to vary.
        state: at the start.
        values: as `jaxmpm.with_soil` takes them.
        steps: of the run.
        **choices: of `jaxmpm.replay`.

    Returns:
        As `jaxmpm.replay`.
    """
    varied, start = with_soil(scene, state, **values)
    varied = replace(varied, numerics=replace(varied.numerics, time_step=scene.numerics.time_step))
    final, observed = replay(varied, start, steps, **choices)
    lost = jnp.where(final.status > Status.DECIDED, jnp.nan, 0.0)
    final = replace(final, displacement=final.displacement + lost.astype(final.displacement.dtype))
    return final, jax.tree.map(lambda leaf: leaf + lost.astype(leaf.dtype), observed)
