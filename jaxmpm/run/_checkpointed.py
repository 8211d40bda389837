"""Runs that can be differentiated: a known number of steps, taken with checkpoints that fit into a budget of bytes.

`solve` decides on the host when to stop, which no derivative can pass. It records how many steps it took; `replay`
takes them again, with the same arithmetic. Derivatives are then those of the run that was: they hold the number of
steps fixed, as they hold the branch that each particle took in its material.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from foundation import check
from jaxmpm._step import step
from jaxmpm.run._checks import check_state
from jaxmpm.run._integrate import begun, lane_status, running
from jaxmpm.tensors import rows
from jaxmpm.transfer import scatter_p
from jaxmpm.types import Scene, State, Status

# What reversing one step holds at once, in sizes of the state, and what friction and finite strains add, whose
# principal values are found in many rotations: measured in two and three dimensions, see tests/test_replay.py.
STEP_IN_STATES, MORE_WITH_FRICTION, MORE_WITH_FINITE_STRAIN = 10, 4, 16


@dataclass(frozen=True)
class Checkpoints:
    """How a run of `steps` is cut for reverse mode.

    levels: steps (or inner loops) of each of the nested loops, outermost first; each level more takes the forward run
    once more. bytes: what reverse mode will hold, in all.
    """

    levels: tuple[int, ...]
    bytes: int


def checkpoints(scene: Scene, state: State, steps: int, memory: float) -> Checkpoints:
    """The fewest levels whose states fit into `memory` (bytes) for a run of `steps` from `state`.

    One level keeps every state, k levels about k steps^(1/k) of them (Griewank and Walther 2000,
    10.1145/347837.347846, for better ones of unequal length). The innermost loop also keeps what particles gave the
    nodes in each of its steps, which costs less than to give it again.
    Raises ValueError where no number of levels fits.
    """
    check.whole("steps", steps)
    check.positive("memory", memory, "bytes")
    size, nodal, needed = _bytes(state), _nodal_bytes(scene, state), 0
    step_in_states = (
        STEP_IN_STATES + MORE_WITH_FRICTION * scene.material.FRICTIONAL + MORE_WITH_FINITE_STRAIN * scene.finite_strain
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


def _given_to_nodes(primitive: Any, *_: Any, **__: Any) -> bool:
    """Policy of `jax.checkpoint`."""
    return primitive is scatter_p


def _nodal_bytes(scene: Scene, state: State) -> int:
    """What the particles give the nodes in a step."""
    equations = jax.make_jaxpr(step)(scene, state, scene.time_step).eqns
    given = [out.aval for e in equations if _given_to_nodes(e.primitive) for out in e.outvars]
    return sum(array.size * array.dtype.itemsize for array in given)


def _levels(steps: int, depth: int) -> tuple[int, ...]:
    """Lengths of `depth` nested loops of about equal length, together at least `steps`."""
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
    """Take `steps` steps, differentiable forward and in reverse; returns the state and the observations.

    scene, state: what to run and from where, as `solve` takes them. observe: State -> anything; seen after each
    `every` steps and stacked, (steps // every, ...); None without.
    limit: steps after which the lane stays as it is, an array that may differ between the lanes of a vmap; `steps` is
    then the largest. memory: bytes that reverse mode may hold for one lane.
    A lane that breaks off says so in its status (see `Status`), and its derivatives mean nothing; those of other lanes
    under `jax.vmap(jax.grad(...))` are what they would be without it. Mask after differentiating, not before.
    Raises ValueError for a number of steps that is no Python integer, an `every` that does not divide it, too little
    memory, and a state that is not the scene's (see `solve`).
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
    state = begun(scene, running(state))
    plan = checkpoints(scene, state, every, memory - (0 if every == steps else steps // every * _bytes(state)))

    def one(old: State) -> State:
        new = replace(step(scene, old, scene.time_step), step=old.step + 1)
        if limit is None:
            return new
        going = old.step < limit
        return jax.tree.map(lambda a, b: jnp.where(going, a, b), new, old)

    def segment(old: State, _: Any) -> tuple[State, Any]:
        new = _nested(one, old, every, len(plan.levels))
        first = jnp.where(old.status == Status.RUNNING, lane_status(scene, new), old.status)
        new = replace(new, status=first)
        return new, None if observe is None else observe(new)

    if every == steps:
        state, seen = segment(state, None)
        return state, None if observe is None else jax.tree.map(lambda leaf: leaf[None], seen)
    return jax.lax.scan(jax.checkpoint(segment, prevent_cse=False), state, None, length=steps // every)


def _nested(one: Callable[[State], State], state: State, steps: int, depth: int) -> State:
    """`steps` steps in `depth` nested loops, each of which keeps what it starts from and recomputes the rest."""
    if depth == 1:
        return _loop(one, state, steps, keep=_given_to_nodes)
    inner = int(np.ceil(steps ** ((depth - 1) / depth)))
    outer, rest = divmod(steps, inner)
    state = _loop(lambda s: _nested(one, s, inner, depth - 1), state, outer)
    return _nested(one, state, rest, min(depth, rest)) if rest else state


def _loop(body: Callable[[State], State], state: State, count: int, keep: Callable[..., bool] | None = None) -> State:
    remembered = jax.checkpoint(lambda rows: _split(body(_whole(rows))), prevent_cse=False, policy=keep)
    return _whole(jax.lax.scan(lambda rows, _: (remembered(rows), None), _split(state), None, length=count)[0])


def _split(state: State) -> State:
    """A state whose arrays of several rows are lists of rows: reverse mode reads those it kept twice as fast, since
    XLA on CPU does not vectorise loops over a slice of a slice."""
    return jax.tree.map(lambda leaf: rows(leaf) if leaf.ndim > 1 else leaf, state)


def _whole(state: State) -> State:
    """The state that `_split` took apart."""

    def is_rows(leaf: Any) -> bool:
        return isinstance(leaf, list)

    return jax.tree.map(lambda leaf: jnp.stack(leaf) if is_rows(leaf) else leaf, state, is_leaf=is_rows)
