"""Runs: chunks of steps on the device, and between them on the host the stopping rules, snapshots and progress."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from tqdm import tqdm

from foundation import check
from jaxmpm import diagnostics
from jaxmpm._step import grid_position, step
from jaxmpm.laws import hardens, snaps_back, with_parameters
from jaxmpm.run._checks import check_state
from jaxmpm.run._columns import recorded
from jaxmpm.setup import check_scene, check_shape, parameter_names
from jaxmpm.transfer import inside, locate
from jaxmpm.types import Scene, State, Status


@dataclass(frozen=True)
class Settle:
    """Rule by which a lane has settled: for `hold` seconds it is slow and its largest displacement does not change.

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
    """

    speed: float = 0.05
    drift: float = 2e-3
    hold: float = 1.0
    every: float = 0.25
    slides: float | None = None

    def __post_init__(self) -> None:
        for name, unit in (("speed", "m/s"), ("drift", "m"), ("hold", "s")):
            check.not_negative(f"settle's {name}", getattr(self, name), unit)
        check.positive("settle's every", self.every, "s")
        if self.slides is not None:
            check.positive("settle's slides", self.slides, "m")


@dataclass(frozen=True)
class Result:
    """Outcome of `solve`; of a batch, every array has the lanes first.

    Args:
        state: at the end; its `status` and `step` are the `Status` and the steps taken, per lane.
        time_step: s.
        times: of the snapshots (s).
        snapshots: states on the host.
    """

    state: State
    time_step: Array
    times: tuple[float, ...] = ()
    snapshots: tuple[State, ...] = field(default=(), repr=False)

    @property
    def status(self) -> np.ndarray:
        """`Status` of each lane."""
        return np.asarray(self.state.status)

    @property
    def broke_off(self) -> np.ndarray:
        """Whether a lane ended for numerical reasons; a slope that slides did not."""
        return np.asarray(self.status > Status.DECIDED)

    def raise_if_failed(self) -> Result:
        """Return the result if no lane broke off.

        Returns:
            The result itself.

        Raises:
            FloatingPointError: If lanes broke off; the message has their numbers, reasons and steps.
        """
        if np.any(self.broke_off):
            status, steps = np.atleast_1d(self.status), np.atleast_1d(np.asarray(self.state.step))
            lanes = [
                f"lane {i}: {_ADVICE[Status(int(s))]} (step {n})"
                for i, (s, n) in enumerate(zip(status, steps, strict=True))
                if s > Status.DECIDED
            ]
            raise FloatingPointError("; ".join(lanes))
        return self


_ADVICE = {
    Status.NOT_FINITE: "a particle's motion is not finite: lower the CFL number, or look at the material's parameters",
    Status.OUTSIDE_GRID: "a particle has left the grid: enlarge the domain, put a wall there, or give the grid more "
    "`air` above the ground",
    Status.INVERTED: "a particle's volume is no longer positive: refine the grid, or lower the CFL number",
    Status.TIME_STEP_TOO_LARGE: "a particle is faster than the time step allows: build the scene with a larger `speed`",
    Status.BAD_PARAMETER: "a number of its scene, for example its strength at a particle, is not finite or beyond its "
    "limit, its softening snaps back, or its residual is above its peak: check the distribution of its samples",
}


def lane_status(scene: Scene, state: State) -> Array:
    """Status of a running lane after a step: RUNNING, or the reason to end.

    It compares extremes over the particles, which propagate NaN: every comparison with NaN is false.

    Args:
        scene: of the lane.
        state: after the step.

    Returns:
        () int32.
    """
    cells = locate(scene.grid, grid_position(scene, state))
    ends = jnp.stack([jnp.min(cells, axis=1), jnp.max(cells, axis=1)], axis=1)
    speed2 = jnp.max(jnp.sum(state.velocity**2, axis=0))
    finite = jnp.isfinite(speed2) & jnp.all(jnp.isfinite(ends))
    slow = speed2 * scene.time_step**2 < scene.grid.cell**2
    status = jnp.where(slow, Status.RUNNING, Status.TIME_STEP_TOO_LARGE)
    status = jnp.where(jnp.min(state.volume_ratio) > 0, status, Status.INVERTED)
    status = jnp.where(jnp.all(inside(scene.grid, ends)), status, Status.OUTSIDE_GRID)
    return jnp.where(finite, status, Status.NOT_FINITE).astype(jnp.int32)


def begun(scene: Scene, state: State) -> State:
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
    state = begun(scene, state)

    def advanced(old: State) -> State:
        new = step(scene, old, scene.time_step)
        return replace(new, step=old.step + 1, status=lane_status(scene, new))

    def frozen_unless_running(_: Any, old: State) -> State:
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


def lanes(scene: Scene, **values: Array) -> tuple[Scene, Scene]:
    """A scene whose material differs between lanes, and the axes for `solve(..., axes=axes)`.

    Args:
        scene: that lanes share.
        **values: parameters of the material by name, with the lanes as leading axis: `lanes(scene, strength=...)` with
            strength (B,) or (B, N) Pa.

    Returns:
        Scene, and axes: a scene with 0 at leaves that have lanes first, None at the others.

    Raises:
        ValueError: If a name is unknown, a shape is different, or a value is beyond its limit; the lane is its first
            index.
    """
    unknown = set(values) - set(parameter_names(scene))
    if unknown or not values:
        raise ValueError(
            f"{sorted(unknown)} is no parameter of {type(scene.material).__name__}: "
            f"use one of {sorted(parameter_names(scene))}"
        )
    first = {name: jax.tree.leaves(value)[0] for name, value in values.items()}
    count = {np.shape(leaf)[:1] for leaf in first.values()}
    for name, leaf in first.items():
        if np.ndim(leaf) < 1 or len(count) > 1 or not len(leaf):
            raise ValueError(f"{name} has shape {np.shape(leaf)}: give (lanes,) or (lanes, N), as many for every name")
        check_shape(f"a lane of {name}", leaf[0], scene.particles)
    return varied_lanes(scene, partial(with_parameters, scene.material), {n: jnp.asarray(v) for n, v in values.items()})


def varied_lanes(scene: Scene, law_of: Callable[[Any], Any], lanes: Any) -> tuple[Scene, Scene]:
    """A scene with a law for each lane, and the axes for `solve(..., axes=axes)`.

    Args:
        scene: that lanes share.
        law_of: function of one lane's values that returns its law.
        lanes: pytree of arrays (B, ...), values of each lane.

    Returns:
        Scene and axes, as of `lanes`.

    Raises:
        ValueError: If a law is beyond its limits.
    """
    first = law_of(jax.tree.map(lambda leaf: leaf[0], lanes))
    axes = jax.tree.map(lambda one, other: None if one is other else 0, scene.material, first)
    varied = replace(scene, material=jax.vmap(law_of, out_axes=axes)(lanes))
    axes = replace(jax.tree.map(lambda _: None, scene), material=axes)
    check_scene(varied, axes)
    return varied, axes


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


@partial(jax.jit, static_argnames="axes", donate_argnames="state")
def advance_lanes(scene: Scene, state: State, steps: Array, axes: Scene | None) -> State:
    """Compiled `advance` over lanes; the given state is donated.

    On CPU lanes run one after the other, each for all its steps, so that a lane stays in cache; a vmapped step would
    stream all lanes through memory. On other devices they run side by side.

    Args:
        scene: to run.
        state: of one lane, or of B with `axes`.
        steps: () for all lanes, or (B,) for each.
        axes: leaves of the scene that have lanes first, None without lanes; static.

    Returns:
        State.
    """
    in_turn = jax.custom_batching.sequential_vmap(advance)
    one = in_turn if jax.default_backend() == "cpu" else advance
    return _over_lanes(one, axes, 0 if jnp.ndim(steps) else None)(scene, state, steps)


@partial(jax.jit, static_argnames=("axes", "slides", "volume"))
def _look(
    scene: Scene, state: State, axes: Scene | None, slides: float | None, volume: float | None
) -> tuple[Array, ...]:
    """Speed and largest displacement of each lane, or the displacement that a volume exceeds.

    With `slides` also the mean displacement of each slide.
    """

    def measures(scene: Scene, state: State) -> tuple[Array, ...]:
        measured = diagnostics.speed(scene, state), _farthest(scene, state, volume)
        return measured if slides is None else (*measured, diagnostics.slide_displacement(scene, state, slides))

    return _over_lanes(measures, axes)(scene, state)


@partial(jax.jit, static_argnames=("axes", "volume"))
def farthest(scene: Scene, state: State, axes: Scene | None, volume: float | None) -> Array:
    """Largest displacement of each lane (m), or the one that a volume of soil has exceeded."""
    return _over_lanes(partial(_farthest, volume=volume), axes)(scene, state)


def _farthest(scene: Scene, state: State, volume: float | None) -> Array:
    if volume is None:
        return diagnostics.largest_displacement(state)
    return diagnostics.exceeded_displacement(scene, state, volume)


def _over_lanes(function: Callable[..., Any], axes: Scene | None, *others: int | None) -> Callable[..., Any]:
    return function if axes is None else jax.vmap(function, in_axes=(axes, 0, *others))


def solve(
    scene: Scene,
    state: State,
    *,
    t_end: float,
    snapshots: Sequence[float] = (),
    settle: Settle | None = None,
    stop_at: float | None = None,
    least_volume: float | None = None,
    axes: Scene | None = None,
    progress: bool = False,
) -> Result:
    """Run for a time, or until every lane has ended.

    A lane that had finished, settled or been decided in an earlier run goes on; one that broke off does not change.
    Lanes that break off have it in their status, see `Result.raise_if_failed`; one of several lanes with an invalid
    number gets BAD_PARAMETER.

    Args:
        scene: to run.
        state: at the start.
        t_end: duration (s).
        snapshots: times (s) at which to store the state; a lane that has ended has its last one.
        settle: end a lane once it has settled.
        stop_at: end a lane once its largest displacement exceeds this (m).
        least_volume: replaces a lane's largest displacement, here and in `settle`, by the one that this volume of soil
            (m3, in a section m2) has exceeded, see `diagnostics.exceeded_displacement`. None counts every particle.
        axes: leaves of `scene` that have lanes as leading axis (see `lanes`); every leaf of `state` then has.
        progress: show a bar with the simulated time.

    Returns:
        Result.

    Raises:
        ValueError: If a time is below 0, below a step or infinite, `t_end` differs between lanes, the call is within
            jit or a derivative (see `replay`), the state has another precision or lacks the memory of its law, a
            snapshot is after t_end, lanes have different time steps, or, without lanes, a number of the scene is not
            finite or beyond its limit.
    """
    if check.is_traced(scene, state):
        raise ValueError(
            "solve stops on the host, where jit, vmap and derivatives do not reach: take the steps of a run again with "
            "replay(scene, state, int(result.state.step))"
        )
    check_run(t_end, settle, stop_at, least_volume)
    if np.ndim(scene.time_step):
        raise ValueError("time_step differs between lanes: give one number, the smallest of them")
    check.positive("time_step", scene.time_step, "s")
    if axes is None:
        check_scene(scene)
    check_state(scene, state, axes)
    outside = [t for t in snapshots if not 0 <= t <= t_end]
    if outside:
        raise ValueError(f"snapshots at {outside} s lie outside the run: give times from 0 to t_end = {t_end} s")
    dt = float(scene.time_step)
    if t_end < dt * (1 - 1e-6):
        raise ValueError(f"t_end = {t_end:g} s is below the time step of {dt:g} s: give that or more")
    total = steps_until(t_end, dt)
    wanted = {steps_until(t, dt): t for t in sorted(snapshots)}
    rule = settle or Settle()
    look_every = max(1, round(rule.every / dt))
    looks = settle is not None or stop_at is not None
    stops = sorted({*wanted, *(range(look_every, total, look_every) if looks or progress else ()), total})

    stored: dict[int, State] = {}
    watch = Watch.start(np.shape(state.status))
    state = running(jax.tree.map(jnp.copy, state))
    done = 0
    with tqdm(total=round(t_end, 6), unit="s", disable=not progress, bar_format=_BAR) as bar:
        for stop in stops:
            state = advance_lanes(scene, state, jnp.asarray(stop - done), axes)
            bar.update(min((stop - done) * dt, t_end - bar.n))
            if looks:
                watch, ended = watch.look(scene, state, axes, (stop - done) * dt, settle, stop_at, least_volume)
                state = replace(state, status=jnp.asarray(ended))
            done = stop
            if stop in wanted:
                stored[stop] = jax.device_get(state)
            if not np.any(np.asarray(state.status) == Status.RUNNING):
                break
    last = jax.device_get(state)
    final = jnp.where(state.status == Status.RUNNING, Status.FINISHED, state.status).astype(jnp.int32)
    return Result(
        state=replace(state, status=final),
        time_step=scene.time_step,
        times=tuple(wanted.values()),
        snapshots=tuple(stored.get(n, last) for n in wanted),
    )


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


_BAR = "{l_bar}{bar}| {n:.2f}/{total:.2f} s simulated [{elapsed}<{remaining}]"


def steps_until(time: float, dt: float) -> int:
    """Number of steps of dt (s) that reach `time` (s)."""
    return math.ceil(time / dt * (1 - 1e-6))


@dataclass(frozen=True)
class Watch:
    """Memory of the stopping rule between looks, per lane.

    Args:
        quiet: (B,) or () seconds without motion.
        reference: displacement (m) from which motion is counted, of the same shape.
    """

    quiet: np.ndarray
    reference: np.ndarray

    @classmethod
    def start(cls, shape: tuple[int, ...]) -> Watch:
        """A watch without memory, for lanes of this shape."""
        return cls(np.zeros(shape), np.zeros(shape))

    def restarted(self, lane: int, quiet: float, reference: float) -> Watch:
        """The watch with another sample in one lane, at its own time and displacement."""
        fresh = np.arange(self.quiet.size) == lane
        return Watch(np.where(fresh, quiet, self.quiet), np.where(fresh, reference, self.reference))

    def of(self, lanes: np.ndarray) -> Watch:
        """The watch of some lanes."""
        return Watch(self.quiet[lanes], self.reference[lanes])

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
        slides = None if settle is None else settle.slides
        speed, displacement, *slid = map(np.asarray, _look(scene, state, axes, slides, least_volume))
        status, watch = np.asarray(state.status), self
        if settle is not None:
            fast, seen = speed > settle.speed, displacement
            if slides is not None:
                fast, seen = fast & (displacement <= slides), np.where(displacement > slides, slid[0], displacement)
            moved = np.abs(seen - self.reference) > settle.drift
            quiet = np.where(moved | fast, 0.0, self.quiet + elapsed)
            watch = Watch(quiet, np.where(moved, seen, self.reference))
            status = np.where((status == Status.RUNNING) & (quiet >= settle.hold), Status.SETTLED, status)
        if stop_at is not None:
            status = np.where((status == Status.RUNNING) & (displacement > stop_at), Status.DECIDED, status)
        return watch, status.astype(np.int32)
