"""Runs that can be differentiated: a known number of steps, with checkpoints that fit into a budget of bytes.

`solve` decides on the host when to stop, which derivatives cannot pass. It records the number of its steps, and
`replay` takes them again with the same arithmetic. Derivatives are those at a fixed number of steps and at a fixed
branch of each particle's law.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmpm._step import stepped
from jaxmpm.run._advance import checked, running
from jaxmpm.run._checks import check_state
from jaxmpm.setup import follow_soil
from jaxmpm.support import check
from jaxmpm.support.values import by_value
from jaxmpm.tensors import rows
from jaxmpm.transfer import scatter_p
from jaxmpm.types import Scene, State, Status

# Memory of reversing one step, in sizes of the state, and what friction and finite strains add, whose principal values
# need many rotations: measured in two and three dimensions, see tests/jaxmpm/run/test_replay.py.
STEP_IN_STATES, MORE_WITH_FRICTION, MORE_WITH_FINITE_STRAIN = 10, 4, 16


@by_value
@dataclass(frozen=True)
class Checkpoints:
    """Nested loops of a run for reverse mode.

    Args:
        levels: steps (or inner loops) of each loop, outermost first; each further level takes the forward run once
            more.
        bytes: memory of reverse mode, in all.
    """

    levels: tuple[int, ...]
    bytes: int


def checkpoints(scene: Scene, state: State, steps: int, memory: float) -> Checkpoints:
    """The fewest nested loops whose states fit into memory.

    One level stores every state, k levels store about k steps^(1/k) of them. The innermost loop also stores what
    particles map to the nodes in each of its steps, which costs less than to map it again.

    Source of better loops of unequal length: Griewank and Walther (2000), doi:10.1145/347837.347846.

    Args:
        scene: to run.
        state: at the start.
        steps: number of steps.
        memory: bytes that reverse mode may use.

    Returns:
        Checkpoints.

    Raises:
        ValueError: If no number of levels fits.
    """
    check.whole("steps", steps)
    check.positive("memory", memory, "bytes")
    size, nodal, needed = _bytes(state), _nodal_bytes(scene, state), 0
    step_in_states = (
        STEP_IN_STATES
        + MORE_WITH_FRICTION * scene.material.FRICTIONAL
        + MORE_WITH_FINITE_STRAIN * scene.numerics.finite_strain
    )
    for depth in range(1, 1 + max(1, int(np.log2(max(steps, 2))))):
        levels = _levels(steps, depth)
        needed = size * (sum(levels) + step_in_states) + nodal * levels[-1]
        if needed <= memory:
            return Checkpoints(levels, needed)
    raise ValueError(
        f"memory = {memory:.3g} bytes is too small for {steps} steps of a state of {size:,} bytes: "
        f"give at least {needed:.3g}"
    )


def _bytes(state: State) -> int:
    return sum(leaf.size * leaf.dtype.itemsize for leaf in jax.tree.leaves(state))


def _maps_to_nodes(primitive: object, *_: object, **__: object) -> bool:
    """Policy of `jax.checkpoint`: store what particles map to the nodes."""
    return primitive is scatter_p


def _nodal_bytes(scene: Scene, state: State) -> int:
    """Bytes of what the particles map to the nodes in a step."""
    equations = jax.make_jaxpr(stepped)(scene, state, scene.numerics.time_step).eqns
    nodal = [out.aval for e in equations if _maps_to_nodes(e.primitive) for out in e.outvars]
    return sum(array.size * array.dtype.itemsize for array in nodal)


def _levels(steps: int, depth: int) -> tuple[int, ...]:
    """Lengths of `depth` nested loops of about equal length, whose product is at least `steps`."""
    if depth == 1:
        return (steps,)
    inner = int(np.ceil(steps ** ((depth - 1) / depth)))
    return (int(np.ceil(steps / inner)), *_levels(inner, depth - 1))


def replay(
    scene: Scene,
    state: State,
    steps: int,
    *,
    observe: Callable[[State], Any] | None = None,
    every: int | None = None,
    limit: Array | None = None,
    memory: float = 2e9,
) -> tuple[State, Any]:
    """Take a number of steps, differentiable forward and in reverse.

    The status of a lane says whether it broke off (see `Status`). The derivatives of such a lane have no meaning; those
    of other lanes under `jax.vmap(jax.grad(...))` are not affected. Mask after differentiating, not before.

    If soil reaches more nodes than the scene stores, `replay` repeats the run with more nodes. Within jit, vmap or a
    derivative it cannot: the lane then has the status GRID_FULL, and a warning says so.

    JAX compiles it once for each number of steps and each `observe`, so give the same function at every call.

    Args:
        scene: to run.
        state: at the start, as for `solve`.
        steps: a Python integer.
        observe: function of the state, called after each `every` steps; None for none.
        every: steps between two calls, a divisor of `steps`.
        limit: steps after which a lane stays as it is, an array that may differ between the lanes of a vmap; `steps` is
            then the largest.
        memory: bytes that reverse mode may use for one lane.

    Returns:
        State, and the results of `observe` stacked (steps // every, ...), or None.

    Raises:
        ValueError: If `steps` is no Python integer, `every` does not divide it, memory is too small, or the state is
            not the scene's (see `solve`) or records columns.
    """
    if not isinstance(steps, int) or isinstance(steps, bool) or steps < 1:
        raise ValueError(f"steps = {steps!r}: give a Python integer of 1 or more, for example int(result.state.step)")
    if (observe is None) != (every is None):
        raise ValueError("observe and every go together: give both, or none of them")
    every = steps if every is None else every
    check.whole("every", every)
    check.positive("memory", memory, "bytes")
    if limit is not None:
        check.not_negative("limit", limit, "steps")
    if steps % every:
        raise ValueError(f"every = {every} does not divide {steps} steps: give a divisor")
    check_state(scene, state, None)
    if state.columns is not None:
        raise ValueError("replay records no columns: give it a state without, replace(state, columns=None), or solve")
    while True:
        end, seen = _replayed(scene, state, limit, steps=steps, observe=observe, every=every, memory=float(memory))
        if scene.grid.stored is None:
            return end, seen
        if check.is_traced(scene, end):
            jax.debug.callback(_warn_of_full_grid, end.status)
            return end, seen
        if not np.any(np.asarray((end.status == Status.GRID_FULL) & (state.status != Status.GRID_FULL))):
            return end, seen
        scene = follow_soil(scene, end)


def _warn_of_full_grid(status: Array) -> None:
    """Say so where a run that cannot be taken again has ended for want of nodes."""
    if np.any(np.asarray(status) == Status.GRID_FULL):
        warnings.warn(
            "soil reaches more nodes than the scene stores, and the run stops there: give `replay` "
            "follow_soil(scene, result.state) with the result of `solve`",
            stacklevel=2,
        )


@partial(jax.jit, static_argnames=("steps", "observe", "every", "memory"))
def _replayed(
    scene: Scene,
    state: State,
    limit: Array | None,
    *,
    steps: int,
    observe: Callable[[State], Any] | None,
    every: int,
    memory: float,
) -> tuple[State, Any]:
    state = checked(scene, running(state))
    last = None if limit is None else state.step + limit
    plan = checkpoints(scene, state, every, memory - (0 if every == steps else steps // every * _bytes(state)))

    def one(old: State) -> State:
        new = stepped(scene, old, scene.numerics.time_step)
        if last is None:
            return new
        going = old.step < last
        return jax.tree.map(lambda a, b: jnp.where(going, a, b), new, old)

    def segment(old: State, _: object) -> tuple[State, object]:
        new = _nested(one, old, every, len(plan.levels))
        return new, None if observe is None else observe(new)

    if every == steps:
        state, seen = segment(state, None)
        return state, None if observe is None else jax.tree.map(lambda leaf: leaf[None], seen)
    return jax.lax.scan(jax.checkpoint(segment, prevent_cse=False), state, None, length=steps // every)


def _nested(one: Callable[[State], State], state: State, steps: int, depth: int) -> State:
    """Take `steps` steps in `depth` nested loops, each of which stores what it starts from and recomputes the rest."""
    if depth == 1:
        return _loop(one, state, steps, keep=_maps_to_nodes)
    inner = int(np.ceil(steps ** ((depth - 1) / depth)))
    outer, rest = divmod(steps, inner)
    state = _loop(lambda s: _nested(one, s, inner, depth - 1), state, outer)
    return _nested(one, state, rest, min(depth, rest)) if rest else state


def _loop(body: Callable[[State], State], state: State, count: int, keep: Callable[..., bool] | None = None) -> State:
    remembered = jax.checkpoint(lambda rows: _split(body(_whole(rows))), prevent_cse=False, policy=keep)
    return _whole(jax.lax.scan(lambda rows, _: (remembered(rows), None), _split(state), None, length=count)[0])


def _split(state: State) -> State:
    """A state whose arrays of several rows are lists of rows.

    Reverse mode reads stored rows twice as fast, since XLA on CPU does not vectorise loops over a slice of a slice.
    """
    return jax.tree.map(lambda leaf: rows(leaf) if leaf.ndim > 1 else leaf, state)


def _whole(state: State) -> State:
    """The state from the result of `_split`."""

    def is_rows(leaf: object) -> bool:
        return isinstance(leaf, list)

    return jax.tree.map(lambda leaf: jnp.stack(leaf) if is_rows(leaf) else leaf, state, is_leaf=is_rows)
