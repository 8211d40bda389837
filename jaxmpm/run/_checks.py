"""Checks of the state that a run starts from."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from jaxmpm.laws import of_skeleton, remembers_gap
from jaxmpm.types import Scene, State


def check_state(scene: Scene, state: State, axes: Scene | None) -> None:
    """Check that a state fits a scene.

    Args:
        scene: to run.
        state: at the start.
        axes: leaves of the scene that have lanes first, None without lanes.

    Raises:
        ValueError: If the state is of other particles or another precision, lacks lanes, or lacks the history, its
            unaveraged change or the gap of its law.
    """
    leading = () if axes is None else np.shape(state.status)
    shape = (*leading, *scene.particles.position.shape[-2:])
    if axes is not None and len(leading) != 1:
        raise ValueError("axes name lanes, but the state has none: give repeat(state, lanes)")
    if leading == (0,):
        raise ValueError("the state has 0 lanes: give one or more")
    if np.shape(state.status) != leading or np.shape(state.displacement) != shape:
        raise ValueError(
            f"the state's displacement has shape {np.shape(state.displacement)}, the scene needs {shape}: give the "
            "state that was built with it, and `axes` with lanes"
        )
    precisions = [jnp.result_type(array) for array in (state.displacement, scene.particles.position)]
    if precisions[0] != precisions[1]:
        raise ValueError("the state is {}, the scene {}: build both with the same precision".format(*precisions))
    law = scene.material
    initial = jax.eval_shape(law.initial_history, scene.particles)
    expected: object = jax.tree.structure(initial)
    if expected != jax.tree.structure(state.history):
        raise ValueError(
            f"the state's history is not that of {type(law).__name__}: give the state that was built with this law, or "
            "replace(state, history=scene.material.initial_history(scene.particles))"
        )
    changes: object = jax.tree.structure(of_skeleton(initial))
    if scene.numerics.nonlocal_passes is not None and changes != jax.tree.structure(state.unaveraged):
        raise ValueError(
            "the scene averages the change of the history over neighbours, and the state has none: give the state that "
            "was built with it, or replace(state, unaveraged=unstressed(scene).unaveraged)"
        )
    if state.gap is None and remembers_gap(scene.material):
        raise ValueError(
            f"{type(scene.material).__name__} remembers the gap that its tension cutoff opens, and the state has none: "
            "give the state that was built with it, or the law gap_memory = False"
        )
