"""Samples in lanes: chunks of steps, lanes that take the next sample, and batches that shrink."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmpm.run._advance import advance_with_room, in_turn, is_none, take
from jaxmpm.run._devices import mesh_of, placed
from jaxmpm.run._integrate import Result
from jaxmpm.run._stopping import Rule, SlidesEnd, Watch, farthest, steps_until
from jaxmpm.support.values import by_value
from jaxmpm.types import Scene, State, Status

Tree = TypeVar("Tree")

QUARTER = 4
"""Lanes at the start over lanes at the end, when the last samples run."""


@by_value
@dataclass(frozen=True)
class Chunk:
    """Numbers of one chunk of steps.

    Args:
        lanes: in the program.
        busy: lanes with a sample.
        steps: taken by each lane; the largest number if lanes have their own time steps.
    """

    lanes: int
    busy: int
    steps: int


@by_value
@dataclass(frozen=True)
class Midway:
    """An unfinished sample.

    Args:
        state: now.
        memory: of the stopping rules, by the name of their class; a rule that has none starts.
        ended_by: the rule that has ended it, None for none.
    """

    state: State
    memory: Mapping[str, np.ndarray] = field(default_factory=dict)
    ended_by: Rule | None = None


@dataclass(frozen=True)
class Hooks:
    """Functions that `solve_each` calls on the host, each None for none.

    Args:
        resume: of a sample's number, before it starts: what `observe` got in an earlier run, from which the sample goes
            on bit for bit, or None.
        on_chunk: of the numbers of a chunk of steps, after every one.
        observe: of number, seconds simulated and midway of every sample after every chunk, about each `every`.
    """

    resume: Callable[[int], Midway | None] | None = None
    on_chunk: Callable[[Chunk], None] | None = None
    observe: Callable[[int, float, Midway], None] | None = None


@dataclass(frozen=True)
class Sample:
    """A sample to run.

    Args:
        number: of the sample.
        scene: of the sample.
        state: at the start.
        resume: as of `Hooks`.
    """

    number: int
    scene: Scene
    state: State
    resume: Callable[[int], Midway | None] | None

    def begin(self) -> Midway:
        """Where it was in an earlier run, or its start."""
        return (self.resume(self.number) if self.resume is not None else None) or Midway(self.state)


@dataclass(frozen=True)
class Batch:
    """Samples in lanes. Every change gives a new batch; arrays of the old state may be donated.

    Args:
        scene: leaves that samples differ in have lanes first (B, ...).
        axes: which leaves these are.
        state: of all lanes.
        watch: of all lanes.
        numbers: of the samples, None in a lane without one.
        time_step: (B,) s.
        total: (B,) steps to the end.
        chunk: (B,) steps that a lane takes at once, which depend on its own time step alone.
        t_end: duration (s).
        every: time between two looks (s).
    """

    scene: Scene
    axes: Scene
    state: State
    watch: Watch
    numbers: tuple[int | None, ...]
    time_step: np.ndarray
    total: np.ndarray
    chunk: np.ndarray
    t_end: float
    every: float

    @classmethod
    def of(
        cls, shared: Scene, samples: list[Sample], rules: tuple[Rule, ...] = (), *, t_end: float, every: float
    ) -> Batch:
        """A batch with one lane for each sample."""
        axes = jax.tree.map(lambda a, b: None if a is b else 0, shared, samples[0].scene)
        starts = [sample.begin() for sample in samples]
        scene, state = _stacked([sample.scene for sample in samples], [start.state for start in starts], axes)
        watch = Watch.start(rules, (len(samples),))
        for lane, start in enumerate(starts):
            watch = watch.restarted(lane, start.memory)
        paces = [_pace(sample.scene, t_end, every) for sample in samples]
        time_step, total, chunk = (np.array(column) for column in zip(*paces, strict=True))
        return cls(
            scene=scene,
            axes=axes,
            state=state,
            watch=watch,
            numbers=tuple(sample.number for sample in samples),
            time_step=time_step,
            total=total,
            chunk=chunk,
            t_end=t_end,
            every=every,
        )

    @property
    def busy(self) -> list[int]:
        """Lanes with a sample."""
        return [lane for lane, number in enumerate(self.numbers) if number is not None]

    @property
    def ended(self) -> list[int]:
        """Lanes whose sample has ended."""
        running = np.asarray(self.state.status) == Status.RUNNING
        return [lane for lane in self.busy if not running[lane]]

    def number(self, lane: int) -> int:
        """Number of the sample in a lane that has one."""
        number = self.numbers[lane]
        assert number is not None
        return number

    def seconds(self, lane: int) -> float:
        """Time simulated so far (s) in a lane."""
        return int(self.state.step[lane]) * float(self.time_step[lane])

    def midway(self, lane: int) -> Midway:
        """The sample in a lane as it is now."""
        return Midway(_lane(self.state, lane), self.watch.of_lane(lane), self.watch.rule_of(lane))

    def result(self, lane: int) -> Result:
        """Result of a sample that has ended."""
        numerics = take(self.scene.numerics, lane, self.axes.numerics)
        state = jax.device_get(_lane(self.state, lane))
        return Result(state, numerics.time_step, ended_by=self.watch.rule_of(lane))

    def advanced(self, slides_end: SlidesEnd | None = None) -> Batch:
        """The batch after a chunk of steps of every lane and a look at each.

        Args:
            slides_end: when a sample ends that slides at t_end; None for then.

        Returns:
            Batch.
        """
        mesh = mesh_of(len(self.numbers))
        scene, state = placed(self.scene, self.state, self.axes, mesh)
        scene, axes, state = advance_with_room(scene, state, self.chunk, self.axes, mesh)
        assert axes is not None
        elapsed = self.chunk * self.time_step
        watch, status = self.watch.apply(scene, state, axes, elapsed)
        step = np.asarray(state.step)
        over = (status == Status.RUNNING) & (step >= self.total)
        if slides_end is not None and over.any():
            last = np.array([steps_until(slides_end.time, dt) for dt in self.time_step])
            reached = np.asarray(farthest(scene, state, axes, slides_end.least_volume))
            over &= (step >= last) | (reached <= slides_end.displacement)
        ended = jnp.asarray(np.where(over, Status.FINISHED, status), jnp.int32)
        return replace(self, scene=scene, axes=axes, state=replace(state, status=ended), watch=watch)

    def refill(self, lane: int, sample: Sample | None) -> Batch:
        """The batch with another sample in a lane, or none."""
        numbers = (*self.numbers[:lane], None if sample is None else sample.number, *self.numbers[lane + 1 :])
        if sample is None:
            return replace(self, numbers=numbers)
        start = sample.begin()
        of_sample = replace(sample.scene, grid=self.scene.grid)  # with as many nodes as lanes need
        scene, state = _put(self.scene, self.state, of_sample, start.state, lane, self.axes)
        here, (dt, total, chunk) = np.arange(len(numbers)) == lane, _pace(sample.scene, self.t_end, self.every)
        return replace(
            self,
            scene=scene,
            state=state,
            watch=self.watch.restarted(lane, start.memory),
            numbers=numbers,
            time_step=np.where(here, dt, self.time_step),
            total=np.where(here, total, self.total),
            chunk=np.where(here, chunk, self.chunk),
        )

    def shrink(self, first: int) -> Batch:
        """The batch with a quarter of its first lanes, once the others have no sample.

        Where lanes run one after the other, on a CPU, a lane without a sample costs nothing, and none is dropped. Else
        the end of many samples takes one program more than their start.

        Args:
            first: number of lanes at the start.

        Returns:
            Batch.
        """
        busy, width = self.busy, -(-first // QUARTER)
        if in_turn() or width >= len(self.numbers) or not 0 < len(busy) <= width:
            return self
        empty = [lane for lane in range(len(self.numbers)) if self.numbers[lane] is None]
        keep = np.asarray(sorted([*busy, *empty[: width - len(busy)]]))
        scene, state = _kept(self.scene, self.state, keep, self.axes)
        return replace(
            self,
            scene=scene,
            state=state,
            watch=self.watch.of(keep),
            numbers=tuple(self.numbers[lane] for lane in keep),
            time_step=self.time_step[keep],
            total=self.total[keep],
            chunk=self.chunk[keep],
        )


def _pace(scene: Scene, t_end: float, every: float) -> tuple[float, int, int]:
    """Time step (s), steps to the end, and steps of a chunk."""
    dt = float(scene.numerics.time_step)
    total = steps_until(t_end, dt)
    return dt, total, even_chunk(total, max(1, round(every / dt)))


def even_chunk(total: int, about: int) -> int:
    """Steps of a chunk, within a fifth of `about`, whose multiples reach `total` with the fewest steps beyond."""
    return min(range(max(1, about * 4 // 5), max(2, about * 6 // 5)), key=lambda c: (-total % c, abs(c - about)))


@partial(jax.jit, static_argnames="axes")
def _stacked(scenes: list[Scene], states: list[State], axes: Scene) -> tuple[Scene, State]:
    """Scene and state of lanes, one for each sample."""

    def stacked(axis: int | None, *leaves: Array) -> Array:
        return leaves[0] if axis is None else jnp.stack(leaves)

    return jax.tree.map(stacked, axes, *scenes, is_leaf=is_none), jax.tree.map(partial(stacked, 0), *states)


@partial(jax.jit, static_argnames="axes")
def _kept(scenes: Scene, states: State, lanes: Array, axes: Scene) -> tuple[Scene, State]:
    """Scene and state of some lanes."""
    return take(scenes, lanes, axes), take(states, lanes)


@jax.jit
def _lane(batch: State, lane: int) -> State:
    return jax.tree.map(lambda leaf: leaf[lane], batch)


@partial(jax.jit, static_argnames="axes", donate_argnames="states")
def _put(scenes: Scene, states: State, scene: Scene, state: State, lane: int, axes: Scene) -> tuple[Scene, State]:
    """Scene and state of one sample placed in a lane of the others'."""

    def put(axis: int | None, lanes: Array, one: Array) -> Array:
        return lanes if axis is None else lanes.at[lane].set(one)

    return (
        jax.tree.map(put, axes, scenes, scene, is_leaf=is_none),
        jax.tree.map(partial(put, 0), states, state),
    )
