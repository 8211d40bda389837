"""Steps on the device: a lane takes them until its status ends it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.sharding import Mesh

from jaxmpm._step import stepped
from jaxmpm.laws import hardens, snaps_back
from jaxmpm.run._columns import recorded
from jaxmpm.run._devices import over_devices
from jaxmpm.support import check
from jaxmpm.transfer import with_room
from jaxmpm.types import Scene, State, Status

Result = TypeVar("Result")
Tree = TypeVar("Tree")


def checked(scene: Scene, state: State) -> State:
    """The state, with status BAD_PARAMETER if it is running and a number of its scene is invalid."""
    good = check.admissible(scene)
    for wrong in (snaps_back(scene.material), hardens(scene.material)):
        good = good if wrong is None else good & ~wrong
    bad = (state.status == Status.RUNNING) & ~good
    return replace(state, status=jnp.where(bad, int(Status.BAD_PARAMETER), state.status).astype(jnp.int32))


def running(state: State) -> State:
    """The state with all lanes running that have not broken off."""
    ended = state.status <= Status.DECIDED
    return replace(state, status=jnp.where(ended, Status.RUNNING, state.status).astype(jnp.int32))


def advance(scene: Scene, state: State, steps: int | Array) -> State:
    """Take steps; a lane that is not running does not change.

    A Python number of steps gives a loop of that length, differentiable in reverse. A traced one compiles once for all
    numbers, and ends when the lane does. A lane with a number in its scene that is not finite or beyond its limit takes
    no step and gets the status BAD_PARAMETER.

    Args:
        scene: to run.
        state: of one lane.
        steps: their number.

    Returns:
        State.
    """
    state = checked(scene, state)

    def advanced(old: State) -> State:
        return stepped(scene, old, scene.numerics.time_step)

    def frozen_unless_running(_: object, old: State) -> State:
        new = advanced(old)
        new = new if new.columns is None else recorded(scene, new)
        return jax.tree.map(partial(jnp.where, old.status == Status.RUNNING), new, old)

    if isinstance(steps, int):
        return jax.lax.fori_loop(0, steps, frozen_unless_running, state)
    last = state.step + steps

    def until(stop: Array, move: Callable[[State], State], start: State) -> State:
        return jax.lax.while_loop(lambda s: (s.status == Status.RUNNING) & (s.step < stop), move, start)

    if state.columns is None:
        return until(last, advanced, state)
    every = state.columns.every

    def looked_after(start: State) -> State:
        # A look inside the loop would cost every step a quarter, although few steps need it.
        return recorded(scene, until(jnp.minimum(last, (start.step // every + 1) * every), advanced, start))

    return until(last, looked_after, state)


def repeat(state: State, count: int) -> State:
    """Lanes that start from the same state.

    Args:
        state: of one lane.
        count: number of lanes B.

    Returns:
        State with leaves (B, ...).

    Raises:
        ValueError: If `count` is no whole number above 0.
    """
    check.whole("count", count)
    return jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (count, *leaf.shape)), state)


@partial(jax.jit, static_argnames=("axes", "mesh"), donate_argnames="state")
def advance_lanes(scene: Scene, state: State, steps: Array, axes: Scene | None, mesh: Mesh | None = None) -> State:
    """Compiled `advance` over lanes; the given state is donated.

    On CPU each lane takes all its steps before the next one, so that it stays in cache; a vmapped step would stream
    all lanes through memory. On other devices a lane alone runs as one without a batch, whose loop selects no state.
    Devices of a mesh run their own lanes at the same time.

    Args:
        scene: to run.
        state: of one lane, or of B with `axes`.
        steps: () for all lanes, or (B,) for each.
        axes: leaves of the scene that have lanes first, None without lanes; static.
        mesh: devices that share the lanes, None for one; static.

    Returns:
        State.
    """

    def of_one_device(scene: Scene, state: State, steps: Array) -> State:
        if axes is not None and not in_turn() and state.step.shape == (1,):
            alone = advance(take(scene, 0, axes), take(state, 0), jnp.ravel(steps)[0])
            return jax.tree.map(lambda leaf: leaf[None], alone)
        return over_lanes(advance, axes, 0 if jnp.ndim(steps) else None)(scene, state, steps)

    return over_devices(of_one_device, axes, steps, mesh)(scene, state, steps)


def advance_with_room(
    scene: Scene, state: State, steps: int | np.ndarray, axes: Scene | None, mesh: Mesh | None = None
) -> tuple[Scene, Scene | None, State]:
    """`advance_lanes`, with more nodes stored where the soil of a lane reaches more.

    Args:
        scene: to run.
        state: of one lane, or of B with `axes`; it is donated.
        steps: for all lanes, or (B,) for each.
        axes: as of `advance_lanes`.
        mesh: likewise.

    Returns:
        Scene and axes with as many nodes as were needed, and the state after the steps.
    """
    if scene.grid.stored is None:
        return scene, axes, advance_lanes(scene, state, jnp.asarray(steps), axes, mesh)
    last = np.asarray(state.step) + steps
    while True:
        state = advance_lanes(scene, state, jnp.asarray(last - np.asarray(state.step)), axes, mesh)
        full = state.status == Status.GRID_FULL
        if not full.any():
            return scene, axes, state
        state = replace(state, status=jnp.where(full, int(Status.RUNNING), state.status))
        grid = with_room(scene.grid, scene.particles.position + state.displacement)
        scene = replace(scene, grid=grid)
        axes = None if axes is None else replace(axes, grid=grid)


def is_none(node: object) -> bool:
    """Whether a node of a tree is None."""
    return node is None


def take(tree: Tree, index: int | np.ndarray | Array, axes: Tree | None = None) -> Tree:
    """The lane with an index, or the lanes with indices.

    Args:
        tree: of leaves that have lanes first.
        index: of the lane or lanes.
        axes: None where lanes share a leaf, else 0; None if all leaves have lanes.
    """
    if axes is None:
        return jax.tree.map(lambda leaf: leaf[index], tree)
    return jax.tree.map(lambda axis, leaf: leaf if axis is None else leaf[index], axes, tree, is_leaf=is_none)


def in_turn() -> bool:
    """Whether lanes run one after the other."""
    return jax.default_backend() == "cpu"


def over_lanes(function: Callable[..., Result], axes: Scene | None, *others: int | None) -> Callable[..., Result]:
    """The function over the lanes of a batch, or as it is for one lane.

    On CPU lanes run one after the other: XLA adds the numbers of a lane in an order that depends on how many lanes it
    adds up side by side. On other devices they run side by side.

    Args:
        function: of a scene, a state and others.
        axes: mapped axes of the scene, None for one lane.
        others: mapped axes of the other arguments.
    """
    if axes is None:
        return function
    one = jax.custom_batching.sequential_vmap(function) if in_turn() else function
    return jax.vmap(one, in_axes=(axes, 0, *others))
