"""Rules that end a run, which the host applies between chunks of steps."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Protocol, runtime_checkable

import jax
import numpy as np
from jax import Array

from jaxmpm import diagnostics
from jaxmpm.laws import weakens_until
from jaxmpm.run._advance import over_lanes
from jaxmpm.support import check
from jaxmpm.support.text import shown
from jaxmpm.support.values import by_value
from jaxmpm.types import Scene, State, Status


@by_value
@dataclass(frozen=True)
class Reading:
    """Numbers of all lanes after a chunk of steps, () each without lanes.

    Args:
        measured: result of the rule's `measure`, with the lanes first.
        elapsed: time since the look before (s).
        time: since the start of the run (s).
        shaken: whether the motion of the base goes on.
    """

    measured: Any
    elapsed: float | np.ndarray
    time: np.ndarray
    shaken: np.ndarray


@runtime_checkable
class Rule(Protocol):
    """Rule that ends lanes between chunks of steps: a frozen dataclass of numbers.

    `measure` is compiled, `judge` is NumPy. `solve` and `solve_each` also take a function of the scene and state of one
    lane that returns whether the lane ends, or its `Status`. A class that derives from this one has no memory and needs
    nothing, unless it says so.

    The status says what the end means. SETTLED: the lane moves no more, and its end is that of its motion. DECIDED: no
    more is asked of it, and `foreseen` is how far it counts as moved.
    """

    def start(self) -> np.ndarray:
        """Memory of a lane that starts (m,)."""
        return np.zeros(0)

    def check(self, scene: Scene, state: State) -> None:
        """Raise ValueError for a run that lacks what the rule needs."""
        return

    def measure(self, scene: Scene, state: State) -> Any:
        """Arrays () of one lane that the rule needs, as a pytree; traced."""

    def judge(self, memory: np.ndarray, reading: Reading) -> tuple[np.ndarray, np.ndarray]:
        """Memory afterwards (m, ...), and `Status` of each lane: RUNNING, or how the lane ends."""

    def foreseen(self, displacement: float, time: float) -> float:
        """Displacement (m) for which a lane counts that this rule ended as DECIDED; what it has reached by default.

        Args:
            displacement: reached (m).
            time: so far (s).
        """
        return displacement


Condition = Callable[[Scene, State], Array]
"""A rule without memory: whether one lane ends, () bool, which is then DECIDED; or its `Status`, () int."""


@dataclass(frozen=True)
class Ends(Rule):
    """Rule that ends a lane once a function of its scene and state says so.

    Args:
        condition: of one lane; traced.
    """

    condition: Condition

    def measure(self, scene: Scene, state: State) -> Array:
        """Whether the lane ends, or how."""
        return self.condition(scene, state)

    def judge(self, memory: np.ndarray, reading: Reading) -> tuple[np.ndarray, np.ndarray]:
        """DECIDED where the condition holds, or the status that it gives."""
        says = np.asarray(reading.measured)
        return memory, np.where(says, Status.DECIDED, Status.RUNNING) if says.dtype == bool else says


@dataclass(frozen=True)
class Exceeds(Rule):
    """Rule that ends a lane, as DECIDED, once its largest displacement exceeds a limit.

    Args:
        displacement: limit (m).
        least_volume: replaces the largest displacement by the one that this volume of soil (m3, in a section m2) has
            exceeded, see `diagnostics.exceeded_displacement`. None counts every particle.

    Raises:
        ValueError: If a number is not above 0.
    """

    displacement: float
    least_volume: float | None = None

    def __post_init__(self) -> None:
        check.positive("exceeds' displacement", self.displacement, "m")
        check_volume(self.least_volume)

    def measure(self, scene: Scene, state: State) -> Array:
        """Displacement (m)."""
        return diagnostics.exceeded_displacement(scene, state, self.least_volume)

    def judge(self, memory: np.ndarray, reading: Reading) -> tuple[np.ndarray, np.ndarray]:
        """DECIDED beyond the limit."""
        return memory, np.where(reading.measured > self.displacement, Status.DECIDED, Status.RUNNING)


@dataclass(frozen=True)
class Settle(Rule):
    """Rule that ends a lane, as SETTLED, once it is slow and its largest displacement constant for `hold` seconds.

    The seconds count from the end of a motion of the base, and of a loss of strength over time.

    The unbalanced force is not part of the rule: an undamped slope oscillates elastically without end, with 5 to 15 %
    of its weight unbalanced, while it stands.

    Args:
        speed: largest root mean square of the particle speed (m/s).
        drift: largest change of the displacement (m).
        hold: duration (s).
        slides: largest displacement (m) from which a lane is a slide. A slide settles by another rule: for `hold`
            seconds the mean displacement of the soil beyond `slides`, plus what other soil moved, does not change, at
            any particle speed. That rule detects a second mass that moves, and ignores single grains. None for no
            slides: their speed then prevents them from settling.
        least_volume: as for `Exceeds`.

    Raises:
        ValueError: If a number is below 0 or not finite.
    """

    speed: float = 0.05
    drift: float = 2e-3
    hold: float = 1.0
    slides: float | None = None
    least_volume: float | None = None

    def __post_init__(self) -> None:
        for name, unit in (("speed", "m/s"), ("drift", "m"), ("hold", "s")):
            check.not_negative(f"settle's {name}", getattr(self, name), unit)
        if self.slides is not None:
            check.positive("settle's slides", self.slides, "m")
        check_volume(self.least_volume)

    def start(self) -> np.ndarray:
        """Seconds without motion, and the displacement (m) from which motion is counted."""
        return np.zeros(2)

    def measure(self, scene: Scene, state: State) -> tuple[Array, Array, Array | None, Array | None]:
        """Speed (m/s), displacement and, with `slides`, that of the slide (m); end of a loss of strength (s)."""
        slid = None if self.slides is None else diagnostics.slide_displacement(scene, state, self.slides)
        farthest = diagnostics.exceeded_displacement(scene, state, self.least_volume)
        return diagnostics.speed(scene, state), farthest, slid, weakens_until(scene.material)

    def judge(self, memory: np.ndarray, reading: Reading) -> tuple[np.ndarray, np.ndarray]:
        """SETTLED after `hold` seconds without motion."""
        (quiet, reference), (speed, displacement, slid, weakens) = memory, reading.measured
        fast, moved = speed > self.speed, displacement
        if self.slides is not None:
            fast, moved = fast & (displacement <= self.slides), np.where(displacement > self.slides, slid, displacement)
        moves = np.abs(moved - reference) > self.drift
        restless = moves | fast | reading.shaken
        if weakens is not None:
            restless = restless | (reading.time < weakens)
        quiet = np.where(restless, 0.0, quiet + reading.elapsed)
        settles = ~restless & (quiet >= self.hold)
        memory = np.stack([quiet, np.where(moves, moved, reference)])
        return memory, np.where(settles, Status.SETTLED, Status.RUNNING)


@dataclass(frozen=True)
class SlidesEnd:
    """Duration of samples of which those that slide go on.

    Args:
        t_end: of samples that do not slide (s).
        displacement: beyond which a sample goes on at that time (m).
        time: up to which it goes on, to within a chunk (s).
        least_volume: as for `Exceeds`.

    Raises:
        ValueError: If a number is not above 0.
    """

    t_end: float
    displacement: float
    time: float
    least_volume: float | None = None

    def __post_init__(self) -> None:
        check_duration(self.t_end)
        check.positive("slides' displacement", self.displacement, "m")
        check.positive("slides' time", self.time, "s")
        if self.time < self.t_end:
            rule = f"slides' time = {self.time:g} s lies before t_end = {self.t_end:g} s"
            raise ValueError(f"{rule}: give a time from then on")
        check_volume(self.least_volume)


@partial(jax.jit, static_argnames=("axes", "rules"))
def measured(scene: Scene, state: State, axes: Scene | None, rules: tuple[Rule, ...]) -> tuple[Any, ...]:
    """Measurements of each rule, with the lanes first."""
    return over_lanes(lambda scene, state: tuple(rule.measure(scene, state) for rule in rules), axes)(scene, state)


@partial(jax.jit, static_argnames=("axes", "volume"))
def farthest(scene: Scene, state: State, axes: Scene | None, volume: float | None) -> Array:
    """Largest displacement of each lane (m), or the one that a volume of soil has exceeded."""
    return over_lanes(partial(diagnostics.exceeded_displacement, volume=volume), axes)(scene, state)


def check_volume(least_volume: float | None) -> None:
    """Raise ValueError for a least volume that is not above 0."""
    if least_volume is not None:
        check.positive("least_volume", least_volume)


def check_duration(t_end: float, every: float = 1.0) -> None:
    """Raise ValueError for an invalid duration of a run (s), or time between two looks."""
    if np.ndim(t_end):
        raise ValueError(f"t_end has shape {np.shape(t_end)}: give one number of seconds, the same for all lanes")
    check.positive("t_end", t_end, "s")
    check.positive("every", every, "s")


def check_rules(rules: Sequence[Rule | Condition], scene: Scene, state: State) -> tuple[Rule, ...]:
    """The rules of a run, functions as `Ends`.

    Raises ValueError for what is no rule, or where the run lacks what a rule needs.
    """
    # A class has the methods of its instances, and may be called.
    if not isinstance(rules, Sequence) or any(
        isinstance(rule, type) or (not callable(rule) and not isinstance(rule, Rule)) for rule in rules
    ):
        raise ValueError(
            f"rules = {shown(rules)}: give a list of rules, as in rules=[Settle(), Exceeds(1.0)], or of functions of "
            "scene and state that say whether a lane ends"
        )
    checked = tuple(rule if isinstance(rule, Rule) else Ends(rule) for rule in rules)
    for rule in checked:
        rule.check(scene, state)
    return checked


def _still_shaken(scene: Scene, time: np.ndarray) -> np.ndarray:
    """Whether the motion of the base goes on in each lane, () or (B,): no slope has settled before its end."""
    if scene.loads.motion is None:
        return np.zeros(np.shape(time), bool)
    return time < np.asarray(scene.loads.motion.duration)


def steps_until(time: float, dt: float) -> int:
    """Number of steps of dt (s) that reach `time` (s)."""
    return math.ceil(time / dt * (1 - 1e-6))


def names_of(rules: Sequence[Rule]) -> list[str]:
    """Names under which the memories of rules are stored: those of their classes, numbered from the second on."""
    counts: Counter[str] = Counter()
    names = []
    for rule in rules:
        name = type(rule).__name__
        counts[name] += 1
        names.append(name if counts[name] == 1 else f"{name} {counts[name]}")
    return names


@dataclass(frozen=True)
class Watch:
    """Rules of a run, and their memory between looks.

    Args:
        rules: in the order in which they are asked.
        memory: of each rule, (m, B) or (m,).
        ended_by: position of the rule that ended each lane, -1 for none (B,) or ().
    """

    rules: tuple[Rule, ...]
    memory: tuple[np.ndarray, ...]
    ended_by: np.ndarray

    @classmethod
    def start(cls, rules: tuple[Rule, ...], shape: tuple[int, ...]) -> Watch:
        """A watch of lanes of this shape that start."""
        memory = tuple(np.full((*shape, rule.start().size), rule.start()).T for rule in rules)
        return cls(rules, memory, np.full(shape, -1))

    def restarted(self, lane: int, memory: Mapping[str, np.ndarray]) -> Watch:
        """The watch with another sample in one lane.

        Args:
            lane: of the sample.
            memory: by rule, see `of_lane`; a rule that has none starts.
        """
        memories = []
        for name, rule, lanes in zip(names_of(self.rules), self.rules, self.memory, strict=True):
            of_sample = np.asarray(memory.get(name, rule.start()))
            memories.append(np.where(np.arange(lanes.shape[1]) == lane, of_sample[:, None], lanes))
        ended_by = np.where(np.arange(self.ended_by.size) == lane, -1, self.ended_by)
        return replace(self, memory=tuple(memories), ended_by=ended_by)

    def of(self, lanes: np.ndarray) -> Watch:
        """The watch of some lanes."""
        memory = tuple(memory[:, lanes] for memory in self.memory)
        return replace(self, memory=memory, ended_by=self.ended_by[lanes])

    def rule_of(self, lane: int | tuple[()]) -> Rule | None:
        """The rule that ended a lane, None where none did."""
        position = int(self.ended_by[lane])
        return None if position < 0 else self.rules[position]

    def of_lane(self, lane: int) -> dict[str, np.ndarray]:
        """Memory of one lane by rule (m,)."""
        names = names_of(self.rules)
        return {name: memory[:, lane] for name, memory in zip(names, self.memory, strict=True) if memory.size}

    def apply(
        self, scene: Scene, state: State, axes: Scene | None, elapsed: float | np.ndarray
    ) -> tuple[Watch, np.ndarray]:
        """Apply the rules after some time.

        Args:
            scene: of the run.
            state: now.
            axes: leaves of the scene that have lanes first, None without lanes.
            elapsed: time since the last look (s), () or (B,).

        Returns:
            The watch afterwards, and the status of each lane, by the first rule that ends it.
        """
        status = np.asarray(state.status)
        if not self.rules:
            return self, status
        time = np.asarray(state.step) * np.asarray(scene.numerics.time_step)
        shaken, memories, ended_by = _still_shaken(scene, time), [], self.ended_by
        values = jax.device_get(measured(scene, state, axes, self.rules))
        for position, (rule, memory, value) in enumerate(zip(self.rules, self.memory, values, strict=True)):
            memory, judged = rule.judge(memory, Reading(value, elapsed, time, shaken))
            memories.append(memory)
            ends = (status == Status.RUNNING) & (judged != Status.RUNNING)
            status, ended_by = np.where(ends, judged, status), np.where(ends, position, ended_by)
        return replace(self, memory=tuple(memories), ended_by=ended_by), status.astype(np.int32)
