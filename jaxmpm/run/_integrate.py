"""Runs: chunks of steps on the device, and between them on the host the stopping rules, snapshots and progress."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from tqdm import tqdm

from jaxmpm.run._advance import advance_with_room, running
from jaxmpm.run._checks import check_state
from jaxmpm.run._stopping import Condition, Rule, Watch, check_duration, check_rules, steps_until
from jaxmpm.setup import check_scene
from jaxmpm.support import check
from jaxmpm.support.values import by_value
from jaxmpm.types import Scene, State, Status


@by_value
@dataclass(frozen=True)
class Result:
    """Outcome of `solve`; of a batch, every array has the lanes first.

    Args:
        state: at the end; its `status` and `step` are the `Status` and the steps taken, per lane.
        time_step: s.
        times: of the snapshots (s).
        snapshots: states on the host.
        ended_by: the rule that ended the run, None for none; of a batch, one for each lane.
    """

    state: State
    time_step: Array
    times: tuple[float, ...] = ()
    snapshots: tuple[State, ...] = field(default=(), repr=False)
    ended_by: tuple[Rule | None, ...] | Rule | None = None

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
    Status.TIME_STEP_TOO_LARGE: "a particle is faster than the time step allows: build the scene with a larger `speed`,"
    " or give soil without cohesion `tension_cutoff=0`, by which opened grains remember their gap",
    Status.GRID_FULL: "its soil reaches more nodes than the scene stores: run it by `solve`, or give `follow_soil` the "
    "state that it reaches",
    Status.BAD_PARAMETER: "a number of its scene, for example its strength at a particle, is not finite or beyond its "
    "limit, its softening snaps back, or its residual is above its peak: check the distribution of its samples",
}


def solve(
    scene: Scene,
    state: State,
    *,
    t_end: float,
    snapshots: Sequence[float] | np.ndarray = (),
    rules: Sequence[Rule | Condition] = (),
    every: float = 0.25,
    axes: Scene | None = None,
    progress: bool = False,
) -> Result:
    """Run for a time, or until every lane has ended.

    A lane that finished, settled or was decided in an earlier run goes on; one that broke off does not change. The
    status of a lane says whether it broke off, see `Result.raise_if_failed`. Of several lanes, one with an invalid
    number has the status BAD_PARAMETER.

    Args:
        scene: to run.
        state: at the start.
        t_end: duration (s).
        snapshots: times (s) at which to store the state; a lane that has ended has its last one.
        rules: that end a lane before t_end: `Settle()`, `Exceeds(1.0)`, `jaxmpm.run.Early`, a `jaxmpm.run.Rule` of your
            own, or a function of one lane's scene and state that returns whether it ends, or its `Status`; the first
            that holds gives the status.
        every: time between two checks of the rules (s).
        axes: leaves of `scene` that have lanes as leading axis (see `lanes`); every leaf of `state` then has.
        progress: show a bar with the simulated time.

    Returns:
        Result.

    Raises:
        ValueError: If a time is below 0, below a step or infinite, `t_end` differs between lanes, the call is within
            jit or a derivative (see `replay`), the state has another precision or lacks the memory of its law, a
            snapshot is after t_end, lanes have different time steps, or, without lanes, a number of the scene is not
            finite or beyond its limit.

    Example:
        >>> import jaxmpm as mpm
        >>> soil = mpm.Soil(young=5e6, strength=9e3)
        >>> scene, state = mpm.column(4.0, soil, mpm.Discretisation(cell=1.0, spacing=(0.5,)))
        >>> result = mpm.solve(scene, state, t_end=1.0, rules=[mpm.Settle(hold=0.5), mpm.Exceeds(0.1)])
        >>> mpm.Status(int(result.status)).name
        'SETTLED'

        A rule of your own is a function of the scene and the state of one lane:

        >>> fast = lambda scene, state: mpm.diagnostics.speed(scene, state) > 1.0
        >>> result = mpm.solve(scene, state, t_end=0.2, rules=[fast])
        >>> mpm.Status(int(result.status)).name
        'FINISHED'
    """
    if check.is_traced(scene, state):
        raise ValueError(
            "solve stops on the host, where jit, vmap and derivatives do not reach: take the steps of a run again with "
            "replay(scene, state, int(result.state.step))"
        )
    check_duration(t_end, every)
    if np.ndim(scene.numerics.time_step):
        raise ValueError("time_step differs between lanes: give one number, the smallest of them")
    check.positive("time_step", scene.numerics.time_step, "s")
    if axes is None:
        check_scene(scene)
    check_state(scene, state, axes)
    watch = Watch.start(check_rules(rules, scene, state), np.shape(state.status))
    outside = [t for t in snapshots if not 0 <= t <= t_end]
    if outside:
        raise ValueError(f"snapshots at {outside} s lie outside the run: give times from 0 to t_end = {t_end} s")
    dt = float(scene.numerics.time_step)
    if t_end < dt * (1 - 1e-6):
        raise ValueError(f"t_end = {t_end:g} s is below the time step of {dt:g} s: give that or more")
    total = steps_until(t_end, dt)
    if total > np.iinfo(np.int32).max:
        raise ValueError(f"t_end = {t_end:g} s takes {total:,} steps of {dt:.3g} s, the limit is 2^31: give less")
    times = tuple(sorted(snapshots))
    at_snapshots = [steps_until(t, dt) for t in times]
    look_every = max(1, round(every / dt))
    stops = sorted({*at_snapshots, *(range(look_every, total, look_every) if watch.rules or progress else ()), total})

    stored: dict[int, State] = {}
    state = running(jax.device_put(state, may_alias=False))  # its own: the lanes donate it; compiles nothing
    done = 0
    with tqdm(total=round(t_end, 6), unit="s", disable=not progress, bar_format=_BAR) as bar:
        for stop in stops:
            scene, axes, state = advance_with_room(scene, state, stop - done, axes)
            bar.update(min((stop - done) * dt, t_end - bar.n))
            if watch.rules:
                watch, ended = watch.apply(scene, state, axes, (stop - done) * dt)
                state = replace(state, status=jnp.asarray(ended))
            done = stop
            if stop in at_snapshots:
                stored[stop] = jax.device_get(state)
            if not np.any(np.asarray(state.status) == Status.RUNNING):
                break
    last = jax.device_get(state)
    final = jnp.where(state.status == Status.RUNNING, Status.FINISHED, state.status).astype(jnp.int32)
    return Result(
        state=replace(state, status=final),
        time_step=scene.numerics.time_step,
        times=times,
        snapshots=tuple(stored.get(n, last) for n in at_snapshots),
        ended_by=tuple(map(watch.rule_of, range(final.size))) if final.ndim else watch.rule_of(()),
    )


_BAR = "{l_bar}{bar}| {n:.2f}/{total:.2f} s simulated [{elapsed}<{remaining}]"
