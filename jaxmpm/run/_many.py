"""Many samples of one scene through a fixed number of lanes: a lane that ends takes the next sample at once."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmpm.run._integrate import Result, Settle, Watch, advance_lanes, lanes, repeat, steps_until
from jaxmpm.types import Scene, State, Status


@dataclass(frozen=True)
class Chunk:
    """What one chunk of steps did. lanes: in the program. busy: those that held a sample. steps: taken by each."""

    lanes: int
    busy: int
    steps: int


@dataclass(frozen=True)
class Midway:
    """A sample under way: its state, and what the watch remembers of it (see `Settle`).

    quiet: seconds of it so far. reference: the displacement (m) that they are counted from.
    """

    state: State
    quiet: float = 0.0
    reference: float = 0.0


def solve_each(
    scene: Scene,
    state: State,
    strengths: Iterable[tuple[int, Array]],
    *,
    width: int,
    t_end: float,
    settle: Settle | None = None,
    stop_at: float | None = None,
    on_chunk: Callable[[Chunk], None] | None = None,
    observe: Callable[[int, float, Midway], None] | None = None,
    resume: Callable[[int], Midway | None] | None = None,
) -> Iterator[tuple[int, Result]]:
    """Run every (number, strength) from the same `state` and yield (number, result) as each ends, not in order.

    strengths: drawn lazily, one when a lane becomes free; strength is a scalar or (N) Pa. width: number of lanes.
    t_end, settle, stop_at: as for `solve`; t_end is reached to within a few steps. on_chunk: told of every chunk.
    observe: shown (number, seconds simulated, midway) of every sample after every chunk, about each `settle.every`.
    resume: gives what `observe` was shown of a sample in an earlier run, or None; it goes on from there, bit for bit.
    Results do not depend on `width`, nor on the samples that run beside. Towards the end, when at most half the
    lanes hold a sample, the batch shrinks to those.
    Raises ValueError for a width below 1.
    """
    if width < 1:
        raise ValueError(f"width = {width} lanes: give 1 or more")
    waiting = iter(strengths)
    first = list(islice(waiting, width))
    if not first:
        return
    dtype = scene.particles.mass.dtype
    numbers: list[int | None] = [number for number, _ in first]
    varied, axes = lanes(scene, strength=jnp.stack([jnp.asarray(s, dtype) for _, s in first]))
    batch = jax.tree.map(jnp.copy, repeat(state, len(first)))
    dt = float(scene.time_step)
    total = steps_until(t_end, dt)
    chunk = even_chunk(total, max(1, round((settle or Settle()).every / dt)))
    watch = Watch.start((len(first),))

    def begin(number: int) -> Midway:
        return (resume(number) if resume is not None else None) or Midway(state)

    for lane, (sample, strength) in enumerate(first):
        midway = begin(sample)
        if midway.state is not state:
            varied, batch = _refill(varied, batch, midway.state, jnp.asarray(strength, dtype), lane)
            watch = watch.restarted(lane, midway.quiet, midway.reference)
    while any(number is not None for number in numbers):
        batch = advance_lanes(varied, batch, jnp.asarray(chunk), axes)
        watch, status = watch.look(varied, batch, axes, chunk * dt, settle, stop_at)
        status = np.where((status == Status.RUNNING) & (np.asarray(batch.step) >= total), Status.FINISHED, status)
        batch = replace(batch, status=jnp.asarray(status, jnp.int32))
        if on_chunk is not None:
            on_chunk(Chunk(len(numbers), sum(number is not None for number in numbers), chunk))
        if observe is not None:
            for lane, number in enumerate(numbers):
                if number is not None:
                    midway = Midway(_lane(batch, lane), float(watch.quiet[lane]), float(watch.reference[lane]))
                    observe(number, int(midway.state.step) * dt, midway)
        for lane in np.flatnonzero(status != Status.RUNNING).tolist():
            number = numbers[lane]
            if number is None:
                continue
            yield number, Result(jax.device_get(_take(batch, lane)), scene.time_step)
            after = next(waiting, None)
            numbers[lane] = None
            if after is not None:
                numbers[lane], strength = after
                midway = begin(after[0])
                varied, batch = _refill(varied, batch, midway.state, jnp.asarray(strength, dtype), lane)
                watch = watch.restarted(lane, midway.quiet, midway.reference)
        held = [lane for lane, number in enumerate(numbers) if number is not None]
        if 0 < len(held) <= len(numbers) // 2:
            keep = np.asarray(held)
            numbers = [numbers[lane] for lane in held]
            varied, batch = _take(varied, keep, axes), _take(batch, keep)
            watch = Watch(watch.quiet[keep], watch.reference[keep])


def even_chunk(total: int, about: int) -> int:
    """Steps of a chunk, within a fifth of `about`, whose multiples reach `total` with the fewest steps beyond."""
    return min(range(max(1, about * 4 // 5), max(2, about * 6 // 5)), key=lambda c: (-total % c, abs(c - about)))


def _take(tree: Any, index: int | np.ndarray, axes: Any = None) -> Any:
    """The lanes `index` of every leaf, or of those leaves only that `axes` says have lanes."""
    if axes is None:
        return jax.tree.map(lambda leaf: leaf[index], tree)
    return jax.tree.map(
        lambda axis, leaf: leaf if axis is None else leaf[index], axes, tree, is_leaf=lambda node: node is None
    )


@jax.jit
def _lane(batch: State, lane: int) -> State:
    return jax.tree.map(lambda leaf: leaf[lane], batch)


@partial(jax.jit, donate_argnums=(1,))
def _refill(varied: Scene, batch: State, start: State, strength: Array, lane: int) -> tuple[Scene, State]:
    """Put a new sample into a lane."""
    material = replace(varied.material, strength=varied.material.strength.at[lane].set(strength))
    return replace(varied, material=material), jax.tree.map(lambda all_, one: all_.at[lane].set(one), batch, start)
