"""Rules that end a run, which the host applies between chunks of steps."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial

import jax
import numpy as np
from jax import Array

from jaxmpm import diagnostics
from jaxmpm.run._advance import over_lanes
from jaxmpm.run._early import START, Early, measures
from jaxmpm.support import check
from jaxmpm.types import Scene, State, Status


@dataclass(frozen=True)
class Settle:
    """Rule by which a lane has settled: for `hold` seconds it is slow and its largest displacement does not change.

    The seconds count from the end of a motion of the base.

    The unbalanced force is not part of the rule: an undamped slope oscillates elastically without end, with 5 to 15 %
    of its weight unbalanced, while it stands. Any number below 0, an `every` of 0 or a value that is not finite raises
    ValueError.

    Args:
        speed: largest root mean square of the particle speed (m/s).
        drift: largest change of the displacement (m).
        hold: duration (s).
        every: time between two looks (s).
        slides: largest displacement (m) from which a lane is a slide. A slide settles by another rule: for `hold`
            seconds the mean displacement of the soil beyond `slides`, plus what other soil moved, does not change, at
            any particle speed. That rule detects a second mass that moves, and ignores single grains. None for no
            slides: their speed then prevents them from settling.
        early: rule by which the class of a run that ends at a displacement is known earlier; None for none.
    """

    speed: float = 0.05
    drift: float = 2e-3
    hold: float = 1.0
    every: float = 0.25
    slides: float | None = None
    early: Early | None = None

    def __post_init__(self) -> None:
        for name, unit in (("speed", "m/s"), ("drift", "m"), ("hold", "s")):
            check.not_negative(f"settle's {name}", getattr(self, name), unit)
        check.positive("settle's every", self.every, "s")
        if self.slides is not None:
            check.positive("settle's slides", self.slides, "m")


@partial(jax.jit, static_argnames=("axes", "slides", "volume", "early"))
def _look(
    scene: Scene, state: State, axes: Scene | None, slides: float | None, volume: float | None, early: bool = False
) -> tuple[Array, Array, Array | None, tuple[Array, Array] | None]:
    """Speed and largest displacement of each lane, or the displacement that a volume exceeds.

    With `slides` also the mean displacement of each slide; with `early` what that rule sees.
    """

    def seen(scene: Scene, state: State) -> tuple[Array, Array, Array | None, tuple[Array, Array] | None]:
        slid = None if slides is None else diagnostics.slide_displacement(scene, state, slides)
        speed, displacement = diagnostics.speed(scene, state), _farthest(scene, state, volume)
        return speed, displacement, slid, measures(scene, state) if early else None

    return over_lanes(seen, axes)(scene, state)


@partial(jax.jit, static_argnames=("axes", "volume"))
def farthest(scene: Scene, state: State, axes: Scene | None, volume: float | None) -> Array:
    """Largest displacement of each lane (m), or the one that a volume of soil has exceeded."""
    return over_lanes(partial(_farthest, volume=volume), axes)(scene, state)


def _farthest(scene: Scene, state: State, volume: float | None) -> Array:
    if volume is None:
        return diagnostics.largest_displacement(state)
    return diagnostics.exceeded_displacement(scene, state, volume)


def check_run(t_end: float, settle: Settle | None, stop_at: float | None, least_volume: float | None = None) -> None:
    """Raise ValueError for an invalid end of a run."""
    if np.ndim(t_end):
        raise ValueError(f"t_end has shape {np.shape(t_end)}: give one number of seconds, the same for all lanes")
    check.positive("t_end", t_end, "s")
    if settle is not None and not isinstance(settle, Settle):
        raise ValueError(f"settle = {settle!r}: give Settle(...), or None")
    if stop_at is not None:
        check.positive("stop_at", stop_at, "m")
    if least_volume is not None:
        check.positive("least_volume", least_volume)


def _still_shaken(scene: Scene, state: State) -> np.ndarray:
    """Whether the motion of the base goes on in each lane, () or (B,): no slope has settled before its end."""
    if scene.loads.motion is None:
        return np.zeros(np.shape(state.step), bool)
    return np.asarray(state.step) * np.asarray(scene.numerics.time_step) < np.asarray(scene.loads.motion.duration)


def steps_until(time: float, dt: float) -> int:
    """Number of steps of dt (s) that reach `time` (s)."""
    return math.ceil(time / dt * (1 - 1e-6))


@dataclass(frozen=True)
class Watch:
    """Memory of the stopping rule between looks, per lane.

    Args:
        quiet: (B,) or () seconds without motion.
        reference: displacement (m) from which motion is counted, of the same shape.
        rates: (8, B) or (8,), memory of the rule `Early`.
    """

    quiet: np.ndarray
    reference: np.ndarray
    rates: np.ndarray

    @classmethod
    def start(cls, shape: tuple[int, ...]) -> Watch:
        """A watch without memory, for lanes of this shape."""
        return cls(np.zeros(shape), np.zeros(shape), np.full((*shape, START.size), START).T)

    def restarted(self, lane: int, quiet: float, reference: float, rates: np.ndarray) -> Watch:
        """The watch with another sample in one lane, with its own memory."""
        fresh = np.arange(self.quiet.size) == lane
        own = np.where(fresh, quiet, self.quiet), np.where(fresh, reference, self.reference)
        return Watch(*own, np.where(fresh, rates[:, None], self.rates))

    def of(self, lanes: np.ndarray) -> Watch:
        """The watch of some lanes."""
        return Watch(self.quiet[lanes], self.reference[lanes], self.rates[:, lanes])

    def look(
        self,
        scene: Scene,
        state: State,
        axes: Scene | None,
        elapsed: float | np.ndarray,
        settle: Settle | None,
        stop_at: float | None,
        least_volume: float | None,
    ) -> tuple[Watch, np.ndarray]:
        """Apply the stopping rules after some time.

        Args:
            scene: of the run.
            state: now.
            axes: leaves of the scene that have lanes first, None without lanes.
            elapsed: time since the last look (s), () or (B,).
            settle: rule by which lanes settle, None for none.
            stop_at: displacement at which lanes are decided (m), None for none.
            least_volume: as for `solve`.

        Returns:
            The watch afterwards, and the status of each lane; settled and decided ones have ended.
        """
        slides, early = (None, None) if settle is None else (settle.slides, settle.early)
        looked = jax.device_get(_look(scene, state, axes, slides, least_volume, early is not None))
        speed, displacement, slid, plastic = looked
        status, watch = np.asarray(state.status), self
        if settle is not None:
            shaken = _still_shaken(scene, state)
            fast, seen = speed > settle.speed, displacement
            if slides is not None:
                fast, seen = fast & (displacement <= slides), np.where(displacement > slides, slid, displacement)
            moves = np.abs(seen - self.reference) > settle.drift
            restless = moves | fast | shaken
            quiet = np.where(restless, 0.0, self.quiet + elapsed)
            watch = Watch(quiet, np.where(moves, seen, self.reference), self.rates)
            settles = (status == Status.RUNNING) & ~restless & (quiet >= settle.hold)
            status = np.where(settles, Status.SETTLED, status)
        if stop_at is not None:
            status = np.where((status == Status.RUNNING) & (displacement > stop_at), Status.DECIDED, status)
        if early is not None:
            strain, half_period = plastic
            rates, stands, speeds_up = early.judged(self.rates, elapsed, half_period, strain, displacement)
            watch = replace(watch, rates=rates)
            time = np.asarray(state.step) * np.asarray(scene.numerics.time_step)
            fails = speeds_up & (early.projected(displacement, time) > stop_at)
            class_ = np.where(stands, Status.SETTLED, np.where(fails, Status.DECIDED, Status.RUNNING))
            status = np.where(status == Status.RUNNING, class_, status)
        return watch, status.astype(np.int32)
